/* Turns: fairness among principals, priority within one, age, and who comes before whom.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/fair_share.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

enum { AGING_MS = 1000 };

/* "a1" is a job of principal a, submitted at 1 ms. */
static void add(struct fair_share *fair_share, const char *name, int priority) {
    struct turn turn = {.priority = priority, .created_ms = name[1] - '0'};
    snprintf(turn.id, sizeof turn.id, "%s", name);
    snprintf(turn.principal, sizeof turn.principal, "%c", name[0]);
    assert_true(fair_share_add(fair_share, &turn));
}

static void expect_order(struct fair_share *fair_share, const char *expected) {
    char order[256] = "";
    const struct turn *turn;
    while ((turn = fair_share_first(fair_share))) {
        char id[JOB_ID_BYTES];
        snprintf(id, sizeof id, "%s", turn->id);
        assert_int_equal(fair_share_ahead(fair_share, id, NULL, NULL), 0);
        snprintf(order + strlen(order), sizeof order - strlen(order), "%s ", id);
        fair_share_take(fair_share, id);
    }
    assert_string_equal(order, expected);
}

static void the_oldest_comes_first(void **state) {
    struct fair_share *fair_share = fair_share_new(AGING_MS);
    (void)state;
    assert_null(fair_share_first(fair_share));
    add(fair_share, "a2", 5), add(fair_share, "a3", 5), add(fair_share, "a1", 5);
    expect_order(fair_share, "a1 a2 a3 ");
    fair_share_free(fair_share);
}

static void principals_take_turns(void **state) {
    struct fair_share *fair_share = fair_share_new(AGING_MS);
    (void)state;
    for (const char *names = "a1a2a3a4b5b6c7"; *names; names += 2) add(fair_share, (char[]){names[0], names[1], 0}, 5);
    expect_order(fair_share, "a1 b5 c7 a2 b6 a3 a4 ");
    fair_share_free(fair_share);
}

static void who_was_served_last_waits_longest(void **state) {
    struct fair_share *fair_share = fair_share_new(AGING_MS);
    (void)state;
    add(fair_share, "a1", 5);
    fair_share_take(fair_share, "a1");
    add(fair_share, "a2", 9), add(fair_share, "b3", 0);
    expect_order(fair_share, "b3 a2 "); /* priority is among one's own jobs */
    fair_share_free(fair_share);
}

static void priority_is_worth_some_waiting_and_no_more(void **state) {
    struct fair_share *fair_share = fair_share_new(2);
    (void)state;
    add(fair_share, "a1", 0), add(fair_share, "a2", 1), add(fair_share, "a9", 4);
    expect_order(fair_share, "a2 a1 a9 "); /* due at 0, 1 and 1 */
    fair_share_free(fair_share);
}

static void a_job_that_leaves_takes_no_turn(void **state) {
    struct fair_share *fair_share = fair_share_new(AGING_MS);
    (void)state;
    add(fair_share, "a1", 5), add(fair_share, "a2", 5), add(fair_share, "b3", 5);
    fair_share_remove(fair_share, "a1");
    fair_share_remove(fair_share, "no such job");
    assert_int_equal(fair_share_ahead(fair_share, "b3", NULL, NULL), 1);
    assert_int_equal(fair_share_ahead(fair_share, "a1", NULL, NULL), 0);
    expect_order(fair_share, "a2 b3 ");
    fair_share_free(fair_share);
}

static void append(void *ctx, const struct turn *turn) {
    char *text = ctx;
    snprintf(text + strlen(text), 64 - strlen(text), "%s ", turn->id);
}

static void those_ahead_are_told_in_their_order(void **state) {
    struct fair_share *fair_share = fair_share_new(AGING_MS);
    char text[64] = "";
    (void)state;
    add(fair_share, "a1", 5), add(fair_share, "a2", 5), add(fair_share, "b3", 5), add(fair_share, "b4", 6);
    assert_int_equal(fair_share_ahead(fair_share, "b3", append, text), 3);
    assert_string_equal(text, "a1 b4 a2 ");
    fair_share_free(fair_share);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_oldest_comes_first),
        cmocka_unit_test(principals_take_turns),
        cmocka_unit_test(who_was_served_last_waits_longest),
        cmocka_unit_test(priority_is_worth_some_waiting_and_no_more),
        cmocka_unit_test(a_job_that_leaves_takes_no_turn),
        cmocka_unit_test(those_ahead_are_told_in_their_order),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
