/* Idempotency-Key, as the handlers of POST see it: admitted with the headers, compared once the request is complete,
 * and the reply kept when it is made.
 *
 * A request's fingerprint says what it asks for, not how: the operation, the cloud's content and all that is asked of
 * it.  So a form whose boundary is another one each time is still the same request.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/base/digest.h"
#include "server/base/log.h"
#include "server/handlers/handlers.h"
#include "server/handlers/keys.h"

static bool takes_key(enum operation operation) {
    return operation == OPERATION_CREATE_JOB || operation == OPERATION_SIMPLIFY ||
           operation == OPERATION_CREATE_CLOUD || operation == OPERATION_CREATE_CLOUD_JOB ||
           operation == OPERATION_CREATE_BATCH;
}

bool handlers_admit_key(struct service *service, struct request *request, struct response *response) {
    const char *key = request->header[HEADER_IDEMPOTENCY_KEY];
    if (!key || !takes_key(request->match.route->operation)) return true;
    if (!catalog_key_valid(key)) {
        response_refuse(response, PROBLEM_MALFORMED_REQUEST,
                        "Idempotency-Key: takes 1 to 255 visible ASCII characters");
        return false;
    }
    struct error error = {0};
    if (catalog_hold_key(service->catalog, request->principal.name, key, &request->claim, &error) != STATUS_OK) {
        response_error(response, &error);
        return false;
    }
    if (request->claim.held) return true;
    response_refuse(response, PROBLEM_IDEMPOTENCY_IN_PROGRESS, "a request with the key %.80s has not been answered yet",
                    key);
    response_header(response, "Retry-After", "1");
    return false;
}

bool handlers_fingerprint(const struct request *request, const struct job *job, const char *cloud,
                          struct job_key *key) {
    char *text = NULL, *params = job ? job_params_text(&job->params) : NULL;
    size_t bytes;
    struct digest *digest = digest_new();
    FILE *out = open_memstream(&text, &bytes);
    if (out) fprintf(out, "%s\n%s\n", request->match.route->operation_id, cloud);
    if (out && job)
        fprintf(out, "%d\n%s\n%s\n%s", job->priority, job->label, job->webhook ? job->webhook : "",
                params ? params : "");
    bool ok = out && fclose(out) == 0 && digest && (!job || params);
    key->key = request->claim.key;
    if (ok) {
        digest_update(digest, text, bytes);
        digest_finish(digest, key->fingerprint);
    }
    free(text);
    free(params);
    digest_free(digest);
    return ok;
}

bool handlers_find_reply(struct service *service, const struct request *request, const struct job_key *key,
                         struct catalog_reply *record, bool *found, struct response *response) {
    struct error error = {0};
    enum status status = catalog_find_reply(service->catalog, request->principal.name, key->key, record, found, &error);
    if (status != STATUS_OK) {
        response_error(response, &error);
        return false;
    }
    if (!*found || strcmp(record->fingerprint, key->fingerprint) == 0) return true;
    response_refuse(response, PROBLEM_IDEMPOTENCY_KEY_REUSED, "the key %.80s was used for another request", key->key);
    catalog_reply_done(record);
    return false;
}

/* Where it can't be kept, the same request finds what was made, and is answered with its present state. */
void handlers_keep_reply(struct service *service, const struct request *request, const struct response *response) {
    struct error error = {0};
    const char *etag = response_find_header(response, "ETag");
    if (!request->claim.held || response->kind != RESPONSE_TEXT || response->status >= 300) return;
    if (catalog_keep_reply(service->catalog, request->principal.name, request->claim.key, response->status,
                           etag ? etag : "", response->text, &error) != STATUS_OK)
        log_line(LOG_WARNING, "the reply to a key isn't kept: %s", error.text);
}

void handlers_replay(struct catalog_reply *record, struct response *response) {
    response_text(response, record->status, "application/json", record->reply);
    record->reply = NULL;
    if (record->etag[0]) response_header(response, "ETag", "%s", record->etag);
    response_header(response, "Cache-Control", "no-cache");
}
