/* Refinement: tiny meshes with one right answer, then what must hold on a sphere.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/alloc.h"
#include "core/cloud.h"
#include "core/cluster.h"
#include "core/fit_assign.h"
#include "core/knn.h"
#include "core/refine.h"
#include "core/samples.h"
#include "tests/unit/shapes.h"

/* ---------------------------------------------------------------------------------------------- inputs */

struct dense {
    size_t n;
    vec3 *point, *normal;
    float *spacing;
};

static struct dense dense_new(size_t n) {
    struct dense dense = {n, calloc(n, sizeof(vec3)), calloc(n, sizeof(vec3)), calloc(n, sizeof(float))};
    assert_true(dense.point && dense.normal && dense.spacing);
    return dense;
}

static void dense_done(struct dense *dense) { free(dense->point), free(dense->normal), free(dense->spacing); }

static struct refine_input input_of(const struct dense *dense) {
    return (struct refine_input){dense->point, dense->normal, dense->spacing, dense->n, NULL};
}

/* The height field z = f over the unit square, side x side points. */
static struct dense field(size_t side, double (*f)(double x, double y)) {
    struct dense dense = dense_new(side * side);
    for (size_t i = 0; i < side * side; i++) {
        double x = (double)(i % side) / (double)(side - 1), y = (double)(i / side) / (double)(side - 1), e = 1e-6;
        dense.point[i] = (vec3){x, y, f(x, y)};
        dense.normal[i] =
            vec3_unit((vec3){(f(x - e, y) - f(x + e, y)) / (2 * e), (f(x, y - e) - f(x, y + e)) / (2 * e), 1});
        dense.spacing[i] = 1.0f / (float)(side - 1);
    }
    return dense;
}

static double flat(double x, double y) { return 0 * x * y; }
static double roof(double x, double y) { return 0.3 * (1 - fabs(x - y)); } /* a ridge along the diagonal x = y */
static double tent(double x, double y) { return 0.5 - fmax(fabs(x - 0.5), fabs(y - 0.5)); }

static struct mesh mesh_new(const vec3 *vertex, size_t vertices, const uint32_t (*triangle)[3], size_t triangles) {
    struct mesh mesh = {.vertex_count = vertices, .triangle_count = triangles};
    mesh.vertex = alloc_array(vertices, sizeof *mesh.vertex);
    mesh.triangle = alloc_array(triangles, sizeof *mesh.triangle);
    mesh.source = alloc_array(vertices, sizeof *mesh.source);
    assert_true(mesh.vertex && mesh.triangle && mesh.source);
    memcpy(mesh.vertex, vertex, vertices * sizeof *vertex);
    memcpy(mesh.triangle, triangle, triangles * sizeof *triangle);
    memset(mesh.source, 0xff, vertices * sizeof *mesh.source);
    return mesh;
}

static void refine(struct mesh *mesh, const struct dense *dense, enum refine_form form, enum placement placement,
                   struct refine_facts *facts) {
    struct refine_input input = input_of(dense);
    struct refine_options options = {form, placement, 2};
    assert_int_equal(refine_mesh(mesh, &input, &options, NULL, facts), STATUS_OK);
}

static bool has_edge(const struct mesh *mesh, uint32_t a, uint32_t b) {
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            if (mesh->triangle[t][k] == a && mesh->triangle[t][(k + 1) % 3] == b) return true;
    return false;
}

/* ---------------------------------------------------------------------------------------------- kernels */

/* A cluster of n samples, by way of a list. */
static void gather(struct cluster *cluster, vec3 origin, const struct sample *sample, uint32_t n) {
    struct sample_lists lists;
    uint32_t spare = NONE;
    assert_int_equal(sample_lists_init(&lists, 1, n, 1), STATUS_OK);
    for (uint32_t i = 0; i < n; i++) sample_lists_add(&lists, 0, i, &sample[i], &spare);
    cluster_clear(cluster, origin);
    assert_int_equal(cluster_add(cluster, lists.block, lists.first[0]), NONE);
    assert_int_equal(cluster->n, n);
    sample_lists_done(&lists);
}

static void random_samples(uint64_t *seed, double from, double extent, struct sample *sample, size_t n) {
    for (size_t i = 0; i < n; i++) {
        vec3 place = {from + extent * random_unit(seed), from + extent * random_unit(seed),
                      from + extent * random_unit(seed)};
        sample[i] = (struct sample){.place = place, .weight = 0.5f + (float)random_unit(seed)};
    }
}

