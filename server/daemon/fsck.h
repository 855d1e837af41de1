/* `whittled check`: whether a data folder is whole.  Its code is daemon/fsck.c.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_FSCK_H
#define WHITTLE_SERVER_DAEMON_FSCK_H

/* Takes the settings of the service, of which `data` counts; no service may run on the folder.  Prints a line for each
 * finding, and a summary.  Returns the exit status: 0 = nothing is damaged, 1 = something is, or it can't be told. */
int check_main(int argc, char **argv);

#endif
