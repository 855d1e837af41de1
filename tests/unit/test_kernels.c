/* Each kernel in all of its forms (core/base/processor.h): for AVX2, for registers of 16 bytes, and its scalar twin.
 * They give the same bits.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/clean/around.h"
#include "core/cloud/cloud.h"
#include "core/math/few.h"
#include "core/math/sym3.h"
#include "core/math/triangle_sides.h"
#include "core/mesh/edge_costs.h"
#include "core/refine/kernels/sample_batch.h"
#include "core/refine/local_delaunay.h"
#include "core/simplify/pair_cost.h"
#include "core/simplify/rank_sort.h"
#include "core/spatial/directions.h"
#include "core/spatial/knn_group.h"
#include "core/surface/sheet/rays.h"
#include "tests/unit/shapes.h"

#ifdef KERNEL_CHOICE
#define KERNEL_FORMS(name) extern __typeof__(name) name##_scalar, name##_base, name##_avx2;
#define FORM(name, form) ((form) == SCALAR ? name##_scalar : (form) == BASE ? name##_base : name##_avx2)
#else
#define KERNEL_FORMS(name) extern __typeof__(name) name##_scalar;
#define FORM(name, form) ((form) == SCALAR ? name##_scalar : name)
#endif

enum form { SCALAR, BASE, AVX2, FORMS };

KERNEL_FORMS(few_of_ranks)
KERNEL_FORMS(around_weigh)
KERNEL_FORMS(around_plane)
KERNEL_FORMS(around_gather)
KERNEL_FORMS(around_turned)
KERNEL_FORMS(around_heights)
KERNEL_FORMS(around_level)
KERNEL_FORMS(around_sum_up)
KERNEL_FORMS(pair_costs)
KERNEL_FORMS(pair_errors)
KERNEL_FORMS(quadric_assemble)
KERNEL_FORMS(rank_sort_ids)
KERNEL_FORMS(sym3_least)
KERNEL_FORMS(directions_set)
KERNEL_FORMS(directions_near_plane)
KERNEL_FORMS(directions_find_plane)
KERNEL_FORMS(edge_costs_find)
KERNEL_FORMS(rays_sines)
KERNEL_FORMS(rays_turned)
KERNEL_FORMS(rays_equations)
KERNEL_FORMS(rays_between)
KERNEL_FORMS(knn_group_nearest)
KERNEL_FORMS(knn_group_narrow)
KERNEL_FORMS(local_delaunay_find)
KERNEL_FORMS(sample_batch_add)
KERNEL_FORMS(sample_batch_weight)
KERNEL_FORMS(sample_batch_cost)
KERNEL_FORMS(sample_batch_star_cost)
KERNEL_FORMS(sample_batch_star_distances)
KERNEL_FORMS(sample_batch_fit)
KERNEL_FORMS(sample_batch_values)
KERNEL_FORMS(sample_batch_owners)
KERNEL_FORMS(sample_batch_nearest)
KERNEL_FORMS(star_vectors_set)
KERNEL_FORMS(star_frames_make)
KERNEL_FORMS(star_may_become)
KERNEL_FORMS(triangle_frames_make)
KERNEL_FORMS(surface_middle)

static bool can_run(enum form form) {
#ifdef KERNEL_CHOICE
    return form != AVX2 || __builtin_cpu_supports("avx2");
#else
    return form != AVX2;
#endif
}

/* What a form has computed, in bytes: the same kernel writes it for each form. */
struct told {
    unsigned char byte[1 << 17];
    size_t n;
};

static void tell(struct told *told, const void *what, size_t bytes) {
    assert_true(told->n + bytes <= sizeof told->byte);
    memcpy(told->byte + told->n, what, bytes);
    told->n += bytes;
}

static void tell_number(struct told *told, double x) { tell(told, &x, sizeof x); }

