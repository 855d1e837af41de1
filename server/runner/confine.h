/* Confining a job's process: all that keeps a hostile file, or the code that it takes over, inside of one job.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_RUNNER_CONFINE_H
#define WHITTLE_SERVER_RUNNER_CONFINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

struct confinement;

enum { CONFINE_TEXT_BYTES = 192, CONFINE_STACK_BYTES = 8 << 20 };

/* Finds out what the kernel has, for processes that execute the program (borrowed, as long as the confinement lives).
 * sandbox false: limits and no_new_privs alone.  user: the account that they run as, which takes root or CAP_SETUID,
 * CAP_SETGID, CAP_CHOWN and CAP_KILL; "" = ours.
 * STATUS_BAD_PARAMETER: that can't be, or the account can't execute the program.
 * Forks a child that ends at once for each thing that it tries. */
enum status confine_open(const char *program, bool sandbox, const char *user, struct confinement **confinement,
                         struct error *error) MUST_CHECK;
void confine_close(struct confinement *confinement);

/* What holds: "limits, no new privileges, seccomp, Landlock 6, no network, own process ids, threads". */
void confine_describe(const struct confinement *confinement, char text[CONFINE_TEXT_BYTES]);

/* No process addresses more: so much memory is no limit. */
#define CONFINE_ADDRESSABLE (INT64_C(1) << 47)

struct confine_limits {
    int64_t memory_bytes, data_bytes;    /* address space, and what of it can be written; 0 = no limit */
    int64_t files;                       /* open ones that it has beside those that any has */
    int64_t cpu_ms, file_bytes, threads; /* threads: where the kernel counts those of this process alone */
};

/* The same as numbers, one after the other: 0 = it doesn't hold, else 1, or Landlock's version; false: there are no
 * more.  Limits and no_new_privs hold always. */
bool confine_measure(const struct confinement *confinement, size_t i, const char **name, int64_t *value);

/* Whether a job's processes have ids of their own.  Then the process that forks them enters their namespaces first;
 * the first one that it forks is the others' init, and all end with it.  Only system calls. */
bool confine_has_own_pids(const struct confinement *confinement);
bool confine_enter_namespaces(const struct confinement *confinement);

/* Confines this process, a child just forked without descriptors that it doesn't need: the folder may be written, and
 * becomes the current one, for another user has no way to it; it dies with the thread that forked it.  Only system
 * calls.  false: not everything that confine_describe promises could be done, and nothing may be executed. */
bool confine_this_process(const struct confinement *confinement, const struct confine_limits *limits,
                          const char *folder);

/* Executes the program, without an environment; returns only on failure. */
void confine_execute(const struct confinement *confinement, char *const *argv);

#endif