/* The kernels against the distance to one triangle after the other, in double. */
static void check_cluster(const struct sample *sample, uint32_t n, const struct triangle_frame *frame, size_t frames) {
    static struct cluster cluster;
    uint8_t owner[CLUSTER_ROOM];
    float distance_sq[CLUSTER_ROOM];
    double cost = 0;
    gather(&cluster, (vec3){0.3, 0.4, 0.5}, sample, n);
    cluster_owners(&cluster, frame, frames, owner, distance_sq);
    for (size_t i = 0; i < n; i++) {
        const struct sample *this = &sample[cluster.sample[i]];
        double nearest_sq = INFINITY;
        for (size_t j = 0; j < frames; j++)
            nearest_sq = fmin(nearest_sq, triangle_frame_hit(&frame[j], this->place).distance_sq);
        double tolerance = 1e-5 * (1 + nearest_sq);
        assert_true(fabs((double)distance_sq[i] - nearest_sq) < tolerance);
        assert_true(triangle_frame_hit(&frame[owner[i]], this->place).distance_sq < nearest_sq + tolerance);
        cost += (double)this->weight * (sqrt(nearest_sq) + 2 * nearest_sq);
    }
    assert_true(fabs(cluster_cost(&cluster, frame, frames, 2, INFINITY) - cost) < 1e-4 * cost);
    double part = cluster_cost(&cluster, frame, frames, 2, cost / 2);
    assert_true(part > cost / 2 && part <= 1.0001 * cost);
}

static void test_eight_at_a_time_is_one_at_a_time(void **state) {
    (void)state;
    uint64_t seed = 7;
    static struct sample sample[461];
    for (uint32_t n = 1; n <= 461; n += 23) {
        struct triangle_frame frame[3];
        for (int i = 0; i < 3; i++) {
            vec3 corner[3];
            for (int k = 0; k < 3; k++) corner[k] = (vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)};
            frame[i] = triangle_frame_of(corner[0], corner[1], corner[2]);
        }
        random_samples(&seed, -0.5, 2, sample, n);
        check_cluster(sample, n, frame, 3);
    }
}

/* Points, segments and slivers for triangles; samples on their corners and edges, and far away. */
static void test_distances_to_degenerate_triangles(void **state) {
    (void)state;
    static const vec3 corner[][3] = {
        {{0.1, 0.2, 0.3}, {0.1, 0.2, 0.3}, {0.1, 0.2, 0.3}}, /* a point */
        {{0, 0, 0}, {0, 0, 0}, {1, 0, 0}},                   /* segments, whichever edge has no length */
        {{0, 0, 0}, {1, 0, 0}, {1, 0, 0}},
        {{0, 0, 0}, {0, 1, 0}, {0, 0, 0}},
        {{0, 0, 0}, {1, 0, 0}, {0.5, 0, 0}}, /* corners in line, in either order */
        {{0, 0, 0}, {0.5, 0, 0}, {1, 0, 0}},
        {{0, 0, 0}, {1, 0, 0}, {0.5, 1e-7, 0}}, /* a sliver */
    };
    uint64_t seed = 5;
    static struct sample sample[64];
    random_samples(&seed, -1, 3, sample, 64);
    for (int k = 0; k < 3; k++) sample[k].place = corner[4][k];
    sample[3].place = (vec3){2, 0, 0}, sample[4].place = (vec3){-1, 0, 0}, sample[5].place = (vec3){0.25, 0, 0};
    sample[6].place = (vec3){1e5, 1e5, -1e5};
    for (size_t i = 0; i < sizeof corner / sizeof *corner; i++) {
        struct triangle_frame frame = triangle_frame_of(corner[i][0], corner[i][1], corner[i][2]);
        check_cluster(sample, 64, &frame, 1);
        if (i > 0) assert_true(triangle_frame_hit(&frame, (vec3){2, 0, 0}).distance_sq > 0.99);
    }
}

/* The seven regions around a triangle. */
static void test_where_on_a_triangle_is_nearest(void **state) {
    (void)state;
    struct triangle_frame frame = triangle_frame_of((vec3){0, 0, 0}, (vec3){4, 0, 0}, (vec3){1, 3, 0});
    static const struct {
        vec3 place;
        enum triangle_feature feature;
        uint8_t corner;
        double distance_sq;
    } expect[] = {
        {{1.5, 1, 2}, TRIANGLE_INSIDE, 0, 4}, {{2, -3, 1}, TRIANGLE_EDGE, 0, 10},   {{4, 3, 0}, TRIANGLE_EDGE, 1, 4.5},
        {{-1, 2, 0}, TRIANGLE_EDGE, 2, 2.5},  {{-1, -1, 0}, TRIANGLE_CORNER, 0, 2}, {{6, 0, 0}, TRIANGLE_CORNER, 1, 4},
        {{1, 5, 1}, TRIANGLE_CORNER, 2, 5},
    };
    for (size_t i = 0; i < sizeof expect / sizeof *expect; i++) {
        struct triangle_hit hit = triangle_frame_hit(&frame, expect[i].place);
        assert_int_equal(hit.feature, expect[i].feature);
        assert_int_equal(hit.corner, expect[i].corner);
        assert_true(fabs(hit.distance_sq - expect[i].distance_sq) < 1e-12);
    }
}

