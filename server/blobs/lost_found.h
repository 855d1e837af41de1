/* lost+found: where the start puts files that no row of the database names.
 *
 *     lost+found/20260131T120000Z-1a2b3c4d/clouds/<sha256>
 *                                         /jobs/<id>/...
 *                                         /uploads/<id>
 *
 * One folder for each start that found something; below it names are as they were, so that moving its content back to
 * the data folder undoes it.  Nothing here is ever read or removed by the service: whoever operates it does that.
 *
 * The root of an ext file system has a lost+found of root's own; where that can't be written, `lost+found.whittled` is
 * used instead.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BLOBS_LOST_FOUND_H
#define WHITTLE_SERVER_BLOBS_LOST_FOUND_H

#include <stdbool.h>
#include <stdint.h>

enum { LOST_FOUND_NAME_BYTES = 64 };

/* A name for what this start finds, which no other start has. */
void lost_found_name_start(char start[LOST_FOUND_NAME_BYTES]);

/* Moves from/name, of the same file system as root, durably into the folder of that kind ("clouds", ...) of that start,
 * which is made when it is needed: place is its path below root.  false, with errno: it is still where it was. */
bool lost_found_take(int root_fd, const char *start, int from_fd, const char *kind, const char *name,
                     char place[LOST_FOUND_NAME_BYTES]);

/* How many clouds, jobs and uploads all starts have put there, as far as they can be listed. */
uint64_t lost_found_count(int root_fd);

#endif
