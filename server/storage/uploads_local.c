/* Resumable uploads of one host: files of its own.
 *
 * The list of entries is under one lock, each entry's bytes and figures under its own, taken in this order, so that one
 * upload's writing never waits for another's.  An entry lives as long as it is in the list or a writer holds it.
 *
 * A piece with a checksum is gathered in a temporary file and copied once it has proved right.
 *
 * Invariant: the file has info.offset bytes that are the client's, in the order of the content; a row's offset is never
 * larger than what is on disk.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/uploads_internal.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/base/digest.h"
#include "server/base/log.h"
#include "server/base/wall_clock.h"
#include "server/storage/upload.h"

enum { COPY_BYTES = 64 * 1024 };

struct entry {
    struct entry *next;
    unsigned holders; /* the list, and writers; under the list's lock */
    bool gone;        /* out of the list; under the entry's lock, like all below */
    pthread_mutex_t lock;
    struct catalog_upload info;
    pthread_cond_t changed;
    uint64_t writer;   /* number of the one who may write; 0 = nobody */
    uint64_t durable;  /* of info.offset */
    uint64_t reserved; /* bytes, for its principal */
    bool known;        /* it has a row */
    bool busy;         /* somebody flushes its file and writes its row, without the lock */
    bool ending;       /* and makes a piece part of it: there can't be another writer now */
};

struct local {
    struct uploads uploads; /* first */
    struct catalog *catalog;
    struct scratch *scratch;
    pthread_mutex_t lock;
    struct entry *first;
    uint64_t count, writers; /* entries; numbers given to writers */
    char boot[CATALOG_BOOT_BYTES];
};

struct local_writer {
    struct uploads_writer writer; /* first */
    struct local *uploads;
    struct entry *entry;
    uint64_t number;
    int fd;
    struct uploads_check check;
    struct digest *digest;      /* NULL: no hash of ours to check */
    struct scratch_file staged; /* a piece that is checked; fd -1 = it isn't */
    uint64_t staged_bytes;
    uint64_t reserved;        /* of these, where the length isn't known */
    uint64_t principal_bytes; /* a limit; 0 = none */
};

static struct local *local_of(struct uploads *uploads) { return (struct local *)(void *)uploads; }

static struct local_writer *local_writer_of(struct uploads_writer *writer) {
    return (struct local_writer *)(void *)writer;
}

/* ------------------------------------------------------------------------------------------------ entries */

/* Under the list's lock. */
static struct entry *find(struct local *uploads, const char *id) {
    struct entry *entry = uploads->first;
    while (entry && strcmp(entry->info.id, id) != 0) entry = entry->next;
    return entry;
}

/* The entry, held; NULL = there is none. */
static struct entry *hold(struct local *uploads, const char *id) {
    pthread_mutex_lock(&uploads->lock);
    struct entry *entry = find(uploads, id);
    if (entry) entry->holders++;
    pthread_mutex_unlock(&uploads->lock);
    return entry;
}

static void free_entry(struct entry *entry) {
    pthread_cond_destroy(&entry->changed);
    pthread_mutex_destroy(&entry->lock);
    free(entry);
}

static void let_go(struct local *uploads, struct entry *entry) {
    pthread_mutex_lock(&uploads->lock);
    bool last = --entry->holders == 0;
    pthread_mutex_unlock(&uploads->lock);
    if (last) free_entry(entry);
}

static bool refuse(enum problem_kind kind, const char *why, struct problem *problem) {
    problem_set(problem, kind, "%s", why);
    return false;
}

static bool is_below(uint64_t count, uint64_t limit, enum problem_kind kind, const char *name,
                     struct problem *problem) {
    if (count < limit) return true;
    problem_set(problem, kind, "%s is %llu, and as many are there", name, (unsigned long long)limit);
    problem_add_number(problem, "limit", (int64_t)limit);
    return false;
}

/* Whether the principal may have one more.  Under the list's lock. */
static bool has_room(const struct local *uploads, const char *principal, const struct uploads_limits *limits,
                     struct problem *problem) {
    uint64_t own = 0;
    for (const struct entry *entry = uploads->first; entry; entry = entry->next)
        own += strcmp(entry->info.principal, principal) == 0;
    return is_below(uploads->count, limits->all, PROBLEM_TOO_MANY_UPLOADS, "max_uploads", problem) &&
           is_below(own, limits->of_principal, PROBLEM_RATE_LIMITED, "principal_uploads", problem);
}