/* The nearest of the samples, and values of a quadric, against one sample after the other. */
static void test_nearest_and_values(void **state) {
    (void)state;
    uint64_t seed = 3;
    static struct sample sample[77];
    static struct cluster cluster;
    float value[CLUSTER_ROOM];
    const sym3 a = {2, 0.3, -0.4, 1, 0.2, 3};
    const vec3 place = {0.4, 0.1, 0.7};
    random_samples(&seed, 0, 1, sample, 77);
    gather(&cluster, (vec3){0.5, 0.5, 0.5}, sample, 77);
    cluster_values(&cluster, &a, place, value);
    double nearest_sq = INFINITY, least_sq = INFINITY, weight = 0;
    uint32_t nearest = NONE;
    cluster_nearest(&cluster, place, &nearest_sq, &nearest);
    for (size_t i = 0; i < 77; i++) {
        vec3 s = vec3_sub(sample[cluster.sample[i]].place, place);
        least_sq = fmin(least_sq, vec3_length_sq(s));
        weight += (double)sample[i].weight;
        assert_true(fabs(vec3_dot(s, sym3_mul(a, s)) - (double)value[i]) < 1e-5);
    }
    assert_true(fabs(nearest_sq - least_sq) < 1e-5);
    assert_true(fabs(vec3_distance_sq(sample[nearest].place, place) - least_sq) < 1e-5);
    assert_true(fabs(cluster_weight(&cluster) - weight) < 1e-4);
}

/* The quadric's linear part is how the cost changes when the corner moves: against differences. */
static void test_model_is_the_slope_of_the_cost(void **state) {
    (void)state;
    uint64_t seed = 11;
    static struct sample sample[29];
    static struct cluster cluster;
    vec3 a = {0.1, 0, 0}, b = {1, 0.1, 0}, c = {0.2, 1.1, 0.2};
    for (uint32_t i = 0; i < 29; i++) {
        vec3 place = {1.4 * random_unit(&seed) - 0.3, 1.4 * random_unit(&seed) - 0.3, 0.3 + random_unit(&seed)};
        sample[i] = (struct sample){.place = place, .weight = 1};
    }
    gather(&cluster, a, sample, 29);
    struct triangle_frame frame = triangle_frame_of(a, b, c);
    struct cluster_model model = {0};
    cluster_fit_corner(&cluster, 0, 13, &frame, 1e-6f, 0, &model);
    cluster_fit_corner(&cluster, 13, 29, &frame, 1e-6f, 0, &model);
    vec3 step[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int k = 0; k < 3; k++) {
        double h = 1e-2;
        struct triangle_frame ahead = triangle_frame_of(vec3_add(a, vec3_scale(step[k], h)), b, c);
        struct triangle_frame behind = triangle_frame_of(vec3_sub(a, vec3_scale(step[k], h)), b, c);
        double slope =
            (cluster_cost(&cluster, &ahead, 1, 0, INFINITY) - cluster_cost(&cluster, &behind, 1, 0, INFINITY)) /
            (2 * h);
        assert_true(fabs(slope + vec3_dot(model.g, step[k])) < 0.02);
    }
}

/* Lists that are emptied and filled in turns never need more blocks than there are, and lose nothing. */
static void test_lists_are_filled_again(void **state) {
    (void)state;
    enum { LISTS = 5, SAMPLES = 203 };
    static struct sample sample[SAMPLES];
    uint64_t seed = 9;
    struct sample_lists lists;
    uint32_t spare = NONE;
    random_samples(&seed, 0, 1, sample, SAMPLES);
    assert_int_equal(sample_lists_init(&lists, LISTS, SAMPLES, 1), STATUS_OK);
    for (uint32_t i = 0; i < SAMPLES; i++) sample_lists_add(&lists, i % LISTS, i, &sample[i], &spare);
    for (int round = 0; round < 100; round++) {
        uint32_t from = (uint32_t)(random_unit(&seed) * LISTS), to = (uint32_t)(random_unit(&seed) * LISTS);
        uint32_t id[SAMPLES], count = 0;
        spare = sample_lists_take(&lists, from);
        assert_int_equal(lists.first[from], NONE);
        for (uint32_t b = spare; b != NONE; b = lists.block[b].next)
            for (uint32_t i = 0; i < lists.block[b].count; i++) id[count++] = lists.block[b].sample[i];
        for (uint32_t i = 0; i < count; i++) sample_lists_add(&lists, i % 2 ? to : from, id[i], &sample[id[i]], &spare);
        sample_lists_give(&lists, spare);
        assert_true(lists.fresh <= SAMPLES / SAMPLE_BLOCK + LISTS);
    }
    bool seen[SAMPLES] = {false};
    for (size_t k = 0; k < LISTS; k++)
        for (uint32_t b = lists.first[k]; b != NONE; b = lists.block[b].next)
            for (uint32_t i = 0; i < lists.block[b].count; i++) seen[lists.block[b].sample[i]] = true;
    for (size_t i = 0; i < SAMPLES; i++) assert_true(seen[i]);
    sample_lists_done(&lists);
}

/* ---------------------------------------------------------------------------------------------- samples */

static struct neighbourhood hood_of(const struct dense *dense) {
    struct knn *knn = NULL;
    struct error error;
    struct neighbourhood hood;
    struct neighbourhood_options options = {3, 6, 16, 1};
    assert_int_equal(knn_new(dense->point, dense->n, &knn, &error), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, dense->point, dense->n, &options, &hood), STATUS_OK);
    knn_free(knn);
    return hood;
}

