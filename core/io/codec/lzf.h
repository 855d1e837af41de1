/* Decompression of LZF, the scheme that PCD's binary_compressed uses.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_CODEC_LZF_H
#define WHITTLE_CORE_IO_CODEC_LZF_H

#include <stdbool.h>
#include <stddef.h>

/* Decompresses the n bytes at `packed` to exactly `bytes` bytes at `to`.  False: they don't become that many, or break
 * the format; what `to` holds then is of no use.  O(bytes). */
bool lzf_decompress(const void *packed, size_t n, void *to, size_t bytes);

#endif
