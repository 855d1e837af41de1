/* Files that appear complete or not at all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_FILE_OUT_H
#define WHITTLE_CORE_IO_OUT_FILE_OUT_H

#include <stdbool.h>
#include <stddef.h>
#include <sys/types.h>

#include "core/base/status.h"

struct file_out_source {
    dev_t device;
    ino_t inode;
};

/* What a new file may take the place of. */
struct file_out_rule {
    bool replaces;                        /* files that are there, but for those below */
    size_t source_count;                  /* files that are being read, which nothing takes the place of */
    const struct file_out_source *source; /* borrowed */
};

enum file_out_claim {
    FILE_OUT_FREE,
    FILE_OUT_REPLACES,
    FILE_OUT_TAKEN,
    FILE_OUT_IS_SOURCE,
    FILE_OUT_IS_FOLDER,
    FILE_OUT_IS_SPECIAL
};

/* What committing a file of this name would meet now: no file; one that it replaces; one that the rule keeps; the
 * source, by whatever name or link; a folder; a pipe, a socket or a device, which is never replaced. */
enum file_out_claim file_out_look(const char *path, const struct file_out_rule *rule);

/* Says so in words.  STATUS_OK for the first two, STATUS_IO for the last two, else STATUS_BAD_PARAMETER. */
enum status file_out_refuse(const char *path, enum file_out_claim claim, struct error *error) MUST_CHECK;

struct file_out {
    int fd;                           /* to be written to; opened for reading and writing */
    int failure;                      /* of its sync, an errno */
    char *path;                       /* the final name; owned */
    char *temporary;                  /* the name until commit, in the same folder; owned */
    const struct file_out_rule *rule; /* borrowed; NULL: replaces whatever file is there.  Set it after begin */
};

/* Opens a new file beside path, named .NAME.XXXXXXXX.part, with the permissions that the umask leaves of 0666.  On
 * success file_out_commit or file_out_abort must follow; else *file is zeroed and nothing is left behind.  STATUS_IO,
 * STATUS_NO_MEMORY. */
enum status file_out_begin(struct file_out *file, const char *path, struct error *error) MUST_CHECK;

/* Syncs n >= 1 files of one folder, gives them their names in that order (replacing what the rule lets them) and syncs
 * the folder; closes and zeroes all of them in any case.  Where a sync of a file fails (STATUS_IO) none gets its name,
 * and the temporary files are removed; where a name can't be given (STATUS_IO, or STATUS_BAD_PARAMETER by the rule),
 * neither do those after it.  What the rule keeps is never without its name, whoever makes or moves files meanwhile. */
enum status file_out_commit(struct file_out *file, size_t n, struct error *error) MUST_CHECK;

/* Gives a file its name without a sync, and closes and zeroes it; the disk begins to write.  For one of several that
 * nobody trusts before another file is there: file_out_sync must follow before that is committed.  Statuses as above,
 * *file is as it was then. */
enum status file_out_name(struct file_out *file, struct error *error) MUST_CHECK;

/* Waits until a file that has its name is on the disk; its folder is synced with the next one that is committed. */
enum status file_out_sync(const char *path, struct error *error) MUST_CHECK;

/* Closes and removes the temporary file and zeroes *file.  Does nothing after commit, or to a zeroed one. */
void file_out_abort(struct file_out *file);

#endif
