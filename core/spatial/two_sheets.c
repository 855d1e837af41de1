/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/two_sheets.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "core/base/par.h"
#include "core/spatial/heights.h"

enum { PLACES = 256, GRAIN = 16 };
static const double TWO_HEIGHTS = 1.5; /* kurtosis, at most */
static const double ALTERNATE = 0.6;   /* nugget, at least: steps have hardly any */
/* Of how far the neighbours reach: heights off their plane at least.  Two flights over a town are nearer to each other,
 * and what few neighbours tell of is neighbourhood_noisy's. */
static const double APART = 0.125;

struct looks {
    const struct knn *knn;
    const vec3 *point;
    size_t step; /* between the points that are looked at */
    bool two[PLACES];
    enum status status[PLACES];
};

static void look_range(void *ctx, size_t begin, size_t end) {
    struct looks *looks = ctx;
    for (size_t i = begin; i < end; i++) {
        uint32_t id[HEIGHTS_K];
        double distance_sq[HEIGHTS_K];
        looks->status[i] = knn_search(looks->knn, &looks->point[i * looks->step], 1, HEIGHTS_K, 1, id, distance_sq);
        if (looks->status[i]) continue;
        double least = APART * sqrt(distance_sq[HEIGHTS_K - 1]);
        looks->two[i] = heights_rms(looks->point, id, HEIGHTS_K) > least &&
                        heights_kurtosis(looks->point, id, HEIGHTS_K) < TWO_HEIGHTS &&
                        heights_nugget(looks->point, id, HEIGHTS_K) > ALTERNATE;
    }
}

enum status two_sheets_share(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *share) {
    struct looks looks = {.knn = knn, .point = point, .step = n / PLACES};
    size_t count = 0;
    *share = 0;
    if (n < PLACES) return STATUS_OK;
    par_for(threads, PLACES, GRAIN, look_range, &looks);
    for (size_t i = 0; i < PLACES; i++) {
        if (looks.status[i]) return looks.status[i];
        count += looks.two[i];
    }
    *share = (double)count / PLACES;
    return STATUS_OK;
}
