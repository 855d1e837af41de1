/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tiles/fit.h"

#include <inttypes.h>
#include <math.h>

#include "core/base/par.h"
#include "core/pipeline/memory.h"
#include "core/tiles/grid.h"

static const double PROGRAM = 96e6; /* bytes: the program, tables of cells, what is read and written at a time */

/* What a point of a cloud takes, of which the records aren't there, but numbers and marks. */
static double part_bytes(const struct params *params) {
    enum { SMALL = 1 << 20, BESIDE = 16, COST = 4 };
    struct params cloud = *params;
    cloud.outputs = OUTPUT_CLOUD;
    const struct memory_job one = {.points = SMALL}, two = {.points = 2 * SMALL};
    return BESIDE + (fit_tells_gone(params) ? COST : 0) +
           ((double)memory_predict(&two, &cloud) - (double)memory_predict(&one, &cloud)) / SMALL;
}

bool fit_ends_in_memory(const struct params *params) {
    return params_want_mesh(params) || params->outputs & OUTPUT_PREVIEW;
}

bool fit_is_spaced(const struct params *params) { return !isnan(params->spacing) && !fit_ends_in_memory(params); }

bool fit_is_spaced_alone(const struct params *params) {
    return fit_is_spaced(params) && isnan(params->ratio) && !params->points && !params->levels.count;
}

bool fit_is_tileset(const struct params *params) {
    return (params->outputs & ~(uint32_t)OUTPUT_REPORT) == OUTPUT_TILESET && !fit_is_spaced(params) &&
           params->normals != SWITCH_TRUE;
}

bool fit_tells_gone(const struct params *params) { return fit_is_tileset(params) || fit_is_spaced(params); }

uint64_t fit_tileset_room(const struct params *params, uint64_t record_bytes) {
    const double each = 176; /* positions twice and more, keys, the tree, groups of its points, what is read */
    double bytes = (double)params->memory_bytes;
    return bytes > PROGRAM ? (uint64_t)((bytes - PROGRAM) / (each + (double)record_bytes)) : 0;
}

uint64_t fit_room(const struct params *params) {
    double bytes = (double)params->memory_bytes;
    return bytes > PROGRAM ? (uint64_t)((bytes - PROGRAM) / part_bytes(params)) : 0;
}

/* The most points that a part's end has room for. */
static double most_kept(uint64_t room) { return floor(FIT_LEFT * (double)room / FIT_MORE_THAN_KEPT); }

/* How many of all points are kept in the end; NAN: nobody has said. */
static double goal_of(const struct params *params, uint64_t points) {
    double ratio = params->levels.count ? params->levels.ratio[0] : params->ratio;
    return params->points ? fmin((double)params->points, (double)points) : floor(ratio * (double)points);
}

struct params fit_params_of_end(const struct params *params, uint64_t points, uint64_t left) {
    struct params end = *params;
    for (uint32_t i = 0; i < end.levels.count; i++) {
        double kept = fmax(1, floor(params->levels.ratio[i] * (double)points));
        end.levels.ratio[i] = fmin(1, (kept + 0.5) / (double)left); /* which is rounded down */
    }
    if (!isnan(end.ratio)) {
        end.points = (uint64_t)fmax(1, goal_of(params, points));
        end.ratio = NAN;
    }
    return end;
}

/* As many as the stages of a mesh have room for; what they take beside what is predicted is an eighth at most. */
static double mesh_points(const struct params *params, uint64_t points, uint64_t record_bytes) {
    uint64_t least = 0, most = (uint64_t)fmin((double)points, most_kept(fit_room(params)));
    while (least < most) {
        uint64_t middle = least + (most - least + 1) / 2;
        struct params end = fit_params_of_end(params, points, middle);
        const struct memory_job job = {.points = middle, .record_bytes = record_bytes};
        end.threads = 1; /* the same points for any number of them */
        if (memory_predict(&job, &end) <= params->memory_bytes / 8 * 7)
            least = middle;
        else
            most = middle - 1;
    }
    return (double)least;
}

double fit_plan_bytes(double points) {
    enum { CELL = 40, FIXED = 1 << 16 };
    return CELL * fmin(points / GRID_CELL_POINTS, GRID_MOST_CELLS) + FIXED;
}

double fit_wanted(const struct params *params, uint64_t points, uint64_t record_bytes) {
    if (fit_ends_in_memory(params)) return mesh_points(params, points, record_bytes);
    double goal = goal_of(params, points);
    return isnan(goal) ? fmin((double)points, most_kept(fit_room(params))) : goal;
}

enum status fit_kept(const struct params *params, uint64_t points, uint64_t record_bytes, uint64_t room,
                     struct error *error) {
    double most = most_kept(room), wanted = fit_wanted(params, points, record_bytes), goal = goal_of(params, points);
    if (fit_ends_in_memory(params) && (wanted < 4 || goal > wanted))
        return error_set(error, STATUS_NO_MEMORY, "memory",
                         "a mesh of %.0f of %" PRIu64 " points is asked for, and %" PRIu64
                         " MiB have room to make one of %.0f; keep fewer, or allow more memory",
                         goal, points, params->memory_bytes >> 20, wanted);
    if (wanted <= most || (fit_is_tileset(params) && params->levels.count < 2)) return STATUS_OK;
    return error_set(error, STATUS_NO_MEMORY, "memory",
                     "%.0f of %" PRIu64 " points are to be kept, and %" PRIu64
                     " MiB have room to finish %.0f; keep fewer, or allow more memory",
                     wanted, points, params->memory_bytes >> 20, most);
}

