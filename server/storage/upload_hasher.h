/* Work on a file that is still being written, beside its writer: its hash, its room and its way to the disk.
 *
 * The writer tells how far it is and goes on; threads read what it wrote back from the page cache, hash it, have the
 * kernel begin to store it, and make room for what comes next.  So at the end little is left to hash, fsync has little
 * to wait for, and nothing of the file is in memory of ours.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_STORAGE_UPLOAD_HASHER_H
#define WHITTLE_SERVER_STORAGE_UPLOAD_HASHER_H

#include <stddef.h>

#include "server/base/digest.h"
#include "server/base/thread_pool.h"

struct upload_hasher;

/* Starts at the file's first byte, with a descriptor of its own; expected: its length, UINT64_MAX = not known.
 * threads are borrowed; NULL: everything is left to upload_hasher_finish.  NULL when memory or descriptors run out. */
struct upload_hasher *upload_hasher_new(struct thread_pool *threads, int fd, uint64_t expected);

/* So many more bytes are in the file, after those before.  Doesn't block. */
void upload_hasher_advance(struct upload_hasher *hasher, size_t count);

/* Gives the hash of all that was told; reads what is left, so it blocks.  -1 with errno when the file can't be read. */
int upload_hasher_finish(struct upload_hasher *hasher, char hex[DIGEST_HEX_BYTES]);

/* Doesn't block, at any time.  Accepts NULL. */
void upload_hasher_free(struct upload_hasher *hasher);

#endif