/* A square has no diagonal of its own: each of its corners sees the triangle that it is a corner of. */
static void test_middles_of_a_grid_are_those_of_its_corners(void **state) {
    (void)state;
    struct dense dense = field(5, flat);
    struct neighbourhood hood = hood_of(&dense);
    struct refine_input input = input_of(&dense);
    struct samples samples;
    size_t points = 0, beside[16] = {0};
    input.hood = &hood;
    assert_int_equal(samples_init(&samples, &input, true, 2), STATUS_OK);
    assert_int_equal(samples.n, 25 + 4 * 16);
    for (size_t i = 0; i < samples.n; i++) {
        vec3 p = vec3_scale(samples.sample[i].place, 4);
        points += samples_point(&samples, (uint32_t)i) != NONE;
        if (samples_point(&samples, (uint32_t)i) != NONE) continue;
        beside[(size_t)p.x + 4 * (size_t)p.y]++;
        assert_true(fabs(fabs(p.x - floor(p.x) - 0.5) - 1.0 / 6) < 1e-6);
        assert_true(fabs(fabs(p.y - floor(p.y) - 0.5) - 1.0 / 6) < 1e-6);
        assert_true(samples.sample[i].weight > 0 && samples.sample[i].weight == samples.sample[25].weight);
    }
    assert_int_equal(points, 25);
    for (size_t i = 0; i < 16; i++) assert_int_equal(beside[i], 4);
    samples_done(&samples);
    neighbourhood_done(&hood);
    dense_done(&dense);
}

/* A roof over a triangular lattice, whose edges the ridge is one of. */
static struct dense lattice_roof(size_t side, double slope) {
    struct dense dense = dense_new(side * side);
    for (size_t i = 0; i < side * side; i++) {
        double row = (double)(i / side) - (double)(side / 2);
        double x = (double)(i % side) + row / 2, y = row * sqrt(0.75), across = 1 / sqrt(1 + slope * slope);
        dense.point[i] = (vec3){x, y * across, -fabs(y) * slope * across};
        dense.normal[i] = vec3_unit((vec3){0, row > 0 ? slope : row < 0 ? -slope : 0, 1});
        dense.spacing[i] = 1;
    }
    return dense;
}

/* Two triangles for each rhombus, one sample each: an edge of 90 degrees has none that cuts across it, since it is
 * unfolded. */
static void test_middles_beside_a_sharp_edge_lie_on_its_faces(void **state) {
    (void)state;
    enum { SIDE = 9, RHOMBI = (SIDE - 1) * (SIDE - 1) };
    struct dense dense = lattice_roof(SIDE, 1);
    struct neighbourhood hood = hood_of(&dense);
    struct refine_input input = input_of(&dense);
    struct samples samples;
    double middles = 0, one = 0;
    input.hood = &hood;
    assert_int_equal(samples_init(&samples, &input, true, 2), STATUS_OK);
    for (size_t i = 0; i < samples.n; i++) {
        vec3 p = samples.sample[i].place;
        assert_true(fabs(p.z + fabs(p.y)) < 1e-9);
        if (samples_point(&samples, (uint32_t)i) != NONE) continue;
        middles += (double)samples.sample[i].weight;
        one = fmax(one, (double)samples.sample[i].weight);
    }
    assert_true(fabs(middles / one - 2.0 * RHOMBI) < 0.1 * RHOMBI);
    samples_done(&samples);
    neighbourhood_done(&hood);
    dense_done(&dense);
}

/* Two parallel sheets, nearer to each other than their points are to one another. */
static void test_no_middle_lies_across_a_gap(void **state) {
    (void)state;
    struct dense sheet = field(6, flat), dense = dense_new(72);
    for (size_t i = 0; i < 72; i++) {
        dense.point[i] = sheet.point[i % 36];
        dense.point[i].z = i < 36 ? 0 : 0.15;
        dense.normal[i] = (vec3){0, 0, 1};
        dense.spacing[i] = 0.2f;
    }
    struct neighbourhood hood = hood_of(&dense);
    struct refine_input input = input_of(&dense);
    struct samples samples;
    input.hood = &hood;
    assert_int_equal(samples_init(&samples, &input, true, 2), STATUS_OK);
    assert_true(samples.n > 72);
    for (size_t i = 0; i < samples.n; i++) {
        double z = samples.sample[i].place.z;
        assert_true(z == 0 || fabs(z - 0.15) < 1e-12);
    }
    samples_done(&samples);
    neighbourhood_done(&hood);
    dense_done(&sheet);
    dense_done(&dense);
}

/* ---------------------------------------------------------------------------------------------- tiny meshes */

static const vec3 square[4] = {{0, 0, 0.3}, {1, 0, 0}, {1, 1, 0.3}, {0, 1, 0}};

