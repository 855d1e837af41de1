/* The members of a tar archive, for its reader and for whoever has its beginning.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_TAR_MEMBERS_H
#define WHITTLE_CORE_IO_FORMATS_TAR_MEMBERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { TAR_BLOCK_BYTES = 512, TAR_NAME_BYTES = 256 };

/* Zero-initialise for the first one. */
struct tar_member {
    char name[TAR_NAME_BYTES]; /* without folders */
    uint64_t first, bytes;     /* where it is; more bytes than there are, where the archive is cut short */
    uint64_t next, at;         /* where to look on; the last header looked at */
    const char *wrong;         /* why there is no next one; NULL = the archive has ended.  Static */
};

/* The next file of n bytes of an archive (all of it, or its beginning); false: there is none.  O(headers passed). */
bool tar_next(const void *bytes, size_t n, struct tar_member *member);

#endif
