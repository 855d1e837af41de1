/* Whether a data folder and a database belong together.
 *
 * Both carry one random identity: the folder in the file `identity`, the database in a row.  A database that is lost,
 * emptied, or another folder's would make every file of the folder look like garbage, so the service doesn't start on
 * such a pair.  An older database of the same folder (a backup) has its identity: it is served, and what it doesn't
 * know goes to lost+found (blobs/lost_found.h).
 *
 * A pair of which one part has no identity yet (a new folder, one of an earlier version, a backup from before) gets
 * one, without a word, where the folder is empty or the database knows something that is in it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_IDENTITY_H
#define WHITTLE_SERVER_JOBS_IDENTITY_H

#include <stdbool.h>

#include "core/base/status.h"
#include "server/catalog/catalog.h"
#include "server/storage/store.h"

/* Before the database is opened, which would make an empty one: STATUS_UNSUPPORTED where there is none and the folder
 * has files. */
enum status identity_expect_database(struct store *store, const char *url, struct error *error) MUST_CHECK;

/* STATUS_UNSUPPORTED, with what to do: they don't belong together.  is_elsewhere: the database doesn't lie in the
 * folder, so a new folder can't take one over that has an identity. */
enum status identity_check(struct store *store, struct catalog *catalog, const char *url, bool is_elsewhere,
                           struct error *error) MUST_CHECK;

/* A host among several that share a catalog has an identity of its own: made where it has none. */
enum status identity_of_host(struct store *store, struct error *error) MUST_CHECK;

/* From now on they do. */
enum status identity_adopt(struct store *store, struct catalog *catalog, struct error *error) MUST_CHECK;

#endif
