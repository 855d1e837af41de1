/* Resumable uploads that any host goes on with: pieces among the blobs, and rows of them.
 *
 *     admit: seize the row for a token of this request  ->  bytes into a file in scratch
 *     end:   the file becomes the blob uploads/<id>/<offset>-<token>  ->  a row, where the token still writes
 *
 * A host has nothing of an upload but what its present requests have brought, each in a writer of its own.  What a
 * broken connection leaves stays in the list: whoever asks for the offset at this host next, or the sweep, makes it a
 * piece.  The sweep makes pieces of what is coming, too, so that a host that dies loses little.
 *
 * Invariant: the row's offset is where the last piece ends, and all pieces up to there are blobs.  A blob that got no
 * row is nobody's, and goes with its folder when the upload ends.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <inttypes.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "core/base/fault.h"
#include "server/base/away.h"
#include "server/base/digest.h"
#include "server/base/log.h"
#include "server/base/random.h"
#include "server/base/wall_clock.h"
#include "server/storage/upload.h"
#include "server/storage/uploads_internal.h"

enum { PAGE = 256, RESERVE_BYTES = 8 << 20 };

struct shared_writer {
    struct uploads_writer writer; /* first */
    struct shared *uploads;
    struct shared_writer *next; /* in the list of all; under its lock, like these two */
    unsigned holders;           /* its request, and who makes pieces */
    uint64_t round;             /* of commit_all that has looked at it */
    char token[CATALOG_TOKEN_BYTES];
    struct uploads_check check;   /* whole: no piece is made before the end */
    struct digest *digest;        /* NULL: no hash of ours to check */
    struct uploads_limits limits; /* of a new one; of others principal_bytes alone */
    uint64_t reserved;            /* bytes, where the length isn't known, and that aren't of a piece by now */
    pthread_mutex_t lock;         /* of all below */
    pthread_cond_t changed;
    struct catalog_upload info; /* the row as this token has made it; offset: where the next piece begins */
    struct scratch_file file;   /* what has come since; fd -1 = it can't be written any more */
    uint64_t bytes;             /* of the file */
    uint64_t put;               /* where is_busy: of the piece before it, which has no row yet */
    bool is_new;                /* it has no row yet */
    bool is_busy;               /* a piece is being made */
    bool is_over;               /* nobody writes any more */
};

struct shared {
    struct uploads uploads; /* first */
    struct catalog *catalog;
    struct store *store;
    pthread_mutex_t lock; /* of the list; taken before a writer's, never held for long */
    struct shared_writer *first;
    uint64_t rounds;
};

static struct shared *shared_of(struct uploads *uploads) { return (struct shared *)(void *)uploads; }

static struct shared_writer *shared_writer_of(struct uploads_writer *writer) {
    return (struct shared_writer *)(void *)writer;
}

static bool refuse_shared(enum problem_kind kind, const char *why, struct problem *problem) {
    problem_set(problem, kind, "%s", why);
    return false;
}

/* Of the catalog or the store; a limit is one of uploads or of bytes. */
static bool refuse_shared_error(const struct error *error, const struct uploads_limits *limits,
                                struct problem *problem) {
    bool is_all = strcmp(error->where, "max_uploads") == 0, is_bytes = strcmp(error->where, "principal_bytes") == 0;
    if (error_is_away(error)) return refuse_shared(PROBLEM_NOT_READY, error->text, problem);
    if (error->code != STATUS_LIMIT) {
        problem_from_error(problem, error);
        return false;
    }
    problem_set(problem, is_all ? PROBLEM_TOO_MANY_UPLOADS : PROBLEM_RATE_LIMITED, "%s%s",
                is_bytes ? "principal_bytes: " : "", error->text);
    problem_add_number(problem, "limit",
                       (int64_t)(is_all     ? limits->all
                                 : is_bytes ? limits->principal_bytes
                                            : limits->of_principal));
    return false;
}

/* ------------------------------------------------------------------------------------------------ open */

static enum status shared_open(struct catalog *catalog, struct store *store, struct uploads **uploads,
                               struct error *error) {
    struct shared *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "uploads", "no memory");
    *opened = (struct shared){.uploads.kind = &uploads_shared, .catalog = catalog, .store = store};
    pthread_mutex_init(&opened->lock, NULL);
    *uploads = &opened->uploads;
    return STATUS_OK;
}

