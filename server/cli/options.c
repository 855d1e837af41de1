/* The command line of whittle: options of its own, and every row of core/params.c by its name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/options.h"

#include <ctype.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/version.h"
#include "core/io/sniff.h"
#include "server/cli/output.h"
#include "server/shared/roff.h"

enum { NAME_BYTES = 64 };

enum own {
    OWN_OUTPUT,
    OWN_FORCE,
    OWN_DRY_RUN,
    OWN_MEMORY,
    OWN_PROGRESS_FD,
    OWN_QUIET,
    OWN_HELP,
    OWN_VERSION,
    OWN_MAN,
    OWN_COUNT
};

/* What isn't a parameter. */
static const struct own_option {
    const char *name;
    char letter; /* 0: none */
    bool valued;
} own_options[OWN_COUNT] = {
    [OWN_OUTPUT] = {"output", 'o', true},
    [OWN_FORCE] = {"force", 'f', false},
    [OWN_DRY_RUN] = {"dry-run", 'n', false},
    [OWN_MEMORY] = {"memory", 0, true},
    [OWN_PROGRESS_FD] = {"progress-fd", 0, true},
    [OWN_QUIET] = {"quiet", 'q', false},
    [OWN_HELP] = {"help", 'h', false},
    [OWN_VERSION] = {"version", 0, false},
    [OWN_MAN] = {"man", 0, false},
};

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
    puts("Usage: whittle INPUT [--parameter value ...] [-o FOLDER/]         cloud.ply, report.json ...\n"
         "       whittle INPUT [--parameter value ...] -o FILE.ply          one file\n"
         "       whittle INPUT [--parameter value ...] [--outputs ONE] -o - in a pipe\n"
         "       whittle measure A B [...]      distances between two clouds or meshes; see whittle measure --help\n"
         "\n"
         "Simplifies a point cloud, reconstructs a watertight mesh and measures the error.");
    printf("INPUT is %s (also CSV), compressed by gzip or zstd or not,\n", cloud_sniff_titles());
    puts(
        "told by its content; - is standard input. Faces of the input become the surface that the mesh is measured\n"
        "against. Writes what --outputs asks for; report.json says what an output could not hold of the input.\n"
        "\n"
        "Options:\n"
        "  -o, --output FOLDER|FILE|-\n        Where outputs go; files that are there are replaced. Default: the "
        "present folder, where none is.\n"
        "        A name that ends in .ply, .xyz, .pcd, .obj, .stl, .glb or .json is one file of that format: of the\n"
        "        cloud, or of what --outputs names. Any other name is a folder, made if it isn't there.\n"
        "        - writes one output to standard output (--outputs names it; default the cloud), and the summary to\n"
        "        standard error. The input is never replaced.\n"
        "  -f, --force\n        Replace files that are there without -o, too.\n"
        "  -n, --dry-run\n        Read the input and tell what would be kept and written, and the memory that it takes "
        "at most;\n        write nothing.\n"
        "  --memory BYTES\n        The memory that may be used, as 4000000000, 4000M or 4G: more tetrahedra than it "
        "has room "
        "for are\n        refused, as points along lines have. Default: that of the machine, or of ulimit.\n"
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
         ".I input\n.RI [ \\-\\-parameter\\~value \"...] [\" \\-o\\~output ]\n.br\n.B whittle measure\n.I a b\n"
         ".SH DESCRIPTION\nSimplifies a point cloud, reconstructs a watertight mesh of it where asked for, and "
         "measures\n"
         "the error.  The kind of the input is told by its content; \\- is standard input.\n"
         "What is written,\n.B \\-\\-outputs\nsays; the points of a cloud come in the order of their importance.\n.PP\n"
         ".B whittle measure\nprints the distances between two clouds or meshes; see its \\-\\-help.\n"
         ".SH OPTIONS\n.TP\n\\fB\\-o\\fR, \\fB\\-\\-output\\fR \\fIfolder\\fR|\\fIfile\\fR|\\-\n"
         "Where outputs go; files that are there are replaced.  Default: the present folder, where none is.\n"
         "A name that ends in that of a format, as in small.ply, is one file: of the cloud, or of what\n"
         ".B \\-\\-outputs\nnames.  Any other is a folder, which is made if it isn't there; \\- is standard output.\n"
         "The input is never replaced.\n"
         ".TP\n\\fB\\-f\\fR, \\fB\\-\\-force\\fR\nReplace files that are there without\n.BR \\-o ,\ntoo.\n"
         ".TP\n\\fB\\-n\\fR, \\fB\\-\\-dry\\-run\\fR\n"
         "Read the input and tell what would be kept and written, and the memory that it takes at most; write "
         "nothing.\n"
         ".TP\n\\fB\\-\\-memory\\fR \\fIbytes\\fR\n"
         "The memory that may be used, as 4000000000, 4000M or 4G: more tetrahedra than it has room for are refused, "
         "as\npoints along lines have.  Default: that of the machine, or of ulimit.\n"
         ".TP\n\\fB\\-\\-progress\\-fd\\fR \\fIn\\fR\n"
         "Tell progress and the end on this inherited descriptor, a line each.\n"
         ".TP\n\\fB\\-q\\fR, \\fB\\-\\-quiet\\fR\nPrint no summary.\n"
         ".TP\n\\fB\\-h\\fR, \\fB\\-\\-help\\fR, \\fB\\-\\-version\\fR, \\fB\\-\\-man\\fR\n"
         "Tell the options, the version, or print this page.\n.SH PARAMETERS");
    print_man_parameters();
    puts(".SH EXIT STATUS\n0 done; 2 a parameter is wrong; 65 the input is malformed, degenerate or over a limit; 70 "
         "internal\nerror; 71 out of memory; 74 reading or writing failed; 75 stopped by a signal.\n"
         ".SH EXAMPLES\n.EX\nwhittle scan.ply \\-\\-ratio 0.1 \\-\\-outputs cloud,mesh,report \\-o out/\n"
         "whittle scan.ply \\-\\-ratio 0.05 \\-o small.ply\n"
         "whittle measure out/mesh.ply scan.ply\n.EE\n.SH SEE ALSO\n.BR whittled (8)");
}

