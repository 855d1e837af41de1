/* Clouds that don't fit into memory, in tiles on disk: by themselves, and step by step.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_TILES_H
#define WHITTLE_SERVER_CLI_TILES_H

#include <signal.h>
#include <stdbool.h>

#include "core/io/out/kept_file.h"
#include "core/pipeline/pipeline.h"
#include "server/cli/input.h"
#include "server/cli/options.h"
#include "server/cli/progress.h"

/* Whether the inputs (open) are to be simplified in tiles: they are of formats that are read part by part, they don't
 * fit, and tiles can do what is asked for.  STATUS_NO_MEMORY where memory was given, the inputs don't fit and neither
 * do tiles help. */
enum status command_tiles_needed(const struct command_options *options, const struct command_inputs *inputs,
                                 bool *needed, struct error *error) MUST_CHECK;

/* Says what it would take, as a dry run.  STATUS_NO_MEMORY where the run would be refused, as far as that is known. */
enum status command_tiles_foretell(const struct command_options *options, const struct command_inputs *inputs,
                                   struct error *error) MUST_CHECK;

/* Plans, runs and merges; says on standard error what it takes.  *cloud, *file and *result as of tiles_merge.  What is
 * done stays in the scratch folder where it is stopped or fails, and that is told. */
enum status command_tiles_simplify(const struct command_options *options, const struct command_inputs *inputs,
                                   struct command_progress *display, struct cloud *cloud, struct kept_file *file,
                                   struct pipeline_result *result, struct error *error) MUST_CHECK;

/* Removes the tiles, once the outputs have their names. */
void command_tiles_remove(const struct command_options *options);

/* whittle tiles plan|list|run|merge, and work, which the service starts (server/runner/spawn.c).  argv[0] is "tiles";
 * machine_bytes: of memory, where none is given.  Returns the
 * exit status. */
int command_tiles_main(int argc, char **argv, uint64_t machine_bytes, volatile sig_atomic_t *stopping);

#endif
