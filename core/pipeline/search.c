/* The step between 6 and 7: how few points may be kept if no input point is to be farther from the result than wanted,
 * or no more than the share that is spared.
 *
 * Distances from the result are known only once it is made and measured, so counts are tried: each is a prefix of the
 * ranking, simplified, reconstructed and refined as it will be in the end.  A larger count isn't always nearer, so
 * nothing is concluded from one count to another.  The search keeps a count that holds and one that doesn't below it
 *
 *     fails  <  ...tried next...  <  holds
 *
 * and ends when they are within CLOSE, or even by the steepest fall of distances no count between them would hold, or
 * after MOST trials, with a count that was measured to hold.  Distances fall about as a power of the count, which the
 * last trials tell: the next one is where that line meets the bound.  A bound that not even all points hold is found
 * out by them before many others are tried: at once where it is far below the distances between points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"
#include "core/pipeline/pipeline_run.h"

enum { MOST = 8, MOST_IN_VAIN = 4 /* before all points are tried */ };
static const double CLOSE = 1.03, PER_TRIAL = 0.15 /* of the progress that is left */;
static const double TINY = 0.01;        /* of the distance between points: all are tried first */
static const double ALL_FROM = 1.0 / 3; /* of all points: where so many seem to do, all are tried */
static const double STEP_LEAST = 1.5, STEP_MOST = 16, MARGIN = 1.15; /* of counts, beyond where the line says */
static const double FLATTEST = 0.5, STEEPEST = 2, USUAL = 1;         /* the power */
static const double NEAREST = 0.15; /* of the way between two counts, no nearer to either of them */

struct trial {
    size_t count;   /* 0 = there is none */
    double reached; /* in the input's units; INFINITY: there is no such mesh */
};

struct search {
    struct run *run;
    double bound; /* in the input's units */
    size_t least; /* points that are kept in any case */
    struct trial fails, holds, last, before;
    struct reach of_all;
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

static enum status make_mesh(struct run *run) {
    enum status status = pipeline_delaunay(run);
    if (!status) status = pipeline_reconstruct(run);
    bool refined = !status && run->params->refine != REFINE_NONE;
    if (refined) status = pipeline_local_delaunay(run) ? pipeline_no_memory(run, "local_delaunay") : STATUS_OK;
    if (refined && !status) status = pipeline_refine(run);
    if (!status && !isnan(run->params->close_holes)) status = pipeline_close_holes(run);
    return status;
}

/* How far the points are from the result with as many as run->searched says.  What was made for it is gone
 * afterwards. */
static enum status try_count(struct run *run, struct reach *reach) {
    enum status status = pipeline_keep(run);
    if (!status && run->mesh_follows)
        status = make_mesh(run);
    else if (!status)
        status = pipeline_tangent(run) ? pipeline_no_memory(run, "tangent") : STATUS_OK;
    if (!status && pipeline_find_reach(run, reach)) status = pipeline_no_memory(run, "search");
    pipeline_leave_level(run);
    free(run->kept);
    run->kept = NULL;
    run->report.level[0] = (struct report_level){0};
    return status;
}

static bool has_failed(const struct search *s) { return s->fails.count >= s->least; }

static double within(double value, double least, double most) {
    return value > least ? fmin(value, most) : least; /* least, if it is no number */
}

/* The power of counts by which distances fall, as two trials have it. */
static double steepness(const struct trial *a, const struct trial *b) {
    double power = -log(a->reached / b->reached) / log((double)a->count / (double)b->count);
    return isfinite(power) ? within(power, FLATTEST, STEEPEST) : USUAL;
}

/* From one side of the bound to the other. */
static size_t step_over(const struct search *s) {
    size_t all = s->run->fits;
    double times = pow(s->last.reached / s->bound, 1 / (s->before.count ? steepness(&s->before, &s->last) : USUAL));
    if (s->last.reached > s->bound) {
        double count = (double)s->last.count * within(times * MARGIN, STEP_LEAST, STEP_MOST);
        return count < ALL_FROM * (double)all ? (size_t)count : all;
    }
    double count = (double)s->last.count * within(times / MARGIN, 1 / STEP_MOST, 1 / STEP_LEAST);
    return count > (double)s->least ? (size_t)count : s->least;
}

/* Where the line through both meets the bound; half-way after two trials on the same side, as it is bent then. */
static size_t step_between(const struct search *s) {
    bool again = (s->last.reached > s->bound) == (s->before.reached > s->bound);
    double way = log(s->fails.reached / s->bound) / log(s->fails.reached / s->holds.reached);
    way = again || !isfinite(way) ? 0.5 : within(way, NEAREST, 1 - NEAREST);
    double times = pow((double)s->holds.count / (double)s->fails.count, way);
    size_t count = (size_t)((double)s->fails.count * times);
    if (count >= s->holds.count) count = s->holds.count - 1;
    return count > s->fails.count ? count : s->fails.count + 1;
}

static bool is_found(const struct search *s) {
    if (!s->holds.count) return false;
    double steepest = pow(s->fails.reached / s->bound, 1 / STEEPEST);
    double close = has_failed(s) && isfinite(s->fails.reached) ? fmax(CLOSE, steepest) : CLOSE;
    return s->holds.count <= s->fails.count + 1 || (double)s->holds.count <= close * (double)s->fails.count;
}

static enum status try_and_note(struct search *s, size_t count) {
    struct reach reach = {.at_share = INFINITY};
    s->run->searched = count;
    enum status status = try_count(s->run, &reach);
    if (status == STATUS_DEGENERATE && count < s->run->fits) status = STATUS_OK; /* too few for a mesh */
    s->before = s->last;
    s->last = (struct trial){count, reach.at_share};
    if (!status && reach.holds)
        s->holds = s->last;
    else if (!status)
        s->fails = s->last;
    if (count == s->run->fits) s->of_all = reach;
    return status;
}

/* Whether the bound is so far below the distances between points that it is doubtful whether all of them hold it. */
static enum status find_tiny(const struct run *run, double bound, bool *tiny) {
    size_t n = run->points.count;
    *tiny = false;
    if (!run->neighbours.spacing) return STATUS_OK; /* without a mesh, trials take hardly any time */
    float *spacing = alloc_array(n, sizeof *spacing);
    if (!spacing) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < n; i++) spacing[i] = run->neighbours.spacing[i];
    *tiny = bound < TINY * run->points.scale * (double)quantile_of(spacing, n, 0.5);
    free(spacing);
    return STATUS_OK;
}

