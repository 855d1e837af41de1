/* A report as JSON.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/report_json.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* JSON has no word for what isn't finite. */
static json_t *number(double value) { return isfinite(value) ? json_real(value) : json_null(); }
static json_t *relative(double value, double diagonal) { return diagonal > 0 ? number(value / diagonal) : json_null(); }
static json_t *count(uint64_t value) { return json_integer((json_int_t)value); }

static json_t *vector(const double v[3]) { return json_pack("[o, o, o]", number(v[0]), number(v[1]), number(v[2])); }

static json_t *distances(const struct distance_stats *stats, double diagonal) {
    if (!stats->count) return json_null();
    return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "samples", count(stats->count), "mean", number(stats->mean),
                     "rms", number(stats->rms), "max", number(stats->max), "mean_rel", relative(stats->mean, diagonal),
                     "rms_rel", relative(stats->rms, diagonal), "max_rel", relative(stats->max, diagonal));
}

static json_t *mesh_json(const struct report *report) {
    if (!report->has_mesh) return json_null();
    return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o, s:b, s:b, s:b, s:o, s:o, s:s}", "vertices",
                     count(report->vertices), "triangles", count(report->triangles), "hole_fill_triangles",
                     count(report->hole_fill_triangles), "points_lost", count(report->points_lost), "vertices_split",
                     count(report->vertices_split), "components", count(report->components), "watertight",
                     report->watertight, "manifold", report->manifold, "oriented", report->oriented, "area",
                     number(report->area), "volume", number(report->volume), "reconstruction", report->reconstruction);
}

/* The worse of the directions that were measured. */
static double worst(const struct report *report, size_t offset) {
    const struct distance_stats *directions[] = {&report->forward, &report->backward, &report->surface};
    double most = 0;
    for (size_t i = 0; i < 3; i++)
        if (directions[i]->count) most = fmax(most, *(const double *)((const char *)directions[i] + offset));
    return most;
}

static json_t *error_json(const struct report *report) {
    if (!report->has_error) return json_null();
    double d = report->diagonal;
    return json_pack("{s:o, s:o, s:o, s:o, s:s, s:o, s:o, s:o}", "mean_rel",
                     relative(worst(report, offsetof(struct distance_stats, mean)), d), "rms_rel",
                     relative(worst(report, offsetof(struct distance_stats, rms)), d), "max_rel",
                     relative(report->hausdorff, d), "hausdorff", number(report->hausdorff), "reference",
                     report->reference, "forward", distances(&report->forward, d), "backward",
                     distances(&report->backward, d), "surface", distances(&report->surface, d));
}

static json_t *timings_json(const struct report *report) {
    json_t *json = json_object();
    for (size_t i = 0; i < report->stage_count; i++)
        json_object_set_new(json, report->stage[i].name, number(report->stage[i].wall_ms));
    return json;
}

char *report_encode(const struct report *report) {
    double d = report->diagonal;
    json_t *contraction = report->has_contraction_error ? number(report->contraction_error) : json_null();
    json_t *json = json_pack("{s:o, s:o, s:o, s:s, s:o, s:{s:o, s:o}, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "points_in",
                             count(report->points_in), "points_distinct", count(report->points_distinct), "points_out",
                             count(report->points_out), "format", report->format, "diagonal", number(d), "box", "min",
                             vector(report->box_min), "max", vector(report->box_max), "contraction_error", contraction,
                             "tangent", distances(&report->tangent, d), "mesh", mesh_json(report), "error",
                             error_json(report), "timings_ms", timings_json(report), "total_ms",
                             number(report->total_ms), "peak_rss_bytes", count(report->peak_rss_bytes));
    char *text = json ? json_dumps(json, JSON_INDENT(2) | JSON_REAL_PRECISION(15)) : NULL;
    json_decref(json);
    size_t length = text ? strlen(text) : 0;
    char *ended = text ? realloc(text, length + 2) : NULL;
    if (!ended) {
        free(text);
        return NULL;
    }
    memcpy(ended + length, "\n", 2);
    return ended;
}

/* ------------------------------------------------------------------------------------------------ reading back */

static double number_at(const json_t *json, const char *name) {
    const json_t *value = json_object_get(json, name);
    return json_is_number(value) ? json_number_value(value) : NAN;
}

static unsigned long long count_at(const json_t *json, const char *name) {
    json_int_t value = json_integer_value(json_object_get(json, name));
    return value > 0 ? (unsigned long long)value : 0;
}

void report_read_headline(const char *text, struct report_headline *headline) {
    json_t *json = text ? json_loads(text, 0, NULL) : NULL;
    const json_t *error = json_object_get(json, "error");
    if (!json_is_object(error)) error = json_object_get(json, "tangent");
    *headline = (struct report_headline){
        .points_in = count_at(json, "points_in"),
        .points_out = count_at(json, "points_out"),
        .triangles = count_at(json_object_get(json, "mesh"), "triangles"),
        .mean_rel = number_at(error, "mean_rel"),
        .rms_rel = number_at(error, "rms_rel"),
        .max_rel = number_at(error, "max_rel"),
        .total_ms = number_at(json, "total_ms"),
    };
    json_decref(json);
}

void report_read_timings(const char *text, void (*found)(void *ctx, const char *name, double ms), void *ctx) {
    json_t *json = text ? json_loads(text, 0, NULL) : NULL;
    json_t *timings = json_object_get(json, "timings_ms"), *value;
    const char *name;
    json_object_foreach(timings, name, value) found(ctx, name, json_number_value(value));
    json_decref(json);
}
