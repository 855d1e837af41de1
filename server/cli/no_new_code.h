/* For a process that has loaded all the code that it will run, and is about to read a file that nobody trusts.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_NO_NEW_CODE_H
#define WHITTLE_SERVER_CLI_NO_NEW_CODE_H

#include <stdbool.h>

/* From now on no memory of this process becomes executable: not what it writes, and no file that it maps.  For good,
 * and for the threads that are started later.  It takes no_new_privs, which whittled sets.  false: the kernel has no
 * filters of system calls, or doesn't allow one. */
bool command_no_new_code(void);

#endif
