/* The document of a cloud.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/cloud_json.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>

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

/* The box of all points: where some were dropped, the report's is that of the others, and the header's is told. */
static json_t *box_json(const struct cloud_document *cloud, const json_t *input) {
    json_t *min = json_object_get(input, "box_min"), *max = json_object_get(input, "box_max");
    const double *low = cloud->header_min, *high = cloud->header_max;
    if (min && max && !count_of(input, "points_outliers") && !unselected(input))
        return json_pack("{s:O, s:O}", "min", min, "max", max);
    if (!low || !high) return json_null();
    return json_pack("{s:[f,f,f], s:[f,f,f]}", "min", low[0], low[1], low[2], "max", high[0], high[1], high[2]);
}

static json_t *points_json(const struct cloud_document *cloud, const json_t *input) {
    json_int_t counted = count_of(input, "points") + unselected(input);
    json_int_t points = cloud->points ? (json_int_t)cloud->points : counted;
    if (!points && cloud->header_points <= INT64_MAX) points = (json_int_t)cloud->header_points;
    return points ? json_integer(points) : json_null();
}

static json_t *time_or_null(int64_t ms) {
    char text[JOB_JSON_TIME_BYTES];
    return ms ? json_string(job_json_time(ms, text)) : json_null();
}

static json_t *stored_cloud_json(const struct cloud_document *cloud) {
    json_t *report = cloud->report ? json_loads(cloud->report, 0, NULL) : NULL;
    const json_t *input = json_object_get(report, "input");
    json_t *href = json_sprintf("%s/v1/clouds/%s", links_base(), cloud->sha256);
    json_t *json =
        json_pack("{s:s, s:s, s:s, s:I, s:o, s:o, s:o, s:o, s:o, s:I, s:[{s:s, s:O}, {s:s, s:o}]}", "id", cloud->sha256,
                  "sha256", cloud->sha256, "format", cloud->format, "bytes", (json_int_t)cloud->bytes, "points",
                  points_json(cloud, input), "properties", properties_json(cloud), "bounding_box",
                  box_json(cloud, input), "created", time_or_null(cloud->created_ms), "expires",
                  time_or_null(cloud->expires_ms), "jobs", (json_int_t)cloud->jobs, "links", "rel", "self", "href",
                  href, "rel", "data", "href", json_sprintf("%s/v1/clouds/%s/data", links_base(), cloud->sha256));
    json_decref(href);
    json_decref(report);
    return json;
}

/* Takes json. */
static char *cloud_dump(json_t *json) {
    char *text = json ? json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(15)) : NULL;
    json_decref(json);
    return text;
}

char *cloud_encode(const struct cloud_document *cloud) { return cloud_dump(stored_cloud_json(cloud)); }

char *cloud_list_encode(const struct cloud_document *clouds, size_t count) {
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++) json_array_append_new(list, stored_cloud_json(&clouds[i]));
    return cloud_dump(json_pack("{s:o}", "clouds", list));
}

/* ------------------------------------------------------------------------------------------------ plans */

static json_t *kept_json(json_int_t points, double ratio) {
    double kept = floor(ratio * (double)points);
    return json_integer(kept < 1 ? 1 : (json_int_t)kept);
}

/* How many points are asked for, level by level; null where the cloud's own are not known, or where only the run finds
 * out.  Repeated points and outliers may leave fewer. */
static json_t *goals_json(json_int_t points, const struct params *params) {
    bool found_out = params_bound_deviation(params) || params->max_error > 0 || !isnan(params->spacing) ||
                     params->crop.count || params->where[0];
    if (!points || found_out) return json_null();
    if (params->points)
        return json_pack("[I]", params->points < (uint64_t)points ? (json_int_t)params->points : points);
    if (!params->levels.count) return json_pack("[o]", kept_json(points, params->ratio));
    json_t *list = json_array();
    for (uint32_t i = 0; i < params->levels.count; i++)
        json_array_append_new(list, kept_json(points, params->levels.ratio[i]));
    return list;
}

/* A problem as an object of its own. */
static json_t *cloud_problem_json(const struct problem *problem) {
    char *text = problem ? problem_encode(problem) : NULL;
    json_t *json = text ? json_loads(text, 0, NULL) : json_null();
    free(text);
    return json;
}

char *plan_encode(const struct plan_document *plan) {
    json_t *report = plan->cloud.report ? json_loads(plan->cloud.report, 0, NULL) : NULL;
    json_t *points = points_json(&plan->cloud, json_object_get(report, "input"));
    json_t *json =
        json_pack("{s:s, s:b, s:o, s:o, s:o, s:I, s:o, s:o}", "cloud", plan->cloud.sha256, "fits", !plan->problem,
                  "points_out", goals_json(json_integer_value(points), plan->params), "points", points, "memory_bytes",
                  plan->memory_bytes ? json_integer((json_int_t)plan->memory_bytes) : json_null(), "memory_limit_bytes",
                  (json_int_t)plan->memory_limit_bytes, "seconds",
                  isnan(plan->seconds) ? json_null() : json_real(round(plan->seconds * 100) / 100), "problem",
                  cloud_problem_json(plan->problem));
    json_decref(report);
    return cloud_dump(json);
}
