/* Contraction in passes against the paper's own order: a heap, and the cheapest pair of all each time.
 *
 * The heap is the simplest one that is right: whenever a point changes, its pairs are pushed again with new costs, and
 * what is popped counts only if neither end has changed since it was pushed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/cloud.h"
#include "core/contract.h"
#include "core/dso.h"
#include "core/normals.h"
#include "core/tangent.h"
#include "tests/unit/shapes.h"

enum { N = 8000, MOST = UINT8_MAX };
static const double LENGTH_BIAS = 1e-9;

/* What both start from. */
struct start {
    vec3 *point, *normal;
    struct neighbourhood hood;
    struct packed_quadric *quadrics;
};

static struct start start_from(vec3 *point) {
    struct start s = {.point = point, .normal = malloc(N * sizeof(vec3)), .quadrics = malloc(N * sizeof *s.quadrics)};
    struct knn *knn = NULL;
    struct neighbourhood_options near = {2.5, 6, 10, 1};
    struct quadric_options options = {AREA_AREA, 3e-3, 1};
    float dso[N], weight[N];
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, point, N, &near, &s.hood), STATUS_OK);
    knn_free(knn);
    normals_fit(point, &s.hood, 1, s.normal, NULL);
    dso_compute(point, s.normal, &s.hood, DSO_RMS, 1, dso);
    dso_weights(dso, N, 0.5, 1, weight);
    quadric_assemble(point, s.normal, &s.hood, weight, &options, s.quadrics);
    return s;
}

static void start_done(struct start *s) {
    neighbourhood_done(&s->hood);
    free(s->point), free(s->normal), free(s->quadrics);
}

/* ------------------------------------------------------------------------------------------------ the heap */

struct pair {
    double cost, length_sq;
    uint32_t p, q, version_p, version_q;
};

struct greedy {
    const vec3 *point;
    quadric quadric[N];
    uint32_t version[N], list[N][MOST];
    unsigned degree[N];
    uint8_t gone[N];
    struct pair *heap;
    size_t used, capacity;
    double bias;
};

static int is_before(const struct pair *a, const struct pair *b) {
    if (a->cost != b->cost) return a->cost < b->cost;
    if (a->length_sq != b->length_sq) return a->length_sq < b->length_sq;
    return a->p != b->p ? a->p < b->p : a->q < b->q;
}

static void heap_push(struct greedy *g, struct pair pair) {
    if (g->used == g->capacity) {
        g->capacity = 2 * g->capacity + 1024;
        g->heap = realloc(g->heap, g->capacity * sizeof *g->heap);
    }
    size_t i = g->used++;
    for (; i > 0 && is_before(&pair, &g->heap[(i - 1) / 2]); i = (i - 1) / 2) g->heap[i] = g->heap[(i - 1) / 2];
    g->heap[i] = pair;
}

static struct pair heap_pop(struct greedy *g) {
    struct pair top = g->heap[0], last = g->heap[--g->used];
    size_t i = 0;
    for (size_t child; (child = 2 * i + 1) < g->used; i = child) {
        if (child + 1 < g->used && is_before(&g->heap[child + 1], &g->heap[child])) child++;
        if (!is_before(&g->heap[child], &last)) break;
        g->heap[i] = g->heap[child];
    }
    g->heap[i] = last;
    return top;
}

/* Error with q moved to p. */
static double error_at(const struct greedy *g, uint32_t p, uint32_t q) {
    return fmax(g->quadric[p].c, 0) + quadric_value(&g->quadric[q], vec3_sub(g->point[p], g->point[q]));
}

static void push_pair(struct greedy *g, uint32_t p, uint32_t q) {
    double length_sq = vec3_distance_sq(g->point[p], g->point[q]);
    double cost = fmin(error_at(g, p, q), error_at(g, q, p)) + g->bias * length_sq;
    heap_push(g, (struct pair){cost, length_sq, p, q, g->version[p], g->version[q]});
}

static void unlink_from(struct greedy *g, uint32_t p, uint32_t q) {
    for (unsigned i = 0; i < g->degree[p]; i++)
        if (g->list[p][i] == q) g->list[p][i--] = g->list[p][--g->degree[p]];
}

static void link_to(struct greedy *g, uint32_t p, uint32_t q) {
    unlink_from(g, p, q);
    assert_true(g->degree[p] < MOST);
    g->list[p][g->degree[p]++] = q;
}

static void contract_pair(struct greedy *g, uint32_t stays, uint32_t goes) {
    quadric moved = quadric_shift(g->quadric[goes], vec3_sub(g->point[goes], g->point[stays]));
    g->quadric[stays] = quadric_add(g->quadric[stays], moved);
    g->gone[goes] = 1;
    g->version[stays]++;
    unlink_from(g, stays, goes);
    for (unsigned i = 0; i < g->degree[goes]; i++) {
        uint32_t j = g->list[goes][i];
        if (j == stays) continue;
        unlink_from(g, j, goes);
        link_to(g, j, stays);
        link_to(g, stays, j);
    }
    for (unsigned i = 0; i < g->degree[stays]; i++) push_pair(g, stays, g->list[stays][i]);
}

