/* Jobs: create, list, read, delete, follow.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/job_json.h"
#include "api/links.h"
#include "core/base/clock.h"
#include "server/base/log.h"
#include "server/base/wall_clock.h"
#include "server/handlers/event_stream.h"
#include "server/handlers/handlers.h"
#include "server/handlers/keys.h"

enum { CANCEL_LOOK_MS = 1000 };

/* ------------------------------------------------------------------------------------------------ wait */

/* Whether the client still waits for the job's end, which hasn't come. */
static bool may_wait(const struct request *request, const struct job *job) {
    const struct request_wait *wait = &request->wait;
    bool is_cut_short = wait->calls && (wait->why == CHANGE_FEED_HANGUP || wait->why == CHANGE_FEED_CLOSED);
    return !job_ended(job->state) && wait->end_ms >= 0 && !is_cut_short && clock_ms() < wait->end_ms;
}

/* ------------------------------------------------------------------------------------------------ create */

static const char *const create_names[] = {"label", "priority", "webhook", NULL};

/* Reads parameters and label from the query. */
static bool read_create(const struct request *request, struct job *job, struct response *response) {
    struct problem problem;
    bool ok = query_decode_params(request->query, request->query_count, create_names, &job->params, &problem) &&
              handlers_read_preferences(request, job, &problem);
    if (!ok) response_problem(response, &problem);
    return ok;
}

static bool admit_job(struct service *service, struct request *request, struct response *response) {
    struct job job = {0};
    return read_create(request, &job, response) && handlers_read_webhook(service, request, &job, response) &&
           handlers_admit_body(service, request, BODY_CLOUD | BODY_FORM | BODY_JSON, create_names, &job.params,
                               response);
}

static void locate(const char *id, struct response *response) {
    response_header(response, "Location", "%s/v1/jobs/%s", links_base(), id);
}

/* The first call: submits, or finds what the same request made before.  false: the response is there. */
static bool create(struct service *service, struct request *request, struct response *response) {
    struct request_wait *wait = &request->wait;
    struct job job = {0};
    struct catalog_reply before = {0};
    bool created = handlers_end_body(request, response) && read_create(request, &job, response) &&
                   handlers_read_webhook(service, request, &job, response) &&
                   handlers_submit(service, request, &job, &before, response);
    bool replayed = created && before.reply;
    memcpy(wait->id, job.id, sizeof wait->id);
    wait->state = (int)job.state; /* successful where an earlier job serves */
    handlers_begin_wait(service, request);
    if (replayed) handlers_replay(&before, response);
    if (replayed && response->status == 201) locate(job.id, response);
    catalog_reply_done(&before);
    job_done(&job);
    return created && !replayed;
}

/* With the job as it is when it has ended, or when the client waits no longer for that. */
static void create_job(struct service *service, struct request *request, struct response *response) {
    struct request_wait *wait = &request->wait;
    struct job job;
    if (!wait->calls && !create(service, request, response)) return;
    wait->seen = change_feed_now(service->feed);
    if (!handlers_read_job(service, request, wait->id, &job, response)) {
        job_done(&job);
        return;
    }
    if (may_wait(request, &job)) {
        response->kind = RESPONSE_WAIT;
        wait->deadline_ms = wait->end_ms;
    } else {
        handlers_job_response(service, &job, 201, response);
        handlers_keep_reply(service, request, response);
        handlers_cache_status(wait->state == JOB_SUCCESSFUL, response);
        handlers_applied_wait(request, service->config->wait_max_ms, response);
        locate(job.id, response);
    }
    job_done(&job);
}

const struct handler handlers_create_job = {.admit = admit_job, .run = create_job};

/* The same for a cloud that is here: the path names it, and a document says all else. */
static bool admit_cloud_job(struct service *service, struct request *request, struct response *response) {
    if (!handlers_takes_no_query(request, response)) return false;
    if (catalog_cloud_id_valid(request->match.capture[0]))
        return handlers_admit_body(service, request, BODY_JSON, create_names, NULL, response);
    response_refuse(response, PROBLEM_NO_SUCH_CLOUD, "there is no cloud %.64s", request->match.capture[0]);
    return false;
}

