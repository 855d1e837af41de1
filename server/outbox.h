/* The outbox: who wants to be told of the end of which job, and how often that was tried.  Rows of the queue's
 * database.
 *
 * A row is added with its job, becomes due when the job ends, and goes with its delivery or with its job.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_OUTBOX_H
#define WHITTLE_SERVER_OUTBOX_H

#include <stddef.h>
#include <stdint.h>

#include "core/status.h"
#include "server/job.h"

struct sql;

struct outbox_row {
    char job[JOB_ID_BYTES], url[JOB_WEBHOOK_BYTES];
    int attempts; /* that failed */
};

/* In the caller's transaction, and under its lock: a job is added that ends with a POST to url; a job has ended; a job
 * is deleted. */
enum status outbox_add(struct sql *writer, const char *job, const char *url, struct error *error) MUST_CHECK;
enum status outbox_make_due(struct sql *writer, const char *job, int64_t now_ms, struct error *error) MUST_CHECK;
enum status outbox_remove(struct sql *writer, const char *job, struct error *error) MUST_CHECK;

/* The one that has been due longest: *found; else *next_ms says when there may be one (INT64_MAX = not known). */
enum status outbox_next(struct sql *reader, int64_t now_ms, struct outbox_row *row, bool *found, int64_t *next_ms,
                        struct error *error) MUST_CHECK;

/* Its delivery failed: it is due again then.  Takes the writer's lock. */
enum status outbox_postpone(struct sql *writer, const char *job, int64_t due_ms, struct error *error) MUST_CHECK;

/* It is delivered, or given up.  Takes the writer's lock. */
enum status outbox_end(struct sql *writer, const char *job, struct error *error) MUST_CHECK;

#endif
