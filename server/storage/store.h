/* The store: clouds by content, outputs and logs by job.  Where each lies is decided here: what is complete among the
 * blobs (blobs/blobs.h), what isn't in this host's scratch (scratch.h).
 *
 *     clouds/<sha256>                 a blob: an input, by content
 *     jobs/<id>/outputs/<name>        a blob: an output of a job that succeeded; outputs.<n> of its n-th attempt, n > 1
 *     jobs/<id>/tiles/<name>          a blob: what tasks of a job in tiles have made, until the job ends
 *     jobs/<id>/log.<host>            a blob, where several hosts share them: what one of them has of the log
 *     uploads/<id>/<offset>-<token>--<hash>   a blob, where several hosts share them: a piece of an upload
 *     jobs/<id>/log, uploads/<id>     scratch
 *
 * What is visible is complete and on disk.  All functions may be called from any thread, and block on the disk; those
 * that may be called from a callback that must not block say so.
 *
 * Statuses: STATUS_IO with a text when the operating system refuses; others as said.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_STORAGE_STORE_H
#define WHITTLE_SERVER_STORAGE_STORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "server/catalog/job.h"
#include "server/storage/scratch.h"

struct digest_will;
struct store;

/* Opens the host's folder, and the blobs behind the URL ("" = in that folder).  store_close accepts NULL. */
enum status store_open(const char *folder, const char *blobs_url, struct store **store, struct error *error) MUST_CHECK;
void store_close(struct store *store);

/* This host's part of it; borrowed. */
struct scratch *store_scratch(struct store *store);

/* Makes the upload, which was flushed, the cloud of this hash; the same content there already is replaced by it.  Ends
 * the upload. */
enum status store_upload_keep(struct store *store, struct scratch_file *upload, const char *sha256,
                              struct error *error) MUST_CHECK;

/* Part of something that is kept: bytes first to last, to be read at their places, of so many (0 = isn't known). */
struct store_range {
    uint64_t first, last, of;
};

/* How somebody may fetch something at the store itself, for so many seconds, and what it is told as. */
struct store_link {
    unsigned seconds;
    const char *type, *disposition;
    char *url; /* BLOBS_LINK_BYTES */
};

/* What a put to the store doesn't end is marked in the catalog, from now on: by these (blobs/blobs.h). */
void store_watch_unfinished(struct store *store, const struct blobs_unfinished *unfinished);
bool store_give_up(struct store *store, const char *what);

/* A cloud, opened for reading, all or at least a range (NULL = all); -1 with the errno of blobs_read where it can't be.
 * false: it can't be fetched elsewhere. */
int store_cloud_open(struct store *store, const char *sha256);
int store_cloud_open_range(struct store *store, const char *sha256, const struct store_range *range);
bool store_cloud_link(struct store *store, const char *sha256, const struct store_link *link);
bool store_cloud_exists(struct store *store, const char *sha256);
bool store_cloud_delete(struct store *store, const char *sha256, struct blobs_removal *removal); /* as blobs_remove */
bool store_is_remote(const struct store *store);                                                 /* ... and this one */

/* Makes the file's content the cloud of this hash, too; the part stays. */
enum status store_part_keep(struct store *store, const char *id, const char *sha256, struct error *error) MUST_CHECK;

/* Pieces of an upload that several hosts go on with: makes the file, which was flushed and has this hash, the piece of
 * that name, and ends the file; copies one to where `to` is at; removes all of an upload's.  A name ends with the first
 * digits of the hash behind two dashes, which are compared when it is copied; those of earlier versions have none. */
enum status store_piece_keep(struct store *store, const char *upload, const char *name, const char *sha256,
                             struct scratch_file *file, struct error *error) MUST_CHECK;
enum status store_piece_copy(struct store *store, const char *upload, const char *name, int to,
                             struct error *error) MUST_CHECK;
void store_pieces_delete(struct store *store, const char *upload);

/* Removes what a mark of the catalog names: a job's folder, or an upload's.  false: some of it may be there still. */
bool store_marked_delete(struct store *store, const char *name);

