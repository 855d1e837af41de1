/* A test's own folder.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_UNIT_FOLDER_H
#define WHITTLE_TESTS_UNIT_FOLDER_H

/* Removes the folder with everything in it. */
void folder_remove(const char *path);

/* How many entries the folder `name` in the folder `path` has; fails the test when it isn't there. */
int folder_entries(const char *path, const char *name);

#endif
