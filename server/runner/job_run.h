/* One run of one job: its process from start to obituary.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_RUNNER_JOB_RUN_H
#define WHITTLE_SERVER_RUNNER_JOB_RUN_H

#include <stdatomic.h>

#include "server/catalog/job.h"
#include "server/jobs/service.h"
#include "server/runner/confine.h"

/* What somebody else wants of a run; changed from any thread, then wake_fd (an eventfd) is written. */
enum job_run_command {
    JOB_RUN_GO_ON,
    JOB_RUN_DISMISS,
    JOB_RUN_REQUEUE,
    JOB_RUN_LOST /* its lease is another's: it ends at once, and nothing is kept of it */
};

struct job_run_control {
    _Atomic int command;     /* enum job_run_command */
    _Atomic int64_t seen_ms; /* when the run last showed that it goes on (clock_ms) */
    int wake_fd;
};

/* Runs a claimed job to its end and records in the catalog what became of it (published and logged).  Blocks for as
 * long as the process lives.  false: it is queued again for what this host lacks, such as room on its disk; another one
 * may have it. */
bool job_run(struct service *service, const struct confinement *confinement, struct job *job,
             struct job_run_control *control);

#endif