/* Outputs are those of a job and of the attempt that made them, so an attempt that goes on after its lease has ended
 * writes to nothing that a later one has.
 *
 * Makes what is in the attempt's folder (scratch_run_begin) its outputs: fills outputs (JOB_MAX_OUTPUTS) with name,
 * length and hash, in the order of their names.  Reads every byte, for as long as will (digest.h; NULL = it goes on)
 * says so. */
enum status store_outputs_keep(struct store *store, const char *id, int attempt, const struct digest_will *will,
                               struct job_output *outputs, size_t *count, struct error *error) MUST_CHECK;

/* Makes the outputs of one job another one's too (of attempt 0): deleting one leaves the other. */
enum status store_outputs_share(struct store *store, const char *from_id, int from_attempt, const char *to_id,
                                struct error *error) MUST_CHECK;

/* Opens an output for reading, like a cloud: by its name alone, or as what its row says. */
int store_output_open(struct store *store, const char *id, int attempt, const char *name);
int store_output_open_range(struct store *store, const char *id, int attempt, const struct job_output *output,
                            const struct store_range *range);
bool store_output_link(struct store *store, const char *id, int attempt, const char *name,
                       const struct store_link *link);
bool store_outputs_exist(struct store *store, const char *id, int attempt);

/* How many there are; -1 where they can't be listed. */
int store_outputs_count(struct store *store, const char *id, int attempt);

/* Makes what is in a task's folder (scratch_run_begin) part of what the job's tasks have made.  Which task makes which
 * names is known above; a task that runs twice makes the same bytes.  As store_outputs_keep. */
enum status store_tiles_keep(struct store *store, const char *id, int attempt, const struct digest_will *will,
                             struct error *error) MUST_CHECK;

/* Opens one for reading; -1 with errno.  Removes all of them; false: some may be there still. */
int store_tiles_open(struct store *store, const char *id, const char *name);
bool store_tiles_delete(struct store *store, const char *id);

/* Opens the job's log, for appending (made if it isn't there) or reading; -1 when it can't. */
int store_log_open(struct store *store, const char *id, bool append);

/* Makes what this host has of a job's log a blob, for other hosts to read; again, in the place of what it was. */
enum status store_log_share(struct store *store, const char *id, const char *host, struct error *error) MUST_CHECK;

/* Opens what all hosts have shared of it, one after the other; this host's own where they have nothing.  -1 with errno,
 * ENOENT when there is none. */
int store_log_gather(struct store *store, const char *id);

/* Removes an attempt's outputs, or all of the job, its log too: they vanish at once. */
void store_outputs_delete(struct store *store, const char *id, int attempt);
bool store_job_delete(struct store *store, const char *id); /* false: some of it may be there still */

enum store_thing { STORE_CLOUD, STORE_JOB, STORE_PART, STORE_TEMPORARY };

/* Tells of everything that the store holds. */
enum status store_each(struct store *store, void (*found)(void *ctx, enum store_thing thing, const char *name),
                       void *ctx, struct error *error) MUST_CHECK;

/* What becomes of a cloud, a job or a part at the start: it stays; it is removed, for it is known to be over; it is
 * moved to lost+found (blobs/lost_found.h), for nothing is known of it. */
enum store_fate { STORE_KEEP, STORE_REMOVE, STORE_SET_ASIDE };

struct store_cleaned {
    size_t removed, set_aside, left; /* left: should have been set aside, and couldn't be */
    char place[64];                  /* where to, in the folder; "" = nothing was */
};

/* Removes everything temporary, and does with each cloud, job and part what fate(ctx, thing, name) says.  For the
 * start, before anything else uses the store. */
enum status store_clean(struct store *store,
                        enum store_fate (*fate)(void *ctx, enum store_thing thing, const char *name), void *ctx,
                        struct store_cleaned *cleaned, struct error *error) MUST_CHECK;

/* How many clouds, jobs and parts lie in lost+found; it stays there until whoever operates the service removes it. */
uint64_t store_lost(struct store *store);

#endif
