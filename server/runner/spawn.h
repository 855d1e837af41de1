/* Starting whittle for a job, confined: fork + exec with few inherited descriptors.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_RUNNER_SPAWN_H
#define WHITTLE_SERVER_RUNNER_SPAWN_H

#include <stdint.h>
#include <sys/types.h>

#include "core/base/status.h"
#include "core/params.h"
#include "server/runner/confine.h"

enum { SPAWN_FIRST_FILE = 4 };

struct spawn_request {
    const struct confinement *confinement; /* and the program */
    int input_fd;                          /* the cloud; becomes standard input */
    const char *output;                    /* absolute path of the folder for outputs */
    const struct params *params;
    uint64_t threads;      /* instead of params->threads */
    uint64_t memory_bytes; /* that it may take; 0 = as much as the limits allow */
    int log_fd;            /* becomes standard output and error */
    const char *task;      /* of a job in tiles: "plan", a tile's number, "merge"; NULL = the job is in one piece */
    const char *files;     /* "plan.0=4,points.7=5": what the descriptors below are; borrowed, as they are */
    const int *file_fd;    /* become descriptors from SPAWN_FIRST_FILE on */
    size_t file_count;
    struct confine_limits limits;
};

struct spawned {
    pid_t pid;       /* also its process group */
    int pid_fd;      /* readable when it has ended */
    int progress_fd; /* what it says (server/shared/worker_protocol.h); doesn't block */
    pid_t keeper;    /* the init of its namespace, which ends when keeper_fd is closed; -1 = there is none */
    int keeper_fd;
};

/* Starts the program.  On success the process is the caller's to reap, and then the rest to let go of (spawn_done).  A
 * program that can't be executed is seen as exit status 127, one that can't be confined as 126. */
enum status spawn_worker(const struct spawn_request *request, struct spawned *spawned, struct error *error) MUST_CHECK;

/* Closes the descriptors, and ends what is left in its namespace.  The process has been reaped. */
void spawn_done(struct spawned *spawned);

#endif
