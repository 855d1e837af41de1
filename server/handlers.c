/* Operation to handler: the table, and what several handlers share.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/handlers.h"
#include "server/handlers_keys.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "api/job_json.h"
#include "core/alloc.h"

enum {
    HEAD_BYTES = 64 * 1024, /* of a cloud, for what it says of its size */
    PAGE_DEFAULT = 50,
    PAGE_MAX = 500
};

static const struct handler table[OPERATION_COUNT] = {
    [OPERATION_GET_PAGE] = {NULL, handlers_get_page, NULL, true},
    [OPERATION_GET_DOCS] = {NULL, handlers_get_docs, NULL, true},
    [OPERATION_SIMPLIFY] = {handlers_admit_simplify, handlers_simplify, NULL, false},
    [OPERATION_CREATE_JOB] = {handlers_admit_job, handlers_create_job, NULL, false},
    [OPERATION_LIST_JOBS] = {NULL, handlers_list_jobs, NULL, false},
    [OPERATION_GET_JOB] = {NULL, handlers_get_job, handlers_job_at_hand, false},
    [OPERATION_DELETE_JOB] = {NULL, handlers_delete_job, NULL, false},
    [OPERATION_GET_EVENTS] = {NULL, handlers_get_events, NULL, false},
    [OPERATION_GET_LOG] = {NULL, handlers_get_log, NULL, false},
    [OPERATION_LIST_OUTPUTS] = {NULL, handlers_list_outputs, NULL, false},
    [OPERATION_GET_OUTPUT] = {NULL, handlers_get_output, NULL, false},
    [OPERATION_CREATE_LINK] = {NULL, handlers_create_link, NULL, false},
    [OPERATION_CREATE_CLOUD] = {handlers_admit_new_cloud, handlers_create_cloud, NULL, false},
    [OPERATION_LIST_CLOUDS] = {NULL, handlers_list_clouds, NULL, false},
    [OPERATION_GET_CLOUD] = {NULL, handlers_get_cloud, NULL, false},
    [OPERATION_DELETE_CLOUD] = {NULL, handlers_delete_cloud, NULL, false},
    [OPERATION_GET_CLOUD_DATA] = {NULL, handlers_get_cloud_data, NULL, false},
    [OPERATION_UPLOAD_OPTIONS] = {NULL, handlers_upload_options, NULL, true},
    [OPERATION_CREATE_UPLOAD] = {handlers_admit_upload, handlers_create_upload, NULL, false},
    [OPERATION_GET_UPLOAD] = {NULL, handlers_get_upload, NULL, false},
    [OPERATION_CONTINUE_UPLOAD] = {handlers_admit_piece, handlers_continue_upload, NULL, false},
    [OPERATION_DELETE_UPLOAD] = {NULL, handlers_delete_upload, NULL, false},
    [OPERATION_GET_PARAMETERS] = {NULL, handlers_get_parameters, NULL, true},
    [OPERATION_GET_INFO] = {NULL, handlers_get_info, NULL, true},
    [OPERATION_GET_CONTRACT] = {NULL, handlers_get_contract, NULL, true},
    [OPERATION_GET_PROBLEM] = {NULL, handlers_get_problem, NULL, true},
    [OPERATION_GET_HEALTH] = {NULL, handlers_get_health, NULL, true},
    [OPERATION_GET_READINESS] = {NULL, handlers_get_readiness, NULL, true},
    [OPERATION_GET_METRICS] = {NULL, handlers_get_metrics, NULL, true},
};

const struct handler *handlers_find(enum operation operation) { return &table[operation]; }

bool handlers_takes_no_query(const struct request *request, struct response *response) {
    struct problem problem;
    if (query_check(request->query, request->query_count, NULL, &problem)) return true;
    response_problem(response, &problem);
    return false;
}

bool handlers_read_page(const struct request *request, const char *const *names, bool (*valid)(const char *id),
                        const char *what, struct handlers_page *page, struct response *response) {
    struct problem problem;
    const char *most = query_find(request->query, request->query_count, "limit");
    char *end = "";
    unsigned long number = most ? strtoul(most, &end, 10) : PAGE_DEFAULT;
    bool whole = !most || (most[0] >= '0' && most[0] <= '9' && !*end);
    *page = (struct handlers_page){number, query_find(request->query, request->query_count, "after")};
    if (!query_check(request->query, request->query_count, names, &problem))
        response_problem(response, &problem);
    else if (page->after && !valid(page->after))
        response_invalid(response, "after", page->after, what);
    else if (!whole || number < 1 || number > PAGE_MAX)
        response_invalid(response, "limit", most, "a whole number from 1 to 500");
    else
        return true;
    return false;
}

