/* Requests and responses: reading what headers say, and putting answers together.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/message.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>
#include <unistd.h>

#include "server/log.h"

const char *const message_header_names[HEADER_COUNT] = {
    [HEADER_RANGE] = "Range",
    [HEADER_IF_RANGE] = "If-Range",
    [HEADER_IF_NONE_MATCH] = "If-None-Match",
    [HEADER_PREFER] = "Prefer",
    [HEADER_EXPECT] = "Expect",
    [HEADER_CONTENT_TYPE] = "Content-Type",
    [HEADER_CONTENT_ENCODING] = "Content-Encoding",
    [HEADER_CONTENT_LENGTH] = "Content-Length",
    [HEADER_TRANSFER_ENCODING] = "Transfer-Encoding",
    [HEADER_LAST_EVENT_ID] = "Last-Event-ID",
    [HEADER_HOST] = "Host",
    [HEADER_CONTENT_DIGEST] = "Content-Digest",
    [HEADER_METHOD_OVERRIDE] = "X-HTTP-Method-Override",
    [HEADER_TUS_RESUMABLE] = "Tus-Resumable",
    [HEADER_UPLOAD_LENGTH] = "Upload-Length",
    [HEADER_UPLOAD_DEFER_LENGTH] = "Upload-Defer-Length",
    [HEADER_UPLOAD_OFFSET] = "Upload-Offset",
    [HEADER_UPLOAD_METADATA] = "Upload-Metadata",
    [HEADER_UPLOAD_CHECKSUM] = "Upload-Checksum",
    [HEADER_UPLOAD_CONCAT] = "Upload-Concat",
    [HEADER_REPR_DIGEST] = "Repr-Digest",
    [HEADER_AUTHORIZATION] = "Authorization",
    [HEADER_REQUEST_ID] = "X-Request-Id",
    [HEADER_TRACEPARENT] = "traceparent",
    [HEADER_CACHE_CONTROL] = "Cache-Control",
    [HEADER_IDEMPOTENCY_KEY] = "Idempotency-Key",
};

/* ------------------------------------------------------------------------------------------------ responses */

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

/* ------------------------------------------------------------------------------------------------ requests */

/* Headers whose repetition makes a request mean two things. */
static bool is_single(size_t header) {
    static const enum request_header single[] = {HEADER_HOST,         HEADER_CONTENT_LENGTH, HEADER_TRANSFER_ENCODING,
                                                 HEADER_CONTENT_TYPE, HEADER_AUTHORIZATION,  HEADER_IDEMPOTENCY_KEY};
    for (size_t i = 0; i < sizeof single / sizeof *single; i++)
        if (single[i] == header) return true;
    return false;
}

void request_take_header(struct request *request, const char *name, const char *value, size_t value_bytes) {
    if (strpbrk(name, " \t")) request->fault = "a header's name holds a blank";
    for (size_t i = 0; i < HEADER_COUNT; i++) {
        if (strcasecmp(name, message_header_names[i]) != 0) continue;
        if (is_single(i) && request->header[i]) request->fault = "a header comes twice that may come once";
        if (strlen(value) != value_bytes) request->fault = "a header holds NUL";
        request->header[i] = value;
    }
}

void request_take_argument(struct request *request, const char *name, size_t name_bytes, const char *value,
                           size_t value_bytes) {
    bool has_nul = strlen(name) != name_bytes || (value && strlen(value) != value_bytes);
    if (has_nul) request->fault = "an argument holds NUL";
    if (request->query_count == REQUEST_MAX_QUERY)
        request->fault = "there are too many arguments";
    else
        request->query[request->query_count++] = (struct query_pair){name, value};
}

static bool read_length(const char *text, uint64_t *length) {
    char *end;
    if (text[0] < '0' || text[0] > '9' || strlen(text) > 18) return false;
    *length = strtoull(text, &end, 10);
    return !*end;
}

void request_read_framing(struct request *request) {
    const char *length = request->header[HEADER_CONTENT_LENGTH], *coding = request->header[HEADER_TRANSFER_ENCODING];
    request->content_length = coding ? UINT64_MAX : 0;
    if (length && coding)
        request->fault = "Content-Length and Transfer-Encoding contradict each other";
    else if (coding && strcasecmp(coding, "chunked") != 0)
        request->fault = "the only transfer coding that is read is chunked";
    else if (length && !read_length(length, &request->content_length))
        request->fault = "Content-Length is no length";
    request->has_body = request->content_length != 0;
}

