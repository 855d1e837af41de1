/* What the service reads from a report.json.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/report_read.h"

#include <jansson.h>
#include <math.h>

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
    const json_t *error = json_object_get(json, "error"), *symmetric = json_object_get(error, "symmetric");
    if (!error) error = json_object_get(json_object_get(json, "cloud"), "tangent_error");
    *headline = (struct report_headline){
        .points_in = count_at(json, "points_in"),
        .points_distinct = count_at(json_object_get(json, "input"), "points_distinct"),
        .points_out = count_at(json, "points_out"),
        .triangles = count_at(json_object_get(json, "mesh"), "triangles"),
        .mean_rel = number_at(error, "mean_rel"),
        .rms_rel = number_at(error, "rms_rel"),
        .max_rel = number_at(error, "max_rel"),
        .symmetric_mean = number_at(symmetric, "mean"),
        .symmetric_max = number_at(symmetric, "max"),
        .symmetric_mean_rel = number_at(symmetric, "mean_rel"),
        .symmetric_max_rel = number_at(symmetric, "max_rel"),
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

char *report_read_compact(const char *text) {
    json_t *json = json_loads(text, 0, NULL);
    char *compact = json ? json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(15)) : NULL;
    json_decref(json);
    return compact;
}
