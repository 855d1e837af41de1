/* The document of a cloud.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/cloud_json.h"

#include <jansson.h>

#include "api/codecs/job_json.h"
#include "api/links.h"

static json_t *properties_json(const struct cloud_document *cloud) {
    if (!cloud->property_count) return json_null();
    json_t *list = json_array();
    for (size_t i = 0; i < cloud->property_count; i++) {
        const struct cloud_property *property = &cloud->property[i];
        json_t *json = json_pack("{s:s, s:s}", "name", property->name, "type", property->type);
        if (property->count_type) json_object_set_new(json, "list_count_type", json_string(property->count_type));
        json_array_append_new(list, json);
    }
    return list;
}

static json_int_t count_of(const json_t *input, const char *name) {
    return json_integer_value(json_object_get(input, name));
}

/* Points that the job whose report it is was not asked to take. */
static json_int_t unselected(const json_t *input) {
    return count_of(input, "points_cropped") + count_of(input, "points_filtered");
}

/* The box of all points: where some were dropped, the report's is that of the others. */
static json_t *box_json(const json_t *input) {
    json_t *min = json_object_get(input, "box_min"), *max = json_object_get(input, "box_max");
    if (!min || !max || count_of(input, "points_outliers") || unselected(input)) return json_null();
    return json_pack("{s:O, s:O}", "min", min, "max", max);
}

static json_t *points_json(const struct cloud_document *cloud, const json_t *input) {
    json_int_t counted = count_of(input, "points") + unselected(input);
    json_int_t points = cloud->points ? (json_int_t)cloud->points : counted;
    return points ? json_integer(points) : json_null();
}

static json_t *time_or_null(int64_t ms) {
    char text[JOB_JSON_TIME_BYTES];
    return ms ? json_string(job_json_time(ms, text)) : json_null();
}

static json_t *cloud_json(const struct cloud_document *cloud) {
    json_t *report = cloud->report ? json_loads(cloud->report, 0, NULL) : NULL;
    const json_t *input = json_object_get(report, "input");
    json_t *href = json_sprintf("%s/v1/clouds/%s", links_base(), cloud->sha256);
    json_t *json =
        json_pack("{s:s, s:s, s:s, s:I, s:o, s:o, s:o, s:o, s:o, s:I, s:[{s:s, s:O}, {s:s, s:o}]}", "id", cloud->sha256,
                  "sha256", cloud->sha256, "format", cloud->format, "bytes", (json_int_t)cloud->bytes, "points",
                  points_json(cloud, input), "properties", properties_json(cloud), "bounding_box", box_json(input),
                  "created", time_or_null(cloud->created_ms), "expires", time_or_null(cloud->expires_ms), "jobs",
                  (json_int_t)cloud->jobs, "links", "rel", "self", "href", href, "rel", "data", "href",
                  json_sprintf("%s/v1/clouds/%s/data", links_base(), cloud->sha256));
    json_decref(href);
    json_decref(report);
    return json;
}

/* Takes json. */
static char *dump(json_t *json) {
    char *text = json ? json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(15)) : NULL;
    json_decref(json);
    return text;
}

char *cloud_encode(const struct cloud_document *cloud) { return dump(cloud_json(cloud)); }

char *cloud_list_encode(const struct cloud_document *clouds, size_t count) {
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++) json_array_append_new(list, cloud_json(&clouds[i]));
    return dump(json_pack("{s:o}", "clouds", list));
}
