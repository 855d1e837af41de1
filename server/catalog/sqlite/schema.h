/* What the database holds: jobs and their outputs, clouds, resumable uploads, keys, webhooks that are due, and what
 * each principal has.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_SQLITE_SCHEMA_H
#define WHITTLE_SERVER_CATALOG_SQLITE_SCHEMA_H

#include "core/base/status.h"
#include "server/catalog/sqlite/sql.h"

/* The version that a database has after schema_migrate: the number of its steps. */
int schema_version(void);

/* Brings a database up to date; STATUS_UNSUPPORTED when it is newer than this program. */
enum status schema_migrate(struct sql *sql, struct error *error) MUST_CHECK;

#endif
