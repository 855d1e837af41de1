/* What whittle leaves: files, a summary, an explanation.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_OUTPUT_H
#define WHITTLE_SERVER_CLI_OUTPUT_H

#include <stdio.h>

#include "core/io/out/kept_file.h"
#include "core/pipeline/pipeline.h"
#include "server/cli/input.h"
#include "server/cli/options.h"

/* Sets options->to_file where the output is the name of one file of a format that is written, and params.outputs to the
 * one that it is.  STATUS_BAD_PARAMETER where it can't be. */
enum status command_output_settle(struct command_options *options, struct error *error) MUST_CHECK;

/* A cloud whose faces most of its points have is a mesh: faces go out where the output has a format that holds them,
 * and
 * --outputs doesn't say what to write.  Returns whether that makes another file. */
bool command_output_follow_faces(struct command_options *options, const struct cloud *cloud);

/* For a conversion, once the input is read: the mesh's format where the cloud has faces and the file can hold them,
 * else the cloud's.  STATUS_BAD_PARAMETER where the format holds faces alone, and there are none. */
enum status command_output_settle_faces(struct command_options *options, const struct cloud *cloud,
                                        struct error *error) MUST_CHECK;

/* Whether all outputs can be written: asked before the work, not after it.  The folder is there and takes files, or can
 * be made; none of them is an input (where one of those can't be opened, the folder alone is looked at); none is there
 * already, unless options let them be replaced.  STATUS_IO, STATUS_BAD_PARAMETER. */
enum status command_output_check(const struct command_options *options, const struct command_inputs *inputs,
                                 struct error *error) MUST_CHECK;

/* Writes the outputs that were asked for into the folder, which is made where it isn't there, or the one output to its
 * file or to standard output.  Each file appears whole or not at all, and what was checked holds still as it gets its
 * name; report.json comes last.  What files can't hold is added to result->report.  STATUS_IO (error->where = the
 * file), STATUS_BAD_PARAMETER, STATUS_NO_MEMORY.
 *
 * file with a path: the kept points are in it (core/tiles/tiles.h), which a tileset alone is made of. */
enum status command_output_write(const struct command_options *options, const struct command_inputs *inputs,
                                 const struct cloud *cloud, const struct kept_file *file,
                                 struct pipeline_result *result, struct error *error) MUST_CHECK;

/* A few lines for people; the names of what was written among them. */
void command_output_summary(const struct command_options *options, const struct report *report, FILE *to);

/* The same of a conversion. */
void command_output_converted(const struct command_options *options, const struct cloud *cloud,
                              const struct left_out *left_out, FILE *to);

/* What a user should know before using the result, a line each, as "whittle: warning: ...": for who wants no summary.
 */
void command_output_warn(const struct report *report, FILE *to);

/* The names of the files, a line each, after this label; those that would be replaced are marked. */
void command_output_names(const struct command_options *options, const char *label, bool mark, FILE *to);

/* The same as a list of *count names, owned, each and all; NULL and 0 where the output is standard output. */
enum status command_output_list(const struct command_options *options, char ***name, size_t *count) MUST_CHECK;

/* "whittle: scan.ply: line 12: x: ..." */
void command_output_explain(const char *input, enum status status, const struct error *error, FILE *to);

#endif