/* What isn't held, where, and what would be. */
static enum status refuse_bound(const struct search *s) {
    const struct run *run = s->run;
    const struct params *params = run->params;
    const struct reach *reach = &s->of_all;
    bool is_rel = isnan(params->max_deviation),
         drops = params->denoise == DENOISE_OUTLIERS || params->denoise == DENOISE_FULL;
    const char *name = is_rel ? "max_deviation_rel" : "max_deviation";
    vec3 p = run->cloud->position[run->points.original[reach->farthest]];
    double n = (double)run->points.count, share = floor(1e4 * (n - (double)reach->over) / n) / 1e4;
    char others[64] = "";
    if (share > 0 && share < params->deviation_share) snprintf(others, sizeof others, ", deviation_share=%g", share);
    return error_set(run->error, STATUS_BAD_PARAMETER, name,
                     "can't be held: with all %zu points kept, %zu are still farther from the %s than %.4g, up to "
                     "%.4g, at %.9g %.9g %.9g; use %s=%.3g%s%s",
                     run->fits, reach->over, run->mesh_follows ? "mesh" : "tangent planes", s->bound, reach->max, p.x,
                     p.y, p.z, name, 1.01 * reach->at_share / (is_rel ? run->points.diagonal : 1), others,
                     drops ? "" : ", or denoise=outliers if they are strays");
}

/* Tries counts, from `count` on. */
static enum status try_counts(struct search *s, size_t count, struct part *part) {
    struct run *run = s->run;
    size_t all = run->fits, first = count;
    bool tiny = false;
    uint64_t *tried = &run->report.deviation.tried;
    if (find_tiny(run, s->bound, &tiny)) return pipeline_no_memory(run, "search");
    if (tiny) count = all;
    while (*tried < MOST && !is_found(s)) {
        enum status status = try_and_note(s, count);
        ++*tried;
        if (status || s->fails.count == all) return status;
        if (count == all && first < all && !has_failed(s))
            count = first;
        else if (!s->holds.count && *tried >= MOST_IN_VAIN)
            count = all;
        else
            count = s->holds.count && has_failed(s) ? step_between(s) : step_over(s);
        part->done += PER_TRIAL * (1 - part->done);
    }
    return STATUS_OK;
}

enum status pipeline_search(struct run *run) {
    struct search s = {.run = run, .bound = pipeline_deviation_bound(run), .least = pipeline_wanted_points(run, 0)};
    struct progress whole = run->progress;
    struct part part = {.whole = whole};
    size_t count = contraction_count_for_error(&run->contraction, s.bound / run->points.scale);
    if (count < s.least) count = s.least;
    if (count > run->fits) count = run->fits;
    s.fails.count = s.least - 1;
    run->progress = (struct progress){part_tick, &part};
    enum status status = try_counts(&s, count, &part);
    run->progress = whole;
    run->searched = s.holds.count;
    if (status || s.holds.count) return status;
    return refuse_bound(&s);
}
