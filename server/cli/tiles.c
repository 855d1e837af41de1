/* Clouds that don't fit into memory.
 *
 *     whittle big.laz small.laz --ratio 0.01 --memory 4G               all by itself, in one process
 *     whittle tiles plan big.laz --ratio 0.01 --memory 4G --scratch work
 *     whittle tiles list --scratch work                                the numbers of the tiles that aren't done
 *     whittle tiles run 7 --scratch work                               in any order, on any host that has the folder
 *     whittle tiles merge small.laz --scratch work
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/tiles.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/clock.h"
#include "core/base/process_memory.h"
#include "core/cloud/colour_depth.h"
#include "core/cloud/leave_properties.h"
#include "core/cloud/normals.h"
#include "core/cloud/select.h"
#include "core/io/codec/inflate.h"
#include "core/io/out/file_out.h"
#include "core/io/out/las_write.h"
#include "core/io/out/sink.h"
#include "core/io/sniff.h"
#include "core/io/stream.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline.h"
#include "core/tiles/tiles.h"
#include "server/cli/cli_internal.h"
#include "server/cli/input.h"
#include "server/cli/no_new_code.h"
#include "server/cli/output.h"
#include "server/shared/worker_protocol.h"

enum { FIRST_BYTES = INFLATE_HEAD_BYTES, FOLDER_BYTES = 4000 };
enum { MOST_REPEATED = 3 /* times that what is damaged on the disk is made again */ };
static const double PLAN_SHARE = 0.3, RUN_SHARE = 0.85, END_SHARE = 0.9; /* of the whole, at whose end each is */

/* ------------------------------------------------------------------------------------------------ by themselves */

/* What is known of an input by its first bytes; false: too little, or it isn't read part by part. */
static bool look_at_input(int input, struct memory_job *job) {
    unsigned char *first = alloc_array(FIRST_BYTES, 1), *unpacked = alloc_array(FIRST_BYTES, 1), *begin = first;
    struct stat about;
    enum inflate_kind kind;
    bool regular = first && unpacked && fstat(input, &about) == 0 && S_ISREG(about.st_mode) && about.st_size > 0;
    ssize_t n = regular ? pread(input, first, FIRST_BYTES, 0) : 0;
    size_t there = n > 0 ? (size_t)n : 0;
    uint64_t total = regular ? (uint64_t)about.st_size : 0;
    bool read_whole = total <= FIRST_BYTES;
    if (there && inflate_sniff(first, there, &kind)) {
        there = inflate_beginning(kind, first, there, unpacked, FIRST_BYTES, &total);
        begin = unpacked;
    }
    enum cloud_kind is = cloud_sniff(begin, there).kind;
    bool has_header = is == CLOUD_KIND_PLY || is == CLOUD_KIND_PCD || is == CLOUD_KIND_LAS; /* which knows better */
    uint64_t known_total = total;
    if (begin == unpacked && has_header) known_total = read_whole && there < FIRST_BYTES ? there : UINT64_MAX;
    bool known = there && cloud_kind_has_parts(is) && memory_job_of(begin, there, known_total, job) == STATUS_OK;
    if (begin == unpacked) job->input_bytes = total;
    free(first), free(unpacked);
    return known;
}

/* The same of all of them together. */
static bool look_at_inputs(const struct command_inputs *inputs, struct memory_job *all) {
    *all = (struct memory_job){0};
    for (size_t i = 0; i < inputs->count; i++) {
        struct memory_job one;
        if (!look_at_input(inputs->fd[i], &one)) return false;
        all->points += one.points;
        all->faces += one.faces;
        all->faces_most += one.faces_most;
        if (one.record_bytes > all->record_bytes) all->record_bytes = one.record_bytes;
        if (one.input_bytes > all->input_bytes) all->input_bytes = one.input_bytes;
    }
    return true;
}

/* A file that is compressed, or a PCD that is within: neither is read part by part before there is a folder. */
enum packed { PACKED_NOT, PACKED_WHOLE, PACKED_WITHIN };

