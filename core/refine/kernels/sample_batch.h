/* Samples of a few triangles, gathered so that their distances to other triangles can be measured eight at a time.
 *
 * Coordinates are relative to an origin amid the samples, which makes float exact enough: distances are good to 1e-7 of
 * the batch's extent.  A sum over a batch is added up in a fixed order, the same on all processors.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_KERNELS_SAMPLE_BATCH_H
#define WHITTLE_CORE_REFINE_KERNELS_SAMPLE_BATCH_H

#include <stddef.h>
#include <stdint.h>

#include "core/math/sym3.h"
#include "core/refine/kernels/star_frames.h"
#include "core/refine/kernels/triangle_frames.h"
#include "core/refine/sample_buckets.h"

enum { CLUSTER_MOST = 512, SAMPLE_BATCH_ROOM = CLUSTER_MOST + 2 * SAMPLE_BLOCK };

struct sample_batch {
    vec3 origin;
    size_t n; /* samples, at most CLUSTER_MOST; those behind have no weight and are far away */
    _Alignas(32) float x[SAMPLE_BATCH_ROOM], y[SAMPLE_BATCH_ROOM], z[SAMPLE_BATCH_ROOM], weight[SAMPLE_BATCH_ROOM];
    uint32_t sample[SAMPLE_BATCH_ROOM];
};

static inline void sample_batch_clear(struct sample_batch *batch, vec3 origin) {
    batch->origin = origin;
    batch->n = 0;
}

/* Adds a list of samples, from the block `first` to its end or until the batch is full; the first block that isn't
 * in, or NONE. */
uint32_t sample_batch_add(struct sample_batch *batch, const struct sample_block *block, uint32_t first);

/* The sum of the weights. */
double sample_batch_weight(const struct sample_batch *batch);

/* The sum over the samples of weight * (d + d^2 * further), d being the distance to the surface; or a part of it that
 * is over limit already. */
double sample_batch_cost(const struct sample_batch *batch, const struct surface *surface, float further, double limit);

/* The same for a star, whose places are relative to the batch's origin. */
double sample_batch_star_cost(const struct sample_batch *batch, const struct star_frames *star, float further,
                              double limit);

/* The squared distance of each sample to the star. */
void sample_batch_star_distances(const struct sample_batch *batch, const struct star_frames *star,
                                 float distance_sq[SAMPLE_BATCH_ROOM]);

/* A quadric of a vertex: s^T a s - 2 g s is what the squares of its samples' distances change by when it moves by s. */
struct sample_batch_model {
    sym3 a;
    vec3 g;
};

/* Adds the batch's samples to the model of a star's vertex; those of triangle k are begin[k] .. begin[k + 1] - 1.
 * Each square is divided by the distance itself (at least near), so that the model is one of weight * (d + d^2 *
 * further). */
void sample_batch_fit(const struct sample_batch *batch, const size_t *begin, const struct star_frames *star, float near,
                      float further, struct sample_batch_model *model);

/* s^T a s for each sample, s being where it is as seen from place; INFINITY for those whose ids aren't below points. */
void sample_batch_values(const struct sample_batch *batch, const sym3 *a, vec3 place, size_t points,
                         float value[SAMPLE_BATCH_ROOM]);

/* For each sample which triangle of the surface is nearest, the first of equals, and its squared distance. */
void sample_batch_owners(const struct sample_batch *batch, const struct surface *surface,
                         uint8_t owner[SAMPLE_BATCH_ROOM], float distance_sq[SAMPLE_BATCH_ROOM]);

/* Of place[0 .. n) to the nearest sample: updates nearest_sq and nearest (the sample's id) where
 * a sample of this batch is nearer. */
void sample_batch_nearest(const struct sample_batch *batch, vec3 place, double *nearest_sq, uint32_t *nearest);

#endif
