/* Problem documents: the table of kinds, and their JSON.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/problem.h"

#include <jansson.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/links.h"
#include "core/cloud_sniff.h"

static const struct problem_type types[PROBLEM_COUNT] = {
    [PROBLEM_INVALID_PARAMETER] =
        {"invalid-parameter", 400, "A parameter's value is not allowed",
         "See errors for the parameter and what it takes; GET /v1/parameters lists them all."},
    [PROBLEM_UNKNOWN_PARAMETER] = {"unknown-parameter", 400, "A parameter is unknown or given twice",
                                   "Nothing is ignored silently.  See errors, and GET /v1/parameters."},
    [PROBLEM_CONFLICTING_PARAMETERS] = {"conflicting-parameters", 400, "Parameters contradict each other",
                                        "Leave one of them out."},
    [PROBLEM_MALFORMED_REQUEST] = {"malformed-request", 400, "The request can't be understood",
                                   "Check how the request is put together: method, headers, query, body."},
    [PROBLEM_MALFORMED_CLOUD] = {"malformed-cloud", 422, "The cloud breaks the rules of its format",
                                 "line or byte_offset say where.  Header and data must agree in number and type."},
    [PROBLEM_DEGENERATE_CLOUD] = {"degenerate-cloud", 422, "The cloud has too few distinct points",
                                  "A mesh needs four points that are not all in one plane."},
    [PROBLEM_UNSUPPORTED_FORMAT] = {"unsupported-format", 415, "The content is of no format that is read here",
                                    "Send a cloud of one of the formats in supported; gzip and zstd may be around it."},
    [PROBLEM_NOT_ACCEPTABLE] = {"not-acceptable", 406, "The reply is of no kind that the request accepts",
                                "The output parameter decides what comes back.  Leave Accept away, or name one of "
                                "supported in it."},
    [PROBLEM_BODY_TOO_LARGE] = {"body-too-large", 413, "The body is over the limit",
                                "limit is in bytes.  A binary PLY is several times smaller than text."},
    [PROBLEM_HEADERS_TOO_LARGE] = {"headers-too-large", 431, "The headers are over the limit",
                                   "limit is in bytes, the first line included.  Send fewer or shorter headers."},
    [PROBLEM_TOO_MANY_POINTS] = {"too-many-points", 413, "The cloud is over a limit of its reader",
                                 "See GET /v1/info for the limits."},
    [PROBLEM_WOULD_EXCEED_MEMORY] = {"would-exceed-memory", 413, "The job would need more memory than it may use",
                                     "limit and actual (a prediction) are in bytes; hint says what would fit."},
    [PROBLEM_DIGEST_MISMATCH] = {"digest-mismatch", 400, "The body is not what its digest says",
                                 "Content-Digest and Repr-Digest are over the body as it is sent, with its content "
                                 "coding.  Nothing was kept; send it again."},
    [PROBLEM_NO_SUCH_JOB] = {"no-such-job", 404, "There is no such job", "GET /v1/jobs lists the jobs."},
    [PROBLEM_NO_SUCH_CLOUD] = {"no-such-cloud", 404, "There is no such cloud",
                               "GET /v1/clouds lists the clouds that you have uploaded and that are still kept."},
    [PROBLEM_CLOUD_IN_USE] = {"cloud-in-use", 409, "Jobs refer to the cloud",
                              "Delete the jobs first; a cloud is kept as long as its jobs are."},
    [PROBLEM_NO_SUCH_UPLOAD] = {"no-such-upload", 404, "There is no such upload",
                                "It was deleted, or has expired; begin a new one with POST /v1/uploads."},
    [PROBLEM_OFFSET_MISMATCH] = {"offset-mismatch", 409, "The upload doesn't go on there",
                                 "HEAD tells the offset at which it goes on."},
    [PROBLEM_UPLOAD_PROTOCOL] = {"upload-protocol", 412, "Resumable uploads speak tus 1.0.0",
                                 "Send Tus-Resumable: 1.0.0 with every request, or upload in one: POST /v1/clouds."},
    [PROBLEM_CHECKSUM_MISMATCH] = {"checksum-mismatch", 460, "The piece is not what its checksum says",
                                   "Nothing of the piece was kept; send it again."},
    [PROBLEM_TOO_MANY_UPLOADS] = {"too-many-uploads", 503, "Too many resumable uploads are open",
                                  "Delete those that are not wanted, or try again after Retry-After seconds."},
    [PROBLEM_NO_SUCH_OUTPUT] = {"no-such-output", 404, "The job has no such output",
                                "GET /v1/jobs/{id}/outputs lists them; the outputs parameter chooses them."},
    [PROBLEM_NO_SUCH_RESOURCE] = {"no-such-resource", 404, "There is nothing at this path",
                                  "GET /openapi.json describes every path.  None ends in a slash."},
    [PROBLEM_METHOD_NOT_ALLOWED] = {"method-not-allowed", 405, "The path doesn't take this method",
                                    "The Allow header lists those that it takes."},
    [PROBLEM_RESULT_NOT_READY] = {"result-not-ready", 409, "The job has not ended yet",
                                  "Try again after Retry-After seconds, or follow the job's events."},
    [PROBLEM_JOB_DISMISSED] = {"job-dismissed", 409, "The job was dismissed before it ended",
                               "It has no results; submit it again if that was a mistake."},
    [PROBLEM_JOB_GONE] = {"job-gone", 410, "The job and its outputs were deleted",
                          "reason and at say why and when.  Outputs are kept for the retention time in GET /v1/info."},
    [PROBLEM_RANGE_NOT_SATISFIABLE] = {"range-not-satisfiable", 416, "The range lies outside of the content",
                                       "Content-Range gives the length."},
    [PROBLEM_UNAUTHORIZED] = {"unauthorized", 401, "The operation wants a token",
                              "Send Authorization: Bearer with a token that the service's operator has given out."},
    [PROBLEM_FORBIDDEN] = {"forbidden", 403, "The token or the link doesn't open this",
                           "scope names what the token lacks.  A signed link opens one output, until it expires."},
    [PROBLEM_RATE_LIMITED] = {"rate-limited", 429, "A limit for each principal is reached",
                              "limit says which.  Try again after Retry-After seconds, or delete what is not needed."},
    [PROBLEM_IDEMPOTENCY_KEY_REUSED] = {"idempotency-key-reused", 422, "The key belongs to another request",
                                        "A key stands for one request: send the same again, or choose another key."},
    [PROBLEM_IDEMPOTENCY_IN_PROGRESS] = {"idempotency-in-progress", 409, "A request with this key is under way",
                                         "Try again after Retry-After seconds: the reply to the other one is given."},
    [PROBLEM_QUEUE_FULL] = {"queue-full", 503, "The queue is full", "Try again after Retry-After seconds."},
    [PROBLEM_DRAINING] = {"draining", 503, "The service is about to stop and takes no new work",
                          "Try again after Retry-After seconds."},
    [PROBLEM_STORAGE_FULL] = {"storage-full", 507, "There is no room to store the request",
                              "Try again later.  A file of a job has a limit too: job_file_bytes in GET /v1/info."},
    [PROBLEM_SYNC_TIMEOUT] = {"sync-timeout", 504, "The job takes longer than a request may wait",
                              "The job goes on: Location names it.  Nothing is lost."},
    [PROBLEM_ENGINE_ERROR] = {"engine-error", 500, "The computation failed",
                              "This is a fault of the service, not of the cloud.  The job's log says more."},
    [PROBLEM_OUT_OF_MEMORY] = {"out-of-memory", 507, "The job needed more memory than it may use",
                               "See job_memory_bytes in GET /v1/info; a smaller cloud needs less."},
    [PROBLEM_TIME_LIMIT] = {"time-limit", 504, "The job needed more time than it may use",
                            "See the limits in GET /v1/info; a smaller cloud, or no mesh, needs less."},
    [PROBLEM_WORKER_CRASHED] = {"worker-crashed", 500, "The job's process died",
                                "This is a fault of the service, not of the client.  The job's log says more."},
    [PROBLEM_INTERNAL_ERROR] = {"internal-error", 500, "The service failed",
                                "This is a fault of the service; its log says more."},
};

/* Which kind a status from the core is. */
static const enum problem_kind kinds[STATUS_COUNT] = {
    [STATUS_OK] = PROBLEM_INTERNAL_ERROR,
    [STATUS_NO_MEMORY] = PROBLEM_OUT_OF_MEMORY,
    [STATUS_IO] = PROBLEM_INTERNAL_ERROR,
    [STATUS_UNSUPPORTED] = PROBLEM_UNSUPPORTED_FORMAT,
    [STATUS_MALFORMED] = PROBLEM_MALFORMED_CLOUD,
    [STATUS_DEGENERATE] = PROBLEM_DEGENERATE_CLOUD,
    [STATUS_BAD_PARAMETER] = PROBLEM_INVALID_PARAMETER,
    [STATUS_LIMIT] = PROBLEM_TOO_MANY_POINTS,
    [STATUS_CANCELLED] = PROBLEM_JOB_DISMISSED,
    [STATUS_ENGINE] = PROBLEM_ENGINE_ERROR,
    [STATUS_NO_SPACE] = PROBLEM_STORAGE_FULL,
};