static enum packed packed_how(int input) {
    unsigned char first[4096];
    enum inflate_kind kind;
    ssize_t n = pread(input, first, sizeof first, 0);
    if (n <= 0) return PACKED_NOT;
    if (inflate_sniff(first, (size_t)n, &kind)) return PACKED_WHOLE;
    return strcmp(cloud_sniff(first, (size_t)n).form, "pcd/binary_compressed") == 0 ? PACKED_WITHIN : PACKED_NOT;
}

/* Whether the files are what their headers say, as far as that can be seen before its points are read: of what is
 * packed within, whether so few bytes can become so many; what is compressed as a whole shows when it is read. */
static enum status check_parts_of(const struct command_options *options, const struct command_inputs *inputs,
                                  struct error *error) {
    const struct cloud_limits limits = {.columns = options->params.columns, .threads = 1};
    struct cloud_stream *stream = NULL;
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < options->input_count; i++) {
        enum packed how = packed_how(inputs->fd[i]);
        if (how == PACKED_WHOLE) continue;
        status = cloud_stream_open((const char *const *)options->input + i, 1, &limits, &stream, error);
        cloud_stream_free(stream);
        stream = NULL;
        bool lacks_folder = status == STATUS_UNSUPPORTED && how == PACKED_WITHIN;
        if (lacks_folder) status = STATUS_OK;
    }
    return status;
}

enum status command_tiles_needed(const struct command_options *options, const struct command_inputs *inputs,
                                 bool *needed, struct error *error) {
    const struct params *params = &options->params;
    struct memory_job job;
    struct error why;
    struct params cloud = *params;
    *needed = false;
    if (options->convert || options->progress_fd >= 0 || !look_at_inputs(inputs, &job)) return STATUS_OK;
    if (memory_predict(&job, params) <= params->memory_bytes) return STATUS_OK;
    enum status status = check_parts_of(options, inputs, error);
    if (status) return status == STATUS_UNSUPPORTED ? STATUS_OK : status;
    *needed = tiles_can(params, &why) == STATUS_OK;
    cloud.outputs = OUTPUT_CLOUD;
    job.faces = job.faces_most = 0;
    uint64_t needs = memory_predict(&job, &cloud);
    if (*needed || !options->memory_given || needs <= params->memory_bytes) return STATUS_OK;
    return error_set(error, STATUS_NO_MEMORY, "memory",
                     "%" PRIu64 " points take %.1f MiB, and %.1f MiB are allowed; %.160s", job.points,
                     (double)needs / 0x1p20, (double)params->memory_bytes / 0x1p20, why.text);
}

static enum status name_scratch(const struct command_options *options, char folder[FOLDER_BYTES], struct error *error) {
    const char *output = options->output;
    size_t length = strlen(output);
    while (length > 1 && output[length - 1] == '/') length--;
    int n = 0;
    if (options->scratch)
        n = snprintf(folder, FOLDER_BYTES, "%s", options->scratch);
    else if (options->to_standard)
        return error_set(error, STATUS_BAD_PARAMETER, "scratch",
                         "the input doesn't fit into memory; name a folder for its tiles by --scratch");
    else if (strcmp(output, ".") == 0)
        n = snprintf(folder, FOLDER_BYTES, "whittle.tiles");
    else
        n = snprintf(folder, FOLDER_BYTES, "%.*s.tiles", (int)length, output);
    return n < FOLDER_BYTES ? STATUS_OK : error_set(error, STATUS_BAD_PARAMETER, "scratch", "the name is too long");
}

static void announce(const struct command_options *options, const char *folder, const struct memory_job *known) {
    uint64_t points = known->points;
    struct tiles_prediction takes = tiles_predict(points, known->record_bytes, &options->params);
    double minutes = floor(takes.seconds / 60) + 1;
    fprintf(stderr,
            "whittle: about %" PRIu64 " points don't fit into %.1f GiB: tiles in %s, up to %.1f GiB, take about %.0f "
            "minute%s\n",
            points, (double)options->params.memory_bytes / 0x1p30, folder, (double)takes.disk_bytes / 0x1p30, minutes,
            minutes == 1 ? "" : "s");
}