/* Reserves more for an upload. */
static bool reserve(struct local *uploads, const struct catalog_upload *info, uint64_t bytes, uint64_t limit,
                    struct problem *problem) {
    struct error error = {0};
    enum status status = catalog_reserve(uploads->catalog, info->principal, bytes, limit, &error);
    if (status == STATUS_OK) return true;
    if (status != STATUS_LIMIT) return refuse(PROBLEM_INTERNAL_ERROR, error.text, problem);
    problem_set(problem, PROBLEM_RATE_LIMITED, "principal_bytes: %s", error.text);
    problem_add_number(problem, "limit", (int64_t)limit);
    return false;
}

/* Under the entry's lock. */
static void release(struct local *uploads, struct entry *entry) {
    catalog_release(uploads->catalog, entry->info.principal, entry->reserved);
    entry->reserved = 0;
}

/* limits NULL: it is there already. */
static struct entry *add(struct local *uploads, const struct catalog_upload *info, const struct uploads_limits *limits,
                         struct problem *problem) {
    struct entry *entry = calloc(1, sizeof *entry);
    if (!entry) return (void)refuse(PROBLEM_INTERNAL_ERROR, "no memory", problem), NULL;
    pthread_mutex_init(&entry->lock, NULL);
    pthread_cond_init(&entry->changed, NULL);
    entry->info = *info;
    entry->holders = 1;
    if (!info->cloud[0]) entry->reserved = info->length != UINT64_MAX ? info->length : info->offset;
    pthread_mutex_lock(&uploads->lock);
    bool room = (!limits || has_room(uploads, info->principal, limits, problem)) &&
                reserve(uploads, info, entry->reserved, limits ? limits->principal_bytes : 0, problem);
    if (room) {
        entry->next = uploads->first;
        uploads->first = entry;
        uploads->count++;
    }
    pthread_mutex_unlock(&uploads->lock);
    if (room) return entry;
    free_entry(entry);
    return NULL;
}

/* Takes it out of the list, if it is there; nobody can write any more.  With by_ms (NULL: in any case) only where it
 * has expired by then and nobody writes; false: it stays. */
static bool take_out(struct local *uploads, struct entry *entry, const int64_t *by_ms) {
    bool listed = false;
    pthread_mutex_lock(&uploads->lock);
    pthread_mutex_lock(&entry->lock);
    bool leaves = !by_ms || (entry->known && !entry->writer && !entry->ending && entry->info.expires_ms <= *by_ms);
    if (leaves) {
        struct entry **at = &uploads->first;
        while (*at && *at != entry) at = &(*at)->next;
        listed = *at == entry;
        if (listed) {
            *at = entry->next;
            uploads->count--;
        }
        entry->gone = true;
        entry->writer = 0;
        release(uploads, entry);
    }
    pthread_mutex_unlock(&entry->lock);
    pthread_mutex_unlock(&uploads->lock);
    if (listed) let_go(uploads, entry);
    return leaves;
}

static enum status delete_row(struct local *uploads, const char *id, struct error *error) {
    bool deleted;
    return catalog_delete_upload(uploads->catalog, id, INT64_MAX, &deleted, error);
}

static enum status local_find(struct uploads *all, const char *id, struct catalog_upload *info, bool *found,
                              struct error *error) {
    struct local *uploads = local_of(all);
    struct entry *entry = hold(uploads, id);
    (void)error;
    *found = entry != NULL;
    if (!entry) return STATUS_OK;
    pthread_mutex_lock(&entry->lock);
    *info = entry->info;
    pthread_mutex_unlock(&entry->lock);
    let_go(uploads, entry);
    return STATUS_OK;
}

