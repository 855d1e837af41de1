/* Idempotency-Key: a request that is sent again under the same key isn't done again.
 *
 * A key belongs to a principal.  While a request with it is under way, others with it are turned away; that is known in
 * memory.  When a request has made something, the key, a fingerprint of the request and what it made are kept in the
 * database, with a job in the transaction that adds the job: so a crash leaves both or neither.  A request that was
 * refused leaves nothing, and may be sent again under the same key.
 *
 * May be called from any thread; what touches the database blocks on it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_IDEMPOTENCY_H
#define WHITTLE_SERVER_IDEMPOTENCY_H

#include <stdbool.h>
#include <stdint.h>

#include "core/status.h"
#include "server/job.h"

struct idempotency;
struct sql;

enum { IDEMPOTENCY_KEY_BYTES = 256 };

/* A request's hold on its key; zeroed = it has none. */
struct idempotency_claim {
    const char *principal, *key; /* borrowed while it is held */
    bool held;
    struct idempotency_claim *previous, *next;
};

/* Returns new, NULL when memory runs out.  idempotency_free accepts NULL. */
struct idempotency *idempotency_new(void);
void idempotency_free(struct idempotency *idempotency);

/* Whether a header's value may be a key: 1 to 255 visible ASCII characters. */
bool idempotency_key_valid(const char *key);

/* Takes hold of a key; false: a request with it is under way.  idempotency_release accepts a claim that isn't held. */
bool idempotency_claim(struct idempotency *idempotency, const char *principal, const char *key,
                       struct idempotency_claim *claim);
void idempotency_release(struct idempotency *idempotency, struct idempotency_claim *claim);

/* What a request under a key made. */
struct idempotency_record {
    char fingerprint[JOB_HASH_BYTES];
    char made[JOB_HASH_BYTES]; /* the job's id, the cloud's hash */
    char etag[32];             /* of the reply; "" = none */
    int status;                /* of the reply; 0 = it was never made */
    char *reply;               /* its text; owned; NULL = it was never made */
};

/* Reads what was made under a key; *found false: nothing.  The record is the caller's, to idempotency_record_done. */
enum status idempotency_find(struct sql *reader, const char *principal, const char *key,
                             struct idempotency_record *record, bool *found, struct error *error) MUST_CHECK;
void idempotency_record_done(struct idempotency_record *record);

/* Adds a row for what a request under a key makes, without a reply as yet; in the caller's transaction, if any. */
enum status idempotency_add(struct sql *writer, const char *principal, const struct job_key *key, const char *made,
                            int64_t now_ms, struct error *error) MUST_CHECK;

/* The same by itself; takes the writer's lock. */
enum status idempotency_put(struct sql *writer, const char *principal, const struct job_key *key, const char *made,
                            int64_t now_ms, struct error *error) MUST_CHECK;

/* Keeps the reply to that request.  Takes the writer's lock; not durable at once, and nothing is lost if it isn't. */
enum status idempotency_keep_reply(struct sql *writer, const char *principal, const char *key, int status,
                                   const char *etag, const char *reply, struct error *error) MUST_CHECK;

/* Forgets what is older; takes the writer's lock. */
enum status idempotency_forget(struct sql *writer, int64_t before_ms, struct error *error) MUST_CHECK;

#endif
