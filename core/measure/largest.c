/* Branch and bound over pieces of triangles.
 *
 * The distance to one triangle T of the target is a convex function of the place, so over a piece it is largest in a
 * corner; and the distance to the whole target is at most that to T.  With T the triangle nearest to the piece's middle
 *
 *     distance(x) <= max over corners c of distance(c, T)        for every x of the piece
 *
 * which is tight as soon as the piece is small beside T.  Pieces whose bound isn't over what has been found already are
 * dropped, the others cut in four.  Of more than MOST pieces those with the largest distances go on, and without a
 * target that has triangles, which gives no bound, those alone decide, a few times.
 *
 * Pieces are measured batch by batch, and what is known grows between batches alone, so the result doesn't depend on
 * the number of threads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/measure/largest.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/math/quantile.h"
#include "core/math/triangle.h"

enum { MOST = 1024, CUTS = 10, CUTS_UNBOUND = 4, GRAIN = 256 };

struct piece {
    vec3 corner[3];
    float rank;  /* the largest distance measured on it, or on what it was cut from */
    float bound; /* no distance on it is larger; INFINITY = not known */
};

struct hunt {
    const struct largest_search *search;
    double largest;
    struct piece *piece, *batch; /* 2 * LARGEST_BATCH that go on; LARGEST_BATCH that are measured */
    size_t count;
    vec3 *middle;
    double *distance;
    uint32_t *nearest;
    float *rank; /* scratch, as many as pieces */
};

static double most_in_corners(const struct largest_search *search, const struct piece *piece, uint32_t t) {
    const uint32_t *v = search->to->triangle[t];
    const vec3 *at = search->to->vertex;
    double most_sq = 0;
    for (int i = 0; i < 3; i++) {
        vec3 near = triangle_closest(piece->corner[i], at[v[0]], at[v[1]], at[v[2]]);
        most_sq = fmax(most_sq, vec3_distance_sq(piece->corner[i], near));
    }
    return sqrt(most_sq);
}

static void bound_range(void *ctx, size_t begin, size_t end) {
    struct hunt *h = ctx;
    for (size_t i = begin; i < end; i++) {
        struct piece *piece = &h->batch[i];
        piece->rank = (float)h->distance[i];
        piece->bound = h->search->to ? (float)most_in_corners(h->search, piece, h->nearest[i]) : INFINITY;
    }
}

static bool may_hold_more(const struct hunt *h, const struct piece *piece) {
    return (double)piece->bound > h->largest * (1 + LARGEST_SLACK);
}

/* Leaves at most MOST pieces that may hold more than is known: those with the largest ranks, the first of equal ones.
 */
static void thin_out(struct hunt *h) {
    size_t n = 0, over = 0;
    for (size_t i = 0; i < h->count; i++)
        if (may_hold_more(h, &h->piece[i])) h->piece[n++] = h->piece[i];
    h->count = n;
    if (n <= MOST) return;
    for (size_t i = 0; i < n; i++) h->rank[i] = h->piece[i].rank;
    float least = quantile_of(h->rank, n, (double)(n - MOST) / (double)(n - 1));
    for (size_t i = 0; i < n; i++) over += h->piece[i].rank > least;
    size_t equal = MOST - over, kept = 0;
    for (size_t i = 0; i < n; i++) {
        float rank = h->piece[i].rank;
        if (rank > least || (rank == least && equal > 0 && equal--)) h->piece[kept++] = h->piece[i];
    }
    h->count = kept;
}

