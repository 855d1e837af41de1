/* Which system calls a job's process may make.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_RUNNER_SECCOMP_H
#define WHITTLE_SERVER_RUNNER_SECCOMP_H

#include <stdbool.h>

#include "core/base/status.h"

struct seccomp_filter;

/* Makes the filter, for processes that are to execute the program with the environment at these two addresses, and
 * nothing else.  STATUS_UNSUPPORTED: the kernel has no filters.  Some milliseconds. */
enum status seccomp_filter_open(const char *program, char *const *environment, struct seccomp_filter **filter,
                                struct error *error) MUST_CHECK;
void seccomp_filter_close(struct seccomp_filter *filter);

/* Puts it on this process, a child just forked, for good; no_new_privs must be set.  Only system calls, and a change of
 * the child's own copy of the filter. */
bool seccomp_filter_apply(struct seccomp_filter *filter);

#endif
