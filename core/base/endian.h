/* Whole numbers in files, little endian, at any address.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_ENDIAN_H
#define WHITTLE_CORE_BASE_ENDIAN_H

#include <stddef.h>
#include <stdint.h>

/* The number in the next bytes, of which there are 1 to 8. */
static inline uint64_t load_little_endian(const unsigned char *p, size_t bytes) {
    uint64_t value = 0;
    for (size_t i = bytes; i-- > 0;) value = value << 8 | p[i];
    return value;
}

/* Puts the number into the next bytes. */
static inline uint64_t load_big_endian(const unsigned char *p, size_t bytes) {
    uint64_t value = 0;
    for (size_t i = 0; i < bytes; i++) value = value << 8 | p[i];
    return value;
}

static inline void store_little_endian(unsigned char *p, uint64_t value, size_t bytes) {
    for (size_t i = 0; i < bytes; i++) p[i] = (unsigned char)(value >> 8 * i);
}

#endif
