/* What each principal has: jobs that have not ended, and bytes that are kept for it.
 *
 * The figures are rows of the database's table `usage`, which triggers keep in step with jobs, outputs and clouds
 * within the transactions that change these (schema.c).  Here is their copy in memory, for those
 * who must not wait for the database: whoever has changed the rows of a principal has it refreshed.  Here too is what
 * is reserved, in memory alone, for it ends with the process that would have brought it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_SQLITE_USAGE_H
#define WHITTLE_SERVER_CATALOG_SQLITE_USAGE_H

#include <stdint.h>

#include "core/base/status.h"
#include "server/catalog/catalog.h"
#include "server/catalog/sqlite/sql.h"

struct usage;

/* Returns new, NULL when memory runs out; usage_free accepts NULL. */
struct usage *usage_new(void);
void usage_free(struct usage *usage);

/* Reads the row of one principal, or all rows (NULL), from a connection that the caller has locked. */
enum status usage_refresh(struct usage *usage, struct sql *sql, const char *principal, struct error *error) MUST_CHECK;

/* Reserves bytes for a principal, in one step with looking whether it may have them: STATUS_LIMIT, with error->where
 * "principal_bytes", where it would have more than the limit then (0 = none).  usage_release gives them back, or says
 * that they are among `bytes` by now. */
enum status usage_reserve(struct usage *usage, const char *principal, uint64_t bytes, uint64_t limit,
                          struct error *error) MUST_CHECK;
void usage_release(struct usage *usage, const char *principal, uint64_t bytes);

/* The figures of a principal; from any thread, never blocks for long. */
struct catalog_usage usage_of(struct usage *usage, const char *principal);

#endif
