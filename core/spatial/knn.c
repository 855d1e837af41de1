/* Queries along the curve in groups (knn_group.c), the others one by one (knn_pieces.c).
 *
 * The boxes, or where the order of the points tells too little the trees, are walked once for a run of some ten
 * queries.  From what that has gathered groups of some three take what is near them; whoever needs more than its group
 * has looks among all that the run has, and then asks the trees.
 *
 * How far the k-th neighbour of the last query was tells how wide the next run and group may be: by that of a surface.
 * In a volume as wide a ball has several times as many points, too many to gather, so groups become narrower there.  A
 * group of few isn't worth gathering for, but in a volume; so queries in no order cost what they would without groups.
 *
 * Queries far from all points come together, too: after one for which the trees looked at very many points the next
 * ones ask the boxes at once, and look no farther than by what the one before found.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/knn.h"

#include <assert.h>
#include <limits.h>
#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/spatial/knn_boxes.h"
#include "core/spatial/knn_group.h"
#include "core/spatial/knn_pieces.h"

enum {
    BATCH = 2048,
    LEAST_BATCH = 128,
    BATCHES = 32,
    FEWEST = 2,
    GROUP = 16,
    RUN = 64,
    FEW = 8 /* neighbours */,
    FEW_MOST = 256 /* points in a ball, where so few are looked for */,
    FAR_ALONE = 31
};
static const double GROUP_WIDTH = 2, GROUP_ROOM = 1.2; /* in distances to the k-th neighbour, as the next line */
static const double RUN_WIDTH = 4, RUN_ROOM = 1.6;
static const double NARROWEST = 1.0 / 3;  /* of those widths, where balls are crowded */
static const double ROUNDING = 1 + 1e-12; /* more than bounds are off by */
enum { UNCROWDED = KNN_GROUP_POINTS / 8 /* points in a ball that may be twice as wide */ };

struct knn {
    const vec3 *point;
    size_t n;
    struct knn_pieces *pieces;
    struct knn_boxes *boxes; /* for queries that the pieces' trees don't answer soon */
};

enum status knn_new(const vec3 *points, size_t n, unsigned threads, struct knn **out, struct error *error) {
    assert(n > 0);
    if (n > INT_MAX) return error_set(error, STATUS_LIMIT, "knn", "%zu points are more than FLANN counts", n);
    struct knn *knn = alloc_zeroed(1, sizeof *knn);
    if (!knn) return error_set(error, STATUS_NO_MEMORY, "knn", "no memory for the index");
    *knn = (struct knn){.point = points, .n = n};
    if (knn_pieces_new(points, n, threads, &knn->pieces) || knn_boxes_new(points, n, &knn->boxes)) {
        knn_free(knn);
        return error_set(error, STATUS_NO_MEMORY, "knn", "FLANN could not build its index");
    }
    *out = knn;
    return STATUS_OK;
}

struct search {
    const struct knn *knn;
    const vec3 *queries;
    unsigned k;
    const struct knn_slack *slack; /* NULL: all exact */
    uint32_t *id;
    double *distance_sq;
    atomic_bool failed;
};

/* Queries along the curve that are near each other. */
struct run {
    size_t begin, end;  /* begin: of the range that this thread answers */
    unsigned far_alone; /* so many that are asked alone don't ask the trees: one before took them too long */
    double usual;       /* how far the k-th neighbour of the last query was */
    double width;       /* of groups, a fraction of GROUP_WIDTH */
    struct knn_group_from from;
    bool gathered;
    struct knn_group wide; /* what was, for all of them */
};

/* How many queries from q on, at most so many, are within a width. */
static size_t length_of(const struct search *search, const struct run *run, size_t q, size_t most, double width) {
    size_t left = run->end - q;
    return knn_group_length(&search->queries[q], left < most ? left : most, width * run->usual);
}

/* No farther than this is the k-th neighbour of a query, by the one before it. */
static double bound_by_last(const struct search *search, const struct run *run, size_t q) {
    if (q == run->begin) return INFINITY;
    double last = sqrt(search->distance_sq[q * search->k - 1]);
    double reach = last + sqrt(vec3_distance_sq(search->queries[q], search->queries[q - 1]));
    return reach * reach * ROUNDING;
}

