/* The store as a folder.
 *
 *     whittled.db             the catalog's, where no setting says otherwise
 *     signing.key             of the links that are handed out
 *     identity                what the database says, too, so that no other one is taken for it
 *     lock                    held, like the folder itself, by the process that serves it
 *     clouds/<sha256>         inputs, by content
 *     jobs/<id>/log           standard error of the job's processes
 *     jobs/<id>/outputs/...   outputs of a job that succeeded; outputs.<n> where they are of its n-th attempt, n > 1
 *     uploads/<id>            resumable uploads, as much of them as there is
 *     tmp/                    what is being written, or being removed; emptied at the start
 *     lost+found/             what the start found and no row names (lost_found.h)
 *
 * Invariant: a name outside of tmp/ stands for complete content: it appears by rename after fsync, and the folder is
 * fsynced before anybody is told.  A job's folder is taken away by renaming it into tmp/ first.
 *
 * Names come from ids and hashes that this program made, or are checked against the queue before they get here; all
 * the same they are used relative to open folders, and one with a slash is refused.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/store.h"

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

#include "core/base/alloc.h"
#include "core/base/fault.h"
#include "server/base/digest.h"
#include "server/blobs/lost_found.h"

enum { FOLDER_MODE = 0700, FILE_MODE = 0600 };

struct store {
    char root[PATH_MAX];
    int root_fd, clouds_fd, jobs_fd, parts_fd, tmp_fd, lock_fd;
    _Atomic uint64_t kept_free_bytes;
};

static enum status refused(struct error *error, const char *what, const char *name) {
    return error_set(error, status_from_errno(errno), "store", "can't %s %s: %s", what, name, strerror(errno));
}

static void close_if_open(int fd) {
    if (fd >= 0) close(fd);
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

static bool is_named(int at, const char *name, int fd) {
    struct stat named, opened;
    return fstatat(at, name, &named, 0) == 0 && fstat(fd, &opened) == 0 && named.st_dev == opened.st_dev &&
           named.st_ino == opened.st_ino;
}

/* false, with errno EWOULDBLOCK: somebody else has it, or its name was given to another file meanwhile. */
static bool lock_once(struct store *store) {
    close_if_open(store->lock_fd);
    store->lock_fd = openat(store->root_fd, "lock", O_RDWR | O_CREAT | O_CLOEXEC, FILE_MODE);
    if (store->lock_fd < 0) return false;
    if (flock(store->root_fd, LOCK_EX | LOCK_NB) != 0 || flock(store->lock_fd, LOCK_EX | LOCK_NB) != 0) return false;
    errno = EWOULDBLOCK;
    return is_named(AT_FDCWD, store->root, store->root_fd) && is_named(store->root_fd, "lock", store->lock_fd);
}

/* The folder itself is locked, which can't be removed while anything is in it; and the file `lock`, which programs of
 * earlier versions look at, and on a shared file system other hosts.  A killed service's lock outlives it for the
 * moment in which a child of its own, forked, has not yet become another program: so it is tried for a while. */
