/* Operation to handler: the table, and what several handlers share.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/handlers/handlers.h"
#include "core/io/codec/inflate.h"
#include "server/handlers/keys.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "api/codecs/job_json.h"
#include "core/base/alloc.h"
#include "core/base/clock.h"
#include "server/storage/archive.h"
#include "server/webhooks/http_client.h"

enum {
    HEAD_BYTES = INFLATE_HEAD_BYTES, /* of a cloud, for what it says of its size */
    PAGE_DEFAULT = 50,
    PAGE_MAX = 500
};

static const struct handler *const table[OPERATION_COUNT] = {
#define ROUTE(operation, name, method, path, id, scope) [OPERATION_##operation] = &handlers_##name,
#include "api/routes.def"
};

static const struct handler *find_handler(enum operation operation) { return table[operation]; }

const struct handlers handlers_all = {find_handler, handlers_admit_key};

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

void handlers_refuse_bytes(const struct service *service, uint64_t has, uint64_t body, struct response *response) {
    uint64_t limit = (uint64_t)service->config->principal_bytes;
    bool never = body > limit;
    struct problem problem;
    if (never)
        problem_set(&problem, PROBLEM_BODY_TOO_LARGE, "principal_bytes is %llu, and this body alone has %llu bytes",
                    (unsigned long long)limit, (unsigned long long)body);
    else
        problem_set(
            &problem, PROBLEM_RATE_LIMITED,
            "principal_bytes is %llu: %llu bytes are kept for you, and %llu would come; delete clouds and jobs, or "
            "wait until some expire",
            (unsigned long long)limit, (unsigned long long)has, (unsigned long long)body);
    problem_add_number(&problem, "limit", (int64_t)limit);
    problem_add_number(&problem, "actual", (int64_t)(never ? body : has + body));
    response_problem(response, &problem);
}

bool handlers_is_within_share(struct service *service, const struct request *request, uint64_t body, bool for_job,
                              struct response *response) {
    const struct config *config = service->config;
    struct catalog_usage has = catalog_usage(service->catalog, request->principal.name);
    uint64_t jobs = (uint64_t)config->principal_jobs, bytes = (uint64_t)config->principal_bytes;
    has.bytes += has.reserved;
    if (body > (uint64_t)config->max_body_bytes) bytes = 0; /* it is refused for that */
    if (for_job && jobs && has.active >= jobs)
        response_limit(response, PROBLEM_RATE_LIMITED, "principal_jobs", jobs, has.active);
    else if (bytes && (has.bytes >= bytes || body > bytes - has.bytes))
        handlers_refuse_bytes(service, has.bytes, body, response);
    else
        return true;
    return false;
}

