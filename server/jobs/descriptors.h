/* File descriptors: how many connections fit below the limit of open files, RLIMIT_NOFILE.
 *
 * At that limit nothing can be accepted, read or written any more, so connections leave a reserve to everything else:
 * each is counted with what it may take at most, a socket and, of an upload, the file and who hashes it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_DESCRIPTORS_H
#define WHITTLE_SERVER_JOBS_DESCRIPTORS_H

#include "server/jobs/config.h"

enum { DESCRIPTORS_PER_CONNECTION = 3 };

/* Raises the limit as far as we may. */
void descriptors_raise_limit(void);

/* The limit; INT64_MAX = none. */
int64_t descriptors_limit(void);

/* How many are kept for all that isn't a connection of the main listener. */
int64_t descriptors_reserve(const struct config *config);

/* How many connections fit beside the reserve; 0 = none. */
int64_t descriptors_connections(const struct config *config);

#endif