/* Of some inputs the first bytes tell exactly how many points they have; others are asked for where some are left
 * out. */
static bool knows_points(const struct params *params, const char *form) {
    bool has_header = strncmp(form, "ply", 3) == 0 || strncmp(form, "pcd", 3) == 0 || strncmp(form, "la", 2) == 0;
    return has_header && !select_is_asked(params);
}

enum status command_tiles_foretell(const struct command_options *options, const struct command_inputs *inputs,
                                   struct error *error) {
    char folder[FOLDER_BYTES];
    unsigned char first[4096];
    struct memory_job job = {0};
    const struct params *params = &options->params;
    enum status status = name_scratch(options, folder, error);
    if (status || !look_at_inputs(inputs, &job)) return status;
    ssize_t n = pread(inputs->fd[0], first, sizeof first, 0);
    const char *form = cloud_sniff(first, n > 0 ? (size_t)n : 0).form;
    if (knows_points(params, form)) status = fit_kept(params, job.points, job.record_bytes, fit_room(params), error);
    if (status) return status;
    if (!options->json) announce(options, folder, &job);
    return dry_run_print_tiles(options, inputs->count > 1 ? "several" : form, &job, error);
}

/* What a part of the end has of the whole of it. */
struct end_span {
    const struct progress *progress;
    double from, to;
};

static int end_tick(void *ctx, const char *stage, double fraction) {
    const struct end_span *span = ctx;
    return progress_tick(span->progress, stage, span->from + (span->to - span->from) * fraction);
}

/* Measures all points in the place of those that the mesh was made of, and says so.  facing: as tiles_measure takes
 * it. */
static enum status measure_all(const char *folder, const struct params *params, const struct progress *progress,
                               const struct cloud *cloud, const float (*facing)[3], struct pipeline_result *made,
                               struct error *error) {
    double start_ms = clock_exact_ms();
    struct report *report = &made->report;
    enum status status = tiles_measure(folder, (unsigned)params->threads, progress, cloud, facing, made, error);
    if (status) return status;
    left_out_add(&report->left_out, "input",
                 LEFT_OUT_NOTE
                 "memory has room for the %zu most important points: the mesh is made of these and fitted "
                 "to these",
                 cloud->count);
    left_out_add(&report->left_out, "report",
                 LEFT_OUT_NOTE "input_to_mesh is of all points%s; mesh_to_input and the supported area are of those "
                               "that the mesh is made of",
                 made->moved ? " as they came" : "");
    if (report->level[0].tangent.count == 0)
        left_out_add(&report->left_out, "report",
                     "distances to the planes at kept points, some of which no tile had left");
    report_add_stage(report, "measure_all", clock_exact_ms() - start_ms);
    report->total_ms += clock_exact_ms() - start_ms;
    report->peak_rss_bytes = process_peak_bytes(0);
    return STATUS_OK;
}

/* Makes what is made in memory (fit_ends_in_memory) of the points that tiles have left, in place of the result. */
static enum status end_in_memory(const char *folder, const struct params *params, const struct progress *progress,
                                 struct cloud *cloud, struct pipeline_result *result, struct error *error) {
    if (!fit_ends_in_memory(params)) return STATUS_OK;
    static const double MADE_SHARE = 0.7;
    struct end_span making = {progress, 0, MADE_SHARE}, measuring = {progress, MADE_SHARE, 1};
    const struct progress progress_made = {end_tick, &making}, progress_measured = {end_tick, &measuring};
    struct report tiled = result->report;
    const struct params end = fit_params_of_end(params, tiled.points_in, cloud->count);
    struct pipeline_result made = {0};
    float(*facing)[3] = result->facing;
    result->facing = NULL;
    pipeline_result_done(result);
    enum status status = pipeline_run(cloud, &end, &progress_made, &made, error);
    if (!status)
        status = measure_all(folder, params, &progress_measured, cloud, (const float(*)[3])facing, &made, error);
    free(facing);
    if (status) {
        pipeline_result_done(&made);
        return status;
    }
    struct report *report = &made.report;
    for (size_t i = 0; i < report->level_count; i++)
        report->level[i].ratio = (double)report->level[i].points_out / (double)tiled.points_in;
    for (size_t i = 0; i < tiled.stage_count; i++)
        report_add_stage(report, tiled.stage[i].name, tiled.stage[i].wall_ms);
    report->points_in = tiled.points_in;
    report->points_distinct = tiled.points_distinct;
    report->points_cropped = tiled.points_cropped;
    report->points_filtered = tiled.points_filtered;
    report->total_ms += tiled.total_ms;
    if (made.moved) cloud_move(cloud, made.moved);
    *result = made;
    return STATUS_OK;
}

