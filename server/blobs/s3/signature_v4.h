/* AWS Signature Version 4, as far as an S3 store needs it: every request is signed with its headers and the hash of its
 * body.  Source: AWS, "Create a signed AWS API request".
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BLOBS_S3_SIGNATURE_V4_H
#define WHITTLE_SERVER_BLOBS_S3_SIGNATURE_V4_H

#include <stdbool.h>
#include <stddef.h>

enum { SIGNATURE_V4_BYTES = 512, SIGNATURE_V4_DATE_BYTES = 17 };

struct signature_v4_keys {
    char access[129], secret[129], region[64];
};

/* What is signed.  path and query are encoded already, the query's parameters sorted; copy_source NULL = none. */
struct signature_v4_request {
    const char *method, *host, *path, *query, *body_sha256, *copy_source;
    char date[SIGNATURE_V4_DATE_BYTES]; /* 20260131T120000Z */
};

/* The value of the header Authorization; false when memory runs out. */
bool signature_v4_make(const struct signature_v4_keys *keys, const struct signature_v4_request *request,
                       char value[SIGNATURE_V4_BYTES]);

/* The signature of a URL that anybody may GET for so many seconds from its date on: query (of request; encoded, sorted)
 * gets its parameters, which sort before those that it holds.  false: memory runs out, or room does. */
bool signature_v4_presign(const struct signature_v4_keys *keys, const struct signature_v4_request *request,
                          unsigned seconds, char *query, size_t bytes);

#endif
