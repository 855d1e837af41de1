/* Parts of the command that only this room takes and a few lines declare.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_CLI_INTERNAL_H
#define WHITTLE_SERVER_CLI_CLI_INTERNAL_H

#include <stddef.h>
#include <stdio.h>

#include "core/cloud/cloud.h"
#include "core/pipeline/memory.h"
#include "server/cli/input.h"
#include "server/cli/options.h"

/* ------------------------------------------------------------------------------------------------ help.c */

/* What whittle tells of its own options. */

/* Writes text with the names of parameters as options have them, max-deviation for max_deviation; all else as it is. */
void help_hyphens(const char *text, char *out, size_t out_bytes);

/* To standard output: --help, of convert too; the manual page; a line for each option, for completion: its name, a tab,
 * what it takes (words with commas between, FILE, VALUE, or nothing), a tab, what it is for. */
void help_print(void);
void help_print_convert(void);
void help_print_man(void);
void help_print_options(void);

/* ------------------------------------------------------------------------------------------------ dry_run.c */

/* What whittle --dry-run tells. */

/* Tells of the cloud, which was read from these inputs, how many points would be kept, which files would be
 * written, how much memory that takes at most, and about how long, by a rule of thumb: only the service remembers jobs.
 * As text or as JSON, to standard output, or where that is the output's to standard error.  STATUS_IO,
 * STATUS_NO_MEMORY. */
enum status dry_run_print(const struct command_options *options, const struct cloud *cloud,
                          const struct command_inputs *inputs, struct error *error) MUST_CHECK;

/* The same of one that is made in tiles, by what its first bytes tell. */
enum status dry_run_print_tiles(const struct command_options *options, const char *format, const struct memory_job *job,
                                struct error *error) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ info.c */

/* whittle info FILE: what a cloud is. */

/* argv[0] is "info".  Returns the exit status. */
int command_info_main(int argc, char **argv);

/* ------------------------------------------------------------------------------------------------ measure.c */

/* The command `whittle measure`: how far two files are from each other. */

/* argv[0] is the command's name and isn't looked at; the rest are its arguments.  Prints to standard output, complaints
 * to standard error.  Returns the exit status; --help lists them. */
int command_measure_main(int argc, char **argv);

/* ------------------------------------------------------------------------------------------------ heap.c */

/* The memory of small jobs. */

/* Has the heap ready for a mesh of a cloud of so many points, which are few (memory_is_kept).  Whether it is changes
 * nothing but the time. */
void command_heap_prepare(size_t points);

/* ------------------------------------------------------------------------------------------------ exact_numbers.c */

/* Memory of the exact numbers that triangulations decide by where double can't (GMP's). */

/* Calls end() where there is no memory for one, in the thread that wants it; end() must not return.  Without it GMP
 * prints a line of its own and aborts.  For the whole process; before the first exact number. */
void command_exact_numbers_end_by(void (*end)(void));

#endif