const struct problem_type *problem_type(enum problem_kind kind) { return &types[kind]; }

const struct problem_type *problem_type_of_slug(const char *slug) {
    for (size_t i = 0; i < PROBLEM_COUNT; i++)
        if (strcmp(types[i].slug, slug) == 0) return &types[i];
    return NULL;
}

void problem_set(struct problem *problem, enum problem_kind kind, const char *format, ...) {
    memset(problem, 0, sizeof *problem);
    problem->kind = kind;
    va_list args;
    va_start(args, format);
    vsnprintf(problem->detail, sizeof problem->detail, format, args);
    va_end(args);
}

static void add_member(struct problem *problem, const char *name, enum problem_member_type type, int64_t number,
                       const char *text) {
    if (problem->member_count == PROBLEM_MAX_MEMBERS) return;
    struct problem_member *member = &problem->member[problem->member_count++];
    snprintf(member->name, sizeof member->name, "%s", name);
    snprintf(member->text, sizeof member->text, "%s", text);
    member->type = type;
    member->number = number;
}

void problem_add_number(struct problem *problem, const char *name, int64_t number) {
    add_member(problem, name, PROBLEM_NUMBER, number, "");
}
void problem_add_text(struct problem *problem, const char *name, const char *text) {
    add_member(problem, name, PROBLEM_TEXT, 0, text);
}
void problem_add_list(struct problem *problem, const char *name, const char *comma_separated) {
    add_member(problem, name, PROBLEM_LIST, 0, comma_separated);
}