static void shared_writer_drop(struct shared_writer *writer) {
    if (writer->reserved) catalog_release(writer->uploads->catalog, writer->info.principal, writer->reserved);
    scratch_file_drop(store_scratch(writer->uploads->store), &writer->file);
    digest_free(writer->digest);
    pthread_cond_destroy(&writer->changed);
    pthread_mutex_destroy(&writer->lock);
    free(writer);
}

static void shared_close(struct uploads *all) {
    struct shared *uploads = shared_of(all);
    while (uploads->first) {
        struct shared_writer *next = uploads->first->next;
        shared_writer_drop(uploads->first);
        uploads->first = next;
    }
    pthread_mutex_destroy(&uploads->lock);
    free(uploads);
}

static enum status shared_find(struct uploads *all, const char *id, struct catalog_upload *info, bool *found,
                               struct error *error) {
    struct shared *uploads = shared_of(all);
    *found = false;
    if (!job_id_valid(id)) return STATUS_OK;
    enum status status = catalog_find_upload(uploads->catalog, id, info, found, error);
    if (status != STATUS_OK || !*found || info->cloud[0]) return status;
    pthread_mutex_lock(&uploads->lock); /* what comes at this host is told, too, before it is a piece */
    for (struct shared_writer *writer = uploads->first; writer; writer = writer->next) {
        pthread_mutex_lock(&writer->lock);
        uint64_t comes = writer->bytes + (writer->is_busy ? writer->put : 0);
        bool goes_on = !writer->is_over && strcmp(writer->info.id, id) == 0 &&
                       writer->info.offset + writer->bytes - comes == info->offset;
        if (goes_on && !writer->check.whole) info->offset += comes;
        pthread_mutex_unlock(&writer->lock);
    }
    pthread_mutex_unlock(&uploads->lock);
    return status;
}

static enum status shared_find_final(struct uploads *all, const char *principal, const char *concat,
                                     struct catalog_upload *info, bool *found, struct error *error) {
    return catalog_find_final(shared_of(all)->catalog, principal, concat, info, found, error);
}

/* ------------------------------------------------------------------------------------------------ writers */

/* One whose row is still to be seized or made; NULL: *problem says why. */
static struct shared_writer *shared_writer_new(struct shared *uploads, const struct uploads_check *check,
                                               struct problem *problem) {
    struct shared_writer *writer = calloc(1, sizeof *writer);
    struct error error = {0};
    if (!writer) return (void)refuse_shared(PROBLEM_INTERNAL_ERROR, "no memory", problem), NULL;
    *writer =
        (struct shared_writer){.writer.kind = &uploads_shared, .uploads = uploads, .check = *check, .file.fd = -1};
    pthread_mutex_init(&writer->lock, NULL);
    pthread_cond_init(&writer->changed, NULL);
    random_name(writer->token);
    if (check->base64[0]) writer->digest = check->is_sha1 ? digest_new_sha1() : digest_new();
    if (check->base64[0] && !writer->digest)
        refuse_shared(PROBLEM_INTERNAL_ERROR, "no memory", problem);
    else if (scratch_file_begin(store_scratch(uploads->store), &writer->file, &error) != STATUS_OK)
        problem_from_error(problem, &error);
    else
        return writer;
    shared_writer_drop(writer);
    return NULL;
}

/* From now on it is a request's. */
static struct uploads_writer *enlist(struct shared *uploads, struct shared_writer *writer) {
    writer->holders = 1;
    pthread_mutex_lock(&uploads->lock);
    writer->next = uploads->first;
    uploads->first = writer;
    pthread_mutex_unlock(&uploads->lock);
    return &writer->writer;
}

static struct uploads_writer *shared_create(struct uploads *all, struct catalog_upload *info,
                                            const struct uploads_check *check, const struct uploads_limits *limits,
                                            struct problem *problem) {
    struct shared *uploads = shared_of(all);
    struct shared_writer *writer = shared_writer_new(uploads, check, problem);
    struct timespec now;
    if (!writer) return NULL;
    clock_gettime(CLOCK_REALTIME, &now);
    job_new_id(&now, info->id);
    info->created_ms = job_now_ms();
    info->offset = 0;
    writer->info = *info;
    writer->limits = *limits;
    writer->is_new = true;
    return enlist(uploads, writer);
}