/* ------------------------------------------------------------------------------------------------ clouds come in */

bool handlers_is_within_share(struct service *service, const struct request *request, uint64_t body, bool for_job,
                              struct response *response) {
    const struct config *config = service->config;
    struct usage_figures has = queue_usage(service->queue, request->principal.name);
    uint64_t jobs = (uint64_t)config->principal_jobs, bytes = (uint64_t)config->principal_bytes;
    if (bytes) has.bytes += uploads_bytes_of(service->uploads, request->principal.name);
    if (for_job && jobs && has.active >= jobs)
        response_limit(response, PROBLEM_RATE_LIMITED, "principal_jobs", jobs, has.active);
    else if (bytes && (has.bytes >= bytes || body > bytes - has.bytes))
        response_limit(response, PROBLEM_RATE_LIMITED, "principal_bytes", bytes, has.bytes);
    else
        return true;
    return false;
}

bool handlers_is_open(struct service *service, uint64_t body, bool for_job, struct response *response) {
    uint64_t waiting, running;
    queue_depth(service->queue, &waiting, &running);
    if (atomic_load(&service->draining))
        response_refuse(response, PROBLEM_DRAINING, "the service is about to stop");
    else if (for_job && waiting >= (uint64_t)service->config->max_queue)
        response_refuse(response, PROBLEM_QUEUE_FULL, "%llu jobs are waiting", (unsigned long long)waiting);
    else if (body <= (uint64_t)service->config->max_body_bytes && !store_has_room(service->store, body))
        response_refuse(response, PROBLEM_STORAGE_FULL, "the disk has no room for this body");
    else
        return true;
    return false;
}

bool handlers_has_room(struct service *service, const struct request *request, uint64_t body, bool for_job,
                       struct response *response) {
    return handlers_is_open(service, body, for_job, response) &&
           handlers_is_within_share(service, request, body, for_job, response);
}

struct admission handlers_admission(const struct config *config, const struct params *params) {
    struct admission admission = {.max_points = (uint64_t)config->max_points,
                                  .max_memory_bytes = (uint64_t)config->job_memory_bytes,
                                  .has_params = params != NULL};
    if (params) admission.params = *params;
    return admission;
}

bool handlers_admit_body(struct service *service, struct request *request, unsigned takes, const char *const *names,
                         const struct params *params, struct response *response) {
    const struct config *config = service->config;
    struct body_plan plan = {.takes = takes,
                             .store = service->store,
                             .threads = service->hashing,
                             .max_bytes = (uint64_t)config->max_body_bytes,
                             .admission = handlers_admission(config, params),
                             .max_expansion = (uint32_t)config->max_expansion,
                             .content_length = request->content_length,
                             .type = request->header[HEADER_CONTENT_TYPE],
                             .coding = request->header[HEADER_CONTENT_ENCODING],
                             .content_digest = request->header[HEADER_CONTENT_DIGEST],
                             .repr_digest = request->header[HEADER_REPR_DIGEST],
                             .names = names};
    struct problem problem;
    uint64_t bytes = request->content_length == UINT64_MAX ? 0 : request->content_length;
    if (!handlers_has_room(service, request, bytes, takes & BODY_JSON, response)) return false;
    request->body = body_new(&plan, &problem);
    if (!request->body) response_problem(response, &problem);
    return request->body != NULL;
}

bool handlers_end_body(struct request *request, struct response *response) {
    struct problem problem;
    size_t room = REQUEST_MAX_QUERY - request->query_count;
    bool ok = body_end(request->body, &problem);
    size_t count = ok ? body_pairs(request->body, request->query + request->query_count, room) : 0;
    if (count > room) problem_set(&problem, PROBLEM_MALFORMED_REQUEST, "there are too many parameters");
    if (ok && count <= room) {
        request->query_count += count;
        return true;
    }
    response_problem(response, &problem);
    return false;
}