/* Runs `compute` with every form and the same seed. */
static void check_forms(uint64_t seed, void (*compute)(enum form form, uint64_t seed, struct told *told)) {
    static struct told twin, other;
    twin.n = 0;
    compute(SCALAR, seed, &twin);
    assert_true(twin.n > 0);
    for (enum form form = BASE; form < FORMS; form++) {
        if (!can_run(form)) continue;
        other.n = 0;
        compute(form, seed, &other);
        assert_int_equal(other.n, twin.n);
        assert_memory_equal(other.byte, twin.byte, twin.n);
    }
}

static vec3 random_vec3(uint64_t *seed) {
    double x = random_unit(seed), y = random_unit(seed), z = random_unit(seed);
    return (vec3){x - 0.5, y - 0.5, z - 0.5};
}

/* ------------------------------------------------------------------------------------------------ simplify */

enum { POINTS = 60, K = 13, PAIRS = 203 };

static void tell_pairs(enum form form, uint64_t seed, struct told *told) {
    vec3 point[POINTS] = {{0}};
    struct packed_quadric packed[POINTS];
    for (size_t i = 0; i < POINTS; i++) {
        quadric q = {0};
        if (seed % 2) q.b = random_vec3(&seed), q.c = random_unit(&seed) - 0.3;
        for (int planes = 0; planes < 3; planes++) quadric_add_plane(&q, random_vec3(&seed), random_unit(&seed));
        point[i] = i % 7 ? random_vec3(&seed) : point[i / 2]; /* some stand on each other */
        packed[i] = quadric_pack(&q);
    }
    for (size_t n = 0; n <= PAIRS; n += n < 9 ? 1 : 97) {
        uint32_t p[PAIRS + PAIR_COST_ROOM], q[PAIRS + PAIR_COST_ROOM];
        float cost[PAIRS + PAIR_COST_ROOM];
        double p_stays[PAIRS + PAIR_COST_ROOM], q_stays[PAIRS + PAIR_COST_ROOM];
        for (size_t i = 0; i < n; i++)
            p[i] = (uint32_t)(random_next(&seed) % POINTS), q[i] = (uint32_t)(random_next(&seed) % POINTS);
        for (int untouched = 0; untouched < 2; untouched++) {
            struct pair_field field = {point, packed, untouched, 0.25};
            FORM(pair_costs, form)(&field, p, q, n, cost);
            tell(told, cost, n * sizeof *cost);
        }
        struct pair_field field = {point, packed, false, 0.25};
        FORM(pair_errors, form)(&field, p, q, n, p_stays, q_stays);
        tell(told, p_stays, n * sizeof *p_stays), tell(told, q_stays, n * sizeof *q_stays);
    }
    tell_number(told, (double)seed);
}

static void test_costs_of_pairs(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 6; seed++) check_forms(seed, tell_pairs);
}

static void tell_sorted(enum form form, uint64_t seed, struct told *told) {
    for (unsigned n = 0; n <= 80; n++) {
        uint32_t id[80] = {0};
        for (unsigned i = 0; i < n; i++) id[i] = random_next(&seed) % 9 ? (uint32_t)(random_next(&seed) % 70) : NONE;
        unsigned count = FORM(rank_sort_ids, form)(id, n);
        tell(told, id, count * sizeof *id);
    }
}

static void test_sorting_of_ids(void **state) {
    (void)state;
    check_forms(4, tell_sorted);
}

/* Covariances of few points, down to those of one, of a line and of a plane. */
static void tell_least(enum form form, uint64_t seed, struct told *told) {
    for (unsigned n = 1; n <= SYM3_FEW; n++)
        for (unsigned round = 0; round < 40; round++) {
            sym3 m[SYM3_FEW] = {0};
            double value[SYM3_FEW];
            vec3 vector[SYM3_FEW];
            for (unsigned i = 0; i < n; i++)
                for (unsigned k = 0; k < (round + i) % 5; k++) m[i] = sym3_add(m[i], sym3_outer(random_vec3(&seed)));
            FORM(sym3_least, form)(m, n, value, vector);
            tell(told, value, n * sizeof *value), tell(told, vector, n * sizeof *vector);
        }
}

