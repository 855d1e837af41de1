/* A report is whole or it isn't there: a member that memory didn't suffice for would read as one that wasn't measured.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/report_json.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/params_json.h"
#include "api/stats_json.h"
#include "core/version.h"

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

static json_t *input_json(const struct report *r) {
    return json_pack("{s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "format", r->format, "points",
                     stats_json_count(r->points_in), "points_distinct", stats_json_count(r->points_distinct),
                     "points_outliers", stats_json_count(r->points_outliers), "noise_rel",
                     stats_json_number(r->noise / r->diagonal), "diagonal", stats_json_number(r->diagonal), "box_min",
                     triple(r->box_min), "box_max", triple(r->box_max));
}

static json_t *cloud_json(const struct report_level *r, double diagonal) {
    return json_pack("{s:o, s:o, s:o}", "points", stats_json_count(r->points_out), "contraction_error_rel",
                     stats_json_number(r->contraction_error / diagonal), "tangent_error",
                     stats_json(&r->tangent, diagonal));
}

static json_t *mesh_json(const struct report_level *r) {
    return json_pack("{s:o, s:o, s:b, s:b, s:b, s:o, s:o, s:o, s:o, s:o, s:o, s:s}", "vertices",
                     stats_json_count(r->vertices), "triangles", stats_json_count(r->triangles), "watertight",
                     r->watertight, "manifold", r->manifold, "oriented", r->oriented, "components",
                     stats_json_count(r->components), "hole_fill_triangles", stats_json_count(r->hole_fill_triangles),
                     "points_lost", stats_json_count(r->points_lost), "vertices_split",
                     stats_json_count(r->vertices_split), "area", stats_json_number(r->area), "volume",
                     stats_json_number(r->volume), "reconstruction", r->reconstruction);
}

/* mean, rms and max are those of the forward direction, the one that every input has; hausdorff is over all. */
static json_t *error_json(const struct report_level *r, double diagonal) {
    json_t *error = stats_json(&r->forward, diagonal);
    int bad = put(error, "hausdorff", stats_json_number(r->hausdorff));
    bad |= put(error, "hausdorff_rel", stats_json_number(r->hausdorff / diagonal));
    bad |= put(error, "reference", json_string(r->reference));
    bad |= put(error, "forward", stats_json(&r->forward, diagonal));
    if (r->backward.count) bad |= put(error, "backward", stats_json(&r->backward, diagonal));
    if (r->surface.count) bad |= put(error, "surface", stats_json(&r->surface, diagonal));
    return whole(error, bad);
}

/* The members that every level has, put into json. */
static int add_level(json_t *json, const struct report_level *r, double diagonal) {
    int bad = put(json, "points_out", stats_json_count(r->points_out));
    bad |= put(json, "cloud", cloud_json(r, diagonal));
    if (r->has_mesh) bad |= put(json, "mesh", mesh_json(r));
    if (r->has_error) bad |= put(json, "error", error_json(r, diagonal));
    return bad;
}

static json_t *levels_json(const struct report *r) {
    json_t *levels = json_array();
    int bad = 0;
    for (size_t i = 0; i < r->level_count; i++) {
        json_t *level = json_pack("{s:o}", "ratio", stats_json_number(r->level[i].ratio));
        bad |= add_level(level, &r->level[i], r->diagonal);
        bad |= json_array_append_new(levels, level);
    }
    return whole(levels, bad);
}

static json_t *timings_json(const struct report *r) {
    json_t *timings = json_object();
    int bad = 0;
    for (size_t i = 0; i < r->stage_count; i++)
        bad |= put(timings, r->stage[i].name, stats_json_number(r->stage[i].wall_ms));
    bad |= put(timings, "total", stats_json_number(r->total_ms));
    return whole(timings, bad);
}

static json_t *losses_json(const struct losses *losses) {
    json_t *list = json_array();
    int bad = 0;
    for (size_t i = 0; i < losses->count; i++)
        bad |= json_array_append_new(
            list, json_pack("{s:s, s:s}", "file", losses->loss[i].where, "what", losses->loss[i].what));
    return whole(list, bad);
}

json_t *report_json(const struct report *r) {
    json_t *json = json_pack("{s:o, s:o}", "points_in", stats_json_count(r->points_in), "input", input_json(r));
    int bad = add_level(json, &r->level[0], r->diagonal);
    if (r->level_count > 1) bad |= put(json, "levels", levels_json(r));
    bad |= put(json, "left_out", losses_json(&r->losses));
    bad |= put(json, "timings_ms", timings_json(r));
    bad |= put(json, "peak_rss_bytes", stats_json_count(r->peak_rss_bytes));
    return whole(json, bad);
}

enum status report_json_write(int fd, const struct report *report, const struct params *params, struct error *error) {
    json_t *json = report_json(report);
    int bad = put(json, "version", json_string(whittle_version()));
    json = whole(json, bad | put(json, "params", params_to_json(params)));
    if (!json) return error_set(error, STATUS_NO_MEMORY, "report", "no memory for the report");
    char *text = json_dumps(json, JSON_INDENT(2) | JSON_REAL_PRECISION(9)); /* dumpfd would write each word */
    json_decref(json);
    if (!text) return error_set(error, STATUS_NO_MEMORY, "report", "no memory for the report");
    int wrote = dprintf(fd, "%s\n", text);
    free(text);
    if (wrote < 0) return error_set(error, STATUS_IO, "report", "can't write the report: %s", strerror(errno));
    return STATUS_OK;
}
