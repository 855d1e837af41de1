/* The command line of whittle: options of its own, and every row of core/params.c by its name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/worker_options.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/version.h"
#include "server/roff.h"

enum { NAME_BYTES = 64 };

static const char *const own_options[] = {"output", "progress-fd", "quiet", "help", "version", "man", NULL};

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
    puts(
        "Usage: whittle INPUT [--parameter value ...] [-o FOLDER]\n"
        "       whittle INPUT [--parameter value ...] [--outputs ONE] -o -      in a pipe\n"
        "       whittle measure A B [...]         distances between two clouds or meshes; see whittle measure --help\n"
        "\n"
        "Simplifies a point cloud, reconstructs a watertight mesh and measures the error. INPUT is PLY, PCD, OBJ, "
        "OFF,\n"
        "STL, LAS or text (XYZ, CSV), each also compressed by gzip or zstd, told by its content; - is standard input.\n"
        "Faces of the input become the surface that the mesh is measured against. Writes what --outputs asks for;\n"
        "report.json says what an output could not hold of the input.\n"
        "\n"
        "Options:\n"
        "  -o, --output FOLDER\n        Where outputs go, made if it isn't there; default .\n"
        "        - writes one output to standard output (--outputs names it; default the cloud), and the summary to\n"
        "        standard error.\n"
        "  --progress-fd N\n        Tell progress and the end on this inherited descriptor, one line each.\n"
        "  -q, --quiet\n        Print no summary.\n"
        "  -h, --help, --version, --man\n"
        "\n"
        "Parameters:");
    print_parameters();
    puts("\nExit status: 0 done; 2 a parameter is wrong; 65 the input is malformed, degenerate or over a limit;\n"
         "70 internal error; 71 out of memory; 74 reading or writing failed; 75 stopped by a signal.");
}

static void print_man_parameters(void) {
    size_t count;
    const struct param *table = params_table(&count);
    for (size_t i = 0; i < count; i++) {
        char allowed[256];
        params_allowed(&table[i], allowed, sizeof allowed);
        printf(".TP\n\\fB\\-\\-%s\\fR \\fIvalue\\fR\n", table[i].name);
        roff_print(table[i].help);
        puts(".");
        printf("Takes ");
        roff_print(allowed);
        if (table[i].unit[0]) printf(", in %s", table[i].unit);
        printf(table[i].default_text[0] ? "; default %s.\n" : ".\n", table[i].default_text);
    }
}

static void print_man(void) {
    printf(".\\\" SPDX-License-Identifier: GPL-3.0-or-later\n.TH WHITTLE 1 \"\" \"whittle %s\" \"whittle\"\n",
           whittle_version());
    puts(".SH NAME\nwhittle \\- make point clouds small and keep their features\n.SH SYNOPSIS\n.B whittle\n"
         ".I input\n.RI [ \\-\\-parameter\\~value \"...] [\" \\-o\\~folder ]\n.br\n.B whittle measure\n.I a b\n"
         ".SH DESCRIPTION\nSimplifies a point cloud, reconstructs a watertight mesh of it where asked for, and "
         "measures\n"
         "the error.  The kind of the input is told by its content; \\- is standard input.\n"
         "What is written,\n.B \\-\\-outputs\nsays; the points of a cloud come in the order of their importance.\n.PP\n"
         ".B whittle measure\nprints the distances between two clouds or meshes; see its \\-\\-help.\n"
         ".SH OPTIONS\n.TP\n\\fB\\-o\\fR, \\fB\\-\\-output\\fR \\fIfolder\\fR\n"
         "Where outputs go; it is made if it isn't there.  Default: the present folder.\n"
         ".TP\n\\fB\\-\\-progress\\-fd\\fR \\fIn\\fR\n"
         "Tell progress and the end on this inherited descriptor, a line each.\n"
         ".TP\n\\fB\\-q\\fR, \\fB\\-\\-quiet\\fR\nPrint no summary.\n"
         ".TP\n\\fB\\-h\\fR, \\fB\\-\\-help\\fR, \\fB\\-\\-version\\fR, \\fB\\-\\-man\\fR\n"
         "Tell the options, the version, or print this page.\n.SH PARAMETERS");
    print_man_parameters();
    puts(".SH EXIT STATUS\n0 done; 2 a parameter is wrong; 65 the input is malformed, degenerate or over a limit; 70 "
         "internal\nerror; 71 out of memory; 74 reading or writing failed; 75 stopped by a signal.\n"
         ".SH EXAMPLES\n.EX\nwhittle scan.ply \\-\\-ratio 0.1 \\-\\-outputs cloud,mesh,report \\-o out/\n"
         "whittle measure out/mesh.ply scan.ply\n.EE\n.SH SEE ALSO\n.BR whittled (8)");
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
    if (strcmp(name, "outputs") == 0) options->outputs_given = true;
    return params_set(&options->params, name, value, error) ? WORKER_REFUSED : WORKER_RUN;
}

static enum worker_request parse_argument(struct worker_options *options, int argc, char **argv, int *i,
                                          struct error *error) {
    const char *argument = argv[*i];
    if (strcmp(argument, "-h") == 0 || strcmp(argument, "--help") == 0) return print_help(), WORKER_TOLD;
    if (strcmp(argument, "--man") == 0) return print_man(), WORKER_TOLD;
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

/* Standard output takes exactly one output: false where more are asked for. */
static bool settle_standard(struct worker_options *options) {
    options->to_standard = true;
    if (!options->outputs_given) options->params.outputs = OUTPUT_CLOUD;
    uint32_t outputs = options->params.outputs;
    return (outputs & (outputs - 1)) == 0 && !options->params.levels.count;
}

enum worker_request worker_options_parse(struct worker_options *options, int argc, char **argv, struct error *error) {
    *options = (struct worker_options){.output = ".", .progress_fd = -1, .summary = true};
    params_defaults(&options->params);
    for (int i = 1; i < argc; i++) {
        enum worker_request request = parse_argument(options, argc, argv, &i, error);
        if (request != WORKER_RUN) return request;
    }
    if (!options->input) return refuse(error, "INPUT", "name a cloud, or - for standard input");
    if (!options->output[0]) return refuse(error, "-o", "a folder is missing");
    if (strcmp(options->output, "-") == 0 && !settle_standard(options))
        return refuse(error, "-o", "standard output takes one output, of one level; name one by --outputs");
    return params_resolve(&options->params, error) ? WORKER_REFUSED : WORKER_RUN;
}
