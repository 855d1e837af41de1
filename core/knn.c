/* Queries along the curve in groups (knn_group.c), the others one by one (knn_pieces.c).
 *
 * How far the k-th neighbour of the last query was tells how wide the next group may be.  A group of few isn't worth
 * gathering for; so queries in no order cost what they would without groups.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/knn.h"

#include <assert.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdlib.h>

#include "core/alloc.h"
#include "core/knn_group.h"
#include "core/knn_pieces.h"
#include "core/par.h"

enum { BATCH = 2048, FEWEST = 2 };
static const double WIDTH = 2; /* of a group, in distances to the k-th neighbour */

struct knn {
    const vec3 *point;
    size_t n;
    struct knn_pieces *pieces;
};

enum status knn_new(const vec3 *points, size_t n, unsigned threads, struct knn **out, struct error *error) {
    assert(n > 0);
    if (n > INT_MAX) return error_set(error, STATUS_LIMIT, "knn", "%zu points are more than FLANN counts", n);
    struct knn *knn = alloc_zeroed(1, sizeof *knn);
    if (!knn) return error_set(error, STATUS_NO_MEMORY, "knn", "no memory for the index");
    *knn = (struct knn){.point = points, .n = n};
    if (knn_pieces_new(points, n, threads, &knn->pieces)) {
        free(knn);
        return error_set(error, STATUS_NO_MEMORY, "knn", "FLANN could not build its index");
    }
    *out = knn;
    return STATUS_OK;
}

struct search {
    const struct knn *knn;
    const vec3 *queries;
    unsigned k;
    uint32_t *id;
    double *distance_sq;
    atomic_bool failed;
};

static enum status ask_alone(const struct search *search, size_t q) {
    uint32_t *id = &search->id[q * search->k];
    double *distance_sq = &search->distance_sq[q * search->k];
    unsigned found;
    enum status status =
        knn_pieces_nearest(search->knn->pieces, search->queries[q], search->k, id, distance_sq, &found);
    for (unsigned i = found; !status && i < search->k; i++) id[i] = UINT32_MAX, distance_sq[i] = INFINITY;
    return status;
}

/* Answers the n queries from q on, whose k-th neighbours are expected to be about `usual` away. */
static enum status ask_group(const struct search *search, size_t q, unsigned n, double usual) {
    const struct knn *knn = search->knn;
    struct knn_group group;
    bool gathered = false;
    enum status status = STATUS_OK;
    if (n >= FEWEST)
        status = knn_group_gather(&group, knn->pieces, knn->point, &search->queries[q], n, usual, &gathered);
    for (size_t end = q + n; q < end && !status; q++)
        if (!gathered || !knn_group_nearest(&group, search->queries[q], search->k, usual, &search->id[q * search->k],
                                            &search->distance_sq[q * search->k]))
            status = ask_alone(search, q);
    return status;
}

static void search_range(void *ctx, size_t begin, size_t end) {
    struct search *search = ctx;
    enum status status = STATUS_OK;
    double usual = 0;
    for (size_t q = begin; q < end && !status;) {
        unsigned n = knn_group_length(&search->queries[q], end - q, WIDTH * usual);
        status = ask_group(search, q, n, usual);
        q += n;
        usual = sqrt(search->distance_sq[q * search->k - 1]);
    }
    if (status) atomic_store(&search->failed, true);
}

enum status knn_search(const struct knn *knn, const vec3 *queries, size_t m, unsigned k, unsigned threads, uint32_t *id,
                       double *distance_sq) {
    assert(k >= 1 && k <= KNN_MAX_K);
    struct search search = {.knn = knn, .queries = queries, .k = k, .id = id, .distance_sq = distance_sq};
    par_for(threads, m, BATCH, search_range, &search);
    return atomic_load(&search.failed) ? STATUS_NO_MEMORY : STATUS_OK;
}

void knn_free(struct knn *knn) {
    if (!knn) return;
    knn_pieces_free(knn->pieces);
    free(knn);
}
