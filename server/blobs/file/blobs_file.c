/* Blobs as files of a folder: folder/name is the path below it.
 *
 * A file gets its name by rename, after it was flushed, and the folders above it are flushed before anybody is told.  A
 * file that lies in another file system is copied into tmp/ first, and its hash compared on the way.  What is removed
 * is renamed into tmp/ first, so that it vanishes at once.
 *
 *     <folder>/clouds/<sha256>, jobs/<id>/...      the blobs
 *     <folder>/tmp/                                what is being copied or removed; a start empties it (scratch.h)
 *     <folder>/lost+found/                         what a start set aside
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/fault.h"
#include "server/base/digest.h"
#include "server/base/folders.h"
#include "server/blobs/blobs_backend.h"
#include "server/blobs/lost_found.h"

struct blobs_file {
    struct blobs blobs; /* first */
    int root_fd, tmp_fd;
};

static const struct blobs_file *file_of(const struct blobs *blobs) {
    return (const struct blobs_file *)(const void *)blobs;
}

static enum status refused(struct error *error, const char *what, const char *name) {
    return error_set(error, status_from_errno(errno), "blobs", "can't %s %.200s: %s", what, name, strerror(errno));
}

/* Where each step may fail is named by what it puts: rename-clouds, sync-jobs, ... (daemon/fault_point.c). */
static bool fails_at(const char *step, const char *folder) {
    char point[64];
    snprintf(point, sizeof point, "%s-%.*s", step, (int)strcspn(folder, "/"), folder);
    return fault_at(point);
}

/* ------------------------------------------------------------------------------------------------ open */

static bool is_valid(const char *path) { return path[0] != 0; }

static void file_close(struct blobs *blobs) {
    struct blobs_file *files = (struct blobs_file *)(void *)blobs;
    folders_close(files->tmp_fd);
    folders_close(files->root_fd);
    free(files);
}

static enum status file_open(const char *path, const char *folder, struct blobs **blobs, struct error *error) {
    (void)folder; /* what is read is there */
    struct blobs_file *files = alloc_zeroed(1, sizeof *files);
    if (!files) return error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    *files = (struct blobs_file){.blobs.backend = &blobs_file, .root_fd = -1, .tmp_fd = -1};
    int clouds_fd = -1, jobs_fd = -1;
    if (folders_make_path(path) == 0) files->root_fd = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (files->root_fd >= 0) {
        files->tmp_fd = folders_make(files->root_fd, "tmp");
        clouds_fd = folders_make(files->root_fd, "clouds");
        jobs_fd = folders_make(files->root_fd, "jobs");
    }
    bool opened = files->tmp_fd >= 0 && clouds_fd >= 0 && jobs_fd >= 0 && fsync(files->root_fd) == 0;
    enum status status = opened ? STATUS_OK : refused(error, "open the folder", path);
    folders_close(clouds_fd);
    folders_close(jobs_fd);
    if (status == STATUS_OK)
        *blobs = &files->blobs;
    else
        file_close(&files->blobs);
    return status;
}

/* ------------------------------------------------------------------------------------------------ put */

/* Opens a folder of blobs, and makes it and those above it where they are missing.  All names on the way are flushed,
 * for somebody else may have made them; two in the root were when it was opened. */
static int make_folders(const struct blobs_file *files, const char *folder) {
    char path[BLOBS_NAME_BYTES];
    snprintf(path, sizeof path, "%s", folder);
    int at = files->root_fd;
    for (char *part = path; part && at >= 0;) {
        char *slash = strchr(part, '/');
        if (slash) *slash = 0;
        int below = folders_make(at, part);
        bool is_flushed = at == files->root_fd && (strcmp(part, "clouds") == 0 || strcmp(part, "jobs") == 0);
        if (below >= 0 && !is_flushed && fsync(at) != 0) close(below), below = -1;
        int error = errno;
        if (at != files->root_fd) close(at);
        errno = error;
        at = below;
        part = slash ? slash + 1 : NULL;
    }
    return at;
}

