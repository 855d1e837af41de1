/* The store as a folder.
 *
 *     whittled.db             the queue's
 *     signing.key             of the links that are handed out
 *     lock                    held by the process that serves the folder
 *     clouds/<sha256>         inputs, by content
 *     jobs/<id>/log           standard error of the job's processes
 *     jobs/<id>/outputs/...   outputs of a job that succeeded
 *     uploads/<id>            resumable uploads, as much of them as there is
 *     tmp/                    what is being written, or being removed; emptied at the start
 *
 * Invariant: a name outside of tmp/ stands for complete content: it appears by rename after fsync, and the folder is
 * fsynced before anybody is told.  A job's folder is taken away by renaming it into tmp/ first.
 *
 * Names come from ids and hashes that this program made, or are checked against the queue before they get here; all
 * the same they are used relative to open folders, and one with a slash is refused.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/store.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

#include "core/alloc.h"
#include "core/fault.h"
#include "server/digest.h"

enum { FOLDER_MODE = 0700, FILE_MODE = 0600 };

struct store {
    char root[PATH_MAX];
    int root_fd, clouds_fd, jobs_fd, parts_fd, tmp_fd, lock_fd;
    _Atomic uint64_t kept_free_bytes;
    _Atomic int64_t tried_s; /* when store_takes_files has written one; 0 = never */
    _Atomic bool took;       /* and whether that went well */
};

static enum status refused(struct error *error, const char *what, const char *name) {
    return error_set(error, status_from_errno(errno), "store", "can't %s %s: %s", what, name, strerror(errno));
}

/* ------------------------------------------------------------------------------------------------ open */

