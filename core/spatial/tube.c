/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/tube.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"

/* How k points are spread. */
struct spread {
    vec3 mean; /* from the first of them */
    double value[3];
    vec3 axis[3]; /* along axis[2] the most, by value[2] (squared, summed) */
};

static struct spread spread_of(const vec3 *point, const uint32_t *id, unsigned k) {
    struct spread spread;
    vec3 sum = {0, 0, 0};
    sym3 moment = {0};
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(point[id[i]], point[id[0]]);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    spread.mean = vec3_scale(sum, 1.0 / k);
    sym3_eigen(sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / k)), spread.value, spread.axis);
    return spread;
}

double tube_unevenness(const vec3 *point, const uint32_t *id, unsigned k) {
    struct spread spread = spread_of(point, id, k);
    double distances = 0, squares = 0;
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(vec3_sub(point[id[i]], point[id[0]]), spread.mean);
        double along = vec3_dot(e, spread.axis[2]), square = fmax(vec3_length_sq(e) - along * along, 0);
        distances += sqrt(square), squares += square;
    }
    return distances > 0 ? sqrt(fmax(squares * k / (distances * distances) - 1, 0)) : INFINITY;
}

/* The middle of the circle that fits the points best across their line, along the first two axes from their mean: least
 * squares of the circle's equation, where x and y are uncorrelated. */
static void find_middle(const vec3 *point, const uint32_t *id, unsigned k, const struct spread *spread,
                        double middle[2]) {
    middle[0] = middle[1] = 0;
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(vec3_sub(point[id[i]], point[id[0]]), spread->mean);
        double x = vec3_dot(e, spread->axis[0]), y = vec3_dot(e, spread->axis[1]), square = x * x + y * y;
        middle[0] += x * square / (2 * spread->value[0]), middle[1] += y * square / (2 * spread->value[1]);
    }
}

double tube_squareness(const vec3 *point, const uint32_t *id, unsigned k) {
    struct spread spread = spread_of(point, id, k);
    double middle[2], distances = 0, along = 0, across = 0, cosines = 0, sines = 0;
    if (!(spread.value[0] > 0)) return 0;
    find_middle(point, id, k, &spread, middle);
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(vec3_sub(point[id[i]], point[id[0]]), spread.mean);
        double x = vec3_dot(e, spread.axis[0]) - middle[0], y = vec3_dot(e, spread.axis[1]) - middle[1];
        double square = x * x + y * y, distance = sqrt(square);
        double c = 1, s = 0; /* cosine and sine of four times the angle */
        if (square > 0) {
            double c2 = (x * x - y * y) / square, s2 = 2 * x * y / square;
            c = c2 * c2 - s2 * s2, s = 2 * c2 * s2;
        }
        distances += distance, along += distance * c, across += distance * s, cosines += c, sines += s;
    }
    if (!(distances > 0)) return 0;
    double usual = distances / k; /* what is off it counts */
    along -= usual * cosines, across -= usual * sines;
    return 2 * sqrt(along * along + across * across) / distances;
}

enum status tube_share(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *share,
                       bool *round) {
    enum { PLACES = 1024, K = 64 };
    static const double SQUARE = 0.06;
    size_t m = n < PLACES ? n : PLACES, count = 0;
    *share = 0, *round = false;
    if (n < K) return STATUS_OK;
    float *squareness = alloc_array(m, sizeof *squareness);
    vec3 *place = alloc_array(m, sizeof *place);
    uint32_t *id = alloc_array(m * K, sizeof *id);
    double *distance_sq = alloc_array(m * K, sizeof *distance_sq);
    enum status status = squareness && place && id && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < m; i++) place[i] = point[i * n / m];
    if (!status) status = knn_search(knn, place, m, K, threads, id, distance_sq);
    for (size_t i = 0; !status && i < m; i++) {
        bool by_all = tube_unevenness(point, &id[i * K], K) < TUBE_UNEVENNESS_MOST;
        if (!by_all && tube_unevenness(point, &id[i * K], K / 2) >= TUBE_UNEVENNESS_MOST) continue;
        squareness[count++] = (float)tube_squareness(point, &id[i * K], by_all ? K : K / 2);
    }
    if (!status) *share = (double)count / (double)m;
    if (!status && count > 0) *round = (double)quantile_of(squareness, count, 0.5) < SQUARE;
    free(squareness), free(place), free(id), free(distance_sq);
    return status;
}
