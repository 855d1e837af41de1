/* Resumable uploads: picks the kind, and hands every use to it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/uploads_internal.h"

#include <string.h>

#include "server/base/digest.h"

enum status uploads_open(struct catalog *catalog, struct store *store, bool is_shared, struct uploads **uploads,
                         struct error *error) {
    enum status status = (is_shared ? uploads_shared : uploads_local).open(catalog, store, uploads, error);
    if (status != STATUS_OK) return status;
    pthread_mutex_init(&(*uploads)->turns_lock, NULL);
    pthread_cond_init(&(*uploads)->turn_ended, NULL);
    return STATUS_OK;
}

void uploads_close(struct uploads *uploads) {
    if (!uploads) return;
    pthread_cond_destroy(&uploads->turn_ended);
    pthread_mutex_destroy(&uploads->turns_lock);
    uploads->kind->close(uploads);
}

enum status uploads_find(struct uploads *uploads, const char *id, struct catalog_upload *info, bool *found,
                         struct error *error) {
    return uploads->kind->find(uploads, id, info, found, error);
}

enum status uploads_find_final(struct uploads *uploads, const char *principal, const char *concat,
                               struct catalog_upload *info, bool *found, struct error *error) {
    return uploads->kind->find_final(uploads, principal, concat, info, found, error);
}

struct uploads_writer *uploads_create(struct uploads *uploads, struct catalog_upload *info,
                                      const struct uploads_check *check, const struct uploads_limits *limits,
                                      struct problem *problem) {
    return uploads->kind->create(uploads, info, check, limits, problem);
}

struct uploads_writer *uploads_resume(struct uploads *uploads, const char *id, uint64_t offset, uint64_t length,
                                      const struct uploads_check *check, uint64_t principal_bytes,
                                      struct problem *problem) {
    return uploads->kind->resume(uploads, id, offset, length, check, principal_bytes, problem);
}

enum status uploads_interrupt(struct uploads *uploads, const char *id, struct error *error) {
    return uploads->kind->interrupt(uploads, id, error);
}

bool uploads_write(struct uploads_writer *writer, const void *bytes, size_t count, struct problem *problem) {
    return writer->kind->write(writer, bytes, count, problem);
}

bool uploads_end(struct uploads_writer *writer, int64_t expires_ms, struct catalog_upload *info,
                 struct problem *problem) {
    return writer->kind->end(writer, expires_ms, info, problem);
}

void uploads_writer_free(struct uploads_writer *writer) {
    if (writer) writer->kind->writer_free(writer);
}

/* Under the lock. */
static bool has_turn(const struct uploads *uploads, const char *id) {
    const struct uploads_turn *turn = uploads->turns;
    while (turn && strcmp(turn->id, id) != 0) turn = turn->next;
    return turn != NULL;
}

bool uploads_take_turn(struct uploads *uploads, const char *id, struct uploads_turn *turn) {
    bool waited = false;
    pthread_mutex_lock(&uploads->turns_lock);
    for (; has_turn(uploads, id); waited = true) pthread_cond_wait(&uploads->turn_ended, &uploads->turns_lock);
    *turn = (struct uploads_turn){.id = id, .next = uploads->turns};
    uploads->turns = turn;
    pthread_mutex_unlock(&uploads->turns_lock);
    return waited;
}

void uploads_end_turn(struct uploads *uploads, struct uploads_turn *turn) {
    pthread_mutex_lock(&uploads->turns_lock);
    struct uploads_turn **at = &uploads->turns;
    while (*at != turn) at = &(*at)->next;
    *at = turn->next;
    pthread_cond_broadcast(&uploads->turn_ended);
    pthread_mutex_unlock(&uploads->turns_lock);
}

enum status uploads_gather(struct uploads *uploads, const char *id, uint64_t bytes, struct error *error) {
    return uploads->kind->gather(uploads, id, bytes, error);
}

enum status uploads_complete(struct uploads *uploads, const char *id, const char *sha256, struct error *error) {
    return uploads->kind->complete(uploads, id, sha256, error);
}

enum status uploads_delete(struct uploads *uploads, const char *id, struct error *error) {
    return uploads->kind->delete (uploads, id, error);
}

void uploads_sweep(struct uploads *uploads, int64_t now_ms) { uploads->kind->sweep(uploads, now_ms); }

void uploads_move_ends(struct uploads *uploads, int64_t step_ms) { uploads->kind->move_ends(uploads, step_ms); }

bool uploads_check_piece(const struct uploads_check *check, struct digest *digest, struct problem *problem) {
    char found[DIGEST_LONGEST_BASE64_BYTES];
    if (!digest) return true;
    digest_finish_base64(digest, found);
    if (strcmp(found, check->base64) == 0) return true;
    problem_set(problem, PROBLEM_CHECKSUM_MISMATCH, "Upload-Checksum is not that of the piece that came");
    problem_add_text(problem, "actual", found);
    return false;
}
