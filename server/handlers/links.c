/* Links: an output for somebody without a token, until a time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "api/codecs/job_json.h"
#include "api/links.h"
#include "server/handlers/handlers.h"
#include "server/handlers/outputs.h"
#include "server/http/access.h"

enum { DEFAULT_S = 3600 };

/* Seconds from now, of the query; 0: the response says what is wrong with them. */
static int64_t read_seconds(const struct service *service, const struct request *request, struct response *response) {
    static const char *const names[] = {"seconds", NULL};
    struct problem problem;
    int64_t most = service->config->link_max_ms / 1000, seconds = most < DEFAULT_S ? most : DEFAULT_S;
    const char *text = query_find(request->query, request->query_count, "seconds");
    char *end = NULL, allowed[64];
    bool known = query_check(request->query, request->query_count, names, &problem);
    if (known && text) seconds = text[0] >= '0' && text[0] <= '9' ? strtoll(text, &end, 10) : 0;
    if (known && seconds >= 1 && seconds <= most && !(end && *end)) return seconds;
    snprintf(allowed, sizeof allowed, "a whole number from 1 to %" PRId64, most);
    if (known)
        response_invalid(response, "seconds", text, allowed);
    else
        response_problem(response, &problem);
    return 0;
}

static void answer(const struct service *service, const char *path, int64_t seconds, struct response *response) {
    char signature[SIGNATURE_HEX_BYTES], href[LINKS_BASE_BYTES + ACCESS_PATH_BYTES + 128];
    int64_t expires_s = (int64_t)time(NULL) + seconds; /* links end by the clock on the wall */
    signature_make(&service->signing_key, path, expires_s, signature);
    snprintf(href, sizeof href, "%s%s?exp=%" PRId64 "&sig=%s", links_base(), path, expires_s, signature);
    response_text(response, 200, "application/json", job_link_encode(href, expires_s * 1000));
    response_header(response, "Cache-Control", "no-store");
}

static void create_link(struct service *service, struct request *request, struct response *response) {
    struct job job;
    char path[ACCESS_PATH_BYTES];
    int64_t seconds = read_seconds(service, request, response);
    if (!seconds) return;
    const char *name = request->match.capture[1];
    if (handlers_read_successful(service, request, &job, response)) {
        if (handlers_find_output(&job, name)) {
            access_output_path(job.id, name, path);
            answer(service, path, seconds, response);
        } else {
            response_refuse(response, PROBLEM_NO_SUCH_OUTPUT, "the job has no output %.80s", name);
        }
    }
    job_done(&job);
}

const struct handler handlers_create_link = {.run = create_link};
