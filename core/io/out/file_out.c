/* Write under a temporary name, sync, rename, sync the folder.
 *
 * Rename is what makes it whole: whoever opens the final name gets the old file or the new one.  The sync before it
 * makes sure that a power failure can't leave the name with half the bytes, the one after it that the name lasts. Files
 * of one folder are synced at the same time, which the disk does with one turn, and share the folder's sync.
 *
 * Nothing is looked up before the name is given that could have changed by then: renameat2 either fails where there is
 * a file already, or exchanges the two names, and then what stood there is looked at, under the temporary name, before
 * it goes.  File systems without these (some of the network) get the nearest: a name that is made empty first where
 * none was, else a look just before.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/file_out.h"

#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/fault.h"
#include "core/base/par.h"

enum { ATTEMPTS = 16, SYNCS = 4, SUFFIX_BYTES = 16 }; /* .XXXXXXXX.part and the dot before the name, and a NUL */

static enum status failed(struct error *error, const char *what, const char *path) {
    return error_set(error, status_from_errno(errno), "write", "can't %s %s: %s", what, path, strerror(errno));
}

static int folder_length(const char *path) {
    const char *slash = strrchr(path, '/');
    return slash ? (int)(slash + 1 - path) : 0;
}

static char *copy_text(const char *text) {
    size_t bytes = strlen(text) + 1;
    char *copy = alloc_array(bytes, 1);
    return copy ? memcpy(copy, text, bytes) : NULL;
}