static void tell_what_is_left(const char *folder) {
    struct tiles_facts facts;
    struct error ignored;
    fprintf(stderr, "\nwhittle: stopped; ");
    if (tiles_look(folder, &facts, NULL, &ignored) == STATUS_OK)
        fprintf(stderr, "%zu of %zu tiles are done. ", facts.done, facts.tiles);
    fprintf(stderr, "The same command goes on from what is in %s\n", folder);
}

enum status command_tiles_simplify(const struct command_options *options, const struct command_inputs *inputs,
                                   struct command_progress *display, struct cloud *cloud, struct kept_file *file,
                                   struct pipeline_result *result, struct error *error) {
    char folder[FOLDER_BYTES];
    struct progress progress = {command_progress_tick, display};
    struct tiles_facts facts = {0};
    unsigned threads = (unsigned)options->params.threads;
    struct memory_job known = {0};
    enum status status = name_scratch(options, folder, error);
    if (status) return status;
    if (options->summary && look_at_inputs(inputs, &known)) announce(options, folder, &known);
    const struct tiles_job job = {(const char *const *)options->input, options->input_count, folder, &options->params,
                                  options->tile_points};
    double start_ms = clock_exact_ms(), planned_ms, run_ms;
    bool ends = fit_ends_in_memory(&options->params);
    alloc_keep_freed(true); /* each tile takes what the last one had */
    for (int repeated = 0;; repeated++) {
        command_progress_span(display, 0, PLAN_SHARE);
        bool is_new = access(folder, F_OK) != 0;
        status = tiles_plan(&job, &progress, &facts, error);
        bool no_plan = status && status != STATUS_CANCELLED;
        if (no_plan && is_new) tiles_remove(folder);
        planned_ms = clock_exact_ms();
        for (size_t t = 0; !status && t < facts.tiles; t++) {
            double each = (RUN_SHARE - PLAN_SHARE) / (double)facts.tiles;
            command_progress_span(display, PLAN_SHARE + each * (double)t, PLAN_SHARE + each * (double)(t + 1));
            status = tiles_run(folder, t, threads, &progress, error);
        }
        command_progress_span(display, RUN_SHARE, ends ? END_SHARE : 1);
        run_ms = clock_exact_ms();
        if (!status) status = tiles_merge(folder, threads, &progress, cloud, file, result, error);
        if (status != STATUS_IO || strcmp(error->where, TILES_DAMAGED) != 0 || repeated == MOST_REPEATED) break;
        fprintf(stderr, "\nwhittle: %s; that is done now\n", error->text);
    }
    alloc_keep_freed(false);
    if (ends) command_progress_span(display, END_SHARE, 1);
    if (!status) status = end_in_memory(folder, &options->params, &progress, cloud, result, error);
    if (!status) { /* of this process: what was done before a stop isn't counted */
        report_add_stage(&result->report, "plan", planned_ms - start_ms);
        report_add_stage(&result->report, "tiles", run_ms - planned_ms);
        result->report.total_ms = clock_exact_ms() - start_ms;
    }
    if (status == STATUS_CANCELLED) tell_what_is_left(folder);
    return status;
}

void command_tiles_remove(const struct command_options *options) {
    char folder[FOLDER_BYTES];
    struct error ignored;
    if (name_scratch(options, folder, &ignored) == STATUS_OK) tiles_remove(folder);
}

