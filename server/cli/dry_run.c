/* The input is read whole, so it is known to be sound, and its points are counted, not guessed by its length.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/cli_internal.h"

#include <inttypes.h>
#include <math.h>

#include "core/base/par.h"
#include "core/pipeline/memory.h"
#include "server/cli/output.h"

/* Duplicates and outliers may leave fewer. */
static void print_level(const char *label, double ratio, const struct cloud *cloud, FILE *to) {
    double points = floor(ratio * (double)cloud->count);
    fprintf(to, "%-16s %.0f of %zu points\n", label, points < 1 ? 1 : points, cloud->count);
}

static void print_goal(const struct params *params, const struct cloud *cloud, FILE *to) {
    for (uint32_t i = 0; i < params->levels.count; i++)
        print_level(i ? "" : "would keep", params->levels.ratio[i], cloud, to);
    if (params->levels.count) return;
    if (!isnan(params->ratio))
        print_level("would keep", params->ratio, cloud, to);
    else if (params->points)
        fprintf(to, "%-16s %" PRIu64 " of %zu points\n", "would keep",
                params->points < cloud->count ? params->points : cloud->count, cloud->count);
    if (!isnan(params->spacing))
        fprintf(to, "%-16s as many of %zu points as have room %g apart%s\n", "would keep", cloud->count,
                params->spacing, isnan(params->ratio) && !params->points ? "" : ", if fewer");
    if (!isnan(params->max_error))
        fprintf(to, "%-16s as many of %zu points as max_error %g of the diagonal demands%s\n", "would keep",
                cloud->count, params->max_error, isnan(params->ratio) && !params->points ? "" : ", if more");
}

/* Only a mesh may take more than is predicted. */
static void print_memory(const struct memory_job *job, const struct params *params, FILE *to) {
    const double mebibyte = 1 << 20;
    uint64_t predicted = memory_predict(job, params), most = memory_predict_most(job, params);
    if (most > params->memory_bytes) most = params->memory_bytes > predicted ? params->memory_bytes : predicted;
    fprintf(to, "%-16s at most %.1f MiB\n", "would take", (double)predicted / mebibyte);
    if (most > predicted)
        fprintf(to, "%-16s at most %.1f MiB where points lie along lines%s\n", "", (double)most / mebibyte,
                job->faces ? ", or faces can't be simplified" : "");
}

/* Points that are kept, of all levels together; NAN where only the run finds out. */
static double kept_in_all(const struct params *params, const struct cloud *cloud) {
    double sum = params->levels.count ? 0 : isnan(params->ratio) ? NAN : params->ratio;
    for (uint32_t i = 0; i < params->levels.count; i++) sum += params->levels.ratio[i];
    return params->points ? (double)params->points : sum * (double)cloud->count;
}

/* By a rule of thumb: scans and a statue of 48 000 to 340 000 points took .3 to 1.7 times that on one processor, clouds
 * alone .4 to 1 times; others share most of it. */
static void print_time(const struct params *params, const struct cloud *cloud, FILE *to) {
    const double point_s = 4e-6, meshed_s = 14e-6, kept_s = 90e-6, fitted_s = 25e-6, alone = 0.3;
    unsigned threads = params->threads ? (unsigned)params->threads : par_processors();
    double kept = kept_in_all(params, cloud), seconds = point_s * (double)cloud->count;
    bool unknown = isnan(kept) || params_bound_deviation(params);
    if (params_want_mesh(params)) seconds += meshed_s * (double)cloud->count;
    if (params_want_mesh(params) && !unknown) seconds += kept_s * kept;
    if (params_want_mesh(params) && params->placement == PLACEMENT_OPTIMAL) seconds += fitted_s * (double)cloud->count;
    seconds *= alone + (1 - alone) / threads;
    if (params_want_mesh(params) && unknown)
        fprintf(to, "%-16s more than %.0f s: how many points are kept isn't known\n", "", fmax(1, ceil(seconds)));
    else if (seconds < 1)
        fprintf(to, "%-16s about a second or less\n", "");
    else
        fprintf(to, "%-16s about %.0f s on %u processor%s\n", "", ceil(seconds), threads, threads == 1 ? "" : "s");
}

void dry_run_print(const struct command_options *options, const struct cloud *cloud,
                   const struct command_inputs *inputs, FILE *to) {
    const struct memory_job job = {cloud->count, cloud->record_bytes, cloud->triangle_count,
                                   command_inputs_bytes(inputs), 0};
    fprintf(to, "%-16s %s, %zu points, %zu triangles\n", "input", cloud->form, cloud->count,
            (size_t)cloud->triangle_count);
    print_goal(&options->params, cloud, to);
    print_memory(&job, &options->params, to);
    print_time(&options->params, cloud, to);
    command_output_names(options, "would write", true, to);
    if (options->to_standard) fprintf(to, "%-16s standard output\n", "would write");
}
