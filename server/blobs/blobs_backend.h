/* What a blob store implements; for the backends and blobs.c alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BLOBS_BLOBS_BACKEND_H
#define WHITTLE_SERVER_BLOBS_BLOBS_BACKEND_H

#include "server/blobs/blobs.h"

/* One function for each of blobs.h, with the prototype that it has there. */
struct blobs_backend {
    const char *scheme; /* of its URLs, such as "file:"; `where` is what follows it */
    bool is_remote;     /* blobs_is_remote */
    bool (*is_valid)(const char *where);
    enum status (*open)(const char *where, const char *folder, struct blobs **blobs, struct error *error);
    __typeof__(blobs_close) *close;
    __typeof__(blobs_put) *put;
    __typeof__(blobs_copy) *copy;
    __typeof__(blobs_read) *read;
    __typeof__(blobs_read_range) *read_range; /* NULL = read does as well */
    __typeof__(blobs_link) *link;             /* NULL = there are none */
    __typeof__(blobs_give_up) *give_up;       /* NULL = nothing stays unfinished */
    __typeof__(blobs_exist) *exist;
    __typeof__(blobs_remove) *remove;
    __typeof__(blobs_list) *list;
    __typeof__(blobs_set_aside) *set_aside;
};

struct blobs {
    const struct blobs_backend *backend;
    struct blobs_unfinished unfinished; /* begins NULL = nobody is told */
};

/* All there are.  Another one is a file or a folder here, and a row. */
#define BLOBS_BACKENDS(ROW)                                                                                            \
    ROW(blobs_file)                                                                                                    \
    ROW(blobs_s3)

#define BLOBS_BACKEND(name) extern const struct blobs_backend name;
BLOBS_BACKENDS(BLOBS_BACKEND)
#undef BLOBS_BACKEND

#endif