/* ------------------------------------------------------------------------------------------------ step by step */

static void print_tiles_help(void) {
    puts("Usage: whittle tiles plan INPUT --scratch FOLDER [--memory BYTES] [--tile-points N] [--parameter value ...]\n"
         "       whittle tiles list --scratch FOLDER\n"
         "       whittle tiles run N --scratch FOLDER [--threads N]\n"
         "       whittle tiles merge OUTPUT --scratch FOLDER [--threads N] [--outputs LIST] [-f]\n"
         "\n"
         "Simplifies a cloud that doesn't fit into memory, step by step: plan reads it and makes tiles in the folder,\n"
         "run simplifies one of them, merge makes the result once all are done. list prints the numbers of the tiles\n"
         "that aren't done yet, a line each. Each step can be repeated: what is done stays done, also after a crash.\n"
         "Tiles can be run in any order, beside each other, by any hosts of the same kind that share the folder; the\n"
         "result is the same. Each step takes at most what plan's --memory says. The folder stays; remove it at the "
         "end.\n"
         "\n"
         "whittle INPUT OUTPUT does all that by itself where the input doesn't fit. Parameters as in whittle --help.\n"
         "\n"
         "Exit status: as whittle's.");
}

static int refuse_tiles(const char *why) {
    fprintf(stderr, "whittle tiles: %s\nUse 'whittle tiles --help' for its commands.\n", why);
    return WIRE_EXIT_PARAMETER;
}

static int end_tiles(const char *of, struct command_progress *display, enum status status, const struct error *error) {
    command_progress_end(display, status, error);
    if (status) command_output_explain(of, status, error, stderr);
    return wire_exit_status(status);
}

/* The options of plan and merge are those of whittle.  `first` stands for its input; without it all names are inputs.
 */
static bool parse_step(struct command_options *options, const char *first, int argc, char **argv, int *exit_status) {
    static const char *const nowhere[] = {"-o", "."};
    struct error error = {0};
    char **all = alloc_array((size_t)argc + 3, sizeof *all);
    int n = 0;
    *exit_status = wire_exit_status(STATUS_NO_MEMORY);
    if (!all) return false;
    all[n++] = argv[0];
    if (first) all[n++] = (char *)(uintptr_t)first;
    for (int i = 0; !first && i < 2; i++) all[n++] = (char *)(uintptr_t)nowhere[i];
    for (int i = 1; i < argc; i++) all[n++] = argv[i];
    enum command_request request = command_options_parse(options, n, all, &error);
    free(all);
    *exit_status = request == COMMAND_TOLD ? 0 : wire_exit_status(STATUS_BAD_PARAMETER);
    if (request == COMMAND_REFUSED) fprintf(stderr, "whittle tiles: %s: %s\n", error.where, error.text);
    if (request != COMMAND_RUN) command_options_done(options);
    return request == COMMAND_RUN;
}

static int plan_tiles(int argc, char **argv, struct command_progress *display, uint64_t machine_bytes) {
    struct command_options options;
    struct tiles_facts facts;
    struct error error = {0};
    struct progress progress = {command_progress_tick, display};
    int exit_status;
    if (!parse_step(&options, NULL, argc, argv, &exit_status)) return exit_status;
    if (!options.params.memory_bytes) options.params.memory_bytes = machine_bytes;
    const struct tiles_job job = {(const char *const *)options.input, options.input_count, options.scratch,
                                  &options.params, options.tile_points};
    enum status status = STATUS_BAD_PARAMETER;
    if (options.scratch)
        status = tiles_plan(&job, &progress, &facts, &error);
    else
        refuse_tiles("plan: name a folder by --scratch");
    if (!status && options.summary) {
        printf("%-16s %" PRIu64 "\n", "points", facts.points);
        printf("%-16s %zu, of %" PRIu64 " points at most, %zu done\n", "tiles", facts.tiles, facts.tile_points,
               facts.done);
        printf("%-16s %zu\n", "passes", facts.passes);
    }
    exit_status = options.scratch ? end_tiles(options.input[0], display, status, &error) : WIRE_EXIT_PARAMETER;
    command_options_done(&options);
    return exit_status;
}