static enum status local_find_final(struct uploads *all, const char *principal, const char *concat,
                                    struct catalog_upload *info, bool *found, struct error *error) {
    struct local *uploads = local_of(all);
    (void)error;
    *found = false;
    pthread_mutex_lock(&uploads->lock);
    for (struct entry *entry = uploads->first; entry && !*found; entry = entry->next) {
        pthread_mutex_lock(&entry->lock);
        *found = entry->known && !entry->gone && !entry->ending && entry->info.offset == entry->info.length &&
                 strcmp(entry->info.concat, concat) == 0 && strcmp(entry->info.principal, principal) == 0;
        if (*found) *info = entry->info;
        pthread_mutex_unlock(&entry->lock);
    }
    pthread_mutex_unlock(&uploads->lock);
    return STATUS_OK;
}

static enum status local_interrupt(struct uploads *all, const char *id, struct error *error) {
    struct local *uploads = local_of(all);
    struct entry *entry = hold(uploads, id);
    (void)error;
    if (!entry) return STATUS_OK;
    pthread_mutex_lock(&entry->lock);
    while (entry->ending) pthread_cond_wait(&entry->changed, &entry->lock);
    entry->writer = 0;
    pthread_mutex_unlock(&entry->lock);
    let_go(uploads, entry);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ open */

static void read_boot(char boot[CATALOG_BOOT_BYTES]) {
    int fd = open("/proc/sys/kernel/random/boot_id", O_RDONLY | O_CLOEXEC);
    ssize_t n = fd >= 0 ? read(fd, boot, CATALOG_BOOT_BYTES - 1) : 0;
    boot[n > 0 ? n : 0] = 0;
    boot[strcspn(boot, "\n")] = 0;
    if (fd >= 0) close(fd);
}

/* Bytes of the file that can be trusted: under the kernel that has them in its memory all, else those flushed.  The
 * rest is cut off.  false: there is no such file, or less of it than was flushed. */
static bool trust(struct local *uploads, struct catalog_upload *row) {
    struct stat facts;
    int fd = scratch_part_open(uploads->scratch, row->id, false);
    bool ok = fd >= 0 && fstat(fd, &facts) == 0 && (uint64_t)facts.st_size >= row->offset;
    bool same_boot = row->boot[0] && strcmp(row->boot, uploads->boot) == 0;
    if (ok && same_boot && (uint64_t)facts.st_size <= row->length) row->offset = (uint64_t)facts.st_size;
    ok = ok && ftruncate(fd, (off_t)row->offset) == 0;
    if (fd >= 0) close(fd);
    return ok;
}

static enum status take_row(struct local *uploads, struct catalog_upload *row, struct error *error) {
    uint64_t durable = row->offset;
    bool whole = row->cloud[0] != 0;
    if (!whole && !trust(uploads, row)) {
        log_line(LOG_ERROR, "upload=%s has lost its file: forgotten", row->id);
        return delete_row(uploads, row->id, error);
    }
    struct problem problem;
    struct entry *entry = add(uploads, row, NULL, &problem);
    if (!entry) return error_set(error, STATUS_NO_MEMORY, "uploads", "no memory");
    entry->durable = durable;
    entry->known = true;
    if (whole || strcmp(row->boot, uploads->boot) == 0) return STATUS_OK;
    memcpy(row->boot, uploads->boot, sizeof row->boot);
    return catalog_put_upload(uploads->catalog, row, error);
}

static void local_close(struct uploads *all) {
    struct local *uploads = local_of(all);
    while (uploads->first) take_out(uploads, uploads->first, NULL);
    pthread_mutex_destroy(&uploads->lock);
    free(uploads);
}

static enum status local_open(struct catalog *catalog, struct store *store, struct uploads **uploads,
                              struct error *error) {
    struct local *opened = calloc(1, sizeof *opened);
    struct catalog_upload row = {0};
    bool found = true;
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "uploads", "no memory");
    opened->uploads.kind = &uploads_local;
    opened->catalog = catalog;
    opened->scratch = store_scratch(store);
    pthread_mutex_init(&opened->lock, NULL);
    read_boot(opened->boot);
    enum status status = STATUS_OK;
    while (status == STATUS_OK && found) {
        status = catalog_next_upload(catalog, row.id, &row, &found, error);
        if (status == STATUS_OK && found) status = take_row(opened, &row, error);
    }
    if (status == STATUS_OK)
        *uploads = &opened->uploads;
    else
        local_close(&opened->uploads);
    return status;
}

/* ------------------------------------------------------------------------------------------------ writers */

