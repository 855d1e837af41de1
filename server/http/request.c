/* Requests: reading what headers say.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/request.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "server/base/random.h"

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
    [HEADER_UPLOAD_COMPLETE] = "Upload-Complete",
    [HEADER_UPLOAD_DRAFT] = "Upload-Draft-Interop-Version",
    [HEADER_REPR_DIGEST] = "Repr-Digest",
    [HEADER_ACCEPT] = "Accept",
    [HEADER_IF_MATCH] = "If-Match",
    [HEADER_ORIGIN] = "Origin",
    [HEADER_SEC_FETCH_SITE] = "Sec-Fetch-Site",
    [HEADER_REQUEST_METHOD] = "Access-Control-Request-Method",
    [HEADER_ACCEPT_ENCODING] = "Accept-Encoding",
    [HEADER_FORWARDED_PROTO] = "X-Forwarded-Proto",
    [HEADER_AUTHORIZATION] = "Authorization",
    [HEADER_REQUEST_ID] = "X-Request-Id",
    [HEADER_TRACEPARENT] = "traceparent",
    [HEADER_CACHE_CONTROL] = "Cache-Control",
    [HEADER_IDEMPOTENCY_KEY] = "Idempotency-Key",
};

/* Headers whose repetition makes a request mean two things. */
static bool is_single(size_t header) {
    static const enum request_header single[] = {HEADER_HOST,
                                                 HEADER_CONTENT_LENGTH,
                                                 HEADER_TRANSFER_ENCODING,
                                                 HEADER_CONTENT_TYPE,
                                                 HEADER_AUTHORIZATION,
                                                 HEADER_IDEMPOTENCY_KEY,
                                                 HEADER_ORIGIN,
                                                 HEADER_SEC_FETCH_SITE,
                                                 HEADER_TUS_RESUMABLE,
                                                 HEADER_UPLOAD_LENGTH,
                                                 HEADER_UPLOAD_OFFSET,
                                                 HEADER_UPLOAD_DEFER_LENGTH,
                                                 HEADER_UPLOAD_CHECKSUM,
                                                 HEADER_UPLOAD_CONCAT,
                                                 HEADER_UPLOAD_METADATA,
                                                 HEADER_UPLOAD_COMPLETE,
                                                 HEADER_UPLOAD_DRAFT};
    for (size_t i = 0; i < sizeof single / sizeof *single; i++)
        if (single[i] == header) return true;
    return false;
}

/* Headers whose value is a list, so that a second line goes on where the first one ends. */
static bool is_list(size_t header) {
    static const enum request_header lists[] = {HEADER_IF_MATCH,       HEADER_IF_NONE_MATCH,   HEADER_PREFER,
                                                HEADER_ACCEPT,         HEADER_ACCEPT_ENCODING, HEADER_CACHE_CONTROL,
                                                HEADER_CONTENT_DIGEST, HEADER_REPR_DIGEST};
    for (size_t i = 0; i < sizeof lists / sizeof *lists; i++)
        if (lists[i] == header) return true;
    return false;
}

/* "before, value", in the request's own memory. */
static const char *join(struct request *request, const char *before, const char *value) {
    char *to = request->joined + request->joined_bytes;
    size_t room = sizeof request->joined - request->joined_bytes;
    int n = snprintf(to, room, "%s, %s", before, value);
    if (n < 0 || (size_t)n >= room) {
        request->fault = "a list of more than one line is too long";
        return value;
    }
    request->joined_bytes += (size_t)n + 1;
    return to;
}

