/* Sorting by radix: what a plain sort says, stable, for any number of threads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/radix.h"
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

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(few_and_many_items_are_sorted),
        cmocka_unit_test(any_number_of_threads_sorts_the_same),
        cmocka_unit_test(equal_keys_and_equal_digits_stay_in_order),
    };
    return cmocka_run_group_tests_name("radix", tests, NULL, NULL);
}
