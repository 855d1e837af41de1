/* The header of a PCD file.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_PCD_HEADER_H
#define WHITTLE_CORE_IO_FORMATS_PCD_HEADER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/cloud/cloud.h"

/* A comment "origin X Y Z" with this behind it tells the origin. */
#define PCD_ORIGIN_MARK "is to be added to x y z"

enum pcd_data { PCD_ASCII, PCD_BINARY, PCD_COMPRESSED };

/* A field as the file has it: count scalars of `bytes` bytes each. */
struct pcd_field {
    char name[PROPERTY_NAME_BYTES];
    unsigned bytes; /* 1, 2, 4 or 8 */
    char kind;      /* 'I', 'U' or 'F' */
    uint32_t count; /* at least 1 */
};

struct pcd_header {
    enum pcd_data data;
    size_t field_count;
    struct pcd_field field[CLOUD_MAX_PROPERTIES];
    size_t record_bytes; /* of a point in binary */
    uint64_t points;
    size_t bytes;        /* of the header: the points begin here */
    uint64_t lines;      /* of the header: the points begin on line lines + 1 */
    double origin[3];    /* to be added to x, y, z, as a comment of ours tells; 0 0 0 where none does */
    double viewpoint[7]; /* translation and quaternion; 0 0 0 1 0 0 0 where it isn't told */
};

/* Whether a line of n bytes is that comment, which then tells the origin. */
bool pcd_header_origin(const char *line, size_t n, double origin[3]);

/* Parses the header at the start of the n bytes.  STATUS_MALFORMED or STATUS_LIMIT with the line.  *header is untouched
 * on failure. */
enum status pcd_header_parse(const void *bytes, size_t n, struct pcd_header *header, struct error *error) MUST_CHECK;

/* No byte of LZF becomes more than this. */
enum { PCD_LZF_MOST = 265 };

/* Whether a file of so many bytes, the header's among them, can hold the points that it promises; of UINT64_MAX bytes
 * nobody knows.  A reader finds more that is wrong, and says what. */
bool pcd_header_fits(const struct pcd_header *header, uint64_t total_bytes);

#endif
