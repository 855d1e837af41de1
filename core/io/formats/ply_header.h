/* The header of a PLY file: what is promised, and whether the bytes that are there can hold it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_PLY_HEADER_H
#define WHITTLE_CORE_IO_FORMATS_PLY_HEADER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/cloud/cloud.h"

enum {
    PLY_HEADER_MAX_BYTES = 64 * 1024,   /* up to and with end_header's line */
    PLY_COMMENTS_MAX_BYTES = 32 * 1024, /* lines beyond are left out, so that what we write has room in its header */
    PLY_MAX_ELEMENTS = 64               /* each with up to CLOUD_MAX_PROPERTIES properties */
};

enum ply_form { PLY_ASCII, PLY_LITTLE_ENDIAN, PLY_BIG_ENDIAN };

/* "ply/ascii", "ply/binary_little_endian", "ply/binary_big_endian". */
const char *ply_form_name(enum ply_form form);

struct ply_element {
    char name[PROPERTY_NAME_BYTES];
    uint64_t count;
    size_t first, property_count; /* its properties are property[first .. first + property_count - 1] */
};

struct ply_header {
    enum ply_form form;
    size_t bytes;   /* of the header: the body begins here */
    uint64_t lines; /* of the header: the body begins on line lines + 1 */
    size_t element_count;
    struct ply_element element[PLY_MAX_ELEMENTS];
    size_t property_count;
    struct property *property; /* of all elements; offset_bytes packed within the element; owned */
    size_t vertex;             /* which element is vertex */
    uint32_t xyz[3];           /* which of the vertex element's properties */
    char *comments;            /* comment and obj_info lines, each ended by \n; NULL = none; owned */
};

/* Parses the header at the start of the n bytes.  STATUS_MALFORMED or STATUS_LIMIT with the line, STATUS_UNSUPPORTED
 * for another version, STATUS_NO_MEMORY.  *header is untouched on failure, else the caller's, for ply_header_done. */
enum status ply_header_parse(const void *bytes, size_t n, struct ply_header *header, struct error *error) MUST_CHECK;

/* Frees what the header owns and zeroes it.  Accepts a zeroed header. */
void ply_header_done(struct ply_header *header);

/* The fewest bytes that a whole file with this header can have, UINT64_MAX on overflow; *exact tells that it counts
 * no more either (binary without lists). */
uint64_t ply_header_file_bytes(const struct ply_header *header, bool *exact);

/* STATUS_MALFORMED with expected and actual bytes when a file of total_bytes is too short for this header. */
enum status ply_header_fits(const struct ply_header *header, uint64_t total_bytes, struct error *error) MUST_CHECK;

/* What somebody who doesn't read the cloud wants to know. */
struct ply_summary {
    bool complete; /* false: end_header isn't among the bytes given, more are needed, nothing below is set */
    enum ply_form form;
    uint64_t vertex_count, face_count;
    uint64_t triangles_most; /* that faces of many corners can become, by the bytes there are for corners */
    size_t property_count;   /* of a vertex */
    size_t record_bytes;     /* of a vertex's scalars in memory */
    size_t header_bytes;
    uint64_t bytes_expected; /* of the whole file, at least */
    bool bytes_exact;        /* the header counts no more than bytes_expected */
};

/* Checks the header in the first n bytes of a file, for one who has only those: total_bytes is the file's length, or
 * UINT64_MAX where it isn't known.  STATUS_OK with summary->complete false asks for more bytes (never once n reaches
 * total_bytes or PLY_HEADER_MAX_BYTES).  Statuses as ply_header_parse and ply_header_fits.  O(header). */
enum status ply_header_check(const void *first_bytes, size_t n, uint64_t total_bytes, struct ply_summary *summary,
                             struct error *error) MUST_CHECK;

#endif
