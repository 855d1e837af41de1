/* Samples of a few triangles, gathered so that their distances to other triangles can be measured eight at a time.
 *
 * Coordinates are relative to an origin amid the samples, which makes float exact enough: distances are good to 1e-7 of
 * the cluster's extent.  A sum over a cluster is added up in a fixed order, the same on all processors.
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

enum { CLUSTER_MOST = 512, CLUSTER_ROOM = CLUSTER_MOST + 2 * SAMPLE_BLOCK };

struct cluster {
    vec3 origin;
    size_t n; /* samples, at most CLUSTER_MOST; those behind have no weight and are far away */
    _Alignas(32) float x[CLUSTER_ROOM], y[CLUSTER_ROOM], z[CLUSTER_ROOM], weight[CLUSTER_ROOM];
    uint32_t sample[CLUSTER_ROOM];
};

static inline void cluster_clear(struct cluster *cluster, vec3 origin) {
    cluster->origin = origin;
    cluster->n = 0;
}

/* Adds a list of samples, from the block `first` to its end or until the cluster is full; the first block that isn't
 * in, or NONE. */
uint32_t cluster_add(struct cluster *cluster, const struct sample_block *block, uint32_t first);

/* The sum of the weights. */
double cluster_weight(const struct cluster *cluster);

/* The sum over the samples of weight * (d + d^2 * further), d being the distance to the surface; or a part of it that
 * is over limit already. */
double cluster_cost(const struct cluster *cluster, const struct surface *surface, float further, double limit);

/* The same for a star, whose places are relative to the cluster's origin. */
double cluster_star_cost(const struct cluster *cluster, const struct star_frames *star, float further, double limit);

/* The squared distance of each sample to the star. */
void cluster_star_distances(const struct cluster *cluster, const struct star_frames *star,
                            float distance_sq[CLUSTER_ROOM]);

/* A quadric of a vertex: s^T a s - 2 g s is what the squares of its samples' distances change by when it moves by s. */
struct cluster_model {
    sym3 a;
    vec3 g;
};

/* Adds the cluster's samples to the model of a star's vertex; those of triangle k are begin[k] .. begin[k + 1] - 1.
 * Each square is divided by the distance itself (at least near), so that the model is one of weight * (d + d^2 *
 * further). */
void cluster_fit(const struct cluster *cluster, const size_t *begin, const struct star_frames *star, float near,
                 float further, struct cluster_model *model);

/* s^T a s for each sample, s being where it is as seen from place; INFINITY for those whose ids aren't below points. */
void cluster_values(const struct cluster *cluster, const sym3 *a, vec3 place, size_t points, float value[CLUSTER_ROOM]);

/* For each sample which triangle of the surface is nearest, the first of equals, and its squared distance. */
void cluster_owners(const struct cluster *cluster, const struct surface *surface, uint8_t owner[CLUSTER_ROOM],
                    float distance_sq[CLUSTER_ROOM]);

/* Of place[0 .. n) to the nearest sample: updates nearest_sq and nearest (an index into the cluster's samples' ids)
 * where a sample of this cluster is nearer. */
void cluster_nearest(const struct cluster *cluster, vec3 place, double *nearest_sq, uint32_t *nearest);

#endif
