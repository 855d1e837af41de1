/* Write under a temporary name, sync, rename, sync the folder.
 *
 * Rename is what makes it whole: whoever opens the final name gets the old file or the new one.  The sync before it
 * makes sure that a power failure can't leave the name with half the bytes, the one after it that the name lasts. Files
 * of one folder are synced at the same time, which the disk does with one turn, and share the folder's sync.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/file_out.h"

#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <unistd.h>

#include "core/alloc.h"
#include "core/fault.h"
#include "core/par.h"

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

static enum status give_name(struct file_out *file, struct error *error) {
    if (fault_at("file-rename") || rename(file->temporary, file->path) != 0)
        return failed(error, "rename to", file->path);
    file->temporary[0] = '\0';
    return STATUS_OK;
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

void file_out_abort(struct file_out *file) {
    if (!file || !file->path) return;
    close(file->fd);
    if (file->temporary[0]) unlink(file->temporary);
    free(file->path);
    free(file->temporary);
    *file = (struct file_out){0};
}
