/* Faults for tests: calls of the operating system that fail, or the process that ends, at a named point.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_FAULT_H
#define WHITTLE_CORE_BASE_FAULT_H

#include <stdbool.h>

/* Stands before a call that may fail, as in `fault_at("sync") || fsync(fd) != 0`, or alone, where something has just
 * been done.  true, and errno set: the call is to be taken as failed. */
bool fault_at(const char *point);

/* For tests alone: fault_point(point) returns the errno of the failure, 0 for none.  NULL (the default) asks nobody.
 * Set it while no other thread runs; it is called from all of them. */
extern int (*fault_point)(const char *point);

#endif
