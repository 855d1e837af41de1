/* XYZ: round trips, limits, failing allocations; and numbers as text.  Single good and bad files are folders under
 * tests/fixtures.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/io/out/write.h"
#include "core/io/read.h"
#include "core/text/number.h"

enum { MANY = 5000, ROUNDS = 200000 };

static uint64_t next_random(uint64_t *state) {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    return *state ^= *state << 17;
}

static enum status read_text(const char *text, struct cloud *cloud) {
    struct error error = {0};
    *cloud = (struct cloud){0};
    return cloud_read_memory(text, strlen(text), NULL, NULL, cloud, &error);
}

/* The bytes of a cloud written as XYZ; to be freed. */
static char *written(const struct cloud *cloud, const uint32_t *ids, size_t n, enum xyz_header header) {
    FILE *file = tmpfile();
    assert_non_null(file);
    struct error error = {0};
    assert_int_equal(cloud_write_xyz(fileno(file), cloud, ids, n, header, &error), STATUS_OK);
    long size = (fseek(file, 0, SEEK_END), ftell(file));
    rewind(file);
    char *text = alloc_zeroed((size_t)size + 1, 1);
    assert_int_equal(fread(text, 1, (size_t)size, file), size);
    fclose(file);
    return text;
}

static void plain_points_come_out_as_plain_lines(void **state) {
    (void)state;
    struct cloud cloud;
    static const uint32_t ids[] = {1, 0};
    assert_int_equal(read_text("1.50 -0 1e3\n0.1\t2e-7\t1e30\n", &cloud), STATUS_OK);
    char *text = written(&cloud, ids, 2, HEADER_NONE);
    assert_string_equal(text, "0.1 2e-07 1e+30\n1.5 -0 1000\n");
    free(text);
    cloud_done(&cloud);
}

static void names_of_columns_survive_and_xyz_comes_first(void **state) {
    (void)state;
    struct cloud cloud, again;
    assert_int_equal(read_text("intensity z y x\n0.5 3 2 1\n0.25 6 5 4\n", &cloud), STATUS_OK);
    char *text = written(&cloud, NULL, 2, HEADER_HASH);
    assert_string_equal(text, "# x y z intensity\n1 2 3 0.5\n4 5 6 0.25\n");
    assert_int_equal(read_text(text, &again), STATUS_OK);
    assert_string_equal(again.property[3].name, "intensity");
    assert_memory_equal(again.position, cloud.position, 2 * sizeof *cloud.position);
    free(text);
    cloud_done(&cloud);
    cloud_done(&again);
}

static void each_header_is_read_back_with_its_names(void **state) {
    (void)state;
    static const char *const first[] = {
        [HEADER_NONE] = "1 2 3 7", [HEADER_PLAIN] = "x y z time\n1 2 3 7", [HEADER_HASH] = "# x y z time\n1 2 3 7"};
    for (int header = HEADER_NONE; header <= HEADER_HASH; header++) {
        struct cloud cloud, again;
        assert_int_equal(read_text("x,y,z,time\n1,2,3,7\n4,5,6,8\n", &cloud), STATUS_OK);
        char *text = written(&cloud, NULL, 2, (enum xyz_header)header);
        assert_memory_equal(text, first[header], strlen(first[header]));
        assert_int_equal(read_text(text, &again), STATUS_OK);
        assert_string_equal(again.property[3].name, header == HEADER_NONE ? "column4" : "time");
        assert_memory_equal(again.record, cloud.record, 2 * cloud.record_bytes);
        free(text);
        cloud_done(&cloud);
        cloud_done(&again);
    }
}

static void floats_of_a_ply_are_short_and_lists_left_out(void **state) {
    (void)state;
    struct cloud cloud;
    assert_int_equal(read_text("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty list uchar int a\n"
                               "property float y\nproperty int z\nproperty uchar red\nend_header\n0.1 1 5 0.3 -7 255\n",
                               &cloud),
                     STATUS_OK);
    char *text = written(&cloud, NULL, 1, HEADER_HASH);
    assert_string_equal(text, "# x y z red\n0.1 0.3 -7 255\n");
    free(text);
    cloud_done(&cloud);
}

static void many_random_points_survive_to_the_bit(void **state) {
    (void)state;
    char *text = alloc_array(MANY, 128);
    size_t used = 0;
    uint64_t random = 7;
    for (int i = 0; i < MANY; i++) {
        for (int k = 0; k < 4; k++) {
            double value = (double)(int64_t)next_random(&random) * (k == 3 ? 1e-300 : 1e-17);
            used += (size_t)snprintf(text + used, MANY * 128 - used, "%.17g%c", value, k == 3 ? '\n' : ' ');
        }
    }
    struct cloud cloud, again;
    assert_int_equal(read_text(text, &cloud), STATUS_OK);
    free(text);
    text = written(&cloud, NULL, MANY, HEADER_NONE);
    assert_int_equal(read_text(text, &again), STATUS_OK);
    assert_int_equal(again.count, MANY);
    assert_memory_equal(again.record, cloud.record, MANY * cloud.record_bytes);
    free(text);
    cloud_done(&cloud);
    cloud_done(&again);
}

