/* What the parts of the service (submit.c, recovery.c, janitor.c) share; for this folder alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_SERVICE_INTERNAL_H
#define WHITTLE_SERVER_JOBS_SERVICE_INTERNAL_H

#include "server/jobs/service.h"

enum { SERVICE_PAGE = 64 }; /* rows that are read at a time */

/* recovery.c: puts right what an earlier process left (logged); before anything else uses the service. */
enum status service_recover(struct service *service, struct error *error) MUST_CHECK;

/* recovery.c: a job whose host has gone is queued again, or failed (*failed) where hosts went too often.  *changed
 * false: it isn't that run's any more, else the outputs that it left are removed. */
enum status service_recover_job(struct service *service, struct job *job, bool *failed, bool *changed,
                                struct error *error) MUST_CHECK;

/* janitor.c: the service's own clock becomes that of the catalog, which several hosts share. */
enum status service_follow_catalog(struct service *service, struct error *error) MUST_CHECK;

/* janitor.c: removes a cloud that nothing refers to any more. */
void service_forget_cloud(struct service *service, const char *cloud);

/* janitor.c: moves all ends, and the service's own clock, with a clock on the wall that was set by so much. */
enum status service_move_ends(struct service *service, int64_t step_ms, struct error *error) MUST_CHECK;

/* What the store doesn't end is marked in the catalog from now on, and given up after a grace. */
void service_watch_unfinished(struct service *service);

#endif
