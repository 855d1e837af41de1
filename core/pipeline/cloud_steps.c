/* Steps 1 to 8: from points to the simplified cloud.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/clean/noise.h"
#include "core/cloud/attribute_names.h"
#include "core/cloud/select.h"
#include "core/math/quantile.h"
#include "core/measure/tangent.h"
#include "core/pipeline/pipeline_run.h"
#include "core/simplify/attribute_edges.h"
#include "core/simplify/dso.h"
#include "core/simplify/normals.h"
#include "core/simplify/point_quadrics.h"
#include "core/simplify/spacing.h"

enum status pipeline_no_memory(struct run *run, const char *where) {
    if (run->error && run->error->code == STATUS_NO_MEMORY) return STATUS_NO_MEMORY; /* the stage has said more */
    return error_set(run->error, STATUS_NO_MEMORY, where, "not enough memory for %zu points", run->cloud->count);
}

void pipeline_scale(struct distance_stats *stats, double scale) {
    stats->mean *= scale;
    stats->rms *= scale;
    stats->max *= scale;
}

static enum status check_size(struct run *run) {
    for (size_t i = 0; i < run->cloud->count; i++) {
        vec3 p = run->cloud->position[i];
        if (fabs(p.x) < ORDER_LARGEST && fabs(p.y) < ORDER_LARGEST && fabs(p.z) < ORDER_LARGEST) continue;
        return error_set(run->error, STATUS_MALFORMED, "order", "the coordinates of point %zu are over %g", i + 1,
                         ORDER_LARGEST);
    }
    return STATUS_OK;
}

void pipeline_report_box(struct run *run) {
    struct report *report = &run->report;
    report->diagonal = run->points.diagonal;
    memcpy(report->box_min, &run->points.box_min, sizeof report->box_min);
    memcpy(report->box_max, &run->points.box_max, sizeof report->box_max);
}

enum status pipeline_order(struct run *run) {
    if (check_size(run)) return STATUS_MALFORMED;
    enum status status = order_points(run->cloud->position, run->cloud->count, run->threads, &run->points);
    if (status) return pipeline_no_memory(run, "order");
    struct report *report = &run->report;
    report->points_in = run->cloud->count;
    report->points_distinct = run->points.count;
    pipeline_report_box(run);
    snprintf(report->format, sizeof report->format, "%s", run->cloud->form);
    status = pipeline_doubt_origin(run);
    return status ? pipeline_no_memory(run, "order") : STATUS_OK;
}

struct neighbourhood_options pipeline_neighbourhood_options(const struct run *run) {
    return (struct neighbourhood_options){run->params->neighbourhood, (unsigned)run->params->neighbours_min,
                                          (unsigned)run->params->neighbours_max, run->threads};
}

/* There is an index where noise was looked for, and none found. */
static enum status find_neighbours(struct run *run) {
    const struct neighbourhood_options options = pipeline_neighbourhood_options(run);
    enum status status = STATUS_OK;
    if (!run->knn) status = knn_new(run->points.point, run->points.count, run->threads, &run->knn, run->error);
    if (status) return status;
    return (run->mesh_follows ? neighbourhood_find_reach : neighbourhood_find)(
        run->knn, run->points.point, run->points.count, &options, &run->neighbours);
}

enum status pipeline_neighbours(struct run *run) {
    bool dropped = false;
    if (run->neighbours.spacing) return STATUS_OK; /* they were needed to measure a mesh */
    enum status status = find_neighbours(run);
    if (!status) status = pipeline_drop_strays(run, &dropped);
    if (!status && dropped && !run->neighbours.spacing) status = find_neighbours(run);
    free(run->neighbours.reach_sq);
    run->neighbours.reach_sq = NULL;
    if (!run->mesh_follows) {
        knn_free(run->knn);
        run->knn = NULL;
        alloc_give_back();
    }
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "neighbours") : status;
}

/* Sets the shares that noise and rounding have of the distance between neighbours, from some of the points. */
static enum status tell_shares(struct run *run) {
    enum { SOME = 1 << 16 };
    struct report *report = &run->report;
    size_t n = run->points.count, step = n / SOME + 1, count = 0;
    float *spacing = alloc_array(n / step + 1, sizeof *spacing);
    if (!spacing) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < n; i += step) spacing[count++] = run->neighbours.spacing[i];
    double usual = (double)quantile_of(spacing, count, 0.5);
    if (usual > 0 && !report->denoised[0]) report->noise_share = report->noise_level / usual;
    report->rounding_step = cloud_rounding_step(run->cloud);
    if (usual > 0) report->rounding_share = report->rounding_step / (usual * run->points.scale);
    free(spacing);
    return STATUS_OK;
}

