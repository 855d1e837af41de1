/* The cut of a graph whose capacities change: as if it had been cut for the first time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/surface/mincut.h"

/* A torus of nodes with arcs to the right, to the left, down and up. */
enum { WIDTH = 12, NODES = WIDTH * WIDTH, CHANGES = 20, ROUNDS = 200, MOST = 40 };

struct torus {
    uint32_t neighbour[NODES][4];
    uint8_t mirror[NODES][4];
    int32_t capacity[NODES][4], terminal[NODES]; /* as they are meant to be */
    uint64_t seed;
};

static int32_t number(struct torus *torus, int32_t below) {
    torus->seed = torus->seed * 6364136223846793005u + 1442695040888963407u;
    return (int32_t)(torus->seed >> 33) % below;
}

static void torus_init(struct torus *torus) {
    const uint32_t right = 1, left = WIDTH - 1;
    *torus = (struct torus){.seed = 1};
    for (uint32_t c = 0; c < NODES; c++) {
        uint32_t x = c % WIDTH, row = c - x;
        const uint32_t to[4] = {row + (x + right) % WIDTH, row + (x + left) % WIDTH, (c + WIDTH) % NODES,
                                (c + NODES - WIDTH) % NODES};
        memcpy(torus->neighbour[c], to, sizeof to);
        torus->terminal[c] = number(torus, 2 * MOST) - MOST;
        for (int i = 0; i < 4; i++) {
            torus->mirror[c][i] = (uint8_t)(i ^ 1);
            torus->capacity[c][i] = number(torus, MOST);
        }
    }
}

struct work {
    int32_t capacity[NODES][4], terminal[NODES];
    struct mincut graph;
    struct mincut_search *search;
};

static void work_init(struct work *work, const struct torus *torus) {
    memcpy(work->capacity, torus->capacity, sizeof work->capacity);
    memcpy(work->terminal, torus->terminal, sizeof work->terminal);
    work->graph = (struct mincut){NODES, torus->neighbour, torus->mirror, work->capacity, work->terminal};
    assert_int_equal(mincut_new(&work->graph, &work->search), STATUS_OK);
}

static void assert_same_sides(const struct torus *torus, const struct work *work) {
    struct work fresh;
    work_init(&fresh, torus);
    assert_int_equal(mincut_flow(fresh.search, "cut", NULL), STATUS_OK);
    for (uint32_t c = 0; c < NODES; c++)
        assert_int_equal(mincut_is_source(work->search, c), mincut_is_source(fresh.search, c));
    mincut_free(fresh.search);
}

/* One terminal and one arc become others, or nothing, or as they are. */
static void change(struct torus *torus, struct work *work) {
    uint32_t c = (uint32_t)number(torus, NODES), d = (uint32_t)number(torus, NODES);
    unsigned i = (unsigned)number(torus, 4);
    int32_t terminal = number(torus, 3) ? number(torus, 2 * MOST) - MOST : 0;
    int32_t capacity = number(torus, 3) ? number(torus, MOST) : 0;
    mincut_add_terminal(work->search, c, terminal - torus->terminal[c]);
    mincut_add_arc(work->search, d, i, capacity - torus->capacity[d][i]);
    torus->terminal[c] = terminal;
    torus->capacity[d][i] = capacity;
}

static void changed_capacities_are_cut_as_new_ones(void **state) {
    (void)state;
    struct torus torus;
    struct work work;
    torus_init(&torus);
    work_init(&work, &torus);
    for (int round = 0; round < ROUNDS; round++) {
        assert_int_equal(mincut_flow(work.search, "cut", NULL), STATUS_OK);
        assert_same_sides(&torus, &work);
        for (int k = 0; k < CHANGES; k++) change(&torus, &work);
    }
    mincut_free(work.search);
}

static void changes_before_the_first_search_count(void **state) {
    (void)state;
    struct torus torus;
    struct work work;
    torus_init(&torus);
    work_init(&work, &torus);
    for (int k = 0; k < CHANGES; k++) change(&torus, &work);
    assert_int_equal(mincut_flow(work.search, "cut", NULL), STATUS_OK);
    assert_same_sides(&torus, &work);
    mincut_free(work.search);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(changed_capacities_are_cut_as_new_ones),
        cmocka_unit_test(changes_before_the_first_search_count),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