static void test_wrong_diagonal_flips(void **state) {
    (void)state;
    static const uint32_t wrong[2][3] = {{0, 1, 3}, {1, 2, 3}};
    struct dense dense = field(9, roof);
    struct mesh mesh = mesh_new(square, 4, wrong, 2);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FLIPS, PLACEMENT_SUBSET, &facts);
    assert_int_equal(facts.flips, 1);
    assert_true(has_edge(&mesh, 0, 2) && has_edge(&mesh, 2, 0));
    assert_true(facts.mean_before > 0.05 && facts.mean_after < 1e-6);
    mesh_done(&mesh);
    dense_done(&dense);
}

static void test_right_diagonal_stays(void **state) {
    (void)state;
    static const uint32_t right[2][3] = {{0, 1, 2}, {0, 2, 3}};
    struct dense dense = field(9, roof);
    struct mesh mesh = mesh_new(square, 4, right, 2);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FLIPS, PLACEMENT_SUBSET, &facts);
    assert_int_equal(facts.flips, 0);
    assert_true(has_edge(&mesh, 0, 2));
    mesh_done(&mesh);
    dense_done(&dense);
}

static void test_flat_is_left_alone(void **state) {
    (void)state;
    static const vec3 corner[5] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0.4, 0.6, 0}};
    static const uint32_t fan[4][3] = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
    struct dense dense = field(9, flat);
    struct mesh mesh = mesh_new(corner, 5, fan, 4);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FULL, PLACEMENT_OPTIMAL, &facts);
    assert_int_equal(facts.flips + facts.moves + facts.teleports, 0);
    assert_true(vec3_equal(mesh.vertex[4], corner[4]));
    mesh_done(&mesh);
    dense_done(&dense);
}

/* A pyramid whose tip stands beside the data's: it must come back, and the base, a boundary, must stay. */
static void pull_tip(enum placement placement, double tolerance) {
    static const vec3 corner[5] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0.62, 0.44, 0.38}};
    static const uint32_t fan[4][3] = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
    struct dense dense = field(17, tent);
    struct mesh mesh = mesh_new(corner, 5, fan, 4);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FULL, placement, &facts);
    assert_true(facts.moves > 0);
    assert_true(vec3_distance(mesh.vertex[4], (vec3){0.5, 0.5, 0.5}) < tolerance);
    for (int v = 0; v < 4; v++) assert_true(vec3_equal(mesh.vertex[v], corner[v]));
    if (placement == PLACEMENT_SUBSET) {
        assert_int_equal(mesh.source[4], 8 * 17 + 8);
        assert_true(facts.mean_after < 1e-6);
    }
    if (placement == PLACEMENT_OPTIMAL) assert_int_equal(mesh.source[4], NONE);
    mesh_done(&mesh);
    dense_done(&dense);
}

static void test_tip_moves_to_the_point(void **state) {
    (void)state;
    pull_tip(PLACEMENT_SUBSET, 1e-12);
}

static void test_tip_moves_to_the_best_place(void **state) {
    (void)state;
    pull_tip(PLACEMENT_OPTIMAL, 0.01);
}

/* More samples over one triangle than a cluster holds. */
static void test_many_points_for_few_triangles(void **state) {
    (void)state;
    static const uint32_t wrong[2][3] = {{0, 1, 3}, {1, 2, 3}};
    struct dense dense = field(61, roof);
    struct mesh mesh = mesh_new(square, 4, wrong, 2);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FULL, PLACEMENT_SUBSET, &facts);
    assert_true(has_edge(&mesh, 0, 2));
    assert_true(facts.mean_after < 1e-6);
    mesh_done(&mesh);
    dense_done(&dense);
}

/* Beside a square of many points two triangles that only have points at their corners, and maybe along an edge between
 * them. */
static void bridge_gap(bool with_ridge, bool flips) {
    static const vec3 corner[8] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0},     {0, 1, 0},
                                   {4, 0, 0}, {6, 0, 0}, {5, 0.4, 0.2}, {5, -0.4, 0.2}};
    static const uint32_t triangle[4][3] = {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {5, 4, 7}};
    enum { SIDE = 21, RIDGE = 99 };
    struct dense square_points = field(SIDE, flat), dense = dense_new(SIDE * SIDE + 4 + (with_ridge ? RIDGE : 0));
    for (size_t i = 0; i < dense.n; i++) {
        size_t k = i - SIDE * SIDE;
        bool in_square = i < SIDE * SIDE, at_corner = !in_square && k < 4;
        dense.point[i] = in_square   ? vec3_add(square_points.point[i], (vec3){0, 0, 1e-3})
                         : at_corner ? corner[4 + k]
                                     : (vec3){4 + 0.02 * (double)(k - 3), 0, 0};
        dense.normal[i] = (vec3){0, 0, 1};
        dense.spacing[i] = 0.05f;
    }
    struct mesh mesh = mesh_new(corner, 8, triangle, 4);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FLIPS, PLACEMENT_SUBSET, &facts);
    assert_int_equal(facts.flips, flips);
    assert_int_equal(has_edge(&mesh, 6, 7), flips);
    mesh_done(&mesh);
    dense_done(&square_points);
    dense_done(&dense);
}

