/* Batches: jobs of several clouds that come together; create, list, read, delete, follow.
 *
 * Whoever waits for a batch waits for the first of its jobs that hasn't ended, and looks at all of them when that one
 * has changed: the last end of all is one of these.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/batch_json.h"
#include "api/links.h"
#include "core/base/clock.h"
#include "server/base/log.h"
#include "server/handlers/event_stream.h"
#include "server/handlers/handlers.h"
#include "server/handlers/keys.h"

enum { BATCH_LOOK_MS = 1000 };

/* ------------------------------------------------------------------------------------------------ a batch */

/* Reads the batch of this id; false: there is none that the request's principal may see, and the response says so.  The
 * batch is the caller's, to catalog_batch_done, either way. */
static bool read_batch(struct service *service, const struct request *request, const char *id,
                       struct catalog_batch *batch, struct response *response) {
    struct error error = {0};
    bool found = false;
    memset(batch, 0, sizeof *batch);
    if (job_id_valid(id) && catalog_get_batch(service->catalog, id, batch, &found, &error) != STATUS_OK) {
        response_error(response, &error);
        return false;
    }
    if (found && principal_sees(&request->principal, batch->principal)) return true;
    response_refuse(response, PROBLEM_NO_SUCH_BATCH, "there is no batch %.40s", id);
    return false;
}

/* The first of its jobs that hasn't ended; NULL: all have. */
static const struct catalog_batch_job *first_open(const struct catalog_batch *batch) {
    for (size_t i = 0; i < batch->job_count; i++)
        if (!job_ended(batch->job[i].state)) return &batch->job[i];
    return NULL;
}

/* Grows with every change of any of its jobs, but where one is deleted. */
static uint64_t batch_sequence(const struct catalog_batch *batch) {
    uint64_t sum = 0;
    for (size_t i = 0; i < batch->job_count; i++) sum += batch->job[i].sequence;
    return sum;
}

enum { BATCH_TAG_BYTES = 48 };
static const char *batch_tag(const struct catalog_batch *batch, char tag[BATCH_TAG_BYTES]) {
    snprintf(tag, BATCH_TAG_BYTES, "\"%llu.%zu\"", (unsigned long long)batch_sequence(batch), batch->job_count);
    return tag;
}

static void answer_batch(const struct service *service, const struct request *request,
                         const struct catalog_batch *batch, int status, struct response *response) {
    char tag[BATCH_TAG_BYTES], *text = service_batch_text(batch, true);
    uint64_t bytes = text ? strlen(text) : 0;
    batch_tag(batch, tag);
    if (status == 200 && request_none_match(request, tag)) {
        free(text);
        response_unchanged(response, tag, "no-cache", bytes);
    } else {
        response_text(response, status, "application/json", text);
        response_header(response, "ETag", "%s", tag);
        response_header(response, "Cache-Control", "no-cache");
        if (first_open(batch)) response_header(response, "Retry-After", "1");
    }
    handlers_applied_wait(request, service->config->wait_max_ms, response);
}

/* The request is answered when the batch may have changed, at this time at the latest. */
static void wait_for_batch(struct request *request, const struct catalog_batch_job *open, int64_t deadline_ms,
                           struct response *response) {
    response->kind = RESPONSE_WAIT;
    memcpy(request->wait.id, open->id, sizeof request->wait.id);
    request->wait.deadline_ms = deadline_ms;
}

/* Whether the client still waits for an end that hasn't come. */
static bool batch_may_wait(const struct request *request) {
    const struct request_wait *wait = &request->wait;
    bool is_cut_short = wait->calls && (wait->why == CHANGE_FEED_HANGUP || wait->why == CHANGE_FEED_CLOSED);
    return wait->end_ms >= 0 && !is_cut_short && clock_ms() < wait->end_ms;
}

/* ------------------------------------------------------------------------------------------------ create */

static const char *const batch_names[] = {"clouds", "label", "priority", "webhook", NULL};

static bool admit_batch(struct service *service, struct request *request, struct response *response) {
    return handlers_takes_no_query(request, response) &&
           handlers_admit_body(service, request, BODY_JSON, batch_names, NULL, response);
}

