/* Costs of pairs against the quadrics' own values, whatever place among four a pair has.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/simplify/pair_cost.h"
#include "tests/unit/shapes.h"

enum { N = 50, PAIRS = 203 };

struct scene {
    vec3 point[N];
    struct packed_quadric quadric[N];
    uint32_t p[PAIRS + PAIR_COST_ROOM], q[PAIRS + PAIR_COST_ROOM];
    struct pair_field field;
};

static vec3 random_vec3(uint64_t *seed) {
    return (vec3){random_unit(seed) - 0.5, random_unit(seed) - 0.5, random_unit(seed) - 0.5};
}

/* Some quadrics have a negative constant, as rounding may leave them. */
static void make_scene(struct scene *s) {
    uint64_t seed = 8;
    for (size_t i = 0; i < N; i++) {
        quadric q = {.b = random_vec3(&seed), .c = random_unit(&seed) - 0.3};
        for (int planes = 0; planes < 3; planes++) quadric_add_plane(&q, random_vec3(&seed), random_unit(&seed));
        s->point[i] = random_vec3(&seed);
        s->quadric[i] = quadric_pack(&q);
    }
    for (size_t i = 0; i < PAIRS; i++)
        s->p[i] = (uint32_t)(random_next(&seed) % N), s->q[i] = (uint32_t)(random_next(&seed) % N);
    s->field = (struct pair_field){s->point, s->quadric, false, 0.25};
}

/* E_p + E_q at p. */
static double error_at(const struct scene *s, uint32_t p, uint32_t q) {
    quadric own = quadric_unpack(&s->quadric[p]), other = quadric_unpack(&s->quadric[q]);
    return quadric_value(&own, (vec3){0, 0, 0}) + quadric_value(&other, vec3_sub(s->point[p], s->point[q]));
}

static void costs_are_those_of_the_quadrics(void **state) {
    (void)state;
    struct scene s;
    double p_stays[PAIRS + PAIR_COST_ROOM], q_stays[PAIRS + PAIR_COST_ROOM];
    float cost[PAIRS + PAIR_COST_ROOM];
    make_scene(&s);
    pair_errors(&s.field, s.p, s.q, PAIRS, p_stays, q_stays);
    pair_costs(&s.field, s.p, s.q, PAIRS, cost);
    for (size_t i = 0; i < PAIRS; i++) {
        assert_true(fabs(p_stays[i] - error_at(&s, s.p[i], s.q[i])) < 1e-13);
        assert_true(fabs(q_stays[i] - error_at(&s, s.q[i], s.p[i])) < 1e-13);
        double length_sq = vec3_distance_sq(s.point[s.p[i]], s.point[s.q[i]]);
        assert_true(cost[i] == (float)(fmin(p_stays[i], q_stays[i]) + 0.25 * length_sq));
    }
}

static void costs_of_untouched_quadrics_are_the_same_without_their_zeros(void **state) {
    (void)state;
    struct scene s;
    float cost[PAIRS + PAIR_COST_ROOM], again[PAIRS + PAIR_COST_ROOM];
    make_scene(&s);
    for (size_t i = 0; i < N; i++) s.quadric[i].b[0] = s.quadric[i].b[1] = s.quadric[i].b[2] = s.quadric[i].c = 0;
    pair_costs(&s.field, s.p, s.q, PAIRS, cost);
    s.field.untouched = true;
    pair_costs(&s.field, s.p, s.q, PAIRS, again);
    assert_memory_equal(again, cost, PAIRS * sizeof *cost);
}

static void a_pair_s_cost_does_not_depend_on_its_place_or_its_company(void **state) {
    (void)state;
    struct scene s;
    float cost[PAIRS + PAIR_COST_ROOM], again[PAIRS + PAIR_COST_ROOM];
    make_scene(&s);
    pair_costs(&s.field, s.p, s.q, PAIRS, cost);
    for (size_t n = 1; n <= 9; n++)
        for (size_t first = 0; first + n <= PAIRS; first += 7) {
            uint32_t p[9 + PAIR_COST_ROOM], q[9 + PAIR_COST_ROOM];
            memcpy(p, &s.p[first], n * sizeof *p);
            memcpy(q, &s.q[first], n * sizeof *q);
            pair_costs(&s.field, p, q, n, again);
            assert_memory_equal(again, &cost[first], n * sizeof *cost);
        }
    pair_costs(&s.field, s.q, s.p, PAIRS, again);
    for (size_t i = 0; i < PAIRS; i++) assert_true(fabsf(again[i] - cost[i]) < 1e-6f);
    pair_costs(&s.field, s.p, s.q, 0, again);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(costs_are_those_of_the_quadrics),
        cmocka_unit_test(costs_of_untouched_quadrics_are_the_same_without_their_zeros),
        cmocka_unit_test(a_pair_s_cost_does_not_depend_on_its_place_or_its_company),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