/* Opens a file of a name that wasn't there; -1 with errno. */
static int open_new(char *temporary, size_t bytes, const char *path) {
    int folder = folder_length(path), fd = -1;
    for (int attempt = 0; fd < 0 && attempt < ATTEMPTS; attempt++) {
        uint32_t random;
        if (getrandom(&random, sizeof random, 0) != sizeof random) return -1;
        snprintf(temporary, bytes, "%.*s.%s.%08x.part", folder, path, path + folder, random);
        fd = fault_at("file-open") ? -1 : open(temporary, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        if (fd < 0 && errno != EEXIST) return -1;
    }
    return fd;
}

enum status file_out_begin(struct file_out *file, const char *path, struct error *error) {
    size_t bytes = strlen(path) + SUFFIX_BYTES;
    *file = (struct file_out){.fd = -1};
    enum status status = STATUS_OK;
    file->path = copy_text(path);
    file->temporary = alloc_array(bytes, 1);
    if (!file->path || !file->temporary)
        status = error_set(error, STATUS_NO_MEMORY, "write", "no memory for a name");
    else if ((file->fd = open_new(file->temporary, bytes, path)) < 0)
        status = failed(error, "create", path);
    if (!status) return STATUS_OK;
    free(file->path);
    free(file->temporary);
    *file = (struct file_out){0};
    return status;
}

static enum status sync_folder(const char *path, struct error *error) {
    char *folder = copy_text(path);
    if (!folder) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a name");
    folder[folder_length(path)] = '\0';
    int fd = fault_at("file-folder-open") ? -1 : open(folder[0] ? folder : ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    enum status status = STATUS_OK;
    if (fd < 0 || ((fault_at("file-folder-sync") || fsync(fd) != 0) && errno != EINVAL))
        status = failed(error, "sync the folder of", path);
    if (fd >= 0) close(fd);
    free(folder);
    return status;
}

static void sync_files(void *ctx, size_t begin, size_t end) {
    struct file_out *file = ctx;
    for (size_t i = begin; i < end; i++)
        if ((fault_at("file-sync") || fsync(file[i].fd) != 0) && errno != EINVAL) file[i].failure = errno;
}

/* ------------------------------------------------------------------------------------------------ names */

static bool is_source(const struct stat *about, const struct file_out_rule *rule) {
    for (size_t i = 0; rule && i < rule->source_count; i++)
        if (about->st_dev == rule->source[i].device && about->st_ino == rule->source[i].inode) return true;
    return false;
}

enum file_out_claim file_out_look(const char *path, const struct file_out_rule *rule) {
    struct stat about;
    if (stat(path, &about) == 0 && is_source(&about, rule)) return FILE_OUT_IS_SOURCE;
    if (lstat(path, &about) != 0) return FILE_OUT_FREE;
    if (S_ISDIR(about.st_mode)) return FILE_OUT_IS_FOLDER;
    if (!S_ISREG(about.st_mode) && !S_ISLNK(about.st_mode)) return FILE_OUT_IS_SPECIAL;
    return rule && !rule->replaces ? FILE_OUT_TAKEN : FILE_OUT_REPLACES;
}

enum status file_out_refuse(const char *path, enum file_out_claim claim, struct error *error) {
    static const char *const why[] = {[FILE_OUT_TAKEN] = "is there already",
                                      [FILE_OUT_IS_SOURCE] = "is the input itself",
                                      [FILE_OUT_IS_FOLDER] = "is a folder",
                                      [FILE_OUT_IS_SPECIAL] = "is no regular file"};
    if (claim == FILE_OUT_FREE || claim == FILE_OUT_REPLACES) return STATUS_OK;
    bool never_replaced = claim == FILE_OUT_IS_FOLDER || claim == FILE_OUT_IS_SPECIAL;
    return error_set(error, never_replaced ? STATUS_IO : STATUS_BAD_PARAMETER, "write", "%s %s", path, why[claim]);
}

/* Whether the file system has no such flag of renameat2. */
static bool lacks_flag(void) { return errno == EINVAL || errno == ENOSYS; }

/* 0 where path was free and is the file's now; else errno. */
static int take_free_name(const struct file_out *file) {
    if (renameat2(AT_FDCWD, file->temporary, AT_FDCWD, file->path, RENAME_NOREPLACE) == 0) return 0;
    if (!lacks_flag()) return errno;
    int fd = open(file->path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (fd < 0) return errno;
    close(fd);
    return rename(file->temporary, file->path) == 0 ? 0 : errno;
}

/* 0 where the file has the name now and what had it has the temporary one (or, without exchange, is gone); else errno.
 */
static int take_used_name(const struct file_out *file) {
    if (renameat2(AT_FDCWD, file->temporary, AT_FDCWD, file->path, RENAME_EXCHANGE) == 0) return 0;
    return lacks_flag() && rename(file->temporary, file->path) == 0 ? 0 : errno;
}

/* Removes what had the name, or gives it back where it is to be kept. */
static enum status clear_away(struct file_out *file, struct error *error) {
    enum status status = file_out_refuse(file->path, file_out_look(file->temporary, file->rule), error);
    if (!status) {
        unlink(file->temporary);
        file->temporary[0] = '\0';
    } else if (renameat2(AT_FDCWD, file->temporary, AT_FDCWD, file->path, RENAME_EXCHANGE) != 0) {
        status = error_set(error, status, "write", "what was %s is %s now", file->path, file->temporary);
        file->temporary[0] = '\0';
    }
    return status;
}

/* Others may make and remove files of that name at the same time: then the two ways take turns. */
static enum status give_name(struct file_out *file, struct error *error) {
    int failure = EEXIST;
    for (int attempt = 0; attempt < ATTEMPTS && (failure == EEXIST || failure == ENOENT); attempt++) {
        failure = fault_at("file-rename") ? errno : take_free_name(file);
        if (failure == 0) {
            file->temporary[0] = '\0';
            return STATUS_OK;
        }
        if (failure != EEXIST) break;
        enum status status = file_out_refuse(file->path, file_out_look(file->path, file->rule), error);
        if (status) return status;
        failure = take_used_name(file);
        if (failure == 0) return clear_away(file, error);
    }
    errno = failure;
    return failed(error, "rename to", file->path);
}

enum status file_out_commit(struct file_out *file, size_t n, struct error *error) {
    enum status status = STATUS_OK;
    par_for(SYNCS, n, 1, sync_files, file);
    for (size_t i = 0; i < n && !status; i++)
        if ((errno = file[i].failure)) status = failed(error, "sync", file[i].path);
    for (size_t i = 0; i < n && !status; i++) status = give_name(&file[i], error);
    if (!status) status = sync_folder(file[0].path, error);
    for (size_t i = 0; i < n; i++) file_out_abort(&file[i]);
    return status;
}

enum status file_out_name(struct file_out *file, struct error *error) {
    (void)sync_file_range(file->fd, 0, 0, SYNC_FILE_RANGE_WRITE); /* which waits for nothing */
    enum status status = give_name(file, error);
    if (!status) file_out_abort(file);
    return status;
}

enum status file_out_sync(const char *path, struct error *error) {
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return failed(error, "open", path);
    struct file_out file = {.fd = fd};
    sync_files(&file, 0, 1);
    close(fd);
    if (file.failure == 0) return STATUS_OK;
    errno = file.failure;
    return failed(error, "sync", path);
}

void file_out_abort(struct file_out *file) {
    if (!file || !file->path) return;
    close(file->fd);
    if (file->temporary[0]) unlink(file->temporary);
    free(file->path);
    free(file->temporary);
    *file = (struct file_out){0};
}
