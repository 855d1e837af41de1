/* Which files a job's process may touch.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_RUNNER_LANDLOCK_H
#define WHITTLE_SERVER_RUNNER_LANDLOCK_H

#include <stdbool.h>

/* The version of Landlock that the kernel speaks; 0 = none. */
int landlock_version(void);

/* For this process, a child just forked, and for good: the folder may be written; what a program needs to start, be
 * read; the program alone be executed; and nothing else, TCP and signals to others included where the version knows of
 * them.  What is open stays so.  no_new_privs must be set.  Only system calls. */
bool landlock_apply(int version, const char *program, const char *folder);

#endif
