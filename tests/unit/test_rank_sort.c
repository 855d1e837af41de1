/* Sorting of a few ids, against the C library's.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/cloud/cloud.h"
#include "core/simplify/rank_sort.h"
#include "tests/unit/shapes.h"

enum { MOST = 150 };

static int compare(const void *a, const void *b) {
    uint32_t i = *(const uint32_t *)a, j = *(const uint32_t *)b;
    return (i > j) - (i < j);
}

static unsigned expected_of(uint32_t *id, unsigned n) {
    unsigned count = 0;
    qsort(id, n, sizeof *id, compare);
    for (unsigned i = 0; i < n; i++)
        if (id[i] != NONE && (count == 0 || id[i] != id[count - 1])) id[count++] = id[i];
    return count;
}

/* From few different ids to hardly any repetition, in lists of every length. */
static void ids_are_sorted_and_single(void **state) {
    (void)state;
    const uint32_t ranges[] = {1, 7, 50, INT32_MAX};
    uint64_t seed = 4;
    for (unsigned n = 0; n <= MOST; n++)
        for (size_t r = 0; r < 4; r++) {
            uint32_t id[MOST] = {0}, expected[MOST];
            for (unsigned i = 0; i < n; i++)
                id[i] = random_next(&seed) % 9 ? (uint32_t)(random_next(&seed) % ranges[r]) : NONE;
            memcpy(expected, id, sizeof id);
            unsigned count = expected_of(expected, n);
            assert_int_equal(rank_sort_ids(id, n), count);
            assert_memory_equal(id, expected, count * sizeof *id);
        }
}

static void the_largest_id_is_kept(void **state) {
    (void)state;
    uint32_t id[] = {INT32_MAX, 0, INT32_MAX, NONE, 5};
    const uint32_t expected[] = {0, 5, INT32_MAX};
    assert_int_equal(rank_sort_ids(id, 5), 3);
    assert_memory_equal(id, expected, sizeof expected);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ids_are_sorted_and_single),
        cmocka_unit_test(the_largest_id_is_kept),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
