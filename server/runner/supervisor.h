/* The supervisor: runs jobs, each as a process of its own.  Its code is runner/supervisor.c, runner/job_run.c and
 * runner/spawn.c.
 *
 * A fixed number of threads each take a job, start whittle for it, follow its progress, reap it and record what became
 * of it.  A thread blocks; nothing else waits for it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_RUNNER_SUPERVISOR_H
#define WHITTLE_SERVER_RUNNER_SUPERVISOR_H

#include <stdbool.h>

#include "core/base/status.h"

struct service;
struct supervisor;

/* Starts config->workers threads.  The service is borrowed. */
enum status supervisor_open(struct service *service, struct supervisor **supervisor, struct error *error) MUST_CHECK;

/* A job was submitted. */
void supervisor_notify(struct supervisor *supervisor);

/* Ends the process of a running job: TERM, KILL 2 s later; the job becomes dismissed, which is published as any change
 * is.  false: no process runs for it. */
bool supervisor_cancel(struct supervisor *supervisor, const char *id);

/* Whether its threads do their work: those without a job have asked the catalog for one within the last 30 s, those
 * with one have looked after it within three times job-stall (30 s at least; else logged).  Waits for the lock, so that
 * a deadlock shows as a call that never returns. */
bool supervisor_answers(struct supervisor *supervisor);

/* Takes no more jobs; those that run go on.  supervisor_idle_fd becomes readable when the last has ended. */
void supervisor_stop(struct supervisor *supervisor);
int supervisor_idle_fd(const struct supervisor *supervisor);

/* Ends the processes that still run; their jobs are queued again. */
void supervisor_requeue(struct supervisor *supervisor);

/* Waits for the threads to end; after supervisor_stop.  Accepts NULL. */
void supervisor_close(struct supervisor *supervisor);

#endif
