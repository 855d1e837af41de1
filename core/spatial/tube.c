/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/tube.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/sym3.h"

double tube_unevenness(const vec3 *point, const uint32_t *id, unsigned k) {
    vec3 sum = {0, 0, 0}, axis[3];
    sym3 moment = {0};
    double value[3], distances = 0, squares = 0;
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(point[id[i]], point[id[0]]);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    vec3 mean = vec3_scale(sum, 1.0 / k);
    sym3_eigen(sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / k)), value, axis);
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(vec3_sub(point[id[i]], point[id[0]]), mean);
        double along = vec3_dot(e, axis[2]), square = fmax(vec3_length_sq(e) - along * along, 0);
        distances += sqrt(square), squares += square;
    }
    return distances > 0 ? sqrt(fmax(squares * k / (distances * distances) - 1, 0)) : INFINITY;
}

enum status tube_share(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *share) {
    enum { PLACES = 1024, K = 64 };
    size_t m = n < PLACES ? n : PLACES, count = 0;
    *share = 0;
    if (n < K) return STATUS_OK;
    vec3 *place = alloc_array(m, sizeof *place);
    uint32_t *id = alloc_array(m * K, sizeof *id);
    double *distance_sq = alloc_array(m * K, sizeof *distance_sq);
    enum status status = place && id && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < m; i++) place[i] = point[i * n / m];
    if (!status) status = knn_search(knn, place, m, K, threads, id, distance_sq);
    for (size_t i = 0; !status && i < m; i++)
        count += tube_unevenness(point, &id[i * K], K) < TUBE_UNEVENNESS_MOST ||
                 tube_unevenness(point, &id[i * K], K / 2) < TUBE_UNEVENNESS_MOST;
    if (!status) *share = (double)count / (double)m;
    free(place), free(id), free(distance_sq);
    return status;
}
