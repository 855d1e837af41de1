/* A request's body on its way in: undone of its content coding, its digest checked, and taken apart.
 *
 *     bytes -> digest -> gzip or zstd undone -> cloud, streamed to disk
 *                                            -> form: its `file` is the cloud, its other fields are parameters
 *                                            -> JSON document: names a cloud that is here, and parameters
 *                                            -> a piece of a resumable upload
 *
 * Nothing of it is kept unless whoever has called body_end makes it so.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_BODY_H
#define WHITTLE_SERVER_HTTP_BODY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api/problem.h"
#include "api/query.h"
#include "server/storage/store.h"
#include "server/storage/upload.h"
#include "server/storage/uploads.h"

/* What an operation takes: a set. */
enum body_kind { BODY_CLOUD = 1, BODY_FORM = 2, BODY_JSON = 4, BODY_PIECE = 8 };

/* What the request's headers say (NULL = absent), and the limits; all borrowed for as long as the body lives. */
struct body_plan {
    unsigned takes; /* a set of enum body_kind */
    struct store *store;
    struct thread_pool *threads; /* for hashing while bytes come */
    uint64_t max_bytes; /* of the body as it comes, and of the cloud; text and fields have limits of their own */
    struct admission admission; /* of the cloud */
    uint32_t max_expansion;     /* bytes of the cloud for each byte of a compressed body */
    uint64_t content_length;    /* UINT64_MAX = not known */
    const char *type, *coding, *content_digest, *repr_digest;
    struct uploads_writer
        *writer;              /* for BODY_PIECE: takes the bytes; the body's from body_new on, also where it fails */
    const char *const *names; /* members that a document may have besides input and params; NULL-terminated */
    const char *input;        /* of a document that names no input itself: the cloud's id; NULL = it has to */
};

struct body;

/* Starts one.  NULL: *problem says why, for instance because nothing of this media type or coding is taken.  Doesn't
 * block for long.  body_free accepts NULL. */
struct body *body_new(const struct body_plan *plan, struct problem *problem);
void body_free(struct body *body);

/* Takes the next bytes; false: *problem says why, and no more may be given. */
bool body_write(struct body *body, const void *bytes, size_t count, struct problem *problem);

/* All bytes were given: the last checks.  false: *problem says why. */
bool body_end(struct body *body, struct problem *problem);

/* The cloud in the body, complete and checked by its first bytes; NULL where the body only names one. */
struct upload *body_upload(struct body *body);

/* Frees the upload early: it is kept, or not wanted. */
void body_drop_upload(struct body *body);

/* Who takes the piece of a resumable upload. */
struct uploads_writer *body_writer(struct body *body);

/* The cloud that the body names; "" where it holds one. */
const char *body_input(const struct body *body);

/* How many clouds more are one with that, and the i-th of them. */
size_t body_joined(const struct body *body);
const char *body_joined_cloud(const struct body *body, size_t i);

/* What was only named is in this upload now, which the body takes. */
void body_take_upload(struct body *body, struct upload *upload);

/* Names and values in the body, as a query holds them; borrowed.  Returns how many, which may be
 * more than max, the room in pairs. */
size_t body_pairs(const struct body *body, struct query_pair *pairs, size_t max);

#endif
