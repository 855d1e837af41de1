/* The tables of the catalog in PostgreSQL; for this folder alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_POSTGRES_TABLES_H
#define WHITTLE_SERVER_CATALOG_POSTGRES_TABLES_H

#include "server/catalog/postgres/pq.h"

/* How many steps this program knows. */
int tables_steps(void);

/* How many steps the database has had; 0 where it has no tables of ours. */
enum status tables_version(struct pq_link *link, int64_t *version, struct error *error) MUST_CHECK;

/* Runs those of the steps that it hasn't had yet, in one transaction, alone.  STATUS_UNSUPPORTED when it has had more.
 */
enum status tables_migrate(struct pq *pq, struct error *error) MUST_CHECK;

#endif
