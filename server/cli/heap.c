/* What stages take for a mesh of a small cloud and give back is some ten megabytes, again and again.  From the kernel,
 * page by page, that is a tenth of the time.  So the heap keeps what is freed, and where the points aren't few it
 * becomes large enough for all of it beforehand, of huge pages where the kernel has them.  Arrays of large
 * clouds have huge pages of their own, and memory that is given back counts.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/cli_internal.h"

#include <malloc.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>

enum { POINT_BYTES = 512, HUGE_BYTES = 1 << 21, FEW = HUGE_BYTES / POINT_BYTES /* not worth a huge page */ };

void command_heap_prepare(size_t points) {
    size_t bytes = points * POINT_BYTES + 2 * HUGE_BYTES;
    mallopt(M_MMAP_THRESHOLD, (int)bytes + HUGE_BYTES);
    mallopt(M_TRIM_THRESHOLD, (int)(2 * bytes));
    if (points < FEW) return;
    void *heap = malloc(bytes);
    if (!heap) return;
    uintptr_t begin = ((uintptr_t)heap + HUGE_BYTES - 1) / HUGE_BYTES * HUGE_BYTES;
    uintptr_t end = ((uintptr_t)heap + bytes) / HUGE_BYTES * HUGE_BYTES;
    if (begin < end) madvise((void *)begin, end - begin, MADV_HUGEPAGE);
    free(heap);
}
