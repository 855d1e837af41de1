/* Facets between inner and outer cells, against a plain search for them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/surface/cocone/boundary.h"
#include "core/surface/delaunay_cgal.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { POINTS = 3000 };

struct labelled {
    vec3 point[POINTS];
    struct tets tets;
    struct cocone_star star;
    uint8_t *inside, near[POINTS];
};

/* Points all over a cube, three cells of four inside, every tenth vertex near. */
static int set_up(void **state) {
    struct labelled *l = *state = calloc(1, sizeof *l);
    uint64_t seed = 5;
    for (size_t i = 0; i < POINTS; i++) {
        l->point[i] = (vec3){random_unit(&seed) - 0.5, random_unit(&seed) - 0.5, random_unit(&seed) - 0.5};
        l->near[i] = i % 10 == 0;
    }
    assert_int_equal(delaunay_build(l->point, POINTS, 1, NULL, &l->tets, NULL), STATUS_OK);
    assert_int_equal(cocone_star_build(&l->tets, l->point, POINTS, 1, &l->star), STATUS_OK);
    l->inside = alloc_zeroed(l->tets.cell_count, 1);
    for (size_t c = 0; c < l->tets.finite_count; c++) l->inside[c] = random_unit(&seed) < 0.75;
    return 0;
}

static int tear_down(void **state) {
    struct labelled *l = *state;
    cocone_star_done(&l->star);
    tets_done(&l->tets);
    free(l->inside), free(l);
    return 0;
}

/* Whether the half facet is to be listed. */
static bool belongs(const struct labelled *l, const uint8_t *near, uint32_t half) {
    uint32_t v[3], cell = cocone_star_cell(half);
    if (!l->inside[cell] || l->inside[l->tets.neighbour[cell][cocone_star_index(half)]]) return false;
    cocone_star_vertices(&l->star, half, v);
    return !near || near[v[0]] || near[v[1]] || near[v[2]];
}

static void check_list(const struct labelled *l, const uint8_t *near, unsigned threads) {
    uint32_t *half = NULL;
    size_t count = 0, found = 0;
    assert_int_equal(cocone_boundary_list(&l->star, l->inside, near, threads, &half, &count), STATUS_OK);
    for (uint32_t h = 0; h < 4 * l->tets.finite_count; h++)
        if (belongs(l, near, h)) assert_true(found < count && half[found++] == h);
    assert_int_equal(found, count);
    assert_true(count > 1000);
    free(half);
}

static void every_facet_of_the_boundary_is_listed_once_in_order(void **state) {
    const struct labelled *l = *state;
    assert_true(l->tets.finite_count > 10000);
    check_list(l, NULL, 1), check_list(l, NULL, 3);
    check_list(l, l->near, 1), check_list(l, l->near, 3);
}

static void any_allocation_may_fail(void **state) {
    const struct labelled *l = *state;
    bool happened = true;
    int nth = 0;
    for (; happened; nth++) {
        uint32_t *half = NULL;
        size_t count = 0;
        faults_in_memory(nth + 1, false);
        enum status status = cocone_boundary_list(&l->star, l->inside, NULL, 1, &half, &count);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(happened == !half);
        free(half);
    }
    assert_int_equal(nth, 4);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(every_facet_of_the_boundary_is_listed_once_in_order, set_up, tear_down),
        cmocka_unit_test_setup_teardown(any_allocation_may_fail, set_up, tear_down),
    };
    return cmocka_run_group_tests_name("boundary", tests, NULL, NULL);
}