static struct greedy *greedy_new(const struct start *start) {
    struct greedy *g = calloc(1, sizeof *g);
    struct adjacency near;
    double weight = 0;
    assert_int_equal(adjacency_from(&start->hood, 1, &near), STATUS_OK);
    g->point = start->point;
    for (uint32_t p = 0; p < N; p++) {
        g->quadric[p] = quadric_unpack(&start->quadrics[p]);
        weight += g->quadric[p].weight;
        g->degree[p] = near.degree[p];
        memcpy(g->list[p], &near.list[near.start[p]], near.degree[p] * sizeof *near.list);
    }
    adjacency_done(&near);
    g->bias = LENGTH_BIAS * weight / N;
    for (uint32_t p = 0; p < N; p++)
        for (unsigned i = 0; i < g->degree[p]; i++)
            if (p < g->list[p][i]) push_pair(g, p, g->list[p][i]);
    return g;
}

/* The k points that are left. */
static void greedy_keep(const struct start *start, size_t k, uint32_t *kept) {
    struct greedy *g = greedy_new(start);
    for (size_t left = N; left > k;) {
        assert_true(g->used > 0);
        struct pair x = heap_pop(g);
        if (g->gone[x.p] || g->gone[x.q] || g->version[x.p] != x.version_p || g->version[x.q] != x.version_q) continue;
        bool p_stays = error_at(g, x.p, x.q) <= error_at(g, x.q, x.p);
        contract_pair(g, p_stays ? x.p : x.q, p_stays ? x.q : x.p);
        left--;
    }
    for (uint32_t p = 0, i = 0; p < N; p++)
        if (!g->gone[p]) kept[i++] = p;
    free(g->heap);
    free(g);
}

/* ------------------------------------------------------------------------------------------------ passes */

static double error_of(const struct start *start, const uint32_t *kept, size_t k) {
    struct distance_stats stats;
    assert_int_equal(tangent_error(start->point, start->normal, N, kept, k, 1, &stats), STATUS_OK);
    return stats.mean;
}

static void passes_are_as_exact_as_the_heap(struct start start) {
    static uint32_t kept[N];
    double heap[2], passes[2];
    const size_t counts[2] = {N / 10, N / 20};
    for (int i = 0; i < 2; i++) {
        greedy_keep(&start, counts[i], kept);
        heap[i] = error_of(&start, kept, counts[i]);
    }
    struct contraction contraction;
    struct adjacency near;
    assert_int_equal(adjacency_from(&start.hood, 1, &near), STATUS_OK);
    assert_int_equal(contract(start.point, &near, start.quadrics, &(struct contract_options){1, 1}, NULL, &contraction),
                     STATUS_OK);
    for (int i = 0; i < 2; i++) passes[i] = error_of(&start, &contraction.order[N - counts[i]], counts[i]);
    print_message("mean tangent error, passes against heap: %.4f at 10 %%, %.4f at 5 %%\n", passes[0] / heap[0],
                  passes[1] / heap[1]);
    assert_true(passes[0] <= 1.02 * heap[0] && passes[1] <= 1.02 * heap[1]);
    contraction_done(&contraction);
    start_done(&start);
}

/* ------------------------------------------------------------------------------------------------ surfaces */

static vec3 bumpy(vec3 u) {
    double bumps = 0.08 * sin(7 * u.x) * sin(6 * u.y + 1) * sin(5 * u.z + 2);
    return vec3_scale(u, 0.4 * (1 + bumps));
}

static void on_a_bumpy_sphere(void **state) {
    (void)state;
    vec3 *point = shape_sphere(N, 1);
    for (size_t i = 0; i < N; i++) point[i] = bumpy(point[i]);
    passes_are_as_exact_as_the_heap(start_from(point));
}

static void on_a_surface_with_an_edge_and_noise(void **state) {
    (void)state;
    vec3 *point = shape_sphere(N, 0.4);
    uint64_t random = 3;
    for (size_t i = 0; i < N; i++) {
        if (point[i].z > 0.3) point[i] = vec3_scale(point[i], 0.3 / point[i].z);
        point[i] = vec3_scale(point[i], 1 + 1e-3 * (random_unit(&random) - 0.5));
    }
    passes_are_as_exact_as_the_heap(start_from(point));
}

/* Waves, ever shorter along x, and points at random. */
static void on_waves_sampled_unevenly(void **state) {
    (void)state;
    vec3 *point = malloc(N * sizeof *point);
    uint64_t random = 5;
    for (size_t i = 0; i < N; i++) {
        double x = sqrt(random_unit(&random)), y = random_unit(&random);
        point[i] = (vec3){0.6 * x, 0.6 * y, 0.03 * sin(20 * x * x) * cos(8 * y)};
    }
    passes_are_as_exact_as_the_heap(start_from(point));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(on_a_bumpy_sphere),
        cmocka_unit_test(on_a_surface_with_an_edge_and_noise),
        cmocka_unit_test(on_waves_sampled_unevenly),
    };
    return cmocka_run_group_tests_name("exact", tests, NULL, NULL);
}