void problem_add_error(struct problem *problem, const char *parameter, const char *value, const char *allowed,
                       const char *suggestion) {
    if (problem->error_count == PROBLEM_MAX_ERRORS) return;
    struct problem_error *error = &problem->error[problem->error_count++];
    snprintf(error->parameter, sizeof error->parameter, "%s", parameter);
    snprintf(error->value, sizeof error->value, "%s", value ? value : "");
    snprintf(error->allowed, sizeof error->allowed, "%s", allowed ? allowed : "");
    snprintf(error->suggestion, sizeof error->suggestion, "%s", suggestion ? suggestion : "");
}

void problem_from_error(struct problem *problem, const struct error *error) {
    enum problem_kind kind = (unsigned)error->code < STATUS_COUNT ? kinds[error->code] : PROBLEM_ENGINE_ERROR;
    problem_set(problem, kind, "%s", error->text);
    if (kind == PROBLEM_INVALID_PARAMETER) {
        problem_add_error(problem, error->where, NULL, error->text, NULL);
        return;
    }
    if (error->line) problem_add_number(problem, "line", (int64_t)error->line);
    if (error->byte_offset != UINT64_MAX) problem_add_number(problem, "byte_offset", (int64_t)error->byte_offset);
    if (error->where[0])
        problem_add_text(problem, kind == PROBLEM_MALFORMED_CLOUD ? "property" : "where", error->where);
    if (kind == PROBLEM_UNSUPPORTED_FORMAT) problem_add_list(problem, "supported", cloud_sniff_formats());
}

