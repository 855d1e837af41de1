/* Requests by their heads.
 *
 * All that can be refused is refused here, so that a client which waits for 100 Continue needn't send its body.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/http_internal.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "api/links.h"
#include "server/http/access.h"

/* What stands before the host of a target in absolute form; 0: it has another form. */
static size_t scheme_bytes(const char *target) {
    return strncasecmp(target, "http://", 7) == 0 ? 7 : strncasecmp(target, "https://", 8) == 0 ? 8 : 0;
}

const char *head_path(const char *target) {
    size_t scheme = scheme_bytes(target);
    if (!scheme) return target;
    const char *path = strchr(target + scheme, '/');
    return path ? path : "/";
}

bool head_is_of(const char *target, const char *host) {
    size_t scheme = scheme_bytes(target), bytes = strcspn(target + scheme, "/");
    return !scheme || (host && strlen(host) == bytes && strncasecmp(target + scheme, host, bytes) == 0);
}

/* ------------------------------------------------------------------------------------------------ check */

/* What makes the head ambiguous or malformed; NULL = nothing. */
static const char *fault_of(const struct request *request, const char *version) {
    if (request->fault) return request->fault;
    bool old = strcmp(version, "HTTP/1.0") == 0;
    return old || request->header[HEADER_HOST] ? NULL : "an HTTP/1.1 request must have a Host header";
}

bool head_check(const struct config *config, const struct request *request, const char *version, uint64_t bytes,
                struct response *response) {
    uint64_t limit = (uint64_t)config->max_header_bytes, most = (uint64_t)config->max_parameters;
    const char *fault = fault_of(request, version);
    if (bytes > limit)
        response_limit(response, PROBLEM_HEADERS_TOO_LARGE, "max_header_bytes", limit, bytes);
    else if (fault)
        response_refuse(response, PROBLEM_MALFORMED_REQUEST, "%s", fault);
    else if (request->argument_count > most)
        response_limit(response, PROBLEM_MALFORMED_REQUEST, "max_parameters", most, request->argument_count);
    else
        return true;
    return false;
}

/* ------------------------------------------------------------------------------------------------ admit */

/* What the admin listener serves: nothing of it waits for anything. */
static bool is_administrative(const struct route *route) {
    return route && (route->operation == OPERATION_GET_HEALTH || route->operation == OPERATION_GET_READINESS ||
                     route->operation == OPERATION_GET_METRICS);
}

/* Who can't send PATCH or DELETE for a resumable upload sends POST and says so. */
static const char *method_of(const struct request *request) {
    static const char uploads[] = "/v1/uploads/";
    const char *other = request->header[HEADER_METHOD_OVERRIDE];
    bool taken = other && (strcmp(other, "PATCH") == 0 || strcmp(other, "DELETE") == 0);
    bool here = strcmp(request->method, "POST") == 0 && strncmp(request->path, uploads, sizeof uploads - 1) == 0;
    return taken && here ? other : request->method;
}

/* PUT would name what it makes, and a cloud's name is its hash, a job's is made here: so both are made by POST.  Who
 * sends it nevertheless is most often curl -T. */
static void add_hint(const struct request *request, struct problem *problem) {
    char hint[PROBLEM_TEXT_BYTES];
    const char *path = strstr(request->match.allow, "POST") ? request->path : "/v1/simplify";
    if (strcmp(request->method, "PUT") != 0) return;
    snprintf(hint, sizeof hint, "curl -T FILE sends PUT; to send a cloud: curl -X POST -T FILE URL, with the path %s%s",
             links_base(), path);
    problem_add_text(problem, "hint", hint);
}

static void refuse_route(const struct request *request, struct response *response) {
    const char *allow = request->match.allow;
    struct problem problem;
    if (allow[0])
        problem_set(&problem, PROBLEM_METHOD_NOT_ALLOWED, "%.16s is not one of %s", request->method, allow);
    else if (request->nowhere)
        problem_set(&problem, PROBLEM_NO_SUCH_RESOURCE, "%%2F in a path is part of a name, not a slash between names");
    else
        problem_set(&problem, PROBLEM_NO_SUCH_RESOURCE, "there is nothing at %.200s", request->path);
    add_hint(request, &problem);
    response_problem(response, &problem);
    if (allow[0]) response_header(response, "Allow", "%s", allow);
}

const struct handler *head_admit(struct service *service, const struct handlers *handlers, struct request *request,
                                 bool admin, struct response *response) {
    request->method = method_of(request);
    routes_match(request->method, request->path, &request->match);
    if (request->nowhere || (admin && !is_administrative(request->match.route))) {
        request->match.route = NULL;
        request->match.allow[0] = 0;
    }
    if (!cross_site_admit_host(service->config, request, response)) return NULL;
    if (cross_site_preflight(service->config, request, response)) return NULL;
    if (!request->match.route) {
        refuse_route(request, response);
        return NULL;
    }
    const struct handler *handler = handlers->find(request->match.route->operation);
    bool admitted = cross_site_admit_origin(service->config, request, response) &&
                    (admin || access_admit(service, request, response)) &&
                    handlers->admit_key(service, request, response) &&
                    (!handler->admit || handler->admit(service, request, response));
    return admitted ? handler : NULL;
}
