/* An input that fits into memory is read whole, so it is known to be sound, and its points are counted, not guessed by
 * its length.  Of one that is made in tiles its first bytes tell.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/cli_internal.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>

#include "api/codecs/forecast_json.h"
#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/pipeline/memory.h"
#include "core/tiles/fit.h"
#include "server/cli/output.h"

/* Duplicates and outliers may leave fewer. */
static void print_level(const char *label, double ratio, uint64_t points, FILE *to) {
    fprintf(to, "%-16s %.0f of %" PRIu64 " points\n", label, fmax(1, floor(ratio * (double)points)), points);
}

static void print_goal(const struct params *params, uint64_t points, FILE *to) {
    for (uint32_t i = 0; i < params->levels.count; i++)
        print_level(i ? "" : "would keep", params->levels.ratio[i], points, to);
    if (params->levels.count) return;
    if (!isnan(params->ratio))
        print_level("would keep", params->ratio, points, to);
    else if (params->points)
        fprintf(to, "%-16s %" PRIu64 " of %" PRIu64 " points\n", "would keep",
                params->points < points ? params->points : points, points);
    if (!isnan(params->spacing))
        fprintf(to, "%-16s as many of %" PRIu64 " points as have room %g apart%s\n", "would keep", points,
                params->spacing, isnan(params->ratio) && !params->points ? "" : ", if fewer");
    if (!isnan(params->max_error))
        fprintf(to, "%-16s as many of %" PRIu64 " points as max_error %g of the diagonal demands%s\n", "would keep",
                points, params->max_error, isnan(params->ratio) && !params->points ? "" : ", if more");
}

/* Only a mesh may take more than is predicted. */
static void print_memory(const struct forecast *forecast, FILE *to) {
    const double mebibyte = 1 << 20;
    fprintf(to, "%-16s at most %.1f MiB\n", "would take", (double)forecast->memory_bytes / mebibyte);
    if (forecast->memory_most_bytes > forecast->memory_bytes)
        fprintf(to, "%-16s at most %.1f MiB where points lie along lines%s\n", "",
                (double)forecast->memory_most_bytes / mebibyte,
                forecast->triangles ? ", or faces can't be simplified" : "");
    if (forecast->in_tiles)
        fprintf(to, "%-16s at most %.1f MiB on the disk, in tiles\n", "", (double)forecast->disk_bytes / mebibyte);
}

/* Points that are kept, of all levels together; NAN where only the run finds out. */
static double kept_in_all(const struct params *params, uint64_t points) {
    double sum = params->levels.count ? 0 : isnan(params->ratio) ? NAN : params->ratio;
    for (uint32_t i = 0; i < params->levels.count; i++) sum += params->levels.ratio[i];
    return params->points ? (double)params->points : sum * (double)points;
}

/* By a rule of thumb: scans and a statue of 48 000 to 340 000 points took .3 to 1.7 times that on one processor, clouds
 * alone .4 to 1 times; others share most of it.  *unknown: it takes more than that. */
static double predict_seconds(const struct params *params, uint64_t points, bool *unknown) {
    const double point_s = 4e-6, meshed_s = 14e-6, kept_s = 90e-6, fitted_s = 25e-6, alone = 0.3;
    unsigned threads = params->threads ? (unsigned)params->threads : par_processors();
    double kept = kept_in_all(params, points), seconds = point_s * (double)points;
    bool kept_unknown = isnan(kept) || params_bound_deviation(params);
    if (params_want_mesh(params)) seconds += meshed_s * (double)points;
    if (params_want_mesh(params) && !kept_unknown) seconds += kept_s * kept;
    if (params_want_mesh(params) && params->placement == PLACEMENT_OPTIMAL) seconds += fitted_s * (double)points;
    *unknown = params_want_mesh(params) && kept_unknown;
    return seconds * (alone + (1 - alone) / threads);
}

