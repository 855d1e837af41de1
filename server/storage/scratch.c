/* Scratch: the data folder of a host, held for one process.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/scratch.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/fault.h"
#include "server/blobs/lost_found.h"

struct scratch {
    char root[PATH_MAX];
    int root_fd, jobs_fd, parts_fd, tmp_fd, lock_fd;
    _Atomic uint64_t kept_free_bytes;
};

static enum status scratch_refused(struct error *error, const char *what, const char *name) {
    return error_set(error, status_from_errno(errno), "scratch", "can't %s %s: %s", what, name, strerror(errno));
}

/* ------------------------------------------------------------------------------------------------ open */

static bool is_named(int at, const char *name, int fd) {
    struct stat named, opened;
    return fstatat(at, name, &named, 0) == 0 && fstat(fd, &opened) == 0 && named.st_dev == opened.st_dev &&
           named.st_ino == opened.st_ino;
}

/* false, with errno EWOULDBLOCK: somebody else has it, or its name was given to another file meanwhile. */
static bool lock_once(struct scratch *scratch) {
    folders_close(scratch->lock_fd);
    scratch->lock_fd = openat(scratch->root_fd, "lock", O_RDWR | O_CREAT | O_CLOEXEC, FOLDERS_FILE_MODE);
    if (scratch->lock_fd < 0) return false;
    if (flock(scratch->root_fd, LOCK_EX | LOCK_NB) != 0 || flock(scratch->lock_fd, LOCK_EX | LOCK_NB) != 0)
        return false;
    errno = EWOULDBLOCK;
    return is_named(AT_FDCWD, scratch->root, scratch->root_fd) && is_named(scratch->root_fd, "lock", scratch->lock_fd);
}

/* The folder itself is locked, which can't be removed while anything is in it; and the file `lock`, which programs of
 * earlier versions look at, and on a shared file system other hosts.  A killed service's lock outlives it for the
 * moment in which a child of its own, forked, has not yet become another program: so it is tried for a while. */
static enum status lock_folder(struct scratch *scratch, struct error *error) {
    enum { TRIES = 100 };
    static const struct timespec pause = {.tv_nsec = 20 * 1000 * 1000};
    for (int i = 0; i < TRIES; i++) {
        if (lock_once(scratch)) return STATUS_OK;
        if (errno != EWOULDBLOCK) return scratch_refused(error, "lock", scratch->root);
        nanosleep(&pause, NULL);
    }
    return error_set(error, STATUS_IO, "scratch", "another whittled serves the folder %s", scratch->root);
}

static enum status open_folders(struct scratch *scratch, const char *folder, struct error *error) {
    if (folders_make_path(folder) != 0 || !realpath(folder, scratch->root))
        return scratch_refused(error, "make the folder", folder);
    scratch->root_fd = open(scratch->root, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (scratch->root_fd < 0) return scratch_refused(error, "open", scratch->root);
    enum status status = lock_folder(scratch, error);
    if (status != STATUS_OK) return status;
    scratch->jobs_fd = folders_make(scratch->root_fd, "jobs");
    scratch->parts_fd = folders_make(scratch->root_fd, "uploads");
    scratch->tmp_fd = folders_make(scratch->root_fd, "tmp");
    if (scratch->jobs_fd < 0 || scratch->parts_fd < 0 || scratch->tmp_fd < 0 || fsync(scratch->root_fd) != 0)
        return scratch_refused(error, "make folders in", scratch->root);
    return STATUS_OK;
}

enum status scratch_open(const char *folder, struct scratch **scratch, struct error *error) {
    struct scratch *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "scratch", "no memory");
    opened->root_fd = opened->jobs_fd = opened->parts_fd = opened->tmp_fd = opened->lock_fd = -1;
    enum status status = open_folders(opened, folder, error);
    if (status == STATUS_OK)
        *scratch = opened;
    else
        scratch_close(opened);
    return status;
}

void scratch_close(struct scratch *scratch) {
    if (!scratch) return;
    const int fds[] = {scratch->jobs_fd, scratch->parts_fd, scratch->tmp_fd, scratch->root_fd, scratch->lock_fd};
    for (size_t i = 0; i < sizeof fds / sizeof *fds; i++) folders_close(fds[i]);
    free(scratch);
}

const char *scratch_folder(const struct scratch *scratch) { return scratch->root; }

void scratch_key_path(const struct scratch *scratch, char path[SCRATCH_PATH_BYTES]) {
    snprintf(path, SCRATCH_PATH_BYTES, "%.4000s/signing.key", scratch->root);
}

/* ------------------------------------------------------------------------------------------------ identity */

enum status scratch_identity(const struct scratch *scratch, char id[SCRATCH_IDENTITY_BYTES], struct error *error) {
    id[0] = 0;
    int fd = openat(scratch->root_fd, "identity", O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0) return errno == ENOENT ? STATUS_OK : scratch_refused(error, "open", "identity");
    ssize_t n = read(fd, id, SCRATCH_IDENTITY_BYTES - 1);
    enum status status = n < 0 ? scratch_refused(error, "read", "identity") : STATUS_OK;
    id[n > 0 ? n : 0] = 0;
    close(fd);
    return status;
}

