/* Idempotency-Key, for the handlers of POST.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HANDLERS_KEYS_H
#define WHITTLE_SERVER_HANDLERS_KEYS_H

#include <stdbool.h>

#include "server/http/request.h"
#include "server/jobs/service.h"

/* Takes hold of the request's Idempotency-Key, where it has one and the operation takes one; else a response: it is
 * malformed, or another request with it is under way.  Must not block. */
bool handlers_admit_key(struct service *service, struct request *request, struct response *response);

/* The key, and a fingerprint of the complete request: for this cloud (its hash), and with what the job asks (NULL =
 * nothing).  false: memory runs out. */
bool handlers_fingerprint(const struct request *request, const struct job *job, const char *cloud, struct job_key *key);

/* What the request made when it came before; false: the response says that the key stands for another one.  The record
 * is the caller's where *found, to catalog_reply_done. */
bool handlers_find_reply(struct service *service, const struct request *request, const struct job_key *key,
                         struct catalog_reply *record, bool *found, struct response *response);

/* Keeps the response for when the request comes again; nothing where it has no key, or is refused. */
void handlers_keep_reply(struct service *service, const struct request *request, const struct response *response);

/* Makes the response that was kept; takes it out of the record. */
void handlers_replay(struct catalog_reply *record, struct response *response);

#endif
