/* multipart/form-data (RFC 7578) as a stream: bytes are pushed in, parts come out through callbacks, none is kept.
 *
 * A part's header lines may have MULTIPART_HEADER_BYTES together.  Nothing but the boundary and these lines is in
 * memory.  What breaks the format is refused, with the byte offset.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_MULTIPART_H
#define WHITTLE_SERVER_HTTP_MULTIPART_H

#include <stdbool.h>
#include <stddef.h>

#include "api/problem.h"

enum { MULTIPART_HEADER_BYTES = 4096, MULTIPART_NAME_BYTES = 64, MULTIPART_TYPE_BYTES = 128 };

/* What a part's headers say. */
struct multipart_part {
    char name[MULTIPART_NAME_BYTES];
    char type[MULTIPART_TYPE_BYTES]; /* its Content-Type; "" = none */
    bool is_file;                    /* it has a filename */
};

/* begin, then bytes any number of times, then end, for each part in turn.  false: *problem says why, and nothing more
 * is called. */
struct multipart_sink {
    bool (*begin)(void *ctx, const struct multipart_part *part, struct problem *problem);
    bool (*bytes)(void *ctx, const void *bytes, size_t count, struct problem *problem);
    bool (*end)(void *ctx, struct problem *problem);
    void *ctx;
};

struct multipart;

/* content_type holds the boundary.  NULL: *problem says why.  multipart_free accepts NULL. */
struct multipart *multipart_new(const char *content_type, struct multipart_sink sink, struct problem *problem);
void multipart_free(struct multipart *multipart);

/* Takes the next bytes; false: *problem says why, and no more may be given. */
bool multipart_push(struct multipart *multipart, const void *bytes, size_t count, struct problem *problem);

/* All bytes were pushed; false: the form isn't complete. */
bool multipart_end(struct multipart *multipart, struct problem *problem);

#endif
