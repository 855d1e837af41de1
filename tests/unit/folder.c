/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/folder.h"

#include <dirent.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

void folder_make_in_memory(char *path, size_t bytes) {
    const char *place = access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp";
    snprintf(path, bytes, "%s/whittle-test.XXXXXX", place);
    assert_non_null(mkdtemp(path));
}

static void remove_entry(int at, const char *name) {
    int fd = openat(at, name, O_RDONLY | O_DIRECTORY);
    DIR *folder = fd >= 0 ? fdopendir(fd) : NULL;
    for (struct dirent *entry; folder && (entry = readdir(folder));)
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0) remove_entry(fd, entry->d_name);
    if (folder) closedir(folder);
    unlinkat(at, name, folder ? AT_REMOVEDIR : 0);
}

void folder_remove(const char *path) { remove_entry(AT_FDCWD, path); }

int folder_entries(const char *path, const char *name) {
    char inner[4096];
    int count = -2; /* . and .. */
    snprintf(inner, sizeof inner, "%s/%s", path, name);
    DIR *folder = opendir(inner);
    assert_non_null(folder);
    while (readdir(folder)) count++;
    closedir(folder);
    return count;
}