/* Any number of neighbours, the point itself among them, and some beyond the rim. */
static void tell_around(enum form form, uint64_t seed, struct told *told) {
    for (unsigned n = 0; n <= AROUND_MOST; n++) {
        struct around around = {.n = n};
        double weight[AROUND_MOST];
        for (unsigned i = 0; i < n; i++) {
            vec3 at = i ? random_vec3(&seed) : (vec3){0, 0, 0};
            around.x[i] = at.x, around.y[i] = at.y, around.z[i] = at.z;
        }
        FORM(around_weigh, form)(&around, 0.5);
        FORM(around_plane, form)(&around, random_vec3(&seed), vec3_unit(random_vec3(&seed)), 0.01, weight);
        tell(told, around.near, n * sizeof *around.near), tell(told, weight, n * sizeof *weight);
        FORM(around_level, form)(&around, vec3_unit(random_vec3(&seed)), 0.1, 0.01, weight);
        tell(told, weight, n * sizeof *weight);
    }
}

/* Points, and normals to all sides, of which the ones after the first are its neighbours. */
enum { PLACED = AROUND_MOST };
struct placed {
    vec3 point[PLACED], normal[PLACED];
    uint32_t near[PLACED];
};

static struct around_place place_all(struct placed *placed, uint64_t *seed, unsigned n) {
    for (unsigned i = 0; i < PLACED; i++) {
        placed->point[i] = random_vec3(seed), placed->normal[i] = vec3_unit(random_vec3(seed));
        placed->near[i] = i + 1;
    }
    return (struct around_place){placed->point, placed->normal, placed->near, n, 0, 0.5, 0.3};
}

static void tell_places(enum form form, uint64_t seed, struct told *told) {
    for (unsigned n = 1; n < AROUND_MOST; n++) {
        struct placed placed;
        struct around around;
        const struct around_place place = place_all(&placed, &seed, n);
        FORM(around_gather, form)(&place, n % 2, &around);
        tell(told, &around.n, sizeof around.n), tell(told, around.near, around.n * sizeof *around.near);
        tell(told, around.x, around.n * sizeof *around.x), tell(told, around.z, around.n * sizeof *around.z);
        vec3 turned = FORM(around_turned, form)(&place);
        tell(told, &turned, sizeof turned);
        struct around_heights heights = FORM(around_heights, form)(&place, n % 3 ? 0.2 : INFINITY);
        tell(told, &heights, sizeof heights);
    }
}

static void test_places_of_neighbours(void **state) {
    (void)state;
    check_forms(6, tell_places);
}

/* One neighbour after the other. */
static void test_looks_at_neighbours(void **state) {
    (void)state;
    uint64_t seed = 7;
    for (unsigned n = 1; n < AROUND_MOST; n++) {
        struct placed placed;
        const struct around_place place = place_all(&placed, &seed, n);
        double scale_sq = n % 2 ? 0.2 : INFINITY;
        vec3 sum = {0, 0, 0}, own = placed.normal[0];
        struct around_heights expected = {0, 0, 0};
        for (unsigned i = 1; i <= n; i++) {
            vec3 e = vec3_sub(placed.point[i], placed.point[0]), normal = placed.normal[i];
            if (vec3_dot(normal, own) < 0) normal = vec3_scale(normal, -1);
            double near = fmax(1 - vec3_dot(e, e) / 0.5, 0), apart = vec3_distance_sq(normal, own);
            double w = near * near * pow(0.3 / (0.3 + apart), 2), h = vec3_dot(vec3_add(own, normal), e) / 2;
            sum = vec3_add(sum, vec3_scale(normal, w));
            if (n % 2) w *= pow(scale_sq / (scale_sq + h * h), 2);
            expected.total += w, expected.sum += w * h, expected.sum_sq += w * h * h;
        }
        vec3 turned = around_turned(&place);
        struct around_heights heights = around_heights(&place, scale_sq);
        assert_true(vec3_distance(turned, sum) < 1e-12);
        assert_true(fabs(heights.total - expected.total) < 1e-12 && fabs(heights.sum - expected.sum) < 1e-12);
        assert_true(fabs(heights.sum_sq - expected.sum_sq) < 1e-12);
    }
}

