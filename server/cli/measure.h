/* The command `whittle measure`: how far two files are from each other.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_MEASURE_H
#define WHITTLE_SERVER_CLI_MEASURE_H

/* argv[0] is the command's name and isn't looked at; the rest are its arguments.  Prints to standard output, complaints
 * to standard error.  Returns the exit status; --help lists them. */
int worker_measure_main(int argc, char **argv);

#endif
