/* Colours of 8 or 16 bits, for the programs that a cloud is written for.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_COLOUR_DEPTH_H
#define WHITTLE_CORE_CLOUD_COLOUR_DEPTH_H

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/params.h"

/* Makes red, green, blue and alpha uint8 or uint16, whatever the input has them as: floats up to 1, numbers up to 255,
 * or up to 65535.  16 bits become 8 by the upper half, 8 become 16 times 257, so 8 bits survive the way to 16 and back.
 * Where other numbers are among them, or with COLOURS_KEEP, nothing changes.  What isn't exact is noted in left_out
 * (may be NULL).  STATUS_NO_MEMORY.  O(points), in place but for the way from 8 to 16 bits. */
enum status cloud_set_colours(struct cloud *cloud, enum colour_bits bits, struct left_out *left_out,
                              struct error *error) MUST_CHECK;

#endif
