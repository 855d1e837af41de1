/* What whittle leaves: files, a summary, an explanation.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_WORKER_OUTPUT_H
#define WHITTLE_SERVER_WORKER_OUTPUT_H

#include <stdio.h>

#include "core/pipeline.h"
#include "server/worker_options.h"

/* Whether the outputs' folder is there and takes files, or can be made: asked before the work, not after it. STATUS_IO.
 */
enum status worker_output_check(const struct worker_options *options, struct error *error) MUST_CHECK;

/* Writes the outputs that were asked for into the folder, which is made where it isn't there, or the one output to
 * standard output.  Each file appears whole or not at all; report.json comes last.  What files can't hold is added to
 * result->report.  STATUS_IO (error->where = the file), STATUS_NO_MEMORY. */
enum status worker_output_write(const struct worker_options *options, const struct cloud *cloud,
                                struct pipeline_result *result, struct error *error) MUST_CHECK;

/* A few lines for people. */
void worker_output_summary(const struct report *report, FILE *to);

/* "whittle: scan.ply: line 12: x: ..." */
void worker_output_explain(const char *input, enum status status, const struct error *error, FILE *to);

#endif
