/* Where a cloud was scanned from, where neither the input nor a parameter says: by the order of its points, or else by
 * the lattice that their rays are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"
#include "core/pipeline/pipeline_run.h"
#include "core/surface/sheet/eye.h"
#include "core/surface/sheet/globe.h"
#include "core/surface/sheet/orient.h"
#include "core/surface/sheet/sweep.h"

static const double BESIDE = 0.02;    /* of the distance to the points, that a place is told wrongly by */
static const double MOST_PARTS = 0.5; /* of the order, that must be explained */

/* To each point the place that its part of the order was seen from; itself where that isn't known. */
static vec3 *spread_eyes(const struct run *run, const struct sweep *sweep) {
    size_t n = run->cloud->count;
    vec3 *each = alloc_array(run->points.count, sizeof *each);
    for (size_t p = 0; each && p < run->points.count; p++) each[p] = run->points.point[p];
    for (size_t i = 0; each && i < n; i++) {
        size_t part = i * sweep->parts / n;
        if (sweep->known[part] && run->points.distinct[i] != NONE)
            each[run->points.distinct[i]] = pipeline_in_frame(run, sweep->eye[part]);
    }
    return each;
}

bool scan_pattern_one_place(const struct run *run, vec3 *place) {
    const struct scan_pattern *pattern = &run->pattern;
    size_t known = 0;
    vec3 sum = {0, 0, 0};
    for (size_t p = 0; pattern->places == 1 && p < run->points.count; p++) {
        vec3 view = pattern->views.each[p];
        if (vec3_distance_sq(view, run->points.point[p]) == 0) continue; /* not known */
        sum = vec3_add(sum, view), known++;
    }
    if (known > 0) *place = vec3_scale(sum, 1 / (double)known);
    return known > 0;
}

bool scan_pattern_sees_no_back(const struct run *run) {
    return run->pattern.sweep.one || (run->pattern.lattice_sought && run->pattern.lattice.found);
}

/* Whether a place that the points tell of, in the frame they are in, is about the middle of a globe: that is told. */
static enum status find_globe(const vec3 *point, size_t n, vec3 place, struct scan_pattern *pattern, bool *is) {
    vec3 middle;
    enum status status = globe_is_around(point, n, place, &middle, is);
    if (status || !*is) return status;
    pattern->globe = true, pattern->middle = middle;
    return STATUS_OK;
}

/* Forgets the one place that the order tells of where it is that. */
static enum status doubt_sweep(const struct run *run, struct scan_pattern *pattern) {
    struct sweep *sweep = &pattern->sweep;
    vec3 sum = {0, 0, 0};
    size_t known = 0;
    bool is_globe = false;
    for (size_t i = 0; i < sweep->parts && sweep->places == 1; i++)
        if (sweep->known[i]) sum = vec3_add(sum, sweep->eye[i]), known++;
    if (known == 0) return STATUS_OK;
    enum status status =
        find_globe(run->cloud->position, run->cloud->count, vec3_scale(sum, 1 / (double)known), pattern, &is_globe);
    if (is_globe) *sweep = (struct sweep){.complete = sweep->complete};
    return status;
}

/* By the points as they came: moved to where a surface seems to be, they are on other rays.  one_alone: whether all
 * were seen from one place is all that is asked. */
static enum status find_sweep_as(struct run *run, bool one_alone, struct scan_pattern *pattern) {
    if (pattern->order_sought && (one_alone || pattern->sweep.complete)) return STATUS_OK;
    enum status status = sweep_find(run->cloud->position, run->cloud->count, one_alone, run->threads, &pattern->sweep);
    if (!status) status = doubt_sweep(run, pattern);
    pattern->order_sought = !status;
    return status;
}

static enum status find_sweep(struct run *run, struct scan_pattern *pattern) {
    return find_sweep_as(run, false, pattern);
}

static enum status seek_by_order(struct run *run, struct scan_pattern *pattern) {
    enum status status = find_sweep(run, pattern);
    if (status || pattern->sweep.share <= MOST_PARTS) return status;
    pattern->views.each = spread_eyes(run, &pattern->sweep);
    if (!pattern->views.each) return STATUS_NO_MEMORY;
    pattern->places = pattern->sweep.places;
    return STATUS_OK;
}

