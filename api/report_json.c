/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/report_json.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "api/params_json.h"
#include "core/version.h"

/* Numbers that JSON can't hold (infinity, NaN) are null. */
static json_t *number(double value) { return isfinite(value) ? json_real(value) : json_null(); }

static json_t *count(uint64_t value) { return json_integer((json_int_t)value); }

static json_t *triple(const double value[3]) {
    return json_pack("[o, o, o]", number(value[0]), number(value[1]), number(value[2]));
}

static json_t *distances(const struct distance_stats *stats, double diagonal) {
    return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "samples", count(stats->count), "mean", number(stats->mean),
                     "rms", number(stats->rms), "max", number(stats->max), "mean_rel", number(stats->mean / diagonal),
                     "rms_rel", number(stats->rms / diagonal), "max_rel", number(stats->max / diagonal));
}

static json_t *input_json(const struct report *r) {
    return json_pack("{s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "format", r->format, "points", count(r->points_in),
                     "points_distinct", count(r->points_distinct), "points_outliers", count(r->points_outliers),
                     "noise_rel", number(r->noise / r->diagonal), "diagonal", number(r->diagonal), "box_min",
                     triple(r->box_min), "box_max", triple(r->box_max));
}

static json_t *cloud_json(const struct report_level *r, double diagonal) {
    return json_pack("{s:o, s:o, s:o}", "points", count(r->points_out), "contraction_error_rel",
                     number(r->contraction_error / diagonal), "tangent_error", distances(&r->tangent, diagonal));
}

static json_t *mesh_json(const struct report_level *r) {
    return json_pack("{s:o, s:o, s:b, s:b, s:b, s:o, s:o, s:o, s:o, s:o, s:o, s:s}", "vertices", count(r->vertices),
                     "triangles", count(r->triangles), "watertight", r->watertight, "manifold", r->manifold, "oriented",
                     r->oriented, "components", count(r->components), "hole_fill_triangles",
                     count(r->hole_fill_triangles), "points_lost", count(r->points_lost), "vertices_split",
                     count(r->vertices_split), "area", number(r->area), "volume", number(r->volume), "reconstruction",
                     r->reconstruction);
}

/* mean, rms and max are those of the forward direction, the one that every input has; hausdorff is over all. */
static json_t *error_json(const struct report_level *r, double diagonal) {
    json_t *error = distances(&r->forward, diagonal);
    json_object_set_new(error, "hausdorff", number(r->hausdorff));
    json_object_set_new(error, "hausdorff_rel", number(r->hausdorff / diagonal));
    json_object_set_new(error, "reference", json_string(r->reference));
    json_object_set_new(error, "forward", distances(&r->forward, diagonal));
    if (r->backward.count) json_object_set_new(error, "backward", distances(&r->backward, diagonal));
    if (r->surface.count) json_object_set_new(error, "surface", distances(&r->surface, diagonal));
    return error;
}

/* The members that every level has, put into json. */
static void add_level(json_t *json, const struct report_level *r, double diagonal) {
    json_object_set_new(json, "points_out", count(r->points_out));
    json_object_set_new(json, "cloud", cloud_json(r, diagonal));
    if (r->has_mesh) json_object_set_new(json, "mesh", mesh_json(r));
    if (r->has_error) json_object_set_new(json, "error", error_json(r, diagonal));
}

static json_t *levels_json(const struct report *r) {
    json_t *levels = json_array();
    for (size_t i = 0; i < r->level_count; i++) {
        json_t *level = json_pack("{s:o}", "ratio", number(r->level[i].ratio));
        add_level(level, &r->level[i], r->diagonal);
        json_array_append_new(levels, level);
    }
    return levels;
}

static json_t *timings_json(const struct report *r) {
    json_t *timings = json_object();
    for (size_t i = 0; i < r->stage_count; i++)
        json_object_set_new(timings, r->stage[i].name, number(r->stage[i].wall_ms));
    json_object_set_new(timings, "total", number(r->total_ms));
    return timings;
}

static json_t *losses_json(const struct losses *losses) {
    json_t *list = json_array();
    for (size_t i = 0; i < losses->count; i++)
        json_array_append_new(list,
                              json_pack("{s:s, s:s}", "file", losses->loss[i].where, "what", losses->loss[i].what));
    return list;
}

json_t *report_json(const struct report *r) {
    json_t *json = json_pack("{s:o, s:o}", "points_in", count(r->points_in), "input", input_json(r));
    if (!json) return NULL;
    add_level(json, &r->level[0], r->diagonal);
    if (r->level_count > 1) json_object_set_new(json, "levels", levels_json(r));
    json_object_set_new(json, "left_out", losses_json(&r->losses));
    json_object_set_new(json, "timings_ms", timings_json(r));
    json_object_set_new(json, "peak_rss_bytes", count(r->peak_rss_bytes));
    return json;
}

enum status report_json_write(int fd, const struct report *report, const struct params *params, struct error *error) {
    json_t *json = report_json(report);
    if (!json) return error_set(error, STATUS_NO_MEMORY, "report", "no memory for the report");
    json_object_set_new(json, "version", json_string(whittle_version()));
    json_object_set_new(json, "params", params_to_json(params));
    int rc = json_dumpfd(json, fd, JSON_INDENT(2) | JSON_REAL_PRECISION(9));
    json_decref(json);
    if (rc != 0 || dprintf(fd, "\n") != 1)
        return error_set(error, STATUS_IO, "report", "can't write the report: %s", strerror(errno));
    return STATUS_OK;
}
