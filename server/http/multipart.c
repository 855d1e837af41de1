/* multipart/form-data as a stream.
 *
 *     PREAMBLE --delimiter--> MARK --CRLF--> HEADERS --empty line--> CONTENT --delimiter--> MARK --"--"--> EPILOGUE
 *
 * The delimiter is CRLF "--" boundary; the first one may begin the body, so matching starts as if a CRLF had come.  It
 * holds one CR, its first byte, so when a match breaks off after k bytes, these k bytes are content and the next match
 * can't begin before the present byte: that is all that has to be remembered between two pieces.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/multipart.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum { BOUNDARY_MAX = 70, DELIMITER_BYTES = BOUNDARY_MAX + 5 };

enum place { PREAMBLE, MARK, HEADERS, CONTENT, EPILOGUE };

struct multipart {
    struct multipart_sink sink;
    enum place place;
    uint64_t offset;      /* of the present byte in the body */
    size_t matched;       /* bytes of the delimiter */
    size_t mark, headers; /* bytes in the buffers below */
    size_t delimiter_bytes;
    char delimiter[DELIMITER_BYTES];
    char marks[2];                           /* what follows the delimiter */
    char header[MULTIPART_HEADER_BYTES + 1]; /* a part's header lines */
};

static bool broken(const struct multipart *m, const char *what, struct problem *problem) {
    problem_set(problem, PROBLEM_MALFORMED_REQUEST, "the form is malformed: %s", what);
    problem_add_number(problem, "byte_offset", (int64_t)m->offset);
    return false;
}

/* ------------------------------------------------------------------------------------------------ parameters */

/* Copies the value of `; name=value` or `; name="value"`, with \" and \\ undone; false: there is none, or it doesn't
 * fit. */
static bool read_parameter(const char *text, const char *name, char *value, size_t bytes) {
    size_t length = strlen(name), used = 0;
    const char *at = strchr(text, ';');
    for (; at; at = strchr(at, ';')) {
        at += 1 + strspn(at + 1, " \t");
        if (strncasecmp(at, name, length) == 0 && at[length] == '=') break;
        bool quoted = at[strcspn(at, "=;")] == '=' && at[strcspn(at, "=;") + 1] == '"';
        if (!quoted) continue;
        for (at += strcspn(at, "\"") + 1; *at && *at != '"'; at++)
            if (*at == '\\' && at[1]) at++;
    }
    if (!at) return false;
    at += length + 1;
    bool quoted = *at == '"';
    for (at += quoted; *at && (quoted ? *at != '"' : !strchr("; \t", *at)); at++) {
        if (quoted && *at == '\\' && at[1]) at++;
        if (used + 1 == bytes) return false;
        value[used++] = *at;
    }
    value[used] = 0;
    return !quoted || *at == '"';
}

struct multipart *multipart_new(const char *content_type, struct multipart_sink sink, struct problem *problem) {
    char boundary[BOUNDARY_MAX + 1];
    bool ok = read_parameter(content_type, "boundary", boundary, sizeof boundary) && boundary[0] &&
              !strpbrk(boundary, "\r\n");
    struct multipart *m = ok ? calloc(1, sizeof *m) : NULL;
    if (!m) {
        problem_set(problem, ok ? PROBLEM_INTERNAL_ERROR : PROBLEM_MALFORMED_REQUEST, "%s",
                    ok ? "no memory" : "Content-Type multipart/form-data needs a boundary of 1 to 70 characters");
        return NULL;
    }
    size_t length = strlen(boundary);
    m->sink = sink;
    memcpy(m->delimiter, "\r\n--", 4);
    memcpy(m->delimiter + 4, boundary, length);
    m->delimiter_bytes = length + 4;
    m->matched = 2;
    return m;
}

void multipart_free(struct multipart *multipart) { free(multipart); }

/* ------------------------------------------------------------------------------------------------ header lines */

static const char *value_of(const char *line, const char *name) {
    size_t length = strlen(name);
    if (strncasecmp(line, name, length) != 0 || line[length] != ':') return NULL;
    return line + length + 1 + strspn(line + length + 1, " \t");
}

static bool read_disposition(const struct multipart *m, const char *value, struct multipart_part *part,
                             struct problem *problem) {
    char file[MULTIPART_HEADER_BYTES];
    if (strncasecmp(value, "form-data", 9) != 0 || !strchr("; \t", value[9]))
        return broken(m, "a part's Content-Disposition isn't form-data", problem);
    if (!read_parameter(value, "name", part->name, sizeof part->name) || !part->name[0])
        return broken(m, "a part has no name, or one over 63 bytes", problem);
    part->is_file =
        read_parameter(value, "filename", file, sizeof file) || read_parameter(value, "filename*", file, sizeof file);
    return true;
}

