/* Building a tree is one thread's work, so there are several, of pieces of space, built side by side.
 *
 *      +-----+--------+     Cuts at the middles of a sample, across the longest side of its box, make pieces of about
 *      |  1  |   .    |     as many points each.  A query asks the tree of its own piece, then those whose boxes are
 *      +-----+  . 3   |     nearer than what it has found so far; few queries lie that near a cut.  Lower trees make up
 *      |  2  +--------+     for that.
 *      |  .  |   4    |
 *      +-----+--------+
 *
 * Strays, far from where most points are, have a tree of their own.  FLANN's nodes have no boxes but the root's, so a
 * tree with a stray would know nothing of how far the others are from a query between, and look at all of them.
 *
 * Invariant: the pieces depend on the points alone, not on threads; and since of equals the lower id is in, no answer
 * depends on the pieces.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/knn_pieces.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/cloud/most.h"
#include "core/math/quantile.h"
#include "core/spatial/knn_flann.h"

enum { MOST_PIECES = 16, LEAST_POINTS = 1 << 13, SAMPLES = 1024, GRAIN = 1 << 14 };
static const double ASTRAY = 64; /* from the box of most points, in its diagonals */

struct cut {
    unsigned axis;
    double at;
};

struct piece {
    vec3 least, most; /* its box */
    size_t begin, end;
    struct knn_flann *tree; /* NULL where there are no points */
    enum status status;
};

struct knn_pieces {
    const vec3 *point;
    size_t n;
    unsigned count;              /* a power of two */
    struct cut cut[MOST_PIECES]; /* of [1] in two; what comes of [i] is cut by [2 i] and [2 i + 1] */
    bool may_stray;
    vec3 least, most;                    /* what lies outside strays */
    struct piece piece[MOST_PIECES + 1]; /* [count]: strays */
};

/* ------------------------------------------------------------------------------------------------ cuts */

static double along(vec3 p, unsigned axis) { return (&p.x)[axis]; }

static bool is_beyond_cut(const struct cut *cut, vec3 p) { return along(p, cut->axis) >= cut->at; }

/* The middle of n >= 1 points across the longest side of their box. */
static struct cut middle_of(const vec3 *sample, size_t n) {
    vec3 least = sample[0], most = sample[0];
    float value[SAMPLES];
    for (size_t i = 1; i < n; i++) least = vec3_min(least, sample[i]), most = vec3_max(most, sample[i]);
    vec3 side = vec3_sub(most, least);
    unsigned axis = side.x >= side.y && side.x >= side.z ? 0 : side.y >= side.z ? 1 : 2;
    for (size_t i = 0; i < n; i++) value[i] = (float)along(sample[i], axis);
    return (struct cut){axis, (double)quantile_of(value, n, 0.5)};
}

/* Makes the cut that is numbered and all that come of it, by the n points of the sample there. */
static void make_cuts(struct knn_pieces *pieces, unsigned number, vec3 *sample, size_t n) {
    if (number >= pieces->count || n == 0) return;
    struct cut cut = pieces->cut[number] = middle_of(sample, n);
    size_t before = 0;
    for (size_t i = 0; i < n; i++) {
        vec3 p = sample[i];
        if (is_beyond_cut(&cut, p)) continue;
        sample[i] = sample[before];
        sample[before++] = p;
    }
    make_cuts(pieces, 2 * number, sample, before);
    make_cuts(pieces, 2 * number + 1, sample + before, n - before);
}

static void cut_space(struct knn_pieces *pieces) {
    vec3 sample[SAMPLES];
    size_t step = (pieces->n - 1) / SAMPLES + 1, taken = (pieces->n - 1) / step + 1;
    for (size_t i = 0; i < taken; i++) sample[i] = pieces->point[i * step];
    make_cuts(pieces, 1, sample, taken);
}

static void find_strays(struct knn_pieces *pieces) {
    vec3 sample[MOST_SAMPLES];
    size_t taken = pieces->n < MOST_SAMPLES ? pieces->n : MOST_SAMPLES;
    for (size_t i = 0; i < taken; i++) sample[i] = pieces->point[i * pieces->n / taken];
    pieces->may_stray = most_of(sample, taken, &pieces->least, &pieces->most);
    if (!pieces->may_stray) return;
    double room = ASTRAY * vec3_distance(pieces->least, pieces->most);
    pieces->least = vec3_sub(pieces->least, (vec3){room, room, room});
    pieces->most = vec3_add(pieces->most, (vec3){room, room, room});
}

static bool is_stray(const struct knn_pieces *pieces, vec3 p) {
    return pieces->may_stray && !vec3_equal(p, vec3_min(vec3_max(p, pieces->least), pieces->most));
}

/* The number of the piece that a place is in, and how far the nearest cut is: nothing of another piece is nearer. */
static unsigned piece_of(const struct knn_pieces *pieces, vec3 p, double *margin) {
    unsigned number = 1;
    *margin = INFINITY;
    while (number < pieces->count) {
        double beyond = along(p, pieces->cut[number].axis) - pieces->cut[number].at;
        *margin = fabs(beyond) < *margin ? fabs(beyond) : *margin;
        number = 2 * number + (beyond >= 0);
    }
    return number - pieces->count;
}

/* ------------------------------------------------------------------------------------------------ trees */

/* Points by their pieces, in each in the order of their ids. */
struct sorting {
    struct knn_pieces *pieces;
    uint64_t *item;
};