/* What is kept doesn't go with the quadrics and links of all of it: the less important ones are told alone. */
static void tell_some(const struct params *params, const struct fit_cloud *cloud, double disk, struct fit_goal *goal) {
    enum { FEW = 32 };
    double told = fmin((double)cloud->points, FIT_MORE_TOLD * goal->wanted), all = cloud->each + FIT_LEFT_BYTES;
    double with = FIT_TOLD_BYTES + FIT_NORMAL_BYTES, left = (disk - with * told) / (all - with);
    goal->told = told;
    goal->tells_normals = left >= told / FEW || params->normals == SWITCH_TRUE;
    if (!goal->tells_normals) left = (disk - FIT_TOLD_BYTES * told) / (all - FIT_TOLD_BYTES);
    goal->left = fmin(goal->left, fmax(fmin(left, disk / all), fmax(told / FEW, 1)));
}

struct fit_goal fit_goal(const struct params *params, const struct fit_cloud *cloud) {
    const double gone = 8, kept = 32; /* bytes in what has gone; of a kept point, beside its record */
    double points = (double)cloud->points, record = (double)cloud->record_bytes, all = cloud->each + FIT_LEFT_BYTES;
    double room = FIT_LEFT * (double)cloud->room, plan = fit_plan_bytes(points);
    double most = cloud->tile_points ? fmin(room, 2 * (double)cloud->tile_points) : room;
    double disk = fmax((FIT_DISK * record - cloud->each) * points - plan, 0);
    struct fit_goal goal = {.wanted = floor(fit_wanted(params, cloud->points, cloud->record_bytes))};
    double wanted = FIT_MORE_THAN_KEPT * goal.wanted;
    goal.ranks_all = fit_is_tileset(params) && params->levels.count < 2 && wanted > most;
    bool is_bounded = !goal.ranks_all && !fit_is_spaced(params);
    if (is_bounded) most = fmin(most, disk / all);
    goal.left = fmin(goal.ranks_all || fit_is_spaced_alone(params) ? most : fmax(most, wanted), points);
    if (is_bounded && fmin(wanted, points) > disk / all) tell_some(params, cloud, disk, &goal);
    double each_told = FIT_TOLD_BYTES + (goal.tells_normals ? FIT_NORMAL_BYTES : 0);
    goal.disk_bytes = cloud->each * points + plan + all * goal.left + each_told * fmax(goal.told - goal.left, 0);
    if (!is_bounded) goal.disk_bytes += gone * points;
    if (goal.ranks_all) goal.disk_bytes += 2 * (kept + record) * goal.wanted;
    return goal;
}

struct tiles_prediction tiles_predict(uint64_t points, uint64_t record_bytes, const struct params *params) {
    enum {
        DOUBLES = 24,
        SHORT = 16,
        LONG = 28,
        ABOUT = 40
    }; /* bytes: positions as they come, records in tiles' files */
    const double each_s = 4.2e-6, kept_s = 2e-6, mesh_s = 20e-6, measured_s = 2e-6;
    bool is_short = record_bytes && record_bytes < DOUBLES;
    const struct fit_cloud cloud = {.points = points,
                                    .record_bytes = record_bytes ? record_bytes : ABOUT,
                                    .each = is_short ? SHORT : LONG,
                                    .room = fit_room(params)};
    struct fit_goal goal = fit_goal(params, &cloud);
    unsigned threads = params->threads ? (unsigned)params->threads : par_processors();
    double seconds = each_s * (double)points * (1 + 1.0 / threads) / 1.5;
    if (fit_ends_in_memory(params)) seconds += mesh_s * goal.wanted + measured_s * (double)points / threads;
    if (goal.ranks_all) seconds += kept_s * goal.wanted;
    return (struct tiles_prediction){(uint64_t)goal.disk_bytes, seconds};
}

enum status tiles_can(const struct params *params, struct error *error) {
    static const char why[] = "isn't done of a cloud that doesn't fit into memory; allow more memory, or simplify to "
                              "a cloud first and give that";
    const char *what = NULL;
    if (params->outputs & OUTPUT_DSO) what = "dso";
    if (params->denoise != DENOISE_NOISY && params_want_denoising(params))
        what = "denoise"; /* that is for meshes alone */
    if (params->normals == SWITCH_TRUE && fit_is_spaced(params)) what = "normals with spacing";
    if (params_bound_deviation(params)) what = "max_deviation";
    if (!isnan(params->max_error)) what = "max_error";
    if (params->weights[0]) what = "weights";
    if (params->properties[0] && fit_is_tileset(params)) what = "properties";
    if (what) return error_set(error, STATUS_NO_MEMORY, "memory", "%s %s", what, why);
    if (fit_room(params) >= 4 * FIT_FEWEST_BLOCKS * FIT_LEAST_BLOCK_POINTS) return STATUS_OK;
    double least = PROGRAM + 4.0 * FIT_FEWEST_BLOCKS * FIT_LEAST_BLOCK_POINTS * part_bytes(params);
    return error_set(error, STATUS_NO_MEMORY, "memory",
                     "%" PRIu64 " MiB are too little even for tiles, which take %.0fM; use that or more",
                     params->memory_bytes >> 20, ceil(least / 0x1p20));
}
