/* An id's place is how many are below it: n^2 comparisons, eight at a time, and no branch that depends on them, which
 * insertion would guess wrong half of the time.
 *
 * Equal ids get the same place and leave the ones after it empty.  What is empty holds NONE, and is left out at the end
 * as NONE itself is; so nothing needs to look for repetitions.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/rank_sort.h"

#include <string.h>

#include "core/lanes.h"

enum { EIGHT = 8, FOUR = 4, FEW = 64, EMPTY = -1 }; /* EMPTY is NONE, signed: comparisons of vectors are */

typedef int32_t eight __attribute__((vector_size(32)));
typedef int32_t four __attribute__((vector_size(16)));

INLINE eight eight_at(const int32_t *p) {
    eight x;
    memcpy(&x, p, sizeof x);
    return x;
}

/* Beyond n, `from` holds numbers that are above all. */
INLINE void place_all(const int32_t *from, unsigned n, int32_t *to) {
    for (unsigned i = 0; i < n; i += EIGHT) {
        eight x = eight_at(&from[i]), place = {0};
        for (unsigned j = 0; j < n; j++) {
            int32_t y = from[j];
            place -= (eight){y, y, y, y, y, y, y, y} < x;
        }
        for (unsigned lane = 0; lane < EIGHT; lane++) to[place[lane]] = x[lane];
    }
}

/* The same with two vectors of four. */
INLINE void place_all_narrow(const int32_t *from, unsigned n, int32_t *to) {
    for (unsigned i = 0; i < n; i += EIGHT) {
        four low, high, low_place = {0}, high_place = {0};
        memcpy(&low, &from[i], sizeof low);
        memcpy(&high, &from[i + FOUR], sizeof high);
        for (unsigned j = 0; j < n; j++) {
            four other = {from[j], from[j], from[j], from[j]};
            low_place -= other < low;
            high_place -= other < high;
        }
        for (unsigned lane = 0; lane < FOUR; lane++) to[low_place[lane]] = low[lane];
        for (unsigned lane = 0; lane < FOUR; lane++) to[high_place[lane]] = high[lane];
    }
}

FOR_EACH_PROCESSOR
static unsigned sort_few(uint32_t *id, unsigned n) {
    int32_t from[FEW + EIGHT], to[FEW + 1];
    unsigned count = 0;
    memcpy(from, id, n * sizeof *id);
    for (unsigned i = 0; i < EIGHT; i++) from[n + i] = INT32_MAX;
    for (unsigned i = 0; i < n; i++) to[i] = EMPTY;
    if (processor_is_wide())
        place_all(from, n, to);
    else
        place_all_narrow(from, n, to);
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

unsigned rank_sort_ids(uint32_t *id, unsigned n) { return n <= FEW ? sort_few(id, n) : sort_many(id, n); }
