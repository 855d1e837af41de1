/* whittle: a cloud in, the simplified cloud, a mesh and a report out.
 *
 *     whittle scan.ply --ratio 0.1 --outputs cloud,mesh,report -o out/
 *     whittle scan.ply small.ply --ratio 0.1
 *     whittle a.laz b.laz c.ply all.laz --ratio 0.1                      (one cloud: core/io/join.h)
 *     zcat scan.ply.gz | whittle - --outputs mesh.glb -o - | upload
 *     whittle convert scan.las scan.ply
 *     whittle measure out/mesh.ply scan.ply                              (server/cli/measure.c)
 *     whittle info scan.las                                              (server/cli/info.c)
 *     whittle big.laz small.laz --memory 4G; whittle tiles plan ...      (server/cli/tiles.c)
 *
 * Reads like its --help: options, then read, run, write.  The same program is what whittled starts for each job; then
 * --progress-fd names an inherited descriptor, and progress and the end are told there
 * (server/shared/worker_protocol.h).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "api/codecs/report_json.h"
#include "core/base/alloc.h"
#include "core/cloud/colour_depth.h"
#include "core/cloud/leave_properties.h"
#include "core/cloud/normals.h"
#include "core/cloud/select.h"
#include "core/io/out/las_write.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline.h"
#include "server/cli/cli_internal.h"
#include "server/cli/cut_input.h"
#include "server/cli/input.h"
#include "server/cli/no_new_code.h"
#include "server/cli/options.h"
#include "server/cli/output.h"
#include "server/cli/preview.h"
#include "server/cli/progress.h"
#include "server/cli/tiles.h"
#include "server/shared/worker_protocol.h"

static volatile sig_atomic_t stopping;
static const double READ_SHARE = 0.05; /* of the whole job */

static void stop(int signal) { stopping = signal; }

/* TERM and INT ask the pipeline to stop at its next tick; nothing that is half written keeps its name.  Where the
 * output is a pipe that nobody reads any more, the process ends by SIGPIPE, silently, as programs in pipes do. */
static void catch_signals(bool to_standard) {
    struct sigaction action = {.sa_handler = stop};
    sigemptyset(&action.sa_mask);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    signal(SIGPIPE, to_standard ? SIG_DFL : SIG_IGN);
    signal(SIGXFSZ, SIG_IGN); /* writing says so too */
}

/* What the process can have: the memory of the machine, or less where limits are set. */
static uint64_t memory_there_is(void) {
    static const int limits[] = {RLIMIT_AS, RLIMIT_DATA};
    uint64_t bytes = (uint64_t)sysconf(_SC_PHYS_PAGES) * (uint64_t)sysconf(_SC_PAGESIZE);
    for (size_t i = 0; i < sizeof limits / sizeof *limits; i++) {
        struct rlimit limit;
        if (getrlimit((__rlimit_resource_t)limits[i], &limit) == 0 && limit.rlim_cur < bytes) bytes = limit.rlim_cur;
    }
    return bytes;
}

/* How many triangles faces of many corners are is known only now. */
static enum status check_faces(const struct cloud *cloud, const struct params *params, struct error *error) {
    const struct memory_job job = {cloud->count, cloud->record_bytes, cloud->triangle_count, 0, 0};
    if (!memory_lacks_for_faces(&job, params)) return STATUS_OK;
    return error_set(error, STATUS_NO_MEMORY, "faces",
                     "%zu triangles and %zu points, and the %" PRIu64 " MiB of memory allowed have no room for them",
                     cloud->triangle_count, cloud->count, params->memory_bytes >> 20);
}

/* A conversion's result: all points in their order, and the input's faces as the mesh. */
static enum status take_all(const struct cloud *cloud, const struct params *params, struct pipeline_result *result,
                            struct error *error) {
    struct mesh *mesh = &result->level[0].mesh;
    result->level_count = 1;
    result->level[0].kept_count = cloud->count;
    if (!(params->outputs & OUTPUT_ANY_MESH)) return STATUS_OK;
    mesh->vertex = alloc_array(cloud->count, sizeof *mesh->vertex);
    mesh->source = alloc_array(cloud->count, sizeof *mesh->source);
    mesh->triangle = alloc_array(cloud->triangle_count, sizeof *mesh->triangle);
    if (!mesh->vertex || !mesh->source || !mesh->triangle)
        return error_set(error, STATUS_NO_MEMORY, "convert", "no memory for the mesh");
    mesh->vertex_count = cloud->count;
    mesh->triangle_count = cloud->triangle_count;
    memcpy(mesh->vertex, cloud->position, cloud->count * sizeof *mesh->vertex);
    memcpy(mesh->triangle, cloud->triangle, cloud->triangle_count * sizeof *mesh->triangle);
    for (size_t i = 0; i < cloud->count; i++) mesh->source[i] = (uint32_t)i;
    return STATUS_OK;
}

