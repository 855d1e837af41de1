/* Formats whose files can be read part by part: what each gives beside its reader (core/io/reader.h).  For core/io/
 * alone; everyone else reads by core/io/stream.h.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_PARTS_H
#define WHITTLE_CORE_IO_PARTS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/cloud/cloud.h"

enum {
    CLOUD_PART_MOST = 1 << 22, /* points in a part, whatever a file says */
    CLOUD_PART_USUAL = 1 << 18
};

struct cloud_parts {
    struct cloud *cloud; /* what the file says of all its points, and those of the present part: count of them; owned */
    uint64_t promised;   /* points of the whole file, by its header; 0 = not known */
    size_t done_bytes;   /* of the file: none before is read again */
    enum status (*next)(struct cloud_parts *parts, struct error *error); /* count 0: the end, where views are known */
    void (*free)(struct cloud_parts *parts);
    bool goes_on;   /* of a part without points: it isn't the end */
    size_t on_disk; /* bytes that it has decompressed there */
};

/* Begins with a whole file of n bytes, not compressed, a mapping of which is borrowed until the end.  Points without a
 * position are among the parts.  Statuses as of the readers; STATUS_UNSUPPORTED where this file can't be read so. */
enum status cloud_las_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) MUST_CHECK;
enum status cloud_ply_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) MUST_CHECK;
enum status cloud_pcd_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) MUST_CHECK;
enum status cloud_e57_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) MUST_CHECK;
enum status cloud_ptx_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) MUST_CHECK;
enum status cloud_xyz_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) MUST_CHECK;

#endif
