/* Normals by Voronoi cells: poles.h.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/poles.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

/* How far a cell reaches along a normal, at least, of how far it reaches at all. */
static const double ALONG = 0.6;

/* A Voronoi cell, as far as its corners have been seen. */
struct reach {
    vec3 pole;    /* from the point to the farthest corner */
    vec3 outward; /* of a point on the hull, whose cell has no end: sum of the normals of the hull's facets */
    double along; /* the normal, to either side */
};

static void see_corner(struct reach *reach, vec3 corner, vec3 normal) {
    if (vec3_length_sq(corner) > vec3_length_sq(reach->pole)) reach->pole = corner;
    reach->along = fmax(reach->along, fabs(vec3_dot(corner, normal)));
}

static void see_cells(const struct tets *tets, const vec3 *point, const vec3 *normal, struct reach *reach) {
    for (size_t c = 0; c < tets->finite_count; c++)
        for (int i = 0; i < 4; i++) {
            uint32_t v = tets->vertex[c][i];
            see_corner(&reach[v], vec3_sub(tets->circumcentre[c], point[v]), normal[v]);
        }
}

/* The facet of an infinite cell, counter-clockwise seen from outside. */
static void hull_facet(const struct tets *tets, size_t cell, uint32_t v[3]) {
    static const int facet[4][3] = {{1, 3, 2}, {0, 2, 3}, {0, 3, 1}, {0, 1, 2}};
    int infinite = 0;
    while (infinite < 3 && tets->vertex[cell][infinite] != NONE) infinite++;
    for (int k = 0; k < 3; k++) v[k] = tets->vertex[cell][facet[infinite][k]];
}

static void see_hull(const struct tets *tets, const vec3 *point, struct reach *reach) {
    for (size_t c = tets->finite_count; c < tets->cell_count; c++) {
        uint32_t v[3];
        hull_facet(tets, c, v);
        vec3 outward = vec3_unit(vec3_triangle_normal(point[v[0]], point[v[1]], point[v[2]]));
        for (int k = 0; k < 3; k++) reach[v[k]].outward = vec3_add(reach[v[k]].outward, outward);
    }
}

/* Whether the normal is none; then *pole is the direction of the pole. */
static bool is_askew(const struct reach *reach, vec3 normal, vec3 *pole) {
    bool hull = vec3_length_sq(reach->outward) > 0;
    *pole = vec3_unit(hull ? reach->outward : reach->pole);
    double farthest = hull ? 1 : vec3_length(reach->pole);
    double along = hull ? fabs(vec3_dot(*pole, normal)) : reach->along;
    return vec3_length_sq(*pole) > 0 && along < ALONG * farthest;
}

enum status poles_find_better(const struct tets *tets, const vec3 *point, size_t n, const vec3 *normal, vec3 *better) {
    struct reach *reach = alloc_zeroed(n, sizeof *reach);
    if (!reach) return STATUS_NO_MEMORY;
    see_cells(tets, point, normal, reach);
    see_hull(tets, point, reach);
    for (size_t v = 0; v < n; v++) {
        vec3 pole;
        bool askew = is_askew(&reach[v], normal[v], &pole);
        double side = vec3_dot(pole, normal[v]) < 0 ? -1 : 1;
        better[v] = vec3_scale(pole, askew ? side : 0);
    }
    free(reach);
    return STATUS_OK;
}