bool handlers_read_wishes(const struct request *request, struct job *job, struct problem *problem) {
    const char *label = query_find(request->query, request->query_count, "label");
    if (label && (strlen(label) >= JOB_LABEL_BYTES || !query_is_text(label))) {
        problem_set(problem, PROBLEM_INVALID_PARAMETER, "label: takes up to 128 bytes of UTF-8");
        problem_add_error(problem, "label", label, "up to 128 bytes of UTF-8", NULL);
        return false;
    }
    snprintf(job->label, sizeof job->label, "%s", label ? label : "");
    const char *priority = query_find(request->query, request->query_count, "priority");
    bool digit = priority && priority[0] >= '0' && priority[0] <= '0' + JOB_PRIORITY_MAX && !priority[1];
    if (priority && !digit) {
        problem_set(problem, PROBLEM_INVALID_PARAMETER, "priority: takes a whole number from 0 to %d",
                    JOB_PRIORITY_MAX);
        problem_add_error(problem, "priority", priority, "a whole number from 0 to 9", NULL);
        return false;
    }
    job->priority = priority ? priority[0] - '0' : JOB_PRIORITY_DEFAULT;
    return true;
}

/* Cache-Control: no-cache asks for a run, even where a result is there. */
static bool wants_fresh(const struct request *request) {
    const char *control = request->header[HEADER_CACHE_CONTROL];
    return control && strcasestr(control, "no-cache");
}

bool handlers_end_upload(struct request *request, struct upload_facts *facts, struct response *response) {
    struct problem problem;
    if (upload_end(body_upload(request->body), facts, &problem)) return true;
    response_problem(response, &problem);
    return false;
}

/* What is known of the request's input, which is in its body or here already. */
static bool read_input(struct service *service, struct request *request, struct upload_facts *facts,
                       struct response *response) {
    struct clouds_record record;
    if (body_upload(request->body)) return handlers_end_upload(request, facts, response);
    bool found = handlers_read_cloud(service, request, body_input(request->body), &record, response);
    *facts = (struct upload_facts){.bytes = record.bytes, .points = record.points};
    memcpy(facts->sha256, record.sha256, sizeof facts->sha256);
    memcpy(facts->format, record.format, sizeof facts->format);
    clouds_record_done(&record);
    return found;
}

/* Whether the request came before under its key: then job->id is set.  false: the response says why. */
static bool came_before(struct service *service, const struct request *request, struct job *job, const char *cloud,
                        struct job_key *key, struct idempotency_record *before, struct response *response) {
    bool found = false;
    if (!request->claim.held) return true;
    if (!handlers_fingerprint(request, job, cloud, key)) {
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "no memory");
        return false;
    }
    if (!handlers_find_reply(service, request, key, before, &found, response)) return false;
    if (found) snprintf(job->id, sizeof job->id, "%.36s", before->made);
    return true;
}

/* The first bytes of the request's cloud, which is in its body or here already; returns new, NULL: it can't be read. */
static unsigned char *read_head(struct service *service, const struct request *request, const char *sha256,
                                size_t *count) {
    const struct upload *upload = body_upload(request->body);
    unsigned char *head = alloc_array(HEAD_BYTES, 1);
    int fd = upload ? -1 : store_cloud_open(service->store, sha256);
    const void *bytes = upload ? upload_head(upload, count) : NULL;
    ssize_t n = fd >= 0 && head ? pread(fd, head, HEAD_BYTES, 0) : -1;
    if (bytes && head) memcpy(head, bytes, *count = *count < HEAD_BYTES ? *count : HEAD_BYTES);
    if (n >= 0) *count = (size_t)n;
    if (fd >= 0) close(fd);
    if (head && (bytes || n >= 0)) return head;
    free(head);
    return NULL;
}

/* Whether the job, of which all is known now, fits the limits; fills in what it will take. */
static bool fits(struct service *service, const struct request *request, const struct upload_facts *facts,
                 struct job *job, struct response *response) {
    struct admission admission = handlers_admission(service->config, &job->params);
    struct problem problem;
    size_t count;
    unsigned char *head = read_head(service, request, facts->sha256, &count);
    bool ok = !head || admission_check(&admission, head, count, facts->bytes, &job->memory_bytes, &problem);
    if (!ok) response_problem(response, &problem);
    free(head);
    return ok;
}

