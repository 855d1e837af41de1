/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine.h"

#include "core/fit.h"
#include "core/fit_flip.h"
#include "core/fit_move.h"
#include "core/fit_teleport.h"
#ifdef FIT_TUNE
#include <stdio.h>
#include <time.h>
double fit_tune[32];
static double now(void){struct timespec t;clock_gettime(CLOCK_MONOTONIC,&t);return (double)t.tv_sec*1e3+(double)t.tv_nsec*1e-6;}
#define SWEEPS (size_t)fit_tune[5]
#else
#define SWEEPS 8
#define now() 0
#define printf(...)
#endif

enum status refine_mesh(struct mesh *mesh, const struct refine_input *input, const struct refine_options *options,
                        const struct progress *progress, struct refine_facts *facts) {
    struct fit fit;
    struct refine_facts made = {0};
    double t0=now();
    enum status status = fit_init(&fit, mesh, input, options);
    if (status) return status;
    printf("samples %zu init %.0f ms\n", fit.samples.n, now()-t0);
    made.cost_before = fit_total(&fit);
    printf("start %.4e\n", made.cost_before/(double)input->n);
    t0=now();
    status = fit_flip(&fit, 12, &made.flips);
    printf("flips %zu %.4e  %.0f ms\n", made.flips, fit_total(&fit)/(double)input->n, now()-t0);
    { double w=0,m=0; for(size_t i=0;i<fit.samples.n;i++)w+=(double)fit.samples.sample[i].weight; m=fit_total(&fit)/w; fit.stray_sq=(FIT_BACKWARD*m)*(FIT_BACKWARD*m); printf("mean %.3e\n",m);}
    for (size_t sweep = 0; !status && options->form == REFINE_FULL && sweep < SWEEPS; sweep++) {
        t0=now();
        size_t m0 = made.moves, f0 = made.flips;
        double t2=t0; size_t p0=made.teleports;
        if (sweep < (size_t)fit_tune[13]) { status = fit_teleport(&fit, &made.teleports); t2=now();
          if(!status)status=fit_flip(&fit,3,&made.flips); }
        printf("teleports %zu %.4e %.0f ms ",made.teleports-p0,fit_total(&fit)/(double)input->n,t2-t0);
        t0=now();
        if(!status)status = fit_move(&fit, &made.moves);
        double t1=now();
        if (!status) status = fit_flip(&fit, 3, &made.flips);
        printf("sweep moves %zu flips %zu %.4e  %.0f + %.0f ms\n", made.moves-m0, made.flips-f0, fit_total(&fit)/(double)input->n, t1-t0,now()-t1);
        (void)m0;(void)f0;(void)t1;(void)t0;(void)progress;
    }
    made.cost_after = fit_total(&fit);
    fit_done(&fit);
    *facts = made;
    return status;
}
