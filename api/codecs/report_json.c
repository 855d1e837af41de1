/* A report is whole or it isn't there: a member that memory didn't suffice for would read as one that wasn't measured.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/report_json.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/params_json.h"
#include "api/codecs/stats_json.h"
#include "core/base/version.h"

/* Puts a member in; nonzero where memory ran out for it, for value, or for json before it. */
static int put(json_t *json, const char *key, json_t *value) { return json_object_set_new(json, key, value); }

/* json, or NULL where a part of it is bad. */
static json_t *whole(json_t *json, int bad) {
    if (!bad) return json;
    json_decref(json);
    return NULL;
}

static json_t *triple(const double value[3]) {
    return json_pack("[o, o, o]", stats_json_number(value[0]), stats_json_number(value[1]),
                     stats_json_number(value[2]));
}

static json_t *report_input_json(const struct report *r) {
    return json_pack("{s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "format", r->format, "points",
                     stats_json_count(r->points_in), "points_cropped", stats_json_count(r->points_cropped),
                     "points_filtered", stats_json_count(r->points_filtered), "points_distinct",
                     stats_json_count(r->points_distinct), "points_outliers", stats_json_count(r->points_outliers),
                     "noise_level", stats_json_number(r->noise_level), "noise_level_rel",
                     stats_json_number(r->noise_level / r->diagonal), "noise_rel",
                     stats_json_number(r->noise / r->diagonal), "diagonal", stats_json_number(r->diagonal), "box_min",
                     triple(r->box_min), "box_max", triple(r->box_max));
}

static json_t *report_cloud_json(const struct report_level *r, double diagonal) {
    return json_pack("{s:o, s:o, s:o}", "points", stats_json_count(r->points_out), "contraction_error_rel",
                     stats_json_number(r->contraction_error / diagonal), "tangent_error",
                     stats_json(&r->tangent, diagonal));
}

static json_t *mesh_json(const struct report_level *r, double diagonal) {
    return json_pack(
        "{s:o, s:o, s:b, s:b, s:b, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:s, s:o}",
        "vertices", stats_json_count(r->vertices), "triangles", stats_json_count(r->triangles), "watertight",
        r->watertight, "manifold", r->manifold, "oriented", r->oriented, "components", stats_json_count(r->components),
        "handles", stats_json_count(r->handles), "borders", stats_json_count(r->borders), "self_intersections",
        stats_json_count(r->self_intersections), "border_length", stats_json_number(r->border_length),
        "border_length_rel", stats_json_number(r->border_length / diagonal), "holes_closed",
        stats_json_count(r->holes_closed), "hole_fill_triangles", stats_json_count(r->hole_fill_triangles),
        "points_lost", stats_json_count(r->points_lost), "vertices_split", stats_json_count(r->vertices_split), "area",
        stats_json_number(r->area), "volume", stats_json_number(r->volume), "unsupported_area_share",
        stats_json_number(r->unsupported), "reconstruction", r->reconstruction, "reconstructed_from",
        stats_json_count(r->reconstructed_from));
}

/* Names from before directions were told apart, which clients go on reading: mean, rms and max are those of
 * input_to_mesh, hausdorff is symmetric's max, and the directions are called forward, backward, surface. */
static int put_old_names(json_t *error, const struct report_level *r, double diagonal) {
    json_t *flat = stats_json(&r->input_to_mesh, diagonal);
    int bad = json_object_update(error, flat);
    json_decref(flat);
    bad |= put(error, "hausdorff", stats_json_number(r->symmetric.max));
    bad |= put(error, "hausdorff_rel", stats_json_number(r->symmetric.max / diagonal));
    bad |= put(error, "forward", stats_json(&r->input_to_mesh, diagonal));
    if (r->mesh_to_input.count) bad |= put(error, "backward", stats_json(&r->mesh_to_input, diagonal));
    if (r->surface_to_mesh.count) bad |= put(error, "surface", stats_json(&r->surface_to_mesh, diagonal));
    return bad;
}

static json_t *error_json(const struct report_level *r, double diagonal) {
    json_t *error = json_pack("{s:s}", "reference", r->reference);
    int bad = put(error, "symmetric", stats_json(&r->symmetric, diagonal));
    bad |= put(error, "input_to_mesh", stats_json(&r->input_to_mesh, diagonal));
    if (r->mesh_to_input.count) bad |= put(error, "mesh_to_input", stats_json(&r->mesh_to_input, diagonal));
    if (r->surface_to_mesh.count) bad |= put(error, "surface_to_mesh", stats_json(&r->surface_to_mesh, diagonal));
    if (r->dropped.count) bad |= put(error, "dropped", stats_json(&r->dropped, diagonal));
    return whole(error, bad | put_old_names(error, r, diagonal));
}

static json_t *warnings_json(const struct report *report, const struct report_level *r) {
    json_t *list = json_array();
    char text[REPORT_WARNING_BYTES];
    int bad = 0;
    for (size_t i = 0; report_warning(report, r, i, text, sizeof text); i++)
        bad |= json_array_append_new(list, json_string(text));
    return whole(list, bad);
}

