/* Whether the service can do its work: a thread of its own looks at disk, program for jobs and database, so that who
 * asks never waits for them, however they hang.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_READINESS_H
#define WHITTLE_SERVER_JOBS_READINESS_H

#include <stdbool.h>
#include <stdint.h>

#include "api/problem.h"
#include "core/base/status.h"

struct service;
struct readiness;

enum { READINESS_PERIOD_MS = 1000 };

/* Looks once, then every period_ms.  The service (its queue, store and settings) is borrowed. */
enum status readiness_open(struct service *service, int64_t period_ms, struct readiness **readiness,
                           struct error *error) MUST_CHECK;

/* Waits for the look that is under way.  Accepts NULL. */
void readiness_close(struct readiness *readiness);

/* What the last look found; false: *problem says what is in the way, which may be that a look doesn't come back.  Never
 * blocks. */
bool readiness_is_given(struct readiness *readiness, struct problem *problem);

#endif