/* One to four points, some with more neighbours than others. */
static void tell_sums(enum form form, uint64_t seed, struct told *told) {
    for (unsigned n = 1; n <= AROUND_FEW; n++)
        for (unsigned round = 0; round < 4; round++) {
            struct around around[AROUND_FEW];
            const double *weight[AROUND_FEW];
            struct around_sums sums[AROUND_FEW];
            for (unsigned i = 0; i < n; i++) {
                around[i].n = 1 + 15 * round + (round % 2 ? i : 0);
                weight[i] = around[i].near;
                for (unsigned k = 0; k < around[i].n; k++) {
                    vec3 at = random_vec3(&seed);
                    around[i].x[k] = at.x, around[i].y[k] = at.y, around[i].z[k] = at.z;
                    around[i].near[k] = random_unit(&seed);
                }
            }
            FORM(around_sum_up, form)(around, weight, n, sums);
            tell(told, sums, n * sizeof *sums);
        }
}

static void test_sums_over_neighbours(void **state) {
    (void)state;
    check_forms(6, tell_sums);
}

static void test_weights_of_neighbours(void **state) {
    (void)state;
    check_forms(6, tell_around);
}

/* Neighbours on two planes, any number of them, and some of these left. */
static void tell_planes(enum form form, uint64_t seed, struct told *told) {
    for (unsigned n = 0; n <= DIRECTIONS_MOST; n++) {
        struct directions d = {.n = n};
        vec3 across[] = {vec3_unit(random_vec3(&seed)), vec3_unit(random_vec3(&seed))}, normal = {0, 0, 0};
        for (unsigned i = 0; i < n; i++) d.to[i] = vec3_unit(vec3_cross(across[i % 2], random_vec3(&seed)));
        FORM(directions_set, form)(&d);
        uint32_t left = (((uint32_t)1 << n) - 1) & ~(uint32_t)(n > 9 ? 0x24 : 0), on[2] = {0, 0};
        on[0] = FORM(directions_near_plane, form)(&d, across[0]);
        bool found = FORM(directions_find_plane, form)(&d, left, &normal, &on[1]);
        assert_true(found || n < 9);
        tell(told, on, sizeof on), tell(told, &normal, sizeof normal), tell(told, &found, sizeof found);
    }
}

static void test_planes_through_neighbours(void **state) {
    (void)state;
    check_forms(7, tell_planes);
}

/* Any number of steps and triples; some points are where they are seen from. */
static void tell_rays(enum form form, uint64_t seed, struct told *told) {
    enum { MOST = 37 };
    for (size_t n = 1; n <= MOST; n++) {
        struct step step[MOST];
        vec3 point[MOST + 2], place = random_vec3(&seed);
        uint32_t of[MOST][3];
        float square[MOST + RAYS_ROOM], found[2];
        double turned[MOST + RAYS_ROOM];
        struct rays_terms terms[MOST];
        size_t few = n < FEW_MOST ? n : FEW_MOST, rank[] = {few / 7, few - 1 - few / 7};
        for (size_t i = 0; i < n + 2; i++) point[i] = i % 11 == 10 ? place : random_vec3(&seed);
        for (uint32_t i = 0; i < n; i++) {
            step[i] = (struct step){point[i], point[i + 1]};
            of[i][0] = i, of[i][1] = i + 1, of[i][2] = i + 2;
        }
        FORM(rays_sines, form)(step, n, place, square);
        for (size_t i = 0; i < n; i++) square[i] = square[i] > 0 ? square[i] : 0; /* or no number */
        FORM(few_of_ranks, form)(square, few, rank, 2, found);
        FORM(rays_turned, form)(point, of, n, place, turned);
        FORM(rays_equations, form)(point, of, n, place, 0.25, terms);
        tell(told, square, n * sizeof *square), tell(told, found, sizeof found);
        tell(told, turned, n * sizeof *turned), tell(told, terms, n * sizeof *terms);
        float at[RAYS_BLOCK];
        int32_t one[RAYS_TOGETHER], opposite[RAYS_TOGETHER];
        for (int i = 0; i < RAYS_BLOCK; i++) at[i] = (float)random_unit(&seed);
        for (int i = 0; i < RAYS_BLOCK; i += RAYS_TOGETHER) at[i] = 0.5F; /* all the same: none on any side */
        FORM(rays_between, form)(at, place, one, opposite);
        assert_true(one[0] == 0 && opposite[0] == 0 && one[1] > 0 && opposite[1] > 0 && one[1] != opposite[1]);
        tell(told, one, sizeof one), tell(told, opposite, sizeof opposite);
    }
}

