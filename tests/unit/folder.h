/* A test's own folder.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_UNIT_FOLDER_H
#define WHITTLE_TESTS_UNIT_FOLDER_H

#include <stddef.h>

/* Makes one where flushing costs nothing, if there is such a place; path takes its name. */
void folder_make_in_memory(char *path, size_t bytes);

/* Removes the folder with everything in it. */
void folder_remove(const char *path);

/* How many entries the folder `name` in the folder `path` has; fails the test when it isn't there. */
int folder_entries(const char *path, const char *name);

#endif
