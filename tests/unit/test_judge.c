/* Judging between two labellings: a sphere whose cells are all inside, and the same with a cell dug out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/spatial/knn.h"
#include "core/surface/cocone/judge.h"
#include "core/surface/delaunay_cgal.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { SITES = 60, DENSE = 3000 };

struct ball {
    vec3 *site, *point, *normal;
    float *spacing;
    uint32_t *of_point;
    struct knn *knn;
    struct tets tets;
    struct cocone_star star;
    struct reconstruct_dense dense;
    uint8_t *whole, *dug, *labels;
};

static uint32_t nearest_site(const struct ball *ball, vec3 p) {
    uint32_t best = 0;
    for (uint32_t i = 1; i < SITES; i++)
        if (vec3_distance_sq(p, ball->site[i]) < vec3_distance_sq(p, ball->site[best])) best = i;
    return best;
}

static int set_up(void **state) {
    struct ball *ball = *state = calloc(1, sizeof *ball);
    ball->site = shape_sphere(SITES, 0.3);
    ball->point = shape_sphere(DENSE, 0.3);
    ball->normal = shape_sphere(DENSE, 1);
    ball->spacing = alloc_array(DENSE, sizeof *ball->spacing);
    ball->of_point = alloc_array(DENSE, sizeof *ball->of_point);
    for (size_t i = 0; i < DENSE; i++) ball->spacing[i] = 0.02f, ball->of_point[i] = nearest_site(ball, ball->point[i]);
    assert_int_equal(knn_new(ball->point, DENSE, 1, &ball->knn, NULL), STATUS_OK);
    assert_int_equal(delaunay_build(ball->site, SITES, 1, NULL, &ball->tets, NULL), STATUS_OK);
    assert_int_equal(cocone_star_build(&ball->tets, ball->site, SITES, 1, &ball->star), STATUS_OK);
    ball->dense = (struct reconstruct_dense){DENSE,     ball->point, ball->normal, ball->spacing, ball->of_point,
                                             ball->knn, NULL,        NULL,         NULL};
    ball->whole = alloc_zeroed(ball->tets.cell_count, 1);
    ball->dug = alloc_array(ball->tets.cell_count, 1);
    ball->labels = alloc_array(ball->tets.cell_count, 1);
    memset(ball->whole, 1, ball->tets.finite_count);
    memcpy(ball->dug, ball->whole, ball->tets.cell_count);
    return 0;
}

static int tear_down(void **state) {
    struct ball *ball = *state;
    cocone_star_done(&ball->star);
    tets_done(&ball->tets);
    knn_free(ball->knn);
    free(ball->site), free(ball->point), free(ball->normal), free(ball->spacing), free(ball->of_point);
    free(ball->whole), free(ball->dug), free(ball->labels);
    free(ball);
    return 0;
}

/* The finite cell at the hull facet of the nth infinite cell. */
static uint32_t cell_at_hull(const struct ball *ball, size_t nth) {
    const uint32_t *neighbour = ball->tets.neighbour[ball->tets.finite_count + nth];
    for (int i = 0; i < 4; i++)
        if (neighbour[i] < ball->tets.finite_count) return neighbour[i];
    fail();
    return 0;
}

/* A cell at the hull that isn't the given one, nor next to it. */
static uint32_t another_at_hull(const struct ball *ball, uint32_t cell) {
    for (size_t nth = 0; ball->tets.finite_count + nth < ball->tets.cell_count; nth++) {
        uint32_t other = cell_at_hull(ball, nth);
        bool apart = other != cell;
        for (int i = 0; i < 4; i++) apart &= ball->tets.neighbour[cell][i] != other;
        if (apart) return other;
    }
    fail();
    return 0;
}

static size_t judged(struct ball *ball, const uint8_t *inside, const uint8_t *other, unsigned threads) {
    size_t taken = 99;
    memcpy(ball->labels, inside, ball->tets.cell_count);
    struct cocone_proposal proposal = {.inside = other, .patience = 1, .matters = 0.02};
    assert_int_equal(cocone_judge(&ball->star, &ball->dense, threads, &proposal, ball->labels, &taken), STATUS_OK);
    return taken;
}

static void equal_labels_are_left_alone(void **state) {
    struct ball *ball = *state;
    assert_int_equal(judged(ball, ball->whole, ball->whole, 1), 0);
    assert_memory_equal(ball->labels, ball->whole, ball->tets.cell_count);
}

static void a_dent_is_not_taken(void **state) {
    struct ball *ball = *state;
    ball->dug[cell_at_hull(ball, 0)] = 0;
    assert_int_equal(judged(ball, ball->whole, ball->dug, 1), 0);
    assert_memory_equal(ball->labels, ball->whole, ball->tets.cell_count);
}

static void a_dent_is_mended(void **state) {
    struct ball *ball = *state;
    ball->dug[cell_at_hull(ball, 0)] = 0;
    assert_int_equal(judged(ball, ball->dug, ball->whole, 1), 1);
    assert_memory_equal(ball->labels, ball->whole, ball->tets.cell_count);
}

static void each_difference_is_decided_by_itself(void **state) {
    struct ball *ball = *state;
    uint32_t here = cell_at_hull(ball, 0), there = another_at_hull(ball, here);
    ball->dug[here] = 0;
    uint8_t *other = alloc_array(ball->tets.cell_count, 1);
    memcpy(other, ball->whole, ball->tets.cell_count);
    other[there] = 0;
    for (unsigned threads = 1; threads <= 3; threads++) {
        assert_int_equal(judged(ball, ball->dug, other, threads), 1);
        assert_memory_equal(ball->labels, ball->whole, ball->tets.cell_count);
    }
    free(other);
}

/* One of the two has no surface at all. */
static void anything_is_better_than_nothing(void **state) {
    struct ball *ball = *state;
    memset(ball->dug, 0, ball->tets.cell_count);
    assert_int_equal(judged(ball, ball->dug, ball->whole, 1), ball->tets.finite_count);
    assert_memory_equal(ball->labels, ball->whole, ball->tets.cell_count);
    assert_int_equal(judged(ball, ball->whole, ball->dug, 1), 0);
}

/* What fails: ours, and those of FLANN's searches. */
static long fail_each(struct ball *ball, void (*faults_in)(long nth)) {
    long nth = 0;
    memcpy(ball->labels, ball->dug, ball->tets.cell_count);
    for (bool happened = true; happened; nth++) {
        size_t taken;
        assert_memory_equal(ball->labels, ball->dug, ball->tets.cell_count);
        struct cocone_proposal proposal = {.inside = ball->whole, .patience = 1, .matters = 0.02};
        faults_in(nth + 1);
        enum status status = cocone_judge(&ball->star, &ball->dense, 1, &proposal, ball->labels, &taken);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    return nth;
}

static void in_memory(long nth) { faults_in_memory(nth, false); }

static void a_failing_allocation_leaves_the_labels(void **state) {
    struct ball *ball = *state;
    ball->dug[cell_at_hull(ball, 0)] = 0;
    assert_true(fail_each(ball, in_memory) > 8);
    assert_true(fail_each(ball, faults_in_new) > 1);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(equal_labels_are_left_alone, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_dent_is_not_taken, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_dent_is_mended, set_up, tear_down),
        cmocka_unit_test_setup_teardown(each_difference_is_decided_by_itself, set_up, tear_down),
        cmocka_unit_test_setup_teardown(anything_is_better_than_nothing, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_failing_allocation_leaves_the_labels, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
