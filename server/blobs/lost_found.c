/* lost+found.
 *
 * A name is moved by one rename, then both folders are flushed: after a power cut it is in one of them, or in both.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/blobs/lost_found.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "server/base/random.h"

enum { FOLDER_MODE = 0700, LEVELS = 2 /* the start, the kind */ };

static const char *const places[] = {"lost+found", "lost+found.whittled"};
enum { PLACES = sizeof places / sizeof places[0] };

static int open_folder(int at, const char *name) {
    return openat(at, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
}

/* Made where it is missing, and on the disk. */
static int make_folder(int at, const char *name) {
    if (mkdirat(at, name, FOLDER_MODE) == 0 ? fsync(at) != 0 : errno != EEXIST) return -1;
    return open_folder(at, name);
}

void lost_found_name_start(char start[LOST_FOUND_NAME_BYTES]) {
    uint32_t random = 0;
    random_fill(&random, sizeof random);
    time_t now = time(NULL);
    struct tm tm;
    char when[24];
    gmtime_r(&now, &tm);
    strftime(when, sizeof when, "%Y%m%dT%H%M%SZ", &tm);
    snprintf(start, LOST_FOUND_NAME_BYTES, "%s-%08x", when, random);
}

/* The folder of a start, -1 with errno. */
static int open_place(int root_fd, const char *start, char place[LOST_FOUND_NAME_BYTES]) {
    int place_fd = -1;
    for (int i = 0; i < PLACES && place_fd < 0; i++) {
        int fd = make_folder(root_fd, places[i]);
        if (fd < 0) continue;
        place_fd = make_folder(fd, start);
        int error = errno;
        close(fd);
        errno = error;
        if (place_fd >= 0) snprintf(place, LOST_FOUND_NAME_BYTES, "%s/%.40s", places[i], start);
    }
    return place_fd;
}

bool lost_found_take(int root_fd, const char *start, int from_fd, const char *kind, const char *name,
                     char place[LOST_FOUND_NAME_BYTES]) {
    int place_fd = open_place(root_fd, start, place);
    int to_fd = place_fd >= 0 ? make_folder(place_fd, kind) : -1;
    bool moved = to_fd >= 0 && renameat(from_fd, name, to_fd, name) == 0 && fsync(to_fd) == 0 && fsync(from_fd) == 0;
    int error = errno;
    if (to_fd >= 0) close(to_fd);
    if (place_fd >= 0) close(place_fd);
    errno = error;
    return moved;
}

/* Names in the folders so many levels below this one, which is closed. */
static uint64_t count_below(int fd, int levels) {
    uint64_t count = 0;
    DIR *folder = fd >= 0 ? fdopendir(fd) : NULL;
    if (!folder && fd >= 0) close(fd);
    if (!folder) return 0;
    for (struct dirent *entry; (entry = readdir(folder));) {
        if (entry->d_name[0] == '.') continue;
        count += levels ? count_below(open_folder(dirfd(folder), entry->d_name), levels - 1) : 1;
    }
    closedir(folder);
    return count;
}

uint64_t lost_found_count(int root_fd) {
    uint64_t count = 0;
    for (int i = 0; i < PLACES; i++) count += count_below(open_folder(root_fd, places[i]), LEVELS);
    return count;
}
