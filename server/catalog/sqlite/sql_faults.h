/* Faults of the disk under the database, for tests.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_SQLITE_SQL_FAULTS_H
#define WHITTLE_SERVER_CATALOG_SQLITE_SQL_FAULTS_H

/* The name of a VFS of SQLite's whose calls pass fault_at (core/base/fault.h) at `database-open`, `-read`, `-write`,
 * `-sync`, `-truncate` and `-map`.  NULL when there is none.  Before there are other threads that open databases. */
const char *sql_faults_vfs(void);

#endif
