/* Starting whittle for a job, confined: fork + exec with one inherited descriptor.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_SPAWN_H
#define WHITTLE_SERVER_DAEMON_SPAWN_H

#include <stdint.h>
#include <sys/types.h>

#include "core/params.h"
#include "core/status.h"
#include "server/daemon_confine.h"

struct spawn_request {
    const struct confinement *confinement; /* and the program */
    int input_fd;                          /* the cloud; becomes standard input */
    const char *output;                    /* absolute path of the folder for outputs */
    const struct params *params;
    uint64_t threads; /* instead of params->threads */
    int log_fd;       /* becomes standard output and error */
    struct confine_limits limits;
};

struct spawned {
    pid_t pid;       /* also its process group */
    int pid_fd;      /* readable when it has ended */
    int progress_fd; /* what it says (server/wire.h); doesn't block */
};

/* Starts the program.  On success the descriptors are the caller's to close and the process to reap.  A program that
 * can't be executed is seen as exit status 127, one that can't be confined as 126. */
enum status spawn_worker(const struct spawn_request *request, struct spawned *spawned, struct error *error) MUST_CHECK;

#endif