/* What all jobs have in common, of the query. */
static bool read_common(const struct service *service, const struct request *request, struct job *common,
                        struct response *response) {
    struct problem problem;
    if (!query_decode_params(request->query, request->query_count, batch_names + 1, &common->params, &problem) ||
        !handlers_read_preferences(request, common, &problem)) {
        response_problem(response, &problem);
        return false;
    }
    memcpy(common->principal, request->principal.name, sizeof common->principal);
    return handlers_read_webhook(service, request, common, response);
}

/* The job of the i-th cloud; a problem says which cloud it is of. */
static bool make_job(struct service *service, const struct request *request, const char *cloud, size_t i,
                     const struct job *common, struct job *job, struct response *response) {
    struct catalog_cloud record;
    struct problem problem;
    *job = *common;
    job->webhook = NULL;
    if (!handlers_read_cloud(service, request, cloud, &record, response)) {
        catalog_cloud_done(&record);
        return false;
    }
    memcpy(job->cloud, record.sha256, sizeof job->cloud);
    bool ok = handlers_foresee(service, request, &record, job, &problem);
    catalog_cloud_done(&record);
    if (ok) return true;
    char detail[sizeof problem.detail];
    snprintf(detail, sizeof detail, "clouds[%zu]: %.480s", i, problem.detail);
    memcpy(problem.detail, detail, sizeof detail);
    response_problem(response, &problem);
    return false;
}

/* Names of all clouds in one text, for the request's fingerprint; returns new, NULL: no memory. */
static char *all_clouds(const struct job *jobs, size_t count) {
    char *text = NULL;
    size_t bytes;
    FILE *out = open_memstream(&text, &bytes);
    for (size_t i = 0; out && i < count; i++) fprintf(out, "%s\n", jobs[i].cloud);
    if (out && fclose(out) == 0) return text;
    free(text);
    return NULL;
}

/* Whether the same request came before under its key: then batch->id is set.  false: the response says why. */
static bool batch_came_before(struct service *service, const struct request *request, const struct job *common,
                              const struct job *jobs, struct catalog_batch *batch, struct job_key *key,
                              struct catalog_reply *before, struct response *response) {
    bool found = false;
    if (!request->claim.held) return true;
    char *clouds = all_clouds(jobs, batch->size);
    bool ok = clouds && handlers_fingerprint(request, common, clouds, key);
    free(clouds);
    if (!ok) {
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "no memory");
        return false;
    }
    if (!handlers_find_reply(service, request, key, before, &found, response)) return false;
    if (found) snprintf(batch->id, sizeof batch->id, "%.36s", before->made);
    if (!found) batch->key = key;
    return true;
}

/* Submits, or finds what the same request made before.  false: the response says why not. */
static bool submit_batch(struct service *service, struct request *request, struct catalog_batch *batch,
                         struct catalog_reply *before, struct response *response) {
    struct job common = {0};
    struct job_key key;
    struct error error = {0};
    if (!handlers_end_body(request, response) || !read_common(service, request, &common, response)) return false;
    batch->size = body_joined(request->body) + 1;
    batch->webhook = common.webhook;
    memcpy(batch->principal, common.principal, sizeof batch->principal);
    memcpy(batch->label, common.label, sizeof batch->label);
    struct job *jobs = calloc(batch->size, sizeof *jobs);
    bool ok = jobs != NULL;
    if (!ok) response_refuse(response, PROBLEM_INTERNAL_ERROR, "no memory");
    for (size_t i = 0; ok && i < batch->size; i++) {
        const char *cloud = i ? body_joined_cloud(request->body, i - 1) : body_input(request->body);
        ok = make_job(service, request, cloud, i, &common, &jobs[i], response);
    }
    ok = ok && batch_came_before(service, request, &common, jobs, batch, &key, before, response);
    if (ok && !batch->id[0]) {
        enum status status = service_submit_batch(service, batch, jobs, handlers_wants_fresh(request), &error);
        ok = handlers_submitted(status, &error, response);
    }
    for (size_t i = 0; jobs && i < batch->size; i++) job_done(&jobs[i]);
    free(jobs);
    return ok;
}

