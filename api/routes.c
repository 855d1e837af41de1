/* The route table, and matching against it.
 *
 * A few dozen rows don't need a tree.  The same table is compared with openapi.json by the tests.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/routes.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>

static const struct route table[] = {
    {"GET", "/", "getPage", OPERATION_GET_PAGE, ROUTES_PUBLIC},
    {"GET", "/docs", "getDocs", OPERATION_GET_DOCS, ROUTES_PUBLIC},
    {"POST", "/v1/simplify", "simplify", OPERATION_SIMPLIFY, ROUTES_SUBMIT},
    {"POST", "/v1/jobs", "createJob", OPERATION_CREATE_JOB, ROUTES_SUBMIT},
    {"GET", "/v1/jobs", "listJobs", OPERATION_LIST_JOBS, ROUTES_READ},
    {"GET", "/v1/jobs/{id}", "getJob", OPERATION_GET_JOB, ROUTES_READ},
    {"DELETE", "/v1/jobs/{id}", "deleteJob", OPERATION_DELETE_JOB, ROUTES_SUBMIT},
    {"GET", "/v1/jobs/{id}/events", "getEvents", OPERATION_GET_EVENTS, ROUTES_READ},
    {"GET", "/v1/jobs/{id}/log", "getLog", OPERATION_GET_LOG, ROUTES_READ},
    {"GET", "/v1/jobs/{id}/outputs", "listOutputs", OPERATION_LIST_OUTPUTS, ROUTES_READ},
    {"GET", "/v1/jobs/{id}/outputs/{name}", "getOutput", OPERATION_GET_OUTPUT, ROUTES_READ},
    {"POST", "/v1/jobs/{id}/outputs/{name}/link", "createLink", OPERATION_CREATE_LINK, ROUTES_READ},
    {"POST", "/v1/clouds", "createCloud", OPERATION_CREATE_CLOUD, ROUTES_SUBMIT},
    {"GET", "/v1/clouds", "listClouds", OPERATION_LIST_CLOUDS, ROUTES_READ},
    {"GET", "/v1/clouds/{id}", "getCloud", OPERATION_GET_CLOUD, ROUTES_READ},
    {"DELETE", "/v1/clouds/{id}", "deleteCloud", OPERATION_DELETE_CLOUD, ROUTES_SUBMIT},
    {"GET", "/v1/clouds/{id}/data", "getCloudData", OPERATION_GET_CLOUD_DATA, ROUTES_READ},
    {"OPTIONS", "/v1/uploads", "getUploadOptions", OPERATION_UPLOAD_OPTIONS, ROUTES_PUBLIC},
    {"POST", "/v1/uploads", "createUpload", OPERATION_CREATE_UPLOAD, ROUTES_SUBMIT},
    {"GET", "/v1/uploads/{id}", "getUpload", OPERATION_GET_UPLOAD, ROUTES_SUBMIT},
    {"PATCH", "/v1/uploads/{id}", "continueUpload", OPERATION_CONTINUE_UPLOAD, ROUTES_SUBMIT},
    {"DELETE", "/v1/uploads/{id}", "deleteUpload", OPERATION_DELETE_UPLOAD, ROUTES_SUBMIT},
    {"GET", "/v1/parameters", "getParameters", OPERATION_GET_PARAMETERS, ROUTES_PUBLIC},
    {"GET", "/v1/info", "getInfo", OPERATION_GET_INFO, ROUTES_PUBLIC},
    {"GET", "/openapi.json", "getContract", OPERATION_GET_CONTRACT, ROUTES_PUBLIC},
    {"GET", "/problems/{slug}", "getProblem", OPERATION_GET_PROBLEM, ROUTES_PUBLIC},
    {"GET", "/healthz", "getHealth", OPERATION_GET_HEALTH, ROUTES_PUBLIC},
    {"GET", "/readyz", "getReadiness", OPERATION_GET_READINESS, ROUTES_PUBLIC},
    {"GET", "/metrics", "getMetrics", OPERATION_GET_METRICS, ROUTES_ADMIN},
};
enum { ROWS = sizeof table / sizeof table[0] };
_Static_assert(ROWS == OPERATION_COUNT, "one row for each operation");

const struct route *routes_table(size_t *count) {
    *count = ROWS;
    return table;
}

/* Matches one part of the path against one part of the pattern; a capture is stored. */
static bool match_part(const char *pattern, size_t pattern_length, const char *path, size_t path_length,
                       char *capture) {
    if (pattern[0] != '{') return pattern_length == path_length && memcmp(pattern, path, path_length) == 0;
    if (path_length == 0 || path_length >= ROUTES_CAPTURE_BYTES) return false;
    memcpy(capture, path, path_length);
    capture[path_length] = 0;
    return true;
}

static bool match_path(const char *pattern, const char *path, struct route_match *match) {
    size_t captures = 0;
    memset(match->capture, 0, sizeof match->capture);
    while (*pattern == '/' && *path == '/') {
        size_t pattern_length = strcspn(++pattern, "/"), path_length = strcspn(++path, "/");
        if (!match_part(pattern, pattern_length, path, path_length, match->capture[captures])) return false;
        captures += pattern[0] == '{';
        pattern += pattern_length;
        path += path_length;
    }
    return !*pattern && !*path;
}

static bool allows(const struct route *route, const char *method) {
    return strcmp(route->method, method) == 0 || (strcmp(method, "HEAD") == 0 && strcmp(route->method, "GET") == 0);
}

static void add_allowed(char *allow, const struct route *route) {
    size_t used = strlen(allow);
    snprintf(allow + used, ROUTES_ALLOW_BYTES - used, "%s%s%s", used ? ", " : "", route->method,
             strcmp(route->method, "GET") == 0 ? ", HEAD" : "");
}

void routes_match(const char *method, const char *path, struct route_match *match) {
    struct route_match found = {0};
    memset(match, 0, sizeof *match);
    for (size_t i = 0; i < ROWS; i++) {
        if (!match_path(table[i].pattern, path, &found)) continue;
        add_allowed(match->allow, &table[i]);
        if (match->route || !allows(&table[i], method)) continue;
        match->route = &table[i];
        memcpy(match->capture, found.capture, sizeof match->capture);
    }
}
