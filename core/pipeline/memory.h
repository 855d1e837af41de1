/* How much memory a job will take, before it runs.
 *
 * The prediction is a bound that jobs don't exceed and usually come near: for whoever has to decide whether a job fits.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PIPELINE_MEMORY_H
#define WHITTLE_CORE_PIPELINE_MEMORY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/alloc.h"
#include "core/base/status.h"
#include "core/params.h"

/* Whether what a stage frees stays with the process, which saves a tenth of the time: a mesh of so few points. */
static inline bool memory_is_kept(uint64_t points, const struct params *params) {
    return points <= ALLOC_SMALL_POINTS && params_want_mesh(params);
}

/* What is known of an input before it is read. */
struct memory_job {
    uint64_t points;
    uint64_t record_bytes; /* of one point in memory: the scalars of all its properties, coordinates among them */
    uint64_t faces;        /* triangles that come with the cloud */
    uint64_t input_bytes;  /* of the file, which is mapped while it is read */
    uint64_t faces_most;   /* that may come, by the bytes that there are for corners; less than faces = the same */
};

/* Predicted peak of the process (VmHWM), in bytes, for params (resolved); saturates at UINT64_MAX.  Clouds that turn
 * out noisy take more, which is counted in.  With max_deviation or max_error as the goal nobody knows how many points
 * stay: all of them are counted, and a mesh is predicted to take ten times what it will.  O(1). */
uint64_t memory_predict(const struct memory_job *job, const struct params *params);

/* The same for as many triangles as may come, and as many tetrahedra as a run may have at all (MEMORY_MOST_TETRAHEDRA):
 * a mesh of points along lines takes up to this.  So does a mesh of given faces of which no vertex can go. */
uint64_t memory_predict_most(const struct memory_job *job, const struct params *params);

/* Tetrahedra for each point that is triangulated, beyond which there is no mesh, however much memory there is: surfaces
 * and volumes have 5 to 8, cones 20, scan lines a hundred times as dense along them as across 100 and more, ever more
 * the longer they are; points along a few curves have as many as points squared. */
enum { MEMORY_MOST_TETRAHEDRA = 150 };

/* The most triangles of an input that params->memory_bytes have room for, whatever else there is; 0 = any number. */
uint64_t memory_triangles(const struct params *params);

/* Whether it is the triangles of this input, known as it is by now, that params->memory_bytes have no room for. */
bool memory_lacks_for_faces(const struct memory_job *job, const struct params *params);

/* The most tetrahedra that a run may have between the kept of its points, or all of them (of_all): what
 * params->memory_bytes leave room for.  With what memory_predict says, that is 24 and more for each where a tenth is
 * kept, 10.5 where all are, and some for small clouds. */
uint64_t memory_tetrahedra(const struct memory_job *job, uint64_t kept, bool of_all, const struct params *params);

/* The same between the points of a closed surface, all of them or fewer, of which its mesh may be made: no more than
 * such points have. */
uint64_t memory_surface_tetrahedra(const struct memory_job *job, uint64_t kept, const struct params *params);

/* How many points of a surface may be triangulated in what memory_predict counts for the kept ones. */
size_t memory_usual_points(size_t points, size_t kept);

/* Fills *job from the first n bytes (as many as are at hand) of a file of total_bytes: by the header where there is one
 * (PLY, PCD, LAS, binary STL), by the length of the first lines where it is text.  STATUS_UNSUPPORTED for anything
 * else, compressed data too, STATUS_MALFORMED where a header is broken, not whole, or promises (PLY, PCD) more than the
 * file has bytes for; *job is untouched then.  O(n). */
enum status memory_job_of(const void *first_bytes, size_t n, uint64_t total_bytes, struct memory_job *job) MUST_CHECK;

#endif
