/* Resumable uploads: files that grow piece by piece, through broken connections and restarts.
 *
 *     begin -> write ... -> end -> (cut, HEAD, begin at the offset, write ... -> end)* -> whole: becomes a cloud
 *
 * Where one process serves the catalog all are in memory, so that what must not block can ask; a row of each is in the
 * catalog, its bytes are a file in scratch.  Where several hosts share it any of them goes on with an upload: its bytes
 * are pieces among the blobs, and the row says how far they reach.
 *
 * What a piece has brought before its connection broke is kept, unless the piece came with a checksum: then it is kept
 * whole or not at all.  Of a host that dies the bytes are kept that were pieces by then: at the end of each request,
 * and at each sweep.
 *
 * One writer has an upload at a time, the newest: a client that comes back need not wait until its old connection is
 * found to be dead, whose bytes are refused from then on.
 *
 * After a crash of the service an upload to a host's own file goes on with every byte that was written, after one of
 * the host with those that were flushed: at the end of each piece, and at each sweep.
 *
 * The bytes that an upload has, or will have where its length is known, are reserved for its principal
 * (catalog_reserve) before they come, until it is a cloud or gone.
 *
 * All functions may be called from any thread.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_STORAGE_UPLOADS_H
#define WHITTLE_SERVER_STORAGE_UPLOADS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api/problem.h"
#include "core/base/status.h"
#include "server/catalog/catalog.h"
#include "server/catalog/job.h"
#include "server/storage/store.h"

struct digest;
struct uploads;
struct uploads_writer;

/* Reads all, where the catalog isn't shared; those whose files are lost are forgotten (logged).  Catalog and store are
 * borrowed.  uploads_close accepts NULL, and wants every writer freed. */
enum status uploads_open(struct catalog *catalog, struct store *store, bool is_shared, struct uploads **uploads,
                         struct error *error) MUST_CHECK;
void uploads_close(struct uploads *uploads);

/* Whether there is one of this id, and what is known of it.  Doesn't block for long. */
enum status uploads_find(struct uploads *uploads, const char *id, struct catalog_upload *info, bool *found,
                         struct error *error) MUST_CHECK;

/* The upload that is made of these parts for this principal, if there is one that is whole and durable: concat is
 * "final ID ...".  Blocks. */
enum status uploads_find_final(struct uploads *uploads, const char *principal, const char *concat,
                               struct catalog_upload *info, bool *found, struct error *error) MUST_CHECK;

/* How pieces are checked: a hash in base64 that must come out. */
struct uploads_check {
    bool whole; /* the piece is kept whole or not at all, by this hash or by another one that the caller knows */
    bool is_sha1;
    char base64[64]; /* "" = none */
};

/* How many there may be, and how many bytes the principal may have in all (0 = no limit). */
struct uploads_limits {
    uint64_t all, of_principal, principal_bytes;
};

/* Starts a new upload with its first piece, which may be empty: fills in info's id.  It is durable, and there for
 * uploads_open, once uploads_end was called; freeing the writer before that undoes it.  NULL: *problem says why.
 * Doesn't block for long. */
struct uploads_writer *uploads_create(struct uploads *uploads, struct catalog_upload *info,
                                      const struct uploads_check *check, const struct uploads_limits *limits,
                                      struct problem *problem);

/* Starts the next piece, at this offset; a length that wasn't known is set (UINT64_MAX = leave it).  Whoever wrote
 * before can't any more.  NULL: *problem says why.  Doesn't block for long. */
struct uploads_writer *uploads_resume(struct uploads *uploads, const char *id, uint64_t offset, uint64_t length,
                                      const struct uploads_check *check, uint64_t principal_bytes,
                                      struct problem *problem);

/* Whoever writes can't any more: the offset is final until the next piece.  Waits for a piece that is just ending.
 * Blocks. */
enum status uploads_interrupt(struct uploads *uploads, const char *id, struct error *error) MUST_CHECK;

/* Takes the next bytes of a piece, to the page cache.  false: *problem says why. */
bool uploads_write(struct uploads_writer *writer, const void *bytes, size_t count, struct problem *problem);

/* The piece is complete: it is checked and made durable; the upload expires at expires_ms.  *info is what it has
 * become. Blocks.  false: *problem says why, and nothing that the writer has checked is kept. */
bool uploads_end(struct uploads_writer *writer, int64_t expires_ms, struct catalog_upload *info,
                 struct problem *problem);

/* Accepts NULL. */
void uploads_writer_free(struct uploads_writer *writer);

/* One request at a time, of this process, makes something of the file of an upload: between these two.  `turn` and id
 * are the caller's until the end.  Returns whether it had to wait, so that what is known of the upload may have
 * changed.  Blocks. */
struct uploads_turn {
    const char *id;
    struct uploads_turn *next;
};
bool uploads_take_turn(struct uploads *uploads, const char *id, struct uploads_turn *turn);
void uploads_end_turn(struct uploads *uploads, struct uploads_turn *turn);

/* The upload, which is whole and has so many bytes, becomes a file in scratch (scratch_part_open), if it isn't one.
 * Fails where they aren't all there any more: another host has made a cloud of them.  Blocks. */
enum status uploads_gather(struct uploads *uploads, const char *id, uint64_t bytes, struct error *error) MUST_CHECK;

/* The upload's file is a cloud now: that is noted, and the file removed.  Blocks. */
enum status uploads_complete(struct uploads *uploads, const char *id, const char *sha256,
                             struct error *error) MUST_CHECK;

/* Removes an upload, row and file; nothing where there is none.  Blocks. */
enum status uploads_delete(struct uploads *uploads, const char *id, struct error *error) MUST_CHECK;

/* Removes what has expired, and flushes what has come since the last piece's end.  Blocks. */
void uploads_sweep(struct uploads *uploads, int64_t now_ms);

/* All expire by so much later. */
void uploads_move_ends(struct uploads *uploads, int64_t step_ms);

#endif