static enum status tell_result(const struct command_options *options, const struct cloud *cloud,
                               const struct report *report, struct error *error) {
    FILE *to = options->to_standard ? stderr : stdout;
    if (options->json) return report_json_write(STDOUT_FILENO, report, &options->params, error);
    if (options->convert)
        command_output_converted(options, cloud, &report->left_out, to);
    else
        command_output_summary(options, report, to);
    return STATUS_OK;
}

/* Said of where outputs go, not of what is written there. */
static bool is_no_output(enum status status, const struct error *error) {
    if (status != STATUS_IO && status != STATUS_BAD_PARAMETER) return false;
    bool refused = status == STATUS_BAD_PARAMETER && strcmp(error->where, "write") == 0;
    return refused || strcmp(error->where, "output") == 0;
}

/* On the terminal, or word of where it is. */
static void show_preview(const struct command_options *options, const struct cloud *cloud,
                         const struct pipeline_result *result) {
    struct picture picture = {0};
    bool made = !preview_make(&options->params, cloud, result, &picture, NULL);
    if (!made || !preview_show(&picture, options->preview, stdout))
        puts("preview          not shown: this is no terminal that is known to show pictures; it is in preview.png");
    picture_done(&picture);
}

static enum status run_request(struct command_options *options, struct command_progress *display, int *exit_status,
                               const char **failed, struct error *error) {
    struct cloud cloud = {0};
    struct pipeline_result result = {0};
    struct selection selection = {0};
    struct progress progress = {command_progress_tick, display};
    struct kept_file file = {0};
    struct command_inputs inputs = {0};
    command_progress_span(display, 0, READ_SHARE);
    struct error missing;
    enum status opened = command_inputs_open(&inputs, options->input, options->input_count, &missing);
    enum status status = command_output_check(options, &inputs, error);
    if (is_no_output(status, error)) *exit_status = WIRE_EXIT_NO_OUTPUT;
    bool is_last = inputs.failed && inputs.failed == options->input[options->input_count - 1];
    if (!status && opened == STATUS_IO && options->output_given && options->input_count > 1 && is_last)
        error_set(&missing, opened, "read", "%s isn't there; with -o all names are inputs, use one of both",
                  inputs.failed);
    if (!status && opened) {
        *exit_status = opened == STATUS_IO ? WIRE_EXIT_NO_INPUT : 0;
        *error = missing;
        status = opened;
    }
    bool tiled = false;
    if (!status) status = command_tiles_needed(options, &inputs, &tiled, error);
    if (!status && tiled && options->dry_run) status = command_tiles_foretell(options, &inputs, error);
    if (!status && tiled && !options->dry_run)
        status = command_tiles_simplify(options, &inputs, display, &cloud, &file, &result, error);
    const struct cloud_limits limits = {.columns = options->params.columns,
                                        .max_triangles = memory_triangles(&options->params),
                                        .threads = (unsigned)options->params.threads};
    if (!status && !tiled) status = command_inputs_read(&inputs, &limits, &progress, &cloud, error);
    if (!status && !tiled && select_is_asked(&options->params))
        status = select_in_place(&cloud, &options->params, &selection, error);
    if (!status && !tiled && !options->convert && command_output_follow_faces(options, &cloud))
        status = command_output_check(options, &inputs, error); /* of other files now */
    if (!status && !tiled) status = cloud_has_properties(&cloud, options->params.properties, error);
    if (!status && !tiled && options->memory_given) status = check_faces(&cloud, &options->params, error);
    if (!status && options->convert) status = command_output_settle_faces(options, &cloud, error);
    if (options->dry_run) goto out;
    if (tiled) goto made;
    command_progress_span(display, READ_SHARE, 1);
    if (!status && !options->convert && memory_is_kept(cloud.count, &options->params) &&
        options->params.levels.count < 2)
        command_heap_prepare(cloud.count);
    if (!status)
        status = options->convert ? take_all(&cloud, &options->params, &result, error)
                                  : pipeline_run(&cloud, &options->params, &progress, &result, error);
    result.report.points_cropped = selection.cropped;
    result.report.points_filtered = selection.filtered;
    if (!status && result.moved) cloud_move(&cloud, result.moved);
made:
    if (!status) status = cloud_leave_properties(&cloud, options->params.properties, error);
    if (!status && result.normal) status = cloud_set_normals(&cloud, (const float(*)[3])result.normal, error);
    if (!status && options->params.outputs & OUTPUT_ANY_LAS && options->params.colours == COLOURS_8)
        status = cloud_keep_colours(&cloud, error);
    if (!status && !file.path)
        status = cloud_set_colours(&cloud, (enum colour_bits)options->params.colours, &result.report.left_out, error);
    if (!status) {
        status = command_output_write(options, &inputs, &cloud, &file, &result, error);
        if (is_no_output(status, error)) *exit_status = WIRE_EXIT_NO_OUTPUT;
    }
    if (!status && tiled) command_tiles_remove(options);
out:
    command_progress_end(display, status, error);
    if (!status && options->dry_run && !tiled)
        status = dry_run_print(options, &cloud, &inputs, error);
    else if (!status && !options->dry_run && (options->summary || options->json))
        status = tell_result(options, &cloud, &result.report, error);
    else if (!status && !options->dry_run && options->progress_fd < 0)
        command_output_warn(&result.report, stderr);
    if (!status && !options->dry_run && !options->json && options->preview) show_preview(options, &cloud, &result);
    pipeline_result_done(&result);
    kept_file_done(&file);
    cloud_done(&cloud);
    *failed = inputs.failed;
    command_inputs_done(&inputs);
    return status;
}

