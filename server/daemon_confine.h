/* Confining a job's process: all that keeps a hostile file, or the code that it takes over, inside of one job.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_CONFINE_H
#define WHITTLE_SERVER_DAEMON_CONFINE_H

#include <stdbool.h>
#include <stdint.h>

#include "core/status.h"

struct confinement;

enum { CONFINE_TEXT_BYTES = 160 };

/* Finds out what the kernel has, for processes that execute the program (borrowed, as long as the confinement lives).
 * sandbox false: limits and no_new_privs alone.  Forks a child that ends at once. */
enum status confine_open(const char *program, bool sandbox, struct confinement **confinement,
                         struct error *error) MUST_CHECK;
void confine_close(struct confinement *confinement);

/* What holds, for the log: "limits, no new privileges, seccomp, Landlock 6, no network". */
void confine_describe(const struct confinement *confinement, char text[CONFINE_TEXT_BYTES]);

struct confine_limits {
    int64_t memory_bytes, cpu_ms, file_bytes; /* memory_bytes: address space; 0 = no limit */
};

/* Confines this process, a child just forked without descriptors that it doesn't need: the folder may be written; it
 * dies with the thread that forked it.  Only system calls.  false: not
 * everything that confine_describe promises could be done, and nothing may be executed. */
bool confine_this_process(const struct confinement *confinement, const struct confine_limits *limits,
                          const char *folder);

/* Executes the program, without an environment; returns only on failure. */
void confine_execute(const struct confinement *confinement, char *const *argv);

#endif
