/* The neighbours of a point are laid out in its tangent plane, each in its direction and at its true distance, so that
 * a sharp edge unfolds rather than being seen from above.  There the ones whose Voronoi cells border on the point's are
 * its ribs, and consecutive ribs span Delaunay's triangles with it.
 *
 *      q1 ----- q0       The cell is where x . q <= |q|^2 / 2 for all q.  So it is the polar of the points
 *      / \     /  \      q / |q|^2: its sides belong to the corners of their convex hull, which one round
 *    q2 --- p --- q4     of Graham's finds, as they are sorted by angle.  The nearest neighbour is always
 *      \   /             a corner, and the round starts there.
 *       q3   (unsampled)
 *
 * Each point has a plane of its own, so neighbours may disagree: a triangle is as sure as many of its corners have it.
 * One that a single corner has must at least lie along the surface at all three, which none across a thin part does.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/local_delaunay.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/simd.h"

enum { POINT_GRAIN = 1024, ROOM = KNN_MAX_K + 4 };

#define STEEPEST_SQ 0.64 /* of the sine of the angle between a rib and the tangent plane */
#define WIDEST (-0.95)   /* cosine of the widest angle between consecutive ribs */
#define NARROWEST 0.05   /* sine of the narrowest */
#define BEHIND (-0.5)    /* cosine of the angle between two neighbours that hide what is behind them */
#define ALONG_SHEET 0.8  /* the same, a triangle's and a sheet's */
#define ALONG 0.5        /* cosine between the normals of a triangle and of a point, for one that a single corner has */

struct search {
    const vec3 *point, *normal;
    const struct neighbourhood *neighbours;
    const struct creases *creases; /* may be NULL */
    struct local_delaunay *out;
};

/* Neighbours laid out in the tangent plane. */
struct ribs {
    unsigned n;
    double x[ROOM], y[ROOM];   /* in the plane */
    double ix[ROOM], iy[ROOM]; /* the same, divided by the squared length */
    double length_sq[ROOM];
    double quarters[ROOM]; /* grows with the angle, by 4 in a turn */
    uint32_t id[ROOM];
};

struct plane {
    vec3 at, u, v;
};

/* As many of them as a vector holds, without those that are too steep. */
INLINE void lay_out(const struct search *search, const struct plane *plane, const uint32_t id[F64_LANES],
                    unsigned count, struct ribs *ribs) {
    const vec3 *q[F64_LANES], *at = &plane->at, *u = &plane->u, *v = &plane->v;
    for (unsigned k = 0; k < F64_LANES; k++) q[k] = &search->point[id[k < count ? k : 0]];
    struct f64v3 place = f64v3_gather(q);
    f64v ex = place.x - at->x, ey = place.y - at->y, ez = place.z - at->z;
    f64v x = ex * u->x + ey * u->y + ez * u->z, y = ex * v->x + ey * v->y + ez * v->z;
    f64v flat_sq = x * x + y * y, length_sq = ex * ex + ey * ey + ez * ez;
    i64v lies = f64_less((1 - STEEPEST_SQ) * length_sq, flat_sq);
    f64v stretch = f64_sqrt(length_sq / flat_sq), side = y / (f64_abs(x) + f64_abs(y));
    x *= stretch, y *= stretch;
    f64v behind = f64_pick(f64_at_least(y, f64_all(0)), f64_all(2), f64_all(-2)) - side;
    f64v quarters = f64_pick(f64_at_least(x, f64_all(0)), side, behind);
    f64v ix = x / length_sq, iy = y / length_sq;
    for (unsigned k = 0; k < count; k++) {
        unsigned i = ribs->n;
        ribs->x[i] = SIMD_LANE(x, k), ribs->y[i] = SIMD_LANE(y, k);
        ribs->ix[i] = SIMD_LANE(ix, k), ribs->iy[i] = SIMD_LANE(iy, k);
        ribs->length_sq[i] = SIMD_LANE(length_sq, k), ribs->quarters[i] = SIMD_LANE(quarters, k), ribs->id[i] = id[k];
        ribs->n += SIMD_LANE(lies, k) != 0;
    }
}

