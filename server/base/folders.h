/* Folders and files by descriptor: what blob stores and a host's scratch do with them.
 *
 * Everything that is made is the service's alone (0700, 0600).  No name is followed where it is a symbolic link.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_FOLDERS_H
#define WHITTLE_SERVER_BASE_FOLDERS_H

#include <stdbool.h>
#include <stdint.h>

enum { FOLDERS_FILE_MODE = 0600, FOLDERS_NAME_BYTES = 80 };

/* Opens a folder; makes it where it is missing.  -1 with errno. */
int folders_open(int at, const char *name);
int folders_make(int at, const char *name);

/* Makes a folder and, where they are missing, those above it.  -1 with errno. */
int folders_make_path(const char *path);

/* A name that nobody else has: prefix-<32 digits>. */
void folders_random_name(const char *prefix, char name[FOLDERS_NAME_BYTES]);

/* Tells of each name that doesn't begin with a dot, sorted by bytes; the folder may change meanwhile.  -1 with errno.
 */
int folders_each(int folder_fd, void (*found)(void *ctx, const char *name), void *ctx);

/* Removes a file, or a folder with what is in it, a few levels deep. */
void folders_remove(int at, const char *name);

/* Writes the rest of one file to another.  -1 with errno. */
int folders_copy(int from_fd, int to_fd);

/* closes a descriptor unless it is -1. */
void folders_close(int fd);

#endif
