/* The job document and its relatives.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/job_json.h"

#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "api/codecs/params_json.h"
#include "api/links.h"
#include "api/problem.h"
#include "core/io/sniff.h"

enum { DUMP = JSON_REAL_PRECISION(15) };

const char *job_json_time(int64_t ms, char text[JOB_JSON_TIME_BYTES]) {
    time_t seconds = (time_t)(ms / 1000);
    struct tm tm;
    gmtime_r(&seconds, &tm);
    size_t used = strftime(text, JOB_JSON_TIME_BYTES, "%Y-%m-%dT%H:%M:%S", &tm);
    snprintf(text + used, JOB_JSON_TIME_BYTES - used, ".%03dZ", (int)(ms % 1000));
    return text;
}

static json_t *time_json(int64_t ms) {
    char text[JOB_JSON_TIME_BYTES];
    return ms ? json_string(job_json_time(ms, text)) : json_null();
}

static json_t *text_or_null(const char *text) {
    json_t *json = text && *text ? json_string(text) : NULL;
    return json ? json : json_null();
}

static json_t *parsed_or_null(const char *text) {
    json_t *json = text && *text ? json_loads(text, 0, NULL) : NULL;
    return json ? json : json_null();
}

static json_t *job_problem_json(const char *text) {
    char *relocated = text && *text ? problem_relocate(text) : NULL;
    json_t *json = parsed_or_null(relocated);
    free(relocated);
    return json;
}

static json_t *count_or_null(uint64_t value) { return value ? json_integer((json_int_t)value) : json_null(); }

static json_t *link_json(const char *rel, const char *id, const char *suffix) {
    return json_pack("{s:s, s:o}", "rel", rel, "href", json_sprintf("%s/v1/jobs/%s%s", links_base(), id, suffix));
}

static json_t *links_json(const struct job_document *job) {
    json_t *links = json_array();
    json_array_append_new(links, link_json("self", job->id, ""));
    json_array_append_new(links, link_json("events", job->id, "/events"));
    json_array_append_new(links, link_json("log", job->id, "/log"));
    if (job->has_outputs) json_array_append_new(links, link_json("results", job->id, "/outputs"));
    return links;
}

/* A count that the report has; 0 where there is none. */
static uint64_t counted(const json_t *report, const char *name) {
    return (uint64_t)json_integer_value(json_object_get(report, name));
}

/* Of the header, else as the job has counted them. */
static uint64_t points_of(const struct job_document *job, const json_t *report) {
    return job->input_points ? job->input_points : counted(report, "points_in");
}

static json_t *job_input_json(const struct job_document *job, const json_t *report) {
    return json_pack("{s:o, s:s, s:o, s:I, s:o}", "cloud", json_sprintf("%s/v1/clouds/%s", links_base(), job->cloud),
                     "sha256", job->cloud, "points", count_or_null(points_of(job, report)), "bytes",
                     (json_int_t)job->input_bytes, "format", text_or_null(job->input_format));
}

/* How many points the ratio comes to, as they will be or were kept; 0: that isn't known, or isn't the goal. */
static uint64_t points_of_ratio(const struct job_document *job, const json_t *report) {
    const struct params *params = job->params;
    uint64_t points = points_of(job, report), kept = counted(report, "points_out");
    if (isnan(params->ratio) || !isnan(params->max_error) || params_bound_deviation(params) || !points) return 0;
    double wanted = floor(params->ratio * (double)points);
    return kept ? kept : wanted < 1 ? 1 : (uint64_t)wanted;
}

/* What runs or has run, rather than what was sent. */
static json_t *params_json(const struct job_document *job, const json_t *report) {
    struct params params = *job->params;
    uint64_t threads = counted(json_object_get(report, "params"), "threads"), points = points_of_ratio(job, report);
    params.threads = threads ? threads : job->threads;
    if (points) params.points = points;
    return params_to_json(&params);
}

static json_t *resources_json(const struct job_document *job) {
    if (!job->peak_rss_bytes) return json_null();
    return json_pack("{s:f, s:f, s:I}", "cpu_seconds", job->cpu_s, "wall_seconds", job->wall_s, "peak_rss_bytes",
                     (json_int_t)job->peak_rss_bytes);
}

static json_t *estimate_json(const struct job_document *job) {
    if (isnan(job->time_left_s)) return json_null();
    return json_pack("{s:f}", "seconds_left", round(job->time_left_s * 10) / 10);
}

static json_t *tiles_json(const struct job_document *job) {
    if (!job->tiles) return json_null();
    return json_pack("{s:I, s:I}", "done", (json_int_t)job->tiles_done, "of", (json_int_t)job->tiles);
}

static json_t *batch_path_json(const char *id) {
    return id && *id ? json_sprintf("%s/v1/batches/%s", links_base(), id) : json_null();
}