bool handlers_is_open(struct service *service, uint64_t body, bool for_job, struct response *response) {
    uint64_t waiting, running;
    catalog_depth(service->catalog, &waiting, &running);
    if (atomic_load(&service->draining))
        response_refuse(response, PROBLEM_DRAINING, "the service is shutting down");
    else if (for_job && waiting >= (uint64_t)service->config->max_queue)
        response_refuse(response, PROBLEM_QUEUE_FULL, "%llu jobs are waiting", (unsigned long long)waiting);
    else if (body <= (uint64_t)service->config->max_body_bytes &&
             !scratch_has_room(store_scratch(service->store), body))
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

bool handlers_admit_body(struct service *service, struct request *request, unsigned takes, const char *const *names,
                         const struct params *params, struct response *response) {
    const struct config *config = service->config;
    struct body_plan plan = {.takes = takes,
                             .store = service->store,
                             .threads = service->hashing,
                             .max_bytes = (uint64_t)config->max_body_bytes,
                             .admission = service_admission(config, params),
                             .max_expansion = (uint32_t)config->max_expansion,
                             .content_length = request->content_length,
                             .type = request->header[HEADER_CONTENT_TYPE],
                             .coding = request->header[HEADER_CONTENT_ENCODING],
                             .content_digest = request->header[HEADER_CONTENT_DIGEST],
                             .repr_digest = request->header[HEADER_REPR_DIGEST],
                             .names = names,
                             .input =
                                 takes == BODY_JSON && request->match.capture[0][0] ? request->match.capture[0] : NULL};
    struct problem problem;
    uint64_t bytes = request->content_length == UINT64_MAX ? 0 : request->content_length;
    enum request_flag complete = request_flag(request, HEADER_UPLOAD_COMPLETE);
    if (complete == FLAG_FALSE || complete == FLAG_MALFORMED) {
        response_refuse(response, PROBLEM_MALFORMED_REQUEST, "%s",
                        complete == FLAG_FALSE
                            ? "Upload-Complete: ?0 says that there is more to come: begin it by POST /v1/uploads"
                            : "Upload-Complete must be ?1, or not there");
        return false;
    }
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

bool handlers_read_preferences(const struct request *request, struct job *job, struct problem *problem) {
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

void handlers_begin_wait(const struct service *service, struct request *request) {
    int64_t prefer_ms = request_prefer_wait_ms(request, service->config->wait_max_ms);
    request->wait.end_ms = prefer_ms < 0 ? -1 : clock_ms() + prefer_ms;
}

bool handlers_read_webhook(const struct service *service, const struct request *request, struct job *job,
                           struct response *response) {
    const char *url = query_find(request->query, request->query_count, "webhook"), *allowed = NULL;
    job->webhook = url;
    if (url && !service->config->webhooks)
        allowed = "nothing: webhooks are off here";
    else if (url && (strlen(url) >= JOB_WEBHOOK_BYTES || !http_client_url_valid(url)))
        allowed = "an http or https URL without user and password, up to 2047 bytes";
    if (!allowed) return true;
    response_invalid(response, "webhook", NULL, allowed);
    return false;
}

bool handlers_wants_fresh(const struct request *request) {
    const char *control = request->header[HEADER_CACHE_CONTROL];
    return control && strcasestr(control, "no-cache");
}

bool handlers_end_upload(struct request *request, struct upload_facts *facts, struct response *response) {
    struct problem problem;
    if (upload_end(body_upload(request->body), facts, &problem)) return true;
    response_problem(response, &problem);
    return false;
}

/* Finds the cloud of this id for an archive; adds to the points, unless some aren't known. */
static bool find_member(struct service *service, struct request *request, const char *id, struct archive_member *member,
                        uint64_t *points, struct response *response) {
    struct catalog_cloud record;
    bool found = handlers_read_cloud(service, request, id, &record, response);
    snprintf(member->sha256, sizeof member->sha256, "%s", id);
    member->bytes = record.bytes;
    *points = *points && record.points ? *points + record.points : 0;
    catalog_cloud_done(&record);
    return found;
}

/* Makes one cloud of those that the body names: an archive of them, which is as if the body had held it. */
static bool join_input(struct service *service, struct request *request, struct upload_facts *facts,
                       struct response *response) {
    const struct body *body = request->body;
    size_t count = body_joined(body) + 1;
    struct archive_member *member = calloc(count, sizeof *member);
    struct admission admission = service_admission(service->config, NULL);
    uint64_t points = 1;
    struct problem problem;
    if (!member) {
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "no memory");
        return false;
    }
    bool ok = true;
    for (size_t i = 0; i < count && ok; i++) {
        const char *id = i ? body_joined_cloud(body, i - 1) : body_input(body);
        ok = find_member(service, request, id, &member[i], &points, response);
    }
    ok = ok && handlers_has_room(service, request, archive_bytes(member, count), true, response);
    if (ok) {
        struct upload *upload = archive_make(service->store, service->hashing, member, count,
                                             (uint64_t)service->config->max_body_bytes, &admission, &problem);
        if (upload) body_take_upload(request->body, upload);
        if (!upload) response_problem(response, &problem);
        ok = upload && handlers_end_upload(request, facts, response);
    }
    if (ok && points) facts->points = points - 1;
    free(member);
    return ok;
}

/* What is known of the request's input, which is in its body or here already. */
static bool read_input(struct service *service, struct request *request, struct upload_facts *facts,
                       struct response *response) {
    struct catalog_cloud record;
    if (body_upload(request->body)) return handlers_end_upload(request, facts, response);
    if (body_joined(request->body)) return join_input(service, request, facts, response);
    bool found = handlers_read_cloud(service, request, body_input(request->body), &record, response);
    *facts = (struct upload_facts){.bytes = record.bytes, .points = record.points};
    memcpy(facts->sha256, record.sha256, sizeof facts->sha256);
    memcpy(facts->format, record.format, sizeof facts->format);
    catalog_cloud_done(&record);
    return found;
}

/* Whether the request came before under its key: then job->id is set.  false: the response says why. */
static bool came_before(struct service *service, const struct request *request, struct job *job, const char *cloud,
                        struct job_key *key, struct catalog_reply *before, struct response *response) {
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
static unsigned char *read_head(struct service *service, const struct request *request,
                                const struct upload_facts *facts, size_t *count) {
    const struct upload *upload = request->body ? body_upload(request->body) : NULL;
    unsigned char *head = alloc_array(HEAD_BYTES, 1);
    const size_t most = facts->bytes < HEAD_BYTES ? (size_t)facts->bytes : HEAD_BYTES;
    const struct store_range range = {0, most - 1, facts->bytes};
    int fd = upload || !most ? -1 : store_cloud_open_range(service->store, facts->sha256, &range);
    const void *bytes = upload ? upload_head(upload, count) : NULL;
    ssize_t n = fd >= 0 && head ? pread(fd, head, most, 0) : -1;
    if (bytes && head) memcpy(head, bytes, *count = *count < HEAD_BYTES ? *count : HEAD_BYTES);
    if (n >= 0) *count = (size_t)n;
    if (fd >= 0) close(fd);
    if (head && (bytes || n >= 0)) return head;
    free(head);
    return NULL;
}

/* Whether the job, of which all is known now, fits the limits; fills in what it will take. */
static bool fits(struct service *service, const struct request *request, const struct upload_facts *facts,
                 struct job *job, struct problem *problem) {
    struct admission admission = service_admission(service->config, &job->params);
    size_t count;
    unsigned char *head = read_head(service, request, facts, &count);
    struct admitted admitted = {0};
    bool ok = !head || admission_check(&admission, head, count, facts->bytes, &admitted, problem);
    job->memory_bytes = admitted.memory_bytes;
    job->tiles = ok && admitted.in_tiles ? JOB_TILES_UNPLANNED : 0;
    free(head);
    return ok;
}

bool handlers_foresee(struct service *service, const struct request *request, const struct catalog_cloud *cloud,
                      struct job *job, struct problem *problem) {
    struct upload_facts facts = {.bytes = cloud->bytes};
    memcpy(facts.sha256, cloud->sha256, sizeof facts.sha256);
    memcpy(job->input_format, cloud->format, sizeof job->input_format);
    job->input_points = cloud->points;
    job->input_bytes = cloud->bytes;
    job->params.outputs |= OUTPUT_REPORT;
    return fits(service, request, &facts, job, problem);
}

bool handlers_submit(struct service *service, struct request *request, struct job *job, struct catalog_reply *before,
                     struct response *response) {
    struct upload_facts facts;
    struct problem problem;
    struct error error = {0};
    struct job_key key;
    memset(before, 0, sizeof *before);
    if (!read_input(service, request, &facts, response)) return false;
    memcpy(job->principal, request->principal.name, sizeof job->principal);
    job->params.outputs |= OUTPUT_REPORT; /* the job document carries the report's figures */
    if (!fits(service, request, &facts, job, &problem)) {
        response_problem(response, &problem);
        return false;
    }
    if (!came_before(service, request, job, facts.sha256, &key, before, response)) return false;
    if (job->id[0]) return true;
    job->key = request->claim.held ? &key : NULL;
    enum status status =
        service_submit(service, body_upload(request->body), &facts, job, handlers_wants_fresh(request), &error);
    job->key = NULL;
    body_drop_upload(request->body);
    return handlers_submitted(status, &error, response);
}

bool handlers_submitted(enum status status, const struct error *error, struct response *response) {
    if (status == STATUS_LIMIT)
        response_refuse(response, strcmp(error->where, "queue") == 0 ? PROBLEM_QUEUE_FULL : PROBLEM_RATE_LIMITED, "%s",
                        error->text);
    else if (status == STATUS_BAD_PARAMETER)
        response_refuse(response, PROBLEM_NO_SUCH_CLOUD, "%s", error->text);
    else if (status != STATUS_OK)
        response_error(response, error);
    return status == STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ jobs go out */

bool handlers_read_job(struct service *service, const struct request *request, const char *id, struct job *job,
                       struct response *response) {
    struct error error = {0};
    struct problem problem;
    enum catalog_presence presence = CATALOG_ABSENT;
    struct catalog_tombstone tombstone = {0};
    memset(job, 0, sizeof *job);
    if (job_id_valid(id) && catalog_get(service->catalog, id, job, &presence, &tombstone, &error) != STATUS_OK) {
        response_error(response, &error);
        return false;
    }
    const char *owner = presence == CATALOG_PRESENT ? job->principal : tombstone.principal;
    if (presence != CATALOG_ABSENT && !principal_sees(&request->principal, owner)) {
        job_done(job);
        presence = CATALOG_ABSENT;
    }
    if (presence == CATALOG_PRESENT) return true;
    if (presence == CATALOG_ABSENT) {
        problem_set(&problem, PROBLEM_NO_SUCH_JOB, "there is no job %.40s", id);
    } else {
        char at[JOB_TIME_BYTES];
        problem_set(&problem, PROBLEM_JOB_GONE, "the job %.40s is gone: %s", id, tombstone.reason);
        problem_add_text(&problem, "reason", tombstone.reason);
        problem_add_text(&problem, "at", job_time_text(tombstone.at_ms, at));
    }
    response_problem(response, &problem);
    return false;
}

void handlers_document_response(char *text, uint64_t sequence, int status, struct response *response) {
    response_text(response, status, "application/json", text);
    response_header(response, "ETag", "\"%llu\"", (unsigned long long)sequence);
    response_header(response, "Cache-Control", "no-cache");
}

void handlers_job_response(struct service *service, const struct job *job, int status, struct response *response) {
    struct job_document document = service_document(service, job);
    handlers_document_response(job_encode(&document), job->sequence, status, response);
    if (!job_ended(job->state)) response_header(response, "Retry-After", "1");
}

void handlers_applied_wait(const struct request *request, int64_t max_ms, struct response *response) {
    int64_t wait_ms = request_prefer_wait_ms(request, max_ms);
    if (wait_ms >= 0) response_header(response, "Preference-Applied", "wait=%lld", (long long)(wait_ms / 1000));
}

bool handlers_admit_match(const struct request *request, const char *etag, struct response *response) {
    if (request_match(request, etag)) return true;
    response_refuse(response, PROBLEM_PRECONDITION_FAILED, "the current ETag is %s, which If-Match does not name",
                    etag ? etag : "none");
    return false;
}

void handlers_cache_status(bool hit, struct response *response) {
    response_header(response, "Cache-Status", hit ? "whittled; hit" : "whittled; fwd=miss");
}