static bool read_line(const struct multipart *m, const char *line, struct multipart_part *part,
                      struct problem *problem) {
    const char *value;
    if ((value = value_of(line, "Content-Disposition"))) return read_disposition(m, value, part, problem);
    if ((value = value_of(line, "Content-Type"))) {
        if (strlen(value) >= sizeof part->type) return broken(m, "a part's Content-Type is too long", problem);
        memcpy(part->type, value, strlen(value) + 1);
    }
    value = value_of(line, "Content-Transfer-Encoding");
    bool plain =
        !value || strcasecmp(value, "binary") == 0 || strcasecmp(value, "8bit") == 0 || strcasecmp(value, "7bit") == 0;
    return plain || broken(m, "a part's Content-Transfer-Encoding isn't binary", problem);
}

/* The lines in m->header, each ended by CRLF. */
static bool begin_part(struct multipart *m, struct problem *problem) {
    struct multipart_part part = {0};
    if (memchr(m->header, 0, m->headers)) return broken(m, "NUL in a part's headers", problem);
    m->header[m->headers] = 0;
    for (char *line = m->header; *line;) {
        char *end = strstr(line, "\r\n");
        *end = 0;
        if (!read_line(m, line, &part, problem)) return false;
        line = end + 2;
    }
    if (!part.name[0]) return broken(m, "a part has no Content-Disposition", problem);
    m->place = CONTENT;
    return m->sink.begin(m->sink.ctx, &part, problem);
}

/* One more byte of the header lines; the empty one ends them. */
static bool take_part_header(struct multipart *m, char byte, struct problem *problem) {
    if (m->headers == MULTIPART_HEADER_BYTES) return broken(m, "a part's headers are too long", problem);
    m->header[m->headers++] = byte;
    bool at_end = m->headers >= 2 && memcmp(m->header + m->headers - 2, "\r\n", 2) == 0;
    if (!at_end) return true;
    if (m->headers == 2) return broken(m, "a part has no headers", problem);
    if (m->headers < 4 || memcmp(m->header + m->headers - 4, "\r\n\r\n", 4) != 0) return true;
    m->headers -= 2;
    return begin_part(m, problem);
}

/* ------------------------------------------------------------------------------------------------ bytes */

/* What follows a delimiter: CRLF, maybe after blanks, or "--". */
static bool take_mark(struct multipart *m, char byte, struct problem *problem) {
    if (m->mark == 0 && (byte == ' ' || byte == '\t')) return true;
    m->marks[m->mark++] = byte;
    if (m->mark < 2) return true;
    m->mark = m->headers = 0;
    if (memcmp(m->marks, "\r\n", 2) == 0)
        m->place = HEADERS;
    else if (memcmp(m->marks, "--", 2) == 0)
        m->place = EPILOGUE;
    else
        return broken(m, "a boundary is followed by something else than the end of a line", problem);
    return true;
}

/* Hands on content; what comes before the first delimiter is nobody's. */
static bool give(struct multipart *m, const char *bytes, size_t count, struct problem *problem) {
    return !count || m->place == PREAMBLE || m->sink.bytes(m->sink.ctx, bytes, count, problem);
}

static bool end_content(struct multipart *m, struct problem *problem) {
    bool ok = m->place == PREAMBLE || m->sink.end(m->sink.ctx, problem);
    m->place = MARK;
    m->matched = 0;
    return ok;
}

/* Goes on with a match that has begun; returns how many bytes it took, and what turned out to be content is given. */
static size_t match_more(struct multipart *m, const char *bytes, size_t count, bool *ok, struct problem *problem) {
    size_t n = 0;
    while (n < count && m->matched < m->delimiter_bytes && bytes[n] == m->delimiter[m->matched]) n++, m->matched++;
    if (m->matched == m->delimiter_bytes) {
        *ok = end_content(m, problem);
    } else if (n < count) {
        size_t content = m->matched;
        m->matched = 0;
        *ok = give(m, m->delimiter, content, problem);
    }
    return n;
}

/* Content up to the next CR; returns how many bytes it took, at least one. */
static size_t take_content(struct multipart *m, const char *bytes, size_t count, bool *ok, struct problem *problem) {
    if (m->matched || *bytes == '\r') {
        size_t n = match_more(m, bytes, count, ok, problem);
        if (n || m->matched || !*ok) return n;
    }
    const char *next = memchr(bytes + 1, '\r', count - 1);
    size_t n = *bytes == '\r' ? 0 : next ? (size_t)(next - bytes) : count;
    if (n) *ok = give(m, bytes, n, problem);
    return n;
}

bool multipart_push(struct multipart *m, const void *data, size_t count, struct problem *problem) {
    const char *bytes = data;
    bool ok = true;
    while (ok && count) {
        size_t n = 1;
        switch (m->place) {
        case PREAMBLE:
        case CONTENT: n = take_content(m, bytes, count, &ok, problem); break;
        case MARK: ok = take_mark(m, *bytes, problem); break;
        case HEADERS: ok = take_part_header(m, *bytes, problem); break;
        case EPILOGUE: n = count; break;
        }
        bytes += n;
        count -= n;
        m->offset += n;
    }
    return ok;
}

bool multipart_end(struct multipart *m, struct problem *problem) {
    return m->place == EPILOGUE || broken(m, "it ends before its last boundary", problem);
}
