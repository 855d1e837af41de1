/* An id's place is how many are below it: n^2 comparisons, some at a time (math/simd.h), and no branch that depends on
 * them, which insertion would guess wrong half of the time.
 *
 * Equal ids get the same place and leave the ones after it empty.  What is empty holds NONE, and is left out at the end
 * as NONE itself is; so nothing needs to look for repetitions.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/rank_sort.h"

#include <string.h>

#include "core/math/simd.h"

enum { EIGHT = 8, FEW = 64, EMPTY = -1 }; /* EMPTY is NONE, signed: comparisons of vectors are */
enum { PARTS = EIGHT / F32_LANES };

/* Beyond n, `from` holds numbers that are above all. */
INLINE void place_all(const int32_t *from, unsigned n, int32_t *to) {
    for (unsigned i = 0; i < n; i += EIGHT) {
        i32v x[PARTS], place[PARTS];
        for (unsigned k = 0; k < PARTS; k++) x[k] = i32_load(&from[i + k * F32_LANES]), place[k] = i32_all(0);
        for (unsigned j = 0; j < n; j++)
            for (unsigned k = 0; k < PARTS; k++) place[k] -= i32_less(i32_all(from[j]), x[k]);
        for (unsigned k = 0; k < EIGHT; k++)
            to[SIMD_LANE(place[k / F32_LANES], k % F32_LANES)] = SIMD_LANE(x[k / F32_LANES], k % F32_LANES);
    }
}

INLINE unsigned sort_few(uint32_t *id, unsigned n) {
    int32_t from[FEW + EIGHT], to[FEW + 1];
    unsigned count = 0;
    memcpy(from, id, n * sizeof *id);
    for (unsigned i = 0; i < EIGHT; i++) from[n + i] = INT32_MAX;
    for (unsigned i = 0; i < n; i++) to[i] = EMPTY;
    place_all(from, n, to);
    for (unsigned i = 0; i < n; i++) {
        id[count] = (uint32_t)to[i];
        count += to[i] != EMPTY;
    }
    return count;
}

static unsigned sort_many(uint32_t *id, unsigned n) {
    unsigned count = 0;
    for (unsigned i = 0; i < n; i++) {
        uint32_t x = id[i];
        unsigned j = count;
        while (j > 0 && id[j - 1] > x) j--;
        if (x == (uint32_t)EMPTY || (j > 0 && id[j - 1] == x)) continue;
        memmove(&id[j + 1], &id[j], (count++ - j) * sizeof *id);
        id[j] = x;
    }
    return count;
}

FOR_EACH_PROCESSOR(unsigned, rank_sort_ids)
(uint32_t *id, unsigned n) { return n <= FEW ? sort_few(id, n) : sort_many(id, n); }
