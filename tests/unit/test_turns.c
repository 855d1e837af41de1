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
static void add(struct turns *turns, const char *name, int priority) {
    struct turn turn = {.priority = priority, .created_ms = name[1] - '0'};
    snprintf(turn.id, sizeof turn.id, "%s", name);
    snprintf(turn.principal, sizeof turn.principal, "%c", name[0]);
    assert_true(turns_add(turns, &turn));
}

static void expect_order(struct turns *turns, const char *expected) {
    char order[256] = "";
    const struct turn *turn;
    while ((turn = turns_first(turns))) {
        char id[JOB_ID_BYTES];
        snprintf(id, sizeof id, "%s", turn->id);
        assert_int_equal(turns_ahead(turns, id, NULL, NULL), 0);
        snprintf(order + strlen(order), sizeof order - strlen(order), "%s ", id);
        turns_take(turns, id);
    }
    assert_string_equal(order, expected);
}

static void the_oldest_comes_first(void **state) {
    struct turns *turns = turns_new(AGING_MS);
    (void)state;
    assert_null(turns_first(turns));
    add(turns, "a2", 5), add(turns, "a3", 5), add(turns, "a1", 5);
    expect_order(turns, "a1 a2 a3 ");
    turns_free(turns);
}

static void principals_take_turns(void **state) {
    struct turns *turns = turns_new(AGING_MS);
    (void)state;
    for (const char *names = "a1a2a3a4b5b6c7"; *names; names += 2) add(turns, (char[]){names[0], names[1], 0}, 5);
    expect_order(turns, "a1 b5 c7 a2 b6 a3 a4 ");
    turns_free(turns);
}

static void who_was_served_last_waits_longest(void **state) {
    struct turns *turns = turns_new(AGING_MS);
    (void)state;
    add(turns, "a1", 5);
    turns_take(turns, "a1");
    add(turns, "a2", 9), add(turns, "b3", 0);
    expect_order(turns, "b3 a2 "); /* priority is among one's own jobs */
    turns_free(turns);
}

static void priority_is_worth_some_waiting_and_no_more(void **state) {
    struct turns *turns = turns_new(2);
    (void)state;
    add(turns, "a1", 0), add(turns, "a2", 1), add(turns, "a9", 4);
    expect_order(turns, "a2 a1 a9 "); /* due at 0, 1 and 1 */
    turns_free(turns);
}

static void a_job_that_leaves_takes_no_turn(void **state) {
    struct turns *turns = turns_new(AGING_MS);
    (void)state;
    add(turns, "a1", 5), add(turns, "a2", 5), add(turns, "b3", 5);
    turns_remove(turns, "a1");
    turns_remove(turns, "no such job");
    assert_int_equal(turns_ahead(turns, "b3", NULL, NULL), 1);
    assert_int_equal(turns_ahead(turns, "a1", NULL, NULL), 0);
    expect_order(turns, "a2 b3 ");
    turns_free(turns);
}

static void append(void *ctx, const struct turn *turn) {
    char *text = ctx;
    snprintf(text + strlen(text), 64 - strlen(text), "%s ", turn->id);
}

static void those_ahead_are_told_in_their_order(void **state) {
    struct turns *turns = turns_new(AGING_MS);
    char text[64] = "";
    (void)state;
    add(turns, "a1", 5), add(turns, "a2", 5), add(turns, "b3", 5), add(turns, "b4", 6);
    assert_int_equal(turns_ahead(turns, "b3", append, text), 3);
    assert_string_equal(text, "a1 b4 a2 ");
    turns_free(turns);
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
