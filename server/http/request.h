/* A request as the handlers see it, and the response that they make.  No type of the HTTP library appears here.
 *
 * A handler is a plain function that may block: it runs on a thread of the pool while its connection is suspended. When
 * it can't answer yet it says RESPONSE_WAIT and is called again, with the same request, when the job it waits for has
 * changed, its deadline has come, or the client is gone.  An event stream is the same: RESPONSE_STREAM gives the next
 * piece of text, and the handler is called again when there may be more.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_REQUEST_H
#define WHITTLE_SERVER_HTTP_REQUEST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api/query.h"
#include "api/routes.h"
#include "server/auth/principal.h"
#include "server/catalog/catalog.h"
#include "server/http/body.h"
#include "server/http/response.h"
#include "server/jobs/change_feed.h"

enum request_header {
    HEADER_RANGE,
    HEADER_IF_RANGE,
    HEADER_IF_NONE_MATCH,
    HEADER_PREFER,
    HEADER_EXPECT,
    HEADER_CONTENT_TYPE,
    HEADER_CONTENT_ENCODING,
    HEADER_CONTENT_LENGTH,
    HEADER_TRANSFER_ENCODING,
    HEADER_LAST_EVENT_ID,
    HEADER_HOST,
    HEADER_AUTHORIZATION,
    HEADER_REQUEST_ID,
    HEADER_TRACEPARENT,
    HEADER_CACHE_CONTROL,
    HEADER_IDEMPOTENCY_KEY,
    HEADER_CONTENT_DIGEST,
    HEADER_METHOD_OVERRIDE,
    HEADER_TUS_RESUMABLE,
    HEADER_UPLOAD_LENGTH,
    HEADER_UPLOAD_DEFER_LENGTH,
    HEADER_UPLOAD_OFFSET,
    HEADER_UPLOAD_METADATA,
    HEADER_UPLOAD_CHECKSUM,
    HEADER_UPLOAD_CONCAT,
    HEADER_UPLOAD_COMPLETE,
    HEADER_UPLOAD_DRAFT, /* Upload-Draft-Interop-Version */
    HEADER_REPR_DIGEST,
    HEADER_ACCEPT,
    HEADER_IF_MATCH,
    HEADER_ORIGIN,
    HEADER_SEC_FETCH_SITE,
    HEADER_REQUEST_METHOD,
    HEADER_ACCEPT_ENCODING,
    HEADER_FORWARDED_PROTO
};
#define HEADER_COUNT (HEADER_FORWARDED_PROTO + 1)

/* "Range", ... */
extern const char *const message_header_names[HEADER_COUNT];

enum { REQUEST_MAX_QUERY = 64, REQUEST_JOINED_BYTES = 4096 };

/* What a handler waits for, and keeps between its calls. */
struct request_wait {
    unsigned calls;           /* how often the handler was called before */
    enum change_feed_why why; /* why it is called again */
    char id[JOB_ID_BYTES];
    char batch[JOB_ID_BYTES]; /* that the request has made; the handler's own */
    uint64_t seen;            /* change_feed_now before the job was read */
    int64_t deadline_ms;      /* of this wait, by clock_ms */
    int64_t end_ms;           /* of all waiting; the handler's own */
    uint64_t sequence;        /* of the job when it was read last; the handler's own */
    int state;                /* the same */
};

enum { REQUEST_ID_BYTES = 65 };

struct request {
    char id[REQUEST_ID_BYTES]; /* the client's, or made here; in the log and the response */
    const char *method, *path;
    bool head;
    bool secure; /* came by TLS */
    struct route_match match;
    struct principal principal; /* whose request it is */
    struct query_pair query[REQUEST_MAX_QUERY];
    size_t query_count, argument_count; /* argument_count: with what stands empty between two "&" */
    const char *header[HEADER_COUNT];   /* NULL = absent */
    const char *fault;                  /* what makes the head ambiguous or malformed; NULL = nothing */
    bool nowhere;                       /* its path is none that could be ours, whatever it seems to be decoded */
    char joined[REQUEST_JOINED_BYTES];  /* lists that came in more than one line */
    size_t joined_bytes;
    bool has_body;
    bool tus;                      /* of a resumable upload: every answer says so */
    uint64_t content_length;       /* UINT64_MAX = not known */
    struct body *body;             /* complete, for body_end; NULL = the operation takes none */
    struct catalog_key_hold claim; /* on the request's Idempotency-Key */
    struct request_wait wait;
};

/* Takes a header or an argument, as they come; texts are borrowed and end in NUL.  What must not be is told in
 * request->fault. */
void request_take_header(struct request *request, const char *name, const char *value, size_t value_bytes);
void request_take_argument(struct request *request, const char *name, size_t name_bytes, const char *value,
                           size_t value_bytes);

/* Whether there is a body, and how long it is, when all headers are there.  A framing that two readers could understand
 * in two ways is a fault. */
void request_read_framing(struct request *request);

/* Fills in request->id: of X-Request-Id or traceparent where these are well-formed, else random. */
void request_identify(struct request *request);

/* What a header says that holds one item of RFC 9651: a boolean, ?0 or ?1, or a whole number of up to 15 digits; it may
 * have parameters, which mean nothing here.  FLAG_MALFORMED, false: it is there, and is none. */
enum request_flag { FLAG_ABSENT, FLAG_FALSE, FLAG_TRUE, FLAG_MALFORMED };
enum request_flag request_flag(const struct request *request, enum request_header header);
bool request_integer(const struct request *request, enum request_header header, int64_t *number);

/* Seconds of `Prefer: wait=N` (up to max_ms, in ms); -1 where there is none.  And whether it holds respond-async. */
int64_t request_prefer_wait_ms(const struct request *request, int64_t max_ms);
bool request_prefers_async(const struct request *request);

/* Whether Accept, if it is there, allows this media type ("model/ply"; no parameters). */
bool request_accepts(const struct request *request, const char *media_type);

/* Whether the list of entity tags in If-None-Match holds this one (with quotes, compared weakly) or is *. */
bool request_none_match(const struct request *request, const char *etag);

/* Whether If-Match, if it is there, holds this entity tag (compared strongly) or is *; etag NULL: the content has none,
 * and only * is right. */
bool request_match(const struct request *request, const char *etag);

/* One range of bytes asked for: RANGE_NONE also where it is malformed or more than one, which means the whole. */
enum request_range { RANGE_NONE, RANGE_ONE, RANGE_UNSATISFIABLE };
enum request_range request_range(const struct request *request, uint64_t bytes, uint64_t *first, uint64_t *last);

#endif