const struct handler handlers_create_cloud_job = {.admit = admit_cloud_job, .run = create_job};

/* ------------------------------------------------------------------------------------------------ list */

static const char *const list_names[] = {"status", "label", "batch", "limit", "after", NULL};

static bool read_filter(const struct request *request, struct catalog_filter *filter, size_t *limit,
                        struct response *response) {
    struct handlers_page page;
    if (!handlers_read_page(request, list_names, job_id_valid, "the id of a job", &page, response)) return false;
    const char *state = query_find(request->query, request->query_count, "status");
    filter->label = query_find(request->query, request->query_count, "label");
    filter->batch = query_find(request->query, request->query_count, "batch");
    filter->after = page.after;
    filter->by_state = state != NULL;
    *limit = page.limit;
    if (filter->batch && !job_id_valid(filter->batch)) {
        response_invalid(response, "batch", filter->batch, "the id of a batch");
        return false;
    }
    if (!state || job_state_from_name(state, &filter->state)) return true;
    response_invalid(response, "status", state, "accepted, running, successful, failed or dismissed");
    return false;
}

/* Writes text into a link, with what isn't plain as %XX. */
static void put_escaped(char *to, size_t bytes, const char *text) {
    size_t used = 0;
    for (; *text && used + 4 < bytes; text++) {
        bool plain = (*text >= 'a' && *text <= 'z') || (*text >= 'A' && *text <= 'Z') ||
                     (*text >= '0' && *text <= '9') || strchr("-_.~", *text);
        used += (size_t)snprintf(to + used, bytes - used, plain ? "%c" : "%%%02X", (unsigned char)*text);
    }
    to[used] = 0;
}

static void link_next(const struct catalog_filter *filter, size_t limit, const char *last, struct response *response) {
    char label[3 * JOB_LABEL_BYTES] = "", link[RESPONSE_HEADER_BYTES];
    if (filter->label) put_escaped(label, sizeof label, filter->label);
    int n = snprintf(link, sizeof link, "<%s/v1/jobs?limit=%zu&after=%s%s%s%s%s%s%s>; rel=\"next\"", links_base(),
                     limit, last, filter->by_state ? "&status=" : "",
                     filter->by_state ? job_state_name(filter->state) : "", filter->label ? "&label=" : "", label,
                     filter->batch ? "&batch=" : "", filter->batch ? filter->batch : "");
    if (n > 0 && (size_t)n < sizeof link) response_header(response, "Link", "%s", link);
}

/* One more than asked for is read, to know whether there is a next page. */
static void list_jobs(struct service *service, struct request *request, struct response *response) {
    struct catalog_filter filter = {0};
    struct error error = {0};
    size_t limit, count = 0;
    if (!read_filter(request, &filter, &limit, response)) return;
    if (!(request->principal.scopes & ROUTES_ADMIN)) filter.principal = request->principal.name;
    struct job *jobs = calloc(limit + 1, sizeof *jobs);
    struct job_document *documents = calloc(limit + 1, sizeof *documents);
    enum status status = jobs && documents ? STATUS_OK : error_set(&error, STATUS_NO_MEMORY, "jobs", "no memory");
    if (status == STATUS_OK) status = catalog_list(service->catalog, &filter, jobs, limit + 1, &count, &error);
    if (status == STATUS_OK) {
        size_t shown = count > limit ? limit : count;
        for (size_t i = 0; i < shown; i++) documents[i] = service_document(service, &jobs[i]);
        response_text(response, 200, "application/json", job_list_encode(documents, shown));
        response_header(response, "Cache-Control", "no-cache");
        if (count > limit) link_next(&filter, limit, jobs[limit - 1].id, response);
    } else {
        response_error(response, &error);
    }
    for (size_t i = 0; i < count; i++) job_done(&jobs[i]);
    free(jobs);
    free(documents);
}

const struct handler handlers_list_jobs = {.run = list_jobs};

/* ------------------------------------------------------------------------------------------------ read */