bool handlers_submit(struct service *service, struct request *request, struct job *job,
                     struct idempotency_record *before, struct response *response) {
    struct upload_facts facts;
    struct error error = {0};
    struct job_key key;
    memset(before, 0, sizeof *before);
    if (!read_input(service, request, &facts, response)) return false;
    memcpy(job->principal, request->principal.name, sizeof job->principal);
    job->params.outputs |= OUTPUT_REPORT; /* the job document carries the report's figures */
    if (!fits(service, request, &facts, job, response)) return false;
    if (!came_before(service, request, job, facts.sha256, &key, before, response)) return false;
    if (job->id[0]) return true;
    job->key = request->claim.held ? &key : NULL;
    enum status status = service_submit(service, body_upload(request->body), &facts, job, wants_fresh(request), &error);
    job->key = NULL;
    body_drop_upload(request->body);
    if (status == STATUS_LIMIT)
        response_refuse(response, strcmp(error.where, "queue") == 0 ? PROBLEM_QUEUE_FULL : PROBLEM_RATE_LIMITED, "%s",
                        error.text);
    else if (status == STATUS_BAD_PARAMETER)
        response_refuse(response, PROBLEM_NO_SUCH_CLOUD, "%s", error.text);
    else if (status != STATUS_OK)
        response_error(response, &error);
    return status == STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ jobs go out */

bool handlers_read_job(struct service *service, const struct request *request, const char *id, struct job *job,
                       struct response *response) {
    struct error error = {0};
    struct problem problem;
    enum queue_presence presence = QUEUE_ABSENT;
    struct queue_tombstone tombstone = {0};
    memset(job, 0, sizeof *job);
    if (job_id_valid(id) && queue_get(service->queue, id, job, &presence, &tombstone, &error) != STATUS_OK) {
        response_error(response, &error);
        return false;
    }
    const char *owner = presence == QUEUE_PRESENT ? job->principal : tombstone.principal;
    if (presence != QUEUE_ABSENT && !principal_sees(&request->principal, owner)) {
        job_done(job);
        presence = QUEUE_ABSENT;
    }
    if (presence == QUEUE_PRESENT) return true;
    if (presence == QUEUE_ABSENT) {
        problem_set(&problem, PROBLEM_NO_SUCH_JOB, "there is no job %.40s", id);
    } else {
        char at[JOB_TIME_BYTES];
        problem_set(&problem, PROBLEM_JOB_GONE, "the job %.40s was here and is %s", id, tombstone.reason);
        problem_add_text(&problem, "reason", tombstone.reason);
        problem_add_text(&problem, "at", job_time_text(tombstone.at_ms, at));
    }
    response_problem(response, &problem);
    return false;
}

struct job_document handlers_document(struct service *service, const struct job *job) {
    return (struct job_document){
        .id = job->id,
        .status = job_state_name(job->state),
        .stage = job->stage,
        .message = job->message,
        .label = job->label,
        .principal = job->principal,
        .fraction = job->fraction,
        .created_ms = job->created_ms,
        .started_ms = job->started_ms,
        .finished_ms = job->finished_ms,
        .updated_ms = job->updated_ms,
        .expires_ms = job->expires_ms,
        .ahead = job->ahead,
        .priority = job->priority,
        .time_left_s = job_ended(job->state) ? NAN : service_time_left(service, job),
        .attempt = job->attempt,
        .cloud = job->cloud,
        .input_points = job->input_points,
        .input_bytes = job->input_bytes,
        .input_format = job->input_format,
        .params = &job->params,
        .threads = service_threads(service, &job->params),
        .cpu_s = job->cpu_s,
        .wall_s = job->wall_s,
        .peak_rss_bytes = job->peak_rss_bytes,
        .report = job->report,
        .problem = job->problem,
        .has_outputs = job->output_count > 0,
    };
}

void handlers_document_response(char *text, uint64_t sequence, int status, struct response *response) {
    response_text(response, status, "application/json", text);
    response_header(response, "ETag", "\"%llu\"", (unsigned long long)sequence);
    response_header(response, "Cache-Control", "no-cache");
}

void handlers_job_response(struct service *service, const struct job *job, int status, struct response *response) {
    struct job_document document = handlers_document(service, job);
    handlers_document_response(job_encode(&document), job->sequence, status, response);
    if (!job_ended(job->state)) response_header(response, "Retry-After", "1");
}

void handlers_cache_status(bool hit, struct response *response) {
    response_header(response, "Cache-Status", hit ? "whittled; hit" : "whittled; fwd=miss");
}