enum status pipeline_normals(struct run *run) {
    run->normal = alloc_array(run->points.count, sizeof *run->normal);
    if (!run->normal) return pipeline_no_memory(run, "normals");
    normals_fit(run->points.point, &run->neighbours, run->threads, run->normal, NULL);
    if (noise_estimate(run->points.point, run->normal, &run->neighbours, &run->report.noise_level) || tell_shares(run))
        return pipeline_no_memory(run, "normals");
    run->report.noise_level *= run->points.scale;
    return STATUS_OK;
}

enum status pipeline_dso(struct run *run) {
    run->dso = alloc_array(run->points.count, sizeof *run->dso);
    if (!run->dso) return pipeline_no_memory(run, "dso");
    dso_compute(run->points.point, run->normal, &run->neighbours, (enum dso_form)run->params->dso, run->threads,
                run->dso);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ attributes */

/* The property's values along the curve, so that nearly all lie within a range of 1 (value; order is scratch). */
static void load_values(const struct run *run, const struct property *property, float *value, float *order) {
    const double low_share = 0.01, high_share = 0.99;
    const struct cloud *cloud = run->cloud;
    size_t n = run->points.count, finite = 0;
    for (size_t i = 0; i < n; i++) {
        const unsigned char *record = cloud->record + run->points.original[i] * cloud->record_bytes;
        value[i] = (float)scalar_load(record + property->offset_bytes, property->type);
        if (isfinite(value[i])) order[finite++] = value[i];
    }
    if (!finite) return;
    double low = (double)quantile_of(order, finite, low_share), high = (double)quantile_of(order, finite, high_share);
    for (size_t i = 0; high == low && i < finite; i++) {
        low = fmin(low, (double)order[i]);
        high = fmax(high, (double)order[i]);
    }
    for (size_t i = 0; high > low && i < n; i++) value[i] = (float)((double)value[i] / (high - low));
}

static enum status add_edges(struct run *run, const struct weight_entry *entry, const struct quadric_options *options,
                             float *value, float *order) {
    static const char *const rgb[] = {"red", "green", "blue", NULL};
    const char *const one[] = {entry->name, NULL};
    for (const char *const *name = strcmp(entry->name, "rgb") == 0 ? rgb : one; *name; name++) {
        const struct property *property = attribute_find(run->cloud, *name);
        if (!property) return select_refuse(run->cloud, "weights", *name, run->error);
        load_values(run, property, value, order);
        attribute_edges_add(run->points.point, run->normal, &run->neighbours, value, entry->weight, options,
                            run->quadrics);
    }
    return STATUS_OK;
}

/* Edges of what `weights` names, added to the quadrics. */
static enum status add_attributes(struct run *run) {
    const struct quadric_options options = {(enum area_weight)run->params->area_weight, 0, run->threads};
    const char *at = run->params->weights;
    if (!*at) return STATUS_OK;
    float *value = alloc_array(run->points.count, sizeof *value);
    float *order = alloc_array(run->points.count, sizeof *order);
    enum status status = value && order ? STATUS_OK : pipeline_no_memory(run, "quadrics");
    struct weight_entry entry;
    while (!status && *at && weight_list_next(&at, &entry)) status = add_edges(run, &entry, &options, value, order);
    free(value), free(order);
    return status;
}

enum status pipeline_quadrics(struct run *run) {
    const struct point_quadrics of = {run->params, run->points.point, run->normal, &run->neighbours, run->dso,
                                      NULL,        run->threads};
    double average = NAN;
    run->quadrics = alloc_array(run->points.count, sizeof *run->quadrics);
    if (!run->quadrics || point_quadrics_make(&of, &average, run->quadrics)) return pipeline_no_memory(run, "quadrics");
    return add_attributes(run);
}

size_t pipeline_wanted_points(const struct run *run, size_t level) {
    const struct params *params = run->params;
    size_t wanted = 1, most = run->fits;
    bool spacing_alone = !params->points && isnan(params->ratio) && !params->levels.count && isnan(params->max_error) &&
                         !params_bound_deviation(params);
    if (spacing_alone) return most;
    double ratio = params->levels.count ? params->levels.ratio[level] : params->ratio;
    if (params->points) wanted = params->points;
    if (!isnan(ratio)) wanted = (size_t)floor(ratio * (double)run->cloud->count);
    if (!isnan(params->max_error)) {
        double in_frame = run->points.diagonal / run->points.scale;
        size_t tolerated = contraction_count_for_error(&run->contraction, params->max_error * in_frame);
        if (tolerated > wanted) wanted = tolerated;
    }
    if (wanted < run->searched) wanted = run->searched;
    if (wanted < 1) wanted = 1;
    return wanted < most ? wanted : most;
}

/* From how many points on nobody asks which of them are more important: a mesh, if it isn't to have an error of some
 * size, needs to know which points are left alone. */
static size_t fewest_ranked(const struct run *run) {
    const struct params *params = run->params;
    if (params->outputs & OUTPUT_ANY_CLOUD || !run->mesh_follows || !isnan(params->max_error) ||
        params_bound_deviation(params) || !isnan(params->spacing))
        return 1;
    return pipeline_wanted_points(run, params->levels.count ? params->levels.count - 1 : 0);
}

enum status pipeline_contract(struct run *run) {
    struct adjacency near = {0};
    struct contract_options options = {run->threads, fewest_ranked(run)};
    enum status status = adjacency_from(&run->neighbours, run->threads, &near);
    if (!run->mesh_follows) neighbourhood_done(&run->neighbours);
    if (!status)
        status = contract(run->points.point, &near, run->quadrics, &options, &run->progress, &run->contraction);
    free(run->quadrics);
    run->quadrics = NULL;
    run->fits = run->points.count;
    if (!status && run->mesh_follows)
        status = creases_find(run->points.point, run->normal, &run->neighbours, run->threads, &run->creases);
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "contract") : status;
}