/* Cameras and scanners are at the origin of what they tell, so that is asked first: among the points, or as far from
 * their middle as some of their diagonals. */
static bool is_origin_near(const struct run *run) {
    static const double DIAGONALS = 4;
    return vec3_length(run->points.centre) < DIAGONALS * run->points.diagonal;
}

static vec3 from_frame(const struct run *run, vec3 p) {
    return vec3_add(vec3_scale(p, run->points.scale), run->points.centre);
}

/* Of points as they came, which need an index of their own where they were moved, or where there is none: then it isn't
 * sought among too many.  origin_alone: no other place is tried. */
static enum status seek_lattice(const struct run *run, bool origin_alone, struct scan_pattern *pattern) {
    enum { MOST = 2000000 };
    const vec3 *point = run->moved ? run->cloud->position : run->points.point;
    size_t n = run->moved ? run->cloud->count : run->points.count;
    struct knn *own = NULL;
    struct lattice *lattice = &pattern->lattice;
    enum status status = STATUS_OK;
    *lattice = (struct lattice){.at = run->moved ? (vec3){0, 0, 0} : pipeline_in_frame(run, (vec3){0, 0, 0})};
    if (run->moved || !run->knn) {
        if (n > MOST) return STATUS_OK;
        status = knn_new(point, n, run->threads, &own, NULL);
    }
    const struct knn *knn = own ? own : run->knn;
    if (!status && !pattern->origin_asked && is_origin_near(run))
        status = lattice_is_from(point, n, knn, run->threads, lattice->at, &lattice->found);
    if (!status && !lattice->found && !origin_alone) status = lattice_find(point, n, knn, run->threads, lattice);
    bool is_globe = false;
    if (!status && lattice->found) status = find_globe(point, n, lattice->at, pattern, &is_globe);
    lattice->found = lattice->found && !is_globe;
    knn_free(own);
    if (!run->moved && is_globe) pattern->middle = from_frame(run, pattern->middle);
    if (!run->moved) lattice->at = from_frame(run, lattice->at);
    return status;
}

/* Whatever the order is; *at in the frame of run->points, which dropping points changes. */
static enum status find_lattice(struct run *run, bool *found, vec3 *at) {
    struct scan_pattern *pattern = &run->pattern;
    enum status status = pattern->lattice_sought ? STATUS_OK : seek_lattice(run, false, pattern);
    pattern->lattice_sought = !status;
    *found = !status && pattern->lattice.found;
    *at = pipeline_in_frame(run, pattern->lattice.at);
    return status;
}

static enum status seek_by_lattice(struct run *run, struct scan_pattern *pattern) {
    bool found = false;
    vec3 at;
    enum status status = find_lattice(run, &found, &at);
    if (status || !found) return status;
    pattern->views = (struct views){.is_one = true, .one = at};
    pattern->places = 1;
    return STATUS_OK;
}

/* Whether the rays tell exactly that all points were seen from the place told, or from one far from it. */
static enum status find_denied(struct run *run, vec3 told) {
    struct scan_pattern *pattern = &run->pattern;
    vec3 seen_from;
    enum status status = find_sweep_as(run, true, pattern);
    bool one = pattern->sweep.one, found = false;
    if (!status && !one) status = find_lattice(run, &found, &seen_from);
    if (status || (!one && !found)) return status;
    if (one) seen_from = pipeline_in_frame(run, pattern->sweep.eye[0]);
    vec3 at = one ? pattern->sweep.eye[0] : pattern->lattice.at;
    pattern->seen_from = at;
    double far = fmax(vec3_length(seen_from), vec3_length(told)); /* from the middle of the points */
    pattern->denies = vec3_distance(told, seen_from) > BESIDE * far;
    pattern->agrees = !pattern->denies;
    if (pattern->denies)
        left_out_add(&run->report.left_out, "input",
                     LEFT_OUT_NOTE
                     "viewpoint: the rays tell that the points were seen from %.6g, %.6g, %.6g, which is believed",
                     at.x, at.y, at.z);
    return STATUS_OK;
}

