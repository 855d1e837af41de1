/* The one-shot: a cloud in, one output back.
 *
 * It is a job like any other, and a wait for its end.  The client gets bytes of an output with 200 or a problem, never
 * a 202 that it didn't ask for: that would land in its file.  A job whose client has hung up is dismissed
 * (--oneshot-abandon).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "api/codecs/report_read.h"
#include "api/links.h"
#include "core/base/clock.h"
#include "server/base/log.h"
#include "server/handlers/handlers.h"
#include "server/handlers/outputs.h"

enum { ALLOWED_BYTES = 512 };

static const char *const own_names[] = {"label", "priority", "output", NULL};

/* What names the one output: `output`, or `outputs` as a job has it; NULL: nothing does.  *times: how often. */
static const char *name_of_output(const struct request *request, size_t *times) {
    const char *value = NULL;
    *times = 0;
    for (size_t i = 0; i < request->query_count; i++) {
        const char *name = request->query[i].name;
        if (strcmp(name, "output") != 0 && strcmp(name, "outputs") != 0) continue;
        value = request->query[i].value;
        ++*times;
    }
    return value;
}

/* The bit of `outputs` that stands for it, by any of its names; 0 where there is none of that name, or several. */
static uint32_t output_asked(const struct request *request) {
    size_t times;
    const char *value = name_of_output(request, &times);
    struct params one;
    struct error error;
    if (times > 1) return 0;
    params_defaults(&one);
    if (params_set(&one, "outputs", value ? value : "cloud", &error)) return 0;
    return one.outputs & (one.outputs - 1) ? 0 : one.outputs;
}

static const char *file_asked(const struct request *request) {
    return params_output_file((unsigned)__builtin_ctz(output_asked(request)));
}

static void refuse_output(const struct request *request, struct problem *problem) {
    char allowed[ALLOWED_BYTES] = "one of ";
    const struct param *outputs = params_find("outputs");
    size_t times, used = strlen(allowed);
    for (unsigned i = 0; i < PARAMS_OUTPUTS && used < sizeof allowed; i++)
        used += (size_t)snprintf(allowed + used, sizeof allowed - used, "%s%s", i ? ", " : "", outputs->choices[i]);
    const char *value = name_of_output(request, &times);
    const char *name = query_find(request->query, request->query_count, "outputs") ? "outputs" : "output";
    if (times > 1 || (strcmp(name, "outputs") == 0 && value && strchr(value, ',')))
        problem_set(problem, PROBLEM_CONFLICTING_PARAMETERS,
                    "%s: this operation has one output; use /v1/jobs for several", name);
    else
        problem_set(problem, PROBLEM_INVALID_PARAMETER, "%s: takes %s", name, allowed);
    problem_add_error(problem, name, value, allowed, NULL);
}

static bool read_simplify(const struct request *request, struct job *job, struct response *response) {
    struct problem problem;
    uint32_t asked = output_asked(request);
    bool ok = query_decode_params(request->query, request->query_count, own_names, &job->params, &problem) &&
              handlers_read_preferences(request, job, &problem);
    if (ok && !asked) {
        refuse_output(request, &problem);
        ok = false;
    }
    if (!ok) {
        response_problem(response, &problem);
        return false;
    }
    job->params.outputs = asked;
    return true;
}

/* Whether the client takes what its output is; any of it may be taken for bytes.  That the reply comes later says
 * something else: the job document.  Where no output is named its type is our choice; and clients that are made from
 * the contract ask for JSON, which problems are, whatever the operation answers. */
static bool is_acceptable(const struct request *request, struct response *response) {
    struct problem problem;
    char type[64], supported[128];
    const char *name = file_asked(request), *whole = handlers_media_type(name);
    snprintf(type, sizeof type, "%.*s", (int)strcspn(whole, ";"), whole);
    size_t times;
    if (request_prefers_async(request) || !name_of_output(request, &times) || request_accepts(request, type) ||
        request_accepts(request, "application/octet-stream") || request_accepts(request, "application/json"))
        return true;
    snprintf(supported, sizeof supported, "%s,application/octet-stream", type);
    problem_set(&problem, PROBLEM_NOT_ACCEPTABLE, "%s is %s, which Accept: %.80s leaves out", name, type,
                request->header[HEADER_ACCEPT]);
    problem_add_list(&problem, "supported", supported);
    response_problem(response, &problem);
    return false;
}

static bool admit_simplify(struct service *service, struct request *request, struct response *response) {
    struct job job = {0};
    return read_simplify(request, &job, response) && is_acceptable(request, response) &&
           handlers_admit_body(service, request, BODY_CLOUD | BODY_FORM | BODY_JSON, own_names, &job.params, response);
}

/* ------------------------------------------------------------------------------------------------ answers */

static void put_timing(void *ctx, const char *name, double ms) {
    char *text = ctx;
    size_t used = strlen(text);
    int n = snprintf(text + used, RESPONSE_HEADER_BYTES - used, "%s%s;dur=%.1f", used ? ", " : "", name, ms);
    if (n < 0 || used + (size_t)n >= RESPONSE_HEADER_BYTES) text[used] = 0; /* what doesn't fit is left out */
}

