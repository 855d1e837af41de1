/* What a LAS file says of all its points together, and where in a point each property lies: for whoever writes LAS of a
 * cloud that was LAS.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_LAS_FIELDS_H
#define WHITTLE_CORE_IO_FORMATS_LAS_FIELDS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/cloud/cloud.h"

enum {
    LAS_FORMATS = 11,
    LAS_FIELDS = 32, /* of a format, at most */
    LAS_OLD_HEADER_BYTES = 227,
    LAS_HEADER_BYTES = 375, /* of 1.4 */
    LAS_VLR_BYTES = 54,
    LAS_EXTRA_BYTES = 192, /* a description of extra bytes */
    LAS_LAZ_BIT = 0x80
};

/* What stands in a file; the first eight are enum scalar_type. */
enum { LAS_U64 = SCALAR_TYPE_COUNT, LAS_I64 };

struct las_field {
    char name[PROPERTY_NAME_BYTES];
    unsigned type;        /* enum scalar_type, LAS_U64 or LAS_I64 */
    size_t offset;        /* in the file's record */
    unsigned shift, bits; /* bits 0: the whole scalar */
    bool scaled;
    double scale, add;
};

/* One piece of memory, which a cloud owns (cloud.las). */
struct cloud_las {
    unsigned minor, format, source, encoding; /* of the header */
    size_t record_bytes;
    bool has_crs; /* among the records */
    size_t field_count;
    struct las_field field[CLOUD_MAX_PROPERTIES];
    uint32_t record_count; /* variable length records that go on: coordinate system, extra bytes, classes, text */
    size_t records_bytes;
    unsigned char records[]; /* as they stand in the file */
};

/* Bytes of a point of each format, without extra bytes. */
extern const size_t las_format_bytes[LAS_FORMATS];

/* What a header says of the points before any is read; of LAZ, too. */
struct las_summary {
    unsigned format;
    uint64_t points; /* promised: a file that is cut short has fewer */
    bool has_box;
    double min[3], max[3];
};

/* false where the first n bytes are no header of a LAS file that is read. */
bool las_summary_of(const void *bytes, size_t n, struct las_summary *summary);

/* Fills field with those that points of this format have after x, y, z, and returns how many. */
size_t las_format_fields(unsigned format, struct las_field field[LAS_FIELDS]);

/* ---- las_system.c: the coordinate system that a LAS file names, in any of its compressions, before its points ---- */

/* Writes "EPSG:25832", or the name that its text has where there is no number.  The file (regular, open for reading,
 * read from its begin; where it stands isn't changed) may be of any format: false, and text = "", where it is none of
 * LAS or names no system.  Reads the header and the variable length records alone. */
bool las_coordinate_system(int fd, char *text, size_t text_bytes);

/* The same of a cloud that was LAS.  O(bytes of its records). */
bool las_records_system(const struct cloud_las *las, char *text, size_t text_bytes);

/* Whether the records name a coordinate system by a directory of GeoTIFF keys, and not as text. */
bool las_system_is_keys(const struct cloud_las *las);

#endif
