/* The document of a resumable upload.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_UPLOAD_JSON_H
#define WHITTLE_API_CODECS_UPLOAD_JSON_H

#include <stdint.h>

/* A view: it borrows everything.  Times are milliseconds since 1970 UTC. */
struct upload_document {
    const char *id, *metadata; /* metadata as the client sent it */
    const char *cloud;         /* sha256 of what it has become; "" = null */
    uint64_t offset, length;   /* length UINT64_MAX = null */
    int64_t created_ms, expires_ms;
};

/* Returns new text, NULL when memory runs out. */
char *upload_encode(const struct upload_document *upload);

#endif
