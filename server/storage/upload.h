/* A cloud on its way in: streamed to disk, hashed and counted, its format checked as soon as its first bytes are here.
 *
 * No more of it is in memory than the first PLY_HEADER_MAX_BYTES.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_STORAGE_UPLOAD_H
#define WHITTLE_SERVER_STORAGE_UPLOAD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api/problem.h"
#include "server/base/thread_pool.h"
#include "server/catalog/job.h"
#include "server/storage/admission.h"
#include "server/storage/store.h"

struct upload;

/* The problem of a body of so many bytes (UINT64_MAX = not known) that is over its limit. */
void upload_too_large(uint64_t max_bytes, uint64_t bytes, struct problem *problem);

/* The same of a piece of a resumable upload, which takes `left` bytes more. */
void upload_piece_too_large(uint64_t left, uint64_t bytes, struct problem *problem);

/* What is known of a complete upload. */
struct upload_facts {
    char sha256[JOB_HASH_BYTES];
    uint64_t bytes, points; /* points: as the header says; 0 = not known */
    char format[JOB_FORMAT_BYTES];
};

/* Starts one; expected_bytes UINT64_MAX = not known.  What the first bytes say is judged by the admission (copied) as
 * soon as they are here.  NULL: *problem says why.  Doesn't block for long. */
struct upload *upload_new(struct store *store, struct thread_pool *threads, uint64_t expected_bytes, uint64_t max_bytes,
                          const struct admission *admission, struct problem *problem);

/* Frees it, and removes it from the disk unless it was kept.  Accepts NULL. */
void upload_free(struct upload *upload);

/* Takes the next bytes; false: *problem says why, and no more may be given.  Writes to the page cache, no more. */
bool upload_write(struct upload *upload, const void *bytes, size_t count, struct problem *problem);

/* All bytes were given: their hash; borrowed.  NULL: *problem says why. */
const char *upload_hash(struct upload *upload, struct problem *problem);

/* The same, and the last checks.  false: *problem says why. */
bool upload_end(struct upload *upload, struct upload_facts *facts, struct problem *problem);

/* Its first bytes; borrowed. */
const void *upload_head(const struct upload *upload, size_t *count);

/* The same for a file that holds all of a cloud: reads it. */
bool upload_check_file(int fd, const struct admission *admission, struct upload_facts *facts, struct problem *problem);

/* Flushes to disk; blocks.  Then makes it the cloud of its hash. */
enum status upload_sync(struct upload *upload, struct error *error) MUST_CHECK;
enum status upload_keep(struct upload *upload, struct error *error) MUST_CHECK;

#endif
