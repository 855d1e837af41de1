/* Responses: putting answers together.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/response.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "server/base/away.h"
#include "server/base/log.h"

void response_init(struct response *response) {
    memset(response, 0, sizeof *response);
    response->status = 200;
    response->fd = -1;
    response->problem = -1;
}

void response_done(struct response *response) {
    free(response->text);
    free(response->location);
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

void response_problem(struct response *response, const struct problem *problem) {
    int status = problem_type(problem->kind)->http_status;
    response->problem = (int)problem->kind;
    response_text(response, status, "application/problem+json", problem_encode(problem));
    response_header(response, "Cache-Control", "no-store");
    if (status == 503 || status == 429) response_header(response, "Retry-After", "%d", 5);
}

/* As a file that is not sent: a 304 has no body, and libmicrohttpd tells the length that this one would have. */
void response_unchanged(struct response *response, const char *etag, const char *cache_control, uint64_t bytes) {
    response->kind = RESPONSE_FILE;
    response->status = 304;
    response->file_bytes = bytes;
    response_header(response, "ETag", "%s", etag);
    response_header(response, "Cache-Control", "%s", cache_control);
}

const char *response_find_header(const struct response *response, const char *name) {
    for (size_t i = 0; i < response->header_count; i++)
        if (strcmp(response->header[i].name, name) == 0) return response->header[i].value;
    return NULL;
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
    if (error_is_away(error)) {
        log_line_seldom(LOG_WARNING, "%s: %s", error->where, error->text);
        response_refuse(response, PROBLEM_NOT_READY, "%s", error->text);
        return;
    }
    log_line(LOG_ERROR, "%s: %s", error->where, error->text);
    if (error->code == STATUS_NO_SPACE)
        response_refuse(response, PROBLEM_STORAGE_FULL, "%s", error->text);
    else
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "%s", "the service could not do this; its log says why");
}

char *response_bytes(const struct response *response, const char *reason, size_t *bytes) {
    char *text = NULL, date[40];
    struct tm at;
    time_t now = time(NULL);
    FILE *out = open_memstream(&text, bytes);
    if (!out) return NULL;
    strftime(date, sizeof date, "%a, %d %b %Y %H:%M:%S GMT", gmtime_r(&now, &at));
    fprintf(out, "HTTP/1.1 %d %s\r\nDate: %s\r\nContent-Length: %zu\r\n", response->status, reason, date,
            response->text_bytes);
    for (size_t i = 0; i < response->header_count; i++)
        fprintf(out, "%s: %s\r\n", response->header[i].name, response->header[i].value);
    fputs("\r\n", out);
    if (response->text_bytes) fwrite(response->text, 1, response->text_bytes, out);
    if (fclose(out) == 0) return text;
    free(text);
    return NULL;
}
