/* Whether a cloud, and a job on it, fits the limits: points, and memory, as far as the first bytes tell.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_STORAGE_ADMISSION_H
#define WHITTLE_SERVER_STORAGE_ADMISSION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api/problem.h"
#include "core/params.h"

struct admission {
    uint64_t max_points, max_memory_bytes;
    bool has_params; /* false: the job isn't known, or not yet, and points alone are limited */
    struct params params;
};

/* What was found: memory_bytes is what the job is predicted to take, or a task of it, 0 = nothing can be said. */
struct admitted {
    uint64_t memory_bytes;
    bool in_tiles; /* it doesn't fit in one piece, and tiles can do what is asked for */
};

/* Judges by the first n bytes of a cloud of total_bytes (UINT64_MAX = not known); what is compressed is looked into.
 * false: *problem says too-many-points, would-exceed-memory, or invalid-parameter where a parameter names what the
 * header of a PLY hasn't.  Where nothing can be said it is true, for whether the bytes are a cloud is for others to
 * say.  O(n). */
bool admission_check(const struct admission *admission, const void *first_bytes, size_t n, uint64_t total_bytes,
                     struct admitted *admitted, struct problem *problem);

/* What the job may take at most, where it has more tetrahedra than were predicted: core/pipeline/memory.h, within the
 * limit; 0 = not known. */
uint64_t admission_most(const struct admission *admission, const void *first_bytes, size_t n, uint64_t total_bytes);

/* What would fit, for a job that ran out of memory although it was admitted: a part to keep or a number of points whose
 * prediction is a quarter below the limit, and below this job's.  Always writes a text. */
void admission_advise(const struct admission *admission, const void *first_bytes, size_t n, uint64_t total_bytes,
                      char *advice, size_t bytes);

#endif
