/* FLANN behind four functions.
 *
 * What to know of FLANN 1.9 (Muja, Lowe): KDTREE_SINGLE with unlimited checks and eps 0 is exact; radius searches take
 * their radius as a squared float even in the double interface, so only k-nearest queries are used and radii are cut
 * elsewhere in double; each call copies its parameters into library globals, so every call gets its own struct with
 * random_seed 0, which leaves the generator alone; `cores` needs a build with OpenMP, so batches are split here.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/knn.h"

#include <assert.h>
#include <flann/flann.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdlib.h>

#include "core/alloc.h"
#include "core/par.h"

enum { LEAF_POINTS = 12, BATCH = 2048 };

struct knn {
    flann_index_t index;
    size_t n;
};

static struct FLANNParameters exact_search(void) {
    struct FLANNParameters parameters = DEFAULT_FLANN_PARAMETERS;
    parameters.algorithm = FLANN_INDEX_KDTREE_SINGLE;
    parameters.leaf_max_size = LEAF_POINTS;
    parameters.checks = -1;
    parameters.eps = 0;
    parameters.sorted = 1;
    parameters.cores = 1;
    parameters.random_seed = 0;
    parameters.log_level = FLANN_LOG_NONE;
    return parameters;
}

enum status knn_new(const vec3 *points, size_t n, struct knn **out, struct error *error) {
    static_assert(sizeof(vec3) == 3 * sizeof(double), "a row of FLANN's matrix");
    assert(n > 0);
    if (n > INT_MAX) return error_set(error, STATUS_LIMIT, "knn", "%zu points are more than FLANN counts", n);
    struct knn *knn = alloc_zeroed(1, sizeof *knn);
    if (!knn) return error_set(error, STATUS_NO_MEMORY, "knn", "no memory for the index");
    struct FLANNParameters parameters = exact_search();
    float speedup = 0;
    knn->n = n;
    knn->index = flann_build_index_double((double *)(uintptr_t)points, (int)n, 3, &speedup, &parameters);
    if (!knn->index) {
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

/* Of m results in rows of `found`, widened to rows of k from the last to the first. */
static void widen_rows(const struct search *search, size_t begin, size_t m, unsigned found) {
    for (size_t q = m; q-- > 0;)
        for (unsigned i = search->k; i-- > 0;) {
            size_t to = (begin + q) * search->k + i, from = begin * search->k + q * found + i;
            search->id[to] = i < found ? search->id[from] : UINT32_MAX;
            search->distance_sq[to] = i < found ? search->distance_sq[from] : INFINITY;
        }
}

static void search_range(void *ctx, size_t begin, size_t end) {
    struct search *search = ctx;
    unsigned found = search->knn->n < search->k ? (unsigned)search->knn->n : search->k;
    struct FLANNParameters parameters = exact_search();
    double *queries = (double *)(uintptr_t)&search->queries[begin];
    int rc = flann_find_nearest_neighbors_index_double(
        search->knn->index, queries, (int)(end - begin), (int *)&search->id[begin * search->k],
        &search->distance_sq[begin * search->k], (int)found, &parameters);
    if (rc != 0) atomic_store(&search->failed, true);
    if (found < search->k) widen_rows(search, begin, end - begin, found);
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
    struct FLANNParameters parameters = exact_search();
    flann_free_index_double(knn->index, &parameters);
    free(knn);
}