/* Why the upload can't go on there. */
static bool refuse_seizing(const struct catalog_upload *row, uint64_t offset, struct problem *problem) {
    if (!row->id[0]) return refuse_shared(PROBLEM_NO_SUCH_UPLOAD, "there is no such upload", problem);
    if (row->cloud[0]) return refuse_shared(PROBLEM_OFFSET_MISMATCH, "the upload is complete", problem);
    if (offset == row->offset)
        return refuse_shared(PROBLEM_MALFORMED_REQUEST,
                             row->length == UINT64_MAX ? "Upload-Length is less than what has come"
                                                       : "Upload-Length is known already, and another one",
                             problem);
    problem_set(problem, PROBLEM_OFFSET_MISMATCH, "the upload has %llu bytes, not %llu",
                (unsigned long long)row->offset, (unsigned long long)offset);
    problem_add_number(problem, "offset", (int64_t)row->offset);
    return false;
}

static struct uploads_writer *shared_resume(struct uploads *all, const char *id, uint64_t offset, uint64_t length,
                                            const struct uploads_check *check, uint64_t principal_bytes,
                                            struct problem *problem) {
    struct shared *uploads = shared_of(all);
    struct shared_writer *writer = shared_writer_new(uploads, check, problem);
    struct error error = {0};
    bool seized = false;
    if (!writer) return NULL;
    writer->limits.principal_bytes = principal_bytes;
    enum status status = catalog_seize_upload(uploads->catalog, id, writer->token, offset, length, principal_bytes,
                                              &writer->info, &seized, &error);
    if (status != STATUS_OK)
        refuse_shared_error(&error, &writer->limits, problem);
    else if (!seized)
        refuse_seizing(&writer->info, offset, problem);
    else
        return enlist(uploads, writer);
    shared_writer_drop(writer);
    return NULL;
}

/* ------------------------------------------------------------------------------------------------ bytes */

/* Where the length isn't known bytes are reserved by the block, as far as there is room for blocks. */
static bool reserve_blocks(struct shared_writer *writer, uint64_t bytes, struct problem *problem) {
    struct error error = {0};
    uint64_t limit = writer->limits.principal_bytes;
    if (writer->info.length != UINT64_MAX || !limit || bytes <= writer->reserved) return true;
    uint64_t more = bytes - writer->reserved;
    enum status status = STATUS_LIMIT;
    for (uint64_t asked = more + RESERVE_BYTES;; asked = more) {
        status = catalog_reserve(writer->uploads->catalog, writer->info.principal, asked, limit, &error);
        if (status == STATUS_OK) writer->reserved += asked;
        if (status != STATUS_LIMIT || asked == more) break;
    }
    return status == STATUS_OK || refuse_shared_error(&error, &writer->limits, problem);
}

/* The writer that has lost its upload: to another request, or with it, when that was deleted. */
static bool refuse_lost(struct shared_writer *writer, struct problem *problem) {
    struct catalog_upload row;
    struct error error;
    bool found = true;
    enum status status = catalog_find_upload(writer->uploads->catalog, writer->info.id, &row, &found, &error);
    if (status == STATUS_OK && !found)
        return refuse_shared(PROBLEM_NO_SUCH_UPLOAD, "the upload was deleted meanwhile", problem);
    return refuse_shared(PROBLEM_OFFSET_MISMATCH, "another request goes on with this upload", problem);
}

static bool append_bytes(int fd, const char *bytes, size_t count, struct problem *problem) {
    struct error error;
    while (count) {
        ssize_t n = write(fd, bytes, count);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) {
            error_set(&error, status_from_errno(errno), "", "the piece can't be stored: %s", strerror(errno));
            problem_from_error(problem, &error);
            return false;
        }
        bytes += n;
        count -= (size_t)n;
    }
    return true;
}

static bool shared_write(struct uploads_writer *any, const void *bytes, size_t count, struct problem *problem) {
    struct shared_writer *writer = shared_writer_of(any);
    pthread_mutex_lock(&writer->lock);
    uint64_t had = writer->info.offset + writer->bytes, most = writer->info.length;
    bool ok = !writer->is_over && writer->file.fd >= 0;
    if (!ok) refuse_shared(PROBLEM_OFFSET_MISMATCH, "another request goes on with this upload", problem);
    if (ok && (had > most || count > most - had)) {
        upload_piece_too_large(had < most ? most - had : 0, UINT64_MAX, problem);
        ok = false;
    }
    if (ok && !scratch_may_go_on(store_scratch(writer->uploads->store), had, count))
        ok = refuse_shared(PROBLEM_STORAGE_FULL, "the piece can't be stored: the disk is full", problem);
    ok = ok && reserve_blocks(writer, writer->bytes + count, problem) &&
         append_bytes(writer->file.fd, bytes, count, problem);
    if (ok) writer->bytes += count;
    pthread_mutex_unlock(&writer->lock);
    if (ok && writer->digest) digest_update(writer->digest, bytes, count);
    return ok;
}