/* ------------------------------------------------------------------------------------------------ JSON */

/* Text from outside may be no UTF-8, which JSON can't hold: each byte that isn't ASCII becomes '?' then. */
static json_t *text_json(const char *text) {
    json_t *json = json_string(text);
    if (json) return json;
    char ascii[PROBLEM_DETAIL_BYTES];
    snprintf(ascii, sizeof ascii, "%s", text);
    for (char *p = ascii; *p; p++)
        if (*p & 0x80) *p = '?';
    return json_string(ascii);
}

static json_t *list_json(const char *comma_separated) {
    json_t *list = json_array();
    for (const char *item = comma_separated; list && *item;) {
        size_t length = strcspn(item, ",");
        json_array_append_new(list, json_stringn(item, length));
        item += length + (item[length] == ',');
    }
    return list;
}

static json_t *member_json(const struct problem_member *member) {
    switch (member->type) {
    case PROBLEM_NUMBER: return json_integer(member->number);
    case PROBLEM_LIST: return list_json(member->text);
    case PROBLEM_TEXT: break;
    }
    return text_json(member->text);
}

static json_t *error_json(const struct problem_error *error) {
    const struct {
        const char *name, *text;
    } part[] = {{"parameter", error->parameter},
                {"value", error->value},
                {"allowed", error->allowed},
                {"did_you_mean", error->suggestion}};
    json_t *json = json_object();
    for (size_t i = 0; i < sizeof part / sizeof *part; i++)
        if (part[i].text[0]) json_object_set_new(json, part[i].name, text_json(part[i].text));
    return json;
}

char *problem_encode(const struct problem *problem) {
    const struct problem_type *type = &types[problem->kind];
    json_t *json = json_object(), *errors = json_array();
    json_object_set_new(json, "type", json_sprintf("%s/problems/%s", links_base(), type->slug));
    json_object_set_new(json, "title", json_string(type->title));
    json_object_set_new(json, "status", json_integer(type->http_status));
    json_object_set_new(json, "detail", text_json(problem->detail));
    for (size_t i = 0; i < problem->member_count; i++)
        json_object_set_new(json, problem->member[i].name, member_json(&problem->member[i]));
    for (size_t i = 0; i < problem->error_count; i++) json_array_append_new(errors, error_json(&problem->error[i]));
    if (problem->error_count) json_object_set(json, "errors", errors);
    char *text = json_dumps(json, JSON_COMPACT);
    json_decref(errors);
    json_decref(json);
    return text;
}

/* Whatever stood before the path is replaced by the base path. */
static void relocate(json_t *json, const char *member, const char *path) {
    const char *link = json_string_value(json_object_get(json, member)), *found = link ? strstr(link, path) : NULL;
    if (found) json_object_set_new(json, member, json_sprintf("%s%s", links_base(), found));
}

char *problem_relocate(const char *text) {
    json_t *json = json_loads(text, 0, NULL);
    relocate(json, "type", "/problems/");
    relocate(json, "log", "/v1/jobs/");
    char *relocated = json ? json_dumps(json, JSON_COMPACT) : NULL;
    json_decref(json);
    return relocated;
}

int problem_status_of(const char *text) {
    json_t *json = text ? json_loads(text, 0, NULL) : NULL;
    json_int_t status = json_integer_value(json_object_get(json, "status"));
    json_decref(json);
    return status >= 400 && status <= 599 ? (int)status : 500;
}

char *problem_page(const struct problem_type *type) {
    char *page;
    int n = asprintf(&page,
                     "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n"
                     "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
                     "<meta name=\"color-scheme\" content=\"light dark\">\n<title>%s</title>\n"
                     "<style>body{font:16px/1.5 system-ui,sans-serif;max-width:46rem;margin:2rem auto;padding:0 1rem}"
                     "</style>\n"
                     "<h1>%s</h1>\n<p><code>%s</code>, HTTP status %d</p>\n<p>%s</p>\n</html>\n",
                     type->title, type->title, type->slug, type->http_status, type->help);
    return n < 0 ? NULL : page;
}
