/* Compression of glTF's buffer views: EXT_meshopt_compression (Khronos Group, 2021), modes ATTRIBUTES and INDICES.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_MESHOPT_H
#define WHITTLE_CORE_IO_OUT_MESHOPT_H

#include <stddef.h>
#include <stdint.h>

#include "core/io/out/sink.h"

enum { MESHOPT_MOST_STRIDE = 256 };

/* Puts n elements of `stride` bytes each, a multiple of 4 and at most MESHOPT_MOST_STRIDE.  Each byte of an element is
 * written as its difference from the same byte of the element before it, so neighbours should be alike.  O(n). */
void meshopt_put_attributes(struct sink *sink, const unsigned char *element, size_t n, size_t stride);

/* Puts n indices below 2^30 in their order.  O(n). */
void meshopt_put_indices(struct sink *sink, const uint32_t *index, size_t n);

#endif
