/* Sides of normals.
 *
 * The forest is found as by Kruskal, but edges aren't sorted: they are gone through once for each class of likeness,
 * the most alike first, which takes no memory.  A set of points remembers of each whether its normal is turned against
 * that of its parent in the set's tree.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/normal_sides.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

/* Shares and mean cosines of normals that fit: random ones have 0.5 and 0.5. */
static const double MOST_GIVEN = 0.9, ALONG = 0.65, TO_ONE_SIDE = 0.75;
/* Cosines that classes of edges begin at. */
static const double alike[] = {0.9999, 0.999, 0.995, 0.99, 0.98, 0.96, 0.92, 0.85, 0.7, 0.5, 0.25, 0};
enum { CLASSES = sizeof alike / sizeof *alike };
static const double UPWARDS = 0.3; /* share of a part's surface, less what faces down */

/* ------------------------------------------------------------------------------------------------ given ones */

static bool is_given(vec3 n) { return vec3_is_finite(n) && vec3_length_sq(n) > 0; }

bool normals_fit_points(const vec3 *given, const vec3 *normal, const struct neighbourhood *neighbours) {
    size_t there = 0, pairs = 0, same = 0;
    double along = 0;
    for (size_t p = 0; p < neighbours->n; p++) {
        if (!is_given(given[p])) continue;
        double own = vec3_dot(vec3_unit(given[p]), normal[p]);
        there++;
        along += fabs(own);
        for (unsigned i = 0; i < neighbours->count[p]; i++) {
            uint32_t q = neighbours->id[p * neighbours->stride + i];
            double between = vec3_dot(normal[p], normal[q]);
            if (!is_given(given[q]) || fabs(between) < 0.5) continue;
            pairs++;
            same += (own > 0) == ((vec3_dot(given[q], normal[q]) > 0) == (between > 0));
        }
    }
    return (double)there > MOST_GIVEN * (double)neighbours->n && along > ALONG * (double)there &&
           (double)same > TO_ONE_SIDE * (double)pairs;
}

/* ------------------------------------------------------------------------------------------------ the forest */

struct disjoint_set {
    uint32_t *parent;
    uint8_t *turned; /* against the parent */
};

/* The root of p's tree; *turned = whether p is turned against it. */
static uint32_t root_of(struct disjoint_set *disjoint_set, uint32_t p, uint8_t *turned) {
    uint8_t against = 0;
    while (disjoint_set->parent[p] != p) {
        uint32_t up = disjoint_set->parent[p], above = disjoint_set->parent[up];
        disjoint_set->turned[p] ^= up == above ? 0 : disjoint_set->turned[up];
        disjoint_set->parent[p] = above;
        against ^= disjoint_set->turned[p];
        p = above;
    }
    *turned = against;
    return p;
}

static void unite(struct disjoint_set *disjoint_set, uint32_t p, uint32_t q, bool against) {
    uint8_t of_p, of_q;
    uint32_t a = root_of(disjoint_set, p, &of_p), b = root_of(disjoint_set, q, &of_q);
    if (a == b) return;
    uint32_t low = a < b ? a : b, high = a < b ? b : a;
    disjoint_set->parent[high] = low;
    disjoint_set->turned[high] = of_p ^ of_q ^ (uint8_t)against;
}

static void grow(struct disjoint_set *disjoint_set, const struct neighbourhood *neighbours, const vec3 *normal) {
    for (uint32_t p = 0; p < neighbours->n; p++) disjoint_set->parent[p] = p, disjoint_set->turned[p] = 0;
    for (int class = 0; class < CLASSES; class ++) {
        double least = alike[class], most = class ? alike[class - 1] : INFINITY;
        for (uint32_t p = 0; p < neighbours->n; p++)
            for (unsigned i = 0; i < neighbours->count[p]; i++) {
                uint32_t q = neighbours->id[(size_t)p * neighbours->stride + i];
                double cosine = vec3_dot(normal[p], normal[q]);
                if (fabs(cosine) >= least && fabs(cosine) < most) unite(disjoint_set, p, q, cosine < 0);
            }
    }
}

/* ------------------------------------------------------------------------------------------------ the parts */

/* Of a tree, by its root: sums over its points, each with the surface that it stands for. */
struct part {
    double area, up, out;
    vec3 middle;
};

static double area_of(const struct neighbourhood *neighbours, size_t p) {
    return fmax((double)neighbours->spacing[p] * (double)neighbours->spacing[p], 1e-30);
}

static void turn_parts(const vec3 *point, const struct neighbourhood *neighbours, struct disjoint_set *disjoint_set,
                       struct part *part, vec3 *normal, enum normal_side *side) {
    double upwards = 0, outwards = 0;
    uint8_t turned;
    for (uint32_t p = 0; p < neighbours->n; p++) {
        struct part *own = &part[root_of(disjoint_set, p, &turned)];
        double area = area_of(neighbours, p);
        if (turned) normal[p] = vec3_scale(normal[p], -1);
        own->area += area;
        own->up += area * normal[p].z;
        own->middle = vec3_add(own->middle, vec3_scale(point[p], area));
    }
    for (uint32_t p = 0; p < neighbours->n; p++) {
        struct part *own = &part[root_of(disjoint_set, p, &turned)];
        vec3 away = vec3_sub(point[p], vec3_scale(own->middle, 1 / own->area));
        own->out += area_of(neighbours, p) * vec3_dot(normal[p], away);
    }
    for (uint32_t p = 0; p < neighbours->n; p++) {
        const struct part *own = &part[root_of(disjoint_set, p, &turned)];
        bool is_up = fabs(own->up) > UPWARDS * own->area;
        *(is_up ? &upwards : &outwards) += area_of(neighbours, p);
        if ((is_up ? own->up : own->out) < 0) normal[p] = vec3_scale(normal[p], -1);
    }
    *side = upwards > outwards ? NORMALS_UP : NORMALS_OUT;
}

static enum status turn_together(const vec3 *point, const struct neighbourhood *neighbours, vec3 *normal,
                                 enum normal_side *side) {
    struct disjoint_set disjoint_set = {alloc_array(neighbours->n, sizeof *disjoint_set.parent),
                                        alloc_array(neighbours->n, sizeof *disjoint_set.turned)};
    struct part *part = alloc_zeroed(neighbours->n, sizeof *part);
    bool room = disjoint_set.parent && disjoint_set.turned && part;
    if (room) {
        grow(&disjoint_set, neighbours, normal);
        turn_parts(point, neighbours, &disjoint_set, part, normal, side);
    }
    free(disjoint_set.parent), free(disjoint_set.turned), free(part);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status normals_turn(const vec3 *point, const struct neighbourhood *neighbours,
                         const struct normal_evidence *evidence, vec3 *normal, enum normal_side *side) {
    if (!evidence->given && !evidence->view) return turn_together(point, neighbours, normal, side);
    *side = evidence->given ? NORMALS_BY_GIVEN : NORMALS_BY_VIEW;
    for (size_t p = 0; p < neighbours->n; p++) {
        vec3 towards = evidence->given ? evidence->given[p] : (vec3){0, 0, 0};
        if (!is_given(towards) && evidence->view) towards = vec3_sub(evidence->view[p], point[p]);
        if (vec3_dot(towards, normal[p]) < 0) normal[p] = vec3_scale(normal[p], -1);
    }
    return STATUS_OK;
}