enum status pipeline_space(struct run *run) {
    size_t n = run->points.count;
    const vec3 *position = run->moved ? run->moved : run->cloud->position;
    vec3 *along = alloc_array(n, sizeof *along);
    if (!along) return pipeline_no_memory(run, "space");
    for (size_t i = 0; i < n; i++) along[i] = position[run->points.original[i]];
    enum status status = spacing_apply(&run->contraction, along, run->params->spacing, &run->fits);
    free(along);
    run->report.spacing = (struct report_spacing){run->params->spacing, run->fits, false};
    return status ? pipeline_no_memory(run, "space") : STATUS_OK;
}

/* Those that are there still, once what was asked for or is noise has been dropped. */
static void tell_strays(struct run *run) {
    size_t strays = run->points.strays;
    if (strays && (run->params->denoise == DENOISE_NONE || run->params->denoise == DENOISE_NOISY))
        left_out_add(&run->report.left_out, "input",
                     LEFT_OUT_WARNING
                     "%zu point%s hundreds of times as far off as the others are wide: denoise=outliers drops strays",
                     strays, strays == 1 ? " lies" : "s lie");
}

/* Where all distinct points that are left are fewer than were asked for. */
static void tell_fewer(struct run *run) {
    const struct params *params = run->params;
    double ratio = params->levels.count ? params->levels.ratio[0] : params->ratio;
    double asked = params->points ? (double)params->points : floor(ratio * (double)run->cloud->count);
    if (run->kept_count == run->points.count && (double)run->kept_count < asked)
        left_out_add(&run->report.left_out, "input",
                     LEFT_OUT_NOTE "%zu points are kept, not %.0f: there are no more that are distinct%s",
                     run->kept_count, asked, run->report.points_outliers ? " and weren't dropped" : "");
}

/* The levels come finest first, so that the points of the first one hold those of all others as prefixes. */
enum status pipeline_keep(struct run *run) {
    const struct contraction *contraction = &run->contraction;
    struct report_level *level = &run->report.level[run->level];
    run->kept_count = pipeline_wanted_points(run, run->level);
    level->points_out = run->kept_count;
    level->ratio = (double)run->kept_count / (double)run->cloud->count;
    level->contraction_error = NAN;
    if (run->level == 0) tell_strays(run);
    if (run->faces_alone) return STATUS_OK;
    if (run->level == 0) tell_fewer(run);
    if (!run->kept) {
        size_t finest = pipeline_wanted_points(run, 0);
        run->kept = alloc_array(finest, sizeof *run->kept);
        if (!run->kept) return pipeline_no_memory(run, "keep");
        for (size_t i = 0; i < finest; i++) run->kept[i] = contraction->order[contraction->n - 1 - i];
    }
    size_t made = contraction->n - run->kept_count;
    level->contraction_error = made ? (double)contraction->error[made - 1] * run->points.scale : 0;
    return STATUS_OK;
}

enum status pipeline_tangent(struct run *run) {
    struct distance_stats *tangent = &run->report.level[run->level].tangent;
    if (run->surface_alone) return STATUS_OK;
    if (pipeline_wants_planes(run->params) && !run->distance)
        run->distance = alloc_array(run->points.count, sizeof *run->distance);
    if (pipeline_wants_planes(run->params) && !run->distance) return STATUS_NO_MEMORY;
    float *distance = pipeline_wants_planes(run->params) && run->level == 0 ? run->distance : NULL;
    enum status status = tangent_error(run->points.point, run->normal, run->points.count, run->kept, run->kept_count,
                                       run->threads, tangent, distance);
    if (!status) pipeline_scale(tangent, run->points.scale);
    return status;
}
