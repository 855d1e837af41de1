/* libpq, shorter: connections to a PostgreSQL server, statements with values bound to them, rows.
 *
 * A pool of connections, each used by whoever has taken it.  No statement hangs: each has a deadline of our own, past
 * which the connection is closed (libpq's settings can't see a server that is stopped, nor a commit that waits for its
 * standby).  Whether a commit that didn't answer was done is not known then: pq_end says so.
 *
 * Statuses: STATUS_IO with a text when the server refuses or isn't there (base/away.h), STATUS_NO_SPACE,
 * STATUS_NO_MEMORY.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_POSTGRES_PQ_H
#define WHITTLE_SERVER_CATALOG_POSTGRES_PQ_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

struct pq;      /* the pool */
struct pq_link; /* a connection that somebody has taken */
struct pq_rows; /* what a statement has returned */

/* Whether libpq takes it as the address of a server. */
bool pq_valid(const char *conninfo);

/* Connects once, to see that it can be done.  pq_close accepts NULL, and wants every link given back. */
enum status pq_open(const char *conninfo, struct pq **pq, struct error *error) MUST_CHECK;
void pq_close(struct pq *pq);

/* Takes a connection to read with, a statement at a time, or for a transaction that changes something.  pq_done or
 * pq_end, which takes it back, follows where this was OK.  A connection that was found dead is made anew first. */
enum status pq_take(struct pq *pq, struct pq_link **link, struct error *error) MUST_CHECK;
enum status pq_begin(struct pq *pq, struct pq_link **link, struct error *error) MUST_CHECK;

/* The same for callers who must not wait for long: all that is done with the link has a second together.  A server
 * that has just left somebody waiting isn't asked at all, until it has answered somebody else. */
enum status pq_take_soon(struct pq *pq, struct pq_link **link, struct error *error) MUST_CHECK;
enum status pq_begin_soon(struct pq *pq, struct pq_link **link, struct error *error) MUST_CHECK;
void pq_done(struct pq_link *link);

/* Commits when status is OK, undoes it otherwise.  STATUS_IO with *unknown (NULL = not wanted): the commit has had no
 * answer, and may be done or not. */
enum status pq_end(struct pq_link *link, enum status status, bool *unknown, struct error *error) MUST_CHECK;

/* Undoes the transaction, whose caller has found something to be otherwise. */
void pq_undo(struct pq_link *link);

/* A value to bind, made with I(integer), R(real) or T(text; NULL = null); a list of them with VALUES(...). */
struct pq_value {
    enum { PQ_VALUE_INTEGER, PQ_VALUE_REAL, PQ_VALUE_TEXT } type;
    int64_t integer;
    double real;
    const char *text; /* borrowed */
};
#define I(x) ((struct pq_value){.type = PQ_VALUE_INTEGER, .integer = (int64_t)(x)})
#define R(x) ((struct pq_value){.type = PQ_VALUE_REAL, .real = (x)})
#define T(x) ((struct pq_value){.type = PQ_VALUE_TEXT, .text = (x)})
#define VALUES(...)                                                                                                    \
    (const struct pq_value[]){__VA_ARGS__}, sizeof((const struct pq_value[]){__VA_ARGS__}) / sizeof(struct pq_value)

/* Runs a statement; *changed is how many rows it has changed.  In a transaction one of which that isn't wanted (NULL)
 * goes out with the next that has an answer, or with the COMMIT, and so does the BEGIN: where it fails that one does.
 */
enum status pq_run(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                   int64_t *changed, struct error *error) MUST_CHECK;

/* Runs statements without values, at once. */
enum status pq_execute(struct pq_link *link, const char *text, struct error *error) MUST_CHECK;

/* Runs one whose rows are wanted: all of them, to be freed with pq_free.  pq_next goes to the next one; false: there is
 * none. */
enum status pq_select(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                      struct pq_rows **rows, struct error *error) MUST_CHECK;
bool pq_next(struct pq_rows *rows);
void pq_free(struct pq_rows *rows);

/* Runs one that returns one number; *number is untouched where there is no row. */
enum status pq_number(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                      int64_t *number, struct error *error) MUST_CHECK;

/* Columns of the present row, counted from 0.  pq_text borrows, pq_copy_text cuts what doesn't fit, both make null "";
 * pq_new_text returns new, NULL for null or where there is no memory. */
int64_t pq_integer(const struct pq_rows *rows, int column);
double pq_real(const struct pq_rows *rows, int column);
const char *pq_text(const struct pq_rows *rows, int column);
void pq_copy_text(const struct pq_rows *rows, int column, char *to, size_t bytes);
char *pq_new_text(const struct pq_rows *rows, int column);

/* Waits until somebody has notified the link, which listens, for up to so long: whether it is so, and with which text.
 * STATUS_IO: the connection is gone. */
enum status pq_wait(struct pq_link *link, int ms, char *text, size_t bytes, bool *notified,
                    struct error *error) MUST_CHECK;

#endif
