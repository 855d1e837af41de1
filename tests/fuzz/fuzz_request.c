/* Fuzzes a request's head as the handlers see it: method and path against the routes, headers, framing, arguments,
 * parameters, ranges, preferences, entity tags.
 *
 *     GET /v1/jobs/x           the first line
 *     Range: bytes=0-5         a header
 *     ?ratio=0.5               an argument, already undone of its escapes; bytes are taken as they are
 *
 * What decodes is stored and read again the same.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "api/routes.h"
#include "server/catalog/job.h"
#include "server/http/request.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { MAX_LINES = 100 };

static void require(int condition) {
    if (!condition) abort();
}

static char *copy(const char *from, size_t length) {
    char *text = malloc(length + 1);
    require(text != NULL);
    memcpy(text, from, length);
    text[length] = 0;
    return text;
}

static void take_line(struct request *request, char *line, size_t length) {
    char *colon = memchr(line, ':', length), *equals = memchr(line, '=', length);
    if (line[0] == '?') {
        size_t name = equals ? (size_t)(equals - line - 1) : length - 1;
        if (equals) *equals = 0;
        request_take_argument(request, line + 1, name, equals ? equals + 1 : NULL, equals ? length - name - 2 : 0);
    } else if (colon) {
        *colon = 0;
        char *value = colon + 1 + (colon[1] == ' ');
        request_take_header(request, line, value, length - (size_t)(value - line));
    }
}

static void try_params(const struct request *request) {
    static const char *const extra[] = {"label", "priority", "output", NULL};
    static const char *const none[] = {"status", NULL};
    struct params params, again;
    struct problem problem = {.kind = PROBLEM_COUNT};
    bool ok = query_decode_params(request->query, request->query_count, extra, &params, &problem);
    require(ok || problem.kind != PROBLEM_COUNT);
    if (!ok) free(problem_encode(&problem));
    query_check(request->query, request->query_count, none, &problem);
    if (!ok) return;
    char *text = job_params_text(&params);
    job_params_read(text, &again);
    char *twice = job_params_text(&again);
    require(text && twice && strcmp(text, twice) == 0);
    free(text);
    free(twice);
}

static void try_headers(const struct request *request) {
    static const uint64_t lengths[] = {0, 1, 100, UINT64_MAX - 1};
    for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) {
        uint64_t first = 0, last = 0;
        enum request_range range = request_range(request, lengths[i], &first, &last);
        require(range != RANGE_ONE || (first <= last && last < lengths[i]));
    }
    int64_t wait = request_prefer_wait_ms(request, 60000);
    require(wait >= -1 && wait <= 60000);
    request_prefers_async(request);
    request_none_match(request, "\"12\"");
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    struct request request = {.content_length = UINT64_MAX};
    char *lines[MAX_LINES];
    size_t count = 0;
    const char *text = (const char *)data, *end = text + size;
    while (text < end && count < MAX_LINES) {
        const char *newline = memchr(text, '\n', (size_t)(end - text));
        size_t length = (size_t)((newline ? newline : end) - text);
        lines[count] = copy(text, length);
        if (count) take_line(&request, lines[count], length);
        count++;
        text += length + 1;
    }
    if (count) {
        char *blank = strchr(lines[0], ' ');
        if (blank) *blank = 0;
        request.method = lines[0];
        request.path = blank ? blank + 1 : "/";
        routes_match(request.method, request.path, &request.match);
        request_read_framing(&request);
        request_identify(&request);
        try_params(&request);
        try_headers(&request);
    }
    for (size_t i = 0; i < count; i++) free(lines[i]);
    return 0;
}
