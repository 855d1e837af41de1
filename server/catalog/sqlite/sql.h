/* SQL, shorter: a connection to an SQLite database, statements with values bound to them, rows.
 *
 * What keeps something in the database (the files of this folder) is written with these.  A connection is used by
 * whoever holds its lock.
 *
 * Statuses: STATUS_IO with a text when the database refuses, STATUS_NO_SPACE where the disk is full, STATUS_NO_MEMORY.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_SQLITE_SQL_H
#define WHITTLE_SERVER_CATALOG_SQLITE_SQL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

struct sql;      /* a connection */
struct sql_rows; /* a statement that is being read */

/* Opens or creates the file: WAL, every commit durable.  sql_close accepts NULL. */
enum status sql_open(const char *path, struct sql **sql, struct error *error) MUST_CHECK;
void sql_close(struct sql *sql);

/* How long a statement waits for who else holds the database; 10 s at first. */
void sql_set_patience(struct sql *sql, int ms);

/* Runs those of the steps that this database has not had yet, in one transaction; `user_version` counts them.
 * STATUS_UNSUPPORTED when it has had more. */
enum status sql_migrate(struct sql *sql, const char *const *steps, size_t count, struct error *error) MUST_CHECK;

void sql_lock(struct sql *sql);
void sql_unlock(struct sql *sql);

/* One value to bind, made with I(integer), R(real) or T(text; NULL = null); a list of them with VALUES(...). */
struct sql_value {
    enum { SQL_VALUE_INTEGER, SQL_VALUE_REAL, SQL_VALUE_TEXT } type;
    int64_t integer;
    double real;
    const char *text; /* borrowed */
};
#define I(x) ((struct sql_value){.type = SQL_VALUE_INTEGER, .integer = (int64_t)(x)})
#define R(x) ((struct sql_value){.type = SQL_VALUE_REAL, .real = (x)})
#define T(x) ((struct sql_value){.type = SQL_VALUE_TEXT, .text = (x)})
#define VALUES(...)                                                                                                    \
    (const struct sql_value[]){__VA_ARGS__}, sizeof((const struct sql_value[]){__VA_ARGS__}) / sizeof(struct sql_value)

/* Runs statements without values and rows. */
enum status sql_execute(struct sql *sql, const char *text, struct error *error) MUST_CHECK;

/* Runs a statement that returns no rows; sql_changes says how many it has changed. */
enum status sql_run(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                    struct error *error) MUST_CHECK;
int64_t sql_changes(const struct sql *sql);

/* The same, not in a transaction, and not durable: it costs no fsync, and a power cut may take it back. */
enum status sql_run_nosync(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                           struct error *error) MUST_CHECK;

/* Runs a statement that returns one number; *number is untouched where there is no row. */
enum status sql_number(struct sql *sql, const char *text, const struct sql_value *values, size_t count, int64_t *number,
                       struct error *error) MUST_CHECK;

/* A transaction for writing.  sql_end commits when status is OK and undoes it otherwise. */
enum status sql_begin(struct sql *sql, struct error *error) MUST_CHECK;
enum status sql_end(struct sql *sql, enum status status, struct error *error) MUST_CHECK;

/* Prepares a statement whose rows are wanted; the values' texts are borrowed until sql_finish, which follows in any
 * case where this was OK. */
enum status sql_select(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                       struct sql_rows **rows, struct error *error) MUST_CHECK;

/* Goes to the next row; false: there is none, or the database refuses. */
bool sql_next(struct sql_rows *rows);

/* Ends reading; STATUS_IO when the last sql_next was false because the database refused, or when it refuses what the
 * statement has changed. */
enum status sql_finish(struct sql_rows *rows, struct error *error) MUST_CHECK;

/* Columns of the present row, counted from 0.  sql_text borrows until the next call, sql_copy_text cuts what doesn't
 * fit, both make null ""; sql_new_text returns new, NULL for null.  A text for which there is no memory is "" or NULL,
 * and makes sql_finish STATUS_NO_MEMORY. */
int64_t sql_integer(struct sql_rows *rows, int column);
double sql_real(struct sql_rows *rows, int column);
const char *sql_text(struct sql_rows *rows, int column);
void sql_copy_text(struct sql_rows *rows, int column, char *to, size_t bytes);
char *sql_new_text(struct sql_rows *rows, int column);

#endif
