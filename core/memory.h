/* How much memory a job will take, before it runs.
 *
 * The prediction is a bound that jobs don't exceed and usually come near: for whoever has to decide whether a job fits.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MEMORY_H
#define WHITTLE_CORE_MEMORY_H

#include <stddef.h>
#include <stdint.h>

#include "core/params.h"
#include "core/status.h"

/* Whether what a stage frees stays with the process, which saves a tenth of the time: a mesh of so few points. */
enum { MEMORY_SMALL_JOB = 1 << 16 };
static inline bool memory_is_kept(uint64_t points, const struct params *params) {
    return points <= MEMORY_SMALL_JOB && params_want_mesh(params);
}

/* What is known of an input before it is read. */
struct memory_job {
    uint64_t points;
    uint64_t record_bytes; /* of one point in memory: the scalars of all its properties, coordinates among them */
    uint64_t faces;        /* triangles that come with the cloud */
    uint64_t input_bytes;  /* of the file, which is mapped while it is read */
};

/* Predicted peak of the process (VmHWM), in bytes, for params (resolved); saturates at UINT64_MAX.  Clouds that turn
 * out noisy take more, which is counted in.  With max_error alone as the goal nobody knows how many points stay: all of
 * them are counted, and a mesh is predicted to take ten times what it will.  O(1). */
uint64_t memory_predict(const struct memory_job *job, const struct params *params);

/* Fills *job from the first n bytes (as many as are at hand) of a file of total_bytes: by the header where there is one
 * (PLY, PCD, LAS, binary STL), by the length of the first lines where it is text.  STATUS_UNSUPPORTED for anything
 * else, compressed data too, STATUS_MALFORMED where a header is broken or not whole; *job is untouched then.  O(n). */
enum status memory_job_of(const void *first_bytes, size_t n, uint64_t total_bytes, struct memory_job *job) MUST_CHECK;

#endif
