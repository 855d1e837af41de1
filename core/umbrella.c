/* The neighbours of a point are laid out in its tangent plane, each in its direction and at its true distance, so that
 * a sharp edge unfolds rather than being seen from above.  There the ones whose Voronoi cells border on the point's are
 * its ribs, and consecutive ribs span Delaunay's triangles with it.
 *
 *      q1 ----- q0       The cell is where x . q <= |q|^2 / 2 for all q.  So it is the polar of the points
 *      / \     /  \      q / |q|^2: its sides belong to the corners of their convex hull, which one round
 *    q2 --- p --- q4     of Graham's finds, as they are sorted by angle.  The nearest neighbour is always
 *      \   /             a corner, and the round starts there.
 *       q3   (gap)
 *
 * Each point sees its own plane, so neighbours may disagree: a triangle is as sure as many of its corners have it.
 * One that a single corner has must at least lie along the surface at all three, which none across a thin part does.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/umbrella.h"

#include <stdlib.h>

#include "core/alloc.h"
#include "core/cloud.h"
#include "core/par.h"

enum { POINT_GRAIN = 1024 };

#define STEEPEST_SQ 0.64 /* of the sine of the angle between a rib and the tangent plane */
#define WIDEST (-0.95)   /* cosine of the widest angle between consecutive ribs */
#define NARROWEST 0.05   /* sine of the narrowest */
#define ALONG 0.5        /* cosine between a triangle's normal and a point's, for one that a single corner has */

struct search {
    const vec3 *point, *normal;
    const struct neighbourhood *hood;
    struct umbrellas *out;
};

struct rib {
    double x, y;   /* in the tangent plane */
    double ix, iy; /* the same, divided by the squared length */
    double length_sq;
    double quarters; /* grows with the angle, by 4 in a turn */
    uint32_t id;
};

static bool lay_out(const struct search *search, size_t p, uint32_t q, vec3 u, vec3 v, struct rib *rib) {
    vec3 e = vec3_sub(search->point[q], search->point[p]);
    double x = vec3_dot(e, u), y = vec3_dot(e, v), flat_sq = x * x + y * y, length_sq = vec3_length_sq(e);
    if (!(flat_sq > (1 - STEEPEST_SQ) * length_sq)) return false;
    double stretch = sqrt(length_sq / flat_sq), side = y / (fabs(x) + fabs(y));
    x *= stretch, y *= stretch;
    double quarters = x >= 0 ? side : (y >= 0 ? 2 : -2) - side;
    *rib = (struct rib){x, y, x / length_sq, y / length_sq, length_sq, quarters, q};
    return true;
}

/* Sorted by angle; ties by length, then id. */
static bool comes_before(const struct rib *a, const struct rib *b) {
    if (a->quarters != b->quarters) return a->quarters < b->quarters;
    return a->length_sq != b->length_sq ? a->length_sq < b->length_sq : a->id < b->id;
}

static unsigned lay_out_all(const struct search *search, size_t p, struct rib rib[KNN_MAX_K]) {
    const struct neighbourhood *hood = search->hood;
    vec3 u, v;
    unsigned n = 0;
    vec3_basis(search->normal[p], &u, &v);
    for (unsigned i = 0; i < hood->count[p]; i++) {
        struct rib new;
        if (!lay_out(search, p, hood->id[p * hood->stride + i], u, v, &new)) continue;
        unsigned j = n++;
        for (; j > 0 && comes_before(&new, &rib[j - 1]); j--) rib[j] = rib[j - 1];
        rib[j] = new;
    }
    return n;
}

/* Whether the sides of a and c leave none of the cell to b, which is between them. */
static bool is_hidden(const struct rib *a, const struct rib *b, const struct rib *c) {
    if (a->x * c->y - a->y * c->x <= 0) return false;
    return (b->ix - a->ix) * (c->iy - b->iy) <= (b->iy - a->iy) * (c->ix - b->ix);
}

/* Graham's round; hull[0 .. result) are the ribs that are left. */
static unsigned keep_natural(const struct rib *rib, unsigned n, const struct rib *hull[KNN_MAX_K]) {
    unsigned start = 0, kept = 1;
    for (unsigned i = 1; i < n; i++)
        if (rib[i].length_sq < rib[start].length_sq) start = i;
    hull[0] = &rib[start];
    for (unsigned k = 1; k <= n; k++) {
        const struct rib *next = &rib[(start + k) % n];
        while (kept > 1 && is_hidden(hull[kept - 2], hull[kept - 1], next)) kept--;
        if (k < n) hull[kept++] = next;
    }
    return kept;
}

