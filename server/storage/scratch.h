/* Scratch: a host's own part of the disk, in its data folder.  What is being received or computed lies here until it is
 * a blob; nobody else looks at it, and a host that is lost loses no more than that.
 *
 *     identity                of the host, and of a catalog of its own (jobs/identity.h)
 *     signing.key             of the links that are handed out
 *     lock                    held, like the folder itself, by the process that serves it
 *     uploads/<id>            resumable uploads, as much of them as there is
 *     jobs/<id>/log           standard error of the job's processes
 *     tmp/                    what is being written, or being removed; emptied at the start
 *
 * All functions may be called from any thread, and block on the disk; those that may be called from a callback that
 * must not block say so.
 *
 * Statuses: STATUS_IO with a text when the operating system refuses, STATUS_NO_SPACE; others as said.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_STORAGE_SCRATCH_H
#define WHITTLE_SERVER_STORAGE_SCRATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "server/base/folders.h"
#include "server/blobs/blobs.h"

struct scratch;

enum { SCRATCH_PATH_BYTES = 4096 };

/* Opens or creates the folder, for this process alone: STATUS_IO when another one has it, whatever was removed from it
 * by hand.  scratch_close accepts NULL. */
enum status scratch_open(const char *folder, struct scratch **scratch, struct error *error) MUST_CHECK;
void scratch_close(struct scratch *scratch);

/* The identity of the host: read, "" where it has none; and set, durably. */
enum { SCRATCH_IDENTITY_BYTES = 33 };
enum status scratch_identity(const struct scratch *scratch, char id[SCRATCH_IDENTITY_BYTES],
                             struct error *error) MUST_CHECK;
enum status scratch_set_identity(struct scratch *scratch, const char *id, struct error *error) MUST_CHECK;

/* The path of the folder, and of the file that keeps the key of signed links. */
const char *scratch_folder(const struct scratch *scratch);
void scratch_key_path(const struct scratch *scratch, char path[SCRATCH_PATH_BYTES]);

/* ------------------------------------------------------------------------------------------------ room */

/* Bytes that may still be written; UINT64_MAX when that isn't known.  Doesn't block for long. */
uint64_t scratch_free_bytes(const struct scratch *scratch);

/* How many bytes are to stay free (0 at first), and whether so many more may be written beside them.  Neither blocks
 * for long. */
void scratch_keep_free(struct scratch *scratch, uint64_t bytes);
bool scratch_has_room(const struct scratch *scratch, uint64_t bytes);

/* Whether files can be written at all: a small one is, and vanishes.  STATUS_NO_SPACE: the disk is full; STATUS_IO:
 * they are refused for another reason.  Blocks as long as the disk does. */
enum status scratch_takes_files(struct scratch *scratch, struct error *error) MUST_CHECK;

/* Whether writing `count` bytes after `before` others is fine by scratch_has_room, asked once for each
 * SCRATCH_STRIDE_BYTES; else errno is ENOSPC. */
enum { SCRATCH_STRIDE_BYTES = 1 << 20 };
bool scratch_may_go_on(const struct scratch *scratch, uint64_t before, uint64_t count);

/* ------------------------------------------------------------------------------------------------ files */

/* A file in the making: write to fd, then put it among the blobs or drop it.  Zero-initialise with fd = -1. */
struct scratch_file {
    int fd;
    char name[FOLDERS_NAME_BYTES];
};

/* Doesn't block for long. */
enum status scratch_file_begin(struct scratch *scratch, struct scratch_file *file, struct error *error) MUST_CHECK;

/* Flushes it to disk. */
enum status scratch_file_sync(struct scratch_file *file, struct error *error) MUST_CHECK;

/* What makes it a blob of this name and content; all borrowed. */
struct blobs_source scratch_file_source(const struct scratch *scratch, const struct scratch_file *file,
                                        const char *name, const char *sha256);

/* Closes it, and removes it unless it has become a blob; accepts one that has ended. */
void scratch_file_drop(struct scratch *scratch, struct scratch_file *file);

/* A file without a name, for reading and writing, gone when it is closed; -1 with errno when there can't be one. */
int scratch_nameless_open(const struct scratch *scratch);

/* ------------------------------------------------------------------------------------------------ uploads */

/* A resumable upload's file: opened for reading and writing (create: a new one), -1 with errno when it can't.  Doesn't
 * block for long. */
int scratch_part_open(struct scratch *scratch, const char *id, bool create);

/* Flushes the file, and that it is there. */
enum status scratch_part_sync(struct scratch *scratch, int fd, struct error *error) MUST_CHECK;

/* Makes the file, which is no part of anything else, the upload's, in the place of what is there.  Ends the file. */
enum status scratch_part_take(struct scratch *scratch, const char *id, struct scratch_file *file,
                              struct error *error) MUST_CHECK;

/* Makes *file the same content under another name. */
enum status scratch_part_link(struct scratch *scratch, const char *id, struct scratch_file *file,
                              struct error *error) MUST_CHECK;
void scratch_part_delete(struct scratch *scratch, const char *id);

/* ------------------------------------------------------------------------------------------------ runs */

/* Makes an empty folder that an attempt of a job writes into, gives its path; opens it; removes it, and those of
 * earlier attempts, if they are there. */
enum status scratch_run_begin(struct scratch *scratch, const char *job, int attempt, char path[SCRATCH_PATH_BYTES],
                              struct error *error) MUST_CHECK;
int scratch_run_open(const struct scratch *scratch, const char *job, int attempt);
void scratch_run_drop(struct scratch *scratch, const char *job, int attempt);

/* Removes it, and leaves those of other attempts, which are tasks of the same job. */
void scratch_run_drop_alone(struct scratch *scratch, const char *job, int attempt);

/* Opens the job's log, for appending (made if it isn't there) or reading; -1 when it can't. */
int scratch_log_open(struct scratch *scratch, const char *job, bool append);
void scratch_log_delete(struct scratch *scratch, const char *job);

/* ------------------------------------------------------------------------------------------------ all of it */

/* Tells of each upload; of each job that has a log; of what is in tmp/.  -1 with errno. */
int scratch_each_part(const struct scratch *scratch, void (*found)(void *ctx, const char *name), void *ctx);
int scratch_each_log(const struct scratch *scratch, void (*found)(void *ctx, const char *name), void *ctx);
int scratch_each_temporary(const struct scratch *scratch, void (*found)(void *ctx, const char *name), void *ctx);

/* Empties tmp/; *removed is how many names.  For the start, before anything else uses the folder.  -1 with errno. */
int scratch_wipe(struct scratch *scratch, size_t *removed);

/* Moves an upload to lost+found (blobs/lost_found.h); false: it is still where it was. */
bool scratch_part_set_aside(struct scratch *scratch, const char *start, const char *id, char place[64]);

/* How many clouds, jobs and parts lie in the data folder's lost+found; it stays there until whoever operates the
 * service removes it. */
uint64_t scratch_lost(const struct scratch *scratch);

#endif