static void key_range(void *ctx, size_t begin, size_t end) {
    const struct sorting *s = ctx;
    double margin;
    for (size_t i = begin; i < end; i++)
        s->item[i] =
            radix_item(is_stray(s->pieces, s->pieces->point[i]) ? s->pieces->count
                                                                : piece_of(s->pieces, s->pieces->point[i], &margin),
                       (uint32_t)i);
}

static void find_pieces(const struct sorting *s) {
    for (size_t i = s->pieces->n, j = i; i > 0; i = j) {
        struct piece *piece = &s->pieces->piece[radix_key(s->item[i - 1])];
        for (j = i; j > 0 && radix_key(s->item[j - 1]) == radix_key(s->item[i - 1]);) j--;
        piece->begin = j, piece->end = i;
    }
}

static void build_piece(void *ctx, size_t number, size_t end) {
    const struct sorting *s = ctx;
    struct piece *piece = &s->pieces->piece[number];
    (void)end;
    if (piece->begin == piece->end) return;
    const vec3 *point = s->pieces->point;
    piece->least = piece->most = point[radix_value(s->item[piece->begin])];
    for (size_t i = piece->begin + 1; i < piece->end; i++) {
        vec3 p = point[radix_value(s->item[i])];
        piece->least = vec3_min(piece->least, p), piece->most = vec3_max(piece->most, p);
    }
    piece->status = knn_flann_new(point, &s->item[piece->begin], piece->end - piece->begin, &piece->tree);
}

static enum status build_trees(struct knn_pieces *pieces, unsigned threads) {
    enum status status = STATUS_OK;
    uint64_t *item = alloc_array(pieces->n, sizeof *item), *spare = alloc_array(pieces->n, sizeof *spare);
    if (item && spare) {
        struct sorting s = {pieces, item};
        par_for(threads, pieces->n, GRAIN, key_range, &s);
        s.item = radix_sort(item, spare, pieces->n, threads);
        find_pieces(&s);
        par_for(threads, pieces->count + 1, 1, build_piece, &s);
        for (unsigned i = 0; i <= pieces->count && !status; i++) status = pieces->piece[i].status;
    } else {
        status = STATUS_NO_MEMORY;
    }
    free(item), free(spare);
    return status;
}

enum status knn_pieces_new(const vec3 *points, size_t n, unsigned threads, struct knn_pieces **out) {
    struct knn_pieces *pieces = alloc_zeroed(1, sizeof *pieces);
    if (!pieces) return STATUS_NO_MEMORY;
    pieces->point = points;
    pieces->n = n;
    for (pieces->count = 1; pieces->count < MOST_PIECES && n / pieces->count >= 2 * LEAST_POINTS;) pieces->count *= 2;
    cut_space(pieces);
    find_strays(pieces);
    enum status status = build_trees(pieces, threads);
    if (status)
        knn_pieces_free(pieces);
    else
        *out = pieces;
    return status;
}

/* ------------------------------------------------------------------------------------------------ queries */

/* How far a piece's box is from a place.  Rounding never makes it more than how far its points are. */
static double piece_distance_sq(const struct piece *piece, vec3 p) {
    vec3 inside = vec3_min(vec3_max(p, piece->least), piece->most);
    return vec3_distance_sq(p, inside);
}

/* The tree of the piece that a place is in, and how far anything of another one is at least. */
static const struct piece *own_piece(const struct knn_pieces *pieces, vec3 p, double *margin_sq) {
    double margin;
    const struct piece *strays = &pieces->piece[pieces->count], *own = &pieces->piece[piece_of(pieces, p, &margin)];
    *margin_sq = margin * margin;
    if (strays->tree) *margin_sq = fmin(*margin_sq, piece_distance_sq(strays, p));
    return own;
}

enum status knn_pieces_nearest(const struct knn_pieces *pieces, vec3 query, unsigned k, const struct knn_slack *slack,
                               uint32_t *id, double *distance_sq, unsigned *count, unsigned *visits) {
    double margin_sq;
    const struct piece *own = own_piece(pieces, query, &margin_sq), *end = &pieces->piece[pieces->count + 1];
    enum status status = STATUS_OK;
    *count = 0;
    if (own->tree) status = knn_flann_nearest(own->tree, query, k, slack, id, distance_sq, count, visits);
    if (*count == k && distance_sq[k - 1] < margin_sq) return status;
    for (const struct piece *piece = pieces->piece; piece < end && *visits && !status; piece++)
        if (piece != own && piece->tree && (*count < k || piece_distance_sq(piece, query) <= distance_sq[k - 1]))
            status = knn_flann_nearest(piece->tree, query, k, slack, id, distance_sq, count, visits);
    return status;
}

enum status knn_pieces_within(const struct knn_pieces *pieces, vec3 centre, double radius, unsigned most, uint32_t *id,
                              unsigned *count) {
    double margin_sq;
    const struct piece *piece = own_piece(pieces, centre, &margin_sq), *end = piece + 1;
    enum status status = STATUS_OK;
    *count = 0;
    if (margin_sq < radius * radius) piece = pieces->piece, end = piece + pieces->count + 1;
    for (; piece < end && *count <= most && !status; piece++)
        if (piece->tree && piece_distance_sq(piece, centre) < radius * radius)
            status = knn_flann_within(piece->tree, centre, radius, most, id, count);
    return status;
}

void knn_pieces_free(struct knn_pieces *pieces) {
    if (!pieces) return;
    for (unsigned i = 0; i <= pieces->count; i++) knn_flann_free(pieces->piece[i].tree);
    bool large = pieces->n > ALLOC_SMALL_POINTS;
    free(pieces);
    if (large) alloc_give_back(); /* the heap of each thread that built a tree would keep what it was made of */
}
