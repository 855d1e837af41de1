/* `whittled export` and `whittled import`: all that a service has, from one catalog and blob store to others.  Its code
 * is daemon/transfer.c.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_TRANSFER_H
#define WHITTLE_SERVER_DAEMON_TRANSFER_H

/* argv[0] is "export" or "import"; takes --to FOLDER or --from FOLDER, and the settings of the service.  Prints what it
 * has moved.  Returns the exit status: 0 = it is all there, 1 = not, 2 = the arguments are wrong. */
int transfer_main(int argc, char **argv);

#endif
