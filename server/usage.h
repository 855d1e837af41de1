/* What each principal has: jobs that have not ended, and bytes that are kept for it.
 *
 * The figures are rows of the database's table `usage`, which triggers keep in step with jobs, outputs and clouds
 * within the transactions that change these (queue_sqlite.c).  Here is their copy in memory, for those who must not
 * wait for the database: whoever has changed the rows of a principal has it refreshed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_USAGE_H
#define WHITTLE_SERVER_USAGE_H

#include <stdint.h>

#include "core/status.h"
#include "server/sql.h"

struct usage;

struct usage_figures {
    uint64_t active; /* jobs accepted or running */
    uint64_t bytes;  /* of the inputs and outputs of all its jobs, and of its clouds; what is shared counts for each */
};

/* Returns new, NULL when memory runs out; usage_free accepts NULL. */
struct usage *usage_new(void);
void usage_free(struct usage *usage);

/* Reads the row of one principal, or all rows (NULL), from a connection that the caller has locked. */
enum status usage_refresh(struct usage *usage, struct sql *sql, const char *principal, struct error *error) MUST_CHECK;

/* The figures of a principal; from any thread, never blocks for long. */
struct usage_figures usage_of(struct usage *usage, const char *principal);

#endif