/* Whether what is on no sheet at p, in direction `to`, lies behind two neighbours on the crease at the sheet's end. */
static bool is_behind(const vec3 *on, unsigned n, vec3 to, vec3 normal) {
    vec3 flat = vec3_sub(to, vec3_scale(normal, vec3_dot(to, normal)));
    double stretch = vec3_length(flat) > 0 ? vec3_length(to) / vec3_length(flat) : 0;
    flat = vec3_scale(flat, stretch);
    for (unsigned i = 0; i < n; i++)
        for (unsigned j = 0; j < n; j++) {
            double lengths = vec3_length(on[i]) * vec3_length(on[j]);
            if (vec3_dot(vec3_cross(on[i], flat), normal) <= 0 || vec3_dot(vec3_cross(flat, on[j]), normal) <= 0 ||
                vec3_dot(on[i], on[j]) < BEHIND * lengths)
                continue;
            if (vec3_dot(vec3_cross(vec3_sub(on[j], on[i]), vec3_sub(flat, on[i])), normal) < 0) return true;
        }
    return false;
}

static bool is_on_crease(const struct search *search, uint32_t p) {
    const struct sheets *sheets = creases_at(search->creases, p);
    return sheets && sheets->count > 1;
}

/* The neighbours of p without those behind a crease; their number. */
static unsigned hold(const struct search *search, const struct sheets *sheets, size_t p, uint32_t held[KNN_MAX_K]) {
    const struct neighbourhood *neighbours = search->neighbours;
    const uint32_t *id = &neighbours->id[p * neighbours->stride];
    vec3 on[KNN_MAX_K];
    unsigned on_count = 0, count = 0;
    for (unsigned i = 0; i < neighbours->count[p]; i++) {
        vec3 to = vec3_sub(search->point[id[i]], search->point[p]);
        if (is_on_crease(search, id[i]) && sheets_hold(sheets, vec3_unit(to))) on[on_count++] = to;
    }
    for (unsigned i = 0; i < neighbours->count[p]; i++) {
        vec3 to = vec3_sub(search->point[id[i]], search->point[p]);
        if (sheets_hold(sheets, vec3_unit(to)) || !is_behind(on, on_count, to, sheets_normal(sheets, 0)))
            held[count++] = id[i];
    }
    return count;
}

static void lay_out_all(const struct search *search, size_t p, struct ribs *ribs) {
    const struct neighbourhood *neighbours = search->neighbours;
    const uint32_t *id = &neighbours->id[p * neighbours->stride];
    struct plane plane = {.at = search->point[p]};
    const struct sheets *sheets = creases_at(search->creases, (uint32_t)p);
    uint32_t held[KNN_MAX_K];
    unsigned count = neighbours->count[p];
    if (sheets && sheets->count == 1) {
        count = hold(search, sheets, p, held);
        id = held;
    }
    vec3_basis(sheets && sheets->count == 1 ? sheets_normal(sheets, 0) : search->normal[p], &plane.u, &plane.v);
    ribs->n = 0;
    for (unsigned i = 0; i < count; i += F64_LANES) {
        unsigned left = count - i;
        lay_out(search, &plane, id + i, left < F64_LANES ? left : F64_LANES, ribs);
    }
}

/* By angle; ties by length, then id. */
static bool comes_before(const struct ribs *r, unsigned a, unsigned b) {
    if (r->quarters[a] != r->quarters[b]) return r->quarters[a] < r->quarters[b];
    return r->length_sq[a] != r->length_sq[b] ? r->length_sq[a] < r->length_sq[b] : r->id[a] < r->id[b];
}

static void sort_slowly(const struct ribs *ribs, unsigned order[ROOM]) {
    for (unsigned i = 0; i < ribs->n; i++) {
        unsigned j = i;
        for (; j > 0 && comes_before(ribs, i, order[j - 1]); j--) order[j] = order[j - 1];
        order[j] = i;
    }
}

