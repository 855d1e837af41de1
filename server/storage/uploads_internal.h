/* What keeps resumable uploads: a host's own files (uploads_local.c), or pieces that all hosts share
 * (uploads_shared.c).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_STORAGE_UPLOADS_INTERNAL_H
#define WHITTLE_SERVER_STORAGE_UPLOADS_INTERNAL_H

#include <pthread.h>

#include "server/storage/uploads.h"

/* One function for each of uploads.h, with the prototype that it has there. */
struct uploads_kind {
    enum status (*open)(struct catalog *catalog, struct store *store, struct uploads **uploads, struct error *error);
    __typeof__(uploads_close) *close;
    __typeof__(uploads_find) *find;
    __typeof__(uploads_find_final) *find_final;
    __typeof__(uploads_create) *create;
    __typeof__(uploads_resume) *resume;
    __typeof__(uploads_interrupt) *interrupt;
    __typeof__(uploads_write) *write;
    __typeof__(uploads_end) *end;
    __typeof__(uploads_writer_free) *writer_free;
    __typeof__(uploads_gather) *gather;
    __typeof__(uploads_complete) *complete;
    __typeof__(uploads_delete) *delete;
    __typeof__(uploads_sweep) *sweep;
    __typeof__(uploads_move_ends) *move_ends;
};

extern const struct uploads_kind uploads_local, uploads_shared;

/* The first member of both kinds' own. */
struct uploads {
    const struct uploads_kind *kind;
    pthread_mutex_t turns_lock;
    pthread_cond_t turn_ended;
    struct uploads_turn *turns; /* of those who have one */
};

struct uploads_writer {
    const struct uploads_kind *kind;
};

/* Whether the hash of the piece, which is complete, is the one that came with it; digest NULL: none did. */
bool uploads_check_piece(const struct uploads_check *check, struct digest *digest, struct problem *problem);

#endif