static void test_gap_takes_the_shorter_diagonal(void **state) {
    (void)state;
    bridge_gap(false, true);
}

static void test_points_take_the_longer_diagonal(void **state) {
    (void)state;
    bridge_gap(true, false);
}

static void test_filled_holes_stay_marked(void **state) {
    (void)state;
    static const uint32_t wrong[2][3] = {{0, 1, 3}, {1, 2, 3}};
    for (int both = 0; both < 2; both++) {
        struct dense dense = field(9, roof);
        struct mesh mesh = mesh_new(square, 4, wrong, 2);
        struct refine_facts facts;
        mesh.tag = alloc_zeroed(2, 1);
        mesh.tag[0] = MESH_HOLE_FILL;
        mesh.tag[1] = both ? MESH_HOLE_FILL : MESH_SUPPORTED;
        refine(&mesh, &dense, REFINE_FLIPS, PLACEMENT_SUBSET, &facts);
        assert_int_equal(facts.flips, 1);
        for (int t = 0; t < 2; t++) assert_int_equal(mesh.tag[t], both ? MESH_HOLE_FILL : MESH_SUPPORTED);
        mesh_done(&mesh);
        dense_done(&dense);
    }
}

/* ---------------------------------------------------------------------------------------------- a sphere */

enum { SPHERE_POINTS = 4000 };

static struct dense sphere_points(void) {
    struct dense dense = dense_new(SPHERE_POINTS);
    vec3 *point = shape_sphere(SPHERE_POINTS, 0.3);
    for (size_t i = 0; i < SPHERE_POINTS; i++) {
        dense.point[i] = point[i];
        dense.point[i].z *= 0.5 + point[i].x; /* pear-shaped, so that places differ */
        dense.normal[i] = vec3_unit(point[i]);
        dense.spacing[i] = 0.015f;
    }
    free(point);
    return dense;
}

static uint32_t nearest_point(const struct dense *dense, vec3 p, const uint32_t *used, size_t n) {
    uint32_t best = NONE;
    for (uint32_t i = 0; i < dense->n; i++) {
        bool taken = false;
        for (size_t k = 0; k < n; k++) taken |= used[k] == i;
        if (taken) continue;
        if (best == NONE || vec3_distance_sq(dense->point[i], p) < vec3_distance_sq(dense->point[best], p)) best = i;
    }
    return best;
}

/* Rings of latitude, closed by two poles; its vertices are points. */
static struct mesh sphere_mesh(const struct dense *dense) {
    enum { RINGS = 7, AROUND = 12, VERTICES = RINGS * AROUND + 2, TRIANGLES = 2 * RINGS * AROUND };
    vec3 vertex[VERTICES];
    uint32_t triangle[TRIANGLES][3], source[VERTICES];
    size_t t = 0;
    for (uint32_t i = 0; i < VERTICES; i++) {
        double polar = 3.14159265 * (double)(i / AROUND + 1) / (RINGS + 1), turn = 6.2831853 * (i % AROUND) / AROUND;
        if (i >= RINGS * AROUND) polar = i == RINGS * AROUND ? 0 : 3.14159265;
        vec3 p = vec3_scale((vec3){sin(polar) * cos(turn), sin(polar) * sin(turn), cos(polar)}, 0.3);
        p.z *= 0.5 + p.x;
        source[i] = nearest_point(dense, p, source, i);
        vertex[i] = dense->point[source[i]];
    }
    for (uint32_t r = 0; r < RINGS - 1; r++) {
        for (uint32_t k = 0; k < AROUND; k++) {
            uint32_t a = r * AROUND + k, b = r * AROUND + (k + 1) % AROUND, c = a + AROUND, d = b + AROUND;
            memcpy(triangle[t++], (uint32_t[3]){a, c, b}, sizeof *triangle);
            memcpy(triangle[t++], (uint32_t[3]){b, c, d}, sizeof *triangle);
        }
    }
    for (uint32_t k = 0; k < AROUND; k++) {
        uint32_t last = (RINGS - 1) * AROUND, next = (k + 1) % AROUND;
        memcpy(triangle[t++], (uint32_t[3]){RINGS * AROUND, k, next}, sizeof *triangle);
        memcpy(triangle[t++], (uint32_t[3]){RINGS * AROUND + 1, last + next, last + k}, sizeof *triangle);
    }
    struct mesh mesh = mesh_new(vertex, VERTICES, triangle, t);
    memcpy(mesh.source, source, sizeof source);
    return mesh;
}

static double nearest_sq(const struct fit *fit, vec3 place) {
    double best_sq = INFINITY;
    for (uint32_t t = 0; t < fit->mesh->triangle_count; t++) {
        struct triangle_frame frame = fit_frame(fit, t);
        best_sq = fmin(best_sq, triangle_frame_hit(&frame, place).distance_sq);
    }
    return best_sq;
}

