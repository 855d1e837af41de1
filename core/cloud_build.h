/* Making a cloud, point by point: what the readers of all formats but PLY and XYZ share.
 *
 *     cloud_build_start(&build, CLOUD_OFF, n, limits, progress, error);
 *     status = cloud_build_property(...) for each; cloud_build_room, where the count is known
 *     status = cloud_build_point(...), cloud_build_triangle(...)
 *     return cloud_build_end(&build, status, cloud);
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_BUILD_H
#define WHITTLE_CORE_CLOUD_BUILD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/cloud.h"
#include "core/progress.h"
#include "core/status.h"

struct cloud_build {
    struct cloud cloud; /* read it, but don't write to it */
    uint64_t bytes;     /* of the file, for progress */
    uint64_t max_points;
    size_t max_properties;
    size_t point_capacity, triangle_capacity;
    const struct progress *progress;
    struct error *error;
};

/* Where in the file: the line, for text (0 = it isn't text), and the byte. */
struct cloud_place {
    uint64_t line, byte;
};

/* limits, progress and error are borrowed until the end, and may be NULL. */
void cloud_build_start(struct cloud_build *build, enum cloud_format format, uint64_t bytes,
                       const struct cloud_limits *limits, const struct progress *progress, struct error *error);

/* Adds a scalar property, before the first point.  x, y and z are known by these names.  A name that is taken, too long
 * or not printable becomes "columnN".  STATUS_LIMIT, STATUS_NO_MEMORY. */
enum status cloud_build_property(struct cloud_build *build, const char *name, enum scalar_type type) MUST_CHECK;

/* There will be this many points: STATUS_LIMIT, or memory for all of them (STATUS_NO_MEMORY). */
enum status cloud_build_room(struct cloud_build *build, uint64_t points) MUST_CHECK;

/* Adds the point of this record (cloud.record_bytes, native byte order, borrowed).  STATUS_MALFORMED where a coordinate
 * isn't finite, STATUS_LIMIT, STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status cloud_build_point(struct cloud_build *build, const void *record, struct cloud_place place) MUST_CHECK;

/* Adds a triangle.  Whether its points are there is the caller's to check. */
enum status cloud_build_triangle(struct cloud_build *build, uint32_t a, uint32_t b, uint32_t c) MUST_CHECK;

/* Notes what the file has and a cloud can't hold; one line.  A note that is there already isn't added again. */
enum status cloud_build_leave_out(struct cloud_build *build, const char *what) MUST_CHECK;

/* Adds a comment of n bytes without its mark; what isn't printable becomes a blank, what is too much is dropped. */
enum status cloud_build_comment(struct cloud_build *build, const char *text, size_t n) MUST_CHECK;

/* STATUS_MALFORMED at a place: for readers. */
enum status cloud_build_bad(struct cloud_build *build, const char *where, struct cloud_place place, const char *format,
                            ...) MUST_CHECK __attribute__((format(printf, 4, 5)));

/* The end, in any case: hands the cloud over where status is STATUS_OK and there are points, else frees it. */
enum status cloud_build_end(struct cloud_build *build, enum status status, struct cloud *cloud) MUST_CHECK;

#endif