static enum worker_request refuse(struct error *error, const char *where, const char *text) {
    error_set(error, STATUS_BAD_PARAMETER, where, "%s", text);
    return WORKER_REFUSED;
}

/* The option as it was written, without '=' and what follows. */
static const char *as_written(const char *argument, char written[ERROR_WHERE_BYTES]) {
    snprintf(written, ERROR_WHERE_BYTES, "%.*s", (int)strcspn(argument, "="), argument);
    return written;
}

static enum worker_request refuse_unknown(struct error *error, const char *argument, const char *name) {
    char written[ERROR_WHERE_BYTES];
    const char *names[OWN_COUNT + 1] = {NULL};
    for (int i = 0; i < OWN_COUNT; i++) names[i] = own_options[i].name;
    const char *near = name ? params_suggest(name, names) : NULL;
    error_set(error, STATUS_BAD_PARAMETER, as_written(argument, written), "unknown option%s%s%s",
              near ? "; did you mean '--" : "", near ? near : "", near ? "'?" : "");
    return WORKER_REFUSED;
}

/* Between the dashes and '=', with '_' for '-'. */
static void option_name(const char *argument, char name[NAME_BYTES]) {
    size_t length = strcspn(argument + 2, "=");
    snprintf(name, NAME_BYTES, "%.*s", (int)(length < NAME_BYTES ? length : NAME_BYTES - 1), argument + 2);
    for (char *c = name; *c; c++)
        if (*c == '-') *c = '_';
}

/* By its letter or its name; OWN_COUNT: none. */
static enum own find_own(const char *argument) {
    char name[NAME_BYTES], own[NAME_BYTES + 2];
    bool is_long = argument[1] == '-';
    if (is_long) option_name(argument, name);
    for (int i = 0; i < OWN_COUNT; i++) {
        snprintf(own, sizeof own, "--%s", own_options[i].name);
        option_name(own, own);
        bool same = is_long ? strcmp(name, own) == 0 : argument[1] == own_options[i].letter && !argument[2];
        if (same) return (enum own)i;
    }
    return OWN_COUNT;
}

/* The option's value, from after '=' or from the next argument; NULL when there is none. */
static const char *take_value(int argc, char **argv, int *i) {
    char *equals = strchr(argv[*i], '=');
    if (equals && argv[*i][1] == '-') return equals + 1;
    return *i + 1 < argc ? argv[++*i] : NULL;
}

/* A count of bytes over 0, with K, M, G or T for powers of 1024. */
static bool parse_bytes(const char *text, uint64_t *bytes) {
    static const char units[] = "KMGT";
    char *end;
    if (!isdigit((unsigned char)text[0])) return false;
    errno = 0;
    unsigned long long count = strtoull(text, &end, 10);
    const char *unit = *end ? strchr(units, *end) : NULL;
    unsigned shift = unit ? 10 * (unsigned)(unit - units + 1) : 0;
    if (errno || count == 0 || end[unit ? 1 : 0] || count > UINT64_MAX >> shift) return false;
    *bytes = (uint64_t)count << shift;
    return true;
}

