/* What each format that is read gives: a look at the first bytes, and a reader.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_READER_H
#define WHITTLE_CORE_IO_READER_H

#include <stddef.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/io/formats.h"

struct first_bytes;

/* A format's look at the first bytes: the form that a file which begins like this has, "" for one of another format.
 * Static.  O(bytes looked at), at most 64 KiB. */
#define ROW(constant, name, title, looks_like, forms) const char *cloud_##name##_look(const struct first_bytes *first);
CLOUD_FORMAT_ROWS(ROW)
#undef ROW

/* A format's reader, of a whole file of n bytes, not compressed.  limits (NULL = none), and whether the n bytes can
 * hold what a header promises, are checked before anything is allocated; progress may be NULL.  On success *cloud is
 * the caller's, for cloud_done; else it is untouched.  STATUS_MALFORMED with the line or the byte offset and what is
 * wrong there; STATUS_LIMIT, STATUS_UNSUPPORTED, STATUS_NO_MEMORY, STATUS_CANCELLED.  O(n). */
#define ROW(constant, name, title, looks_like, forms)                                                                  \
    enum status cloud_##name##_read(const void *bytes, size_t n, const struct cloud_limits *limits,                    \
                                    const struct progress *progress, struct cloud *cloud, struct error *error)         \
        MUST_CHECK;
CLOUD_FORMAT_ROWS(ROW)
#undef ROW

#endif