/* ------------------------------------------------------------------------------------------------ pieces */

/* Puts the file and adds its row, and names it; *held false: another request has the upload by now. */
static enum status put_piece(struct shared_writer *writer, struct scratch_file *file, struct catalog_piece *piece,
                             int64_t expires_ms, bool *held, struct error *error) {
    struct shared *uploads = writer->uploads;
    enum { HASH_DIGITS = 8 }; /* as many as a piece's name has room for */
    const char *id = writer->info.id;
    char sha256[DIGEST_HEX_BYTES] = "";
    uint64_t found, bytes = piece->bytes;
    enum status status = STATUS_OK;
    if (bytes && digest_file(file->fd, sha256, &found) != 0)
        status =
            error_set(error, status_from_errno(errno), "uploads", "can't read a piece of %s: %s", id, strerror(errno));
    snprintf(piece->name, sizeof piece->name, "%020llu-%s--%.*s", (unsigned long long)piece->offset, writer->token,
             HASH_DIGITS, sha256);
    if (status == STATUS_OK && bytes) status = scratch_file_sync(file, error);
    if (status == STATUS_OK && bytes) status = store_piece_keep(uploads->store, id, piece->name, sha256, file, error);
    fault_at("piece-kept");
    if (status == STATUS_OK)
        status = catalog_add_piece(uploads->catalog, id, writer->token, piece, expires_ms, held, error);
    scratch_file_drop(store_scratch(uploads->store), file);
    return status;
}

/* What has come as a piece, with what was reserved for it, or at the end for more than came.  Under the writer's lock.
 */
static struct catalog_piece take_bytes(struct shared_writer *writer, bool is_last) {
    struct catalog_piece piece = {.offset = writer->info.offset, .bytes = writer->bytes, .reserved = writer->reserved};
    if (!is_last && piece.reserved > piece.bytes) piece.reserved = piece.bytes;
    writer->info.offset += piece.bytes;
    writer->bytes = 0;
    writer->put = piece.bytes;
    writer->reserved -= piece.reserved;
    return piece;
}

/* Makes a piece of what has come; the writer gets another file where it goes on.  At the end (is_last) a piece of no
 * bytes says that the upload lives. */
static enum status commit_piece(struct shared_writer *writer, bool is_last, int64_t expires_ms, bool *held,
                                struct error *error) {
    struct scratch_file file, fresh = {.fd = -1};
    enum status status = STATUS_OK;
    pthread_mutex_lock(&writer->lock);
    while (writer->is_busy) pthread_cond_wait(&writer->changed, &writer->lock);
    *held = writer->file.fd >= 0;
    bool has_work = *held && (writer->bytes || is_last);
    if (has_work && !is_last) status = scratch_file_begin(store_scratch(writer->uploads->store), &fresh, error);
    if (!has_work || status != STATUS_OK) {
        pthread_mutex_unlock(&writer->lock);
        return status;
    }
    struct catalog_piece piece = take_bytes(writer, is_last);
    file = writer->file;
    writer->file = fresh;
    writer->is_busy = true;
    pthread_mutex_unlock(&writer->lock);
    status = put_piece(writer, &file, &piece, expires_ms, held, error);
    pthread_mutex_lock(&writer->lock);
    if (status != STATUS_OK || !*held) writer->reserved += piece.reserved;
    writer->is_busy = false;
    writer->info.expires_ms = expires_ms;
    if (status != STATUS_OK || !*held) scratch_file_drop(store_scratch(writer->uploads->store), &writer->file);
    pthread_cond_broadcast(&writer->changed);
    pthread_mutex_unlock(&writer->lock);
    return status;
}

