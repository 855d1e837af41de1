/* Gopi's neighbourhood of every point: who is near enough to say something of the surface around it.
 *
 * Gopi, Krishnan: A fast and efficient projection-based approach for surface reconstruction (2002); Lee, Jong section
 * 4.1.  N_p = { q : |q - p| <= m s }, s the distance to the nearest neighbour.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_NEIGHBOURHOOD_H
#define WHITTLE_CORE_SPATIAL_NEIGHBOURHOOD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

struct neighbourhood_options {
    double radius;     /* m: multiple of the distance to the nearest neighbour */
    unsigned min, max; /* fewest and most neighbours; 3 <= min <= max < KNN_MAX_K */
    unsigned threads;
};

/* Neighbours of point p: id[p * stride + i], 0 <= i < count[p], nearest first, p itself not among them.  Not symmetric.
 */
struct neighbourhood {
    size_t n;
    unsigned stride;
    bool noisy;      /* the cloud as a whole: there are up to three times as many neighbours */
    bool walls;      /* most of the cloud is both sides of walls that are hardly thicker than points are apart */
    uint32_t *id;    /* n * stride; owned */
    uint8_t *count;  /* n; owned */
    float *spacing;  /* n: mean distance to the neighbours, a fraction of the diagonal; 0 for a lonely point; owned */
    float *reach_sq; /* n: squared distance within which p's neighbours were looked for; NULL = not kept; owned */
};

/* Finds the neighbourhoods of n distinct points in the normalised frame.  Where the nearest ones lie on a line, as in
 * scan lines, neighbours are taken from eight sectors around the point instead.  Where the cloud as a whole is noisy,
 * min and max count three times (up to KNN_MAX_K - 1).  O(n log n).  STATUS_NO_MEMORY. */
enum status neighbourhood_find(const struct knn *knn, const vec3 *point, size_t n,
                               const struct neighbourhood_options *options, struct neighbourhood *out) MUST_CHECK;

/* The same, and their reach, for neighbourhood_lose. */
enum status neighbourhood_find_reach(const struct knn *knn, const vec3 *point, size_t n,
                                     const struct neighbourhood_options *options, struct neighbourhood *out) MUST_CHECK;

/* The two halves of the first one, for who knows of more points than these whether their cloud is noisy; walls may be
 * NULL, and aren't told of by the second half. */
enum status neighbourhood_noisy(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, bool *noisy,
                                bool *walls) MUST_CHECK;
enum status neighbourhood_find_as(const struct knn *knn, const vec3 *point, size_t n,
                                  const struct neighbourhood_options *options, bool noisy,
                                  struct neighbourhood *out) MUST_CHECK;

/* Makes of neighbourhoods with their reach those of what is left of the points, m in the same order, without those that
 * lost[p] marks: as neighbourhood_find_as finds them there (knn and point: of those), whose options and noise are the
 * same.  Only who had a lost point within reach looks again.  O(n), and as much again for each lost point.
 * STATUS_NO_MEMORY, and then nothing is left in *neighbours. */
enum status neighbourhood_lose(const struct knn *knn, const vec3 *point, const struct neighbourhood_options *options,
                               const vec3 *before, const uint8_t *lost, struct neighbourhood *neighbours) MUST_CHECK;

/* What a bound on the number of neighbours becomes where the cloud is noisy. */
static inline unsigned neighbourhood_noisy_count(unsigned count) {
    enum { NOISY_TIMES = 3 };
    return count * NOISY_TIMES < KNN_MAX_K ? count * NOISY_TIMES : KNN_MAX_K - 1;
}

/* Accepts a zeroed neighbourhood. */
void neighbourhood_done(struct neighbourhood *neighbourhood);

#endif
