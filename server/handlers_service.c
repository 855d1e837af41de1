/* What the service says of itself: parameters, limits, contract, health, and a page for people.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "api/docs_page.h"
#include "api/job_json.h"
#include "api/openapi.h"
#include "api/params_json.h"
#include "core/version.h"
#include "server/handlers.h"
#include "server/metrics.h"
#include "server/page.h"

/* A page that loads nothing; takes text. */
static void answer_page(char *text, struct response *response) {
    response_text(response, 200, "text/html; charset=utf-8", text);
    response_header(response, "Content-Security-Policy", "default-src 'none'; style-src 'unsafe-inline'");
}

void handlers_get_page(struct service *service, struct request *request, struct response *response) {
    size_t bytes;
    (void)service;
    if (!handlers_takes_no_query(request, response)) return;
    const char *page = page_document(&bytes);
    answer_page(strndup(page, bytes), response);
}

void handlers_get_docs(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response)) answer_page(docs_page(), response);
}

void handlers_get_parameters(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response))
        response_text(response, 200, "application/schema+json", params_schema());
}

void handlers_get_info(struct service *service, struct request *request, struct response *response) {
    if (!handlers_takes_no_query(request, response)) return;
    struct config limits = *service->config;
    response_text(response, 200, "application/json", job_info_encode(whittle_version(), config_limit, &limits));
}

void handlers_get_contract(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response)) response_text(response, 200, "application/json", openapi_here());
}

void handlers_get_problem(struct service *service, struct request *request, struct response *response) {
    const struct problem_type *type = problem_type_of_slug(request->match.capture[0]);
    (void)service;
    if (!handlers_takes_no_query(request, response)) return;
    if (type)
        answer_page(problem_page(type), response);
    else
        response_refuse(response, PROBLEM_NO_SUCH_RESOURCE, "there is no problem of this name");
}

void handlers_get_health(struct service *service, struct request *request, struct response *response) {
    (void)service;
    (void)request;
    response_text(response, 200, "application/json", strdup("{\"status\":\"alive\"}"));
    response_header(response, "Cache-Control", "no-store");
}

void handlers_get_readiness(struct service *service, struct request *request, struct response *response) {
    uint64_t waiting, running;
    (void)request;
    queue_depth(service->queue, &waiting, &running);
    if (atomic_load(&service->draining))
        response_refuse(response, PROBLEM_DRAINING, "the service is about to stop");
    else if (waiting >= (uint64_t)service->config->max_queue)
        response_refuse(response, PROBLEM_QUEUE_FULL, "%llu jobs are waiting", (unsigned long long)waiting);
    else if (!store_has_room(service->store, 0) || !store_takes_files(service->store))
        response_refuse(response, PROBLEM_STORAGE_FULL, "the disk is full");
    else
        response_text(response, 200, "application/json", strdup("{\"status\":\"ready\"}"));
    response_header(response, "Cache-Control", "no-store");
}

void handlers_get_metrics(struct service *service, struct request *request, struct response *response) {
    if (!handlers_takes_no_query(request, response)) return;
    response_text(response, 200, "text/plain; version=0.0.4; charset=utf-8", metrics_text(service->metrics, service));
    response_header(response, "Cache-Control", "no-store");
}
