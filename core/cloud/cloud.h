/* A cloud as it was read: points, and everything else that the file said of them.
 *
 * The file's vertex records are kept as they were (native byte order, each property in its own type), so that the
 * points that are kept come out bit for bit.  position is a copy of x, y, z as double for the stages.
 *
 * Invariant: position[i] equals the x, y and z properties of record i; every coordinate is finite.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_CLOUD_H
#define WHITTLE_CORE_CLOUD_CLOUD_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

#define NONE UINT32_MAX
#define CLOUD_SCAN "scan"
enum { CLOUD_SCANS_MOST = 65536 }; /* numbers of scans are below */

enum scalar_type {
    SCALAR_INT8,
    SCALAR_UINT8,
    SCALAR_INT16,
    SCALAR_UINT16,
    SCALAR_INT32,
    SCALAR_UINT32,
    SCALAR_FLOAT32,
    SCALAR_FLOAT64
};
#define SCALAR_TYPE_COUNT 8

/* Bytes of one scalar: 1, 1, 2, 2, 4, 4, 4, 8. */
size_t scalar_bytes(enum scalar_type type);

/* The value at p (any alignment, native byte order) as a double; and the other way round (rounded, saturated). */
double scalar_load(const void *p, enum scalar_type type);
void scalar_store(void *p, enum scalar_type type, double value);

enum { PROPERTY_NAME_BYTES = 64, CLOUD_MAX_PROPERTIES = 256 };

/* One property of the vertex element, in the order of the file. */
struct property {
    char name[PROPERTY_NAME_BYTES];
    enum scalar_type type;       /* of the scalar, or of a list's items */
    int is_list;                 /* lists live in list_offset / list_data, not in the record */
    enum scalar_type count_type; /* of a list's length in the file */
    size_t offset_bytes;         /* of a scalar, within the record */
    size_t *list_offset;         /* lists: count + 1 byte offsets into list_data; owned */
    unsigned char *list_data;    /* lists: items, native byte order; owned */
};

struct params;

/* What a reader may accept; 0 = the format's own limit (NONE - 1 points, CLOUD_MAX_PROPERTIES); and what only the
 * caller knows of the file. */
struct cloud_limits {
    uint64_t max_points;
    uint32_t max_properties;
    const char *columns;    /* of text: core/text/column_list.h; NULL or "" = what the file says */
    bool columns_if_text;   /* of any other format they are left aside, and not refused */
    uint64_t max_triangles; /* that memory has room for; more are STATUS_NO_MEMORY */
    unsigned threads;       /* that may read; 0 = all processors */
    /* Of clouds that are read part by part: only points that its crop and where leave; NULL = all.  Borrowed. */
    const struct params *select;
    /* And a folder for what of them can't be read where it lies: compressed files.  NULL: these aren't read so. */
    const char *scratch;
    /* Formats of scanners have CLOUD_SCAN of one scan, too: others follow. */
    bool numbers_scans;
};

struct cloud_las;

struct cloud {
    size_t count;
    vec3 *position; /* count; owned */

    size_t property_count;
    struct property *property; /* property_count; owned */
    size_t record_bytes;       /* packed, no padding */
    unsigned char *record;     /* count * record_bytes; owned */
    uint32_t xyz[3];           /* which properties are x, y, z */

    size_t triangle_count;   /* the file's own faces, as fans of triangles; 0 where it has none */
    uint32_t (*triangle)[3]; /* ids < count; owned; NULL where triangle_count is 0 */

    /* Where it was scanned from, in its own coordinates: 0 places = not told here; one = all of it; more = record i's
     * scalar property CLOUD_SCAN says from which. */
    size_t view_count;
    vec3 *view; /* owned */

    int up; /* which axis the file says is upwards: enum up of core/params.h; 0 = it doesn't */

    const char *form;      /* of the file's format, e.g. "ply/ascii" (core/io/formats.h); "arrays" of memory; static */
    char *comments;        /* comment and obj_info lines of the header, each ended by \n; NULL = none; owned */
    struct cloud_las *las; /* of what was LAS: core/io/formats/las_fields.h; NULL = it wasn't; owned */
    uint16_t (*colour)[3]; /* red, green, blue in 16 bits where the records have 8 of them now; NULL = they haven't;
                              owned */
    char *left_out;        /* what the file has and a cloud can't hold, each ended by \n; NULL = nothing; owned */
};

/* Which axis property j is, 0 to 2; -1 where it is none of x, y, z. */
static inline int cloud_axis_of(const struct cloud *cloud, size_t j) {
    for (int axis = 0; axis < 3; axis++)
        if (cloud->xyz[axis] == j) return axis;
    return -1;
}

/* Frees everything that the cloud owns and zeroes it.  Accepts a zeroed cloud. */
void cloud_done(struct cloud *cloud);

/* The position that a point of the cloud would have if p were written to its coordinates: rounded to their types. */
vec3 cloud_round(const struct cloud *cloud, vec3 p);

/* How far apart neighbouring numbers are that its coordinates can hold, in its units: the widest of those axes that are
 * float32, far from 0.  An axis doesn't count whose coordinates hardly use every second of these numbers, as those of a
 * grid that float32 holds exactly.  Looks at some of the points, in O(1). */
double cloud_rounding_step(const struct cloud *cloud);

/* Moves every point: position has cloud->count of them.  Coordinates are rounded to their types. */
void cloud_move(struct cloud *cloud, const vec3 *position);

#endif