static enum status lock_folder(struct store *store, struct error *error) {
    enum { TRIES = 100 };
    static const struct timespec pause = {.tv_nsec = 20 * 1000 * 1000};
    for (int i = 0; i < TRIES; i++) {
        if (lock_once(store)) return STATUS_OK;
        if (errno != EWOULDBLOCK) return refused(error, "lock", store->root);
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

void store_close(struct store *store) {
    if (!store) return;
    const int fds[] = {store->clouds_fd, store->jobs_fd, store->parts_fd,
                       store->tmp_fd,    store->root_fd, store->lock_fd};
    for (size_t i = 0; i < sizeof fds / sizeof *fds; i++) close_if_open(fds[i]);
    free(store);
}

void store_key_path(const struct store *store, char path[STORE_PATH_BYTES]) {
    snprintf(path, STORE_PATH_BYTES, "%.4000s/signing.key", store->root);
}

/* ------------------------------------------------------------------------------------------------ identity */

enum status store_identity(const struct store *store, char id[STORE_IDENTITY_BYTES], struct error *error) {
    id[0] = 0;
    int fd = openat(store->root_fd, "identity", O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0) return errno == ENOENT ? STATUS_OK : refused(error, "open", "identity");
    ssize_t n = read(fd, id, STORE_IDENTITY_BYTES - 1);
    enum status status = n < 0 ? refused(error, "read", "identity") : STATUS_OK;
    id[n > 0 ? n : 0] = 0;
    close(fd);
    return status;
}

enum status store_set_identity(struct store *store, const char *id, struct error *error) {
    size_t bytes = strlen(id);
    int fd = openat(store->tmp_fd, "identity", O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, FILE_MODE);
    bool done = fd >= 0 && write(fd, id, bytes) == (ssize_t)bytes && fsync(fd) == 0 &&
                renameat(store->tmp_fd, "identity", store->root_fd, "identity") == 0 && fsync(store->root_fd) == 0;
    enum status status = done ? STATUS_OK : refused(error, "write", "identity");
    close_if_open(fd);
    return status;
}

/* ------------------------------------------------------------------------------------------------ room */

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

enum status store_takes_files(struct store *store, struct error *error) {
    static const char block[4096] = "x";
    errno = ENOSPC; /* where it is written in part */
    int fd = fault_at("scratch") ? -1 : store_scratch_open(store);
    bool written = fd >= 0 && write(fd, block, sizeof block) == sizeof block;
    enum status status = written ? STATUS_OK : refused(error, "write files in", store->root);
    close_if_open(fd);
    return status;
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

void store_cloud_delete(struct store *store, const char *sha256) {
    if (unlinkat(store->clouds_fd, sha256, 0) == 0) fsync(store->clouds_fd);
}

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

/* The folder of an attempt's outputs in the job's; earlier versions had one name for all. */
static void outputs_name(int attempt, char name[STORE_NAME_BYTES]) {
    if (attempt > 1)
        snprintf(name, STORE_NAME_BYTES, "outputs.%d", attempt);
    else
        snprintf(name, STORE_NAME_BYTES, "outputs");
}

/* jobs/<id>/outputs of an attempt that is there already, relative to jobs. */
static void outputs_path(const struct store *store, const char *id, int attempt, char path[2 * STORE_NAME_BYTES]) {
    char name[STORE_NAME_BYTES];
    outputs_name(attempt, name);
    snprintf(path, 2 * STORE_NAME_BYTES, "%.70s/%s", id, name);
    if (attempt > 1 && faccessat(store->jobs_fd, path, F_OK, 0) != 0)
        snprintf(path, 2 * STORE_NAME_BYTES, "%.70s/outputs", id);
}

/* The folder in tmp that an attempt writes into. */
static void run_name(const char *id, int attempt, char name[STORE_NAME_BYTES]) {
    snprintf(name, STORE_NAME_BYTES, "%.60s.%d", id, attempt);
}

enum status store_outputs_begin(struct store *store, const char *id, int attempt, char path[STORE_PATH_BYTES],
                                struct error *error) {
    char name[STORE_NAME_BYTES];
    run_name(id, attempt, name);
    remove_tree(store->tmp_fd, name, DEPTH);
    if (fault_at("outputs-begin") || mkdirat(store->tmp_fd, name, FOLDER_MODE) != 0)
        return refused(error, "make a folder for", id);
    snprintf(path, STORE_PATH_BYTES, "%.3900s/tmp/%.80s", store->root, name);
    return STATUS_OK;
}

void store_outputs_drop(struct store *store, const char *id, int attempt) {
    for (int each = attempt; each >= 1; each--) { /* an earlier one's could have been in the way of a full machine */
        char name[STORE_NAME_BYTES];
        run_name(id, each, name);
        remove_tree(store->tmp_fd, name, DEPTH);
    }
}

/* Hashes and flushes one output. */
static enum status take_output(int folder_fd, const char *name, const struct digest_will *will,
                               struct job_output *output, struct error *error) {
    int fd = fault_at("output-open") ? -1 : openat(folder_fd, name, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    struct stat facts;
    if (fd < 0) return refused(error, "open", name);
    enum status status = STATUS_OK;
    if (fstat(fd, &facts) != 0 || !S_ISREG(facts.st_mode))
        status = error_set(error, STATUS_IO, "store", "%s is no file", name);
    else if (digest_file_while(fd, will, output->sha256, &output->bytes) != 0 || fault_at("output-sync") ||
             fsync(fd) != 0)
        status = refused(error, "read", name);
    snprintf(output->name, sizeof output->name, "%.*s", JOB_OUTPUT_NAME_BYTES - 1, name);
    close(fd);
    return status;
}

static int is_visible(const struct dirent *entry) { return entry->d_name[0] != '.'; }

static enum status take_outputs(int folder_fd, const struct digest_will *will, struct job_output *outputs,
                                size_t *count, struct error *error) {
    struct dirent **entries;
    int n = scandirat(folder_fd, ".", &entries, is_visible, alphasort);
    if (n < 0) return refused(error, "list", "outputs");
    enum status status = STATUS_OK;
    *count = 0;
    for (int i = 0; i < n; i++) {
        const char *name = entries[i]->d_name;
        if (status == STATUS_OK && (*count == JOB_MAX_OUTPUTS || strlen(name) >= JOB_OUTPUT_NAME_BYTES))
            status = error_set(error, STATUS_IO, "store", "too many outputs, or too long a name: %.80s", name);
        if (status == STATUS_OK) status = take_output(folder_fd, name, will, &outputs[(*count)++], error);
        free(entries[i]);
    }
    free(entries);
    if (status == STATUS_OK && fsync(folder_fd) != 0) status = refused(error, "flush", "outputs");
    return status;
}

static enum status move_outputs(struct store *store, const char *id, int attempt, struct error *error) {
    char from[STORE_NAME_BYTES], to[STORE_NAME_BYTES];
    run_name(id, attempt, from);
    outputs_name(attempt, to);
    int job_fd = make_folder(store->jobs_fd, id);
    if (job_fd < 0) return refused(error, "make a folder for", id);
    remove_by_way_of_tmp(store, job_fd, to); /* of a run whose end was never recorded */
    enum status status = STATUS_OK;
    if (fault_at("outputs-rename") || renameat(store->tmp_fd, from, job_fd, to) != 0 ||
        fault_at("outputs-folder-sync") || fsync(job_fd) != 0 || fsync(store->jobs_fd) != 0)
        status = refused(error, "keep the outputs of", id);
    close(job_fd);
    return status;
}

enum status store_outputs_keep(struct store *store, const char *id, int attempt, const struct digest_will *will,
                               struct job_output *outputs, size_t *count, struct error *error) {
    char name[STORE_NAME_BYTES];
    run_name(id, attempt, name);
    int folder_fd = open_folder(store->tmp_fd, name);
    if (folder_fd < 0) return refused(error, "open the outputs of", id);
    enum status status = take_outputs(folder_fd, will, outputs, count, error);
    close(folder_fd);
    return status == STATUS_OK ? move_outputs(store, id, attempt, error) : status;
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

enum status store_outputs_share(struct store *store, const char *from_id, int from_attempt, const char *to_id,
                                struct error *error) {
    char path[2 * STORE_NAME_BYTES], to_path[STORE_PATH_BYTES];
    outputs_path(store, from_id, from_attempt, path);
    int from_fd = open_folder(store->jobs_fd, path), to_fd = -1;
    enum status status = from_fd < 0 ? refused(error, "open the outputs of", from_id)
                                     : store_outputs_begin(store, to_id, 0, to_path, error);
    if (status == STATUS_OK) {
        to_fd = open(to_path, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
        status = to_fd < 0 ? refused(error, "open a folder for", to_id) : link_outputs(from_fd, to_fd, error);
        if (status == STATUS_OK) status = move_outputs(store, to_id, 0, error);
        if (status != STATUS_OK) store_outputs_drop(store, to_id, 0);
    }
    close_if_open(from_fd);
    close_if_open(to_fd);
    return status;
}

/* Opens a file of a folder below jobs. */
static int open_below_jobs(const struct store *store, const char *folder, const char *name) {
    char path[256];
    int n = snprintf(path, sizeof path, "%s/%s", folder, name);
    if (n < 0 || (size_t)n >= sizeof path || strchr(name, '/') || name[0] == '.') return -1;
    return openat(store->jobs_fd, path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
}

int store_output_open(const struct store *store, const char *id, int attempt, const char *name) {
    char folder[2 * STORE_NAME_BYTES];
    outputs_path(store, id, attempt, folder);
    return open_below_jobs(store, folder, name);
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

bool store_outputs_exist(const struct store *store, const char *id, int attempt) {
    char path[2 * STORE_NAME_BYTES];
    outputs_path(store, id, attempt, path);
    return faccessat(store->jobs_fd, path, X_OK, 0) == 0;
}

int store_outputs_count(const struct store *store, const char *id, int attempt) {
    char path[2 * STORE_NAME_BYTES];
    struct dirent **entries;
    outputs_path(store, id, attempt, path);
    int n = scandirat(store->jobs_fd, path, &entries, is_visible, alphasort);
    for (int i = 0; i < n; i++) free(entries[i]);
    if (n >= 0) free(entries);
    return n;
}

int store_log_open(struct store *store, const char *id, bool append) {
    if (!append) return open_below_jobs(store, id, "log");
    int job_fd = make_folder(store->jobs_fd, id);
    if (job_fd < 0) return -1;
    int fd = openat(job_fd, "log", O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | O_NOFOLLOW, FILE_MODE);
    close(job_fd);
    return fd;
}

void store_outputs_delete(struct store *store, const char *id, int attempt) {
    char name[STORE_NAME_BYTES];
    int job_fd = open_folder(store->jobs_fd, id);
    if (job_fd < 0) return;
    outputs_name(attempt, name);
    remove_by_way_of_tmp(store, job_fd, name);
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

struct cleaning {
    struct store *store;
    enum store_fate (*fate)(void *ctx, enum store_thing thing, const char *name);
    void *ctx;
    struct lost_found lost;
    struct store_cleaned *cleaned;
};

static void clean_one(struct cleaning *cleaning, int folder_fd, const char *kind, enum store_thing thing,
                      const char *name) {
    struct store_cleaned *cleaned = cleaning->cleaned;
    switch (thing == STORE_TEMPORARY ? STORE_REMOVE : cleaning->fate(cleaning->ctx, thing, name)) {
    case STORE_KEEP: return;
    case STORE_REMOVE:
        if (thing == STORE_TEMPORARY)
            remove_tree(folder_fd, name, DEPTH);
        else
            remove_by_way_of_tmp(cleaning->store, folder_fd, name);
        cleaned->removed++;
        return;
    case STORE_SET_ASIDE:
        if (lost_found_take(&cleaning->lost, folder_fd, kind, name))
            cleaned->set_aside++;
        else
            cleaned->left++;
    }
}

/* Lists a folder, which may change meanwhile. */
static enum status clean_folder(struct cleaning *cleaning, int folder_fd, const char *kind, enum store_thing thing) {
    struct dirent **entries;
    int n = scandirat(folder_fd, ".", &entries, is_visible, alphasort);
    if (n < 0) return STATUS_IO;
    for (int i = 0; i < n; i++) {
        clean_one(cleaning, folder_fd, kind, thing, entries[i]->d_name);
        free(entries[i]);
    }
    free(entries);
    return STATUS_OK;
}

enum status store_clean(struct store *store,
                        enum store_fate (*fate)(void *ctx, enum store_thing thing, const char *name), void *ctx,
                        struct store_cleaned *cleaned, struct error *error) {
    struct cleaning cleaning = {.store = store,
                                .fate = fate,
                                .ctx = ctx,
                                .lost = {.root_fd = store->root_fd, .place_fd = -1},
                                .cleaned = cleaned};
    *cleaned = (struct store_cleaned){0};
    enum status status = clean_folder(&cleaning, store->tmp_fd, "tmp", STORE_TEMPORARY);
    if (status == STATUS_OK) status = clean_folder(&cleaning, store->clouds_fd, "clouds", STORE_CLOUD);
    if (status == STATUS_OK) status = clean_folder(&cleaning, store->jobs_fd, "jobs", STORE_JOB);
    if (status == STATUS_OK) status = clean_folder(&cleaning, store->parts_fd, "uploads", STORE_PART);
    if (status != STATUS_OK) status = refused(error, "list", store->root);
    snprintf(cleaned->place, sizeof cleaned->place, "%s", cleaning.lost.place);
    lost_found_close(&cleaning.lost);
    return status;
}

uint64_t store_lost(const struct store *store) { return lost_found_count(store->root_fd); }
