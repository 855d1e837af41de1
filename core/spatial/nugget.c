/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/nugget.h"

#include <assert.h>
#include <math.h>

#include "core/math/sym3.h"

/* As seen from across the plane. */
struct spot {
    double x, y, height;
};

static void lay_on_plane(const vec3 *point, const uint32_t *id, unsigned k, struct spot *spot) {
    vec3 sum = {0, 0, 0}, across, u, v;
    sym3 moment = {0};
    double least;
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(point[id[i]], point[id[0]]);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    vec3 mean = vec3_scale(sum, 1.0 / k);
    moment = sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / k));
    sym3_least(&moment, 1, &least, &across);
    vec3_basis(across, &u, &v);
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(vec3_sub(point[id[i]], point[id[0]]), mean);
        spot[i] = (struct spot){vec3_dot(u, e), vec3_dot(v, e), vec3_dot(across, e)};
    }
}

static unsigned spot_beside(const struct spot *spot, unsigned k, unsigned of) {
    double least = INFINITY;
    unsigned beside = of;
    for (unsigned i = 0; i < k; i++) {
        double x = spot[i].x - spot[of].x, y = spot[i].y - spot[of].y, distance_sq = x * x + y * y;
        if (i != of && distance_sq < least) least = distance_sq, beside = i;
    }
    return beside;
}

double nugget_of_heights(const vec3 *point, const uint32_t *id, unsigned k) {
    struct spot spot[NUGGET_K] = {{0, 0, 0}};
    double squares = 0, between = 0;
    assert(k <= NUGGET_K);
    lay_on_plane(point, id, k, spot);
    for (unsigned i = 0; i < k; i++) {
        double apart = spot[i].height - spot[spot_beside(spot, k, i)].height;
        between += apart * apart;
        squares += spot[i].height * spot[i].height;
    }
    return squares > 0 ? between / (2 * squares) : 1;
}
