/* The files that the commands read.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_INPUT_H
#define WHITTLE_SERVER_CLI_INPUT_H

#include <stddef.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/io/out/file_out.h"

/* Opens a file, or standard input for "-"; *input is the descriptor.  STATUS_IO where it isn't there, is a folder or
 * can't be opened: the exit status is WIRE_EXIT_NO_INPUT then. */
enum status command_input_open(const char *path, int *input, struct error *error) MUST_CHECK;

/* Closes it, unless it is standard input or -1. */
void command_input_close(int input);

/* The inputs of one run, which are one cloud.  They stay open until outputs have their names, so that they are told
 * from them.  Zero-initialise. */
struct command_inputs {
    size_t count;
    const char *const *name; /* count; borrowed */
    int *fd;                 /* count, -1 = not open; owned */
    size_t source_count;
    struct file_out_source *source; /* of the regular files among them; owned */
    const char *failed;             /* the one that an error is about; NULL = none of them */
};

/* Opens them.  As command_input_open, of the first that fails; STATUS_NO_MEMORY. */
enum status command_inputs_open(struct command_inputs *inputs, const char *const *name, size_t count,
                                struct error *error) MUST_CHECK;

/* Reads them as one cloud (core/io/join.h), for cloud_done.  STATUS_BAD_PARAMETER where their coordinate systems
 * differ; else as cloud_read.  progress may be NULL. */
enum status command_inputs_read(struct command_inputs *inputs, const struct cloud_limits *limits,
                                const struct progress *progress, struct cloud *cloud, struct error *error) MUST_CHECK;

/* Bytes of the regular files among them. */
uint64_t command_inputs_bytes(const struct command_inputs *inputs);

/* Closes them.  Accepts zeroed ones. */
void command_inputs_done(struct command_inputs *inputs);

#endif