static void limits_hold(void **state) {
    (void)state;
    struct cloud cloud;
    struct error error = {0};
    static const char text[] = "1 2 3 4\n5 6 7 8\n";
    const size_t n = sizeof text - 1;
    assert_int_equal(cloud_read_memory(text, n, &(struct cloud_limits){.max_points = 1}, NULL, &cloud, &error),
                     STATUS_LIMIT);
    assert_int_equal(error.line, 2);
    assert_int_equal(cloud_read_memory(text, n, &(struct cloud_limits){.max_properties = 3}, NULL, &cloud, &error),
                     STATUS_LIMIT);
    assert_int_equal(
        cloud_read_memory(text, n, &(struct cloud_limits){.max_points = 2, .max_properties = 4}, NULL, &cloud, &error),
        STATUS_OK);
    cloud_done(&cloud);
}

static bool countdown(void *ctx) { return (*(int *)ctx)-- == 0; }

static void every_failing_allocation_is_survived(void **state) {
    (void)state;
    enum status status = STATUS_NO_MEMORY;
    int n = 0;
    for (; status == STATUS_NO_MEMORY; n++) {
        struct cloud cloud;
        int left = n;
        alloc_fail = countdown;
        alloc_fail_ctx = &left;
        status = read_text("x y z a\n1 2 3 4\n5 6 7 8\n", &cloud);
        alloc_fail = NULL;
        cloud_done(&cloud);
        assert_true(n < 100);
    }
    assert_int_equal(status, STATUS_OK);
    assert_true(n > 4);
}

/* ------------------------------------------------------------------------------------------------ numbers */

static void check_f64(const char *text) {
    double value = -1;
    assert_ptr_equal(number_parse_f64(text, text + strlen(text), &value), text + strlen(text));
    double expected = strtod(text, NULL);
    if (memcmp(&value, &expected, sizeof value) != 0) fail_msg("%s is read as %a, not %a", text, value, expected);
}

static void check_f32(const char *text) {
    float value = -1;
    assert_ptr_equal(number_parse_f32(text, text + strlen(text), &value), text + strlen(text));
    float expected = strtof(text, NULL);
    if (memcmp(&value, &expected, sizeof value) != 0)
        fail_msg("%s is read as %a, not %a", text, (double)value, (double)expected);
}

static void hard_numbers_are_read_as_the_library_does(void **state) {
    (void)state;
    static const char *const hard[] = {"0",
                                       "-0",
                                       "1e22",
                                       "1e23",
                                       "9007199254740993",
                                       "9007199254740992.5",
                                       "9007199254740993e-1",
                                       "1.7976931348623157e308",
                                       "2.2250738585072011e-308",
                                       "5e-324",
                                       "2e-324",
                                       "1e400",
                                       "-1e400",
                                       "0.000000000000000000000000000000000001",
                                       "18446744073709551615",
                                       "18446744073709551616",
                                       "9999999999999999999",
                                       "0.9999999999999999999",
                                       "9223372036854775808e-1",
                                       "123456789012345678e-19",
                                       "16777217",
                                       "16777217.0000001",
                                       "33554435",
                                       "1.00000005960464477539062500000",
                                       "1.00000005960464477539062500001",
                                       "3.4028235677973366e38",
                                       "1e-45",
                                       "7e-46",
                                       "0.1e1",
                                       "000000000000000000000000000001.5",
                                       "1e0000000000000000000000001",
                                       "5e-99999999999"};
    for (size_t i = 0; i < sizeof hard / sizeof *hard; i++) {
        check_f64(hard[i]);
        check_f32(hard[i]);
    }
}

/* Long mantissas come near the middle between two doubles, where every bit of the quotient counts. */
static void long_mantissas_are_read_as_the_library_does(void **state) {
    (void)state;
    uint64_t random = 4711;
    for (int i = 0; i < ROUNDS; i++) {
        char text[64];
        uint64_t w = next_random(&random);
        snprintf(text, sizeof text, "%llue-%d", (unsigned long long)w, (int)(w % 20));
        check_f64(text);
        check_f32(text);
    }
}

/* What isn't exact in the first two ways goes to the library, which doesn't know Fortran's letter. */
static void exponents_of_fortran_are_read_as_others(void **state) {
    (void)state;
    static const char *const plain[] = {"1.5E0",  "-2e22", "0.1E+01", "1.2345678901234567890123e-200",
                                        "3e-320", "1e400"};
    for (size_t i = 0; i < sizeof plain / sizeof *plain; i++) {
        char text[64];
        double value = -1;
        snprintf(text, sizeof text, "%s", plain[i]);
        *strpbrk(text, "eE") = i % 2 ? 'd' : 'D';
        assert_ptr_equal(number_parse_f64(text, text + strlen(text), &value), text + strlen(text));
        assert_true(value == strtod(plain[i], NULL));
    }
}