/* Of one of several inputs, or of all of them. */
static void explain_failure(const struct command_options *options, const char *failed, enum status status,
                            const struct error *error) {
    char all[96];
    snprintf(all, sizeof all, "%.60s and %zu more", options->input[0], options->input_count - 1);
    command_output_explain(failed ? failed : options->input_count > 1 ? all : options->input[0], status, error, stderr);
}

/* For the end without memory, which comes from the depth of a library. */
static struct command_progress display;
static const char *input_name;

static _Noreturn void end_without_memory(void) {
    struct error error;
    enum status status = error_set(&error, STATUS_NO_MEMORY, "delaunay", "no memory for an exact number");
    command_progress_end(&display, status, &error);
    command_output_explain(input_name, status, &error, stderr);
    _exit(wire_exit_status(status));
}

int main(int argc, char **argv) {
    char asked[] = "--help", *of_command[] = {argv[0], argc > 2 ? argv[2] : asked, asked, NULL};
    if (argc > 1 && argc < 4 && strcmp(argv[1], "help") == 0 && access(argv[1], F_OK) != 0)
        argv = of_command, argc = 3; /* whittle help [COMMAND] */
    cut_input_watch();
    if (argc > 1 && strcmp(argv[1], "measure") == 0) return command_measure_main(argc - 1, argv + 1);
    if (argc > 1 && strcmp(argv[1], "info") == 0) return command_info_main(argc - 1, argv + 1);
    if (argc > 1 && strcmp(argv[1], "tiles") == 0) {
        catch_signals(false);
        return command_tiles_main(argc - 1, argv + 1, memory_there_is(), &stopping);
    }
    struct command_options options;
    struct error error = {0};
    enum command_request request = command_options_parse(&options, argc, argv, &error);
    if (request == COMMAND_TOLD) {
        command_options_done(&options);
        return 0;
    }
    if (request == COMMAND_REFUSED) {
        fprintf(stderr, "whittle: %s: %s\nUse 'whittle --help' for all options.\n", error.where, error.text);
        command_options_done(&options);
        return wire_exit_status(STATUS_BAD_PARAMETER);
    }
    if (!options.params.memory_bytes) options.params.memory_bytes = memory_there_is();
    catch_signals(options.to_standard);
    bool confined = options.progress_fd >= 0 && command_no_new_code();
    (void)confined; /* where the kernel has no filters, whittled says so */
    input_name = options.input[0];
    command_exact_numbers_end_by(end_without_memory);
    command_progress_init(&display, options.progress_fd, &stopping);
    int exit_status = 0;
    const char *failed = NULL;
    enum status status = run_request(&options, &display, &exit_status, &failed, &error);
    if (status) explain_failure(&options, failed, status, &error);
    command_options_done(&options);
    return status && exit_status ? exit_status : wire_exit_status(status);
}