/* Whether what the client waits for has not come: the job's end or, with If-None-Match, a change of what it names. */
static bool wants_to_wait(const struct request *request, const struct job *job, const char *etag) {
    bool is_unchanged = !request->header[HEADER_IF_NONE_MATCH] || request_none_match(request, etag);
    return may_wait(request, job) && is_unchanged && request_match(request, etag);
}

/* Makes a 304 of the document's 200 where the client has it already. */
static void leave_out_known(const struct request *request, const char *etag, struct response *response) {
    uint64_t bytes = response->text_bytes;
    if (response->status != 200 || !request_none_match(request, etag)) return;
    response_done(response);
    response_unchanged(response, etag, "no-cache", bytes);
}

static void answer_job(struct service *service, uint64_t since, const struct job *job, struct response *response) {
    handlers_job_response(service, job, 200, response);
    if (job_ended(job->state) && response->status == 200)
        job_cache_keep(service->job_cache, since, job, response->text);
}

static bool job_at_hand(struct service *service, struct request *request, struct response *response) {
    char owner[JOB_PRINCIPAL_BYTES], etag[32];
    uint64_t sequence;
    char *text =
        request->query_count ? NULL : job_cache_find(service->job_cache, request->match.capture[0], owner, &sequence);
    if (!text || !principal_sees(&request->principal, owner)) {
        free(text);
        return false;
    }
    snprintf(etag, sizeof etag, "\"%llu\"", (unsigned long long)sequence);
    handlers_document_response(text, sequence, 200, response);
    leave_out_known(request, etag, response);
    handlers_applied_wait(request, service->config->wait_max_ms, response);
    return true;
}

static void get_job(struct service *service, struct request *request, struct response *response) {
    struct request_wait *wait = &request->wait;
    struct job job;
    if (!handlers_takes_no_query(request, response)) return;
    wait->seen = change_feed_now(service->feed);
    uint64_t since = job_cache_now(service->job_cache);
    if (handlers_read_job(service, request, request->match.capture[0], &job, response)) {
        char etag[32];
        snprintf(etag, sizeof etag, "\"%llu\"", (unsigned long long)job.sequence);
        if (!wait->calls) {
            handlers_begin_wait(service, request);
            memcpy(wait->id, job.id, sizeof wait->id);
        }
        if (wants_to_wait(request, &job, etag)) {
            response->kind = RESPONSE_WAIT;
            wait->deadline_ms = wait->end_ms;
        } else {
            answer_job(service, since, &job, response);
            leave_out_known(request, etag, response);
            handlers_applied_wait(request, service->config->wait_max_ms, response);
        }
    }
    job_done(&job);
}

const struct handler handlers_get_job = {.run = get_job, .at_hand = job_at_hand};

/* ------------------------------------------------------------------------------------------------ delete */

enum status handlers_withdraw(struct service *service, struct job *job, bool *changed, struct error *error) {
    wall_clock_hold();
    job->expires_ms = job_now_ms() + service->config->retention_ms;
    enum status status = catalog_finish(service->catalog, JOB_WITHDRAW, job, changed, error);
    wall_clock_release();
    if (status == STATUS_OK && *changed) {
        log_line(LOG_INFO, "job=%s %s -> dismissed", job->id, job_state_name(job->state));
        if (job->tiles) store_tiles_delete(service->store, job->id); /* and again by who runs a task of it */
    }
    return status;
}

/* Tries accepted -> dismissed; it may have begun to run by now. */
static bool dismiss_waiting(struct service *service, struct job *job, bool *changed, struct response *response) {
    struct error error = {0};
    if (handlers_withdraw(service, job, changed, &error) == STATUS_OK) return true;
    response_error(response, &error);
    return false;
}

/* Ends the process of a running job, and waits until its end is recorded: not for ever, the disk may be full.  One that
 * runs here is told first: a database that is busy for seconds doesn't let it come to its own end meanwhile. */