static void test_rays(void **state) {
    (void)state;
    check_forms(5, tell_rays);
}

static void test_least_eigenvalues(void **state) {
    (void)state;
    check_forms(5, tell_least);
}

static struct error_form random_form(uint64_t *seed, unsigned planes) {
    struct error_form form = {.c = random_unit(seed), .volume = random_unit(seed)};
    for (unsigned k = 0; k < planes; k++) form.a = sym3_add(form.a, sym3_outer(random_vec3(seed)));
    form.b = random_vec3(seed), form.area = random_vec3(seed);
    return form;
}

/* Edges to as many ends as there may be: some at the same place, on a border, that stay, or that have no best place. */
static void tell_edges(enum form form, uint64_t seed, struct told *told) {
    static const struct plane none = {{0, 0, 0}, 0};
    for (unsigned n = 0; n <= EDGE_COSTS_MOST; n++) {
        struct error_form from = random_form(&seed, n % 5), to[EDGE_COSTS_MOST];
        struct plane beside[EDGE_COSTS_MOST];
        struct edge_end end[EDGE_COSTS_MOST];
        vec3 at = random_vec3(&seed), place[EDGE_COSTS_MOST], best[EDGE_COSTS_MOST];
        double cost[EDGE_COSTS_MOST];
        for (unsigned i = 0; i < n; i++) {
            to[i] = random_form(&seed, i % 4);
            beside[i] = i % 3 ? (struct plane){vec3_scale(random_vec3(&seed), 0.1), random_unit(&seed)} : none;
            place[i] = i % 7 ? random_vec3(&seed) : at;
            end[i] = (struct edge_end){&to[i], &place[i], {&beside[i], i % 2 ? NULL : &none}, i % 5 == 4};
        }
        FORM(edge_costs_find, form)(&from, at, end, n, cost, best);
        tell(told, cost, n * sizeof *cost), tell(told, best, n * sizeof *best);
    }
}

static void test_costs_of_edges(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 6; seed++) check_forms(seed, tell_edges);
}

/* Points near a plane, each with others for neighbours, as many as its number says. */
struct scene {
    vec3 point[POINTS], normal[POINTS];
    float weight[POINTS];
    uint32_t id[POINTS * K];
    uint8_t count[POINTS];
    struct neighbourhood neighbours;
};

static void make_scene(struct scene *s, uint64_t *seed) {
    for (size_t p = 0; p < POINTS; p++) {
        s->point[p] = random_vec3(seed);
        s->point[p].z *= 0.1;
        s->normal[p] = vec3_unit(vec3_add((vec3){0, 0, 2}, random_vec3(seed)));
        s->weight[p] = (float)random_unit(seed);
        s->count[p] = (uint8_t)(p % (K + 1));
        size_t step = 1 + random_next(seed) % 4; /* 60 has no neighbour twice for K steps of up to 4 */
        for (size_t i = 0; i < K; i++) s->id[p * K + i] = (uint32_t)((p + (i + 1) * step) % POINTS);
    }
    s->neighbours = (struct neighbourhood){.n = POINTS, .stride = K, .id = s->id, .count = s->count};
}

static void tell_quadrics(enum form form, uint64_t seed, struct told *told) {
    struct scene s;
    struct packed_quadric packed[POINTS];
    make_scene(&s, &seed);
    for (int by_area = 0; by_area < 2; by_area++) {
        struct quadric_options options = {by_area ? AREA_AREA : AREA_UNIT, 1e-3, 1};
        FORM(quadric_assemble, form)(s.point, s.normal, &s.neighbours, s.weight, &options, packed);
        tell(told, packed, sizeof packed);
    }
}

