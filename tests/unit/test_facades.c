/* Walls that were seen from above, beside strays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "core/clean/facades.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { SIDE = 60, WALL = 40, STRAYS = 40, N = SIDE * SIDE + WALL + STRAYS };

struct city {
    vec3 point[N];
    uint8_t outlier[N];
};

static size_t count(const uint8_t *outlier, size_t begin, size_t end) {
    size_t marked = 0;
    for (size_t p = begin; p < end; p++) marked += outlier[p];
    return marked;
}

/* A block, 20 high, on the ground, seen from above; some points of one of its walls, and strays over the ground beside
 * it and below: all of these are marked. */
static struct city a_city(void) {
    static struct city city;
    size_t n = 0;
    uint64_t random = 5;
    memset(&city, 0, sizeof city);
    for (int i = 0; i < SIDE * SIDE; i++) {
        double x = i % SIDE, y = i / SIDE;
        bool on_roof = x >= 20 && x < 40 && y >= 20 && y < 40;
        city.point[n++] = (vec3){x, y, (on_roof ? 20 : 0) + .1 * random_unit(&random)};
    }
    for (int i = 0; i < WALL; i++) city.point[n++] = (vec3){19.5, 20 + i / 2. + .1, 2 + 16 * random_unit(&random)};
    for (int i = 0; i < STRAYS; i++)
        city.point[n++] = (vec3){3 + 10 * random_unit(&random), 60 * random_unit(&random),
                                 i % 2 ? -4 - random_unit(&random) : 3 + 15 * random_unit(&random)};
    memset(&city.outlier[SIDE * SIDE], 1, WALL + STRAYS);
    return city;
}

static size_t spared_of(struct city *city, unsigned threads) {
    size_t spared;
    assert_int_equal(facades_spare(city->point, N, threads, city->outlier, &spared), STATUS_OK);
    return spared;
}

static void walls_are_spared_and_strays_are_not(void **state) {
    (void)state;
    struct city city = a_city();
    assert_int_equal(spared_of(&city, 1), WALL);
    assert_int_equal(count(city.outlier, SIDE * SIDE, SIDE * SIDE + WALL), 0);
    assert_int_equal(count(city.outlier, SIDE * SIDE + WALL, N), STRAYS);
    struct city same = a_city();
    assert_int_equal(spared_of(&same, 3), WALL);
    assert_memory_equal(same.outlier, city.outlier, sizeof city.outlier);
}

/* Where most points lie over others, what is between them may be anything. */
static void nothing_is_spared_in_a_room(void **state) {
    (void)state;
    struct city city = a_city();
    for (size_t p = 0; p < SIDE * SIDE; p += 2) city.point[p].z = 40;
    assert_int_equal(spared_of(&city, 1), 0);
    assert_int_equal(count(city.outlier, 0, N), WALL + STRAYS);
}

static void without_outliers_nothing_is_done(void **state) {
    (void)state;
    struct city city = a_city();
    memset(city.outlier, 0, sizeof city.outlier);
    assert_int_equal(spared_of(&city, 1), 0);
    memset(city.outlier, 1, sizeof city.outlier); /* nor where all are */
    assert_int_equal(spared_of(&city, 1), 0);
    assert_int_equal(count(city.outlier, 0, N), N);
}

static void sparing_needs_memory(void **state) {
    (void)state;
    long failed = 0;
    size_t spared;
    for (bool happened = true; happened; failed += happened) {
        struct city city = a_city();
        faults_in_memory(failed + 1, false);
        enum status status = facades_spare(city.point, N, 1, city.outlier, &spared);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_true(failed > 4);
    assert_int_equal(spared, WALL);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(walls_are_spared_and_strays_are_not),
        cmocka_unit_test(nothing_is_spared_in_a_room),
        cmocka_unit_test(without_outliers_nothing_is_done),
        cmocka_unit_test(sparing_needs_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