/* A rib comes after as many as have a smaller angle: to count these takes no branch that might be guessed wrong.  False
 * where two have the same. */
static bool sort_by_counting(struct ribs *ribs, unsigned order[ROOM]) {
    uint64_t places = 0;
    for (unsigned k = 0; k < F64_LANES; k++) ribs->quarters[ribs->n + k] = INFINITY;
    for (unsigned i = 0; i < ribs->n; i++) {
        i64v before = i64_all(0);
        f64v own = f64_all(ribs->quarters[i]);
        for (unsigned j = 0; j < ribs->n; j += F64_LANES) before -= f64_less(f64_load(&ribs->quarters[j]), own);
        unsigned place = (unsigned)i64_total(before);
        order[place] = i;
        places |= (uint64_t)1 << place;
    }
    return (unsigned)__builtin_popcountll(places) == ribs->n;
}

/* Whether the sides of a and c leave none of the cell to b, which is between them. */
static bool is_hidden(const struct ribs *r, unsigned a, unsigned b, unsigned c) {
    if (r->x[a] * r->y[c] - r->y[a] * r->x[c] <= 0) return false;
    return (r->ix[b] - r->ix[a]) * (r->iy[c] - r->iy[b]) <= (r->iy[b] - r->iy[a]) * (r->ix[c] - r->ix[b]);
}

/* Graham's round over the ribs in their order; hull[0 .. result) are those that are left. */
static unsigned keep_natural(const struct ribs *ribs, const unsigned *order, unsigned hull[ROOM]) {
    unsigned start = 0, kept = 1, n = ribs->n;
    for (unsigned i = 1; i < n; i++)
        if (ribs->length_sq[order[i]] < ribs->length_sq[order[start]]) start = i;
    hull[0] = order[start];
    for (unsigned k = 1, at = start; k <= n; k++) {
        at = at + 1 < n ? at + 1 : 0;
        while (kept > 1 && is_hidden(ribs, hull[kept - 2], hull[kept - 1], order[at])) kept--;
        if (k < n) hull[kept++] = order[at];
    }
    return kept;
}

static bool is_closed(const struct ribs *r, unsigned a, unsigned b) {
    double lengths = sqrt(r->length_sq[a] * r->length_sq[b]);
    return r->x[a] * r->y[b] - r->y[a] * r->x[b] > NARROWEST * lengths &&
           r->x[a] * r->x[b] + r->y[a] * r->y[b] > WIDEST * lengths;
}

static void open_range(void *ctx, size_t begin, size_t end) {
    const struct search *search = ctx;
    for (size_t p = begin; p < end; p++) {
        struct ribs ribs;
        unsigned order[ROOM], hull[ROOM], n = 0, closed = 0;
        lay_out_all(search, p, &ribs);
        if (!sort_by_counting(&ribs, order)) sort_slowly(&ribs, order);
        if (ribs.n > 0) n = keep_natural(&ribs, order, hull);
        if (n > LOCAL_DELAUNAY_RIBS) n = LOCAL_DELAUNAY_RIBS;
        for (unsigned i = 0; i < LOCAL_DELAUNAY_RIBS; i++) search->out->rib[p][i] = i < n ? ribs.id[hull[i]] : NONE;
        for (unsigned i = 0; i < n; i++)
            closed |= (unsigned)is_closed(&ribs, hull[i], hull[i + 1 < n ? i + 1 : 0]) << i;
        search->out->closed[p] = (uint16_t)(closed | n << LOCAL_DELAUNAY_RIBS);
    }
}

static_assert(LOCAL_DELAUNAY_RIBS % 4 == 0, "ids are compared four at a time");

/* Whether p has the triangle with q and r, in either order: normals have either sign.  It takes no branch that might be
 * guessed wrong. */