static void test_quadrics(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 4; seed++) check_forms(seed, tell_quadrics);
}

/* ------------------------------------------------------------------------------------------------ spatial */

static void tell_nearest(enum form form, uint64_t seed, struct told *told) {
    for (unsigned count = 9; count <= 200; count += 19) {
        static struct knn_group group, narrow;
        group = (struct knn_group){.count = count, .radius = 1};
        for (unsigned i = 0; i < count; i++) {
            vec3 p = random_vec3(&seed);
            if (seed % 3 == 0) p = (vec3){round(4 * p.x) / 4, round(4 * p.y) / 4, round(4 * p.z) / 4}; /* equally far */
            group.x[i] = p.x, group.y[i] = p.y, group.z[i] = p.z, group.id[i] = i ^ 5;
        }
        for (unsigned round = 0; round < 4; round++) {
            uint32_t id[8] = {0};
            double distance_sq[8] = {0};
            vec3 query = vec3_scale(random_vec3(&seed), 0.3);
            bool found = FORM(knn_group_nearest, form)(&group, query, 1 + count % 8, 0.2, id, distance_sq);
            tell(told, &found, sizeof found), tell(told, id, sizeof id), tell(told, distance_sq, sizeof distance_sq);
            if (!FORM(knn_group_narrow, form)(&group, &query, 1, 0.3, &narrow)) continue;
            tell(told, narrow.id, narrow.count * sizeof *narrow.id);
        }
    }
}

static void test_nearest_of_a_group(void **state) {
    (void)state;
    check_forms(6, tell_nearest);
}

/* ------------------------------------------------------------------------------------------------ refine */

static void tell_local_delaunay(enum form form, uint64_t seed, struct told *told) {
    struct scene s;
    struct local_delaunay local_delaunay = {0};
    make_scene(&s, &seed);
    assert_int_equal(FORM(local_delaunay_find, form)(s.point, s.normal, &s.neighbours, NULL, 1, &local_delaunay),
                     STATUS_OK);
    tell(told, local_delaunay.rib, POINTS * sizeof *local_delaunay.rib);
    tell(told, local_delaunay.closed, POINTS * sizeof *local_delaunay.closed);
    tell(told, local_delaunay.votes, POINTS * sizeof *local_delaunay.votes);
    local_delaunay_done(&local_delaunay);
}

static void test_local_delaunay(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 4; seed++) check_forms(seed, tell_local_delaunay);
}

static void check_hit(const struct triangle_frame *frame, vec3 place) {
    struct triangle_sides sides = triangle_sides_of(frame);
    struct triangle_hit hit = triangle_sides_hit(&sides, place), twin = triangle_frame_hit(frame, place);
    assert_memory_equal(&hit.distance_sq, &twin.distance_sq, sizeof hit.distance_sq);
    assert_int_equal(hit.feature, twin.feature);
    assert_int_equal(hit.corner, twin.corner);
}

/* Places all around, on the corners and on the edges, of triangles with and without area. */
static void test_distance_to_one_triangle(void **state) {
    (void)state;
    uint64_t seed = 3;
    size_t features[3] = {0};
    for (int round = 0; round < 400; round++) {
        vec3 a = random_vec3(&seed), b = random_vec3(&seed), c = random_vec3(&seed);
        if (round % 7 == 1) b = a;
        if (round % 7 == 2) c = a;
        if (round % 7 == 3) c = b;
        if (round % 7 == 4) c = vec3_lerp(a, b, 0.5);
        if (round % 49 == 5) b = c = a;
        struct triangle_frame frame = triangle_frame_of(a, b, c);
        const vec3 own[] = {a, b, c, vec3_lerp(a, b, 0.5), vec3_lerp(b, c, 0.25), triangle_frame_middle(&frame)};
        for (size_t i = 0; i < sizeof own / sizeof *own; i++) check_hit(&frame, own[i]);
        for (int i = 0; i < 20; i++) {
            vec3 place = vec3_scale(random_vec3(&seed), i < 10 ? 1 : 4);
            check_hit(&frame, place);
            features[triangle_frame_hit(&frame, place).feature]++;
        }
    }
    for (int i = 0; i < 3; i++) assert_true(features[i] > 100);
}