/* Copies a file of another file system; its hash is compared with what it has to be. */
static enum status copy_over(const struct blobs_file *files, const struct blobs_source *source, int folder_fd,
                             struct error *error) {
    char name[FOLDERS_NAME_BYTES], found[DIGEST_HEX_BYTES];
    uint64_t bytes = 0;
    folders_random_name("copy", name);
    int from = openat(source->folder_fd, source->file, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    int to = openat(files->tmp_fd, name, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, FOLDERS_FILE_MODE);
    enum status status = STATUS_OK;
    if (from < 0 || to < 0 || folders_copy(from, to) != 0 || digest_file(to, found, &bytes) != 0 || fsync(to) != 0)
        status = refused(error, "copy", source->name);
    else if (strcmp(found, source->sha256) != 0)
        status = error_set(error, STATUS_MALFORMED, "blobs", "%.100s has the hash %s", source->name, found);
    else if (renameat(files->tmp_fd, name, folder_fd, source->name) != 0)
        status = refused(error, "keep", source->name);
    if (status != STATUS_OK) unlinkat(files->tmp_fd, name, 0);
    folders_close(from);
    folders_close(to);
    return status;
}

static enum status put_one(const struct blobs_file *files, const struct blobs_source *source, int folder_fd,
                           struct error *error) {
    if (renameat(source->folder_fd, source->file, folder_fd, source->name) == 0) return STATUS_OK;
    return errno == EXDEV ? copy_over(files, source, folder_fd, error) : refused(error, "keep", source->name);
}

static enum status file_put(struct blobs *blobs, const char *folder, const struct blobs_source *sources, size_t count,
                            struct error *error) {
    const struct blobs_file *files = file_of(blobs);
    int folder_fd = make_folders(files, folder);
    if (folder_fd < 0) return refused(error, "make the folder", folder);
    enum status status = fails_at("rename", folder) ? refused(error, "keep", folder) : STATUS_OK;
    for (size_t i = 0; status == STATUS_OK && i < count; i++) status = put_one(files, &sources[i], folder_fd, error);
    if (status == STATUS_OK && (fails_at("sync", folder) || fsync(folder_fd) != 0))
        status = refused(error, "flush", folder);
    close(folder_fd);
    return status;
}

/* ------------------------------------------------------------------------------------------------ copy */

struct copying {
    int from_fd, to_fd;
    struct error *error;
    enum status status;
};

static void link_one(void *ctx, const char *name) {
    struct copying *copying = ctx;
    if (copying->status != STATUS_OK) return;
    if (linkat(copying->from_fd, name, copying->to_fd, name, 0) != 0 && errno != EEXIST)
        copying->status = refused(copying->error, "link", name);
}

static enum status file_copy(struct blobs *blobs, const char *from_folder, const char *to_folder, struct error *error) {
    const struct blobs_file *files = file_of(blobs);
    struct copying copying = {.from_fd = folders_open(files->root_fd, from_folder), .to_fd = -1, .error = error};
    if (copying.from_fd < 0) return refused(error, "open", from_folder);
    copying.to_fd = make_folders(files, to_folder);
    if (copying.to_fd < 0) copying.status = refused(error, "make the folder", to_folder);
    if (copying.status == STATUS_OK && folders_each(copying.from_fd, link_one, &copying) != 0)
        copying.status = refused(error, "list", from_folder);
    if (copying.status == STATUS_OK && (fails_at("sync", to_folder) || fsync(copying.to_fd) != 0))
        copying.status = refused(error, "flush", to_folder);
    folders_close(copying.to_fd);
    close(copying.from_fd);
    return copying.status;
}

/* ------------------------------------------------------------------------------------------------ read, remove */

static int file_read(struct blobs *blobs, const char *name, const struct blobs_facts *facts) {
    (void)facts; /* it is what was put, or the disk says so */
    return openat(file_of(blobs)->root_fd, name, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
}

static bool file_exist(struct blobs *blobs, const char *name) {
    return faccessat(file_of(blobs)->root_fd, name, R_OK, 0) == 0;
}

/* A file goes at once; a folder is renamed first, so that nobody finds it in part. */
static bool file_remove(struct blobs *blobs, const char *name, struct blobs_removal *removal) {
    (void)removal; /* it is always settled */
    const struct blobs_file *files = file_of(blobs);
    char gone[FOLDERS_NAME_BYTES], folder[BLOBS_NAME_BYTES];
    snprintf(folder, sizeof folder, "%.*s", (int)(strrchr(name, '/') - name), name);
    int folder_fd = folders_open(files->root_fd, folder);
    if (folder_fd < 0) return errno == ENOENT;
    folders_random_name("gone", gone);
    bool is_gone = unlinkat(files->root_fd, name, 0) == 0 || errno == ENOENT;
    if (is_gone) {
        fsync(folder_fd);
    } else if (errno == EISDIR && !fault_at("remove-rename") &&
               renameat(files->root_fd, name, files->tmp_fd, gone) == 0) {
        is_gone = true;
        fsync(folder_fd);
        fault_at("removed");
        folders_remove(files->tmp_fd, gone);
    }
    close(folder_fd);
    return is_gone;
}

static enum status file_list(struct blobs *blobs, const char *folder, void (*found)(void *ctx, const char *name),
                             void *ctx, struct error *error) {
    int folder_fd = folders_open(file_of(blobs)->root_fd, folder);
    if (folder_fd < 0 && errno == ENOENT) return STATUS_OK;
    enum status status =
        folder_fd >= 0 && folders_each(folder_fd, found, ctx) == 0 ? STATUS_OK : refused(error, "list", folder);
    folders_close(folder_fd);
    return status;
}

static enum status file_set_aside(struct blobs *blobs, const char *start, const char *folder, const char *name,
                                  char place[64], struct error *error) {
    const struct blobs_file *files = file_of(blobs);
    int folder_fd = folders_open(files->root_fd, folder);
    bool moved = folder_fd >= 0 && lost_found_take(files->root_fd, start, folder_fd, folder, name, place);
    enum status status = moved ? STATUS_OK : refused(error, "set aside", name);
    folders_close(folder_fd);
    return status;
}

const struct blobs_backend blobs_file = {
    .scheme = "file:",
    .is_valid = is_valid,
    .open = file_open,
    .close = file_close,
    .put = file_put,
    .copy = file_copy,
    .read = file_read,
    .exist = file_exist,
    .remove = file_remove,
    .list = file_list,
    .set_aside = file_set_aside,
};