static inline bool has_triangle(const struct local_delaunay *local_delaunay, uint32_t p, uint32_t q, uint32_t r) {
    const uint32_t *rib = local_delaunay->rib[p];
    uint32_t at_q = ids_equal(rib, LOCAL_DELAUNAY_RIBS, q), at_r = ids_equal(rib, LOCAL_DELAUNAY_RIBS, r);
    unsigned n = local_delaunay_ribs(local_delaunay, p), last = n > 0 ? n - 1 : 0;
    uint32_t before_q = at_q >> 1 | (at_q & 1) << last, before_r = at_r >> 1 | (at_r & 1) << last;
    return local_delaunay->closed[p] & ((at_q & before_r) | (at_r & before_q));
}

static bool lies_along(const struct search *search, uint32_t p, uint32_t q, uint32_t r) {
    vec3 normal = vec3_unit(vec3_triangle_normal(search->point[p], search->point[q], search->point[r]));
    const vec3 *n = search->normal;
    return fabs(vec3_dot(normal, n[p])) >= ALONG && fabs(vec3_dot(normal, n[q])) >= ALONG &&
           fabs(vec3_dot(normal, n[r])) >= ALONG;
}

/* Whether the triangle lies along one of the sheets at each of its corners that have any. */
static bool follows_sheets(const struct search *search, const uint32_t corner[3]) {
    const struct sheets *sheets[3];
    const vec3 *p = search->point;
    for (int k = 0; k < 3; k++) sheets[k] = creases_at(search->creases, corner[k]);
    if (!sheets[0] && !sheets[1] && !sheets[2]) return true;
    vec3 normal = vec3_unit(vec3_triangle_normal(p[corner[0]], p[corner[1]], p[corner[2]]));
    for (int k = 0; k < 3; k++)
        if (sheets[k] && sheets_agreement(sheets[k], normal) < ALONG_SHEET) return false;
    return true;
}

static unsigned votes_of(const struct search *search, uint32_t p, uint32_t q, uint32_t r) {
    bool at_q = has_triangle(search->out, q, p, r);
    if (at_q && q < p) return 0;
    bool at_r = has_triangle(search->out, r, p, q);
    if (at_r && r < p) return 0;
    if (!at_q && !at_r && !lies_along(search, p, q, r)) return 0;
    if (!follows_sheets(search, (uint32_t[3]){p, q, r})) return 0;
    return 1U + at_q + at_r;
}

static void vote_range(void *ctx, size_t begin, size_t end) {
    const struct search *search = ctx;
    const struct local_delaunay *out = search->out;
    for (uint32_t p = (uint32_t)begin; p < end; p++) {
        out->votes[p] = 0;
        for (unsigned i = 0, n = local_delaunay_ribs(out, p); i < n; i++)
            if (out->closed[p] >> i & 1)
                out->votes[p] |= votes_of(search, p, out->rib[p][i], local_delaunay_after(out, p, i)) << 2 * i;
    }
}

FOR_EACH_PROCESSOR(enum status, local_delaunay_find)
(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbours, const struct creases *creases,
 unsigned threads, struct local_delaunay *out) {
    size_t n = neighbours->n;
    struct local_delaunay new = {.n = n};
    struct search search = {point, normal, neighbours, creases, &new};
    new.rib = alloc_array(n, sizeof *new.rib);
    new.closed = alloc_array(n, sizeof *new.closed);
    new.votes = alloc_array(n, sizeof *new.votes);
    if (!new.rib || !new.closed || !new.votes) {
        local_delaunay_done(&new);
        return STATUS_NO_MEMORY;
    }
    par_for(threads, n, POINT_GRAIN, open_range, &search);
    par_for(threads, n, POINT_GRAIN, vote_range, &search);
    *out = new;
    return STATUS_OK;
}

FOR_EACH_PROCESSOR(void, local_delaunay_done)
(struct local_delaunay *local_delaunay) {
    free(local_delaunay->rib), free(local_delaunay->closed), free(local_delaunay->votes);
    *local_delaunay = (struct local_delaunay){0};
}
