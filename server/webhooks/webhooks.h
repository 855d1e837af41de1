/* Webhooks: a POST to where a client said, when its job or all jobs of its batch have ended.
 *
 * Where to is kept with the job in the database's outbox, in the same transactions that add and end the job, so neither
 * a crash nor a restart loses a delivery: it is made at least once, and webhook-id tells a second one.  What is sent is
 * {"type": "job.ended" or "batch.ended", "timestamp": ..., "data": the job or the batch}, with the headers of Standard
 * Webhooks (webhook-id, webhook-timestamp, webhook-signature: v1 and HMAC-SHA256).  Where it isn't answered 2xx it is
 * sent again, later and later, with some randomness; after WEBHOOKS_MAX_ATTEMPTS, or 410, it is given up, which the
 * job's log tells.
 *
 * A few threads deliver, with shares for hosts and principals; nothing waits for them.  Their code is
 * webhooks/webhooks.c.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_WEBHOOKS_WEBHOOKS_H
#define WHITTLE_SERVER_WEBHOOKS_WEBHOOKS_H

#include <stdbool.h>

#include "core/base/status.h"

struct service;
struct webhooks;

enum { WEBHOOKS_MAX_ATTEMPTS = 10 };

/* Starts the threads, where the settings turn webhooks on (*webhooks stays NULL otherwise).  STATUS_BAD_PARAMETER when
 * the file of the secret can't be read or holds none. */
enum status webhooks_open(struct service *service, struct webhooks **webhooks, struct error *error) MUST_CHECK;

/* Ends them; what wasn't delivered is at the next start.  Accepts NULL. */
void webhooks_close(struct webhooks *webhooks);

#endif
