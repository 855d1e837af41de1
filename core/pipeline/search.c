/* The step between 6 and 7: how few points may be kept if no input point is to be farther from the result than wanted.
 *
 * Distances from the result are known only once it is made and measured, so counts are tried: each is a prefix of the
 * ranking, simplified, reconstructed and refined as it will be in the end.  A larger count isn't always nearer, so
 * nothing is concluded from one count to another.  The search keeps a count that holds and one that doesn't below it
 *
 *     fails  <  ...tried next: their geometric mean...  <  holds
 *
 * and ends when they are within 1 %, or after MOST trials, with a count that was measured to hold.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/measure/metro.h"
#include "core/pipeline/pipeline_run.h"

enum { MOST = 24, STRIDE = 4 };
static const double CLOSE = 1.01, PER_TRIAL = 0.15 /* of the progress that is left */;

struct search {
    struct run *run;
    double bound, of_holds, of_all; /* in the input's units */
    size_t least, fails, holds;     /* holds: 0 = none so far */
};

/* The steps of a trial each begin at 0; how many trials there will be isn't known. */
struct part {
    struct progress whole;
    double done;
};

static int part_tick(void *ctx, const char *stage, double fraction) {
    (void)stage, (void)fraction;
    const struct part *part = ctx;
    return progress_tick(&part->whole, "search", part->done);
}

double pipeline_deviation_bound(const struct run *run) {
    const struct params *params = run->params;
    return isnan(params->max_deviation) ? params->max_deviation_rel * run->points.diagonal : params->max_deviation;
}

static enum status make_mesh(struct run *run) {
    enum status status = pipeline_delaunay(run);
    if (!status) status = pipeline_reconstruct(run);
    bool refined = !status && run->params->refine != REFINE_NONE;
    if (refined) status = pipeline_local_delaunay(run) ? pipeline_no_memory(run, "local_delaunay") : STATUS_OK;
    if (refined && !status) status = pipeline_refine(run);
    if (!status && !isnan(run->params->close_holes)) status = pipeline_close_holes(run);
    return status;
}

static enum status measure_mesh(struct run *run, double *deviation) {
    struct distance_stats stats;
    struct metro_options options = {.threads = run->threads, .progress = &run->progress};
    enum status status = metro_points(run->points.point, run->points.count, &run->mesh, &options, &stats);
    if (!status) *deviation = stats.max * run->points.scale;
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "search") : status;
}

/* The deviation with the points that run->searched says; what was made for it is gone afterwards. */
static enum status try_count(struct run *run, double *deviation) {
    enum status status = pipeline_keep(run);
    if (!status && run->mesh_follows) {
        status = make_mesh(run);
        if (!status) status = measure_mesh(run, deviation);
    } else if (!status) {
        status = pipeline_tangent(run) ? pipeline_no_memory(run, "tangent") : STATUS_OK;
        if (!status) *deviation = run->report.level[0].tangent.max;
    }
    pipeline_leave_level(run);
    free(run->kept);
    run->kept = NULL;
    run->report.level[0] = (struct report_level){0};
    return status;
}

static size_t next_count(const struct search *s, size_t tried) {
    size_t all = s->run->fits;
    if (!s->holds) return tried < all / STRIDE ? tried * STRIDE : all;
    if (s->fails < s->least) return tried / STRIDE > s->least ? tried / STRIDE : s->least;
    size_t middle = (size_t)sqrt((double)s->fails * (double)s->holds);
    return middle > s->fails ? middle : s->fails + 1;
}

static bool is_found(const struct search *s) {
    return s->holds && (s->holds <= s->fails + 1 || (double)s->holds <= CLOSE * (double)s->fails);
}

static enum status try_and_note(struct search *s, size_t count) {
    double deviation = INFINITY;
    s->run->searched = count;
    enum status status = try_count(s->run, &deviation);
    if (status == STATUS_DEGENERATE && count < s->run->fits) status = STATUS_OK; /* too few for a mesh */
    if (!status && deviation <= s->bound) s->holds = count, s->of_holds = deviation;
    if (!status && deviation > s->bound) s->fails = count;
    if (count == s->run->fits) s->of_all = deviation;
    return status;
}

enum status pipeline_search(struct run *run) {
    struct search s = {.run = run, .bound = pipeline_deviation_bound(run), .least = pipeline_wanted_points(run, 0)};
    struct progress whole = run->progress;
    struct part part = {.whole = whole};
    size_t all = run->fits;
    size_t count = contraction_count_for_error(&run->contraction, s.bound / run->points.scale);
    if (count < s.least) count = s.least;
    if (count > all) count = all;
    s.fails = s.least - 1;
    enum status status = STATUS_OK;
    uint64_t *tried = &run->report.deviation.tried;
    for (run->progress = (struct progress){part_tick, &part}; !status && *tried < MOST && !is_found(&s); ++*tried) {
        status = try_and_note(&s, count);
        if (s.fails == all) break;
        count = next_count(&s, count);
        part.done += PER_TRIAL * (1 - part.done);
    }
    run->progress = whole;
    run->searched = s.holds;
    if (status || s.holds) return status;
    return error_set(run->error, STATUS_BAD_PARAMETER,
                     isnan(run->params->max_deviation) ? "max_deviation_rel" : "max_deviation",
                     "can't be held: with all %zu points kept, one is still %g from the %s (%g of the diagonal)", all,
                     s.of_all, run->mesh_follows ? "mesh" : "tangent planes", s.of_all / run->points.diagonal);
}

enum status pipeline_verify(struct run *run) {
    const struct report_level *level = &run->report.level[run->level];
    struct report_deviation *deviation = &run->report.deviation;
    deviation->bound = pipeline_deviation_bound(run);
    deviation->reached = run->mesh_follows ? level->input_to_mesh.max : level->tangent.max;
    if (deviation->reached <= deviation->bound) return STATUS_OK;
    return error_set(run->error, STATUS_ENGINE, "search", "the result is %g from the input, %g when it was tried",
                     deviation->reached, deviation->bound);
}
