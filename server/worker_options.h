/* The command line of whittle.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_WORKER_OPTIONS_H
#define WHITTLE_SERVER_WORKER_OPTIONS_H

#include <stdbool.h>

#include "core/params.h"
#include "core/status.h"

struct worker_options {
    struct params params;
    const char *input;  /* a path, or "-" for standard input; borrowed from argv */
    const char *output; /* folder for the outputs, or "-" for standard output; borrowed from argv */
    bool to_standard;   /* output is "-": there is exactly one output, and messages go to standard error */
    int progress_fd;    /* -1: none */
    bool summary;       /* print what was done */
    bool outputs_given; /* the parameter outputs was set, and isn't the default */
};

enum worker_request {
    WORKER_RUN,
    WORKER_TOLD,   /* --help or --version was asked for and printed */
    WORKER_REFUSED /* error says why */
};

/* Parameters are --name value or --name=value, with '-' for '_' as one likes; the rows come from the table in
 * core/params.c. */
enum worker_request worker_options_parse(struct worker_options *options, int argc, char **argv, struct error *error);

#endif