static bool shared_end(struct uploads_writer *any, int64_t expires_ms, struct catalog_upload *info,
                       struct problem *problem) {
    struct shared_writer *writer = shared_writer_of(any);
    struct error error = {0};
    bool held = false;
    if (!uploads_check_piece(&writer->check, writer->digest, problem)) return false;
    if (writer->is_new) {
        const struct catalog_upload_limits limits = {writer->limits.all, writer->limits.of_principal,
                                                     writer->limits.principal_bytes};
        writer->info.expires_ms = expires_ms;
        if (catalog_open_upload(writer->uploads->catalog, &writer->info, writer->token, &limits, &error) != STATUS_OK)
            return refuse_shared_error(&error, &writer->limits, problem);
        pthread_mutex_lock(&writer->lock);
        writer->is_new = false;
        pthread_mutex_unlock(&writer->lock);
    }
    if (commit_piece(writer, true, expires_ms, &held, &error) != STATUS_OK)
        return refuse_shared_error(&error, &writer->limits, problem);
    pthread_mutex_lock(&writer->lock);
    writer->is_over = true;
    *info = writer->info;
    pthread_mutex_unlock(&writer->lock);
    return held || refuse_lost(writer, problem);
}

static void unlink_writer(struct shared *uploads, const struct shared_writer *writer) {
    struct shared_writer **at = &uploads->first;
    while (*at != writer) at = &(*at)->next;
    *at = writer->next;
}

/* Whether it has brought what is still to become a piece. */
static bool has_rest(struct shared_writer *writer) {
    pthread_mutex_lock(&writer->lock);
    bool has = writer->file.fd >= 0 && writer->bytes && !writer->is_new && !writer->check.whole;
    pthread_mutex_unlock(&writer->lock);
    return has;
}

/* The last one frees it; with a rest it stays in the list, for whoever looks next. */
static void shared_let_go(struct shared *uploads, struct shared_writer *writer) {
    pthread_mutex_lock(&uploads->lock);
    bool is_over = --writer->holders == 0 && !has_rest(writer);
    if (is_over) unlink_writer(uploads, writer);
    pthread_mutex_unlock(&uploads->lock);
    if (is_over) shared_writer_drop(writer);
}

static void shared_writer_free(struct uploads_writer *any) {
    struct shared_writer *writer = shared_writer_of(any);
    pthread_mutex_lock(&writer->lock);
    writer->is_over = true;
    pthread_mutex_unlock(&writer->lock);
    shared_let_go(writer->uploads, writer);
}

/* One of this upload (NULL = of any) that this round hasn't looked at, held. */
static struct shared_writer *hold_next(struct shared *uploads, const char *id, uint64_t round) {
    pthread_mutex_lock(&uploads->lock);
    struct shared_writer *writer = uploads->first;
    while (writer && (writer->round == round || (id && strcmp(writer->info.id, id) != 0))) writer = writer->next;
    if (writer) {
        writer->round = round;
        writer->holders++;
    }
    pthread_mutex_unlock(&uploads->lock);
    return writer;
}

/* Makes pieces of what comes at this moment, and of what broken connections have left (id NULL: of any upload), and
 * lets no more come (ends). */
static enum status commit_all(struct shared *uploads, const char *id, bool ends, struct error *error) {
    struct shared_writer *writer;
    enum status status = STATUS_OK;
    pthread_mutex_lock(&uploads->lock);
    uint64_t round = ++uploads->rounds;
    pthread_mutex_unlock(&uploads->lock);
    while (status == STATUS_OK && (writer = hold_next(uploads, id, round))) {
        pthread_mutex_lock(&writer->lock);
        if (ends) writer->is_over = true;
        while (ends && writer->is_busy) pthread_cond_wait(&writer->changed, &writer->lock); /* it has its row then */
        bool held, is_last = writer->is_over;
        pthread_mutex_unlock(&writer->lock);
        if (has_rest(writer)) status = commit_piece(writer, is_last, writer->info.expires_ms, &held, error);
        shared_let_go(uploads, writer);
    }
    return status;
}

static enum status shared_interrupt(struct uploads *all, const char *id, struct error *error) {
    struct shared *uploads = shared_of(all);
    struct catalog_upload row;
    char token[CATALOG_TOKEN_BYTES];
    bool seized;
    enum status status = commit_all(uploads, id, true, error);
    random_name(token);
    return status == STATUS_OK
               ? catalog_seize_upload(uploads->catalog, id, token, UINT64_MAX, UINT64_MAX, 0, &row, &seized, error)
               : status;
}

/* ------------------------------------------------------------------------------------------------ ends */

