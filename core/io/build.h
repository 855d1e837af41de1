/* Making a cloud, point by point: what the readers of all formats but PLY and XYZ share.
 *
 *     cloud_build_start(&build, "off", n, limits, progress, error);
 *     status = cloud_build_property(...) for each; cloud_build_room, where the count is known
 *     status = cloud_build_point(...), cloud_build_triangle(...)
 *     return cloud_build_end(&build, status, cloud);
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_BUILD_H
#define WHITTLE_CORE_IO_BUILD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"

/* Of a cloud's triangles while they come. */
struct triangle_room {
    size_t capacity;
    uint64_t most; /* that there may be; 0 = any number */
};

struct cloud_build {
    struct cloud cloud; /* read it, but don't write to it */
    uint64_t bytes;     /* of the file, for progress */
    uint64_t max_points;
    size_t max_properties;
    size_t point_capacity;
    struct triangle_room triangles;
    const struct progress *progress;
    struct error *error;
};

/* Where in the file: the line, for text (0 = it isn't text), and the byte. */
struct cloud_place {
    uint64_t line, byte;
};

/* limits, progress and error are borrowed until the end, and may be NULL. */
void cloud_build_start(struct cloud_build *build, const char *form, uint64_t bytes, const struct cloud_limits *limits,
                       const struct progress *progress, struct error *error);

/* Adds a scalar property, before the first point.  x, y and z are known by these names.  A name that is taken, too long
 * or not printable becomes "columnN".  STATUS_LIMIT, STATUS_NO_MEMORY. */
enum status cloud_build_property(struct cloud_build *build, const char *name, enum scalar_type type) MUST_CHECK;

/* There will be this many points: STATUS_LIMIT, or memory for all of them (STATUS_NO_MEMORY). */
enum status cloud_build_room(struct cloud_build *build, uint64_t points) MUST_CHECK;

/* Adds the point of this record (cloud.record_bytes, native byte order, borrowed).  One that has a coordinate which
 * isn't finite stays until the end, for faces that count it.  STATUS_LIMIT, STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status cloud_build_point(struct cloud_build *build, const void *record, struct cloud_place place) MUST_CHECK;

/* For points whose number is known and which are made out of order, on many threads: adds so many, whose records
 * (cloud.record + i * cloud.record_bytes) are to be written, and each placed then.  The first is as cloud_build_room;
 * the second is O(1) and touches point i alone. */
enum status cloud_build_slots(struct cloud_build *build, uint64_t points) MUST_CHECK;
void cloud_build_place(struct cloud_build *build, size_t i);

/* Adds a triangle.  Whether its points are there is the caller's to check. */
enum status cloud_build_triangle(struct cloud_build *build, uint32_t a, uint32_t b, uint32_t c) MUST_CHECK;

/* The same for readers that fill a cloud of their own: STATUS_NO_MEMORY, at "faces" where there are too many. */
enum status cloud_build_append(struct cloud *cloud, struct triangle_room *room, uint32_t a, uint32_t b, uint32_t c,
                               struct error *error) MUST_CHECK;

/* Corners that were added as UINT32_MAX - 1 - i, i < count, become id[i]. */
void cloud_build_renumber(struct cloud_build *build, const uint32_t *id, size_t count);

/* Notes what the file has and a cloud can't hold; one line.  A note that is there already isn't added again.
 * STATUS_NO_MEMORY.  The first is for readers that fill a cloud of their own. */
enum status cloud_leave_out(struct cloud *cloud, const char *what) MUST_CHECK;
enum status cloud_build_leave_out(struct cloud_build *build, const char *what) MUST_CHECK;

/* Adds a comment of n bytes without its mark; what isn't printable becomes a blank, what is too much is dropped. */
enum status cloud_build_comment(struct cloud_build *build, const char *text, size_t n) MUST_CHECK;

/* STATUS_MALFORMED at a place: for readers. */
enum status cloud_build_bad(struct cloud_build *build, const char *where, struct cloud_place place, const char *format,
                            ...) MUST_CHECK __attribute__((format(printf, 4, 5)));

/* The end, in any case: hands the cloud over where status is STATUS_OK and there are points, less those that have no
 * position (core/io/finite.h), else frees it. */
enum status cloud_build_end(struct cloud_build *build, enum status status, struct cloud *cloud) MUST_CHECK;

#endif