static json_t *job_json(const struct job_document *job) {
    json_t *report = parsed_or_null(job->report);
    const struct {
        const char *name;
        json_t *value;
    } members[] = {
        {"id", json_string(job->id)},
        {"status", json_string(job->status)},
        {"stage", text_or_null(job->stage)},
        {"progress", json_integer((json_int_t)(job->fraction * 100))},
        {"message", text_or_null(job->message)},
        {"tiles", tiles_json(job)},
        {"created", time_json(job->created_ms)},
        {"started", time_json(job->started_ms)},
        {"finished", time_json(job->finished_ms)},
        {"updated", time_json(job->updated_ms)},
        {"expires", time_json(job->expires_ms)},
        {"queue", json_pack("{s:I, s:i}", "ahead", (json_int_t)job->ahead, "priority", job->priority)},
        {"estimate", estimate_json(job)},
        {"attempt", json_integer(job->attempt)},
        {"label", text_or_null(job->label)},
        {"principal", text_or_null(job->principal)},
        {"batch", batch_path_json(job->batch)},
        {"input", job_input_json(job, report)},
        {"params", params_json(job, report)},
        {"resources", resources_json(job)},
        {"report", report},
        {"problem", job_problem_json(job->problem)},
        {"links", links_json(job)},
    };
    json_t *json = json_object();
    for (size_t i = 0; i < sizeof members / sizeof *members; i++)
        json_object_set_new(json, members[i].name, members[i].value);
    return json;
}

/* Takes json. */
static char *job_dump(json_t *json, size_t flags) {
    char *text = json ? json_dumps(json, flags | DUMP) : NULL;
    json_decref(json);
    return text;
}

char *job_encode(const struct job_document *job) { return job_dump(job_json(job), JSON_COMPACT); }

char *job_list_encode(const struct job_document *jobs, size_t count) {
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++) json_array_append_new(list, job_json(&jobs[i]));
    return job_dump(json_pack("{s:o}", "jobs", list), JSON_COMPACT);
}

char *job_outputs_encode(const char *id, const struct output_document *outputs, size_t count) {
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++)
        json_array_append_new(
            list, json_pack("{s:s, s:o, s:s, s:I, s:s}", "name", outputs[i].name, "href",
                            json_sprintf("%s/v1/jobs/%s/outputs/%s", links_base(), id, outputs[i].name), "media_type",
                            outputs[i].media_type, "bytes", (json_int_t)outputs[i].bytes, "sha256", outputs[i].sha256));
    return job_dump(json_pack("{s:o}", "outputs", list), JSON_COMPACT);
}

char *job_link_encode(const char *href, int64_t expires_ms) {
    return job_dump(json_pack("{s:s, s:o}", "href", href, "expires", time_json(expires_ms)), JSON_COMPACT);
}

char *job_event_encode(const struct job_document *job) {
    return job_dump(json_pack("{s:s, s:s, s:o, s:I, s:o, s:I, s:o, s:i}", "id", job->id, "status", job->status, "stage",
                              text_or_null(job->stage), "progress", (json_int_t)(job->fraction * 100), "message",
                              text_or_null(job->message), "ahead", (json_int_t)job->ahead, "estimate",
                              estimate_json(job), "attempt", job->attempt),
                    JSON_COMPACT);
}

/* Names with commas between, as a list. */
static json_t *names_json(const char *text) {
    json_t *list = json_array();
    for (; *text; text += *text == ',') {
        size_t length = strcspn(text, ",");
        json_array_append_new(list, json_stringn(text, length));
        text += length;
    }
    return list;
}

static json_t *output_files_json(void) {
    json_t *list = json_array();
    for (unsigned bit = 0; bit < PARAMS_OUTPUTS; bit++)
        json_array_append_new(list, json_string(params_output_file(bit)));
    return list;
}

/* What an upload may be. */
static json_t *features_json(void) {
    return json_pack("{s:[s, s, s], s:[s, s], s:[s], s:[s]}", "request_bodies", "application/octet-stream",
                     "multipart/form-data", "application/json", "content_codings", "gzip", "zstd", "digests", "sha-256",
                     "resumable_uploads", "tus/1.0.0");
}

static json_t *list_json(struct job_info_list list) {
    json_t *object = json_object();
    const char *name;
    int64_t value;
    for (size_t i = 0; list.next(list.ctx, i, &name, &value); i++)
        json_object_set_new(object, name, json_integer(value));
    return object;
}

char *job_info_encode(const char *version, struct job_info_list limits, struct job_info_list confinement) {
    return job_dump(json_pack("{s:s, s:s, s:o, s:[s, s], s:o, s:o, s:o, s:o, s:{s:o, s:o}}", "name", "whittled",
                              "version", version, "input_formats", names_json(cloud_sniff_formats()),
                              "input_compressions", "gzip", "zstd", "outputs", output_files_json(), "features",
                              features_json(), "limits", list_json(limits), "confinement", list_json(confinement),
                              "links", "contract", json_sprintf("%s/openapi.json", links_base()), "parameters",
                              json_sprintf("%s/v1/parameters", links_base())),
                    JSON_INDENT(2));
}