static enum status shared_gather(struct uploads *all, const char *id, uint64_t bytes, struct error *error) {
    struct shared *uploads = shared_of(all);
    struct scratch *scratch = store_scratch(uploads->store);
    struct scratch_file file = {.fd = -1};
    struct catalog_piece *pieces = calloc(PAGE, sizeof *pieces);
    size_t count = PAGE;
    uint64_t offset = 0;
    enum status status =
        pieces ? scratch_file_begin(scratch, &file, error) : error_set(error, STATUS_NO_MEMORY, "uploads", "no memory");
    while (status == STATUS_OK && count == PAGE) {
        status = catalog_list_pieces(uploads->catalog, id, offset, pieces, PAGE, &count, error);
        for (size_t i = 0; status == STATUS_OK && i < count; i++) {
            if (pieces[i].offset == offset)
                status = store_piece_copy(uploads->store, id, pieces[i].name, file.fd, error);
            else
                status = error_set(error, STATUS_IO, "uploads", "upload %s lacks a piece at %llu", id,
                                   (unsigned long long)offset);
            offset += pieces[i].bytes;
        }
    }
    if (status == STATUS_OK && offset != bytes)
        status = error_set(error, STATUS_IO, "uploads", "upload %s has %llu bytes in pieces, not %llu", id,
                           (unsigned long long)offset, (unsigned long long)bytes);
    if (status == STATUS_OK) status = scratch_file_sync(&file, error);
    if (status == STATUS_OK) status = scratch_part_take(scratch, id, &file, error);
    scratch_file_drop(scratch, &file);
    free(pieces);
    return status;
}

static enum status shared_complete(struct uploads *all, const char *id, const char *sha256, struct error *error) {
    struct shared *uploads = shared_of(all);
    enum status status = catalog_complete_upload(uploads->catalog, id, sha256, error);
    if (status != STATUS_OK) return status;
    scratch_part_delete(store_scratch(uploads->store), id);
    store_pieces_delete(uploads->store, id);
    return STATUS_OK;
}

/* What comes of it at this host, or has come, is nobody's any more. */
static void forget_all(struct shared *uploads, const char *id) {
    struct shared_writer *writer;
    pthread_mutex_lock(&uploads->lock);
    uint64_t round = ++uploads->rounds;
    pthread_mutex_unlock(&uploads->lock);
    while ((writer = hold_next(uploads, id, round))) {
        pthread_mutex_lock(&writer->lock);
        writer->is_over = true;
        if (!writer->is_new) scratch_file_drop(store_scratch(uploads->store), &writer->file);
        pthread_mutex_unlock(&writer->lock);
        shared_let_go(uploads, writer);
    }
}

static enum status remove_upload(struct shared *uploads, const char *id, int64_t by_ms, bool *deleted,
                                 struct error *error) {
    enum status status = catalog_delete_upload(uploads->catalog, id, by_ms, deleted, error);
    if (status != STATUS_OK || !*deleted) return status;
    forget_all(uploads, id);
    scratch_part_delete(store_scratch(uploads->store), id);
    store_pieces_delete(uploads->store, id);
    return STATUS_OK;
}

static enum status shared_delete(struct uploads *all, const char *id, struct error *error) {
    bool deleted;
    return remove_upload(shared_of(all), id, INT64_MAX, &deleted, error);
}

static void shared_sweep(struct uploads *all, int64_t now_ms) {
    struct shared *uploads = shared_of(all);
    char ids[PAGE][JOB_ID_BYTES];
    struct error error = {0};
    size_t count = 0;
    enum status status = commit_all(uploads, NULL, false, &error);
    if (status == STATUS_OK) status = catalog_expired_uploads(uploads->catalog, now_ms, ids, PAGE, &count, &error);
    for (size_t i = 0; status == STATUS_OK && i < count; i++) {
        bool deleted; /* not where a piece has come meanwhile */
        status = remove_upload(uploads, ids[i], now_ms, &deleted, &error);
        if (status == STATUS_OK && deleted) log_line(LOG_INFO, "upload=%s expired", ids[i]);
    }
    if (status != STATUS_OK) log_line(LOG_ERROR, "uploads can't be looked after: %s", error.text);
}

/* They end by the catalog's clock. */
static void shared_move_ends(struct uploads *all, int64_t step_ms) { (void)all, (void)step_ms; }

const struct uploads_kind uploads_shared = {
    .open = shared_open,
    .close = shared_close,
    .find = shared_find,
    .find_final = shared_find_final,
    .create = shared_create,
    .resume = shared_resume,
    .interrupt = shared_interrupt,
    .write = shared_write,
    .end = shared_end,
    .writer_free = shared_writer_free,
    .gather = shared_gather,
    .complete = shared_complete,
    .delete = shared_delete,
    .sweep = shared_sweep,
    .move_ends = shared_move_ends,
};
