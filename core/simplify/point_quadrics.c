/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/point_quadrics.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/simplify/dso.h"

enum status point_quadrics_make(const struct point_quadrics *of, double *average, struct packed_quadric *quadrics) {
    const struct params *params = of->params;
    const struct quadric_options options = {(enum area_weight)params->area_weight, params->line_quadric, of->threads};
    size_t n = of->neighbourhood->n;
    bool smoothed = params->dso == DSO_RMS; /* the paper's form is used as it is */
    float *smooth = alloc_array(n, sizeof *smooth), *weight = alloc_array(n, sizeof *weight);
    bool room = smooth && weight;
    if (room) {
        if (smoothed) dso_smooth(of->dso, of->neighbourhood, of->threads, smooth);
        const float *measure = smoothed ? smooth : of->dso;
        if (isnan(*average)) *average = dso_average(measure, of->own, n);
        dso_weights(measure, n, *average, params->dso_exponent, of->threads, weight);
        quadric_assemble(of->point, of->normal, of->neighbourhood, weight, &options, quadrics);
    }
    free(smooth), free(weight);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}
