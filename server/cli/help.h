/* What whittle tells of its own options.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_HELP_H
#define WHITTLE_SERVER_CLI_HELP_H

#include <stddef.h>

/* Writes text with the names of parameters as options have them, max-deviation for max_deviation; all else as it is. */
void help_hyphens(const char *text, char *out, size_t out_bytes);

/* To standard output: --help, of convert too; the manual page; a line for each option, for completion: its name, a tab,
 * what it takes (words with commas between, FILE, VALUE, or nothing), a tab, what it is for. */
void help_print(void);
void help_print_convert(void);
void help_print_man(void);
void help_print_options(void);

#endif