static bool refuse_io(const char *what, struct problem *problem) {
    struct error error;
    error_set(&error, status_from_errno(errno), "", "%s: %s", what, strerror(errno));
    problem_from_error(problem, &error);
    return false;
}

static void local_writer_free(struct uploads_writer *any) {
    struct local_writer *writer = local_writer_of(any);
    struct entry *entry = writer->entry;
    pthread_mutex_lock(&entry->lock);
    bool undone = !entry->known && !entry->gone;
    if (entry->writer == writer->number) entry->writer = 0;
    pthread_mutex_unlock(&entry->lock);
    if (undone) {
        scratch_part_delete(writer->uploads->scratch, entry->info.id);
        take_out(writer->uploads, entry, NULL);
    }
    catalog_release(writer->uploads->catalog, entry->info.principal, writer->reserved);
    scratch_file_drop(writer->uploads->scratch, &writer->staged);
    digest_free(writer->digest);
    if (writer->fd >= 0) close(writer->fd);
    let_go(writer->uploads, entry);
    free(writer);
}

/* Takes over the caller's hold of the entry, and fd, in any case; fd -1 with errno: the file couldn't be opened. */
static struct local_writer *new_writer(struct local *uploads, struct entry *entry, int fd,
                                       const struct uploads_check *check, uint64_t principal_bytes,
                                       struct problem *problem) {
    struct local_writer *writer = NULL;
    struct error error = {0};
    if (fd < 0)
        refuse_io("the upload's file can't be opened", problem);
    else if (!(writer = calloc(1, sizeof *writer)))
        refuse(PROBLEM_INTERNAL_ERROR, "no memory", problem);
    if (!writer) {
        if (fd >= 0) close(fd);
        let_go(uploads, entry);
        return NULL;
    }
    *writer = (struct local_writer){.writer.kind = &uploads_local,
                                    .uploads = uploads,
                                    .entry = entry,
                                    .fd = fd,
                                    .check = *check,
                                    .staged.fd = -1,
                                    .principal_bytes = principal_bytes};
    if (check->base64[0]) writer->digest = check->is_sha1 ? digest_new_sha1() : digest_new();
    pthread_mutex_lock(&uploads->lock);
    writer->number = ++uploads->writers;
    pthread_mutex_unlock(&uploads->lock);
    if (check->base64[0] && !writer->digest)
        refuse(PROBLEM_INTERNAL_ERROR, "no memory", problem);
    else if (check->whole && scratch_file_begin(uploads->scratch, &writer->staged, &error) != STATUS_OK)
        problem_from_error(problem, &error);
    else
        return writer;
    local_writer_free(&writer->writer);
    return NULL;
}