static void print_time(const struct params *params, double seconds, bool unknown, FILE *to) {
    unsigned threads = params->threads ? (unsigned)params->threads : par_processors();
    if (unknown)
        fprintf(to, "%-16s more than %.0f s: how many points are kept isn't known\n", "", fmax(1, ceil(seconds)));
    else if (seconds < 1)
        fprintf(to, "%-16s about a second or less\n", "");
    else
        fprintf(to, "%-16s about %.0f s on %u processor%s\n", "", ceil(seconds), threads, threads == 1 ? "" : "s");
}

static void list_goals(const struct params *params, uint64_t points, struct forecast *forecast) {
    double all = (double)points;
    forecast->goals = params->levels.count ? params->levels.count : 1;
    for (size_t i = 0; i < forecast->goals; i++) {
        double ratio = params->levels.count ? params->levels.ratio[i] : params->ratio;
        double kept = params->points ? fmin((double)params->points, all) : fmax(1, floor(ratio * all));
        bool is_told = params->points || !isnan(ratio);
        bool more_or_fewer = !isnan(params->spacing) || !isnan(params->max_error) || params_bound_deviation(params);
        forecast->kept[i] = is_told && !more_or_fewer ? kept : NAN;
    }
}

static enum status print_json(const struct command_options *options, struct forecast *forecast, FILE *to,
                              struct error *error) {
    char **name = NULL;
    enum status status = command_output_list(options, &name, &forecast->outputs);
    forecast->output = (const char *const *)name;
    if (!status) status = forecast_json_write(to, forecast);
    for (size_t i = 0; i < forecast->outputs; i++) free(name[i]);
    free(name);
    return status ? error_set(error, status, "", "standard output can't be written") : STATUS_OK;
}

static enum status tell_forecast(const struct command_options *options, struct forecast *forecast, bool unknown,
                                 struct error *error) {
    FILE *to = options->to_standard ? stderr : stdout;
    list_goals(&options->params, forecast->points, forecast);
    if (options->json) {
        if (unknown) forecast->seconds = NAN;
        return print_json(options, forecast, to, error);
    }
    fprintf(to, "%-16s %s, %" PRIu64 " points, %" PRIu64 " triangles\n", "input", forecast->format, forecast->points,
            forecast->triangles);
    print_goal(&options->params, forecast->points, to);
    print_memory(forecast, to);
    print_time(&options->params, forecast->seconds, unknown, to);
    command_output_names(options, "would write", true, to);
    if (options->to_standard) fprintf(to, "%-16s standard output\n", "would write");
    return STATUS_OK;
}

enum status dry_run_print(const struct command_options *options, const struct cloud *cloud,
                          const struct command_inputs *inputs, struct error *error) {
    const struct params *params = &options->params;
    const struct memory_job job = {cloud->count, cloud->record_bytes, cloud->triangle_count,
                                   command_inputs_bytes(inputs), 0};
    bool unknown;
    uint64_t predicted = memory_predict(&job, params), most = memory_predict_most(&job, params);
    if (most > params->memory_bytes) most = params->memory_bytes > predicted ? params->memory_bytes : predicted;
    struct forecast forecast = {.format = cloud->form,
                                .points = cloud->count,
                                .triangles = cloud->triangle_count,
                                .memory_bytes = predicted,
                                .memory_most_bytes = most > predicted ? most : predicted,
                                .seconds = predict_seconds(params, cloud->count, &unknown)};
    return tell_forecast(options, &forecast, unknown, error);
}

enum status dry_run_print_tiles(const struct command_options *options, const char *format, const struct memory_job *job,
                                struct error *error) {
    const struct params *params = &options->params;
    const struct tiles_prediction takes = tiles_predict(job->points, job->record_bytes, params);
    struct forecast forecast = {.format = format,
                                .points = job->points,
                                .memory_bytes = params->memory_bytes,
                                .memory_most_bytes = params->memory_bytes,
                                .in_tiles = true,
                                .disk_bytes = takes.disk_bytes,
                                .seconds = takes.seconds};
    return tell_forecast(options, &forecast, false, error);
}
