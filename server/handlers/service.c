/* What the service says of itself: parameters, limits, contract, health, and a page for people.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "api/codecs/job_json.h"
#include "api/codecs/params_json.h"
#include "api/docs_page.h"
#include "api/links.h"
#include "api/openapi/openapi.h"
#include "api/site.h"
#include "core/base/version.h"
#include "server/daemon/metrics.h"
#include "server/handlers/handlers.h"
#include "server/handlers/page.h"
#include "server/jobs/readiness.h"

/* A page that loads nothing; takes text. */
static void answer_page(char *text, struct response *response) {
    response_text(response, 200, "text/html; charset=utf-8", text);
    response_header(response, "Content-Security-Policy", "default-src 'none'; style-src 'unsafe-inline'");
}

/* Where the request found the service: "https://host/base", without http:// as curl has it by itself.  A proxy that
 * ended TLS says so. */
static void put_address(FILE *out, const struct request *request) {
    const char *host = request->header[HEADER_HOST], *forwarded = request->header[HEADER_FORWARDED_PROTO];
    bool secure = request->secure || (forwarded && strcasecmp(forwarded, "https") == 0);
    fprintf(out, "%s%s%s", secure ? "https://" : "", host && site_host_is_plain(host) ? host : "localhost:8080",
            links_base());
}

/* The page with its curl lines for this address; returns new, NULL: no memory. */
static char *page_here(const struct request *request) {
    static const char place[] = "$HERE";
    size_t left, bytes;
    const char *from = page_document(&left), *found;
    char *text = NULL;
    FILE *out = open_memstream(&text, &bytes);
    for (; out && (found = memmem(from, left, place, sizeof place - 1)); from = found) {
        fwrite(from, 1, (size_t)(found - from), out);
        put_address(out, request);
        found += sizeof place - 1;
        left -= (size_t)(found - from);
    }
    if (out) fwrite(from, 1, left, out);
    if (out && fclose(out) == 0) return text;
    free(text);
    return NULL;
}

static void get_page(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (!handlers_takes_no_query(request, response)) return;
    answer_page(page_here(request), response);
    response_header(response, "Cache-Control", "no-cache");
    response_header(response, "Vary", "Host");
}

const struct handler handlers_get_page = {.run = get_page, .quick = true};

static void get_docs(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response)) answer_page(docs_page(), response);
}

const struct handler handlers_get_docs = {.run = get_docs, .quick = true};

static void get_parameters(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response))
        response_text(response, 200, "application/schema+json", params_schema());
}

const struct handler handlers_get_parameters = {.run = get_parameters, .quick = true};

static bool measure(void *ctx, size_t i, const char **name, int64_t *value) {
    const struct service *service = ctx;
    if (i >= SERVICE_MEASURES || !service->confinement[i].name) return false;
    *name = service->confinement[i].name;
    *value = service->confinement[i].value;
    return true;
}

static void get_info(struct service *service, struct request *request, struct response *response) {
    if (!handlers_takes_no_query(request, response)) return;
    struct config settings = *service->config;
    struct job_info_list limits = {config_limit, &settings}, confinement = {measure, service};
    response_text(response, 200, "application/json", job_info_encode(whittle_version(), limits, confinement));
}

const struct handler handlers_get_info = {.run = get_info, .quick = true};

static void get_contract(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response)) response_text(response, 200, "application/json", openapi_here());
}

const struct handler handlers_get_contract = {.run = get_contract, .quick = true};

static void get_problem(struct service *service, struct request *request, struct response *response) {
    const struct problem_type *type = problem_type_of_slug(request->match.capture[0]);
    (void)service;
    if (!handlers_takes_no_query(request, response)) return;
    if (type)
        answer_page(problem_page(type), response);
    else
        response_refuse(response, PROBLEM_NO_SUCH_RESOURCE, "there is no problem of this name");
}

const struct handler handlers_get_problem = {.run = get_problem, .quick = true};

static void get_health(struct service *service, struct request *request, struct response *response) {
    (void)service;
    (void)request;
    response_text(response, 200, "application/json", strdup("{\"status\":\"alive\"}"));
    response_header(response, "Cache-Control", "no-store");
}

const struct handler handlers_get_health = {.run = get_health, .quick = true};

static void get_readiness(struct service *service, struct request *request, struct response *response) {
    uint64_t waiting, running;
    struct problem problem;
    (void)request;
    catalog_depth(service->catalog, &waiting, &running);
    if (atomic_load(&service->draining))
        response_refuse(response, PROBLEM_DRAINING, "the service is shutting down");
    else if (waiting >= (uint64_t)service->config->max_queue)
        response_refuse(response, PROBLEM_QUEUE_FULL, "%llu jobs are waiting", (unsigned long long)waiting);
    else if (!readiness_is_given(service->readiness, &problem))
        response_problem(response, &problem);
    else
        response_text(response, 200, "application/json", strdup("{\"status\":\"ready\"}"));
    response_header(response, "Cache-Control", "no-store");
}

const struct handler handlers_get_readiness = {.run = get_readiness, .quick = true};

static void get_metrics(struct service *service, struct request *request, struct response *response) {
    if (!handlers_takes_no_query(request, response)) return;
    response_text(response, 200, "text/plain; version=0.0.4; charset=utf-8", metrics_text(service->metrics, service));
    response_header(response, "Cache-Control", "no-store");
}

const struct handler handlers_get_metrics = {.run = get_metrics, .quick = true};