static enum status find_hidden(struct run *run, vec3 told) {
    double share = 0;
    enum status status = pipeline_hidden_from(run, told, &share, &run->pattern.hides);
    if (run->pattern.hides)
        left_out_add(&run->report.left_out, "input",
                     "viewpoint: %.0f %% of the points are hidden behind others from there, so they weren't all seen "
                     "from it: each piece of the surface faces it as a whole",
                     100 * share);
    return status;
}

enum status scan_pattern_check_told(struct run *run, struct views *views) {
    struct scan_pattern *pattern = &run->pattern;
    enum status status = STATUS_OK;
    if (!views->is_one) return STATUS_OK;
    bool checks = !pattern->told_checked;
    if (checks) status = find_denied(run, views->one);
    if (!status && checks && !pattern->denies && !pattern->agrees) status = find_hidden(run, views->one);
    pattern->told_checked = true;
    if (pattern->denies) views->one = pipeline_in_frame(run, pattern->seen_from);
    return status;
}

enum status scan_pattern_told_place(struct run *run, bool *told, bool *known, vec3 *place) {
    struct views views = {0};
    enum status status = pipeline_views(run, &views);
    if (!status) status = scan_pattern_check_told(run, &views);
    *known = views.is_one && !run->pattern.hides, *place = views.one;
    *told = views.is_one || views.each;
    free(views.each);
    return status;
}

enum status pipeline_seek_pattern(struct run *run) {
    struct scan_pattern *pattern = &run->pattern;
    if (pattern->sought) return STATUS_OK;
    pattern->sought = true;
    enum status status = seek_by_order(run, pattern);
    return status || pattern->places ? status : seek_by_lattice(run, pattern);
}

enum status scan_pattern_exact_place(struct run *run, bool *known, vec3 *place) {
    struct scan_pattern *pattern = &run->pattern;
    enum status status = find_sweep_as(run, true, pattern);
    *known = false;
    if (status) return status;
    if (pattern->sweep.one) {
        *known = true, *place = pipeline_in_frame(run, pattern->sweep.eye[0]);
        return STATUS_OK;
    }
    if (!pattern->lattice_sought && !pattern->origin_asked && is_origin_near(run))
        status = seek_lattice(run, true, pattern);
    if (status) return status;
    pattern->origin_asked = true;
    pattern->lattice_sought = pattern->lattice_sought || pattern->lattice.found;
    *known = pattern->lattice.found, *place = pipeline_in_frame(run, pattern->lattice.at);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ ranges */

/* The one place that all points were seen from, where the input, the order of its points or, of points that are dense
 * somewhere, as they are near a scanner, their rays tell it. */
static enum status find_place(struct run *run, bool *known, vec3 *place) {
    bool told = false, sought = false;
    enum status status = scan_pattern_told_place(run, &told, known, place);
    if (status || told) return status;
    status = find_sweep(run, &run->pattern);
    const struct sweep *sweep = &run->pattern.sweep;
    if (!status && sweep->share <= MOST_PARTS)
        status = eye_is_sought(run->points.point, run->points.count, run->threads, &sought);
    if (!status && sought) return find_lattice(run, known, place);
    if (status || sweep->share <= MOST_PARTS || sweep->places != 1) return status;
    for (size_t i = 0; i < sweep->parts && !*known; i++)
        if (sweep->known[i]) *known = true, *place = pipeline_in_frame(run, sweep->eye[i]);
    return STATUS_OK;
}

enum status pipeline_ranges(struct run *run, float **range) {
    static const float NEAREST = 0.1F; /* of the median */
    size_t n = run->points.count;
    bool known = false;
    vec3 place;
    *range = NULL;
    enum status status = find_place(run, &known, &place);
    if (status || !known) return status;
    float *found = alloc_array(n, sizeof *found), *sorted = alloc_array(n, sizeof *sorted);
    if (!found || !sorted) status = STATUS_NO_MEMORY;
    for (size_t p = 0; p < n && !status; p++) found[p] = sorted[p] = (float)vec3_distance(place, run->points.point[p]);
    float least = status ? 0 : NEAREST * quantile_of(sorted, n, 0.5);
    for (size_t p = 0; p < n && !status; p++) found[p] = fmaxf(found[p], least);
    free(sorted);
    if (status || !(least > 0))
        free(found);
    else
        *range = found;
    return status;
}
