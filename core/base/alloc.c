/* The one place where the project's arrays come from.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/alloc.h"

#include <malloc.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>

bool (*alloc_fail)(void *ctx);
void *alloc_fail_ctx;

static bool refused(size_t n, size_t size) {
    if (size && n > SIZE_MAX / 2 / size) return true;
    return alloc_fail && alloc_fail(alloc_fail_ctx);
}

/* Small arrays don't begin with a cache line: the allocator is slower at that. */
enum { LINE_BYTES = 64, LEAST_ALIGNED = 4096, HUGE_PAGE = 1 << 21 };

/* Only pages that lie within the array, so that each of them goes with it. */
static void ask_for_huge_pages(void *array, size_t bytes) {
    size_t before = -(uintptr_t)array % HUGE_PAGE, whole = (bytes - before) / HUGE_PAGE * HUGE_PAGE;
    (void)madvise((char *)array + before, whole, MADV_HUGEPAGE);
}

void *alloc_array(size_t n, size_t size) {
    if (refused(n, size)) return NULL;
    size_t bytes = n * size;
    if (bytes < LEAST_ALIGNED) return malloc(bytes ? bytes : 1);
    void *array = aligned_alloc(LINE_BYTES, (bytes + LINE_BYTES - 1) / LINE_BYTES * LINE_BYTES);
    if (array && bytes >= ALLOC_HUGE_BYTES) ask_for_huge_pages(array, bytes);
    return array;
}

static bool keeps; /* as mallopt was told: the whole process's, which nothing can be asked for */

void alloc_give_back(void) {
    if (!keeps) malloc_trim(0);
}

void alloc_keep_freed(bool keep) {
    enum { MOST_MAPPED = 1 << 16, TRIMMED = 128 << 10 }; /* the C library's own */
    mallopt(M_MMAP_MAX, keep ? 0 : MOST_MAPPED);
    mallopt(M_TRIM_THRESHOLD, keep ? -1 : TRIMMED); /* -1: never by itself */
    keeps = keep;
    alloc_give_back();
}

void *alloc_zeroed(size_t n, size_t size) { return refused(n, size) ? NULL : calloc(n ? n : 1, size ? size : 1); }

void *alloc_resize(void *old, size_t n, size_t size) {
    return refused(n, size) ? NULL : realloc(old, n && size ? n * size : 1);
}
