/* whittle info FILE: what a cloud is.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_INFO_H
#define WHITTLE_SERVER_CLI_INFO_H

/* argv[0] is "info".  Returns the exit status. */
int worker_info_main(int argc, char **argv);

#endif
