/* Jobs: create, list, read, delete, follow.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/job_json.h"
#include "api/links.h"
#include "server/handlers.h"
#include "server/handlers_keys.h"
#include "server/log.h"
#include "server/post.h"
#include "server/supervisor.h"

enum { HEARTBEAT_MS = 15000, CANCEL_LOOK_MS = 1000 };

/* ------------------------------------------------------------------------------------------------ create */

static const char *const create_names[] = {"label", "priority", "webhook", NULL};

/* Reads parameters and label from the query. */
static bool read_create(const struct request *request, struct job *job, struct response *response) {
    struct problem problem;
    bool ok = query_decode_params(request->query, request->query_count, create_names, &job->params, &problem) &&
              handlers_read_wishes(request, job, &problem);
    if (!ok) response_problem(response, &problem);
    return ok;
}

/* Takes `webhook` from the query; borrowed there. */
static bool read_webhook(const struct service *service, const struct request *request, struct job *job,
                         struct response *response) {
    const char *url = query_find(request->query, request->query_count, "webhook"), *allowed = NULL;
    job->webhook = url;
    if (url && !service->config->webhooks)
        allowed = "nothing: webhooks are off here";
    else if (url && (strlen(url) >= JOB_WEBHOOK_BYTES || !post_url_valid(url)))
        allowed = "an http or https URL without user and password, up to 2047 bytes";
    if (!allowed) return true;
    response_invalid(response, "webhook", NULL, allowed);
    return false;
}

bool handlers_admit_job(struct service *service, struct request *request, struct response *response) {
    struct job job = {0};
    return read_create(request, &job, response) && read_webhook(service, request, &job, response) &&
           handlers_admit_body(service, request, BODY_CLOUD | BODY_FORM | BODY_JSON, create_names, &job.params,
                               response);
}

/* The job as it is now, or the reply that was given to the same request before. */
static void answer_created(struct service *service, const struct request *request, const struct job *job,
                           struct idempotency_record *before, struct response *response) {
    struct job stored = {0};
    if (before->reply) {
        handlers_replay(before, response);
    } else if (handlers_read_job(service, request, job->id, &stored, response)) {
        handlers_job_response(service, &stored, 201, response);
        handlers_keep_reply(service, request, response);
        handlers_cache_status(job->state == JOB_SUCCESSFUL, response);
    }
    if (response->status == 201) response_header(response, "Location", "%s/v1/jobs/%s", links_base(), job->id);
    job_done(&stored);
}