/* n samples, by way of a list. */
static void gather(enum form form, uint64_t *seed, uint32_t n, struct sample_batch *batch) {
    struct sample_buckets lists;
    uint32_t spare = NONE;
    assert_int_equal(sample_buckets_init(&lists, 1, n, 1), STATUS_OK);
    for (uint32_t i = 0; i < n; i++) {
        struct sample sample = {.place = random_vec3(seed), .weight = 0.5f + (float)random_unit(seed)};
        sample_buckets_add(&lists, 0, i, &sample, &spare);
    }
    sample_batch_clear(batch, (vec3){0.1, 0.05, -0.1});
    assert_int_equal(FORM(sample_batch_add, form)(batch, lists.block, lists.first[0]), NONE);
    sample_buckets_done(&lists);
}

/* Some of the triangles are without area, whichever edge has no length. */
static struct surface make_surface(enum form form, uint64_t *seed, size_t n, struct triangle_frames *frames,
                                   struct told *told) {
    vec3 corner[FRAMES_MOST][3];
    struct triangle_corners corners[FRAMES_MOST];
    for (size_t i = 0; i < n; i++) {
        for (int k = 0; k < 3; k++) corner[i][k] = random_vec3(seed);
        if (i % 5 == 3) corner[i][i % 3] = corner[i][(i + 1) % 3];
        corners[i] = (struct triangle_corners){&corner[i][0], &corner[i][1], &corner[i][2]};
    }
    struct surface surface = FORM(triangle_frames_make, form)(frames, corners, n);
    for (size_t i = 0; i < n; i++) {
        vec3 middle = FORM(surface_middle, form)(&surface, i), normal = surface_normal(&surface, i);
        tell(told, &middle, sizeof middle), tell(told, &normal, sizeof normal);
        tell_number(told, surface_shape(&surface, i));
    }
    return surface;
}

static void tell_surface(enum form form, uint64_t seed, struct told *told) {
    for (uint32_t n = 1; n <= 120; n += 17) {
        static struct sample_batch batch;
        struct triangle_frames frames;
        uint8_t owner[SAMPLE_BATCH_ROOM];
        float distance_sq[SAMPLE_BATCH_ROOM], value[SAMPLE_BATCH_ROOM];
        double nearest_sq = INFINITY;
        uint32_t nearest = NONE;
        gather(form, &seed, n, &batch);
        struct surface surface = make_surface(form, &seed, 1 + n % 12, &frames, told);
        if (surface.n > 3) surface.first = 1, surface.n -= 2; /* the frames of a part */
        tell_number(told, FORM(sample_batch_weight, form)(&batch));
        double cost = FORM(sample_batch_cost, form)(&batch, &surface, 2, INFINITY);
        tell_number(told, cost), tell_number(told, FORM(sample_batch_cost, form)(&batch, &surface, 2, cost / 3));
        FORM(sample_batch_owners, form)(&batch, &surface, owner, distance_sq);
        tell(told, owner, n), tell(told, distance_sq, n * sizeof *distance_sq);
        sym3 a = sym3_outer(random_vec3(&seed));
        FORM(sample_batch_values, form)(&batch, &a, random_vec3(&seed), 40, value);
        tell(told, value, n * sizeof *value);
        FORM(sample_batch_nearest, form)(&batch, random_vec3(&seed), &nearest_sq, &nearest);
        tell_number(told, nearest_sq), tell_number(told, nearest);
    }
}

static void test_samples_and_triangles(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 4; seed++) check_forms(seed, tell_surface);
}

/* Two samples as near as each other: which one is told doesn't depend on the width either. */
static void tell_nearest_of_equals(enum form form, uint64_t seed, struct told *told) {
    static struct sample_batch batch;
    gather(form, &seed, 40, &batch);
    for (uint32_t i = 0; i < 40; i++) batch.x[i] = batch.y[i] = batch.z[i] = i % 6 == seed % 6 ? 0 : 1;
    double nearest_sq = INFINITY;
    uint32_t nearest = NONE;
    FORM(sample_batch_nearest, form)(&batch, batch.origin, &nearest_sq, &nearest);
    tell_number(told, nearest_sq), tell_number(told, nearest);
}

