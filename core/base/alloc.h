/* Allocation of arrays: overflow-checked, and through one seam, so that a test can make the n-th allocation fail.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_ALLOC_H
#define WHITTLE_CORE_BASE_ALLOC_H

#include <stdbool.h>
#include <stddef.h>

/* Returns new memory for n elements of size bytes, uninitialised, to be given to free(); NULL when n * size overflows
 * or memory runs out.  n == 0 returns a valid pointer.  Arrays of pages begin with a cache line, so that elements of a
 * whole number of lines, or a whole part of one, lie in no more of them than they must; those of ALLOC_HUGE_BYTES and
 * more are of huge pages where the kernel has some for whoever asks. */
enum { ALLOC_HUGE_BYTES = 4 << 20 };
void *alloc_array(size_t n, size_t size) __attribute__((warn_unused_result));

/* What has been freed goes back to the system as far as it can, unless it is kept (below).  Worth its time above
 * ALLOC_SMALL_POINTS points. */
enum { ALLOC_SMALL_POINTS = 1 << 19 };
void alloc_give_back(void);

/* Whether large arrays that are freed stay with the process for those that come next, which costs less than fresh
 * memory and a fifth more at the peak; false, as it is to begin with, gives back what has stayed.  While no other
 * thread allocates. */
void alloc_keep_freed(bool keep);

/* The same as alloc_array, zeroed. */
void *alloc_zeroed(size_t n, size_t size) __attribute__((warn_unused_result));

/* Changes an array's length to n elements, keeping what fits, as realloc does: returns new memory and takes the old,
 * or returns NULL and leaves the old as it was. */
void *alloc_resize(void *old, size_t n, size_t size) __attribute__((warn_unused_result));

/* For tests alone: alloc_fail(ctx) is asked before each allocation, and true makes it fail.  NULL (the default) asks
 * nobody.  Set it while no other thread allocates. */
extern bool (*alloc_fail)(void *ctx);
extern void *alloc_fail_ctx;

#endif
