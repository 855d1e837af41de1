/* The documents of ended jobs that were asked for last, kept in memory: they don't change any more, so a client that
 * asks again is answered without the database.
 *
 * A table of fixed size in which a document takes the place of another whose id falls on the same slot.  A job that is
 * deleted is forgotten; a document that was read before that, and comes after it, is not kept: `since` tells.  All
 * functions may be called from any thread and never block for long.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_JOB_CACHE_H
#define WHITTLE_SERVER_JOBS_JOB_CACHE_H

#include <stdint.h>

#include "server/catalog/job.h"

struct job_cache;

struct job_cache *job_cache_new(void);        /* NULL: no memory */
void job_cache_free(struct job_cache *cache); /* accepts NULL */

/* What job_cache_keep wants to know: to be taken before the job is read. */
uint64_t job_cache_now(struct job_cache *cache);

/* Keeps the text of an ended job.  Does nothing where a job was forgotten since, where the text is long, or where
 * memory runs out. */
void job_cache_keep(struct job_cache *cache, uint64_t since, const struct job *job, const char *text);

/* A copy of the text, ended by NUL, for the caller to free, with the job's owner and sequence; NULL = not kept. */
char *job_cache_find(struct job_cache *cache, const char *id, char principal[JOB_PRINCIPAL_BYTES], uint64_t *sequence);

/* Forgets one, or all (NULL). */
void job_cache_forget(struct job_cache *cache, const char *id);

#endif
