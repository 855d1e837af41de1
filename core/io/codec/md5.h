/* MD5 (RFC 1321), for formats that name things by it; it keeps no secret.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_CODEC_MD5_H
#define WHITTLE_CORE_IO_CODEC_MD5_H

#include <stddef.h>

enum { MD5_BYTES = 16, MD5_MOST = 247 };

/* Of n <= MD5_MOST bytes. */
void md5_short(const void *bytes, size_t n, unsigned char digest[MD5_BYTES]);

#endif