enum status scratch_set_identity(struct scratch *scratch, const char *id, struct error *error) {
    size_t bytes = strlen(id);
    int fd =
        openat(scratch->tmp_fd, "identity", O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, FOLDERS_FILE_MODE);
    bool done = fd >= 0 && write(fd, id, bytes) == (ssize_t)bytes && fsync(fd) == 0 &&
                renameat(scratch->tmp_fd, "identity", scratch->root_fd, "identity") == 0 &&
                fsync(scratch->root_fd) == 0;
    enum status status = done ? STATUS_OK : scratch_refused(error, "write", "identity");
    folders_close(fd);
    return status;
}

/* ------------------------------------------------------------------------------------------------ room */

uint64_t scratch_free_bytes(const struct scratch *scratch) {
    struct statvfs figures;
    if (fstatvfs(scratch->tmp_fd, &figures) != 0) return UINT64_MAX;
    return (uint64_t)figures.f_bavail * figures.f_frsize;
}

void scratch_keep_free(struct scratch *scratch, uint64_t bytes) { scratch->kept_free_bytes = bytes; }

bool scratch_has_room(const struct scratch *scratch, uint64_t bytes) {
    uint64_t room = scratch_free_bytes(scratch), kept = scratch->kept_free_bytes;
    return room >= kept && room - kept >= bytes;
}

bool scratch_may_go_on(const struct scratch *scratch, uint64_t before, uint64_t count) {
    bool asks = before / SCRATCH_STRIDE_BYTES != (before + count) / SCRATCH_STRIDE_BYTES;
    if (!asks || scratch_has_room(scratch, 0)) return true;
    errno = ENOSPC;
    return false;
}

enum status scratch_takes_files(struct scratch *scratch, struct error *error) {
    static const char block[4096] = "x";
    errno = ENOSPC; /* where it is written in part */
    int fd = fault_at("scratch") ? -1 : scratch_nameless_open(scratch);
    bool written = fd >= 0 && write(fd, block, sizeof block) == sizeof block;
    enum status status = written ? STATUS_OK : scratch_refused(error, "write files in", scratch->root);
    folders_close(fd);
    return status;
}

/* ------------------------------------------------------------------------------------------------ files */

enum status scratch_file_begin(struct scratch *scratch, struct scratch_file *file, struct error *error) {
    folders_random_name("upload", file->name);
    file->fd = fault_at("upload-open")
                   ? -1
                   : openat(scratch->tmp_fd, file->name, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, FOLDERS_FILE_MODE);
    return file->fd < 0 ? scratch_refused(error, "make", file->name) : STATUS_OK;
}

enum status scratch_file_sync(struct scratch_file *file, struct error *error) {
    bool failed = fault_at("upload-sync") || fsync(file->fd) != 0;
    return failed ? scratch_refused(error, "flush", file->name) : STATUS_OK;
}

struct blobs_source scratch_file_source(const struct scratch *scratch, const struct scratch_file *file,
                                        const char *name, const char *sha256) {
    return (struct blobs_source){.name = name, .folder_fd = scratch->tmp_fd, .file = file->name, .sha256 = sha256};
}

void scratch_file_drop(struct scratch *scratch, struct scratch_file *file) {
    folders_close(file->fd);
    file->fd = -1;
    if (file->name[0]) unlinkat(scratch->tmp_fd, file->name, 0);
    file->name[0] = 0;
}

int scratch_nameless_open(const struct scratch *scratch) {
    char name[FOLDERS_NAME_BYTES];
    int fd = openat(scratch->tmp_fd, ".", O_RDWR | O_TMPFILE | O_CLOEXEC, FOLDERS_FILE_MODE);
    if (fd >= 0 || errno != EOPNOTSUPP) return fd;
    folders_random_name("scratch", name); /* a file system without nameless files */
    fd = openat(scratch->tmp_fd, name, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, FOLDERS_FILE_MODE);
    if (fd >= 0) unlinkat(scratch->tmp_fd, name, 0);
    return fd;
}

/* ------------------------------------------------------------------------------------------------ uploads */

int scratch_part_open(struct scratch *scratch, const char *id, bool create) {
    int flags = O_RDWR | O_CLOEXEC | O_NOFOLLOW | (create ? O_CREAT | O_EXCL : 0);
    return openat(scratch->parts_fd, id, flags, FOLDERS_FILE_MODE);
}

enum status scratch_part_sync(struct scratch *scratch, int fd, struct error *error) {
    return fsync(fd) == 0 && fsync(scratch->parts_fd) == 0 ? STATUS_OK : scratch_refused(error, "flush", "an upload");
}

