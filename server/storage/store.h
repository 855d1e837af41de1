/* The store: clouds by content, outputs and logs by job.
 *
 * One backend at present, a folder (store_fs.c).  Another one (an object store that several hosts share) implements the
 * same functions.  What is visible is complete and on disk: uploads and outputs are written under temporary names and
 * appear by rename, after fsync.  All functions may be called from any thread, and block on the disk; those that may be
 * called from a callback that must not block say so.
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

struct digest_will;
struct store;

enum { STORE_PATH_BYTES = 4096, STORE_NAME_BYTES = 80 };

/* Opens or creates the folder, for this process alone: STATUS_IO when another one has it, whatever was removed from it
 * by hand.  store_close accepts NULL. */
enum status store_open(const char *folder, struct store **store, struct error *error) MUST_CHECK;
void store_close(struct store *store);

/* The identity that the folder shares with its database (jobs/identity.h): read, "" where it has none; and set,
 * durably.
 */
enum { STORE_IDENTITY_BYTES = 33 };
enum status store_identity(const struct store *store, char id[STORE_IDENTITY_BYTES], struct error *error) MUST_CHECK;
enum status store_set_identity(struct store *store, const char *id, struct error *error) MUST_CHECK;

/* The path of the file that keeps the key of signed links. */
void store_key_path(const struct store *store, char path[STORE_PATH_BYTES]);

/* Bytes that may still be written; UINT64_MAX when that isn't known.  Doesn't block for long. */
uint64_t store_free_bytes(const struct store *store);

/* How many bytes are to stay free (0 at first), and whether so many more may be written beside them.  Neither blocks
 * for long. */
void store_keep_free(struct store *store, uint64_t bytes);
bool store_has_room(const struct store *store, uint64_t bytes);

/* Whether files can be written at all: a small one is, and vanishes.  STATUS_NO_SPACE: the disk is full; STATUS_IO:
 * they are refused for another reason.  Blocks as long as the disk does. */
enum status store_takes_files(struct store *store, struct error *error) MUST_CHECK;

/* Whether writing `count` bytes after `before` others is fine by store_has_room, asked once for each
 * STORE_STRIDE_BYTES; else errno is ENOSPC. */
enum { STORE_STRIDE_BYTES = 1 << 20 };
bool store_may_go_on(const struct store *store, uint64_t before, uint64_t count);

/* An upload in the making: write to fd, then keep or drop it.  Zero-initialise with fd = -1. */
struct store_upload {
    int fd;
    char name[STORE_NAME_BYTES];
};

/* Doesn't block for long. */
enum status store_upload_begin(struct store *store, struct store_upload *upload, struct error *error) MUST_CHECK;

/* Flushes the upload to disk; to be called before, and outside of locks held for, store_upload_keep. */
enum status store_upload_sync(struct store_upload *upload, struct error *error) MUST_CHECK;

/* Makes the upload the cloud of this hash; the same content there already is replaced by it.  Ends the upload. */
enum status store_upload_keep(struct store *store, struct store_upload *upload, const char *sha256,
                              struct error *error) MUST_CHECK;

/* Removes the upload; accepts one that has ended. */
void store_upload_drop(struct store *store, struct store_upload *upload);

/* The path of a cloud, for a worker to read. */
void store_cloud_path(const struct store *store, const char *sha256, char path[STORE_PATH_BYTES]);
int store_cloud_open(const struct store *store, const char *sha256); /* for reading; -1 when there is none */
bool store_cloud_exists(const struct store *store, const char *sha256);
void store_cloud_delete(struct store *store, const char *sha256);

/* A resumable upload's file: opened for reading and writing (create: a new one), -1 with errno when it can't.  Doesn't
 * block for long. */
int store_part_open(struct store *store, const char *id, bool create);

/* Flushes the file, and that it is there. */
enum status store_part_sync(struct store *store, int fd, struct error *error) MUST_CHECK;

/* Makes the file's content the cloud of this hash, too; the part stays. */
enum status store_part_keep(struct store *store, const char *id, const char *sha256, struct error *error) MUST_CHECK;
void store_part_delete(struct store *store, const char *id);

/* Outputs are those of a job and of the attempt that made them, so an attempt that goes on after its lease has ended
 * writes to nothing that a later one has.
 *
 * Makes an empty folder for the outputs of an attempt, and gives its path. */
enum status store_outputs_begin(struct store *store, const char *id, int attempt, char path[STORE_PATH_BYTES],
                                struct error *error) MUST_CHECK;

/* Makes what is in that folder the attempt's outputs: fills outputs (JOB_MAX_OUTPUTS) with name, length and hash, in
 * the order of their names.  Reads every byte, for as long as will (digest.h; NULL = it goes on) says so. */
enum status store_outputs_keep(struct store *store, const char *id, int attempt, const struct digest_will *will,
                               struct job_output *outputs, size_t *count, struct error *error) MUST_CHECK;

/* Makes the outputs of one job another one's too (of attempt 0), as links to the same files: deleting one leaves the
 * other. */
enum status store_outputs_share(struct store *store, const char *from_id, int from_attempt, const char *to_id,
                                struct error *error) MUST_CHECK;

/* Removes that folder, and those of earlier attempts, if they are there. */
void store_outputs_drop(struct store *store, const char *id, int attempt);

/* Opens an output for reading; -1 when there is none. */
int store_output_open(const struct store *store, const char *id, int attempt, const char *name);
bool store_outputs_exist(const struct store *store, const char *id, int attempt);

/* How many there are; -1 where they can't be listed. */
int store_outputs_count(const struct store *store, const char *id, int attempt);

/* A file without a name, for reading and writing, gone when it is closed; -1 with errno when there can't be one. */
int store_scratch_open(const struct store *store);

/* Opens the job's log, for appending (made if it isn't there) or reading; -1 when it can't. */
int store_log_open(struct store *store, const char *id, bool append);

/* Removes an attempt's outputs, or all of the job, its log too: they vanish at once. */
void store_outputs_delete(struct store *store, const char *id, int attempt);
void store_job_delete(struct store *store, const char *id);

enum store_thing { STORE_CLOUD, STORE_JOB, STORE_PART, STORE_TEMPORARY };

/* Tells of everything that the store holds. */
enum status store_each(const struct store *store, void (*found)(void *ctx, enum store_thing thing, const char *name),
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
uint64_t store_lost(const struct store *store);

#endif