static bool is_closed(const struct rib *a, const struct rib *b) {
    double lengths = sqrt(a->length_sq * b->length_sq);
    return a->x * b->y - a->y * b->x > NARROWEST * lengths && a->x * b->x + a->y * b->y > WIDEST * lengths;
}

static void open_range(void *ctx, size_t begin, size_t end) {
    const struct search *search = ctx;
    for (size_t p = begin; p < end; p++) {
        struct rib rib[KNN_MAX_K];
        const struct rib *hull[KNN_MAX_K];
        unsigned n = lay_out_all(search, p, rib), closed = 0;
        if (n > 0) n = keep_natural(rib, n, hull);
        if (n > UMBRELLA_RIBS) n = UMBRELLA_RIBS;
        for (unsigned i = 0; i < UMBRELLA_RIBS; i++) search->out->rib[p][i] = i < n ? hull[i]->id : NONE;
        for (unsigned i = 0; i < n; i++) closed |= (unsigned)is_closed(hull[i], hull[i + 1 < n ? i + 1 : 0]) << i;
        search->out->closed[p] = (uint16_t)closed;
    }
}

uint32_t umbrella_after(const struct umbrellas *umbrellas, size_t p, unsigned i) {
    const uint32_t *rib = umbrellas->rib[p];
    return i + 1 < UMBRELLA_RIBS && rib[i + 1] != NONE ? rib[i + 1] : rib[0];
}

/* Whether p has the triangle with q and r, in either order: normals have either sign. */
static bool has_triangle(const struct umbrellas *umbrellas, uint32_t p, uint32_t q, uint32_t r) {
    for (unsigned i = 0; i < UMBRELLA_RIBS && umbrellas->rib[p][i] != NONE; i++) {
        if (!(umbrellas->closed[p] >> i & 1)) continue;
        uint32_t a = umbrellas->rib[p][i], b = umbrella_after(umbrellas, p, i);
        if ((a == q && b == r) || (a == r && b == q)) return true;
    }
    return false;
}

static bool lies_along(const struct search *search, uint32_t p, uint32_t q, uint32_t r) {
    vec3 normal = vec3_unit(vec3_triangle_normal(search->point[p], search->point[q], search->point[r]));
    const vec3 *n = search->normal;
    return fabs(vec3_dot(normal, n[p])) >= ALONG && fabs(vec3_dot(normal, n[q])) >= ALONG &&
           fabs(vec3_dot(normal, n[r])) >= ALONG;
}

static unsigned votes_of(const struct search *search, uint32_t p, uint32_t q, uint32_t r) {
    bool at_q = has_triangle(search->out, q, p, r), at_r = has_triangle(search->out, r, p, q);
    if ((at_q && q < p) || (at_r && r < p)) return 0;
    if (!at_q && !at_r && !lies_along(search, p, q, r)) return 0;
    return 1U + at_q + at_r;
}

static void vote_range(void *ctx, size_t begin, size_t end) {
    const struct search *search = ctx;
    const struct umbrellas *out = search->out;
    for (uint32_t p = (uint32_t)begin; p < end; p++) {
        out->votes[p] = 0;
        for (unsigned i = 0; i < UMBRELLA_RIBS && out->rib[p][i] != NONE; i++)
            if (out->closed[p] >> i & 1)
                out->votes[p] |= votes_of(search, p, out->rib[p][i], umbrella_after(out, p, i)) << 2 * i;
    }
}

enum status umbrella_find(const vec3 *point, const vec3 *normal, const struct neighbourhood *hood, unsigned threads,
                          struct umbrellas *out) {
    size_t n = hood->n;
    struct umbrellas new = {.n = n};
    struct search search = {point, normal, hood, &new};
    new.rib = alloc_array(n, sizeof *new.rib);
    new.closed = alloc_array(n, sizeof *new.closed);
    new.votes = alloc_array(n, sizeof *new.votes);
    if (!new.rib || !new.closed || !new.votes) {
        umbrella_done(&new);
        return STATUS_NO_MEMORY;
    }
    par_for(threads, n, POINT_GRAIN, open_range, &search);
    par_for(threads, n, POINT_GRAIN, vote_range, &search);
    *out = new;
    return STATUS_OK;
}

void umbrella_done(struct umbrellas *umbrellas) {
    free(umbrellas->rib), free(umbrellas->closed), free(umbrellas->votes);
    *umbrellas = (struct umbrellas){0};
}
