/* whittle: a cloud in, the simplified cloud, a mesh and a report out.
 *
 *     whittle scan.ply --ratio 0.1 --outputs cloud,mesh,report -o out/
 *     zcat scan.ply.gz | whittle - --outputs mesh.glb -o - | upload
 *     whittle measure out/mesh.ply scan.ply                              (server/worker_measure.c)
 *
 * Reads like its --help: options, then read, run, write.  The same program is what whittled starts for each job; then
 * --progress-fd names an inherited descriptor, and progress and the end are told there (server/wire.h).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/cloud_read.h"
#include "core/memory.h"
#include "core/pipeline.h"
#include "server/wire.h"
#include "server/worker_heap.h"
#include "server/worker_measure.h"
#include "server/worker_options.h"
#include "server/worker_output.h"
#include "server/worker_progress.h"

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

static enum status read_input(const struct worker_options *options, const struct progress *progress,
                              struct cloud *cloud, struct error *error) {
    if (strcmp(options->input, "-") == 0) return cloud_read(STDIN_FILENO, NULL, progress, cloud, error);
    return cloud_read_path(options->input, NULL, progress, cloud, error);
}

static enum status run(const struct worker_options *options, struct worker_progress *display, struct error *error) {
    struct cloud cloud = {0};
    struct pipeline_result result = {0};
    struct progress progress = {worker_progress_tick, display};
    worker_progress_span(display, 0, READ_SHARE);
    enum status status = worker_output_check(options, error);
    if (!status) status = read_input(options, &progress, &cloud, error);
    worker_progress_span(display, READ_SHARE, 1);
    if (!status && memory_is_kept(cloud.count, &options->params) && options->params.levels.count < 2)
        worker_heap_prepare(cloud.count);
    if (!status) status = pipeline_run(&cloud, &options->params, &progress, &result, error);
    if (!status && result.moved) cloud_move(&cloud, result.moved);
    if (!status) status = worker_output_write(options, &cloud, &result, error);
    worker_progress_end(display, status, error);
    if (!status && options->summary) worker_output_summary(&result.report, options->to_standard ? stderr : stdout);
    pipeline_result_done(&result);
    cloud_done(&cloud);
    return status;
}

int main(int argc, char **argv) {
    if (argc > 1 && strcmp(argv[1], "measure") == 0) return worker_measure_main(argc - 1, argv + 1);
    struct worker_options options;
    struct error error = {0};
    enum worker_request request = worker_options_parse(&options, argc, argv, &error);
    if (request == WORKER_TOLD) return 0;
    if (request == WORKER_REFUSED) {
        fprintf(stderr, "whittle: %s: %s\nTry 'whittle --help'.\n", error.where, error.text);
        return wire_exit_status(STATUS_BAD_PARAMETER);
    }
    catch_signals(options.to_standard);
    struct worker_progress display;
    worker_progress_init(&display, options.progress_fd, &stopping);
    enum status status = run(&options, &display, &error);
    if (status) worker_output_explain(options.input, status, &error, stderr);
    return wire_exit_status(status);
}