enum status scratch_part_take(struct scratch *scratch, const char *id, struct scratch_file *file, struct error *error) {
    bool done = renameat(scratch->tmp_fd, file->name, scratch->parts_fd, id) == 0;
    enum status status = done ? STATUS_OK : scratch_refused(error, "keep", id);
    if (done) file->name[0] = 0;
    scratch_file_drop(scratch, file);
    return status;
}

enum status scratch_part_link(struct scratch *scratch, const char *id, struct scratch_file *file, struct error *error) {
    file->fd = -1;
    folders_random_name("part", file->name);
    if (linkat(scratch->parts_fd, id, scratch->tmp_fd, file->name, 0) == 0) return STATUS_OK;
    file->name[0] = 0;
    return scratch_refused(error, "keep", id);
}

void scratch_part_delete(struct scratch *scratch, const char *id) { unlinkat(scratch->parts_fd, id, 0); }

/* ------------------------------------------------------------------------------------------------ runs */

/* The folder in tmp that an attempt writes into. */
static void run_name(const char *id, int attempt, char name[FOLDERS_NAME_BYTES]) {
    snprintf(name, FOLDERS_NAME_BYTES, "%.60s.%d", id, attempt);
}

enum status scratch_run_begin(struct scratch *scratch, const char *job, int attempt, char path[SCRATCH_PATH_BYTES],
                              struct error *error) {
    char name[FOLDERS_NAME_BYTES];
    run_name(job, attempt, name);
    folders_remove(scratch->tmp_fd, name);
    bool fails = fault_at("outputs-begin");
    int fd = fails ? -1 : folders_make(scratch->tmp_fd, name);
    if (fd < 0) return scratch_refused(error, "make a folder for", job);
    folders_close(fd);
    snprintf(path, SCRATCH_PATH_BYTES, "%.3900s/tmp/%.80s", scratch->root, name);
    return STATUS_OK;
}

int scratch_run_open(const struct scratch *scratch, const char *job, int attempt) {
    char name[FOLDERS_NAME_BYTES];
    run_name(job, attempt, name);
    return folders_open(scratch->tmp_fd, name);
}

void scratch_run_drop(struct scratch *scratch, const char *job, int attempt) {
    for (int each = attempt; each >= 1; each--) { /* an earlier one's could have been in the way of a full machine */
        char name[FOLDERS_NAME_BYTES];
        run_name(job, each, name);
        folders_remove(scratch->tmp_fd, name);
    }
}

void scratch_run_drop_alone(struct scratch *scratch, const char *job, int attempt) {
    char name[FOLDERS_NAME_BYTES];
    run_name(job, attempt, name);
    folders_remove(scratch->tmp_fd, name);
}

int scratch_log_open(struct scratch *scratch, const char *job, bool append) {
    int flags = append ? O_WRONLY | O_CREAT | O_APPEND : O_RDONLY;
    int job_fd = append ? folders_make(scratch->jobs_fd, job) : folders_open(scratch->jobs_fd, job);
    if (job_fd < 0) return -1;
    int fd = openat(job_fd, "log", flags | O_CLOEXEC | O_NOFOLLOW, FOLDERS_FILE_MODE);
    close(job_fd);
    return fd;
}

void scratch_log_delete(struct scratch *scratch, const char *job) {
    int job_fd = folders_open(scratch->jobs_fd, job);
    if (job_fd < 0) return;
    unlinkat(job_fd, "log", 0);
    close(job_fd);
    unlinkat(scratch->jobs_fd, job, AT_REMOVEDIR);
}

/* ------------------------------------------------------------------------------------------------ all of it */

int scratch_each_part(const struct scratch *scratch, void (*found)(void *ctx, const char *name), void *ctx) {
    return folders_each(scratch->parts_fd, found, ctx);
}

int scratch_each_log(const struct scratch *scratch, void (*found)(void *ctx, const char *name), void *ctx) {
    return folders_each(scratch->jobs_fd, found, ctx);
}

int scratch_each_temporary(const struct scratch *scratch, void (*found)(void *ctx, const char *name), void *ctx) {
    return folders_each(scratch->tmp_fd, found, ctx);
}

struct wipe {
    int tmp_fd;
    size_t removed;
};

static void wipe_one(void *ctx, const char *name) {
    struct wipe *wipe = ctx;
    folders_remove(wipe->tmp_fd, name);
    wipe->removed++;
}

int scratch_wipe(struct scratch *scratch, size_t *removed) {
    struct wipe wipe = {.tmp_fd = scratch->tmp_fd};
    int result = folders_each(scratch->tmp_fd, wipe_one, &wipe);
    *removed = wipe.removed;
    return result;
}

bool scratch_part_set_aside(struct scratch *scratch, const char *start, const char *id, char place[64]) {
    return lost_found_take(scratch->root_fd, start, scratch->parts_fd, "uploads", id, place);
}

uint64_t scratch_lost(const struct scratch *scratch) { return lost_found_count(scratch->root_fd); }
