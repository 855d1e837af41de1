/* Cyclic redundancy checks.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/codec/crc32.h"

#include "core/base/endian.h"

void crc32_init(struct crc32 *crc, uint32_t polynomial) {
    uint32_t(*table)[256] = crc->table;
    for (uint32_t b = 0; b < 256; b++) {
        uint32_t c = b;
        for (int i = 0; i < 8; i++) c = c >> 1 ^ (c & 1 ? polynomial : 0);
        table[0][b] = c;
    }
    for (uint32_t b = 0; b < 256; b++)
        for (int k = 1; k < CRC32_TABLES; k++) table[k][b] = table[k - 1][b] >> 8 ^ table[0][table[k - 1][b] & 0xff];
}

/* Eight bytes at a time (Kounavis, Berry 2005). */
uint32_t crc32_of(const struct crc32 *crc, const unsigned char *p, size_t n) {
    const uint32_t(*table)[256] = crc->table;
    uint32_t c = UINT32_MAX;
    for (; n >= CRC32_TABLES; n -= CRC32_TABLES, p += CRC32_TABLES) {
        uint64_t v = load_little_endian(p, 8) ^ c;
        c = 0;
        for (int k = 0; k < CRC32_TABLES; k++) c ^= table[CRC32_TABLES - 1 - k][v >> 8 * k & 0xff];
    }
    for (; n; n--, p++) c = c >> 8 ^ table[0][(c ^ *p) & 0xff];
    return ~c;
}
