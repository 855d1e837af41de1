/* The points on a sphere around the place, each of which is compared with those beside it there.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/hidden.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/spatial/knn.h"

enum { POINTS = 16384, ASKED = 2048, BESIDE = 10 /* the point itself and others */, NEARER = 3 /* of these hide it */ };
static const double STEEP = 6; /* more slope than surfaces that are seen have */

struct rays {
    size_t n;
    vec3 *way;     /* unit vectors, along the points' order */
    double *range; /* logarithms: what they differ by is in units of the way's angle */
};

static void cast(const vec3 *point, size_t n, vec3 place, struct rays *rays) {
    size_t each = (n + POINTS - 1) / POINTS;
    rays->n = 0;
    for (size_t i = 0; i < n; i += each) {
        vec3 to = vec3_sub(point[i], place);
        double range = vec3_length(to);
        if (!(range > 0)) continue;
        rays->way[rays->n] = vec3_scale(to, 1 / range);
        rays->range[rays->n++] = log(range);
    }
}

static bool is_hidden(const struct rays *rays, size_t i, const uint32_t *beside, const double *distance_sq) {
    double behind = STEEP * sqrt(distance_sq[BESIDE - 1]);
    int nearer = 0;
    for (int k = 0; k < BESIDE; k++) nearer += rays->range[i] - rays->range[beside[k]] > behind;
    return nearer >= NEARER;
}

static enum status count_hidden(const struct rays *rays, unsigned threads, double *share) {
    struct knn *knn = NULL;
    size_t asked = rays->n < ASKED ? rays->n : ASKED, hidden = 0;
    vec3 *way = alloc_array(asked, sizeof *way);
    uint32_t *beside = alloc_array(asked * BESIDE, sizeof *beside);
    double *distance_sq = alloc_array(asked * BESIDE, sizeof *distance_sq);
    enum status status = way && beside && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < asked; i++) way[i] = rays->way[i * rays->n / asked];
    if (!status) status = knn_new(rays->way, rays->n, threads, &knn, NULL);
    if (!status) status = knn_search(knn, way, asked, BESIDE, threads, beside, distance_sq);
    for (size_t i = 0; !status && i < asked; i++)
        hidden += is_hidden(rays, i * rays->n / asked, &beside[i * BESIDE], &distance_sq[i * BESIDE]);
    if (!status) *share = (double)hidden / (double)asked;
    knn_free(knn);
    free(way), free(beside), free(distance_sq);
    return status;
}

enum status hidden_share(const vec3 *point, size_t n, vec3 place, unsigned threads, double *share) {
    size_t most = n < POINTS ? n : POINTS;
    struct rays rays = {.way = alloc_array(most, sizeof *rays.way), .range = alloc_array(most, sizeof *rays.range)};
    enum status status = rays.way && rays.range ? STATUS_OK : STATUS_NO_MEMORY;
    *share = 0;
    if (!status) cast(point, n, place, &rays);
    if (!status && rays.n >= BESIDE) status = count_hidden(&rays, threads, share);
    free(rays.way), free(rays.range);
    return status;
}