/* Points belong to the nearest triangle of all, and so do nearly all middles. */
static void test_samples_start_with_the_nearest_triangle(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    struct mesh mesh = sphere_mesh(&dense);
    struct neighbourhood hood = hood_of(&dense);
    struct refine_input input = input_of(&dense);
    struct fit fit = {.mesh = &mesh, .threads = 2};
    input.hood = &hood;
    assert_int_equal(samples_init(&fit.samples, &input, true, 2), STATUS_OK);
    assert_int_equal(halfedge_init(&fit.he, &mesh), STATUS_OK);
    uint32_t *triangle = alloc_array(fit.samples.n, sizeof *triangle);
    float *distance_sq = alloc_array(fit.samples.n, sizeof *distance_sq);
    assert_true(triangle && distance_sq && fit.samples.n > 2 * SPHERE_POINTS);
    assert_int_equal(fit_assign(&fit, triangle, distance_sq), STATUS_OK);
    size_t farther = 0;
    for (size_t i = 0; i < fit.samples.n; i++) {
        vec3 place = fit.samples.sample[i].place;
        struct triangle_frame frame = fit_frame(&fit, triangle[i]);
        double d_sq = triangle_frame_hit(&frame, place).distance_sq, best_sq = nearest_sq(&fit, place);
        assert_true(fabs(d_sq - (double)distance_sq[i]) < 1e-6 * d_sq + 1e-15);
        if (samples_point(&fit.samples, (uint32_t)i) != NONE) assert_true(d_sq < best_sq + 1e-12);
        farther += d_sq > best_sq + 1e-12;
    }
    assert_true(farther < fit.samples.n / 100);
    free(triangle), free(distance_sq);
    halfedge_done(&fit.he);
    samples_done(&fit.samples);
    neighbourhood_done(&hood);
    mesh_done(&mesh);
    dense_done(&dense);
}

static size_t folds(const struct mesh *mesh) {
    size_t count = 0;
    for (size_t s = 0; s < mesh->triangle_count; s++) {
        for (size_t t = 0; t < s; t++) {
            int shared = 0;
            for (int i = 0; i < 3; i++)
                for (int k = 0; k < 3; k++) shared += mesh->triangle[s][i] == mesh->triangle[t][k];
            if (shared != 2) continue;
            const uint32_t *a = mesh->triangle[s], *b = mesh->triangle[t];
            vec3 m = vec3_triangle_normal(mesh->vertex[a[0]], mesh->vertex[a[1]], mesh->vertex[a[2]]);
            vec3 n = vec3_triangle_normal(mesh->vertex[b[0]], mesh->vertex[b[1]], mesh->vertex[b[2]]);
            count += vec3_dot(m, n) < 0;
        }
    }
    return count;
}

static void check_sphere(const struct mesh *mesh, size_t vertices, size_t triangles) {
    struct mesh_facts facts;
    assert_int_equal(mesh_examine(mesh, &facts), STATUS_OK);
    assert_int_equal(mesh->vertex_count, vertices);
    assert_int_equal(mesh->triangle_count, triangles);
    assert_true(facts.watertight && facts.manifold);
    assert_int_equal(facts.euler, 2);
    assert_int_equal(facts.unused_vertices, 0);
    assert_true(facts.volume > 0);
}

static void test_closed_stays_closed_and_gets_better(void **state) {
    (void)state;
    static const struct {
        enum refine_form form;
        enum placement placement;
        double of_before;
    } kind[] = {{REFINE_NONE, PLACEMENT_SUBSET, 1.0001},
                {REFINE_FLIPS, PLACEMENT_SUBSET, 0.96},
                {REFINE_FULL, PLACEMENT_SUBSET, 0.8},
                {REFINE_FULL, PLACEMENT_OPTIMAL, 0.3}};
    struct dense dense = sphere_points();
    for (size_t k = 0; k < sizeof kind / sizeof *kind; k++) {
        struct mesh mesh = sphere_mesh(&dense);
        size_t vertices = mesh.vertex_count, triangles = mesh.triangle_count, folded = folds(&mesh);
        struct refine_facts facts;
        check_sphere(&mesh, vertices, triangles);
        refine(&mesh, &dense, kind[k].form, kind[k].placement, &facts);
        check_sphere(&mesh, vertices, triangles);
        assert_true(folds(&mesh) <= folded);
        assert_true(facts.mean_after <= kind[k].of_before * facts.mean_before);
        mesh_done(&mesh);
    }
    dense_done(&dense);
}

static void test_subset_stays_a_subset(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    struct mesh mesh = sphere_mesh(&dense);
    uint8_t *used = calloc(dense.n, 1);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FULL, PLACEMENT_SUBSET, &facts);
    assert_true(facts.moves > 0 && facts.teleports > 0);
    for (size_t v = 0; v < mesh.vertex_count; v++) {
        assert_true(mesh.source[v] < dense.n);
        assert_true(vec3_equal(mesh.vertex[v], dense.point[mesh.source[v]]));
        assert_int_equal(used[mesh.source[v]]++, 0);
    }
    free(used);
    mesh_done(&mesh);
    dense_done(&dense);
}

