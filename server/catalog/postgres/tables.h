/* The tables of the catalog in PostgreSQL; for this folder alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_POSTGRES_TABLES_H
#define WHITTLE_SERVER_CATALOG_POSTGRES_TABLES_H

#include "server/catalog/postgres/pq.h"

/* Whether this program goes on with the tables as they are: its own, or those of the next version, so that hosts may be
 * upgraded one after the other.  STATUS_UNSUPPORTED: they are older, or newer than that. */
enum status tables_check(struct pq_link *link, struct error *error) MUST_CHECK;

/* Runs those of the steps that it hasn't had yet, in one transaction, alone.  STATUS_UNSUPPORTED when it has had more.
 */
enum status tables_migrate(struct pq *pq, struct error *error) MUST_CHECK;

#endif
