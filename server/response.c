/* Responses: putting answers together.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/response.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/log.h"

void response_init(struct response *response) {
    memset(response, 0, sizeof *response);
    response->status = 200;
    response->fd = -1;
    response->problem = -1;
}

void response_done(struct response *response) {
    free(response->text);
    if (response->fd >= 0) close(response->fd);
    response_init(response);
}

void response_header(struct response *response, const char *name, const char *format, ...) {
    if (response->header_count == RESPONSE_MAX_HEADERS) return;
    response->header[response->header_count].name = name;
    va_list args;
    va_start(args, format);
    vsnprintf(response->header[response->header_count].value, RESPONSE_HEADER_BYTES, format, args);
    va_end(args);
    response->header_count++;
}

void response_text(struct response *response, int status, const char *media_type, char *text) {
    free(response->text);
    response->kind = RESPONSE_TEXT;
    response->status = text ? status : 500;
    response->text = text;
    response->text_bytes = text ? strlen(text) : 0;
    response_header(response, "Content-Type", "%s", media_type);
}

static void retry_later(struct response *response, int status) {
    if (status == 503 || status == 429) response_header(response, "Retry-After", "%d", 5);
}

void response_problem(struct response *response, const struct problem *problem) {
    int status = problem_type(problem->kind)->http_status;
    response->problem = (int)problem->kind;
    response_text(response, status, "application/problem+json", problem_encode(problem));
    response_header(response, "Cache-Control", "no-store");
    retry_later(response, status);
}

void response_problem_text(struct response *response, const char *json) {
    response_text(response, problem_status_of(json), "application/problem+json", problem_relocate(json));
}

void response_refuse(struct response *response, enum problem_kind kind, const char *format, ...) {
    struct problem problem;
    char detail[PROBLEM_DETAIL_BYTES];
    va_list args;
    va_start(args, format);
    vsnprintf(detail, sizeof detail, format, args);
    va_end(args);
    problem_set(&problem, kind, "%s", detail);
    response_problem(response, &problem);
}

void response_invalid(struct response *response, const char *name, const char *value, const char *allowed) {
    struct problem problem;
    problem_set(&problem, PROBLEM_INVALID_PARAMETER, "%s: takes %s", name, allowed);
    problem_add_error(&problem, name, value, allowed, NULL);
    response_problem(response, &problem);
}

void response_limit(struct response *response, enum problem_kind kind, const char *name, uint64_t limit,
                    uint64_t actual) {
    struct problem problem;
    problem_set(&problem, kind, "%s is %llu, and this is %llu", name, (unsigned long long)limit,
                (unsigned long long)actual);
    problem_add_number(&problem, "limit", (int64_t)limit);
    problem_add_number(&problem, "actual", (int64_t)actual);
    response_problem(response, &problem);
}

void response_error(struct response *response, const struct error *error) {
    log_line(LOG_ERROR, "%s: %s", error->where, error->text);
    if (error->code == STATUS_NO_SPACE)
        response_refuse(response, PROBLEM_STORAGE_FULL, "%s", error->text);
    else
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "%s", "the service could not do this; its log says why");
}
