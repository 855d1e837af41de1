/* Folders and files by descriptor.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/folders.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/base/random.h"

enum { FOLDER_MODE = 0700, DEPTH = 4, BLOCK_BYTES = 1 << 16 };

void folders_close(int fd) {
    if (fd >= 0) close(fd);
}

int folders_open(int at, const char *name) { return openat(at, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW); }

int folders_make(int at, const char *name) {
    if (mkdirat(at, name, FOLDER_MODE) != 0 && errno != EEXIST) return -1;
    return folders_open(at, name);
}

int folders_make_path(const char *folder) {
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

void folders_random_name(const char *prefix, char name[FOLDERS_NAME_BYTES]) {
    char random[RANDOM_NAME_BYTES];
    random_name(random);
    snprintf(name, FOLDERS_NAME_BYTES, "%.40s-%s", prefix, random);
}

static int is_visible(const struct dirent *entry) { return entry->d_name[0] != '.'; }

static int by_bytes(const struct dirent **a, const struct dirent **b) { return strcmp((*a)->d_name, (*b)->d_name); }

int folders_each(int folder_fd, void (*found)(void *ctx, const char *name), void *ctx) {
    struct dirent **entries;
    int n = scandirat(folder_fd, ".", &entries, is_visible, by_bytes);
    if (n < 0) return -1;
    for (int i = 0; i < n; i++) {
        found(ctx, entries[i]->d_name);
        free(entries[i]);
    }
    free(entries);
    return 0;
}

static void remove_tree(int at, const char *name, int depth) {
    if (unlinkat(at, name, 0) == 0 || (errno != EISDIR && errno != EPERM)) return;
    int fd = depth ? folders_open(at, name) : -1;
    DIR *folder = fd >= 0 ? fdopendir(fd) : NULL;
    if (!folder) {
        folders_close(fd);
        return;
    }
    for (struct dirent *entry; (entry = readdir(folder));)
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0)
            remove_tree(dirfd(folder), entry->d_name, depth - 1);
    closedir(folder);
    unlinkat(at, name, AT_REMOVEDIR);
}

void folders_remove(int at, const char *name) { remove_tree(at, name, DEPTH); }

int folders_copy(int from_fd, int to_fd) {
    char block[BLOCK_BYTES];
    ssize_t n;
    while ((n = read(from_fd, block, sizeof block)) != 0) {
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return -1;
        for (ssize_t done = 0; done < n;) {
            ssize_t written = write(to_fd, block + done, (size_t)(n - done));
            if (written < 0 && errno != EINTR) return -1;
            if (written > 0) done += written;
        }
    }
    return 0;
}