static bool is_token(const char *name) {
    static const char allowed[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789!#$%&'*+-.^_`|~";
    return name[0] && !name[strspn(name, allowed)];
}

/* Whether the name goes on behind that of a header which says where a request ends.  libmicrohttpd makes such names of
 * lines that are folded, which others read as the header itself. */
static bool is_framing_and_more(const char *name) {
    static const enum request_header framing[] = {HEADER_CONTENT_LENGTH, HEADER_TRANSFER_ENCODING};
    for (size_t i = 0; i < sizeof framing / sizeof *framing; i++) {
        size_t length = strlen(message_header_names[framing[i]]);
        if (strncasecmp(name, message_header_names[framing[i]], length) == 0 && name[length]) return true;
    }
    return false;
}

void request_take_header(struct request *request, const char *name, const char *value, size_t value_bytes) {
    if (!is_token(name) || is_framing_and_more(name)) request->fault = "a header's name is malformed";
    if (strlen(value) != value_bytes) request->fault = "a header holds NUL";
    if (strpbrk(value, "\r\n")) request->fault = "a header holds the end of a line";
    for (size_t i = 0; i < HEADER_COUNT; i++) {
        if (strcasecmp(name, message_header_names[i]) != 0) continue;
        const char *before = request->header[i];
        if (is_single(i) && before) request->fault = "a header comes twice that may come once";
        request->header[i] = before && is_list(i) ? join(request, before, value) : value;
    }
}

void request_take_argument(struct request *request, const char *name, size_t name_bytes, const char *value,
                           size_t value_bytes) {
    bool has_nul = strlen(name) != name_bytes || (value && strlen(value) != value_bytes);
    bool is_nothing = name_bytes == 0 && !value; /* between two "&" */
    if (has_nul) request->fault = "an argument holds NUL";
    if (request->argument_count++ == REQUEST_MAX_QUERY) request->fault = "there are too many arguments";
    if (!is_nothing && request->query_count < REQUEST_MAX_QUERY)
        request->query[request->query_count++] = (struct query_pair){name, value};
}

static bool read_length(const char *text, uint64_t *length) {
    char *end;
    if (text[0] < '0' || text[0] > '9' || strlen(text) > 18) return false;
    *length = strtoull(text, &end, 10);
    return !*end;
}

/* HOST[:PORT], or [ADDRESS][:PORT], as far as what is in it goes. */
static bool is_host(const char *text) {
    static const char name[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-_~%!$&'()*+,;=";
    static const char address[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-_~!$&'()*+,;=:";
    const char *end = text + strspn(text, name);
    if (text[0] == '[') {
        end = text + 1 + strspn(text + 1, address);
        if (*end++ != ']') return false;
    }
    size_t digits = *end == ':' ? strspn(end + 1, "0123456789") : 0;
    if (*end == ':') end += 1 + digits;
    return !*end && digits <= 5 && (!digits || strtol(end - digits, NULL, 10) <= UINT16_MAX);
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
    else if (request->header[HEADER_HOST] && !is_host(request->header[HEADER_HOST]))
        request->fault = "Host is no host";
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
        random_fill(&random, sizeof random);
        snprintf(request->id, sizeof request->id, "%016llx", (unsigned long long)random);
    }
}

/* ------------------------------------------------------------------------------------------------ items of RFC 9651 */

static const char small_letters[] = "abcdefghijklmnopqrstuvwxyz", decimals[] = "0123456789";

/* What follows a quoted string, from its first quote on; NULL: it doesn't end, or holds what it can't. */
static const char *skip_string(const char *at) {
    for (at++; *at != '"'; at++) {
        if (*at == '\\' && at[1] != '"' && at[1] != '\\') return NULL;
        if (*at == '\\') at++;
        if (*at < ' ' || *at > '~') return NULL;
    }
    return at + 1;
}

/* What follows a parameter's value: a number, a date, a boolean, bytes between colons, a string, or a token; NULL: it
 * is none of these. */
static const char *skip_value(const char *at) {
    static const char token[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789!#$%&'*+-.^_`|~:/";
    static const char base64[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+/=";
    if (*at == '"') return skip_string(at);
    if (*at == '%') return at[1] == '"' ? skip_string(at + 1) : NULL;
    if (*at == '?') return at[1] == '0' || at[1] == '1' ? at + 2 : NULL;
    if (*at == ':') {
        at += 1 + strspn(at + 1, base64);
        return *at == ':' ? at + 1 : NULL;
    }
    if (*at == '*' || (*at >= 'a' && *at <= 'z') || (*at >= 'A' && *at <= 'Z')) return at + strspn(at, token);
    bool is_date = *at == '@';
    at += is_date;
    at += *at == '-';
    size_t whole = strspn(at, decimals), part = at[whole] == '.' ? strspn(at + whole + 1, decimals) : 0;
    bool has_point = at[whole] == '.';
    if (!whole || whole > (has_point ? 12 : 15) || (has_point && (is_date || !part || part > 3))) return NULL;
    return at + whole + has_point + part;
}

/* Whether what follows an item is parameters, and blanks at the end. */
static bool are_parameters(const char *at) {
    static const char key[] = "abcdefghijklmnopqrstuvwxyz0123456789_-.*";
    while (at && *at == ';') {
        at += 1 + strspn(at + 1, " ");
        if (*at != '*' && !(*at && strchr(small_letters, *at))) return false;
        at += strspn(at, key);
        if (*at == '=') at = skip_value(at + 1);
    }
    return at && !at[strspn(at, " ")];
}

enum request_flag request_flag(const struct request *request, enum request_header header) {
    const char *text = request->header[header];
    if (!text) return FLAG_ABSENT;
    text += strspn(text, " ");
    if (text[0] != '?' || (text[1] != '0' && text[1] != '1') || !are_parameters(text + 2)) return FLAG_MALFORMED;
    return text[1] == '1' ? FLAG_TRUE : FLAG_FALSE;
}

bool request_integer(const struct request *request, enum request_header header, int64_t *number) {
    const char *text = request->header[header];
    text += text ? strspn(text, " ") : 0;
    size_t sign = text && *text == '-', digits = text ? strspn(text + sign, decimals) : 0;
    if (!digits || digits > 15 || !are_parameters(text + sign + digits)) return false;
    *number = strtoll(text, NULL, 10);
    return true;
}

/* ------------------------------------------------------------------------------------------------ preferences */

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

/* Whether "type/subtype", "type/" and a star, or two stars, of n characters, cover the media type. */
static bool covers(const char *range, size_t n, const char *media_type) {
    size_t type = strcspn(media_type, "/") + 1;
    if (n == 3 && memcmp(range, "*/*", 3) == 0) return true;
    if (n == type + 1 && range[type] == '*') return strncasecmp(range, media_type, type) == 0;
    return n == strlen(media_type) && strncasecmp(range, media_type, n) == 0;
}

/* Whether parameters, up to n characters, hold q=0, which excludes. */
static bool excludes(const char *parameters, size_t n) {
    for (const char *q = parameters, *end = parameters + n; (q = memchr(q, ';', (size_t)(end - q)));) {
        q += 1 + strspn(q + 1, " \t");
        if (end - q >= 3 && strncasecmp(q, "q=0", 3) == 0) return strspn(q + 3, ".0") == strcspn(q + 3, ",; \t");
    }
    return false;
}

bool request_accepts(const struct request *request, const char *media_type) {
    const char *list = request->header[HEADER_ACCEPT];
    bool accepts = !list || !list[strspn(list, " \t,")];
    for (; list && *list; list += *list == ',') {
        list += strspn(list, " \t");
        size_t n = strcspn(list, ",; \t"), whole = strcspn(list, ",");
        if (covers(list, n, media_type) && !excludes(list + n, whole - n)) accepts = true;
        list += whole;
    }
    return accepts;
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

bool request_match(const struct request *request, const char *etag) {
    const char *list = request->header[HEADER_IF_MATCH];
    size_t length = etag ? strlen(etag) : 0;
    if (!list) return true;
    while (*list) {
        list += strspn(list, " \t,");
        if (list[0] == '*') return true;
        if (etag && strncmp(list, etag, length) == 0 && strchr(", \t", list[length])) return true;
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