static int open_folder(int at, const char *name) {
    return openat(at, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
}

static int make_folder(int at, const char *name) {
    if (mkdirat(at, name, FOLDER_MODE) != 0 && errno != EEXIST) return -1;
    return open_folder(at, name);
}

/* The folder and, where they are missing, those above it. */
static int make_path(const char *folder) {
    char path[PATH_MAX];
    int n = snprintf(path, sizeof path, "%s", folder);
    if (n <= 0 || n >= PATH_MAX) {
        errno = ENAMETOOLONG;
        return -1;
    }
    for (char *slash = strchr(path + 1, '/'); slash; slash = strchr(slash + 1, '/')) {
        *slash = 0;
        if (mkdir(path, FOLDER_MODE) != 0 && errno != EEXIST) return -1;
        *slash = '/';
    }
    return mkdir(path, FOLDER_MODE) != 0 && errno != EEXIST ? -1 : 0;
}

/* A killed service's lock outlives it for the moment in which a child of its own, forked, has not yet become another
 * program: so the lock is tried for a while. */
static enum status lock_folder(struct store *store, struct error *error) {
    enum { TRIES = 100 };
    static const struct timespec pause = {.tv_nsec = 20 * 1000 * 1000};
    store->lock_fd = openat(store->root_fd, "lock", O_RDWR | O_CREAT | O_CLOEXEC, FILE_MODE);
    if (store->lock_fd < 0) return refused(error, "open", "lock");
    for (int i = 0; i < TRIES; i++) {
        if (flock(store->lock_fd, LOCK_EX | LOCK_NB) == 0) return STATUS_OK;
        nanosleep(&pause, NULL);
    }
    return error_set(error, STATUS_IO, "store", "another whittled serves the folder %s", store->root);
}

static enum status open_folders(struct store *store, const char *folder, struct error *error) {
    if (make_path(folder) != 0 || !realpath(folder, store->root)) return refused(error, "make the folder", folder);
    store->root_fd = open(store->root, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (store->root_fd < 0) return refused(error, "open", store->root);
    enum status status = lock_folder(store, error);
    if (status != STATUS_OK) return status;
    store->clouds_fd = make_folder(store->root_fd, "clouds");
    store->jobs_fd = make_folder(store->root_fd, "jobs");
    store->parts_fd = make_folder(store->root_fd, "uploads");
    store->tmp_fd = make_folder(store->root_fd, "tmp");
    if (store->clouds_fd < 0 || store->jobs_fd < 0 || store->parts_fd < 0 || store->tmp_fd < 0 ||
        fsync(store->root_fd) != 0)
        return refused(error, "make folders in", store->root);
    return STATUS_OK;
}

enum status store_open(const char *folder, struct store **store, struct error *error) {
    struct store *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "store", "no memory");
    opened->root_fd = opened->clouds_fd = opened->jobs_fd = opened->parts_fd = opened->tmp_fd = opened->lock_fd = -1;
    enum status status = open_folders(opened, folder, error);
    if (status == STATUS_OK)
        *store = opened;
    else
        store_close(opened);
    return status;
}

static void close_if_open(int fd) {
    if (fd >= 0) close(fd);
}

void store_close(struct store *store) {
    if (!store) return;
    const int fds[] = {store->clouds_fd, store->jobs_fd, store->parts_fd,
                       store->tmp_fd,    store->root_fd, store->lock_fd};
    for (size_t i = 0; i < sizeof fds / sizeof *fds; i++) close_if_open(fds[i]);
    free(store);
}

void store_database_path(const struct store *store, char path[STORE_PATH_BYTES]) {
    snprintf(path, STORE_PATH_BYTES, "%.4000s/whittled.db", store->root);
}

void store_key_path(const struct store *store, char path[STORE_PATH_BYTES]) {
    snprintf(path, STORE_PATH_BYTES, "%.4000s/signing.key", store->root);
}

uint64_t store_free_bytes(const struct store *store) {
    struct statvfs figures;
    if (fstatvfs(store->tmp_fd, &figures) != 0) return UINT64_MAX;
    return (uint64_t)figures.f_bavail * figures.f_frsize;
}

void store_keep_free(struct store *store, uint64_t bytes) { store->kept_free_bytes = bytes; }

bool store_has_room(const struct store *store, uint64_t bytes) {
    uint64_t room = store_free_bytes(store), kept = store->kept_free_bytes;
    return room >= kept && room - kept >= bytes;
}

bool store_may_go_on(const struct store *store, uint64_t before, uint64_t count) {
    bool asks = before / STORE_STRIDE_BYTES != (before + count) / STORE_STRIDE_BYTES;
    if (!asks || store_has_room(store, 0)) return true;
    errno = ENOSPC;
    return false;
}

bool store_takes_files(struct store *store) {
    static const char block[4096] = "x";
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    if (store->tried_s == now.tv_sec + 1) return store->took; /* + 1, for that clock may begin at 0 */
    int fd = store_scratch_open(store);
    store->took = fd >= 0 && write(fd, block, sizeof block) == sizeof block;
    store->tried_s = now.tv_sec + 1;
    close_if_open(fd);
    return store->took;
}

/* ------------------------------------------------------------------------------------------------ removing */

/* Removes a file, or a folder with what is in it (two levels are all there ever are). */
static void remove_tree(int at, const char *name, int depth) {
    if (unlinkat(at, name, 0) == 0 || (errno != EISDIR && errno != EPERM)) return;
    int fd = depth ? open_folder(at, name) : -1;
    DIR *folder = fd >= 0 ? fdopendir(fd) : NULL;
    if (!folder) {
        close_if_open(fd);
        return;
    }
    for (struct dirent *entry; (entry = readdir(folder));)
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0)
            remove_tree(dirfd(folder), entry->d_name, depth - 1);
    closedir(folder);
    unlinkat(at, name, AT_REMOVEDIR);
}
enum { DEPTH = 3 };

static void random_name(const char *prefix, char name[STORE_NAME_BYTES]) {
    uint64_t random[2] = {0};
    ssize_t n = getrandom(random, sizeof random, 0); /* 16 bytes are never cut short */
    (void)n;
    snprintf(name, STORE_NAME_BYTES, "%s-%016llx%016llx", prefix, (unsigned long long)random[0],
             (unsigned long long)random[1]);
}

static void remove_by_way_of_tmp(struct store *store, int at, const char *name) {
    char gone[STORE_NAME_BYTES];
    random_name("gone", gone);
    if (fault_at("remove-rename") || renameat(at, name, store->tmp_fd, gone) != 0) return;
    fsync(at);
    fault_at("removed");
    remove_tree(store->tmp_fd, gone, DEPTH);
}

/* ------------------------------------------------------------------------------------------------ clouds */

enum status store_upload_begin(struct store *store, struct store_upload *upload, struct error *error) {
    random_name("upload", upload->name);
    upload->fd = fault_at("upload-open")
                     ? -1
                     : openat(store->tmp_fd, upload->name, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, FILE_MODE);
    return upload->fd < 0 ? refused(error, "make", upload->name) : STATUS_OK;
}

