/* The command line of whittle: options of its own, and every row of core/params.c by its name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/options.h"

#include <ctype.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "core/base/version.h"
#include "core/params_written.h"
#include "server/cli/advice.h"
#include "server/cli/cli_internal.h"
#include "server/cli/output.h"

enum { NAME_BYTES = 64 };

enum own {
    OWN_OUTPUT,
    OWN_FORCE,
    OWN_DRY_RUN,
    OWN_MEMORY,
    OWN_SCRATCH,
    OWN_TILE_POINTS,
    OWN_PROGRESS_FD,
    OWN_PREVIEW,
    OWN_QUIET,
    OWN_VERBOSE,
    OWN_JSON,
    OWN_HELP,
    OWN_VERSION,
    OWN_MAN,
    OWN_LIST,
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
    [OWN_SCRATCH] = {"scratch", 0, true},
    [OWN_TILE_POINTS] = {"tile-points", 0, true},
    [OWN_PROGRESS_FD] = {"progress-fd", 0, true},
    [OWN_PREVIEW] = {"preview", 0, false},
    [OWN_QUIET] = {"quiet", 'q', false},
    [OWN_VERBOSE] = {"verbose", 'v', false},
    [OWN_JSON] = {"json", 0, false},
    [OWN_HELP] = {"help", 'h', false},
    [OWN_VERSION] = {"version", 'V', false},
    [OWN_MAN] = {"man", 0, false},
    [OWN_LIST] = {"list-options", 0, false},
};

static enum command_request refuse_option(struct error *error, const char *where, const char *text) {
    error_set(error, STATUS_BAD_PARAMETER, where, "%s", text);
    return COMMAND_REFUSED;
}

/* The option as it was written, without '=' and what follows. */
static const char *as_written(const char *argument, char written[ERROR_WHERE_BYTES]) {
    snprintf(written, ERROR_WHERE_BYTES, "%.*s", (int)strcspn(argument, "="), argument);
    return written;
}

/* Between the dashes and '=', with '_' for '-'. */
static void option_name(const char *argument, char name[NAME_BYTES]) {
    size_t length = strcspn(argument + 2, "=");
    snprintf(name, NAME_BYTES, "%.*s", (int)(length < NAME_BYTES ? length : NAME_BYTES - 1), argument + 2);
    for (char *c = name; *c; c++)
        if (*c == '-') *c = '_';
}

