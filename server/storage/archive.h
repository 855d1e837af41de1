/* Clouds that are here as one: a tar archive of them (core/io/formats/tar_members.c), which is a cloud of its own.
 *
 * Its bytes follow from the clouds' and their order alone, so the same list is the same cloud.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_STORAGE_ARCHIVE_H
#define WHITTLE_SERVER_STORAGE_ARCHIVE_H

#include <stddef.h>
#include <stdint.h>

#include "server/storage/upload.h"

struct archive_member {
    char sha256[JOB_HASH_BYTES];
    uint64_t bytes;
};

/* Bytes of the archive of these clouds; saturates at UINT64_MAX. */
uint64_t archive_bytes(const struct archive_member *member, size_t count);

/* Copies them into a new upload, whose members are called cloud-1, cloud-2 ...; upload_end is to follow.  NULL:
 * *problem says why: no-such-cloud where one isn't here any more; as upload_new.  Blocks: O(bytes). */
struct upload *archive_make(struct store *store, struct thread_pool *threads, const struct archive_member *member,
                            size_t count, uint64_t max_bytes, const struct admission *admission,
                            struct problem *problem);

#endif
