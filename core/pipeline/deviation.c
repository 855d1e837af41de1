/* How far the points are from a result, against a bound: of all of them, or of the share that it is to hold for.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"
#include "core/pipeline/pipeline_run.h"
#include "core/spatial/bvh.h"

double pipeline_deviation_bound(const struct run *run) {
    const struct params *params = run->params;
    return isnan(params->max_deviation) ? params->max_deviation_rel * run->points.diagonal : params->max_deviation;
}

size_t pipeline_deviation_spare(const struct run *run) {
    const double rounding = 1e-12; /* 0.9 of ten points are nine */
    double n = (double)run->points.count;
    return run->points.count - (size_t)ceil(run->params->deviation_share * n * (1 - rounding));
}

/* Adds the point to what is known, and returns its distance in the input's units. */
static double note(const struct run *run, size_t point, double distance, double bound, struct reach *reach) {
    double d = distance * run->points.scale;
    reach->over += d > bound;
    if (d > reach->max || point == 0) reach->max = d, reach->farthest = point;
    return d;
}

/* Chunks of queries, so that the hits of all points need not be held at once. */
enum { REACH_CHUNK = 1 << 16 };

static enum status note_mesh(const struct run *run, double bound, float *distance, struct reach *reach) {
    size_t n = run->points.count;
    struct bvh *bvh = NULL;
    struct bvh_hit *hit = alloc_array(REACH_CHUNK, sizeof *hit);
    enum status status = hit ? bvh_new(&run->mesh, run->threads, &bvh) : STATUS_NO_MEMORY;
    for (size_t begin = 0; !status && begin < n; begin += REACH_CHUNK) {
        size_t m = n - begin < REACH_CHUNK ? n - begin : REACH_CHUNK;
        bvh_closest_all(bvh, &run->points.point[begin], m, run->threads, hit);
        for (size_t i = 0; i < m; i++)
            distance[begin + i] = (float)note(run, begin + i, sqrt(hit[i].distance_sq), bound, reach);
    }
    bvh_free(bvh);
    free(hit);
    return status;
}

enum status pipeline_find_reach(struct run *run, struct reach *reach) {
    size_t n = run->points.count, spare = pipeline_deviation_spare(run);
    double bound = pipeline_deviation_bound(run);
    *reach = (struct reach){0};
    float *distance = alloc_array(n, sizeof *distance);
    enum status status = distance ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status && run->mesh_follows) status = note_mesh(run, bound, distance, reach);
    for (size_t i = 0; !status && !run->mesh_follows && i < n; i++)
        distance[i] = (float)note(run, i, (double)run->distance[i], bound, reach);
    if (!run->mesh_follows) reach->max = run->report.level[run->level].tangent.max; /* the others are rounded */
    reach->at_share = reach->max;
    reach->holds = spare > 0 ? reach->over <= spare : reach->max <= bound;
    if (!status && spare > 0) {
        double rank = (double)(n - spare - 1);
        double rounded = (double)quantile_of(distance, n, (rank + 0.5) / (double)(n - 1));
        reach->at_share = reach->holds ? fmin(rounded, bound) : fmax(rounded, bound);
    }
    free(distance);
    return status;
}

enum status pipeline_verify(struct run *run) {
    const struct report_level *level = &run->report.level[run->level];
    struct report_deviation *deviation = &run->report.deviation;
    struct reach reach = {.at_share = run->mesh_follows ? level->input_to_mesh.max : level->tangent.max};
    deviation->bound = pipeline_deviation_bound(run);
    deviation->share = run->params->deviation_share;
    reach.holds = reach.at_share <= deviation->bound;
    enum status status = deviation->share < 1 ? pipeline_find_reach(run, &reach) : STATUS_OK;
    if (status) return pipeline_no_memory(run, "search");
    deviation->reached = reach.at_share;
    deviation->points_over = reach.over;
    if (reach.holds) return STATUS_OK;
    return error_set(run->error, STATUS_ENGINE, "search", "the result is %g from the input, %g when it was tried",
                     deviation->reached, deviation->bound);
}