static struct uploads_writer *local_create(struct uploads *all, struct catalog_upload *info,
                                           const struct uploads_check *check, const struct uploads_limits *limits,
                                           struct problem *problem) {
    struct local *uploads = local_of(all);
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    job_new_id(&now, info->id);
    info->created_ms = (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
    info->offset = 0;
    struct entry *entry = add(uploads, info, limits, problem);
    if (!entry) return NULL;
    int fd = scratch_part_open(uploads->scratch, info->id, true);
    struct local_writer *writer =
        new_writer(uploads, hold(uploads, info->id), fd, check, limits->principal_bytes, problem);
    if (writer) {
        entry->writer = writer->number;
    } else {
        scratch_part_delete(uploads->scratch, info->id);
        take_out(uploads, entry, NULL);
    }
    return writer ? &writer->writer : NULL;
}

/* Under the entry's lock. */
static bool may_resume(struct entry *entry, uint64_t offset, uint64_t length, struct problem *problem) {
    struct catalog_upload *info = &entry->info;
    if (entry->gone || info->cloud[0]) return refuse(PROBLEM_OFFSET_MISMATCH, "the upload is complete", problem);
    if (entry->ending) return refuse(PROBLEM_OFFSET_MISMATCH, "its last piece is being stored", problem);
    if (offset != info->offset) {
        problem_set(problem, PROBLEM_OFFSET_MISMATCH, "the upload has %llu bytes, not %llu",
                    (unsigned long long)info->offset, (unsigned long long)offset);
        problem_add_number(problem, "offset", (int64_t)info->offset);
        return false;
    }
    if (length != UINT64_MAX && info->length != UINT64_MAX && length != info->length)
        return refuse(PROBLEM_MALFORMED_REQUEST, "Upload-Length is known already, and another one", problem);
    if (length != UINT64_MAX && length < info->offset)
        return refuse(PROBLEM_MALFORMED_REQUEST, "Upload-Length is less than what has come", problem);
    return true;
}

static struct uploads_writer *local_resume(struct uploads *all, const char *id, uint64_t offset, uint64_t length,
                                           const struct uploads_check *check, uint64_t principal_bytes,
                                           struct problem *problem) {
    struct local *uploads = local_of(all);
    struct entry *entry = hold(uploads, id);
    if (!entry) {
        refuse(PROBLEM_NO_SUCH_UPLOAD, "there is no such upload", problem);
        return NULL;
    }
    pthread_mutex_lock(&entry->lock);
    bool ok = may_resume(entry, offset, length, problem);
    int fd = ok ? scratch_part_open(uploads->scratch, id, false) : -1; /* of one that is complete there is none */
    pthread_mutex_unlock(&entry->lock);
    if (!ok) {
        let_go(uploads, entry);
        return NULL;
    }
    struct local_writer *writer = new_writer(uploads, entry, fd, check, principal_bytes, problem);
    if (!writer) return NULL;
    pthread_mutex_lock(&entry->lock);
    ok = may_resume(entry, offset, length, problem);
    if (ok && length != UINT64_MAX && entry->info.length == UINT64_MAX) {
        ok = reserve(uploads, &entry->info, length - entry->reserved, principal_bytes, problem);
        if (ok) entry->info.length = entry->reserved = length;
    }
    if (ok) entry->writer = writer->number;
    pthread_mutex_unlock(&entry->lock);
    if (ok) return &writer->writer;
    local_writer_free(&writer->writer);
    return NULL;
}

/* ------------------------------------------------------------------------------------------------ bytes */

static bool write_at(int fd, uint64_t offset, const char *bytes, size_t count, struct problem *problem) {
    while (count) {
        ssize_t n = pwrite(fd, bytes, count, (off_t)offset);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return refuse_io("the piece can't be stored", problem);
        bytes += n;
        offset += (uint64_t)n;
        count -= (size_t)n;
    }
    return true;
}

/* Under the entry's lock. */
static bool may_write(const struct local_writer *writer, struct problem *problem) {
    return writer->entry->writer == writer->number ||
           refuse(PROBLEM_OFFSET_MISMATCH, "another request goes on with this upload", problem);
}

static bool local_write(struct uploads_writer *any, const void *bytes, size_t count, struct problem *problem) {
    struct local_writer *writer = local_writer_of(any);
    struct entry *entry = writer->entry;
    struct catalog_upload *info = &entry->info;
    pthread_mutex_lock(&entry->lock);
    uint64_t most = info->length, had = info->offset + writer->staged_bytes;
    bool staged = writer->staged.fd >= 0, ok = may_write(writer, problem);
    if (ok && (had > most || count > most - had)) {
        upload_piece_too_large(had < most ? most - had : 0, UINT64_MAX, problem);
        ok = false;
    }
    if (ok && !scratch_may_go_on(writer->uploads->scratch, had, count))
        ok = refuse_io("the piece can't be stored", problem);
    uint64_t more = most == UINT64_MAX ? count : 0;
    ok = ok && reserve(writer->uploads, info, more, writer->principal_bytes * (more > 0), problem);
    if (ok && !write_at(staged ? writer->staged.fd : writer->fd, staged ? writer->staged_bytes : info->offset, bytes,
                        count, problem)) {
        catalog_release(writer->uploads->catalog, info->principal, more);
        ok = false;
    }
    if (ok && staged) writer->staged_bytes += count, writer->reserved += more;
    if (ok && !staged) info->offset += count, entry->reserved += more;
    pthread_mutex_unlock(&entry->lock);
    if (ok && writer->digest) digest_update(writer->digest, bytes, count);
    return ok;
}

/* Copies the piece that was gathered to where it belongs. */
static bool copy_piece(struct local_writer *writer, uint64_t offset, struct problem *problem) {
    char *block = malloc(COPY_BYTES);
    bool ok = block || refuse(PROBLEM_INTERNAL_ERROR, "no memory", problem);
    for (uint64_t done = 0; ok && done < writer->staged_bytes;) {
        uint64_t left = writer->staged_bytes - done;
        ssize_t n = pread(writer->staged.fd, block, left < COPY_BYTES ? (size_t)left : COPY_BYTES, (off_t)done);
        ok = n > 0 ? write_at(writer->fd, offset + done, block, (size_t)n, problem)
                   : refuse_io("the piece can't be read", problem);
        if (ok) done += (uint64_t)n;
    }
    free(block);
    return ok;
}

/* Waits for its turn to flush the file and write the row; returns with the entry locked, `leave` follows. */
static void enter(struct entry *entry) {
    pthread_mutex_lock(&entry->lock);
    while (entry->busy) pthread_cond_wait(&entry->changed, &entry->lock);
    entry->busy = true;
}

static void leave(struct entry *entry) {
    entry->busy = entry->ending = false;
    pthread_cond_broadcast(&entry->changed);
    pthread_mutex_unlock(&entry->lock);
}

/* Flushes the file, then writes the row. */
static enum status make_durable(struct local *uploads, struct catalog_upload *row, int fd, struct error *error) {
    memcpy(row->boot, uploads->boot, sizeof row->boot);
    enum status status = scratch_part_sync(uploads->scratch, fd, error);
    return status == STATUS_OK ? catalog_put_upload(uploads->catalog, row, error) : status;
}

/* What was made durable counts, unless the upload was deleted meanwhile.  Under the entry's lock. */
static bool settle(struct local *uploads, struct entry *entry, const struct catalog_upload *row) {
    struct error error = {0};
    if (!entry->gone) {
        entry->durable = row->offset;
        entry->known = true;
        return true;
    }
    if (delete_row(uploads, row->id, &error) != STATUS_OK) log_line(LOG_ERROR, "upload=%s: %s", row->id, error.text);
    return false;
}

static bool local_end(struct uploads_writer *any, int64_t expires_ms, struct catalog_upload *info,
                      struct problem *problem) {
    struct local_writer *writer = local_writer_of(any);
    struct entry *entry = writer->entry;
    struct error error = {0};
    if (!uploads_check_piece(&writer->check, writer->digest, problem)) return false;
    enter(entry);
    bool ok = may_write(writer, problem);
    entry->ending = ok;
    entry->info.expires_ms = expires_ms;
    struct catalog_upload row = entry->info;
    pthread_mutex_unlock(&entry->lock);
    ok = ok && copy_piece(writer, row.offset, problem);
    row.offset += writer->staged_bytes;
    if (ok && make_durable(writer->uploads, &row, writer->fd, &error) != STATUS_OK) {
        problem_from_error(problem, &error);
        ok = false;
    }
    pthread_mutex_lock(&entry->lock);
    if (ok && !settle(writer->uploads, entry, &row)) ok = refuse(PROBLEM_NO_SUCH_UPLOAD, "it was deleted", problem);
    if (ok) {
        entry->info.offset = row.offset;
        entry->reserved += writer->reserved;
        writer->reserved = 0;
    }
    writer->staged_bytes = 0;
    *info = entry->info;
    leave(entry);
    return ok;
}

/* ------------------------------------------------------------------------------------------------ ends */

static enum status local_complete(struct uploads *all, const char *id, const char *sha256, struct error *error) {
    struct local *uploads = local_of(all);
    struct entry *entry = hold(uploads, id);
    if (!entry) return STATUS_OK;
    wall_clock_hold(); /* the row has an end, too */
    enter(entry);
    struct catalog_upload row = entry->info;
    snprintf(row.cloud, sizeof row.cloud, "%s", sha256);
    memcpy(row.boot, uploads->boot, sizeof row.boot);
    pthread_mutex_unlock(&entry->lock);
    enum status status = catalog_put_upload(uploads->catalog, &row, error);
    pthread_mutex_lock(&entry->lock);
    if (status == STATUS_OK && settle(uploads, entry, &row)) {
        memcpy(entry->info.cloud, row.cloud, JOB_HASH_BYTES);
        release(uploads, entry); /* counted as a cloud now */
    }
    leave(entry);
    wall_clock_release();
    if (status == STATUS_OK) scratch_part_delete(uploads->scratch, id);
    let_go(uploads, entry);
    return status;
}

/* Of an entry that was taken out. */
static enum status remove_taken(struct local *uploads, const struct entry *entry, struct error *error) {
    enum status status = delete_row(uploads, entry->info.id, error);
    scratch_part_delete(uploads->scratch, entry->info.id);
    return status;
}

static enum status local_delete(struct uploads *all, const char *id, struct error *error) {
    struct local *uploads = local_of(all);
    struct entry *entry = hold(uploads, id);
    if (!entry) return STATUS_OK;
    take_out(uploads, entry, NULL);
    enum status status = remove_taken(uploads, entry, error);
    let_go(uploads, entry);
    return status;
}

/* Flushes what came since the last time. */
static void flush(struct local *uploads, struct entry *entry) {
    struct error error = {0};
    enter(entry);
    bool hasher = entry->known && !entry->gone && !entry->info.cloud[0] && entry->durable != entry->info.offset;
    struct catalog_upload row = entry->info;
    pthread_mutex_unlock(&entry->lock);
    int fd = hasher ? scratch_part_open(uploads->scratch, row.id, false) : -1;
    bool ok = fd >= 0 && make_durable(uploads, &row, fd, &error) == STATUS_OK;
    if (hasher && !ok) log_line(LOG_ERROR, "upload=%s can't be flushed: %s", row.id, error.text);
    if (fd >= 0) close(fd);
    pthread_mutex_lock(&entry->lock);
    if (ok) (void)settle(uploads, entry, &row);
    leave(entry);
}

static void sweep_one(struct local *uploads, struct entry *entry, int64_t now_ms) {
    struct error error = {0};
    if (!take_out(uploads, entry, &now_ms))
        flush(uploads, entry);
    else if (remove_taken(uploads, entry, &error) == STATUS_OK)
        log_line(LOG_INFO, "upload=%s expired", entry->info.id);
    else
        log_line(LOG_ERROR, "upload=%s can't expire: %s", entry->info.id, error.text);
}

/* The i-th entry, held; NULL past the last. */
static struct entry *hold_nth(struct local *uploads, uint64_t i) {
    pthread_mutex_lock(&uploads->lock);
    struct entry *entry = uploads->first;
    while (entry && i--) entry = entry->next;
    if (entry) entry->holders++;
    pthread_mutex_unlock(&uploads->lock);
    return entry;
}

/* From the last to the first, so that removing one moves none that is still to come. */
static void local_sweep(struct uploads *all, int64_t now_ms) {
    struct local *uploads = local_of(all);
    pthread_mutex_lock(&uploads->lock);
    uint64_t count = uploads->count;
    pthread_mutex_unlock(&uploads->lock);
    for (uint64_t i = count; i-- > 0;) {
        struct entry *entry = hold_nth(uploads, i);
        if (!entry) continue;
        sweep_one(uploads, entry, now_ms);
        let_go(uploads, entry);
    }
}

static void local_move_ends(struct uploads *all, int64_t step_ms) {
    struct local *uploads = local_of(all);
    pthread_mutex_lock(&uploads->lock);
    for (struct entry *entry = uploads->first; entry; entry = entry->next) {
        pthread_mutex_lock(&entry->lock);
        entry->info.expires_ms += step_ms;
        pthread_mutex_unlock(&entry->lock);
    }
    pthread_mutex_unlock(&uploads->lock);
}

/* It is one. */
static enum status local_gather(struct uploads *all, const char *id, uint64_t bytes, struct error *error) {
    (void)all, (void)id, (void)bytes, (void)error;
    return STATUS_OK;
}

const struct uploads_kind uploads_local = {
    .open = local_open,
    .close = local_close,
    .find = local_find,
    .find_final = local_find_final,
    .create = local_create,
    .resume = local_resume,
    .interrupt = local_interrupt,
    .write = local_write,
    .end = local_end,
    .writer_free = local_writer_free,
    .gather = local_gather,
    .complete = local_complete,
    .delete = local_delete,
    .sweep = local_sweep,
    .move_ends = local_move_ends,
};
