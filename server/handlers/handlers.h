/* What the service does for each operation of the route table.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HANDLERS_HANDLERS_H
#define WHITTLE_SERVER_HANDLERS_HANDLERS_H

#include <stdbool.h>

#include "api/codecs/job_json.h"
#include "server/catalog/catalog.h"
#include "server/http/handler.h"
#include "server/http/request.h"
#include "server/jobs/service.h"

/* All of them, for http_open. */
extern const struct handlers handlers_all;

/* ---- shared by the handlers_*.c ---- */

/* For an operation that takes no query: whether there is none; else the response names the first of its parameters. */
bool handlers_takes_no_query(const struct request *request, struct response *response);

/* Refuses bytes that are more than the principal's share: body, of which has are kept, or 0 where it isn't known.  413
 * where it alone is more. */
void handlers_refuse_bytes(const struct service *service, uint64_t has, uint64_t body, struct response *response);

/* Whether so many bytes more are taken now, and (for_job) another job; whether they are within the principal's share,
 * to which resumable uploads count that are not whole; both.  Else a response. */
bool handlers_is_open(struct service *service, uint64_t body, bool for_job, struct response *response);
bool handlers_is_within_share(struct service *service, const struct request *request, uint64_t body, bool for_job,
                              struct response *response);
bool handlers_has_room(struct service *service, const struct request *request, uint64_t body, bool for_job,
                       struct response *response);

/* Whether new work is taken now, and the request's headers fit a body that the operation takes (a set of enum
 * body_kind; where it may be JSON, it is for a job, and the queue must have room; names as in struct body_plan; params
 * is what is known of the job, NULL for none); else a response.  Where the path of an operation that takes JSON alone
 * has an id, it is the cloud's. */
bool handlers_admit_body(struct service *service, struct request *request, unsigned takes, const char *const *names,
                         const struct params *params, struct response *response);

/* The last checks of the request's body, and what it says of parameters is added to the query; false: the response says
 * what is wrong.  To be called once, before the query is read. */
bool handlers_end_body(struct request *request, struct response *response);

/* The last checks of the cloud in the request's body; false: the response says what is wrong. */
bool handlers_end_upload(struct request *request, struct upload_facts *facts, struct response *response);

/* Reads the cloud of this id; false: there is none that the request's principal may see, and the response says so.  The
 * record is the caller's either way. */
bool handlers_read_cloud(struct service *service, const struct request *request, const char *id,
                         struct catalog_cloud *record, struct response *response);

/* Which part of a listing the query asks for. */
struct handlers_page {
    size_t limit;
    const char *after; /* the last one before it, borrowed of the query; NULL = from the beginning */
};

/* Reads limit and after, of a query that takes these names; valid(after) says whether that may be an id, which is what
 * (as in "the id of a job"); false: the response says what is wrong. */
bool handlers_read_page(const struct request *request, const char *const *names, bool (*valid)(const char *id),
                        const char *what, struct handlers_page *page, struct response *response);

/* Takes `label` and `priority` from the query; false: *problem says why. */
bool handlers_read_preferences(const struct request *request, struct job *job, struct problem *problem);

/* Takes `webhook` from the query; borrowed there.  false: the response says why. */
bool handlers_read_webhook(const struct service *service, const struct request *request, struct job *job,
                           struct response *response);

/* Reads how long Prefer: wait=N lets the request wait, from now on. */
void handlers_begin_wait(const struct service *service, struct request *request);

/* Cache-Control: no-cache asks for a run, even where a result is there. */
bool handlers_wants_fresh(const struct request *request);

/* Whether what was submitted is; else the response says why not. */
bool handlers_submitted(enum status status, const struct error *error, struct response *response);

/* Reads the job of this id; false: there is none that the request's principal may see, and the response (404, 410) says
 * so.  The job is the caller's, to job_done, either way. */
bool handlers_read_job(struct service *service, const struct request *request, const char *id, struct job *job,
                       struct response *response);

/* Submits a job for the cloud that the request's body holds or names, with these parameters; false: the response says
 * why.  Where the same request came before under the same key, *before says what it made, job->id is that job's, and
 * nothing is submitted; it is the caller's, to catalog_reply_done. */
bool handlers_submit(struct service *service, struct request *request, struct job *job, struct catalog_reply *before,
                     struct response *response);

/* What a job on this cloud will take, by job->params: fills in memory_bytes and the job's input.  false: it would be
 * refused, *problem says why.  The request has no body. */
bool handlers_foresee(struct service *service, const struct request *request, const struct catalog_cloud *cloud,
                      struct job *job, struct problem *problem);

/* The job document as a response with this status, its ETag and, while the job has not ended, Retry-After. */
void handlers_job_response(struct service *service, const struct job *job, int status, struct response *response);

/* The same of a document that is there already; takes text.  The job has ended. */
void handlers_document_response(char *text, uint64_t sequence, int status, struct response *response);

/* Preference-Applied, where Prefer: wait=N was followed, with the seconds that were left of it by a limit of ours. */
void handlers_applied_wait(const struct request *request, int64_t max_ms, struct response *response);

/* Cache-Status: whether an earlier job's outputs serve this one: what service_submit found. */
void handlers_cache_status(bool hit, struct response *response);

/* Whether If-Match allows to change what has this ETag (NULL = none); false: the response (412) says not. */
bool handlers_admit_match(const struct request *request, const char *etag, struct response *response);

/* Dismisses a job that waits; *changed false: it doesn't wait any more. */
enum status handlers_withdraw(struct service *service, struct job *job, bool *changed, struct error *error) MUST_CHECK;

/* The handlers themselves, each where its function is. */
#define ROUTE(operation, name, method, path, id, scope) extern const struct handler handlers_##name;
#include "api/routes.def"

#endif
