/* Jobs: the transition table as it is drawn, ids, and parameters kept as text.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/job.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static void only_the_transitions_that_are_drawn(void **state) {
    (void)state;
    static const struct {
        enum job_state from;
        enum job_event event;
        enum job_state to;
    } drawn[] = {
        {JOB_ACCEPTED, JOB_CLAIM, JOB_RUNNING},    {JOB_ACCEPTED, JOB_WITHDRAW, JOB_DISMISSED},
        {JOB_RUNNING, JOB_DONE, JOB_SUCCESSFUL},   {JOB_RUNNING, JOB_FAIL, JOB_FAILED},
        {JOB_RUNNING, JOB_DISMISS, JOB_DISMISSED}, {JOB_RUNNING, JOB_REQUEUE, JOB_ACCEPTED},
        {JOB_ACCEPTED, JOB_REUSE, JOB_SUCCESSFUL},
    };
    int allowed = 0;
    for (int from = 0; from < JOB_STATE_COUNT; from++)
        for (int event = 0; event < JOB_EVENT_COUNT; event++) {
            enum job_state next;
            allowed += job_transition((enum job_state)from, (enum job_event)event, &next);
        }
    assert_int_equal(allowed, sizeof drawn / sizeof *drawn);
    for (size_t i = 0; i < sizeof drawn / sizeof *drawn; i++) {
        enum job_state next;
        assert_true(job_transition(drawn[i].from, drawn[i].event, &next));
        assert_int_equal(next, drawn[i].to);
    }
}

static void nothing_leaves_an_ended_state(void **state) {
    (void)state;
    for (int from = 0; from < JOB_STATE_COUNT; from++)
        for (int event = 0; event < JOB_EVENT_COUNT; event++) {
            enum job_state next;
            bool leaves = job_transition((enum job_state)from, (enum job_event)event, &next);
            assert_false(leaves && job_ended((enum job_state)from));
        }
}

static void names_and_back(void **state) {
    (void)state;
    for (int i = 0; i < JOB_STATE_COUNT; i++) {
        enum job_state found;
        assert_true(job_state_from_name(job_state_name((enum job_state)i), &found));
        assert_int_equal(found, i);
    }
    enum job_state untouched = JOB_FAILED;
    assert_false(job_state_from_name("done", &untouched));
    assert_int_equal(untouched, JOB_FAILED);
}

static void ids_are_uuids_of_version_7(void **state) {
    (void)state;
    struct timespec now = {1700000000, 123456789};
    char id[JOB_ID_BYTES];
    job_new_id(&now, id);
    assert_true(job_id_valid(id));
    assert_int_equal(strtoull(id, NULL, 16), 1700000000123ULL >> 16);
    assert_int_equal(strtoull(id + 9, NULL, 16), 1700000000123ULL & 0xffff);
    assert_int_equal(id[14], '7');
    assert_non_null(strchr("89ab", id[19]));
}

static void ids_sort_by_time(void **state) {
    (void)state;
    char earlier[JOB_ID_BYTES], later[JOB_ID_BYTES];
    for (long i = 0; i < 1000; i++) {
        struct timespec a = {1700000000 + i / 7, 999 * i * 1000 % 999999000}, b = a;
        b.tv_nsec += 1000; /* a microsecond */
        job_new_id(&a, earlier);
        job_new_id(&b, later);
        assert_true(strcmp(earlier, later) < 0);
    }
}

static void ids_of_one_moment_differ(void **state) {
    (void)state;
    struct timespec now = {1700000000, 0};
    char a[JOB_ID_BYTES], b[JOB_ID_BYTES];
    job_new_id(&now, a);
    job_new_id(&now, b);
    assert_string_not_equal(a, b);
    memcpy(b, a, sizeof b);
    job_another_id(b);
    assert_true(job_id_valid(b) && strncmp(a, b, 18) == 0); /* the time, by which they sort */
    assert_string_not_equal(a, b);
}

static void what_is_no_id(void **state) {
    (void)state;
    static const char *const wrong[] = {"",
                                        "x",
                                        "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5",
                                        "../../../../../../../../../../etc/pas",
                                        "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5ee",
                                        "0198C7D2-4a10-7cc3-9d0e-6f1f2b3c4d5e",
                                        "0198c7d2x4a10-7cc3-9d0e-6f1f2b3c4d5e"};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) assert_false(job_id_valid(wrong[i]));
}