/* The members that every level has, put into json. */
static int add_level(json_t *json, const struct report *report, const struct report_level *r) {
    double diagonal = report->diagonal;
    int bad = put(json, "points_out", stats_json_count(r->points_out));
    bad |= put(json, "cloud", report_cloud_json(r, diagonal));
    if (r->has_mesh) bad |= put(json, "mesh", mesh_json(r, diagonal));
    if (r->has_error) bad |= put(json, "error", error_json(r, diagonal));
    bad |= put(json, "warnings", warnings_json(report, r));
    return bad;
}

static json_t *report_levels_json(const struct report *r) {
    json_t *levels = json_array();
    int bad = 0;
    for (size_t i = 0; i < r->level_count; i++) {
        json_t *level = json_pack("{s:o}", "ratio", stats_json_number(r->level[i].ratio));
        bad |= add_level(level, r, &r->level[i]);
        bad |= json_array_append_new(levels, level);
    }
    return whole(levels, bad);
}

/* What is of normals known: where they are from, and what says which way those that are written point. */
static json_t *normals_json(const struct report_normals *normals) {
    json_t *json = json_pack("{s:s}", "source", normals->given ? "given" : "computed");
    return whole(json, normals->orientation[0] ? put(json, "orientation", json_string(normals->orientation)) : 0);
}

static json_t *spacing_json(const struct report_spacing *spacing) {
    return json_pack("{s:o, s:o}", "spacing", stats_json_number(spacing->spacing), "points",
                     stats_json_count(spacing->points));
}

static json_t *report_surface_json(const struct report_surface *surface) {
    return json_pack("{s:s, s:s, s:b, s:s}", "kind", surface->kind, "reason", surface->reason, "sure", surface->sure,
                     "orientation", surface->orientation);
}

static json_t *deviation_json(const struct report *r) {
    const struct report_deviation *d = &r->deviation;
    return json_pack("{s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "of",
                     r->level[0].has_mesh ? "input_to_mesh" : "tangent_error", "bound", stats_json_number(d->bound),
                     "bound_rel", stats_json_number(d->bound / r->diagonal), "reached", stats_json_number(d->reached),
                     "reached_rel", stats_json_number(d->reached / r->diagonal), "share", stats_json_number(d->share),
                     "points_over", stats_json_count(d->points_over), "counts_tried", stats_json_count(d->tried));
}

static json_t *timings_json(const struct report *r) {
    json_t *timings = json_object();
    int bad = 0;
    for (size_t i = 0; i < r->stage_count; i++)
        bad |= put(timings, r->stage[i].name, stats_json_number(r->stage[i].wall_ms));
    bad |= put(timings, "total", stats_json_number(r->total_ms));
    return whole(timings, bad);
}

static json_t *left_out_json(const struct left_out *left_out) {
    json_t *list = json_array();
    int bad = 0;
    for (size_t i = 0; i < left_out->count; i++)
        bad |= json_array_append_new(
            list, json_pack("{s:s, s:s}", "file", left_out->loss[i].where, "what", left_out->loss[i].what));
    return whole(list, bad);
}

json_t *report_json(const struct report *r) {
    json_t *json = json_pack("{s:o, s:o}", "points_in", stats_json_count(r->points_in), "input", report_input_json(r));
    int bad = add_level(json, r, &r->level[0]);
    if (r->denoised[0]) bad |= put(json, "denoised", json_string(r->denoised));
    if (r->normals.known) bad |= put(json, "normals", normals_json(&r->normals));
    if (r->spacing.spacing > 0) bad |= put(json, "spacing", spacing_json(&r->spacing));
    if (r->surface.kind[0]) bad |= put(json, "surface", report_surface_json(&r->surface));
    if (r->deviation.bound > 0) bad |= put(json, "deviation", deviation_json(r));
    if (r->level_count > 1) bad |= put(json, "levels", report_levels_json(r));
    bad |= put(json, "left_out", left_out_json(&r->left_out));
    bad |= put(json, "timings_ms", timings_json(r));
    bad |= put(json, "peak_rss_bytes", stats_json_count(r->peak_rss_bytes));
    return whole(json, bad);
}

/* What a deprecated name stood for is told by that name, too, as long as it is accepted. */
static json_t *told_params(const struct params *params) {
    size_t count;
    const struct param_alias *alias = params_aliases(&count);
    json_t *json = params_to_json(params);
    for (size_t i = 0; i < count; i++) json_object_set(json, alias[i].name, json_object_get(json, alias[i].of));
    return json;
}

enum status report_json_write(int fd, const struct report *report, const struct params *params, struct error *error) {
    json_t *json = report_json(report);
    int bad = put(json, "version", json_string(whittle_version()));
    json = whole(json, bad | put(json, "params", told_params(params)));
    if (!json) return error_set(error, STATUS_NO_MEMORY, "report", "no memory for the report");
    char *text = json_dumps(json, JSON_INDENT(2) | JSON_REAL_PRECISION(9)); /* dumpfd would write each word */
    json_decref(json);
    if (!text) return error_set(error, STATUS_NO_MEMORY, "report", "no memory for the report");
    int wrote = dprintf(fd, "%s\n", text), failure = errno;
    free(text);
    if (wrote < 0)
        return error_set(error, status_from_errno(failure), "report", "can't write the report: %s", strerror(failure));
    return STATUS_OK;
}
