/* The memory of small jobs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_HEAP_H
#define WHITTLE_SERVER_CLI_HEAP_H

#include <stddef.h>

/* Has the heap ready for a mesh of a cloud of so many points, which are few (memory_is_kept).  Whether it is changes
 * nothing but the time. */
void worker_heap_prepare(size_t points);

#endif
