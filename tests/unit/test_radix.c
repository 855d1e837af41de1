/* Sorting by radix: what a plain sort says, stable, for any number of threads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/radix.h"
#include "tests/unit/shapes.h"

static int compare_items(const void *a, const void *b) {
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

/* The values are the places, so that a stable order by key is the order of the whole items. */
static void sorts(size_t n, uint32_t mask, unsigned threads) {
    uint64_t *item = malloc((n + 1) * sizeof *item), *spare = malloc((n + 1) * sizeof *spare);
    uint64_t *wanted = malloc((n + 1) * sizeof *wanted), random = n;
    for (size_t i = 0; i < n; i++) item[i] = wanted[i] = radix_item((uint32_t)random_next(&random) & mask, (uint32_t)i);
    qsort(wanted, n, sizeof *wanted, compare_items);
    uint64_t *sorted = radix_sort(item, spare, n, threads);
    assert_true(sorted == item || sorted == spare);
    assert_memory_equal(sorted, wanted, n * sizeof *wanted);
    free(item), free(spare), free(wanted);
}

static void few_and_many_items_are_sorted(void **state) {
    (void)state;
    for (size_t n = 0; n < 5; n++) sorts(n, UINT32_MAX, 1);
    sorts(1000, UINT32_MAX, 1);
    sorts(200001, UINT32_MAX, 1);
}

static void any_number_of_threads_sorts_the_same(void **state) {
    (void)state;
    for (unsigned threads = 0; threads <= 20; threads += 5) sorts(300007, UINT32_MAX, threads);
}

static void equal_keys_and_equal_digits_stay_in_order(void **state) {
    (void)state;
    const uint32_t masks[] = {0, 1, 0x7ff, 0x800, 0x3ff800, 0x80000000};
    for (size_t i = 0; i < sizeof masks / sizeof masks[0]; i++) sorts(100000, masks[i], 3);
}

/* What is kept is what a sort would put first, in its old order. */
static void keeps_lowest(size_t n, uint32_t mask, size_t count) {
    uint64_t *item = malloc((n + 1) * sizeof *item), *spare = malloc((n + 1) * sizeof *spare);
    uint64_t *sorted = malloc((n + 1) * sizeof *sorted), random = n + count;
    for (size_t i = 0; i < n; i++) item[i] = sorted[i] = radix_item((uint32_t)random_next(&random) & mask, (uint32_t)i);
    qsort(sorted, n, sizeof *sorted, compare_items);
    size_t kept = radix_keep_lowest(item, spare, n, count), wanted = count < n ? count : n;
    assert_int_equal(kept, wanted);
    for (size_t i = 1; i < kept; i++) assert_true(radix_value(item[i - 1]) < radix_value(item[i]));
    qsort(item, kept, sizeof *item, compare_items);
    assert_memory_equal(item, sorted, kept * sizeof *item);
    free(item), free(spare), free(sorted);
}

static void the_lowest_are_kept_in_the_order_that_they_come_in(void **state) {
    (void)state;
    const uint32_t masks[] = {0, 1, 0x7ff, 0x3ff800, 0x80000000, UINT32_MAX};
    for (size_t i = 0; i < sizeof masks / sizeof masks[0]; i++)
        for (size_t count = 0; count < 5000; count += 1 + count / 2) keeps_lowest(4000, masks[i], count);
    for (size_t n = 0; n < 3; n++) keeps_lowest(n, UINT32_MAX, 1);
}

static void keys_of_signed_numbers_are_in_their_order(void **state) {
    (void)state;
    const double rising[] = {-INFINITY, -1e30, -2, -1, -1e-30, 0, 1e-30, 1, 1.5, 1e30, INFINITY};
    for (size_t i = 1; i < sizeof rising / sizeof rising[0]; i++)
        assert_true(radix_key_of_signed(rising[i - 1]) < radix_key_of_signed(rising[i]));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(few_and_many_items_are_sorted),
        cmocka_unit_test(any_number_of_threads_sorts_the_same),
        cmocka_unit_test(equal_keys_and_equal_digits_stay_in_order),
        cmocka_unit_test(the_lowest_are_kept_in_the_order_that_they_come_in),
        cmocka_unit_test(keys_of_signed_numbers_are_in_their_order),
    };
    return cmocka_run_group_tests_name("radix", tests, NULL, NULL);
}
