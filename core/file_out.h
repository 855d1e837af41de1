/* Files that appear complete or not at all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_FILE_OUT_H
#define WHITTLE_CORE_FILE_OUT_H

#include <stddef.h>

#include "core/status.h"

struct file_out {
    int fd;          /* to be written to; opened for reading and writing */
    int failure;     /* of its sync, an errno */
    char *path;      /* the final name; owned */
    char *temporary; /* the name until commit, in the same folder; owned */
};

/* Opens a new file beside path, named .NAME.XXXXXXXX.part, with the permissions that the umask leaves of 0666.  On
 * success file_out_commit or file_out_abort must follow; else *file is zeroed and nothing is left behind.  STATUS_IO,
 * STATUS_NO_MEMORY. */
enum status file_out_begin(struct file_out *file, const char *path, struct error *error) MUST_CHECK;

/* Syncs n >= 1 files of one folder, gives them their names in that order (replacing what was there) and syncs the
 * folder; closes and zeroes all of them in any case.  Where a sync of a file fails (STATUS_IO) none gets its name, and
 * the temporary files are removed; where a name can't be given, neither do those after it. */
enum status file_out_commit(struct file_out *file, size_t n, struct error *error) MUST_CHECK;

/* Closes and removes the temporary file and zeroes *file.  Does nothing after commit, or to a zeroed one. */
void file_out_abort(struct file_out *file);

#endif
