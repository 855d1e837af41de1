/* Refinement: a mesh of the simplified cloud is fitted to the original points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_H
#define WHITTLE_CORE_REFINE_H

#include "core/mesh.h"
#include "core/neighbourhood.h"
#include "core/params.h"
#include "core/progress.h"
#include "core/status.h"
#include "core/vec3.h"

struct refine_input {
    const vec3 *points;
    const vec3 *normals;   /* unit, of either sign */
    const double *spacing; /* mean distance to the neighbours */
    size_t n;
    const struct neighbourhood *hood; /* of the points; may be NULL: then the points alone are fitted to */
};

struct refine_options {
    enum refine_form form;
    enum placement placement;
    unsigned threads;
};

struct refine_facts {
    size_t flips, moves, teleports;
    double cost_before, cost_after;
};

enum status refine_mesh(struct mesh *mesh, const struct refine_input *input, const struct refine_options *options,
                        const struct progress *progress, struct refine_facts *facts) MUST_CHECK;

#endif