static void dismiss_running(struct service *service, struct request *request, const struct job *job,
                            struct response *response) {
    struct request_wait *wait = &request->wait;
    struct error error = {0};
    if (!wait->calls) wait->end_ms = clock_ms() + service->config->wait_max_ms;
    if (service->supervisor) service->runner->cancel(service->supervisor, job->id);
    if (catalog_cancel(service->catalog, job->id, &error) != STATUS_OK) {
        response_error(response, &error);
        return;
    }
    if (clock_ms() >= wait->end_ms) {
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "the job was told to end, but its end can't be recorded yet");
        return;
    }
    response->kind = RESPONSE_WAIT;
    memcpy(wait->id, job->id, sizeof wait->id);
    wait->deadline_ms = clock_ms() + CANCEL_LOOK_MS;
}

/* Whether If-Match allows it; the first call asks, before anything is done. */
static bool may_delete(const struct request *request, const struct job *job, struct response *response) {
    char etag[32];
    snprintf(etag, sizeof etag, "\"%llu\"", (unsigned long long)job->sequence);
    return request->wait.calls || handlers_admit_match(request, etag, response);
}

/* The first call decides what DELETE means; later ones wait until the job has ended.  One that became successful before
 * it could be told to end is deleted instead: whoever sent DELETE is never told of an end that didn't come. */
static void delete_job(struct service *service, struct request *request, struct response *response) {
    const char *id = request->match.capture[0];
    struct error error = {0};
    struct job job;
    bool changed = false;
    if (!handlers_takes_no_query(request, response)) return;
    request->wait.seen = change_feed_now(service->feed);
    bool found = handlers_read_job(service, request, id, &job, response) && may_delete(request, &job, response);
    bool waits = job.state == JOB_ACCEPTED || (job.state == JOB_RUNNING && job.tiles); /* nobody runs all of it */
    if (found && waits) {
        found = dismiss_waiting(service, &job, &changed, response);
        job_done(&job);
        found = found && handlers_read_job(service, request, id, &job, response) &&
                (changed || may_delete(request, &job, response));
    } else if (found && (request->wait.calls == 0 ? job_ended(job.state) : job.state == JOB_SUCCESSFUL) &&
               service_delete(service, &job, "deleted", &changed, &error) != STATUS_OK) {
        response_error(response, &error);
        found = false;
    }
    if (found && job.state == JOB_RUNNING && request->wait.why != CHANGE_FEED_CLOSED)
        dismiss_running(service, request, &job, response);
    else if (found)
        handlers_job_response(service, &job, 200, response);
    job_done(&job);
}

const struct handler handlers_delete_job = {.run = delete_job};

/* ------------------------------------------------------------------------------------------------ events */

struct followed_job {
    struct service *service;
    const struct job *job;
};

static char *job_event(void *of) {
    const struct followed_job *followed = of;
    struct job_document document = service_document(followed->service, followed->job);
    return job_event_encode(&document);
}

static void put_outputs(FILE *out, void *of) {
    const struct job *job = ((const struct followed_job *)of)->job;
    for (size_t i = 0; i < job->output_count; i++) {
        char data[JOB_ID_BYTES + LINKS_BASE_BYTES + 2 * JOB_OUTPUT_NAME_BYTES + 48];
        snprintf(data, sizeof data, "{\"name\":\"%s\",\"href\":\"%s/v1/jobs/%s/outputs/%s\"}", job->output[i].name,
                 links_base(), job->id, job->output[i].name);
        event_put(out, "output", job->sequence, data);
    }
}

static void get_events(struct service *service, struct request *request, struct response *response) {
    struct job job;
    bool streaming = request->wait.calls > 0;
    if (!streaming && !handlers_takes_no_query(request, response)) return;
    request->wait.seen = change_feed_now(service->feed);
    if (handlers_read_job(service, request, request->match.capture[0], &job, response)) {
        struct followed_job followed = {service, &job};
        const struct event_source source = {.sequence = job.sequence,
                                            .state = (int)job.state,
                                            .ended = job_ended(job.state),
                                            .job_id = job.id,
                                            .data = job_event,
                                            .before_end = put_outputs,
                                            .of = &followed};
        event_stream_answer(request, &source, response);
    } else if (streaming) {
        event_stream_gone(response);
    }
    job_done(&job);
}

const struct handler handlers_get_events = {.run = get_events};
