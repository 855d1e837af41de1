/* Points of LAS for tests of LAZ: a flight line of returns, whose every field changes now and then, seldom or by much,
 * so that all branches of the code are met.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_TOOLS_LAZ_POINTS_H
#define WHITTLE_TESTS_TOOLS_LAZ_POINTS_H

#include <assert.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/io/laz/items.h"

enum { LAZ_POINTS_FORMATS = 11 };
static const size_t laz_points_bytes[LAZ_POINTS_FORMATS] = {20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67};

static inline uint64_t laz_points_next(uint64_t *state) {
    *state ^= *state << 13, *state ^= *state >> 7, *state ^= *state << 17;
    return *state;
}

/* Whether something happens that does so once in n times. */
static inline bool laz_points_one_in(uint64_t *state, unsigned n) { return laz_points_next(state) % n == 0; }

static inline void laz_points_step(unsigned format, size_t bytes, uint64_t *s, const unsigned char *last,
                                   unsigned char *record) {
    memcpy(record, last, bytes);
    for (size_t axis = 0; axis < 3; axis++) {
        uint32_t step = (uint32_t)(laz_points_next(s) % 200) - 100;
        if (laz_points_one_in(s, 50)) step = (uint32_t)laz_points_next(s) >> laz_points_next(s) % 32;
        laz_store32(record + 4 * axis, laz_load32(record + 4 * axis) + step);
    }
    if (laz_points_one_in(s, 2)) laz_store16(record + 12, (uint32_t)laz_points_next(s) % 300);
    size_t time = format >= 6 ? 22 : 20, user = 17, source = format >= 6 ? 20 : 18, class = format >= 6 ? 16 : 15;
    if (laz_points_one_in(s, 2)) record[14] = (unsigned char)laz_points_next(s);
    if (format >= 6 && laz_points_one_in(s, 9)) record[15] = (unsigned char)laz_points_next(s);
    if (format >= 6 && laz_points_one_in(s, 40)) laz_store16(record + 18, (uint32_t)laz_points_next(s));
    if (format < 6 && laz_points_one_in(s, 9)) record[16] = (unsigned char)(record[16] + 1);
    if (laz_points_one_in(s, 7)) record[class] = (unsigned char)laz_points_next(s);
    if (laz_points_one_in(s, 99)) record[user] = (unsigned char)laz_points_next(s);
    if (laz_points_one_in(s, 99)) laz_store16(record + source, (uint32_t)laz_points_next(s));
    bool has_time = format >= 6 || format == 1 || format >= 3;
    if (has_time && laz_points_one_in(s, 2)) {
        uint64_t bits = laz_load64(record + time);
        bits += laz_points_one_in(s, 20)   ? laz_points_next(s) % 100000
                : laz_points_one_in(s, 90) ? laz_points_next(s) >> laz_points_next(s) % 40
                                           : 1000;
        if (laz_points_one_in(s, 30)) bits -= 7000;
        laz_store64(record + time, bits);
    }
    for (size_t i = time + (has_time ? 8 : 0); i < bytes; i++)
        if (laz_points_one_in(s, 3))
            record[i] =
                (unsigned char)(laz_points_one_in(s, 5) ? laz_points_next(s) : record[i] + laz_points_next(s) % 3);
    bool has_wave = format == 4 || format == 5 || format >= 9;
    if (has_wave) { /* packets one behind the other, most often */
        size_t at = laz_points_bytes[format] - LAZ_WAVE_BYTES;
        uint64_t offset = laz_load64(last + at + 1);
        memcpy(record + at + 9, last + at + 9, 4);
        if (!laz_points_one_in(s, 4))
            offset += laz_points_one_in(s, 9) ? laz_points_next(s) % 9999 : laz_load32(last + at + 9);
        if (laz_points_one_in(s, 50)) offset = laz_points_next(s) >> 12; /* a double holds it */
        if (laz_points_one_in(s, 20)) laz_store32(record + at + 9, (uint32_t)laz_points_next(s) % 500);
        laz_store64(record + at + 1, offset);
    }
}

/* n records of so many bytes; for free(). */
static inline unsigned char *laz_points_make(unsigned format, size_t bytes, size_t n, uint64_t seed) {
    unsigned char *records = calloc(n + 1, bytes);
    assert(records);
    if (format >= 6 || format == 1 || format >= 3)
        laz_store64(records + (format >= 6 ? 22 : 20), UINT64_C(0x41b0000000000000)); /* 2^28 s */
    for (size_t i = 1; i < n; i++)
        laz_points_step(format, bytes, &seed, records + (i - 1) * bytes, records + i * bytes);
    return records;
}

#endif
