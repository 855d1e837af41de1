/* The memory that this process has had at most.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_PROCESS_MEMORY_H
#define WHITTLE_CORE_BASE_PROCESS_MEMORY_H

#include <stdint.h>

/* The most bytes of its own that a process has had in memory at once, or this one: pid 0.  0: it isn't known, for
 * instance of a process that has ended.
 *
 * Not what getrusage and wait4 say: their figure goes on from what the process had before its program was loaded, which
 * is what its parent had when it forked (Linux, fs/exec.c), so whatever a large parent starts seems as large. */
uint64_t process_peak_bytes(int pid);

#endif
