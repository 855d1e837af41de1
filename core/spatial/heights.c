/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/heights.h"

#include <assert.h>
#include <math.h>

#include "core/math/sym3.h"

/* The plane through the mean of points, which is relative to the first of them, across their least spread. */
struct plane {
    vec3 mean, across;
};

/* As seen from across the plane. */
struct spot {
    double x, y, height;
};

static struct plane fit_least_plane(const vec3 *point, const uint32_t *id, unsigned k) {
    struct plane plane;
    vec3 sum = {0, 0, 0};
    sym3 moment = {0};
    double least;
    assert(k > 0 && k <= HEIGHTS_K);
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(point[id[i]], point[id[0]]);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    plane.mean = vec3_scale(sum, 1.0 / k);
    moment = sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / k));
    sym3_least(&moment, 1, &least, &plane.across);
    return plane;
}

static double height_of(const vec3 *point, const uint32_t *id, unsigned i, const struct plane *plane) {
    return vec3_dot(plane->across, vec3_sub(vec3_sub(point[id[i]], point[id[0]]), plane->mean));
}

double heights_rms(const vec3 *point, const uint32_t *id, unsigned k) {
    struct plane plane = fit_least_plane(point, id, k);
    double squares = 0;
    for (unsigned i = 0; i < k; i++) squares += height_of(point, id, i, &plane) * height_of(point, id, i, &plane);
    return sqrt(squares / k);
}

double heights_kurtosis(const vec3 *point, const uint32_t *id, unsigned k) {
    struct plane plane = fit_least_plane(point, id, k);
    double squares = 0, fourths = 0;
    for (unsigned i = 0; i < k; i++) {
        double height = height_of(point, id, i, &plane);
        squares += height * height, fourths += height * height * height * height;
    }
    return squares > 0 ? fourths * k / (squares * squares) : INFINITY;
}

static void lay_on_plane(const vec3 *point, const uint32_t *id, unsigned k, struct spot *spot) {
    struct plane plane = fit_least_plane(point, id, k);
    vec3 u, v;
    vec3_basis(plane.across, &u, &v);
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(vec3_sub(point[id[i]], point[id[0]]), plane.mean);
        spot[i] = (struct spot){vec3_dot(u, e), vec3_dot(v, e), vec3_dot(plane.across, e)};
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

double heights_nugget(const vec3 *point, const uint32_t *id, unsigned k) {
    struct spot spot[HEIGHTS_K] = {{0, 0, 0}};
    double squares = 0, between = 0;
    lay_on_plane(point, id, k, spot);
    for (unsigned i = 0; i < k; i++) {
        double apart = spot[i].height - spot[spot_beside(spot, k, i)].height;
        between += apart * apart;
        squares += spot[i].height * spot[i].height;
    }
    return squares > 0 ? between / (2 * squares) : 1;
}