static void test_threads_change_nothing(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    for (int placement = PLACEMENT_SUBSET; placement <= PLACEMENT_OPTIMAL; placement++) {
        struct mesh mesh[3];
        for (unsigned i = 0; i < 3; i++) {
            struct refine_input input = input_of(&dense);
            struct refine_options options = {REFINE_FULL, (enum placement)placement, 1 + 3 * i};
            mesh[i] = sphere_mesh(&dense);
            assert_int_equal(refine_mesh(&mesh[i], &input, &options, NULL, NULL), STATUS_OK);
            size_t vertices = mesh[i].vertex_count, triangles = mesh[i].triangle_count;
            assert_memory_equal(mesh[i].vertex, mesh[0].vertex, vertices * sizeof(vec3));
            assert_memory_equal(mesh[i].source, mesh[0].source, vertices * sizeof(uint32_t));
            assert_memory_equal(mesh[i].triangle, mesh[0].triangle, triangles * sizeof(uint32_t[3]));
        }
        for (int i = 0; i < 3; i++) mesh_done(&mesh[i]);
    }
    dense_done(&dense);
}

/* ---------------------------------------------------------------------------------------------- faults */

static bool fail_at(void *ctx) {
    int *left = ctx;
    return (*left)-- == 0;
}

static void test_failure_leaves_the_mesh(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    struct mesh mesh = sphere_mesh(&dense), copy = sphere_mesh(&dense);
    struct refine_input input = input_of(&dense);
    struct refine_options options = {REFINE_FULL, PLACEMENT_SUBSET, 1};
    int failures = 0;
    alloc_fail = fail_at;
    for (int n = 0; n < 1000; n++) {
        int left = n;
        alloc_fail_ctx = &left;
        enum status status = refine_mesh(&mesh, &input, &options, NULL, NULL);
        if (status == STATUS_OK) break;
        assert_int_equal(status, STATUS_NO_MEMORY);
        failures++;
        assert_memory_equal(mesh.vertex, copy.vertex, mesh.vertex_count * sizeof(vec3));
        assert_memory_equal(mesh.triangle, copy.triangle, mesh.triangle_count * sizeof(uint32_t[3]));
    }
    alloc_fail = NULL;
    assert_true(failures > 10 && failures < 1000);
    mesh_done(&mesh);
    mesh_done(&copy);
    dense_done(&dense);
}

static int stop_at(void *ctx, const char *stage, double fraction) {
    assert_string_equal(stage, "refine");
    assert_true(fraction >= 0 && fraction <= 1);
    return fraction >= *(double *)ctx;
}

static void test_cancel_leaves_the_mesh(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    struct mesh mesh = sphere_mesh(&dense), copy = sphere_mesh(&dense);
    struct refine_input input = input_of(&dense);
    struct refine_options options = {REFINE_FULL, PLACEMENT_SUBSET, 1};
    for (double at = 0; at < 0.8; at += 0.15) {
        struct progress progress = {stop_at, &at};
        assert_int_equal(refine_mesh(&mesh, &input, &options, &progress, NULL), STATUS_CANCELLED);
        assert_memory_equal(mesh.vertex, copy.vertex, mesh.vertex_count * sizeof(vec3));
        assert_memory_equal(mesh.triangle, copy.triangle, mesh.triangle_count * sizeof(uint32_t[3]));
    }
    mesh_done(&mesh);
    mesh_done(&copy);
    dense_done(&dense);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_eight_at_a_time_is_one_at_a_time),
        cmocka_unit_test(test_distances_to_degenerate_triangles),
        cmocka_unit_test(test_where_on_a_triangle_is_nearest),
        cmocka_unit_test(test_nearest_and_values),
        cmocka_unit_test(test_lists_are_filled_again),
        cmocka_unit_test(test_model_is_the_slope_of_the_cost),
        cmocka_unit_test(test_middles_of_a_grid_are_those_of_its_corners),
        cmocka_unit_test(test_middles_beside_a_sharp_edge_lie_on_its_faces),
        cmocka_unit_test(test_no_middle_lies_across_a_gap),
        cmocka_unit_test(test_wrong_diagonal_flips),
        cmocka_unit_test(test_right_diagonal_stays),
        cmocka_unit_test(test_flat_is_left_alone),
        cmocka_unit_test(test_tip_moves_to_the_point),
        cmocka_unit_test(test_tip_moves_to_the_best_place),
        cmocka_unit_test(test_many_points_for_few_triangles),
        cmocka_unit_test(test_gap_takes_the_shorter_diagonal),
        cmocka_unit_test(test_points_take_the_longer_diagonal),
        cmocka_unit_test(test_filled_holes_stay_marked),
        cmocka_unit_test(test_samples_start_with_the_nearest_triangle),
        cmocka_unit_test(test_closed_stays_closed_and_gets_better),
        cmocka_unit_test(test_subset_stays_a_subset),
        cmocka_unit_test(test_threads_change_nothing),
        cmocka_unit_test(test_failure_leaves_the_mesh),
        cmocka_unit_test(test_cancel_leaves_the_mesh),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