/* Measures n pieces of the batch in their middles; those that may hold more go on. */
static enum status measure_largest_batch(struct hunt *h, size_t n) {
    const struct largest_search *search = h->search;
    for (size_t i = 0; i < n; i++) {
        const vec3 *c = h->batch[i].corner;
        h->middle[i] = vec3_scale(vec3_add(c[0], vec3_add(c[1], c[2])), 1.0 / 3);
    }
    enum status status = search->measure(search->ctx, h->middle, n, h->distance, h->nearest);
    if (status) return status;
    par_for(search->threads, n, GRAIN, bound_range, h);
    for (size_t i = 0; i < n; i++) h->largest = fmax(h->largest, h->distance[i]);
    if (h->count + n > 2 * LARGEST_BATCH) thin_out(h);
    for (size_t i = 0; i < n; i++)
        if (may_hold_more(h, &h->batch[i])) h->piece[h->count++] = h->batch[i];
    return STATUS_OK;
}

static void put_corners(const struct mesh *mesh, size_t t, struct piece *piece) {
    for (int i = 0; i < 3; i++) piece->corner[i] = mesh->vertex[mesh->triangle[t][i]];
}

static enum status measure_triangles(struct hunt *h) {
    const struct mesh *from = h->search->from;
    enum status status = STATUS_OK;
    for (size_t begin = 0; !status && begin < from->triangle_count; begin += LARGEST_BATCH) {
        size_t left = from->triangle_count - begin, n = left < LARGEST_BATCH ? left : LARGEST_BATCH;
        for (size_t i = 0; i < n; i++) put_corners(from, begin + i, &h->batch[i]);
        status = measure_largest_batch(h, n);
        if (h->count > LARGEST_BATCH) thin_out(h);
    }
    return status;
}

/* Without a bound the triangles are ranked by their samples. */
static void rank_triangles(struct hunt *h) {
    const struct mesh *from = h->search->from;
    for (size_t t = 0; t < from->triangle_count; t++) {
        struct piece *piece = &h->piece[h->count++];
        put_corners(from, t, piece);
        piece->rank = h->search->seen[t];
        piece->bound = INFINITY;
        if (h->count == 2 * LARGEST_BATCH) thin_out(h);
    }
}

static void cut(const struct piece *whole, struct piece quarter[4]) {
    vec3 a = whole->corner[0], b = whole->corner[1], c = whole->corner[2];
    vec3 ab = vec3_lerp(a, b, 0.5), bc = vec3_lerp(b, c, 0.5), ca = vec3_lerp(c, a, 0.5);
    const vec3 corner[4][3] = {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}};
    for (int i = 0; i < 4; i++) memcpy(quarter[i].corner, corner[i], sizeof corner[i]);
}

static enum status cut_pieces(struct hunt *h) {
    thin_out(h);
    size_t n = h->count;
    for (size_t i = 0; i < n; i++) cut(&h->piece[i], &h->batch[4 * i]);
    h->count = 0;
    return measure_largest_batch(h, 4 * n);
}
_Static_assert(4 * MOST <= LARGEST_BATCH, "the quarters of MOST pieces are one batch");

enum status largest_distance(const struct largest_search *search, double *largest) {
    struct hunt h = {.search = search, .largest = *largest};
    h.piece = alloc_array(2 * LARGEST_BATCH, sizeof *h.piece);
    h.batch = alloc_array(LARGEST_BATCH, sizeof *h.batch);
    h.middle = alloc_array(LARGEST_BATCH, sizeof *h.middle);
    h.distance = alloc_array(LARGEST_BATCH, sizeof *h.distance);
    h.nearest = alloc_array(LARGEST_BATCH, sizeof *h.nearest);
    h.rank = alloc_array(2 * LARGEST_BATCH, sizeof *h.rank);
    bool room = h.piece && h.batch && h.middle && h.distance && h.nearest && h.rank;
    enum status status = room ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status && search->to) status = measure_triangles(&h);
    if (!status && !search->to) rank_triangles(&h);
    for (int i = 0; !status && h.count > 0 && i < (search->to ? CUTS : CUTS_UNBOUND); i++) status = cut_pieces(&h);
    if (!status) *largest = h.largest;
    free(h.piece), free(h.batch), free(h.middle), free(h.distance), free(h.nearest), free(h.rank);
    return status;
}
