/* Cyclic redundancy checks of 32 bits, of any polynomial.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_CODEC_CRC32_H
#define WHITTLE_CORE_IO_CODEC_CRC32_H

#include <stddef.h>
#include <stdint.h>

/* Polynomials, their bits reversed. */
#define CRC32_CASTAGNOLI UINT32_C(0x82F63B78)
#define CRC32_IEEE UINT32_C(0xEDB88320) /* of Ethernet, gzip and zip */

enum { CRC32_TABLES = 8 };

/* table[k][b]: what byte b does to the remainder k bytes later.  8 KiB. */
struct crc32 {
    uint32_t table[CRC32_TABLES][256];
};

void crc32_init(struct crc32 *crc, uint32_t polynomial);

/* Of n bytes, begun with ones and turned round at the end, as usual. */
uint32_t crc32_of(const struct crc32 *crc, const unsigned char *bytes, size_t n);

#endif
