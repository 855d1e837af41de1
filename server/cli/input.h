/* The files that the commands read.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_INPUT_H
#define WHITTLE_SERVER_CLI_INPUT_H

#include "core/base/status.h"

/* Opens a file, or standard input for "-"; *input is the descriptor.  STATUS_IO where it isn't there, is a folder or
 * can't be opened: the exit status is WIRE_EXIT_NO_INPUT then. */
enum status worker_input_open(const char *path, int *input, struct error *error) MUST_CHECK;

/* Closes it, unless it is standard input or -1. */
void worker_input_close(int input);

#endif