static enum status ask_alone(const struct search *search, struct run *run, size_t q) {
    uint32_t *id = &search->id[q * search->k];
    double *distance_sq = &search->distance_sq[q * search->k], bound_sq = INFINITY;
    unsigned found = 0, k = search->k, visits = KNN_VISITS * (1 + k / FEW);
    vec3 query = search->queries[q];
    enum status status = STATUS_OK;
    if (run->far_alone) {
        run->far_alone--, visits = 0;
        bound_sq = bound_by_last(search, run, q);
    } else {
        status = knn_pieces_nearest(search->knn->pieces, query, k, search->slack, id, distance_sq, &found, &visits);
        if (!visits) run->far_alone = FAR_ALONE;
        if (found == k) bound_sq = distance_sq[k - 1];
    }
    if (!status && !visits)
        found = knn_boxes_nearest(search->knn->boxes, query, k, search->slack, bound_sq, id, distance_sq);
    for (unsigned i = found; !status && i < search->k; i++) id[i] = UINT32_MAX, distance_sq[i] = INFINITY;
    return status;
}

static enum status gather(const struct search *search, struct run *run, size_t q, size_t n, double room,
                          struct knn_group *group, bool *gathered) {
    unsigned most = search->k < FEW ? FEW_MOST : KNN_GROUP_POINTS;
    return knn_group_gather(group, &run->from, &search->queries[q], n, room, most, gathered);
}

static bool is_answered(const struct search *search, const struct knn_group *group, size_t q, double usual) {
    return knn_group_nearest(group, search->queries[q], search->k, usual, &search->id[q * search->k],
                             &search->distance_sq[q * search->k]);
}

/* Answers the n queries from q on. */
static enum status ask_group(const struct search *search, struct run *run, size_t q, size_t n) {
    struct knn_group group;
    double room = GROUP_ROOM * run->usual;
    enum status status = STATUS_OK;
    bool gathered = run->gathered && knn_group_narrow(&run->wide, &search->queries[q], n, room, &group);
    if (!gathered && (n >= FEWEST || run->width < 1)) {
        status = gather(search, run, q, n, room, &group, &gathered);
        if (!gathered) run->width = fmax(run->width / 2, NARROWEST);
    }
    if (gathered && group.count < UNCROWDED) run->width = fmin(2 * run->width, 1);
    for (size_t end = q + n; q < end && !status; q++) {
        if (gathered && is_answered(search, &group, q, run->usual)) continue;
        if (run->gathered && is_answered(search, &run->wide, q, run->usual)) continue;
        status = ask_alone(search, run, q);
    }
    run->usual = sqrt(search->distance_sq[q * search->k - 1]);
    return status;
}

static enum status ask_run(const struct search *search, struct run *run, size_t q) {
    enum status status = STATUS_OK;
    run->gathered = false;
    if (run->end - q >= FEWEST && !(run->width < 1))
        status = gather(search, run, q, run->end - q, RUN_ROOM * run->usual, &run->wide, &run->gathered);
    for (size_t n; q < run->end && !status; q += n) {
        n = length_of(search, run, q, GROUP, GROUP_WIDTH * run->width);
        status = ask_group(search, run, q, n);
    }
    return status;
}

static void search_range(void *ctx, size_t begin, size_t end) {
    struct search *search = ctx;
    enum status status = STATUS_OK;
    struct run run; /* what was gathered isn't worth clearing */
    run.begin = begin, run.far_alone = 0, run.usual = 0, run.width = 1;
    run.from = (struct knn_group_from){search->knn->boxes, search->knn->pieces, search->knn->point, 0};
    for (size_t q = begin; q < end && !status; q = run.end) {
        run.end = end;
        run.end = q + length_of(search, &run, q, RUN, RUN_WIDTH);
        status = ask_run(search, &run, q);
    }
    if (status) atomic_store(&search->failed, true);
}

enum status knn_search_nearly(const struct knn *knn, const struct knn_slack *slack, const vec3 *queries, size_t m,
                              unsigned k, unsigned threads, uint32_t *id, double *distance_sq) {
    assert(k >= 1 && k <= KNN_MAX_K);
    struct search search = {
        .knn = knn, .queries = queries, .k = k, .slack = slack, .id = id, .distance_sq = distance_sq};
    size_t batch = m / BATCHES;
    batch = batch < LEAST_BATCH ? LEAST_BATCH : batch > BATCH ? BATCH : batch;
    par_for(threads, m, batch, search_range, &search);
    return atomic_load(&search.failed) ? STATUS_NO_MEMORY : STATUS_OK;
}

enum status knn_search(const struct knn *knn, const vec3 *queries, size_t m, unsigned k, unsigned threads, uint32_t *id,
                       double *distance_sq) {
    return knn_search_nearly(knn, NULL, queries, m, k, threads, id, distance_sq);
}

void knn_free(struct knn *knn) {
    if (!knn) return;
    knn_pieces_free(knn->pieces);
    knn_boxes_free(knn->boxes);
    free(knn);
}
