/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/worker_options.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/version.h"

enum { NAME_BYTES = 64 };

static const char *const own_options[] = {"output", "progress-fd", "quiet", "help", "version", NULL};

static void print_parameters(void) {
    size_t count;
    const struct param *table = params_table(&count);
    for (size_t i = 0; i < count; i++) {
        char allowed[256];
        params_allowed(&table[i], allowed, sizeof allowed);
        printf("  --%s\n        %s.\n        %s%s%s", table[i].name, table[i].help, allowed,
               table[i].unit[0] ? "; in " : "", table[i].unit);
        printf(table[i].default_text[0] ? "; default %s\n" : "\n", table[i].default_text);
    }
}

static void print_help(void) {
    puts("Usage: whittle INPUT [--parameter value ...] [-o FOLDER]\n"
         "       whittle measure A B [...]         distances between two clouds or meshes; see whittle measure --help\n"
         "\n"
         "Simplifies a point cloud (PLY or XYZ, told by its content; - is standard input), reconstructs a watertight\n"
         "mesh and measures the error. Writes cloud.ply, cloud.xyz, mesh.ply and report.json, as asked for by "
         "--outputs.\n"
         "\n"
         "Options:\n"
         "  -o, --output FOLDER\n        Where outputs go, made if it isn't there; default .\n"
         "  --progress-fd N\n        Tell progress and the end on this inherited descriptor, one line each.\n"
         "  -q, --quiet\n        Print no summary.\n"
         "  -h, --help, --version\n"
         "\n"
         "Parameters:");
    print_parameters();
    puts("\nExit status: 0 done; 2 a parameter is wrong; 65 the input is malformed, degenerate or over a limit;\n"
         "70 internal error; 71 out of memory; 74 reading or writing failed; 75 stopped by a signal.");
}

static enum worker_request refuse(struct error *error, const char *where, const char *text) {
    error_set(error, STATUS_BAD_PARAMETER, where, "%s", text);
    return WORKER_REFUSED;
}

static enum worker_request refuse_unknown(struct error *error, const char *name) {
    const char *near = params_suggest(name, own_options);
    error_set(error, STATUS_BAD_PARAMETER, name, "unknown option%s%s%s", near ? "; did you mean '" : "",
              near ? near : "", near ? "'?" : "");
    return WORKER_REFUSED;
}

/* Takes the option's value from after '=', or from the next argument.  NULL when there is none. */
static const char *take_value(int argc, char **argv, int *i) {
    char *equals = strchr(argv[*i], '=');
    if (equals && argv[*i][1] == '-') return equals + 1;
    return *i + 1 < argc ? argv[++*i] : NULL;
}

/* The name between the dashes and '=', with '_' for '-'. */
static void option_name(const char *argument, char name[NAME_BYTES]) {
    size_t length = strcspn(argument + 2, "=");
    snprintf(name, NAME_BYTES, "%.*s", (int)(length < NAME_BYTES ? length : NAME_BYTES - 1), argument + 2);
    for (char *c = name; *c; c++)
        if (*c == '-') *c = '_';
}

static enum worker_request set_own(struct worker_options *options, const char *name, const char *value,
                                   struct error *error) {
    if (strcmp(name, "output") == 0) {
        options->output = value;
        return WORKER_RUN;
    }
    char *end;
    long fd = strtol(value, &end, 10);
    if (end == value || *end || fd < 0 || fd > 1024) return refuse(error, name, "it takes the number of a descriptor");
    options->progress_fd = (int)fd;
    options->summary = false;
    return WORKER_RUN;
}

static enum worker_request parse_long(struct worker_options *options, int argc, char **argv, int *i,
                                      struct error *error) {
    char name[NAME_BYTES];
    option_name(argv[*i], name);
    bool own = strcmp(name, "output") == 0 || strcmp(name, "progress_fd") == 0;
    if (!own && !params_find(name)) return refuse_unknown(error, name);
    const char *value = take_value(argc, argv, i);
    if (!value) return refuse(error, name, "a value is missing");
    if (own) return set_own(options, name, value, error);
    return params_set(&options->params, name, value, error) ? WORKER_REFUSED : WORKER_RUN;
}

static enum worker_request parse_argument(struct worker_options *options, int argc, char **argv, int *i,
                                          struct error *error) {
    const char *argument = argv[*i];
    if (strcmp(argument, "-h") == 0 || strcmp(argument, "--help") == 0) return print_help(), WORKER_TOLD;
    if (strcmp(argument, "--version") == 0) return printf("whittle %s\n", whittle_version()), WORKER_TOLD;
    if (strcmp(argument, "-q") == 0 || strcmp(argument, "--quiet") == 0) {
        options->summary = false;
        return WORKER_RUN;
    }
    if (strcmp(argument, "-o") == 0) {
        options->output = take_value(argc, argv, i);
        return options->output ? WORKER_RUN : refuse(error, "-o", "a folder is missing");
    }
    if (strncmp(argument, "--", 2) == 0) return parse_long(options, argc, argv, i, error);
    if (argument[0] == '-' && argument[1]) return refuse_unknown(error, argument);
    if (options->input) return refuse(error, argument, "only one input can be given");
    options->input = argument;
    return WORKER_RUN;
}

enum worker_request worker_options_parse(struct worker_options *options, int argc, char **argv, struct error *error) {
    *options = (struct worker_options){.output = ".", .progress_fd = -1, .summary = true};
    params_defaults(&options->params);
    for (int i = 1; i < argc; i++) {
        enum worker_request request = parse_argument(options, argc, argv, &i, error);
        if (request != WORKER_RUN) return request;
    }
    if (!options->input) return refuse(error, "INPUT", "name a cloud, or - for standard input");
    return params_resolve(&options->params, error) ? WORKER_REFUSED : WORKER_RUN;
}
