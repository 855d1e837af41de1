/* Where a mesh is fitted to: points, and the middles of the triangles that they see around them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/cloud/cloud.h"
#include "core/refine/samples.h"
#include "tests/unit/dense.h"

/* A square has no diagonal of its own: each of its corners sees the triangle that it is a corner of. */
static void test_middles_of_a_grid_are_those_of_its_corners(void **state) {
    (void)state;
    struct dense dense = dense_field(5, dense_flat);
    struct neighbourhood neighbours = dense_neighbourhood(&dense);
    struct refine_input input = dense_input(&dense);
    struct samples samples;
    size_t points = 0, beside[16] = {0};
    input.neighbours = &neighbours;
    assert_int_equal(samples_init(&samples, &input, 1, 2), STATUS_OK);
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
    neighbourhood_done(&neighbours);
    dense_done(&dense);
}

/* All samples together stand for as much as with whole triangles, points for less of it. */
static void test_quarters_lie_in_their_triangle_and_weigh_as_much(void **state) {
    (void)state;
    enum { SIDE = 9 };
    struct dense dense = dense_field(SIDE, dense_flat);
    struct neighbourhood neighbours = dense_neighbourhood(&dense);
    struct refine_input input = dense_input(&dense);
    struct samples samples[2];
    double points[2] = {0, 0}, middles[2] = {0, 0};
    input.neighbours = &neighbours;
    assert_int_equal(samples_init(&samples[0], &input, 1, 2), STATUS_OK);
    assert_int_equal(samples_init(&samples[1], &input, SAMPLES_QUARTERS, 2), STATUS_OK);
    assert_int_equal(samples[1].n - samples[1].points, SAMPLES_QUARTERS * (samples[0].n - samples[0].points));
    for (int k = 0; k < 2; k++)
        for (uint32_t i = 0; i < samples[k].n; i++)
            *(samples_point(&samples[k], i) == NONE ? &middles[k] : &points[k]) += (double)samples[k].sample[i].weight;
    assert_true(fabs(points[1] / points[0] - 0.4) < 1e-3 && fabs(middles[1] / middles[0] - 1.2) < 1e-3);
    for (size_t i = samples[0].points; i < samples[0].n; i++) {
        const struct sample *whole = &samples[0].sample[i];
        const struct sample *part = &samples[1].sample[samples[1].points + SAMPLES_QUARTERS * (i - samples[0].points)];
        vec3 sum = {0};
        for (int k = 0; k < SAMPLES_QUARTERS; k++) sum = vec3_add(sum, part[k].place);
        assert_true(vec3_distance(vec3_scale(sum, 0.25), whole->place) < 1e-12);
        for (int k = 0; k < SAMPLES_QUARTERS; k++)
            for (int j = 0; j < k; j++) assert_true(vec3_distance(part[j].place, part[k].place) > 0.1 / (SIDE - 1));
    }
    for (int k = 0; k < 2; k++) samples_done(&samples[k]);
    neighbourhood_done(&neighbours);
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
    struct neighbourhood neighbours = dense_neighbourhood(&dense);
    struct refine_input input = dense_input(&dense);
    struct samples samples;
    double middles = 0, one = 0;
    input.neighbours = &neighbours;
    assert_int_equal(samples_init(&samples, &input, 1, 2), STATUS_OK);
    for (size_t i = 0; i < samples.n; i++) {
        vec3 p = samples.sample[i].place;
        assert_true(fabs(p.z + fabs(p.y)) < 1e-9);
        if (samples_point(&samples, (uint32_t)i) != NONE) continue;
        middles += (double)samples.sample[i].weight;
        one = fmax(one, (double)samples.sample[i].weight);
    }
    assert_true(fabs(middles / one - 2.0 * RHOMBI) < 0.1 * RHOMBI);
    samples_done(&samples);
    neighbourhood_done(&neighbours);
    dense_done(&dense);
}

/* Two parallel sheets, nearer to each other than their points are to one another. */
static void test_no_middle_lies_across_a_gap(void **state) {
    (void)state;
    struct dense sheet = dense_field(6, dense_flat), dense = dense_new(72);
    for (size_t i = 0; i < 72; i++) {
        dense.point[i] = sheet.point[i % 36];
        dense.point[i].z = i < 36 ? 0 : 0.15;
        dense.normal[i] = (vec3){0, 0, 1};
        dense.spacing[i] = 0.2f;
    }
    struct neighbourhood neighbours = dense_neighbourhood(&dense);
    struct refine_input input = dense_input(&dense);
    struct samples samples;
    input.neighbours = &neighbours;
    assert_int_equal(samples_init(&samples, &input, 1, 2), STATUS_OK);
    assert_true(samples.n > 72);
    for (size_t i = 0; i < samples.n; i++) {
        double z = samples.sample[i].place.z;
        assert_true(z == 0 || fabs(z - 0.15) < 1e-12);
    }
    samples_done(&samples);
    neighbourhood_done(&neighbours);
    dense_done(&sheet);
    dense_done(&dense);
}

/* A face of three points, with a fourth one beside it, which is of none. */
static void test_points_of_no_face_weigh_beside_sharp_ones(void **state) {
    (void)state;
    const vec3 point[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}};
    const vec3 normal[] = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}, {0, 0, 1}};
    const float spacing[] = {1, 1, 1, 1};
    const uint32_t corner[][3] = {{0, 1, 2}};
    const struct refine_faces faces = {1, corner, NULL};
    for (int sharp = 0; sharp < 2; sharp++) {
        struct refine_input input = {
            .points = point, .normals = normal, .spacing = spacing, .n = 4, .faces = &faces, .sharp = sharp};
        struct samples samples;
        assert_int_equal(samples_init(&samples, &input, 1, 1), STATUS_OK);
        assert_true(samples.sample[0].weight > 0);
        assert_true((samples.sample[3].weight > 0) == sharp);
        samples_done(&samples);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_middles_of_a_grid_are_those_of_its_corners),
        cmocka_unit_test(test_quarters_lie_in_their_triangle_and_weigh_as_much),
        cmocka_unit_test(test_middles_beside_a_sharp_edge_lie_on_its_faces),
        cmocka_unit_test(test_no_middle_lies_across_a_gap),
        cmocka_unit_test(test_points_of_no_face_weigh_beside_sharp_ones),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