/* The value of an option of list and run, and the one operand. */
static bool take_simple(int argc, char **argv, const char **scratch, const char **threads, const char **operand) {
    for (int i = 1; i < argc; i++) {
        const char **value = strncmp(argv[i], "--scratch", 9) == 0   ? scratch
                             : strncmp(argv[i], "--threads", 9) == 0 ? threads
                                                                     : NULL;
        if (!value && (argv[i][0] == '-' || *operand)) return false;
        if (!value)
            *operand = argv[i];
        else if (argv[i][9] == '=')
            *value = argv[i] + 10;
        else if (argv[i][9] || i + 1 == argc)
            return false;
        else
            *value = argv[++i];
    }
    return *scratch != NULL;
}

static bool parse_tile_number(const char *text, unsigned long most, unsigned long *count) {
    char *end;
    errno = 0;
    *count = text ? strtoul(text, &end, 10) : 0;
    return !text || (text[0] >= '0' && text[0] <= '9' && !errno && !*end && *count <= most);
}

static int list_tiles(int argc, char **argv) {
    const char *scratch = NULL, *threads = NULL, *operand = NULL;
    struct tiles_facts facts;
    struct error error = {0};
    if (!take_simple(argc, argv, &scratch, &threads, &operand) || operand || threads)
        return refuse_tiles("list takes --scratch FOLDER");
    enum status status = tiles_look(scratch, &facts, NULL, &error);
    for (size_t t = 0; !status && t < facts.tiles; t++)
        if (!tiles_is_done(scratch, t)) printf("%zu\n", t);
    if (status) command_output_explain(scratch, status, &error, stderr);
    return wire_exit_status(status);
}

static int run_one(int argc, char **argv, struct command_progress *display) {
    const char *scratch = NULL, *threads = NULL, *operand = NULL;
    struct progress progress = {command_progress_tick, display};
    struct error error = {0};
    unsigned long tile, count;
    if (!take_simple(argc, argv, &scratch, &threads, &operand) || !operand ||
        !parse_tile_number(operand, UINT32_MAX, &tile) || !parse_tile_number(threads, 256, &count))
        return refuse_tiles("run takes the number of a tile, --scratch FOLDER and --threads N");
    return end_tiles(scratch, display, tiles_run(scratch, tile, (unsigned)count, &progress, &error), &error);
}

/* What the plan was made with, but for how outputs are written. */
static struct params outputs_of(const struct params *planned, const struct params *given) {
    struct params params = *planned;
    params.outputs = given->outputs;
    params.encoding = given->encoding;
    params.colours = given->colours;
    params.pcd_precision = given->pcd_precision;
    params.header = given->header;
    params.quantize = given->quantize;
    params.meshopt = given->meshopt;
    params.threads = given->threads;
    return params;
}

static enum status write_merged(const struct command_options *options, const struct command_inputs *inputs,
                                struct cloud *cloud, const struct kept_file *file, struct pipeline_result *result,
                                struct error *error) {
    enum status status = file->path ? STATUS_OK : cloud_leave_properties(cloud, options->params.properties, error);
    if (!status && result->normal) status = cloud_set_normals(cloud, (const float(*)[3])result->normal, error);
    if (!status && !file->path && options->params.outputs & OUTPUT_ANY_LAS && options->params.colours == COLOURS_8)
        status = cloud_keep_colours(cloud, error);
    if (!status && !file->path)
        status = cloud_set_colours(cloud, (enum colour_bits)options->params.colours, &result->report.left_out, error);
    return status ? status : command_output_write(options, inputs, cloud, file, result, error);
}

static bool parse_merge(struct command_options *options, const char *input, int argc, char **argv, int *exit_status) {
    if (!parse_step(options, input, argc, argv, exit_status)) return false;
    if (options->input_count == 1) return true;
    *exit_status = refuse_tiles("merge takes one OUTPUT; a folder holds several, which --outputs names");
    command_options_done(options);
    return false;
}

