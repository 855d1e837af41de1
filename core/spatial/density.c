/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/density.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"

enum { PLACES = 1024, LEAST = 64, AROUND = 16, K = 2 * AROUND + 1 /* the last one's area is the next */ };

enum status density_change(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *change) {
    size_t m = n < PLACES ? n : PLACES;
    *change = 0;
    if (n < LEAST) return STATUS_OK;
    float *each = alloc_array(m, sizeof *each);
    vec3 *place = alloc_array(m, sizeof *place);
    uint32_t *id = alloc_array(m * K, sizeof *id);
    double *area = alloc_array(m * K, sizeof *area), *next = alloc_array(m * K, sizeof *next);
    enum status status = each && place && id && area && next ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < m; i++) place[i] = point[i * n / m];
    if (!status) status = knn_search(knn, place, m, K, threads, id, area);
    for (size_t i = 0; !status && i < m; i++) place[i] = point[id[i * K + K - 1]];
    if (!status) status = knn_search(knn, place, m, K, threads, id, next);
    for (size_t i = 0; !status && i < m; i++) each[i] = (float)fabs(log(area[i * K + AROUND] / next[i * K + AROUND]));
    if (!status) *change = (double)quantile_of(each, m, 0.5);
    free(each), free(place), free(id), free(area), free(next);
    return status;
}
