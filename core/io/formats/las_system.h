/* The coordinate system that a LAS file names, in any of its compressions: it stands before the points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_LAS_SYSTEM_H
#define WHITTLE_CORE_IO_FORMATS_LAS_SYSTEM_H

#include <stdbool.h>
#include <stddef.h>

#include "core/cloud/cloud.h"

/* Writes "EPSG:25832", or the name that its text has where there is no number.  The file (regular, open for reading,
 * read from its begin; where it stands isn't changed) may be of any format: false, and text = "", where it is none of
 * LAS or names no system.  Reads the header and the variable length records alone. */
bool las_coordinate_system(int fd, char *text, size_t text_bytes);

/* The same of a cloud that was LAS.  O(bytes of its records). */
bool las_records_system(const struct cloud_las *las, char *text, size_t text_bytes);

#endif
