/* Requests to an S3 store, by libcurl: one object or one listing each, signed, with a deadline.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BLOBS_S3_S3_CLIENT_H
#define WHITTLE_SERVER_BLOBS_S3_S3_CLIENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

struct s3_client;

/* s3://bucket/prefix?endpoint=URL, without its scheme; other parameters are region (us-east-1), keys (a file with a
 * line access:secret; else AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY of the environment) and ca (a file of
 * certificates). */
bool s3_client_valid(const char *where);
enum status s3_client_open(const char *where, struct s3_client **client, struct error *error) MUST_CHECK;
void s3_client_close(struct s3_client *client);

/* A request, and what came of it. */
struct s3_request {
    const char *method;  /* GET, HEAD, PUT, DELETE */
    const char *name;    /* of an object, below the prefix; NULL = of the bucket */
    const char *query;   /* sorted, encoded; NULL = none */
    const char *copy_of; /* PUT: the name of another object; NULL = the bytes of body_fd */
    int body_fd;         /* PUT: read from its start */
    uint64_t body_bytes;
    const char *sha256; /* of the body, which the store checks; NULL = of an empty one */
    int to_fd;          /* GET: where the object goes, -1 = into text */
    char *text;         /* the answer's; the caller's to free */
};

/* *code is the answer's status.  STATUS_IO: there was none, though it was asked three times. */
enum status s3_client_ask(struct s3_client *client, struct s3_request *request, int *code,
                          struct error *error) MUST_CHECK;

/* The prefix of all names, "" or with a slash at its end. */
const char *s3_client_prefix(const struct s3_client *client);

/* Encodes a text for a query; returns new, NULL when memory runs out. */
char *s3_client_encode(const char *text);

#endif