void handlers_create_job(struct service *service, struct request *request, struct response *response) {
    struct job job = {0};
    struct idempotency_record before = {0};
    if (handlers_end_body(request, response) && read_create(request, &job, response) &&
        read_webhook(service, request, &job, response) && handlers_submit(service, request, &job, &before, response))
        answer_created(service, request, &job, &before, response);
    idempotency_record_done(&before);
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ list */

static const char *const list_names[] = {"status", "label", "limit", "after", NULL};

static bool read_filter(const struct request *request, struct queue_filter *filter, size_t *limit,
                        struct response *response) {
    struct handlers_page page;
    if (!handlers_read_page(request, list_names, job_id_valid, "the id of a job", &page, response)) return false;
    const char *state = query_find(request->query, request->query_count, "status");
    filter->label = query_find(request->query, request->query_count, "label");
    filter->after = page.after;
    filter->by_state = state != NULL;
    *limit = page.limit;
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

static void link_next(const struct queue_filter *filter, size_t limit, const char *last, struct response *response) {
    char label[3 * JOB_LABEL_BYTES] = "", link[RESPONSE_HEADER_BYTES];
    if (filter->label) put_escaped(label, sizeof label, filter->label);
    int n = snprintf(link, sizeof link, "<%s/v1/jobs?limit=%zu&after=%s%s%s%s%s>; rel=\"next\"", links_base(), limit,
                     last, filter->by_state ? "&status=" : "", filter->by_state ? job_state_name(filter->state) : "",
                     filter->label ? "&label=" : "", label);
    if (n > 0 && (size_t)n < sizeof link) response_header(response, "Link", "%s", link);
}

/* One more than asked for is read, to know whether there is a next page. */
void handlers_list_jobs(struct service *service, struct request *request, struct response *response) {
    struct queue_filter filter = {0};
    struct error error = {0};
    size_t limit, count = 0;
    if (!read_filter(request, &filter, &limit, response)) return;
    if (!(request->principal.scopes & ROUTES_ADMIN)) filter.principal = request->principal.name;
    struct job *jobs = calloc(limit + 1, sizeof *jobs);
    struct job_document *documents = calloc(limit + 1, sizeof *documents);
    enum status status = jobs && documents ? STATUS_OK : error_set(&error, STATUS_NO_MEMORY, "jobs", "no memory");
    if (status == STATUS_OK) status = queue_list(service->queue, &filter, jobs, limit + 1, &count, &error);
    if (status == STATUS_OK) {
        size_t shown = count > limit ? limit : count;
        for (size_t i = 0; i < shown; i++) documents[i] = handlers_document(service, &jobs[i]);
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

/* ------------------------------------------------------------------------------------------------ read */

/* Whether the client wants to wait for a change that has not come: only while the job can still change. */
static bool wants_to_wait(const struct request *request, const struct job *job, const char *etag) {
    const struct request_wait *wait = &request->wait;
    if (job_ended(job->state) || wait->end_ms < 0) return false;
    if (wait->calls && (wait->why == EVENTS_HANGUP || wait->why == EVENTS_CLOSED)) return false;
    if (events_clock_ms() >= wait->end_ms) return false;
    if (request->header[HEADER_IF_NONE_MATCH]) return request_none_match(request, etag);
    return wait->sequence == job->sequence;
}

static void answer_unchanged(const char *etag, struct response *response) {
    response->status = 304;
    response_header(response, "ETag", "%s", etag);
}

static void answer_job(struct service *service, uint64_t since, const struct job *job, struct response *response) {
    handlers_job_response(service, job, 200, response);
    if (job_ended(job->state) && response->status == 200)
        documents_keep(service->documents, since, job, response->text);
}

bool handlers_job_at_hand(struct service *service, struct request *request, struct response *response) {
    char owner[JOB_PRINCIPAL_BYTES], etag[32];
    uint64_t sequence;
    char *text =
        request->query_count ? NULL : documents_find(service->documents, request->match.capture[0], owner, &sequence);
    if (!text || !principal_sees(&request->principal, owner)) {
        free(text);
        return false;
    }
    snprintf(etag, sizeof etag, "\"%llu\"", (unsigned long long)sequence);
    if (request_none_match(request, etag)) {
        free(text);
        answer_unchanged(etag, response);
    } else {
        handlers_document_response(text, sequence, 200, response);
    }
    return true;
}

void handlers_get_job(struct service *service, struct request *request, struct response *response) {
    struct request_wait *wait = &request->wait;
    struct job job;
    if (!handlers_takes_no_query(request, response)) return;
    wait->seen = events_now(service->events);
    uint64_t since = documents_now(service->documents);
    if (handlers_read_job(service, request, request->match.capture[0], &job, response)) {
        char etag[32];
        snprintf(etag, sizeof etag, "\"%llu\"", (unsigned long long)job.sequence);
        if (!wait->calls) {
            int64_t prefer_ms = request_prefer_wait_ms(request, service->config->wait_max_ms);
            wait->end_ms = prefer_ms < 0 ? -1 : events_clock_ms() + prefer_ms;
            wait->sequence = job.sequence;
            memcpy(wait->id, job.id, sizeof wait->id);
        }
        if (wants_to_wait(request, &job, etag)) {
            response->kind = RESPONSE_WAIT;
            wait->deadline_ms = wait->end_ms;
        } else if (request_none_match(request, etag)) {
            answer_unchanged(etag, response);
        } else {
            answer_job(service, since, &job, response);
        }
    }
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ delete */

enum status handlers_withdraw(struct service *service, struct job *job, bool *changed, struct error *error) {
    job->expires_ms = job_now_ms() + service->config->retention_ms;
    enum status status = queue_finish(service->queue, JOB_WITHDRAW, job, changed, error);
    if (status == STATUS_OK && *changed) {
        log_line(LOG_INFO, "job=%s accepted -> dismissed", job->id);
        events_publish(service->events, job->id);
    }
    return status;
}

/* Tries accepted -> dismissed; it may have begun to run by now. */
static bool dismiss_waiting(struct service *service, struct job *job, struct response *response) {
    struct error error = {0};
    bool changed;
    if (handlers_withdraw(service, job, &changed, &error) == STATUS_OK) return true;
    response_error(response, &error);
    return false;
}

/* Ends the process of a running job, and waits until its end is recorded: not for ever, the disk may be full. */
static void dismiss_running(struct service *service, struct request *request, const struct job *job,
                            struct response *response) {
    struct request_wait *wait = &request->wait;
    if (!wait->calls) wait->end_ms = events_clock_ms() + service->config->wait_max_ms;
    supervisor_cancel(service->supervisor, job->id);
    if (events_clock_ms() >= wait->end_ms) {
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "the job is told to end, but its end can't be recorded yet");
        return;
    }
    response->kind = RESPONSE_WAIT;
    memcpy(wait->id, job->id, sizeof wait->id);
    wait->deadline_ms = events_clock_ms() + CANCEL_LOOK_MS;
}

/* The first call decides what DELETE means; later ones only wait until the job has ended. */
void handlers_delete_job(struct service *service, struct request *request, struct response *response) {
    const char *id = request->match.capture[0];
    struct error error = {0};
    struct job job;
    bool changed = false;
    if (!handlers_takes_no_query(request, response)) return;
    request->wait.seen = events_now(service->events);
    bool found = handlers_read_job(service, request, id, &job, response);
    if (found && job.state == JOB_ACCEPTED) {
        found = dismiss_waiting(service, &job, response);
        job_done(&job);
        found = found && handlers_read_job(service, request, id, &job, response);
    } else if (found && job_ended(job.state) && request->wait.calls == 0 &&
               service_delete(service, &job, "deleted", &changed, &error) != STATUS_OK) {
        response_error(response, &error);
        found = false;
    }
    if (found && job.state == JOB_RUNNING && request->wait.why != EVENTS_CLOSED)
        dismiss_running(service, request, &job, response);
    else if (found)
        handlers_job_response(service, &job, 200, response);
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ events */

static void put_event(struct service *service, FILE *out, const char *name, const struct job *job) {
    struct job_document document = handlers_document(service, job);
    char *data = job_event_encode(&document);
    fprintf(out, "event: %s\nid: %llu\ndata: %s\n\n", name, (unsigned long long)job->sequence, data ? data : "{}");
    free(data);
}

static void put_outputs(FILE *out, const struct job *job) {
    for (size_t i = 0; i < job->output_count; i++)
        fprintf(out, "event: output\nid: %llu\ndata: {\"name\":\"%s\",\"href\":\"%s/v1/jobs/%s/outputs/%s\"}\n\n",
                (unsigned long long)job->sequence, job->output[i].name, links_base(), job->id, job->output[i].name);
}

/* What is new since the last piece, as events; a comment where nothing is. */
static void put_news(struct service *service, FILE *out, struct request_wait *wait, const struct job *job) {
    bool first = wait->calls == 0, state_changed = first || wait->state != (int)job->state;
    if (state_changed) put_event(service, out, "status", job);
    if (!state_changed && wait->sequence != job->sequence) put_event(service, out, "progress", job);
    if (job_ended(job->state)) {
        put_outputs(out, job);
        put_event(service, out, "end", job);
    } else if (!state_changed && wait->why == EVENTS_DEADLINE) {
        fputs(": still here\n\n", out);
    }
    wait->state = (int)job->state;
    wait->sequence = job->sequence;
}

static void stream_news(struct service *service, struct request_wait *wait, const struct job *job,
                        struct response *response) {
    FILE *out = open_memstream(&response->text, &response->text_bytes);
    if (out) put_news(service, out, wait, job);
    bool written = out && fclose(out) == 0;
    response->kind = RESPONSE_STREAM;
    response->last = !written || job_ended(job->state) ||
                     (wait->calls && (wait->why == EVENTS_HANGUP || wait->why == EVENTS_CLOSED));
    wait->deadline_ms = events_clock_ms() + HEARTBEAT_MS;
    memcpy(wait->id, job->id, sizeof wait->id);
}

/* Whether the client has seen the last event that there will be. */
static bool has_seen_the_end(const struct request *request, const struct job *job) {
    const char *last = request->header[HEADER_LAST_EVENT_ID];
    char sequence[24];
    snprintf(sequence, sizeof sequence, "%llu", (unsigned long long)job->sequence);
    return job_ended(job->state) && last && strcmp(last, sequence) == 0;
}

/* The current state comes first: it is all that a client that was away has missed.  One that has seen the end is told
 * not to come again, which is what 204 means to an EventSource. */
void handlers_get_events(struct service *service, struct request *request, struct response *response) {
    struct job job;
    bool streaming = request->wait.calls > 0;
    if (!streaming && !handlers_takes_no_query(request, response)) return;
    request->wait.seen = events_now(service->events);
    if (handlers_read_job(service, request, request->match.capture[0], &job, response)) {
        response_header(response, "Cache-Control", "no-cache");
        if (!streaming && has_seen_the_end(request, &job)) {
            response->status = 204;
        } else {
            stream_news(service, &request->wait, &job, response);
            response_header(response, "Content-Type", "text/event-stream");
            response_header(response, "X-Accel-Buffering", "no");
        }
    } else if (streaming) { /* deleted while it was followed */
        response_done(response);
        response->kind = RESPONSE_STREAM;
        response->last = true;
    }
    job_done(&job);
}
