/* The response that a handler makes: headers, and a text, a file, or the news that there is none yet.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_RESPONSE_H
#define WHITTLE_SERVER_HTTP_RESPONSE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api/problem.h"

enum response_kind { RESPONSE_TEXT, RESPONSE_FILE, RESPONSE_WAIT, RESPONSE_STREAM };

enum { RESPONSE_MAX_HEADERS = 20, RESPONSE_HEADER_BYTES = 1280 };

struct response {
    enum response_kind kind;
    int status;
    size_t header_count;
    struct {
        const char *name; /* static */
        char value[RESPONSE_HEADER_BYTES];
    } header[RESPONSE_MAX_HEADERS];
    char *location; /* owned; a header, for it may be long; NULL = none */
    char *text;     /* owned; text of RESPONSE_TEXT, next piece of RESPONSE_STREAM (NULL = nothing yet) */
    size_t text_bytes;
    int fd; /* owned; of RESPONSE_FILE */
    uint64_t file_offset, file_bytes;
    int problem; /* enum problem_kind of a problem document; -1 = it is none */
    bool last;   /* RESPONSE_STREAM: ends after this piece */
};

/* An empty text, status 200. */
void response_init(struct response *response);

/* Frees what the response owns. */
void response_done(struct response *response);

/* Adds a header; the name is static.  A value that doesn't fit is cut. */
void response_header(struct response *response, const char *name, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Makes it a text of this type; takes text (NULL: memory ran out, which becomes an empty 500). */
void response_text(struct response *response, int status, const char *media_type, char *text);

/* Makes it a problem document, with the status of its kind, and Retry-After where one is due. */
void response_problem(struct response *response, const struct problem *problem);

/* Makes it a 304 with this ETag and Cache-Control; bytes: the length of the content, which a 200 would have. */
void response_unchanged(struct response *response, const char *etag, const char *cache_control, uint64_t bytes);

/* The value of a header that was added; NULL = it was not. */
const char *response_find_header(const struct response *response, const char *name);

/* The same for a problem that is JSON already (of a failed job). */
void response_problem_text(struct response *response, const char *json);

/* A problem without members, from a printf-formatted sentence. */
void response_refuse(struct response *response, enum problem_kind kind, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* A parameter's value isn't allowed; allowed says what is, value may be NULL. */
void response_invalid(struct response *response, const char *name, const char *value, const char *allowed);

/* A limit of /v1/info is reached. */
void response_limit(struct response *response, enum problem_kind kind, const char *name, uint64_t limit,
                    uint64_t actual);

/* A text as it goes over a connection, with its head: Date, Content-Length and the headers that were added; returns
 * new, NULL when memory runs out. */
char *response_bytes(const struct response *response, const char *reason, size_t *bytes);

/* What the service itself failed at: 500, or 503 where a server is away (base/away.h), and a line in the log. */
void response_error(struct response *response, const struct error *error);

#endif