static int merge_tiles(int argc, char **argv, struct command_progress *display) {
    struct command_options options;
    struct tiles_facts facts;
    struct params planned;
    struct cloud cloud = {0};
    struct kept_file file = {0};
    struct pipeline_result result = {0};
    struct progress progress = {command_progress_tick, display};
    struct error error = {0};
    const char *scratch = NULL;
    struct tiles_inputs planned_inputs = {0};
    struct command_inputs inputs = {0};
    int exit_status = 0;
    for (int i = 1; i < argc; i++) {
        if (strncmp(argv[i], "--scratch=", 10) == 0) scratch = argv[i] + 10;
        if (strcmp(argv[i], "--scratch") == 0 && i + 1 < argc) scratch = argv[i + 1];
    }
    if (!scratch) return refuse_tiles("merge: name the folder by --scratch");
    enum status status = tiles_look(scratch, &facts, &planned, &error);
    if (!status) status = tiles_inputs(scratch, &planned_inputs, &error);
    if (status) return end_tiles(scratch, display, status, &error);
    if (!parse_merge(&options, planned_inputs.path[0], argc, argv, &exit_status)) {
        tiles_inputs_done(&planned_inputs);
        return exit_status;
    }
    options.params = outputs_of(&planned, &options.params);
    status = command_inputs_open(&inputs, (const char *const *)planned_inputs.path, planned_inputs.count, &error);
    if (!status) status = command_output_check(&options, &inputs, &error);
    if (!status && facts.for_tileset && !(options.params.outputs & OUTPUT_TILESET))
        status = error_set(&error, STATUS_BAD_PARAMETER, "outputs",
                           "the plan is for a tileset of more points than memory holds; merge it to a tileset");
    if (!status && fit_ends_in_memory(&options.params) && !fit_ends_in_memory(&planned))
        status = error_set(&error, STATUS_BAD_PARAMETER, "outputs",
                           "the plan is for a cloud; plan with --outputs mesh to have one, or a preview");
    if (!status)
        status = tiles_merge(scratch, (unsigned)options.params.threads, &progress, &cloud, &file, &result, &error);
    struct params end = options.params;
    end.outputs |= planned.outputs;
    if (!status) status = end_in_memory(scratch, &end, &progress, &cloud, &result, &error);
    if (!status) status = write_merged(&options, &inputs, &cloud, &file, &result, &error);
    if (!status) tiles_kept_remove(&file);
    kept_file_done(&file);
    if (!status && options.summary)
        command_output_summary(&options, &result.report, options.to_standard ? stderr : stdout);
    bool no_output = status && (strcmp(error.where, "output") == 0 || strcmp(error.where, "write") == 0);
    exit_status = end_tiles(scratch, display, status, &error);
    if (no_output) exit_status = WIRE_EXIT_NO_OUTPUT;
    command_inputs_done(&inputs);
    pipeline_result_done(&result);
    cloud_done(&cloud);
    tiles_inputs_done(&planned_inputs);
    command_options_done(&options);
    return exit_status;
}

/* ------------------------------------------------------------------------------------------------ for the service */

/* A line for each tile: those whose points it reads. */
static enum status write_around(size_t tiles, struct error *error) {
    struct file_out file;
    struct sink sink;
    bool *is_read = alloc_array(tiles, sizeof *is_read);
    if (!is_read) return error_set(error, STATUS_NO_MEMORY, "tiles", "no memory for %zu tiles", tiles);
    enum status status = file_out_begin(&file, "around", error);
    if (!status) {
        status = sink_init(&sink, file.fd);
        for (size_t t = 0; !status && t < tiles; t++) {
            status = tiles_around(".", t, is_read, error);
            for (size_t i = 0; !status && i < tiles; i++)
                if (is_read[i]) sink_format(&sink, "%zu ", i);
            if (!status) sink_format(&sink, "\n");
        }
        status = sink_done(&sink, status, error);
        if (!status) status = file_out_commit(&file, 1, error);
    }
    if (status) file_out_abort(&file);
    free(is_read);
    return status;
}

