/* Coordinates are taken relative to the point itself before anything is squared: a scan that lies a million units from
 * the origin keeps all its digits.
 *
 * Lee, Jong: Point-based Simplification Algorithm, section 4.2.
 * Pauly, Gross, Kobbelt: Efficient Simplification of Point-Sampled Surfaces (2002), for the surface variation.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/normals.h"

#include "core/base/par.h"
#include "core/math/sym3.h"

enum { GRAIN = 2048 };

struct fit {
    const vec3 *point;
    const struct neighbourhood *neighbourhood;
    vec3 *normal;
    float *variation;
};

/* Covariance of {p} and its neighbours about their mean, from coordinates relative to p. */
static sym3 covariance(const struct fit *fit, size_t p) {
    const struct neighbourhood *neighbours = fit->neighbourhood;
    vec3 sum = {0, 0, 0};
    sym3 moment = {0};
    for (unsigned i = 0; i < neighbours->count[p]; i++) {
        vec3 e = vec3_sub(fit->point[neighbours->id[p * neighbours->stride + i]], fit->point[p]);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    return sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / (neighbours->count[p] + 1)));
}

static void fit_few(const struct fit *fit, size_t first, unsigned n) {
    sym3 spread[SYM3_FEW] = {0};
    double least[SYM3_FEW];
    vec3 across[SYM3_FEW];
    for (unsigned i = 0; i < n; i++) spread[i] = covariance(fit, first + i);
    sym3_least(spread, n, least, across);
    for (unsigned i = 0; i < n; i++) {
        double trace = sym3_trace(spread[i]);
        fit->normal[first + i] = trace > 0 ? across[i] : (vec3){0, 0, 1};
        if (fit->variation) fit->variation[first + i] = trace > 0 ? (float)(fmax(least[i], 0) / trace) : 0;
    }
}

static void fit_range(void *ctx, size_t begin, size_t end) {
    const struct fit *fit = ctx;
    for (size_t p = begin; p < end; p += SYM3_FEW) fit_few(fit, p, end - p < SYM3_FEW ? (unsigned)(end - p) : SYM3_FEW);
}

void normals_fit(const vec3 *point, const struct neighbourhood *neighbourhood, unsigned threads, vec3 *normal,
                 float *variation) {
    struct fit fit = {point, neighbourhood, normal, variation};
    par_for(threads, neighbourhood->n, GRAIN, fit_range, &fit);
}