enum status store_upload_sync(struct store_upload *upload, struct error *error) {
    bool failed = fault_at("upload-sync") || fsync(upload->fd) != 0;
    return failed ? refused(error, "flush", upload->name) : STATUS_OK;
}

enum status store_upload_keep(struct store *store, struct store_upload *upload, const char *sha256,
                              struct error *error) {
    if (fault_at("upload-rename") || renameat(store->tmp_fd, upload->name, store->clouds_fd, sha256) != 0)
        return refused(error, "keep", upload->name);
    upload->name[0] = 0;
    if (fault_at("upload-folder-sync") || fsync(store->clouds_fd) != 0) return refused(error, "keep", sha256);
    close(upload->fd);
    upload->fd = -1;
    return STATUS_OK;
}

void store_upload_drop(struct store *store, struct store_upload *upload) {
    close_if_open(upload->fd);
    upload->fd = -1;
    if (upload->name[0]) unlinkat(store->tmp_fd, upload->name, 0);
    upload->name[0] = 0;
}

void store_cloud_path(const struct store *store, const char *sha256, char path[STORE_PATH_BYTES]) {
    snprintf(path, STORE_PATH_BYTES, "%.3900s/clouds/%.80s", store->root, sha256);
}

int store_cloud_open(const struct store *store, const char *sha256) {
    return openat(store->clouds_fd, sha256, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
}

bool store_cloud_exists(const struct store *store, const char *sha256) {
    return faccessat(store->clouds_fd, sha256, R_OK, 0) == 0;
}

void store_cloud_delete(struct store *store, const char *sha256) { unlinkat(store->clouds_fd, sha256, 0); }

/* ------------------------------------------------------------------------------------------------ parts */

int store_part_open(struct store *store, const char *id, bool create) {
    int flags = O_RDWR | O_CLOEXEC | O_NOFOLLOW | (create ? O_CREAT | O_EXCL : 0);
    return openat(store->parts_fd, id, flags, FILE_MODE);
}

enum status store_part_sync(struct store *store, int fd, struct error *error) {
    return fsync(fd) == 0 && fsync(store->parts_fd) == 0 ? STATUS_OK : refused(error, "flush", "an upload");
}

enum status store_part_keep(struct store *store, const char *id, const char *sha256, struct error *error) {
    bool there = linkat(store->parts_fd, id, store->clouds_fd, sha256, 0) == 0 || errno == EEXIST;
    return there && fsync(store->clouds_fd) == 0 ? STATUS_OK : refused(error, "keep", id);
}

void store_part_delete(struct store *store, const char *id) { unlinkat(store->parts_fd, id, 0); }

/* ------------------------------------------------------------------------------------------------ outputs */

enum status store_outputs_begin(struct store *store, const char *id, char path[STORE_PATH_BYTES], struct error *error) {
    remove_tree(store->tmp_fd, id, DEPTH);
    if (fault_at("outputs-begin") || mkdirat(store->tmp_fd, id, FOLDER_MODE) != 0)
        return refused(error, "make a folder for", id);
    snprintf(path, STORE_PATH_BYTES, "%.3900s/tmp/%.80s", store->root, id);
    return STATUS_OK;
}

void store_outputs_drop(struct store *store, const char *id) { remove_tree(store->tmp_fd, id, DEPTH); }

/* Hashes and flushes one output. */
static enum status take_output(int folder_fd, const char *name, struct job_output *output, struct error *error) {
    int fd = fault_at("output-open") ? -1 : openat(folder_fd, name, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    struct stat facts;
    if (fd < 0) return refused(error, "open", name);
    enum status status = STATUS_OK;
    if (fstat(fd, &facts) != 0 || !S_ISREG(facts.st_mode))
        status = error_set(error, STATUS_IO, "store", "%s is no file", name);
    else if (digest_file(fd, output->sha256, &output->bytes) != 0 || fault_at("output-sync") || fsync(fd) != 0)
        status = refused(error, "read", name);
    snprintf(output->name, sizeof output->name, "%.*s", JOB_OUTPUT_NAME_BYTES - 1, name);
    close(fd);
    return status;
}

static int is_visible(const struct dirent *entry) { return entry->d_name[0] != '.'; }

static enum status take_outputs(int folder_fd, struct job_output *outputs, size_t *count, struct error *error) {
    struct dirent **entries;
    int n = scandirat(folder_fd, ".", &entries, is_visible, alphasort);
    if (n < 0) return refused(error, "list", "outputs");
    enum status status = STATUS_OK;
    *count = 0;
    for (int i = 0; i < n; i++) {
        const char *name = entries[i]->d_name;
        if (status == STATUS_OK && (*count == JOB_MAX_OUTPUTS || strlen(name) >= JOB_OUTPUT_NAME_BYTES))
            status = error_set(error, STATUS_IO, "store", "too many outputs, or too long a name: %.80s", name);
        if (status == STATUS_OK) status = take_output(folder_fd, name, &outputs[(*count)++], error);
        free(entries[i]);
    }
    free(entries);
    if (status == STATUS_OK && fsync(folder_fd) != 0) status = refused(error, "flush", "outputs");
    return status;
}

static enum status move_outputs(struct store *store, const char *id, struct error *error) {
    int job_fd = make_folder(store->jobs_fd, id);
    if (job_fd < 0) return refused(error, "make a folder for", id);
    remove_by_way_of_tmp(store, job_fd, "outputs"); /* of a run whose end was never recorded */
    enum status status = STATUS_OK;
    if (fault_at("outputs-rename") || renameat(store->tmp_fd, id, job_fd, "outputs") != 0 ||
        fault_at("outputs-folder-sync") || fsync(job_fd) != 0 || fsync(store->jobs_fd) != 0)
        status = refused(error, "keep the outputs of", id);
    close(job_fd);
    return status;
}

enum status store_outputs_keep(struct store *store, const char *id, struct job_output *outputs, size_t *count,
                               struct error *error) {
    int folder_fd = open_folder(store->tmp_fd, id);
    if (folder_fd < 0) return refused(error, "open the outputs of", id);
    enum status status = take_outputs(folder_fd, outputs, count, error);
    close(folder_fd);
    return status == STATUS_OK ? move_outputs(store, id, error) : status;
}

static enum status link_outputs(int from_fd, int to_fd, struct error *error) {
    struct dirent **entries;
    int n = scandirat(from_fd, ".", &entries, is_visible, alphasort);
    if (n < 0) return refused(error, "list", "outputs");
    enum status status = STATUS_OK;
    for (int i = 0; i < n; i++) {
        const char *name = entries[i]->d_name;
        if (status == STATUS_OK && linkat(from_fd, name, to_fd, name, 0) != 0) status = refused(error, "link", name);
        free(entries[i]);
    }
    free(entries);
    if (status == STATUS_OK && fsync(to_fd) != 0) status = refused(error, "flush", "outputs");
    return status;
}

enum status store_outputs_share(struct store *store, const char *from_id, const char *to_id, struct error *error) {
    char path[128], to_path[STORE_PATH_BYTES];
    snprintf(path, sizeof path, "%.80s/outputs", from_id);
    int from_fd = open_folder(store->jobs_fd, path), to_fd = -1;
    enum status status = from_fd < 0 ? refused(error, "open the outputs of", from_id)
                                     : store_outputs_begin(store, to_id, to_path, error);
    if (status == STATUS_OK) {
        to_fd = open_folder(store->tmp_fd, to_id);
        status = to_fd < 0 ? refused(error, "open a folder for", to_id) : link_outputs(from_fd, to_fd, error);
        if (status == STATUS_OK) status = move_outputs(store, to_id, error);
        if (status != STATUS_OK) store_outputs_drop(store, to_id);
    }
    close_if_open(from_fd);
    close_if_open(to_fd);
    return status;
}

/* Opens jobs/<id>/<name>, or jobs/<id>/<folder>/<name>. */
static int open_in_job(const struct store *store, const char *id, const char *folder, const char *name) {
    char path[256];
    int n = snprintf(path, sizeof path, "%s/%s%s%s", id, folder ? folder : "", folder ? "/" : "", name);
    if (n < 0 || (size_t)n >= sizeof path || strchr(name, '/') || name[0] == '.') return -1;
    return openat(store->jobs_fd, path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
}

int store_output_open(const struct store *store, const char *id, const char *name) {
    return open_in_job(store, id, "outputs", name);
}

int store_scratch_open(const struct store *store) {
    char name[STORE_NAME_BYTES];
    int fd = openat(store->tmp_fd, ".", O_RDWR | O_TMPFILE | O_CLOEXEC, FILE_MODE);
    if (fd >= 0 || errno != EOPNOTSUPP) return fd;
    random_name("scratch", name); /* a file system without nameless files */
    fd = openat(store->tmp_fd, name, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, FILE_MODE);
    if (fd >= 0) unlinkat(store->tmp_fd, name, 0);
    return fd;
}

bool store_outputs_exist(const struct store *store, const char *id) {
    char path[128];
    snprintf(path, sizeof path, "%.80s/outputs", id);
    return faccessat(store->jobs_fd, path, X_OK, 0) == 0;
}

int store_outputs_count(const struct store *store, const char *id) {
    char path[128];
    struct dirent **entries;
    snprintf(path, sizeof path, "%.80s/outputs", id);
    int n = scandirat(store->jobs_fd, path, &entries, is_visible, alphasort);
    for (int i = 0; i < n; i++) free(entries[i]);
    if (n >= 0) free(entries);
    return n;
}

int store_log_open(struct store *store, const char *id, bool append) {
    if (!append) return open_in_job(store, id, NULL, "log");
    int job_fd = make_folder(store->jobs_fd, id);
    if (job_fd < 0) return -1;
    int fd = openat(job_fd, "log", O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | O_NOFOLLOW, FILE_MODE);
    close(job_fd);
    return fd;
}

void store_outputs_delete(struct store *store, const char *id) {
    int job_fd = open_folder(store->jobs_fd, id);
    if (job_fd < 0) return;
    remove_by_way_of_tmp(store, job_fd, "outputs");
    close(job_fd);
}

void store_job_delete(struct store *store, const char *id) { remove_by_way_of_tmp(store, store->jobs_fd, id); }

/* ------------------------------------------------------------------------------------------------ all of it */

static enum status each_in(int folder_fd, enum store_thing thing,
                           void (*found)(void *ctx, enum store_thing thing, const char *name), void *ctx) {
    struct dirent **entries;
    int n = scandirat(folder_fd, ".", &entries, is_visible, alphasort);
    if (n < 0) return STATUS_IO;
    for (int i = 0; i < n; i++) {
        found(ctx, thing, entries[i]->d_name);
        free(entries[i]);
    }
    free(entries);
    return STATUS_OK;
}

enum status store_each(const struct store *store, void (*found)(void *ctx, enum store_thing thing, const char *name),
                       void *ctx, struct error *error) {
    enum status status = each_in(store->clouds_fd, STORE_CLOUD, found, ctx);
    if (status == STATUS_OK) status = each_in(store->jobs_fd, STORE_JOB, found, ctx);
    if (status == STATUS_OK) status = each_in(store->parts_fd, STORE_PART, found, ctx);
    if (status == STATUS_OK) status = each_in(store->tmp_fd, STORE_TEMPORARY, found, ctx);
    return status == STATUS_OK ? STATUS_OK : refused(error, "list", store->root);
}

/* ------------------------------------------------------------------------------------------------ clean */

/* Lists a folder (which may change meanwhile) and removes what keep denies; keep NULL denies everything. */
static enum status clean_folder(struct store *store, int folder_fd, enum store_thing thing,
                                bool (*keep)(void *ctx, enum store_thing thing, const char *name), void *ctx,
                                size_t *removed) {
    struct dirent **entries;
    int n = scandirat(folder_fd, ".", &entries, is_visible, alphasort);
    if (n < 0) return STATUS_IO;
    for (int i = 0; i < n; i++) {
        if (!keep || !keep(ctx, thing, entries[i]->d_name)) {
            if (folder_fd == store->tmp_fd)
                remove_tree(folder_fd, entries[i]->d_name, DEPTH);
            else
                remove_by_way_of_tmp(store, folder_fd, entries[i]->d_name);
            ++*removed;
        }
        free(entries[i]);
    }
    free(entries);
    return STATUS_OK;
}

enum status store_clean(struct store *store, bool (*keep)(void *ctx, enum store_thing thing, const char *name),
                        void *ctx, size_t *removed, struct error *error) {
    *removed = 0;
    enum status status = clean_folder(store, store->tmp_fd, STORE_TEMPORARY, NULL, NULL, removed);
    if (status == STATUS_OK) status = clean_folder(store, store->clouds_fd, STORE_CLOUD, keep, ctx, removed);
    if (status == STATUS_OK) status = clean_folder(store, store->jobs_fd, STORE_JOB, keep, ctx, removed);
    if (status == STATUS_OK) status = clean_folder(store, store->parts_fd, STORE_PART, keep, ctx, removed);
    return status == STATUS_OK ? STATUS_OK : refused(error, "list", store->root);
}
