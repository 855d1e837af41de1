/* Which clouds there are, and who may see them.
 *
 * A cloud is content, named by its sha256; the file is the store's.  A principal sees it when it has uploaded it: on
 * its own (a row of this table, which expires) or with a job (which it lives as long as).  The table is kept in the
 * queue's database (clouds_sqlite.c).  All functions may be called from any thread; they block on the disk, and what
 * they write is durable when they return.
 *
 * Statuses: STATUS_IO with a text when the database refuses.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLOUDS_H
#define WHITTLE_SERVER_CLOUDS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/status.h"
#include "server/job.h"
#include "server/queue.h"

struct clouds_record {
    char sha256[JOB_HASH_BYTES];
    char principal[JOB_PRINCIPAL_BYTES]; /* for clouds_put */
    int64_t created_ms, expires_ms;      /* expires 0: when its last job is deleted */
    uint64_t bytes, points;              /* points: as the header says, 0 = not known */
    char format[JOB_FORMAT_BYTES];
    uint64_t jobs; /* that refer to it, of those who may be seen */
    char *report;  /* of the newest job that has read it; owned; NULL = none */
};

/* Frees what the record owns.  Accepts a zeroed one. */
void clouds_record_done(struct clouds_record *record);

/* Whether text has the form of a cloud's id. */
bool clouds_id_valid(const char *text);

/* Makes the cloud one of its principal's; where it is already, it expires at the later of both times. */
enum status clouds_put(struct queue *queue, const struct clouds_record *record, struct error *error) MUST_CHECK;

/* What this principal sees of a cloud (NULL: what all do).  *found false: nothing.  The record is the caller's. */
enum status clouds_get(struct queue *queue, const char *sha256, const char *principal, struct clouds_record *record,
                       bool *found, struct error *error) MUST_CHECK;

/* Up to max clouds that this principal sees (NULL: anybody), newest first, those behind the cloud `after` (NULL: from
 * the newest). */
enum status clouds_list(struct queue *queue, const char *principal, const char *after, struct clouds_record *records,
                        size_t max, size_t *count, struct error *error) MUST_CHECK;

/* The cloud is none of this principal's (NULL: of nobody's) own any more. */
enum status clouds_delete(struct queue *queue, const char *sha256, const char *principal,
                          struct error *error) MUST_CHECK;

/* Deletes up to max rows whose time is over and whose principal has no job that refers to them; their clouds' names. */
enum status clouds_expire(struct queue *queue, int64_t now_ms, char (*names)[JOB_HASH_BYTES], size_t max, size_t *count,
                          struct error *error) MUST_CHECK;

/* The first name behind `after` ("" = from the beginning) in the table; *found false: there is none. */
enum status clouds_next(struct queue *queue, const char *after, char name[JOB_HASH_BYTES], bool *found,
                        struct error *error) MUST_CHECK;

#endif
