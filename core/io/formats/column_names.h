/* Names of columns that text files have, and what they mean.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_COLUMN_NAMES_H
#define WHITTLE_CORE_IO_FORMATS_COLUMN_NAMES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/cloud/cloud.h"
#include "core/io/text_scanner.h"

/* The names on a line. */
struct column_names {
    size_t count;                                /* may be more than are kept */
    struct scan_word name[CLOUD_MAX_PROPERTIES]; /* without quotes; in the line */
    const char *meaning[CLOUD_MAX_PROPERTIES];   /* "x", "y", "z", "red", "green", "blue", "alpha", "nx", "ny", "nz";
                                                    NULL: no more than the name says */
    bool has_xyz;                                /* x, y and z are among the meanings */
    bool is_geographic;                          /* x is a longitude and y a latitude */
};

/* Splits the line at .. its end or `end`: by commas, where there are any, else by semicolons, tabs, or blanks.  Among
 * blanks, what stands in brackets is the unit of the name before it.
 *
 * Then tells the meanings, whatever the case, with a unit in brackets or behind "_" or without one: x y z, x_coord,
 * easting northing height, lon lat alt, e n h and the like; r g b, Red Green Blue; nx, normal_x.  x and y are of one
 * kind; where there are several, the first of these.  Colours and normals are all three there, or none is. */
void column_names_split(const char *at, const char *end, struct column_names *names);

/* Which of the kept names is this one: as it is, else whatever its case.  names->count: none. */
size_t column_names_find(const struct column_names *names, const char *text, size_t n);

#endif
