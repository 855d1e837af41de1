/* The step between 3 and 4 that asks which side of the surface is in front: what the input and the parameters say of
 * it, and, where normals are to be written, which of them are to be turned: the stages go by the signs that normals
 * have, so that nothing else changes with that.  Where the input has normals that fit, the fitted ones get their signs,
 * by which closed surfaces tell inside from outside, and a plate from a height field.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"
#include "core/pipeline/pipeline_run.h"
#include "core/pipeline/sides.h"
#include "core/simplify/normal_sides.h"
#include "core/surface/sheet/globe.h"
#include "core/surface/sheet/hidden.h"
#include "core/text/number.h"

/* ------------------------------------------------------------------------------------------------ normals */

/* The normals that the input has, along the curve; *normal stays NULL where it has none. */
static enum status load_normals(const struct run *run, vec3 **normal) {
    const struct cloud *cloud = run->cloud;
    const struct property *x = attribute_find(cloud, "nx"), *y = attribute_find(cloud, "ny"),
                          *z = attribute_find(cloud, "nz");
    if (!x || !y || !z) return STATUS_OK;
    *normal = alloc_array(run->points.count, sizeof **normal);
    for (size_t i = 0; *normal && i < run->points.count; i++) {
        const unsigned char *record = cloud->record + run->points.original[i] * cloud->record_bytes;
        vec3 given = {scalar_load(record + x->offset_bytes, x->type), scalar_load(record + y->offset_bytes, y->type),
                      scalar_load(record + z->offset_bytes, z->type)};
        (*normal)[i] = vec3_is_finite(given) ? given : (vec3){0, 0, 0};
    }
    return *normal ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status pipeline_given_normals(const struct run *run, vec3 **normal) {
    return run->normals_fit ? load_normals(run, normal) : STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ viewers */

static bool is_pcd(const struct cloud *cloud) { return cloud->form && strncmp(cloud->form, "pcd/", 4) == 0; }

/* Points beside the origin, not around it or far off, as those of a map are. */
static bool are_beside_origin(const struct run *run) {
    double away_sq = 0;
    for (int k = 0; k < 3; k++) {
        double away = fmax(run->report.box_min[k], -run->report.box_max[k]);
        if (away > 0) away_sq += away * away;
    }
    return away_sq > 0 && sqrt(away_sq) < run->points.diagonal;
}

enum status pipeline_hidden_from(const struct run *run, vec3 place, double *share, bool *hides) {
    static const double HIDDEN = 0.15;
    enum status status = hidden_share(run->points.point, run->points.count, place, run->threads, share);
    *hides = !status && *share > HIDDEN;
    return status;
}

enum status pipeline_doubt_origin(struct run *run) {
    double share = 0;
    bool hides = false, is_globe = false;
    vec3 origin = pipeline_in_frame(run, (vec3){0, 0, 0}), middle;
    run->seen_from_origin = is_pcd(run->cloud) && are_beside_origin(run);
    if (!run->seen_from_origin) return STATUS_OK;
    enum status status = pipeline_hidden_from(run, origin, &share, &hides);
    if (!status && !hides) status = globe_is_around(run->points.point, run->points.count, origin, &middle, &is_globe);
    run->seen_from_origin = !hides && !is_globe;
    return status;
}

vec3 pipeline_in_frame(const struct run *run, vec3 p) {
    return vec3_scale(vec3_sub(p, run->points.centre), 1 / run->points.scale);
}

/* Where a PCD file says that it was scanned from: what it has where nobody said isn't kept as a comment. */
static bool find_pcd_view(const struct run *run, vec3 *view) {
    static const char mark[] = "viewpoint ";
    const char *at = run->cloud->comments ? strstr(run->cloud->comments, mark) : NULL;
    double given[3] = {0, 0, 0};
    char *text = NULL;
    if (!is_pcd(run->cloud)) return false;
    if (at) at += sizeof mark - 1;
    for (int k = 0; at && k < 3; k++, at = text) given[k] = number_read(at, &text);
    *view = (vec3){given[0], given[1], given[2]};
    return at || run->seen_from_origin;
}

/* The one place that all was seen from. */
static bool find_one_view(const struct run *run, vec3 *view) {
    const struct param_numbers *given = &run->params->viewpoint;
    const struct cloud *cloud = run->cloud;
    if (given->count) {
        *view = (vec3){given->value[0], given->value[1], given->value[2]};
        return true;
    }
    if (cloud->view_count == 1) *view = cloud->view[0];
    return cloud->view_count == 1 || (cloud->view_count == 0 && find_pcd_view(run, view));
}

enum status pipeline_views(const struct run *run, struct views *views) {
    const struct cloud *cloud = run->cloud;
    size_t n = run->points.count;
    vec3 one;
    views->is_one = find_one_view(run, &one);
    if (views->is_one) views->one = pipeline_in_frame(run, one);
    const struct property *scan = attribute_find(cloud, CLOUD_SCAN);
    if (views->is_one || cloud->view_count == 0 || !scan) return STATUS_OK;
    views->each = alloc_array(n, sizeof *views->each);
    for (size_t i = 0; views->each && i < n; i++) {
        const unsigned char *record = cloud->record + run->points.original[i] * cloud->record_bytes;
        double number = scalar_load(record + scan->offset_bytes, scan->type);
        bool known = number >= 0 && number < (double)cloud->view_count && vec3_is_finite(cloud->view[(size_t)number]);
        views->each[i] = known ? pipeline_in_frame(run, cloud->view[(size_t)number]) : run->points.point[i];
    }
    return views->each ? STATUS_OK : STATUS_NO_MEMORY;
}

/* ------------------------------------------------------------------------------------------------ the step */

static enum status turn(struct run *run, const vec3 *given) {
    static const char *const names[] = {[NORMALS_BY_GIVEN] = "normals",
                                        [NORMALS_BY_VIEW] = "viewpoint",
                                        [NORMALS_UP] = "upwards",
                                        [NORMALS_OUT] = "outwards"};
    struct views views = {0};
    enum normal_side side = NORMALS_OUT;
    size_t n = run->points.count;
    vec3 *turned = alloc_array(n, sizeof *turned);
    run->turned = alloc_array(n, sizeof *run->turned);
    enum status status = turned && run->turned ? pipeline_views(run, &views) : STATUS_NO_MEMORY;
    if (!status && views.is_one && !given) {
        views.each = alloc_array(n, sizeof *views.each);
        for (size_t i = 0; views.each && i < n; i++) views.each[i] = views.one;
        if (!views.each) status = STATUS_NO_MEMORY;
    }
    struct normal_evidence evidence = {given, views.each};
    if (!status) {
        memcpy(turned, run->normal, n * sizeof *turned);
        status = normals_turn(run->points.point, &run->neighbours, &evidence, turned, &side);
        for (size_t i = 0; i < n; i++) run->turned[i] = vec3_dot(turned[i], run->normal[i]) < 0;
    }
    free(views.each), free(turned);
    snprintf(run->report.normals.orientation, sizeof run->report.normals.orientation, "%s", names[side]);
    return status;
}

/* Turns the fitted normals to the sides of the given ones. */
static void take_sides(struct run *run, const vec3 *given) {
    for (size_t p = 0; p < run->points.count; p++)
        if (vec3_dot(given[p], run->normal[p]) < 0) run->normal[p] = vec3_scale(run->normal[p], -1);
}

enum status pipeline_sides(struct run *run) {
    vec3 *given = NULL;
    enum status status = load_normals(run, &given);
    struct report_normals *report = &run->report.normals;
    run->normals_fit = given && normals_fit_points(given, run->normal, &run->neighbours);
    report->known = true;
    report->given = run->normals_fit;
    if (given && !run->normals_fit)
        left_out_add(&run->report.left_out, "input",
                     LEFT_OUT_NOTE
                     "nx, ny, nz: these normals don't fit the points around them, and aren't used to tell sides");
    if (!status && run->normals_fit) take_sides(run, given);
    if (!status && run->params->normals == SWITCH_TRUE) status = turn(run, run->normals_fit ? given : NULL);
    free(given);
    return status ? pipeline_no_memory(run, "sides") : STATUS_OK;
}

float (*pipeline_spread_normals(const struct run *run))[3] {
    float(*all)[3] = alloc_array(run->cloud->count, sizeof *all);
    for (size_t i = 0; all && i < run->cloud->count; i++) {
        uint32_t p = run->points.distinct[i];
        size_t of = p == NONE ? 0 : p;
        vec3 n = vec3_scale(run->normal[of], run->turned[of] ? -1 : 1);
        all[i][0] = (float)n.x, all[i][1] = (float)n.y, all[i][2] = (float)n.z;
    }
    return all;
}

enum status sides_of_normals(const struct cloud *cloud, const struct params *params, unsigned threads,
                             const vec3 *normal, float (**turned)[3], struct report *report, struct error *error) {
    struct run run = {.cloud = cloud, .params = params, .error = error, .threads = threads};
    enum status status = pipeline_order(&run);
    if (!status) status = pipeline_neighbours(&run);
    run.report.left_out = report->left_out;
    if (!status) run.normal = alloc_array(run.points.count, sizeof *run.normal);
    if (!status && !run.normal) status = pipeline_no_memory(&run, "sides");
    for (size_t i = 0; !status && i < run.points.count; i++) run.normal[i] = normal[run.points.original[i]];
    if (!status) status = pipeline_sides(&run);
    if (!status && !run.normals_fit) {
        *turned = pipeline_spread_normals(&run);
        if (!*turned) status = pipeline_no_memory(&run, "sides");
    }
    report->normals = run.report.normals;
    report->left_out = run.report.left_out;
    ordered_points_done(&run.points);
    knn_free(run.knn);
    neighbourhood_done(&run.neighbours);
    free(run.normal), free(run.turned);
    return status;
}
