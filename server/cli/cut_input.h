/* A mapped input whose pages have gone while they were read: somebody has cut the file short, or its disk has failed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_CUT_INPUT_H
#define WHITTLE_SERVER_CLI_CUT_INPUT_H

/* From here on such a read ends the process with WIRE_EXIT_IO, and names the file where /proc tells it. */
void cut_input_watch(void);

#endif