static void test_samples_that_are_equally_near(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 12; seed++) check_forms(seed, tell_nearest_of_equals);
}

/* Around a vertex; spokes of no length and double ones among them. */
static void make_star(enum form form, uint64_t *seed, size_t n, vec3 place, struct star_frames *star,
                      struct told *told) {
    vec3 rim[STAR_MOST];
    const vec3 *corner[STAR_MOST];
    struct star_rim flat = {.n = n, .open = n % 3 == 1};
    for (size_t i = 0; i < n; i++) {
        double angle = 6.28 * (double)i / (double)n;
        rim[i] = i % 11 == 7 ? place : i % 13 == 9 ? rim[i - 1] : (vec3){cos(angle), sin(angle), random_unit(seed)};
        corner[i] = &rim[i];
    }
    if (flat.open) corner[n] = &rim[0];
    FORM(star_vectors_set, form)(&flat.place, corner, n + flat.open, (vec3){0});
    FORM(star_frames_make, form)(star, &flat, place);
    tell(told, star->shape, n * sizeof *star->shape), tell(told, star->normal.x, n * sizeof *star->normal.x);
    tell(told, star->normal.z, n * sizeof *star->normal.z);
}

static void tell_star(enum form form, uint64_t seed, struct told *told) {
    for (size_t n = 3; n <= STAR_MOST; n++) {
        static struct sample_batch batch;
        struct star_frames star, moved;
        struct star_vectors outside = {0};
        struct sample_batch_model model = {0};
        float distance_sq[SAMPLE_BATCH_ROOM];
        size_t begin[STAR_MOST + 1] = {0};
        uint64_t same = seed;
        make_star(form, &seed, n, (vec3){0.1, 0, 0}, &star, told);
        make_star(form, &same, n, (vec3){0.12, 0.02, 0.01}, &moved, told);
        gather(form, &seed, (uint32_t)(5 * n), &batch);
        for (size_t k = 0; k < n; k++) begin[k + 1] = begin[k] + random_next(&seed) % 9 % (5 * n - begin[k] + 1);
        begin[n] = batch.n;
        bool may =
            FORM(star_may_become, form)(&star, &moved, &outside, (struct star_limits){.turn = 0.5f, .thin = 0.02f});
        double cost = FORM(sample_batch_star_cost, form)(&batch, &star, 2, INFINITY);
        tell_number(told, may), tell_number(told, cost);
        tell_number(told, FORM(sample_batch_star_cost, form)(&batch, &star, 2, cost / 3));
        FORM(sample_batch_star_distances, form)(&batch, &star, distance_sq);
        tell(told, distance_sq, batch.n * sizeof *distance_sq);
        FORM(sample_batch_fit, form)(&batch, begin, &star, 0.01f, 2, &model);
        tell(told, &model, sizeof model);
    }
}

static void test_stars(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 4; seed++) check_forms(seed, tell_star);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_costs_of_pairs),
        cmocka_unit_test(test_sorting_of_ids),
        cmocka_unit_test(test_weights_of_neighbours),
        cmocka_unit_test(test_places_of_neighbours),
        cmocka_unit_test(test_looks_at_neighbours),
        cmocka_unit_test(test_sums_over_neighbours),
        cmocka_unit_test(test_rays),
        cmocka_unit_test(test_planes_through_neighbours),
        cmocka_unit_test(test_least_eigenvalues),
        cmocka_unit_test(test_costs_of_edges),
        cmocka_unit_test(test_quadrics),
        cmocka_unit_test(test_nearest_of_a_group),
        cmocka_unit_test(test_local_delaunay),
        cmocka_unit_test(test_distance_to_one_triangle),
        cmocka_unit_test(test_samples_and_triangles),
        cmocka_unit_test(test_samples_that_are_equally_near),
        cmocka_unit_test(test_stars),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
