/* The command line of whittle.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_OPTIONS_H
#define WHITTLE_SERVER_CLI_OPTIONS_H

#include <stdbool.h>

#include "core/base/status.h"
#include "core/params.h"

/* How the picture is shown on a terminal. */
enum preview_way { PREVIEW_NOT, PREVIEW_AUTO, PREVIEW_KITTY, PREVIEW_SIXEL, PREVIEW_BLOCKS };

struct command_options {
    struct params params;
    const char **input;   /* paths, or "-" for standard input: one cloud together; owned, the texts are argv's */
    size_t input_count;   /* at least 1 */
    const char *output;   /* where outputs go: a folder, one file, or "-" for standard output; borrowed from argv */
    bool output_named;    /* by the last of several names: files that are there stay */
    bool output_given;    /* by -o: files that are there are replaced */
    bool names_alone;     /* after --: what follows are names, whatever they begin with */
    bool to_standard;     /* output is "-": there is exactly one output, and messages go to standard error */
    char *tileset_folder; /* output is this, a folder of tiles; NULL: it isn't; owned */
    bool to_file;         /* output is the name of the one file */
    bool force;           /* files that are there are replaced */
    bool dry_run;         /* read the input, tell what would be done, write nothing */
    int progress_fd;      /* -1: none */
    bool summary;         /* print what was done */
    bool verbose;         /* and how long each stage took */
    bool json;            /* the report to standard output in its place */
    bool convert;         /* `whittle convert`: all points as they are */
    enum preview_way preview;
    bool memory_given;    /* by --memory */
    const char *scratch;  /* folder of tiles; NULL = not given; borrowed from argv */
    uint64_t tile_points; /* 0 = not given */
    bool outputs_given;   /* the parameter outputs was set, and isn't the default */
};

enum command_request {
    COMMAND_RUN,
    COMMAND_TOLD,   /* --help or --version was asked for and printed */
    COMMAND_REFUSED /* error says why */
};

/* Options and parameters are --name value or --name=value, with '-' for '_' as one likes; the rows of the parameters
 * come from the table in core/params.c.  `convert` as the first argument is the command of that name.  error->where is
 * the option as it was written. */
enum command_request command_options_parse(struct command_options *options, int argc, char **argv, struct error *error);

/* After parsing, whatever came of it. */
void command_options_done(struct command_options *options);

#endif
