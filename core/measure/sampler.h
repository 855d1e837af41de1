/* Points on a surface, as many as are wanted and where they do the most good: what errors are measured at.
 *
 * A sampler is a list of elements (points, edges or triangles), each with a number of samples, and can say where the
 * i-th sample of all lies.  So samples need no memory, any range of them can be made by any thread, and where a sample
 * lies depends on the mesh, the number of samples and the seed alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MEASURE_SAMPLER_H
#define WHITTLE_CORE_MEASURE_SAMPLER_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/mesh/mesh.h"

enum sampler_kind { SAMPLER_POINTS, SAMPLER_UNIFORM, SAMPLER_EDGES, SAMPLER_FACES };

struct sampler {
    enum sampler_kind kind;
    size_t count; /* of samples */
    size_t element_count;
    const vec3 *position;    /* of the points or the mesh's vertices; borrowed */
    uint32_t (*triangle)[3]; /* uniform and faces; borrowed */
    uint32_t (*edge)[2];     /* edges; owned */
    uint32_t *vertex;        /* points: which ones; NULL = all; owned */
    size_t *first;           /* element_count + 1: each element's first sample; NULL = one each; owned */
    uint64_t seed;
};

/* Each of n points once.  Borrows them; can't fail. */
struct sampler sampler_points(const vec3 *point, size_t n);

/* count samples, uniform by area and stratified: a triangle has its share of them rounded up or down, spread evenly
 * over it by an additive sequence from a start of its own.  A mesh whose whole area is 0 gets the same number on each
 * triangle, and one without triangles none.  Borrows the mesh.  O(triangles).  STATUS_NO_MEMORY. */
enum status sampler_uniform(const struct mesh *mesh, size_t count, uint64_t seed, struct sampler *sampler) MUST_CHECK;

/* As the program Metro samples by default: sampler[0] has every vertex that a triangle uses, sampler[1] points inside
 * the edges, sampler[2] inside the triangles in rows similar to them; together at most about count (never less than the
 * vertices).  They have nothing random.  Borrows the mesh.  O(triangles log triangles).  STATUS_NO_MEMORY.
 *
 * Source: Cignoni, Rocchini, Scopigno: Metro: measuring error on simplified surfaces (1998), section 3. */
enum status sampler_metro(const struct mesh *mesh, size_t count, struct sampler sampler[3]) MUST_CHECK;

/* Writes samples begin .. end - 1 to out[0 ..]. */
void sampler_fill(const struct sampler *sampler, size_t begin, size_t end, vec3 *out);

/* The element (point, edge or triangle) that sample i < count is of.  O(log elements). */
size_t sampler_element(const struct sampler *sampler, size_t i);

/* Frees what the sampler owns and zeroes it.  Accepts a zeroed one. */
void sampler_done(struct sampler *sampler);

#endif