/* The id of the batch is kept in wait.batch between calls. */
static void create_batch(struct service *service, struct request *request, struct response *response) {
    struct request_wait *wait = &request->wait;
    struct catalog_batch batch = {0};
    if (!wait->calls) {
        struct catalog_reply before = {0};
        bool ok = submit_batch(service, request, &batch, &before, response);
        bool replayed = ok && before.reply;
        memcpy(wait->batch, batch.id, sizeof wait->batch);
        handlers_begin_wait(service, request);
        if (replayed) handlers_replay(&before, response);
        if (replayed) response_header(response, "Location", "%s/v1/batches/%s", links_base(), batch.id);
        catalog_reply_done(&before);
        if (!ok || replayed) return;
    }
    wait->seen = change_feed_now(service->feed);
    if (read_batch(service, request, wait->batch, &batch, response)) {
        const struct catalog_batch_job *open = first_open(&batch);
        if (open && batch_may_wait(request)) {
            wait_for_batch(request, open, wait->end_ms, response);
        } else {
            answer_batch(service, request, &batch, 201, response);
            handlers_keep_reply(service, request, response);
            response_header(response, "Location", "%s/v1/batches/%s", links_base(), batch.id);
        }
    }
    catalog_batch_done(&batch);
}

const struct handler handlers_create_batch = {.admit = admit_batch, .run = create_batch};

/* ------------------------------------------------------------------------------------------------ list, read */

static void put_batches(const struct catalog_batch *batches, size_t count, size_t limit, struct response *response) {
    size_t shown = count > limit ? limit : count;
    char **texts = calloc(shown + 1, sizeof *texts);
    for (size_t i = 0; texts && i < shown; i++) texts[i] = service_batch_text(&batches[i], false);
    response_text(response, 200, "application/json", texts ? batch_list_encode(texts, shown) : NULL);
    response_header(response, "Cache-Control", "no-cache");
    if (count > limit)
        response_header(response, "Link", "<%s/v1/batches?limit=%zu&after=%s>; rel=\"next\"", links_base(), limit,
                        batches[limit - 1].id);
    for (size_t i = 0; texts && i < shown; i++) free(texts[i]);
    free(texts);
}

/* One more than asked for is read, to know whether there is a next page. */
static void list_batches(struct service *service, struct request *request, struct response *response) {
    static const char *const names[] = {"limit", "after", NULL};
    struct handlers_page page;
    struct error error = {0};
    size_t count = 0;
    if (!handlers_read_page(request, names, job_id_valid, "the id of a batch", &page, response)) return;
    const char *owner = request->principal.scopes & ROUTES_ADMIN ? NULL : request->principal.name;
    struct catalog_batch *batches = calloc(page.limit + 1, sizeof *batches);
    enum status status = batches ? STATUS_OK : error_set(&error, STATUS_NO_MEMORY, "batches", "no memory");
    if (status == STATUS_OK)
        status = catalog_list_batches(service->catalog, owner, page.after, batches, page.limit + 1, &count, &error);
    if (status == STATUS_OK)
        put_batches(batches, count, page.limit, response);
    else
        response_error(response, &error);
    for (size_t i = 0; i < count; i++) catalog_batch_done(&batches[i]);
    free(batches);
}

const struct handler handlers_list_batches = {.run = list_batches};

static void get_batch(struct service *service, struct request *request, struct response *response) {
    struct catalog_batch batch;
    char tag[BATCH_TAG_BYTES];
    if (!handlers_takes_no_query(request, response)) return;
    request->wait.seen = change_feed_now(service->feed);
    if (read_batch(service, request, request->match.capture[0], &batch, response)) {
        const struct catalog_batch_job *open = first_open(&batch);
        if (!request->wait.calls) handlers_begin_wait(service, request);
        batch_tag(&batch, tag);
        bool is_unchanged = !request->header[HEADER_IF_NONE_MATCH] || request_none_match(request, tag);
        if (open && is_unchanged && batch_may_wait(request) && request_match(request, tag))
            wait_for_batch(request, open, request->wait.end_ms, response);
        else
            answer_batch(service, request, &batch, 200, response);
    }
    catalog_batch_done(&batch);
}

const struct handler handlers_get_batch = {.run = get_batch};

/* ------------------------------------------------------------------------------------------------ delete */