static void parameters_as_text_and_back(void **state) {
    (void)state;
    struct params params, back;
    struct error error;
    params_defaults(&params);
    assert_int_equal(params_set(&params, "levels", "0.3333333333333333,0.1,0.01", &error), STATUS_OK);
    assert_int_equal(params_set(&params, "outputs", "cloud,mesh,error", &error), STATUS_OK);
    assert_int_equal(params_set(&params, "seed", "4294967295", &error), STATUS_OK);
    assert_int_equal(params_resolve(&params, &error), STATUS_OK);
    char *const texts[] = {job_params_text(&params), job_params_stored(&params)};
    for (int i = 0; i < 2; i++) {
        assert_non_null(texts[i]);
        assert_true(job_params_read(texts[i], &back));
        assert_memory_equal(&back, &params, sizeof params);
    }
    assert_non_null(strstr(texts[1], "\ngiven=levels,outputs,seed\n"));
    free(texts[0]);
    free(texts[1]);
}

/* What a newer program has stored is read as it was meant, or it is said that it can't be. */
static void stored_parameters_that_are_not_known_are_told(void **state) {
    static const struct {
        const char *text;
        bool is_known;
    } stored[] = {
        {"ratio=0.5\nshade=7\nplacement=auto\ngiven=ratio\n", true}, /* as if it weren't there */
        {"ratio=0.5\nshade=7\nplacement=auto\ngiven=ratio,shade\n", false},
        {"given=shade\nshade=7\n", false},
        {"shade=7\ngiven=shaded,shad\n", true},
        {"placement=sideways\ngiven=ratio\n", false}, /* which may be the default of that program */
        {"placement=sideways\n", true},               /* of an older program, and gone */
        {"neighbours_max=100\ngiven=neighbours_max\n", false},
        {"given=", true},
        {"", true},
    };
    (void)state;
    for (size_t i = 0; i < sizeof stored / sizeof *stored; i++) {
        struct params params;
        if (job_params_read(stored[i].text, &params) != stored[i].is_known) fail_msg("%s", stored[i].text);
    }
}

static void stored_parameters_of_another_version_are_skipped(void **state) {
    (void)state;
    struct params params;
    job_params_read("gone=1\nratio=0.25\nplacement=sideways\nno equals\n\n=\nseed=3", &params);
    assert_float_equal(params.ratio, 0.25, 0);
    assert_int_equal(params.placement, PLACEMENT_AUTO);
    assert_int_equal(params.seed, 3);
}

static void an_overlong_stored_line_is_skipped(void **state) {
    (void)state;
    for (int length = 500; length < 3000; length++) {
        struct params params;
        char text[4096];
        memset(text, 'x', sizeof text);
        memcpy(text, "seed=1\nlabel=", 13);
        snprintf(text + length, sizeof text - (size_t)length, "\nratio=0.25\n");
        job_params_read(text, &params);
        assert_int_equal(params.seed, 1);
        assert_float_equal(params.ratio, 0.25, 0);
    }
    struct params params;
    char text[4096] = "seed=1\nratio=0.5"; /* whose beginning is a value too */
    size_t length = strlen(text);
    memset(text + length, '0', sizeof text - length - 1);
    job_params_read(text, &params);
    assert_true(params.seed == 1 && isnan(params.ratio));
}

static void times_as_text(void **state) {
    (void)state;
    char text[JOB_TIME_BYTES];
    assert_string_equal(job_time_text(1700000000007, text), "2023-11-14T22:13:20.007Z");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(only_the_transitions_that_are_drawn),
        cmocka_unit_test(nothing_leaves_an_ended_state),
        cmocka_unit_test(names_and_back),
        cmocka_unit_test(ids_are_uuids_of_version_7),
        cmocka_unit_test(ids_sort_by_time),
        cmocka_unit_test(ids_of_one_moment_differ),
        cmocka_unit_test(what_is_no_id),
        cmocka_unit_test(parameters_as_text_and_back),
        cmocka_unit_test(stored_parameters_of_another_version_are_skipped),
        cmocka_unit_test(stored_parameters_that_are_not_known_are_told),
        cmocka_unit_test(an_overlong_stored_line_is_skipped),
        cmocka_unit_test(times_as_text),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