static enum status merge_and_write(const struct command_options *options, const char *folder,
                                   const struct progress *progress, struct error *error) {
    struct cloud cloud = {0};
    struct kept_file file = {0};
    struct pipeline_result result = {0};
    struct command_inputs inputs = {0};
    enum status status = command_inputs_open(&inputs, options->input, options->input_count, error);
    if (!status)
        status = tiles_merge(folder, (unsigned)options->params.threads, progress, &cloud, &file, &result, error);
    if (!status) status = end_in_memory(folder, &options->params, progress, &cloud, &result, error);
    if (!status) status = write_merged(options, &inputs, &cloud, &file, &result, error);
    tiles_kept_remove(&file);
    command_inputs_done(&inputs);
    pipeline_result_done(&result);
    cloud_done(&cloud);
    return status;
}

/* One task of a job of tiles.  The cloud is standard input; what the task makes lies in the current folder. */
static int work_task(int argc, char **argv, volatile sig_atomic_t *stopping) {
    struct command_options options;
    struct command_progress display;
    struct progress progress = {command_progress_tick, &display};
    struct error error = {0};
    struct tiles_facts facts;
    if (argc < 4) return refuse_tiles("work takes a task, its files and the options of whittle");
    const char *task = argv[1];
    size_t room = sizeof TILES_GIVEN + strlen(argv[2]);
    char *folder = alloc_array(room, 1);
    if (!folder) return wire_exit_status(STATUS_NO_MEMORY);
    snprintf(folder, room, TILES_GIVEN "%s", argv[2]);
    if (command_options_parse(&options, argc - 2, argv + 2, &error) != COMMAND_RUN) {
        fprintf(stderr, "whittle tiles: %s: %s\n", error.where, error.text);
        command_options_done(&options);
        free(folder);
        return wire_exit_status(STATUS_BAD_PARAMETER);
    }
    bool confined = options.progress_fd >= 0 && command_no_new_code();
    (void)confined; /* where the kernel has no filters, whittled says so */
    command_progress_init(&display, options.progress_fd, stopping);
    unsigned threads = (unsigned)options.params.threads;
    enum status status;
    if (strcmp(task, "plan") == 0) {
        const struct tiles_job job = {options.input, options.input_count, ".", &options.params, options.tile_points};
        status = tiles_plan(&job, &progress, &facts, &error);
        if (!status) status = write_around(facts.tiles, &error);
    } else if (strcmp(task, "merge") == 0) {
        status = merge_and_write(&options, folder, &progress, &error);
    } else {
        status = tiles_run(folder, strtoul(task, NULL, 10), threads, &progress, &error);
    }
    command_progress_end(&display, status, &error);
    if (status) command_output_explain("the cloud", status, &error, stderr);
    command_options_done(&options);
    free(folder);
    return wire_exit_status(status);
}

int command_tiles_main(int argc, char **argv, uint64_t machine_bytes, volatile sig_atomic_t *stopping) {
    struct command_progress display;
    const char *step = argc > 1 ? argv[1] : "";
    if (strcmp(step, "--help") == 0 || strcmp(step, "-h") == 0) {
        print_tiles_help();
        return 0;
    }
    for (int i = 2; i < argc; i++)
        if (strcmp(argv[i], "--help") == 0 || strcmp(argv[i], "-h") == 0) {
            print_tiles_help();
            return 0;
        }
    if (strcmp(step, "work") == 0) return work_task(argc - 1, argv + 1, stopping);
    command_progress_init(&display, -1, stopping);
    if (strcmp(step, "plan") == 0) return plan_tiles(argc - 1, argv + 1, &display, machine_bytes);
    if (strcmp(step, "list") == 0) return list_tiles(argc - 1, argv + 1);
    if (strcmp(step, "run") == 0) return run_one(argc - 1, argv + 1, &display);
    if (strcmp(step, "merge") == 0) return merge_tiles(argc - 1, argv + 1, &display);
    return refuse_tiles("use plan, list, run or merge");
}
