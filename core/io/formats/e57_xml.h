/* What the XML of an E57 file says of its scans.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_E57_XML_H
#define WHITTLE_CORE_IO_FORMATS_E57_XML_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/io/formats/e57_pages.h"

enum { E57_NAME_BYTES = 64 };

enum e57_type { E57_INTEGER, E57_SCALED, E57_FLOAT, E57_DOUBLE, E57_OTHER /* text, and what else there may be */ };

/* One field of a scan's records. */
struct e57_field {
    char name[E57_NAME_BYTES]; /* with its prefix; cut where it is longer */
    enum e57_type type;
    int64_t minimum, maximum; /* of integers, scaled or not */
    double scale, offset;     /* of scaled ones */
};

struct e57_scan {
    uint64_t file_offset, records; /* physical; 0 where there are none */
    size_t field_count;
    struct e57_field *field; /* owned */
    bool has_pose;
    double rotation[4], translation[3]; /* w x y z; x y z */
};

struct e57_description {
    size_t scan_count;
    struct e57_scan *scan; /* owned */
    bool has_images;
};

/* Parses `bytes` logical bytes of XML from a logical offset.  Entities of its own are refused, and what is nested too
 * deep.  Memory is linear in the text.  STATUS_MALFORMED, with what is wrong and the line of the XML; STATUS_NO_MEMORY.
 */
enum status e57_xml_parse(const struct e57_pages *pages, uint64_t logical, uint64_t bytes,
                          struct e57_description *description, struct error *error) MUST_CHECK;

/* Accepts a zeroed description. */
void e57_description_done(struct e57_description *description);

#endif
