/* Requests to an S3 store, by libcurl: one object or one listing each, signed, with a deadline.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BLOBS_S3_S3_CLIENT_H
#define WHITTLE_SERVER_BLOBS_S3_S3_CLIENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "server/blobs/blobs.h"

struct s3_client;

/* s3://bucket/prefix?endpoint=URL, without its scheme; other parameters are region (us-east-1), keys (a file with a
 * line access:secret; else AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY of the environment), ca (a file of
 * certificates), style (path: the bucket is in the path; host: in front of the endpoint's host) and part (64: objects
 * of more MiB are put in parts of so many; 5 to 5000). */
bool s3_client_valid(const char *where);
enum status s3_client_open(const char *where, struct s3_client **client, struct error *error) MUST_CHECK;
void s3_client_close(struct s3_client *client);

enum { S3_ETAG_BYTES = 72 };

/* A request, and what came of it. */
struct s3_request {
    const char *method;  /* GET, HEAD, PUT, POST, DELETE */
    const char *name;    /* of an object, below the prefix; NULL = of the bucket */
    const char *query;   /* sorted, encoded; NULL = none */
    const char *copy_of; /* PUT: the name of another object; NULL = the bytes of body_fd */
    int body_fd;         /* PUT: body_bytes of it, from body_offset on */
    uint64_t body_offset, body_bytes;
    const char *body_text; /* POST */
    const char *sha256;    /* of the body, which the store checks; NULL = of an empty one */
    int to_fd;             /* GET: where the object goes, -1 = into text */
    bool is_range;         /* GET: bytes first to last alone, which go to the same places of to_fd; 206 */
    uint64_t first, last;
    struct blobs_facts expected; /* GET: what is known of the object; a range is not hashed */
    const char *ends_with;       /* what the text of an answer of 200 has, where it is whole; NULL = anything */
    char *text;                  /* the answer's, where it isn't an object; the caller's to free */
    char etag[S3_ETAG_BYTES];    /* the answer's, with its quotes; "" = it has none, or a longer one */
    int64_t signed_ms;           /* as of when it is signed, of clock_ms; 0 = now */
    unsigned valid_s; /* how long the store takes it from then on, which its URL says; 0 = as long as usual (a quarter
                       * of an hour) */
    int tries;        /* how often it was made; all but the last may still come to the store */
};

/* *code is the answer's status: of the store, for who stands in between says it otherwise (below).  All is asked three
 * times.  STATUS_IO: there was no answer, or none of the store's, or it broke off.  STATUS_MALFORMED: what came is not
 * what is known of it. */
enum status s3_client_ask(struct s3_client *client, struct s3_request *request, int *code,
                          struct error *error) MUST_CHECK;

/* How many bytes a part has. */
uint64_t s3_client_part_bytes(const struct s3_client *client);

/* A URL of the object that anybody may GET for so many seconds, who is told this type and disposition then. */
bool s3_client_presign(struct s3_client *client, const char *name, unsigned seconds, const char *type,
                       const char *disposition, char *url, size_t bytes);

/* The prefix of all names, "" or with a slash at its end. */
const char *s3_client_prefix(const struct s3_client *client);

/* Encodes a text for a query; returns new, NULL when memory runs out. */
char *s3_client_encode(const char *text);

#endif