static enum command_request refuse_unknown(struct error *error, const char *argument, const char *name) {
    char written[ERROR_WHERE_BYTES];
    const char *names[OWN_COUNT + 1] = {NULL};
    for (int i = 0; i < OWN_COUNT; i++) names[i] = own_options[i].name;
    char option[NAME_BYTES] = "", named[NAME_BYTES] = "";
    char dashed[NAME_BYTES + 2];
    snprintf(dashed, sizeof dashed, "-%s", argument);
    if (!name && argument[2]) option_name(dashed, named); /* -ratio */
    const char *meant = name ? name : named, *way = advice_way(argument);
    if (way) return refuse_option(error, as_written(argument, written), way);
    const char *near = advice_option(argument);
    if (!near && meant[0]) near = params_find(meant) ? meant : params_suggest(meant, names);
    if (near) help_hyphens(near, option, sizeof option);
    error_set(error, STATUS_BAD_PARAMETER, as_written(argument, written), "unknown option%s%s%s",
              near ? "; did you mean '--" : "", option, near ? "'?" : "");
    return COMMAND_REFUSED;
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

/* A count of points over 0, as of --points. */
static bool parse_points(const char *text, uint64_t *points) {
    char digits[PARAMS_WRITTEN_BYTES], *end;
    text = params_written_count(text, digits);
    if (!isdigit((unsigned char)text[0])) return false;
    errno = 0;
    unsigned long long count = strtoull(text, &end, 10);
    if (errno || count == 0 || *end) return false;
    *points = (uint64_t)count;
    return true;
}

static enum command_request set_preview(struct command_options *options, const char *written, const char *way,
                                        struct error *error) {
    static const struct {
        const char *name;
        enum preview_way way;
    } ways[] = {{"auto", PREVIEW_AUTO}, {"kitty", PREVIEW_KITTY}, {"sixel", PREVIEW_SIXEL}, {"blocks", PREVIEW_BLOCKS}};
    for (size_t i = 0; i < sizeof ways / sizeof *ways; i++)
        if (strcmp(way ? way : "auto", ways[i].name) == 0) options->preview = ways[i].way;
    return options->preview ? COMMAND_RUN : refuse_option(error, written, "it takes auto, kitty, sixel or blocks");
}

static enum command_request set_own(struct command_options *options, enum own own, const char *written,
                                    const char *value, struct error *error) {
    switch (own) {
    case OWN_OUTPUT:
        options->output = value;
        options->output_given = true;
        return value[0] ? COMMAND_RUN : refuse_option(error, written, "a folder or a file is missing");
    case OWN_PROGRESS_FD: {
        char *end;
        long fd = strtol(value, &end, 10);
        if (end == value || *end || fd < 0 || fd > 1024)
            return refuse_option(error, written, "it takes the number of a descriptor");
        options->progress_fd = (int)fd;
        options->summary = false;
        return COMMAND_RUN;
    }
    case OWN_MEMORY:
        if (!parse_bytes(value, &options->params.memory_bytes))
            return refuse_option(error, written, "it takes a number of bytes over 0, as 4000M or 4G");
        options->memory_given = true;
        return COMMAND_RUN;
    case OWN_SCRATCH:
        options->scratch = value;
        return value[0] ? COMMAND_RUN : refuse_option(error, written, "a folder is missing");
    case OWN_TILE_POINTS:
        if (!parse_points(value, &options->tile_points))
            return refuse_option(error, written, "it takes a number of points over 0, as 500k or 8M");
        return COMMAND_RUN;
    case OWN_PREVIEW: return set_preview(options, written, value, error);
    case OWN_FORCE: options->force = true; return COMMAND_RUN;
    case OWN_DRY_RUN: options->dry_run = true; return COMMAND_RUN;
    case OWN_QUIET: options->summary = false; return COMMAND_RUN;
    case OWN_VERBOSE: options->verbose = true; return COMMAND_RUN;
    case OWN_JSON: options->json = true; return COMMAND_RUN;
    case OWN_HELP: options->convert ? help_print_convert() : help_print(); return COMMAND_TOLD;
    case OWN_VERSION: printf("whittle %s\n", whittle_version()); return COMMAND_TOLD;
    case OWN_MAN: help_print_man(); return COMMAND_TOLD;
    case OWN_LIST: help_print_options(); return COMMAND_TOLD;
    case OWN_COUNT: break;
    }
    return refuse_option(error, written, "unknown option");
}

static enum command_request parse_own(struct command_options *options, enum own own, int argc, char **argv, int *i,
                                      struct error *error) {
    char written[ERROR_WHERE_BYTES];
    const char *argument = argv[*i];
    as_written(argument, written);
    if (options->convert && (own == OWN_MEMORY || own == OWN_SCRATCH || own == OWN_TILE_POINTS))
        return refuse_option(error, written,
                             "all points are converted at once, in as much memory as they take; use whittle INPUT "
                             "OUTPUT --ratio 1, without convert, for tiles");
    if (!own_options[own].valued) {
        const char *equals = argument[1] == '-' ? strchr(argument, '=') : NULL;
        if (equals && own == OWN_PREVIEW) return set_own(options, own, written, equals + 1, error);
        if (equals) return refuse_option(error, written, "it takes no value");
        return set_own(options, own, written, NULL, error);
    }
    const char *value = take_value(argc, argv, i);
    return value ? set_own(options, own, written, value, error) : refuse_option(error, written, "a value is missing");
}

/* What says how a file is read and written, and which part of it. */
static bool converts_with(const char *name) {
    static const char *const names[] = {"crop",          "where",  "columns", "encoding",  "colours",
                                        "pcd_precision", "header", "outputs", "properties"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(names[i], name) == 0) return true;
    return false;
}

static enum command_request refuse_missing(struct error *error, const char *written, const char *name) {
    char allowed[PARAMS_ALLOWED_BYTES];
    params_allowed(params_find(name), allowed, sizeof allowed);
    error_set(error, STATUS_BAD_PARAMETER, written, "a value is missing; it takes %s", allowed);
    return COMMAND_REFUSED;
}

static enum command_request parse_parameter(struct command_options *options, int argc, char **argv, int *i,
                                            struct error *error) {
    char name[NAME_BYTES], written[ERROR_WHERE_BYTES];
    const char *argument = argv[*i];
    option_name(argument, name);
    if (!params_find(name)) return refuse_unknown(error, argument, name);
    if (options->convert && !converts_with(name))
        return refuse_option(
            error, as_written(argument, written),
            "all points are converted as they are; use whittle INPUT OUTPUT, without convert, to simplify");
    const char *value = take_value(argc, argv, i);
    if (!value) return refuse_missing(error, as_written(argument, written), name);
    if (strcmp(name, "outputs") == 0) options->outputs_given = true;
    enum status status = params_set(&options->params, name, value, error);
    if (status != STATUS_OK) advice_on_value(params_find(name), value, *i + 1 < argc ? argv[*i + 1] : NULL, error);
    return status != STATUS_OK ? COMMAND_REFUSED : COMMAND_RUN;
}

static enum command_request parse_argument(struct command_options *options, int argc, char **argv, int *i,
                                           struct error *error) {
    const char *argument = argv[*i];
    bool is_option = argument[0] == '-' && argument[1] && !options->names_alone;
    if (is_option && strcmp(argument, "--") == 0) {
        options->names_alone = true;
        return COMMAND_RUN;
    }
    if (is_option) {
        enum own own = find_own(argument);
        if (own != OWN_COUNT) return parse_own(options, own, argc, argv, i, error);
        if (argument[1] != '-') return refuse_unknown(error, argument, NULL);
        return parse_parameter(options, argc, argv, i, error);
    }
    if (!argument[0]) return refuse_option(error, options->input_count ? "OUTPUT" : "INPUT", "a name is missing");
    options->input[options->input_count++] = argument;
    return COMMAND_RUN;
}

/* Whether a number stands where the output's name should. */
static bool is_value(const char *name) {
    char *end;
    strtod(name, &end);
    return end > name && (!*end || strcmp(end, "%") == 0);
}

/* Words before the names, as other programs have them. */
static bool is_no_command(const struct command_options *options) {
    const char *first = options->input[0];
    return !options->convert && options->input_count > 1 && !strpbrk(first, "./-") && access(first, F_OK) != 0;
}

static enum command_request refuse_value(struct error *error, const char *value) {
    error_set(error, STATUS_BAD_PARAMETER, "OUTPUT",
              "%s is a value without its option; use --ratio 0.1, and commas in lists, as --levels 0.4,0.2", value);
    return COMMAND_REFUSED;
}

/* The last of several names is the output, unless -o says where that is. */
static enum command_request settle_names(struct command_options *options, struct error *error) {
    size_t standard = 0;
    options->output_named = options->input_count > 1 && !options->output_given;
    if (options->output_named) options->output = options->input[--options->input_count];
    for (size_t i = 0; i < options->input_count; i++) standard += strcmp(options->input[i], "-") == 0;
    if (options->output_named && is_value(options->output)) return refuse_value(error, options->output);
    for (size_t i = 0; i < options->input_count + options->output_named; i++)
        if (advice_on_name(options->input[i], error)) return COMMAND_REFUSED;
    if (options->input_count && is_no_command(options))
        return refuse_option(error, options->input[0],
                             "no such file and no such command; use whittle INPUT OUTPUT.ply to simplify, or info, "
                             "convert, measure");
    if (!options->input_count) return refuse_option(error, "INPUT", "use the name of a cloud, or - for standard input");
    return standard > 1 ? refuse_option(error, "-", "standard input is one input, not several") : COMMAND_RUN;
}

/* Standard output takes exactly one output: false where more are asked for. */
static bool settle_standard(struct command_options *options) {
    options->to_standard = true;
    if (!options->outputs_given) options->params.outputs = OUTPUT_CLOUD;
    uint32_t outputs = options->params.outputs;
    return (outputs & (outputs - 1)) == 0 && !options->params.levels.count;
}

static enum command_request settle_conversion(struct command_options *options, struct error *error) {
    if (options->json) return refuse_option(error, "--json", "a conversion has no report; use whittle info --json");
    if (strcmp(options->output, ".") == 0)
        return refuse_option(error, "OUTPUT", "use whittle convert INPUT OUTPUT.ply");
    if (strcmp(options->output, "-") == 0 && (!options->outputs_given || !settle_standard(options)))
        return refuse_option(error, "-o", "use --outputs to name the one format of standard output, as cloud.pcd");
    if (!options->to_standard && command_output_settle(options, error)) return COMMAND_REFUSED;
    if (!options->to_standard && !options->to_file)
        return refuse_option(error, options->output, "use a name with the format's end, as scan.ply");
    if (!(options->params.outputs & (OUTPUT_ANY_CLOUD | OUTPUT_ANY_MESH)))
        return refuse_option(error, options->output, "no cloud and no mesh; use another format");
    options->params.ratio = 1;
    return params_resolve(&options->params, error) ? COMMAND_REFUSED : COMMAND_RUN;
}

static enum command_request parse_all(struct command_options *options, int argc, char **argv, struct error *error) {
    for (int i = 1; i < argc; i++) {
        enum command_request request = parse_argument(options, argc, argv, &i, error);
        if (request != COMMAND_RUN) return request;
    }
    enum command_request names = settle_names(options, error);
    if (names != COMMAND_RUN) return names;
    if (options->convert && options->preview)
        return refuse_option(error, "--preview", "a conversion has no deviation to show");
    if (options->convert) return settle_conversion(options, error);
    if (options->json && strcmp(options->output, "-") == 0)
        return refuse_option(error, "--json", "the output is on standard output already; use -o FILE");
    if (options->preview) options->params.outputs |= OUTPUT_PREVIEW, options->outputs_given = true;
    if (strcmp(options->output, "-") == 0) {
        if (!settle_standard(options))
            return refuse_option(error, "-o",
                                 "standard output takes one output, of one level; use --outputs to name one");
    } else if (command_output_settle(options, error)) {
        return COMMAND_REFUSED;
    }
    return params_resolve(&options->params, error) ? COMMAND_REFUSED : COMMAND_RUN;
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

enum command_request command_options_parse(struct command_options *options, int argc, char **argv,
                                           struct error *error) {
    bool convert = argc > 1 && strcmp(argv[1], "convert") == 0;
    *options = (struct command_options){.output = ".", .progress_fd = -1, .summary = true, .convert = convert};
    params_defaults(&options->params);
    options->input = calloc((size_t)argc, sizeof *options->input);
    if (!options->input) return refuse_option(error, "INPUT", "no memory for names");
    enum command_request request = parse_all(options, argc - convert, argv + convert, error);
    if (request != COMMAND_REFUSED) return request;
    char text[ERROR_TEXT_BYTES];
    help_hyphens(error->text, text, sizeof text);
    memcpy(error->text, text, sizeof text);
    call_as_written(argc, argv, error);
    return request;
}

void command_options_done(struct command_options *options) {
    free(options->input), free(options->tileset_folder);
    options->tileset_folder = NULL;
    options->input = NULL, options->input_count = 0;
}