/* Does with one of its jobs what DELETE means; a job that is gone is as it should be. */
static enum status end_one(struct service *service, const char *id, bool all_ended, struct error *error) {
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    bool changed = false;
    enum status status = catalog_get(service->catalog, id, &job, &presence, &tombstone, error);
    if (status != STATUS_OK || presence != CATALOG_PRESENT) return status;
    if (all_ended) {
        status = service_delete(service, &job, "deleted", &changed, error);
    } else if (job.state == JOB_ACCEPTED || (job.state == JOB_RUNNING && job.tiles)) {
        status = handlers_withdraw(service, &job, &changed, error);
    } else if (job.state == JOB_RUNNING) {
        changed = true;
    }
    if (status == STATUS_OK && !all_ended && (job.state == JOB_RUNNING || !changed) && !job.tiles &&
        !job_ended(job.state)) {
        if (service->supervisor) service->runner->cancel(service->supervisor, job.id);
        status = catalog_cancel(service->catalog, job.id, error);
    }
    job_done(&job);
    return status;
}

/* From the last to the first, so that none of those that wait begins while the others end. */
static enum status end_jobs(struct service *service, const struct catalog_batch *batch, bool all_ended,
                            struct error *error) {
    enum status status = STATUS_OK;
    for (size_t i = batch->job_count; status == STATUS_OK && i > 0; i--)
        if (all_ended || !job_ended(batch->job[i - 1].state))
            status = end_one(service, batch->job[i - 1].id, all_ended, error);
    return status;
}

/* Where a job hasn't ended, all are dismissed that haven't, and the answer comes when they have; else all are deleted.
 */
static void delete_batch(struct service *service, struct request *request, struct response *response) {
    struct request_wait *wait = &request->wait;
    struct catalog_batch batch;
    struct error error = {0};
    char tag[BATCH_TAG_BYTES];
    if (!handlers_takes_no_query(request, response)) return;
    wait->seen = change_feed_now(service->feed);
    bool found = read_batch(service, request, request->match.capture[0], &batch, response);
    found = found && (wait->calls || handlers_admit_match(request, batch_tag(&batch, tag), response));
    bool all_ended = found && !first_open(&batch);
    if (!wait->calls) wait->end_ms = clock_ms() + service->config->wait_max_ms;
    if (found && (!all_ended || !wait->calls) && end_jobs(service, &batch, all_ended, &error) != STATUS_OK) {
        response_error(response, &error);
        found = false;
    }
    if (found && !all_ended) { /* as it is now */
        catalog_batch_done(&batch);
        found = read_batch(service, request, request->match.capture[0], &batch, response);
    }
    const struct catalog_batch_job *open = found ? first_open(&batch) : NULL;
    if (open && clock_ms() >= wait->end_ms)
        response_refuse(response, PROBLEM_INTERNAL_ERROR,
                        "the jobs were told to end, but their end can't be recorded yet");
    else if (open && wait->why != CHANGE_FEED_CLOSED)
        wait_for_batch(request, open, clock_ms() + BATCH_LOOK_MS, response);
    else if (found)
        answer_batch(service, request, &batch, 200, response);
    catalog_batch_done(&batch);
}

const struct handler handlers_delete_batch = {.run = delete_batch};

/* ------------------------------------------------------------------------------------------------ events */

static char *batch_event(void *of) { return service_batch_text(of, false); }

static void get_batch_events(struct service *service, struct request *request, struct response *response) {
    struct catalog_batch batch;
    bool streaming = request->wait.calls > 0;
    if (!streaming && !handlers_takes_no_query(request, response)) return;
    request->wait.seen = change_feed_now(service->feed);
    if (read_batch(service, request, request->match.capture[0], &batch, response)) {
        const struct catalog_batch_job *open = first_open(&batch);
        const struct event_source source = {.sequence = batch_sequence(&batch),
                                            .state = catalog_batch_state(&batch),
                                            .ended = !open,
                                            .job_id = open ? open->id : batch.job[0].id,
                                            .data = batch_event,
                                            .of = &batch};
        event_stream_answer(request, &source, response);
    } else if (streaming) {
        event_stream_gone(response);
    }
    catalog_batch_done(&batch);
}

const struct handler handlers_get_batch_events = {.run = get_batch_events};
