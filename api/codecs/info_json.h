/* What `whittle info` found out, as JSON.
 *
 *     {"format": "ply/ascii", "points": 48485, "points_distinct": 48485, "triangles": 0,
 *      "box": {"min": [...], "max": [...]}, "diagonal": 1.23, "attributes": [{"name": "x", "type": "float"}, ...],
 *      "coordinate_system": "EPSG:25832", "spacing": 0.004, "noise": 0.0001, "noise_rel": ...,
 *      "surface": {"kind": "closed", "reason": "...", "sure": true}, "left_out": ["..."]}
 *
 * What isn't known is absent.  Lengths are in the file's units.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_INFO_JSON_H
#define WHITTLE_API_CODECS_INFO_JSON_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include "core/base/status.h"
#include "core/report.h"

struct cloud_info_attribute {
    const char *name, *type; /* as PLY has it */
    bool is_list;
};

/* All borrowed. */
struct cloud_info {
    const char *format;
    uint64_t points, distinct, triangles;
    double box_min[3], box_max[3], diagonal;
    size_t attribute_count;
    const struct cloud_info_attribute *attribute;
    const char *coordinate_system; /* "" = the file has none, or none that is known */
    double spacing;                /* median distance to the nearest other point; 0 = one point */
    double noise;                  /* standard deviation from the surface, as estimated; NAN = not known */
    const struct report_surface *surface;
    const char *left_out; /* lines; NULL = nothing */
};

/* Writes it indented, with a newline at the end.  STATUS_IO, STATUS_NO_MEMORY. */
enum status info_json_write(FILE *to, const struct cloud_info *info) MUST_CHECK;

#endif
