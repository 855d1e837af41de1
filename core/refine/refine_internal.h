/* What the files of this room use of each other, beside fit.h: a section for each file.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_REFINE_INTERNAL_H
#define WHITTLE_CORE_REFINE_REFINE_INTERNAL_H

#include <stdint.h>

#include "core/math/vec3.h"
#include "core/refine/fit.h"

/* ------------------------------------------------------------------------------------------------ assign.c */

/* Which triangle each sample belongs to: found at the beginning, and anew where operations only hand samples on. */

/* triangle[i], distance_sq[i] = where sample i belongs, and how far off it is: the nearest triangle, or one downhill of
 * which there is none where that is near.  Both are for fit->samples.n.  Only fit->mesh, samples, half-edges and
 * threads are looked at; the lists are empty, and have room for all triangles.  STATUS_NO_MEMORY. */
enum status fit_assign(const struct fit *fit, uint32_t *triangle, float *distance_sq) MUST_CHECK;

/* Fills the lists, and sets the costs, by what fit_assign has found.  STATUS_NO_MEMORY. */
enum status fit_fill(struct fit *fit, const uint32_t *triangle, const float *distance_sq) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ unsampled.c */

/* What a flip is worth where there is no data. */

/* The area that a unit of the samples' weight stands for, on the mesh as it is.  O(triangles). */
double fit_unsampled_unit_area(const struct fit *fit, double total_weight);

/* What the flip of h gains beside the distances of the region's samples, in the same units; weight = the samples', made
 * = the two triangles that it makes.  0 where there are samples enough to decide. */
double fit_unsampled_gain(const struct fit *fit, const struct fit_region *region, double weight, uint32_t h,
                          const struct surface *made);

/* ------------------------------------------------------------------------------------------------ flip.c */

/* Edge flips that bring the mesh nearer to the points (Hoppe and others 1993: edge swaps). */

/* Flips edges whose triangles are touched, the most rewarding first, until no flip gains or `rounds` are over; the
 * triangles that are left touched are those of the last round.  *flips += their number.  STATUS_NO_MEMORY. */
enum status fit_flip(struct fit *fit, size_t rounds, size_t *flips) MUST_CHECK;

/* What a change must not do. */
enum fit_fairness {
    FIT_FAIR,      /* make triangles thin, fold or turn them, or lead them away from the data */
    FIT_TURNING,   /* the same, but triangles may turn as far as they like */
    FIT_REGARDLESS /* nothing: anything goes */
};

/* How much dearer the flip of h, which has a twin, makes the mesh; INFINITY where it isn't possible or fair. */
double fit_flip_cost(const struct fit *fit, uint32_t h, enum fit_fairness fairness);

/* Flips that edge, and hands out its samples. */
void fit_flip_one(struct fit *fit, uint32_t h);

/* ------------------------------------------------------------------------------------------------ move.c */

/* Moves of vertices that bring the mesh nearer to the points (Hoppe and others 1993: fitting for fixed triangles). */

/* Tries to move each unlocked vertex whose star is stale, once: to a better one of the original points (subset) or to
 * the best place (optimal).  *moves += the number of those that moved.  STATUS_NO_MEMORY. */
enum status fit_move(struct fit *fit, size_t *moves) MUST_CHECK;

/* How much dearer the mesh gets with the vertex, which isn't locked, at place; INFINITY where that isn't fair. */
double fit_move_cost(const struct fit *fit, uint32_t vertex, vec3 place, enum fit_fairness fairness);

/* Puts the vertex there, at a point or none (NONE), and hands out its samples. */
void fit_move_one(struct fit *fit, uint32_t vertex, vec3 place, uint32_t source);

/* ------------------------------------------------------------------------------------------------ uncross.c */

/* Triangles that pass through each other are parted. */

/* Flips edges, and where that is allowed moves vertices, of crossing triangles as long as there are fewer crossings;
 * *changes += their number.  What it doesn't get apart within its bounds stays.  About 2 us for each triangle, and some
 * 1 000 for each pair; O(triangles) at most.  One thread's work but for the search.  STATUS_NO_MEMORY. */
enum status fit_uncross(struct fit *fit, bool moves, size_t *changes) MUST_CHECK;

/* ---------------------------------------------------------------------- collapse.c, split.c and reallocate.c */

/* What a reallocation may consist of. */

/* A vertex that may go, and a half-edge of the edge to the neighbour that it merges into.  Or an edge that may be
 * split, and where. */
struct fit_candidate {
    double value; /* loss, or gain */
    uint32_t halfedge, vertex, source;
    vec3 place;
};

#define FIT_CANDIDATE_LEAST_TURN 0.2 /* smallest cosine between the normals of a triangle and what takes its place */

/* ------------------------------------------------------------------------------------------------ collapse.c */

/* What it costs to take a vertex out (Hoppe and others 1993: edge collapse). */

/* About what the vertex is worth where it stands, in no particular unit; INFINITY where it has to stay. */
double fit_collapse_estimate(const struct fit *fit, uint32_t vertex);

/* The collapse of the vertex, which must be able to go, into one of its nearest neighbours that costs least; halfedge
 * is NONE where none of them will do.  Whether the edge may be collapsed is left to be seen. */
struct fit_candidate fit_collapse_cheapest(const struct fit *fit, uint32_t vertex);

/* ------------------------------------------------------------------------------------------------ split.c */

/* What is gained by a vertex on an edge (Hoppe and others 1993: edge split). */

/* The split of the edge of h, which has a twin, that gains most; halfedge is NONE where none does. */
struct fit_candidate fit_split_best(const struct fit *fit, uint32_t h);

/* ------------------------------------------------------------------------------------------------ reallocate.c */

/* Vertices that are worth little where they are, taken out and put in where the mesh is farthest off. */

/* One pass: takes out the vertices whose loss costs least (each collapsed into a neighbour) and puts them on edges
 * where they gain most, pair by pair, as long as a pair gains.  The counts of vertices and triangles stay.
 * *reallocations += their number.  STATUS_NO_MEMORY. */
enum status fit_reallocate(struct fit *fit, size_t *reallocations) MUST_CHECK;

#endif