static enum worker_request set_own(struct worker_options *options, enum own own, const char *written, const char *value,
                                   struct error *error) {
    switch (own) {
    case OWN_OUTPUT:
        options->output = value;
        options->output_given = true;
        return value[0] ? WORKER_RUN : refuse(error, written, "a folder or a file is missing");
    case OWN_PROGRESS_FD: {
        char *end;
        long fd = strtol(value, &end, 10);
        if (end == value || *end || fd < 0 || fd > 1024)
            return refuse(error, written, "it takes the number of a descriptor");
        options->progress_fd = (int)fd;
        options->summary = false;
        return WORKER_RUN;
    }
    case OWN_MEMORY:
        if (!parse_bytes(value, &options->params.memory_bytes))
            return refuse(error, written, "it takes a number of bytes over 0, as 4000M or 4G");
        options->memory_given = true;
        return WORKER_RUN;
    case OWN_FORCE: options->force = true; return WORKER_RUN;
    case OWN_DRY_RUN: options->dry_run = true; return WORKER_RUN;
    case OWN_QUIET: options->summary = false; return WORKER_RUN;
    case OWN_HELP: print_help(); return WORKER_TOLD;
    case OWN_VERSION: printf("whittle %s\n", whittle_version()); return WORKER_TOLD;
    case OWN_MAN: print_man(); return WORKER_TOLD;
    case OWN_COUNT: break;
    }
    return refuse(error, written, "unknown option");
}

static enum worker_request parse_own(struct worker_options *options, enum own own, int argc, char **argv, int *i,
                                     struct error *error) {
    char written[ERROR_WHERE_BYTES];
    const char *argument = argv[*i];
    as_written(argument, written);
    if (!own_options[own].valued) {
        if (argument[1] == '-' && strchr(argument, '=')) return refuse(error, written, "it takes no value");
        return set_own(options, own, written, NULL, error);
    }
    const char *value = take_value(argc, argv, i);
    return value ? set_own(options, own, written, value, error) : refuse(error, written, "a value is missing");
}

static enum worker_request parse_parameter(struct worker_options *options, int argc, char **argv, int *i,
                                           struct error *error) {
    char name[NAME_BYTES], written[ERROR_WHERE_BYTES];
    const char *argument = argv[*i];
    option_name(argument, name);
    if (!params_find(name)) return refuse_unknown(error, argument, name);
    const char *value = take_value(argc, argv, i);
    if (!value) return refuse(error, as_written(argument, written), "a value is missing");
    if (strcmp(name, "outputs") == 0) options->outputs_given = true;
    return params_set(&options->params, name, value, error) ? WORKER_REFUSED : WORKER_RUN;
}

static enum worker_request parse_argument(struct worker_options *options, int argc, char **argv, int *i,
                                          struct error *error) {
    const char *argument = argv[*i];
    if (argument[0] == '-' && argument[1]) {
        enum own own = find_own(argument);
        if (own != OWN_COUNT) return parse_own(options, own, argc, argv, i, error);
        if (argument[1] != '-') return refuse_unknown(error, argument, NULL);
        return parse_parameter(options, argc, argv, i, error);
    }
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

static enum worker_request parse_all(struct worker_options *options, int argc, char **argv, struct error *error) {
    for (int i = 1; i < argc; i++) {
        enum worker_request request = parse_argument(options, argc, argv, &i, error);
        if (request != WORKER_RUN) return request;
    }
    if (!options->input) return refuse(error, "INPUT", "name a cloud, or - for standard input");
    if (strcmp(options->output, "-") == 0) {
        if (!settle_standard(options))
            return refuse(error, "-o", "standard output takes one output, of one level; name one by --outputs");
    } else if (worker_output_settle(options, error)) {
        return WORKER_REFUSED;
    }
    return params_resolve(&options->params, error) ? WORKER_REFUSED : WORKER_RUN;
}

/* What is said of a parameter is said of the option as it was written. */
static void call_as_written(int argc, char **argv, struct error *error) {
    char name[NAME_BYTES];
    for (int i = 1; i < argc; i++) {
        if (strncmp(argv[i], "--", 2) != 0) continue;
        option_name(argv[i], name);
        if (strcmp(name, error->where) != 0) continue;
        as_written(argv[i], error->where);
        return;
    }
}

enum worker_request worker_options_parse(struct worker_options *options, int argc, char **argv, struct error *error) {
    *options = (struct worker_options){.output = ".", .progress_fd = -1, .summary = true};
    params_defaults(&options->params);
    enum worker_request request = parse_all(options, argc, argv, error);
    if (request == WORKER_REFUSED) call_as_written(argc, argv, error);
    return request;
}