static void put_stats(const struct job *job, struct response *response) {
    struct report_headline h;
    char timings[RESPONSE_HEADER_BYTES] = "", errors[128] = "", both[192] = "", mesh[48] = "";
    report_read_headline(job->report, &h);
    report_read_timings(job->report, put_timing, timings);
    if (isfinite(h.mean_rel))
        snprintf(errors, sizeof errors, ", mean-rel=%.4g, rms-rel=%.4g, max-rel=%.4g", h.mean_rel, h.rms_rel,
                 h.max_rel);
    if (isfinite(h.symmetric_mean_rel))
        snprintf(both, sizeof both,
                 ", symmetric-mean=%.4g, symmetric-max=%.4g, symmetric-mean-rel=%.4g, symmetric-max-rel=%.4g",
                 h.symmetric_mean, h.symmetric_max, h.symmetric_mean_rel, h.symmetric_max_rel);
    if (h.triangles) snprintf(mesh, sizeof mesh, ", triangles=%llu", h.triangles);
    response_header(response, "Job-Stats", "points-in=%llu, points-out=%llu%s%s%s", h.points_in, h.points_out, mesh,
                    errors, both);
    if (timings[0]) response_header(response, "Server-Timing", "%s", timings);
}

/* What every answer of a job's one-shot has: where the job is, and how long was waited. */
static void put_job(const struct service *service, const struct request *request, struct response *response) {
    response_header(response, "Link", "<%s/v1/jobs/%s>; rel=\"monitor\"", links_base(), request->wait.id);
    handlers_applied_wait(request, service->config->sync_max_ms, response);
}

static void answer_ended(struct service *service, const struct request *request, const struct job *job,
                         struct response *response) {
    if (job->state == JOB_SUCCESSFUL) {
        handlers_send_output(service, request, job, file_asked(request), response);
        put_stats(job, response);
        handlers_cache_status(request->wait.state == JOB_SUCCESSFUL, response);
    } else if (job->state == JOB_FAILED && job->problem) {
        response_problem_text(response, job->problem);
    } else {
        response_refuse(response, PROBLEM_JOB_DISMISSED, "the job was dismissed");
    }
    put_job(service, request, response);
}

static void answer_late(const struct service *service, const struct request *request, const struct job *job,
                        struct response *response) {
    struct problem problem;
    problem_set(&problem, PROBLEM_SYNC_TIMEOUT, "the job is %s; it goes on", job_state_name(job->state));
    problem_add_text(&problem, "job", job->id);
    response_problem(response, &problem);
    response_header(response, "Location", "%s/v1/jobs/%s", links_base(), job->id);
    put_job(service, request, response);
}

/* ------------------------------------------------------------------------------------------------ the handler */

/* The first call: submits, or finds the job that the same request made before.  false: the response is there. */
static bool submit(struct service *service, struct request *request, struct response *response) {
    struct request_wait *wait = &request->wait;
    struct job job = {0};
    struct catalog_reply before = {0};
    bool submitted = handlers_end_body(request, response) && read_simplify(request, &job, response) &&
                     handlers_submit(service, request, &job, &before, response);
    int64_t most_ms = service->config->sync_max_ms, prefer_ms = request_prefer_wait_ms(request, most_ms);
    memcpy(wait->id, job.id, sizeof wait->id);
    wait->state = (int)job.state; /* successful where an earlier job serves */
    wait->end_ms = clock_ms() + (prefer_ms < 0 ? most_ms : prefer_ms);
    catalog_reply_done(&before);
    job_done(&job);
    return submitted;
}

static void answer_async(struct service *service, const struct request *request, struct response *response) {
    struct job job;
    const char *id = request->wait.id;
    if (handlers_read_job(service, request, id, &job, response)) {
        handlers_job_response(service, &job, 202, response);
        response_header(response, "Location", "%s/v1/jobs/%s", links_base(), id);
        response_header(response, "Preference-Applied", "respond-async");
        handlers_applied_wait(request, service->config->sync_max_ms, response);
        handlers_cache_status(request->wait.state == JOB_SUCCESSFUL, response);
    }
    job_done(&job);
}

/* The client is gone, and can't come back for the result: where it named no key to ask again under, the job's place is
 * freed.  One that has only closed its own half of the connection looks the same, and is told. */
static void abandon(struct service *service, const struct request *request, struct job *job,
                    struct response *response) {
    struct error error = {0};
    bool changed = false;
    if (!service->config->oneshot_abandon || request->header[HEADER_IDEMPOTENCY_KEY]) {
        answer_late(service, request, job, response);
        return;
    }
    log_line(LOG_INFO, "job=%s to be dismissed: its client has disconnected", job->id);
    enum status status = handlers_withdraw(service, job, &changed, &error);
    if (status == STATUS_OK && !changed) status = catalog_cancel(service->catalog, job->id, &error);
    if (status != STATUS_OK) log_line(LOG_ERROR, "job=%s can't be dismissed: %s", job->id, error.text);
    response_refuse(response, PROBLEM_JOB_DISMISSED,
                    "the client closed its half of the connection, so the job was dismissed; with an Idempotency-Key "
                    "it would go on");
    put_job(service, request, response);
}

static void simplify(struct service *service, struct request *request, struct response *response) {
    struct request_wait *wait = &request->wait;
    struct job job;
    if (!wait->calls && !submit(service, request, response)) return;
    bool async = request_prefers_async(request); /* with wait=N: if it takes longer */
    if (!wait->calls && async && request_prefer_wait_ms(request, INT64_MAX) < 0) {
        answer_async(service, request, response);
        return;
    }
    wait->seen = change_feed_now(service->feed);
    if (handlers_read_job(service, request, wait->id, &job, response)) {
        if (job_ended(job.state)) {
            answer_ended(service, request, &job, response);
        } else if (wait->calls && wait->why == CHANGE_FEED_HANGUP) {
            abandon(service, request, &job, response);
        } else if ((wait->calls && wait->why == CHANGE_FEED_CLOSED) || clock_ms() >= wait->end_ms) {
            if (async)
                answer_async(service, request, response);
            else
                answer_late(service, request, &job, response);
        } else {
            response->kind = RESPONSE_WAIT;
            wait->deadline_ms = wait->end_ms;
        }
    }
    job_done(&job);
}

const struct handler handlers_simplify = {.admit = admit_simplify, .run = simplify};