/* 1 to 64 letters, digits and marks that mean nothing in a log or a header. */
static bool is_plain_id(const char *text) {
    static const char allowed[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-";
    size_t length = strlen(text);
    return length > 0 && length < REQUEST_ID_BYTES && strspn(text, allowed) == length;
}

/* The trace id, 32 hexadecimal digits, of "00-TRACE-PARENT-FLAGS" (W3C Trace Context). */
static bool read_trace(const char *text, char id[REQUEST_ID_BYTES]) {
    static const char shape[] = "xx-xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx-xxxxxxxxxxxxxxxx-xx";
    if (strlen(text) != sizeof shape - 1 || strncmp(text, "ff", 2) == 0) return false;
    for (size_t i = 0; shape[i]; i++)
        if (shape[i] == '-' ? text[i] != '-' : !strchr("0123456789abcdef", text[i])) return false;
    if (strspn(text + 3, "0") >= 32 || strspn(text + 36, "0") >= 16) return false;
    snprintf(id, REQUEST_ID_BYTES, "%.32s", text + 3);
    return true;
}

void request_identify(struct request *request) {
    const char *own = request->header[HEADER_REQUEST_ID], *trace = request->header[HEADER_TRACEPARENT];
    uint64_t random = 0;
    if (own && is_plain_id(own)) {
        snprintf(request->id, sizeof request->id, "%s", own);
    } else if (!trace || !read_trace(trace, request->id)) {
        ssize_t n = getrandom(&random, sizeof random, 0); /* 8 bytes are never cut short */
        (void)n;
        snprintf(request->id, sizeof request->id, "%016llx", (unsigned long long)random);
    }
}

/* Finds one preference of the list; returns what follows its name, or NULL. */
static const char *find_preference(const char *list, const char *name) {
    size_t length = strlen(name);
    for (const char *item = list; item && *item;) {
        item += strspn(item, " \t,;");
        if (strncasecmp(item, name, length) == 0 && strchr("=,; \t", item[length])) return item + length;
        item += strcspn(item, ",;");
    }
    return NULL;
}

int64_t request_prefer_wait_ms(const struct request *request, int64_t max_ms) {
    const char *value = find_preference(request->header[HEADER_PREFER], "wait");
    if (!value) return -1;
    value += strspn(value, " \t=\"");
    char *end;
    errno = 0;
    long seconds = strtol(value, &end, 10);
    if (end == value || seconds < 0) return -1;
    return errno || seconds > max_ms / 1000 ? max_ms : (int64_t)seconds * 1000;
}

bool request_prefers_async(const struct request *request) {
    return find_preference(request->header[HEADER_PREFER], "respond-async") != NULL;
}

bool request_none_match(const struct request *request, const char *etag) {
    const char *list = request->header[HEADER_IF_NONE_MATCH];
    size_t length = strlen(etag);
    while (list && *list) {
        list += strspn(list, " \t,");
        if (list[0] == '*') return true;
        if (strncmp(list, "W/", 2) == 0) list += 2;
        if (strncmp(list, etag, length) == 0 && strchr(", \t", list[length])) return true;
        list += strcspn(list, ",");
    }
    return false;
}

/* Decimal digits alone; false on overflow too. */
static bool read_position(const char **text, uint64_t *value) {
    char *end;
    if (**text < '0' || **text > '9') return false;
    errno = 0;
    *value = strtoull(*text, &end, 10);
    *text = end;
    return errno == 0;
}

/* "-n": the last n bytes. */
static enum request_range suffix_range(const char *text, uint64_t bytes, uint64_t *first, uint64_t *last) {
    uint64_t count;
    if (!read_position(&text, &count) || *text) return RANGE_NONE;
    if (count == 0 || bytes == 0) return RANGE_UNSATISFIABLE;
    *first = count < bytes ? bytes - count : 0;
    *last = bytes - 1;
    return RANGE_ONE;
}

enum request_range request_range(const struct request *request, uint64_t bytes, uint64_t *first, uint64_t *last) {
    const char *text = request->header[HEADER_RANGE];
    if (!text || strncasecmp(text, "bytes=", 6) != 0) return RANGE_NONE;
    text += 6;
    if (*text == '-') return suffix_range(text + 1, bytes, first, last);
    if (!read_position(&text, first) || *text++ != '-') return RANGE_NONE;
    *last = UINT64_MAX;
    if (*text && (!read_position(&text, last) || *text || *last < *first)) return RANGE_NONE;
    if (*first >= bytes) return RANGE_UNSATISFIABLE;
    if (*last >= bytes) *last = bytes - 1;
    return RANGE_ONE;
}