static void what_is_no_number_is_refused(void **state) {
    (void)state;
    static const char *const words[] = {"", "-", "+", ".", "-.", "e5", "d5", "abc", "na", "in", "--1", "+-1"};
    double value = 42;
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        assert_null(number_parse_f64(words[i], words[i] + strlen(words[i]), &value));
    assert_true(value == 42);
    static const char partial[] = "1e+x";
    assert_ptr_equal(number_parse_f64(partial, partial + 4, &value), partial + 1);
    assert_true(value == 1);
}

/* Files that were written on other systems have their words for nan and infinity. */
static void what_is_not_finite_is_read_in_every_spelling(void **state) {
    (void)state;
    static const struct {
        const char *text;
        double value;
    } words[] = {{"nan", NAN},
                 {"-NaN", NAN},
                 {"nan(ind)", NAN},
                 {"-nan(ind)", NAN},
                 {"NAN(0x7f)", NAN},
                 {"1.#QNAN", NAN},
                 {"-1.#IND", NAN},
                 {"-1.#IND00", NAN},
                 {"1.#SNAN", NAN},
                 {"1.#INF", INFINITY},
                 {"-1.#INF00", -INFINITY},
                 {"inf", INFINITY},
                 {"-Infinity", -INFINITY}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        const char *text = words[i].text;
        double value = 42;
        float narrow = 42;
        assert_ptr_equal(number_parse_f64(text, text + strlen(text), &value), text + strlen(text));
        assert_ptr_equal(number_parse_f32(text, text + strlen(text), &narrow), text + strlen(text));
        assert_true(isnan(words[i].value) ? isnan(value) && isnan(narrow) : value == words[i].value && isinf(narrow));
    }
    static const struct {
        const char *text;
        size_t taken;
    } partial[] = {{"nan(", 3}, {"nan(x y)", 3}, {"1.#", 2}, {"1.#IN", 2}, {"2.#INF", 2}};
    for (size_t i = 0; i < sizeof partial / sizeof *partial; i++) {
        const char *text = partial[i].text;
        double value;
        assert_ptr_equal(number_parse_f64(text, text + strlen(text), &value), text + partial[i].taken);
    }
}

static void reading_stops_at_the_end_without_a_nul(void **state) {
    (void)state;
    double value;
    static const char digits[] = "1234567890";
    for (size_t n = 1; n < 10; n++) {
        assert_ptr_equal(number_parse_f64(digits, digits + n, &value), digits + n);
        assert_true(value == (double)(1234567890 / (long)pow(10, (double)(10 - n))));
    }
}

static void written_numbers_read_back_and_are_shortest(void **state) {
    (void)state;
    uint64_t random = 88172645463325252u;
    for (int i = 0; i < ROUNDS; i++) {
        uint64_t bits = next_random(&random);
        double value = i & 1 ? (double)(int64_t)bits * ldexp(1, -(int)(bits % 90)) : 0;
        if (!(i & 1)) memcpy(&value, &bits, sizeof value);
        if (i % 5 == 0) value = round(value * 1000) / 1000;
        if (!isfinite(value)) continue;
        char text[NUMBER_TEXT_BYTES + 1], library[64];
        text[number_format_f64(text, value)] = '\0';
        check_f64(text);
        assert_true(strtod(text, NULL) == value);
        if (snprintf(library, sizeof library, "%.15g", value), strtod(library, NULL) == value)
            assert_true(strtod(text, NULL) == strtod(library, NULL) && strlen(text) <= strlen(library) + 5);
        float f32 = (float)value;
        if (!isfinite(f32)) continue;
        text[number_format_f32(text, f32)] = '\0';
        check_f32(text);
        assert_true(strtof(text, NULL) == f32);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(plain_points_come_out_as_plain_lines),
        cmocka_unit_test(names_of_columns_survive_and_xyz_comes_first),
        cmocka_unit_test(each_header_is_read_back_with_its_names),
        cmocka_unit_test(floats_of_a_ply_are_short_and_lists_left_out),
        cmocka_unit_test(many_random_points_survive_to_the_bit),
        cmocka_unit_test(limits_hold),
        cmocka_unit_test(every_failing_allocation_is_survived),
        cmocka_unit_test(hard_numbers_are_read_as_the_library_does),
        cmocka_unit_test(long_mantissas_are_read_as_the_library_does),
        cmocka_unit_test(exponents_of_fortran_are_read_as_others),
        cmocka_unit_test(what_is_no_number_is_refused),
        cmocka_unit_test(what_is_not_finite_is_read_in_every_spelling),
        cmocka_unit_test(reading_stops_at_the_end_without_a_nul),
        cmocka_unit_test(written_numbers_read_back_and_are_shortest),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
