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

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/mesh/intersect.h"
#include "core/refine/local_delaunay.h"
#include "core/refine/refine.h"
#include "core/refine/refine_internal.h"
#include "tests/unit/dense.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

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
    struct refine_input input = dense_input(dense);
    struct refine_options options = {form, placement, 2};
    assert_int_equal(refine_mesh(mesh, &input, &options, NULL, facts), STATUS_OK);
}

static bool has_edge(const struct mesh *mesh, uint32_t a, uint32_t b) {
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            if (mesh->triangle[t][k] == a && mesh->triangle[t][(k + 1) % 3] == b) return true;
    return false;
}

/* ---------------------------------------------------------------------------------------------- tiny meshes */

static const vec3 square[4] = {{0, 0, 0.3}, {1, 0, 0}, {1, 1, 0.3}, {0, 1, 0}};

static void test_wrong_diagonal_flips(void **state) {
    (void)state;
    static const uint32_t wrong[2][3] = {{0, 1, 3}, {1, 2, 3}};
    struct dense dense = dense_field(9, roof);
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
    struct dense dense = dense_field(9, roof);
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
    struct dense dense = dense_field(9, dense_flat);
    struct mesh mesh = mesh_new(corner, 5, fan, 4);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FULL, PLACEMENT_OPTIMAL, &facts);
    assert_int_equal(facts.flips + facts.moves + facts.reallocations, 0);
    assert_true(vec3_equal(mesh.vertex[4], corner[4]));
    mesh_done(&mesh);
    dense_done(&dense);
}

/* A pyramid whose tip stands beside the data's: it must come back, and the base, a boundary, must stay.  The tip is the
 * vertex of each number in turn. */
static void pull_tip(enum placement placement, double tolerance) {
    static const vec3 at[5] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0.62, 0.44, 0.38}};
    static const uint32_t sides[4][3] = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
    struct dense dense = dense_field(17, tent);
    for (uint32_t tip = 0; tip < 5; tip++) {
        vec3 corner[5];
        uint32_t fan[4][3];
        for (uint32_t v = 0; v < 5; v++) corner[(v + tip + 1) % 5] = at[v];
        for (int i = 0; i < 12; i++) fan[i / 3][i % 3] = (sides[i / 3][i % 3] + tip + 1) % 5;
        struct mesh mesh = mesh_new(corner, 5, fan, 4);
        struct refine_facts facts;
        refine(&mesh, &dense, REFINE_FULL, placement, &facts);
        assert_true(facts.moves > 0);
        assert_true(vec3_distance(mesh.vertex[tip], (vec3){0.5, 0.5, 0.5}) < tolerance);
        double moved = placement == PLACEMENT_SUBSET ? 0 : tolerance; /* a border moves along its normal */
        for (uint32_t v = 0; v < 5; v++) assert_true(v == tip || vec3_distance(mesh.vertex[v], corner[v]) <= moved);
        if (placement == PLACEMENT_SUBSET) {
            assert_int_equal(mesh.source[tip], 8 * 17 + 8);
            assert_true(facts.mean_after < 1e-6);
        }
        if (placement == PLACEMENT_OPTIMAL) assert_int_equal(mesh.source[tip], NONE);
        mesh_done(&mesh);
    }
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

/* More samples over one triangle than a batch holds. */
static void test_many_points_for_few_triangles(void **state) {
    (void)state;
    static const uint32_t wrong[2][3] = {{0, 1, 3}, {1, 2, 3}};
    struct dense dense = dense_field(61, roof);
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
    struct dense square_points = dense_field(SIDE, dense_flat),
                 dense = dense_new(SIDE * SIDE + 4 + (with_ridge ? RIDGE : 0));
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
        struct dense dense = dense_field(9, roof);
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

/* So few for each triangle of the mesh that a closer look is worth it. */
static struct dense fewer_sphere_points(void) {
    struct dense dense = sphere_points();
    dense.n /= 4;
    for (size_t k = 0; k < dense.n; k++) dense.point[k] = dense.point[4 * k], dense.normal[k] = dense.normal[4 * k];
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

static struct triangle_frame frame_of(const struct fit *fit, uint32_t triangle) {
    const uint32_t *corner = fit->mesh->triangle[triangle];
    const vec3 *vertex = fit->mesh->vertex;
    return triangle_frame_of(vertex[corner[0]], vertex[corner[1]], vertex[corner[2]]);
}

static double nearest_sq(const struct fit *fit, vec3 place) {
    double best_sq = INFINITY;
    for (uint32_t t = 0; t < fit->mesh->triangle_count; t++) {
        struct triangle_frame frame = frame_of(fit, t);
        best_sq = fmin(best_sq, triangle_frame_hit(&frame, place).distance_sq);
    }
    return best_sq;
}

/* Points belong to the nearest triangle of all, and so do nearly all middles. */
static void test_samples_start_with_the_nearest_triangle(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    struct mesh mesh = sphere_mesh(&dense);
    struct neighbourhood neighbours = dense_neighbourhood(&dense);
    struct refine_input input = dense_input(&dense);
    struct fit fit = {.mesh = &mesh, .threads = 2};
    input.neighbours = &neighbours;
    assert_int_equal(samples_init(&fit.samples, &input, 1, 2), STATUS_OK);
    assert_int_equal(halfedge_init(&fit.he, &mesh, 2), STATUS_OK);
    assert_int_equal(sample_buckets_init(&fit.lists, mesh.triangle_count, fit.samples.n, 1), STATUS_OK);
    uint32_t *triangle = alloc_array(fit.samples.n, sizeof *triangle);
    float *distance_sq = alloc_array(fit.samples.n, sizeof *distance_sq);
    assert_true(triangle && distance_sq && fit.samples.n > 2 * SPHERE_POINTS);
    assert_int_equal(fit_assign(&fit, triangle, distance_sq), STATUS_OK);
    size_t farther = 0;
    for (size_t i = 0; i < fit.samples.n; i++) {
        vec3 place = fit.samples.sample[i].place;
        struct triangle_frame frame = frame_of(&fit, triangle[i]);
        double d_sq = triangle_frame_hit(&frame, place).distance_sq, best_sq = nearest_sq(&fit, place);
        assert_true(fabs(d_sq - (double)distance_sq[i]) < 1e-6 * d_sq + 1e-15);
        if (samples_point(&fit.samples, (uint32_t)i) != NONE) assert_true(d_sq < best_sq + 1e-12);
        farther += d_sq > best_sq + 1e-12;
    }
    assert_true(farther < fit.samples.n / 100);
    free(triangle), free(distance_sq);
    sample_buckets_done(&fit.lists);
    halfedge_done(&fit.he);
    samples_done(&fit.samples);
    neighbourhood_done(&neighbours);
    mesh_done(&mesh);
    dense_done(&dense);
}

/* The samples in the list of a triangle, each counted; how many. */
static size_t count_listed(const struct fit *fit, uint32_t t, uint8_t *seen) {
    struct sample_batch batch;
    size_t count = 0;
    for (uint32_t rest = fit->lists.first[t]; rest != NONE; count += batch.n) {
        sample_batch_clear(&batch, fit->mesh->vertex[fit->mesh->triangle[t][0]]);
        rest = sample_batch_add(&batch, fit->lists.block, rest);
        for (size_t i = 0; i < batch.n; i++) seen[batch.sample[i]]++;
    }
    return count;
}

/* Samples that are there already are taken, those of other parts are not; either way none are left behind. */
static void test_samples_made_beforehand_change_nothing(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    struct neighbourhood neighbours = dense_neighbourhood(&dense);
    struct refine_input input = dense_input(&dense);
    struct refine_options options = {REFINE_FULL, PLACEMENT_SUBSET, 2};
    struct mesh mesh[3];
    struct samples samples = {0};
    input.neighbours = &neighbours;
    for (unsigned parts = 0; parts < 3; parts++) {
        mesh[parts] = sphere_mesh(&dense);
        input.samples = NULL;
        if (parts < 2) assert_int_equal(samples_init(&samples, &input, parts, 2), STATUS_OK);
        const struct sample *made = samples.sample;
        input.samples = &samples;
        struct fit fit;
        assert_int_equal(fit_init(&fit, &mesh[parts], &input, &options), STATUS_OK);
        assert_true(samples.n == 0 && fit.samples.parts == 1 && (fit.samples.sample == made) == (parts == 1));
        fit_done(&fit);
        if (parts < 2) assert_int_equal(samples_init(&samples, &input, parts, 2), STATUS_OK);
        assert_int_equal(refine_mesh(&mesh[parts], &input, &options, NULL, NULL), STATUS_OK);
        assert_true(samples.n == 0 && !samples.sample);
        assert_memory_equal(mesh[parts].vertex, mesh[0].vertex, mesh[0].vertex_count * sizeof *mesh[0].vertex);
        assert_memory_equal(mesh[parts].triangle, mesh[0].triangle, mesh[0].triangle_count * sizeof *mesh[0].triangle);
    }
    for (int i = 0; i < 3; i++) mesh_done(&mesh[i]);
    neighbourhood_done(&neighbours);
    dense_done(&dense);
}

/* After a closer look every sample is in one list, and the whole mesh is to be tried again. */
static void test_a_closer_look_has_all_samples_in_the_lists(void **state) {
    (void)state;
    struct dense dense = fewer_sphere_points();
    struct mesh mesh = sphere_mesh(&dense);
    struct neighbourhood neighbours = dense_neighbourhood(&dense);
    struct local_delaunay local_delaunay = {0};
    struct refine_input input = dense_input(&dense);
    struct refine_options options = {REFINE_FULL, PLACEMENT_OPTIMAL, 2};
    struct fit fit;
    input.neighbours = &neighbours, input.local_delaunay = &local_delaunay;
    assert_true((double)input.n < FIT_CLOSE * (double)mesh.triangle_count);
    assert_int_equal(fit_init(&fit, &mesh, &input, &options), STATUS_OK);
    size_t coarse = fit.samples.n - fit.samples.points, listed = 0;
    double far = fit.far, mean = fit_mean(&fit);
    assert_true(local_delaunay.n == input.n);
    memset(fit.stale, 0, mesh.vertex_count), memset(fit.touched, 0, mesh.triangle_count);
    assert_int_equal(fit_look_closer(&fit), STATUS_OK);
    assert_int_equal(fit.samples.n - fit.samples.points, SAMPLES_QUARTERS * coarse);
    assert_true(local_delaunay.n == 0 && fit.far == far && fabs(fit_mean(&fit) / mean - 1) < 0.2);
    uint8_t *seen = alloc_zeroed(fit.samples.n, 1);
    assert_non_null(seen);
    for (uint32_t t = 0; t < mesh.triangle_count; t++) listed += count_listed(&fit, t, seen);
    assert_int_equal(listed, fit.samples.n);
    for (size_t i = 0; i < fit.samples.n; i++) assert_int_equal(seen[i], 1);
    for (size_t v = 0; v < mesh.vertex_count; v++) assert_int_equal(fit.stale[v], 1);
    for (size_t t = 0; t < mesh.triangle_count; t++) assert_int_equal(fit.touched[t], 1);
    free(seen);
    fit_done(&fit);
    neighbourhood_done(&neighbours);
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

/* ------------------------------------------------------------------------------------------ a judge of its own */

static double segment_distance(vec3 p, vec3 a, vec3 b) {
    vec3 along = vec3_sub(b, a);
    double t = vec3_dot(vec3_sub(p, a), along) / vec3_dot(along, along);
    return vec3_distance(p, vec3_lerp(a, b, t < 0 ? 0 : t > 1 ? 1 : t));
}

/* To its plane above the triangle, else to the nearest of its edges. */
static double triangle_distance(vec3 p, const vec3 corner[3]) {
    vec3 normal = vec3_unit(vec3_triangle_normal(corner[0], corner[1], corner[2]));
    double least = INFINITY;
    bool above = true;
    for (int k = 0; k < 3; k++) {
        vec3 a = corner[k], b = corner[(k + 1) % 3];
        above &= vec3_dot(vec3_cross(vec3_sub(b, a), vec3_sub(p, a)), normal) >= 0;
        least = fmin(least, segment_distance(p, a, b));
    }
    return above ? fabs(vec3_dot(vec3_sub(p, corner[0]), normal)) : least;
}

/* Mean of all points to the mesh, looked for among all of its triangles. */
static double mean_to_mesh(const struct dense *dense, const struct mesh *mesh) {
    double sum = 0;
    for (size_t i = 0; i < dense->n; i++) {
        double least = INFINITY;
        for (size_t t = 0; t < mesh->triangle_count; t++) {
            const uint32_t *v = mesh->triangle[t];
            vec3 corner[3] = {mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]]};
            least = fmin(least, triangle_distance(dense->point[i], corner));
        }
        sum += least;
    }
    return sum / (double)dense->n;
}

/* What is 0 on the surface that the points are of. */
static double pear(vec3 p) { return vec3_length((vec3){p.x, p.y, p.z / (0.5 + p.x)}) - 0.3; }

/* To the surface, to first order. */
static double pear_distance(vec3 p) {
    const double step = 1e-6;
    double value = pear(p);
    vec3 slope = {(pear((vec3){p.x + step, p.y, p.z}) - value) / step,
                  (pear((vec3){p.x, p.y + step, p.z}) - value) / step,
                  (pear((vec3){p.x, p.y, p.z + step}) - value) / step};
    return fabs(value) / vec3_length(slope);
}

/* Mean of the mesh's area to the surface: the middles of 36 parts of each triangle. */
static double mean_to_surface(const struct mesh *mesh) {
    enum { PARTS = 6 };
    double sum = 0, area = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        vec3 a = mesh->vertex[v[0]], b = mesh->vertex[v[1]], c = mesh->vertex[v[2]];
        double part = vec3_length(vec3_triangle_normal(a, b, c)) / (PARTS * PARTS);
        for (int i = 0; i < PARTS; i++)
            for (int j = 0; j < 2 * (PARTS - i) - 1; j++) {
                double u = (i + (j % 2 ? 2.0 : 1.0) / 3) / PARTS, w = (j / 2 + (j % 2 ? 2.0 : 1.0) / 3) / PARTS;
                vec3 p = vec3_add(a, vec3_add(vec3_scale(vec3_sub(b, a), u), vec3_scale(vec3_sub(c, a), w)));
                sum += part * pear_distance(p), area += part;
            }
    }
    return sum / area;
}

static double judged(const struct dense *dense, const struct mesh *mesh) {
    return (mean_to_mesh(dense, mesh) + mean_to_surface(mesh)) / 2;
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
        double of_before; /* mean of both directions, as the judge has it */
    } kind[] = {{REFINE_NONE, PLACEMENT_SUBSET, 1.0001},
                {REFINE_FLIPS, PLACEMENT_SUBSET, 0.95},
                {REFINE_FULL, PLACEMENT_SUBSET, 0.75},
                {REFINE_FULL, PLACEMENT_OPTIMAL, 0.18}};
    struct dense dense = sphere_points();
    for (size_t k = 0; k < sizeof kind / sizeof *kind; k++) {
        struct mesh mesh = sphere_mesh(&dense);
        size_t vertices = mesh.vertex_count, triangles = mesh.triangle_count, folded = folds(&mesh);
        struct refine_facts facts;
        check_sphere(&mesh, vertices, triangles);
        double before = judged(&dense, &mesh);
        refine(&mesh, &dense, kind[k].form, kind[k].placement, &facts);
        check_sphere(&mesh, vertices, triangles);
        double after = judged(&dense, &mesh);
        assert_true(folds(&mesh) <= folded);
        assert_true(after <= kind[k].of_before * before);
        mesh_done(&mesh);
    }
    dense_done(&dense);
}

/* The floor beside a wall should rise from it in a pyramid: the split that does so folds it against the wall. */
static void test_a_split_that_gains_much_may_fold(void **state) {
    (void)state;
    static const vec3 corner[6] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {1, 0, 1}, {1, 1, 1}};
    static const uint32_t floor_and_wall[4][3] = {{0, 1, 2}, {2, 3, 0}, {2, 1, 4}, {2, 4, 5}};
    enum { DIAGONAL = 2 };
    struct dense dense = dense_field(17, tent);
    struct mesh mesh = mesh_new(corner, 6, floor_and_wall, 4);
    struct refine_input input = dense_input(&dense);
    struct refine_options options = {REFINE_FULL, PLACEMENT_OPTIMAL, 1};
    struct fit fit;
    assert_int_equal(fit_init(&fit, &mesh, &input, &options), STATUS_OK);
    fit.fold = FIT_FOLD;
    assert_int_equal(fit_split_best(&fit, DIAGONAL).halfedge, NONE);
    fit.leaps = true;
    struct fit_candidate split = fit_split_best(&fit, DIAGONAL);
    assert_int_equal(split.halfedge, DIAGONAL);
    assert_true(vec3_distance(split.place, (vec3){0.5, 0.5, 0.5}) < 1e-6);
    assert_true(split.value > 0);
    fit_done(&fit);
    mesh_done(&mesh);
    dense_done(&dense);
}

/* Two tetrahedra with an edge in common end nowhere; without one of their triangles they do. */
static void test_four_triangles_at_an_edge_are_no_border(void **state) {
    (void)state;
    static const vec3 corner[6] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, -1, 0}, {0, 0, -1}};
    static const uint32_t both[8][3] = {{0, 1, 3}, {1, 0, 2}, {0, 3, 2}, {1, 2, 3},
                                        {0, 1, 5}, {1, 0, 4}, {0, 5, 4}, {1, 4, 5}};
    struct dense dense = dense_field(9, roof);
    struct refine_input input = dense_input(&dense);
    struct refine_options options = {REFINE_FULL, PLACEMENT_OPTIMAL, 1};
    for (size_t n = 7; n <= 8; n++) {
        struct mesh mesh = mesh_new(corner, 6, both, n);
        struct fit fit;
        assert_int_equal(fit_init(&fit, &mesh, &input, &options), STATUS_OK);
        assert_int_equal(fit.borders > 0, n == 7);
        fit_done(&fit);
        mesh_done(&mesh);
    }
    dense_done(&dense);
}

/* Vertex v is put somewhere, and the mesh is looked at as it is then. */
static size_t uncross(const struct dense *dense, uint32_t v, vec3 place, bool moves, struct mesh *mesh) {
    struct refine_input input = dense_input(dense);
    struct refine_options options = {REFINE_FULL, PLACEMENT_OPTIMAL, 2};
    struct fit fit;
    size_t changes = 0, crossing = 0;
    *mesh = sphere_mesh(dense);
    mesh->vertex[v] = place;
    mesh->source[v] = NONE;
    assert_int_equal(mesh_count_intersections(mesh, 1, &crossing), STATUS_OK);
    assert_int_equal(fit_init(&fit, mesh, &input, &options), STATUS_OK);
    assert_int_equal(fit_uncross(&fit, moves, &changes), STATUS_OK);
    fit_done(&fit);
    assert_true(changes > 0 ? crossing > 0 : crossing == 0 || !moves);
    assert_int_equal(mesh_count_intersections(mesh, 1, &crossing), STATUS_OK);
    return crossing;
}

static void test_what_crosses_is_parted(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    struct mesh mesh = sphere_mesh(&dense), parted;
    size_t vertices = mesh.vertex_count, triangles = mesh.triangle_count;
    for (uint32_t v = 0; v < vertices; v += 40) {
        vec3 through = vec3_scale(mesh.vertex[v], -1.2);
        assert_int_equal(uncross(&dense, v, mesh.vertex[v], true, &parted), 0);
        assert_memory_equal(parted.vertex, mesh.vertex, vertices * sizeof(vec3));
        mesh_done(&parted);
        assert_int_equal(uncross(&dense, v, through, true, &parted), 0);
        check_sphere(&parted, vertices, triangles);
        mesh_done(&parted);
        (void)uncross(&dense, v, through, false, &parted); /* flips alone */
        assert_true(vec3_equal(parted.vertex[v], through));
        mesh_done(&parted);
    }
    mesh_done(&mesh);
    dense_done(&dense);
}

static void test_subset_stays_a_subset(void **state) {
    (void)state;
    struct dense dense = sphere_points();
    struct mesh mesh = sphere_mesh(&dense);
    uint8_t *used = calloc(dense.n, 1);
    struct refine_facts facts;
    refine(&mesh, &dense, REFINE_FULL, PLACEMENT_SUBSET, &facts);
    assert_true(facts.moves > 0 && facts.reallocations > 0);
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
            struct refine_input input = dense_input(&dense);
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

enum { FIELD = 121, STEP = 3, GRID = (FIELD - 1) / STEP + 1 };

static double waves(double x, double y) { return 0.05 * sin(9 * x + 2 * y) * cos(7 * y); }

/* Every third point of each row and column is a vertex: too many for one zone. */
static struct mesh field_mesh(const struct dense *dense) {
    static vec3 vertex[GRID * GRID];
    static uint32_t triangle[2 * (GRID - 1) * (GRID - 1)][3];
    size_t t = 0;
    for (uint32_t v = 0; v < GRID * GRID; v++) vertex[v] = dense->point[STEP * (v / GRID * FIELD + v % GRID)];
    for (uint32_t v = 0; v + GRID + 1 < GRID * GRID; v++) {
        if (v % GRID == GRID - 1) continue;
        memcpy(triangle[t++], (uint32_t[3]){v, v + 1, v + GRID + 1}, sizeof *triangle);
        memcpy(triangle[t++], (uint32_t[3]){v, v + GRID + 1, v + GRID}, sizeof *triangle);
    }
    struct mesh mesh = mesh_new(vertex, GRID * GRID, (const uint32_t(*)[3])triangle, t);
    for (uint32_t v = 0; v < GRID * GRID; v++) mesh.source[v] = STEP * (v / GRID * FIELD + v % GRID);
    return mesh;
}

/* Every vertex is in a zone, none is too large, and most neighbours are in the same. */
static void test_zones_are_compact(void **state) {
    (void)state;
    struct dense dense = dense_field(FIELD, waves);
    struct mesh mesh = field_mesh(&dense);
    struct halfedge he;
    struct fit_partition zones;
    size_t size[GRID * GRID] = {0}, apart = 0;
    assert_int_equal(halfedge_init(&he, &mesh, 2), STATUS_OK);
    assert_int_equal(fit_partition_init(&zones, &he), STATUS_OK);
    assert_true(zones.count > GRID * GRID / FIT_PART_MOST && zones.count < GRID * GRID / 100);
    for (uint32_t v = 0; v < GRID * GRID; v++) {
        assert_true(zones.of[v] < zones.count);
        assert_true(++size[zones.of[v]] <= FIT_PART_MOST);
    }
    for (uint32_t h = 0; h < 3 * mesh.triangle_count; h++)
        apart += zones.of[halfedge_from(&he, h)] != zones.of[halfedge_to(&he, h)];
    assert_true(apart > 0 && apart < 3 * mesh.triangle_count / 5);
    fit_partition_done(&zones);
    halfedge_done(&he);
    mesh_done(&mesh);
    dense_done(&dense);
}

static void test_threads_change_nothing_in_many_zones(void **state) {
    (void)state;
    struct dense dense = dense_field(FIELD, waves);
    struct refine_input input = dense_input(&dense);
    struct mesh mesh[2];
    struct refine_facts facts;
    for (unsigned i = 0; i < 2; i++) {
        struct refine_options options = {REFINE_FULL, PLACEMENT_SUBSET, 1 + 3 * i};
        mesh[i] = field_mesh(&dense);
        assert_int_equal(refine_mesh(&mesh[i], &input, &options, NULL, &facts), STATUS_OK);
        assert_true(facts.moves > GRID && facts.mean_after < 0.8 * facts.mean_before);
    }
    assert_memory_equal(mesh[1].vertex, mesh[0].vertex, GRID * GRID * sizeof(vec3));
    assert_memory_equal(mesh[1].triangle, mesh[0].triangle, mesh[0].triangle_count * sizeof(uint32_t[3]));
    mesh_done(&mesh[0]), mesh_done(&mesh[1]);
    dense_done(&dense);
}

/* ---------------------------------------------------------------------------------------------- ends without points */

enum { CAN_ROWS = 41, CAN_DENSE = 48, CAN_RINGS = 9, CAN_AROUND = 24 };

static vec3 can_place(size_t turn, size_t around, double height) {
    double angle = 6.283185307 * (double)turn / (double)around;
    double radius = 0.2 + 0.012 * sin(3 * angle + 9 * height); /* not quite round, so that there is something to fit */
    return (vec3){radius * cos(angle), radius * sin(angle), height};
}

static double can_row(size_t row) { return 0.6 * (double)row / (CAN_ROWS - 1); }

/* Points on the side of a can, which stood on its one flat end and had the other covered. */
static struct dense can_points(void) {
    struct dense dense = dense_new((size_t)CAN_ROWS * CAN_DENSE);
    for (size_t i = 0; i < dense.n; i++) {
        dense.point[i] = can_place(i % CAN_DENSE, CAN_DENSE, can_row(i / CAN_DENSE));
        dense.normal[i] = vec3_unit((vec3){dense.point[i].x, dense.point[i].y, 0});
        dense.spacing[i] = 0.012f;
    }
    return dense;
}

/* Rings around the can, the first and last on its ends, which are fans of their vertices. */
static struct mesh can_mesh(void) {
    enum { VERTICES = CAN_RINGS * CAN_AROUND, TRIANGLES = 2 * VERTICES - 4, LAST = VERTICES - CAN_AROUND };
    vec3 vertex[VERTICES];
    uint32_t triangle[TRIANGLES][3];
    size_t t = 0;
    for (size_t v = 0; v < VERTICES; v++)
        vertex[v] = can_place(v % CAN_AROUND, CAN_AROUND, 0.6 * (double)(v / CAN_AROUND) / (CAN_RINGS - 1));
    for (uint32_t v = 0; v < LAST; v++) {
        uint32_t next = v % CAN_AROUND == CAN_AROUND - 1 ? v + 1 - CAN_AROUND : v + 1;
        memcpy(triangle[t++], (uint32_t[3]){v, next, next + CAN_AROUND}, sizeof *triangle);
        memcpy(triangle[t++], (uint32_t[3]){v, next + CAN_AROUND, v + CAN_AROUND}, sizeof *triangle);
    }
    for (uint32_t k = 1; k + 1 < CAN_AROUND; k++) {
        memcpy(triangle[t++], (uint32_t[3]){0, k + 1, k}, sizeof *triangle);
        memcpy(triangle[t++], (uint32_t[3]){LAST, LAST + k, LAST + k + 1}, sizeof *triangle);
    }
    return mesh_new(vertex, VERTICES, (const uint32_t(*)[3])triangle, t);
}

/* No vertex goes far out over the plane of an end, where only the stray of its triangles is against it. */
static void test_ends_without_points_stay(void **state) {
    (void)state;
    struct dense dense = can_points();
    struct mesh mesh = can_mesh();
    struct refine_facts facts;
    double over = 0;
    refine(&mesh, &dense, REFINE_FULL, PLACEMENT_OPTIMAL, &facts);
    assert_true(facts.moves > CAN_AROUND && facts.mean_after < 0.5 * facts.mean_before);
    for (size_t v = 0; v < mesh.vertex_count; v++) over = fmax(over, fmax(-mesh.vertex[v].z, mesh.vertex[v].z - 0.6));
    assert_true(over < 20 * facts.mean_before);
    mesh_done(&mesh);
    dense_done(&dense);
}

enum { CONE_ROWS = 31, CONE_DENSE = 48, CONE_RINGS = 7, CONE_AROUND = 12 };

/* On a cone with its tip at .6, a little wavy. */
static vec3 cone_place(size_t turn, size_t around, double height) {
    double angle = 6.283185307 * (double)turn / (double)around;
    double radius = 0.5 * (0.6 - height) + 0.002 * sin(3 * angle + 9 * height);
    return (vec3){radius * cos(angle), radius * sin(angle), height};
}

/* Points up to a height of .3, where the cone was cut off: the end has none. */
static struct dense cone_points(void) {
    struct dense dense = dense_new((size_t)CONE_ROWS * CONE_DENSE);
    for (size_t i = 0; i < dense.n; i++) {
        dense.point[i] = cone_place(i % CONE_DENSE, CONE_DENSE, 0.3 * (double)(i / CONE_DENSE) / (CONE_ROWS - 1));
        dense.normal[i] = vec3_unit((vec3){dense.point[i].x, dense.point[i].y, 0.5 * (0.6 - dense.point[i].z) * 0.5});
        dense.spacing[i] = 0.015f;
    }
    return dense;
}

/* Rings up to a height of .2, and a vertex in the middle of either end. */
static struct mesh cone_mesh(void) {
    enum { TOP = CONE_RINGS * CONE_AROUND, BOTTOM, VERTICES, TRIANGLES = 2 * VERTICES - 4, LAST = TOP - CONE_AROUND };
    vec3 vertex[VERTICES];
    uint32_t triangle[TRIANGLES][3];
    size_t t = 0;
    for (size_t v = 0; v < TOP; v++)
        vertex[v] = cone_place(v % CONE_AROUND, CONE_AROUND, 0.2 * (double)(v / CONE_AROUND) / (CONE_RINGS - 1));
    vertex[TOP] = (vec3){0, 0, 0.3}, vertex[BOTTOM] = (vec3){0};
    for (uint32_t v = 0; v < TOP; v++) {
        uint32_t next = v % CONE_AROUND == CONE_AROUND - 1 ? v + 1 - CONE_AROUND : v + 1;
        if (v < CONE_AROUND) memcpy(triangle[t++], (uint32_t[3]){BOTTOM, next, v}, sizeof *triangle);
        if (v >= LAST) {
            memcpy(triangle[t++], (uint32_t[3]){TOP, v, next}, sizeof *triangle);
            continue;
        }
        memcpy(triangle[t++], (uint32_t[3]){v, next, next + CONE_AROUND}, sizeof *triangle);
        memcpy(triangle[t++], (uint32_t[3]){v, next + CONE_AROUND, v + CONE_AROUND}, sizeof *triangle);
    }
    return mesh_new(vertex, VERTICES, (const uint32_t(*)[3])triangle, t);
}

/* The points beside the end are met best by triangles that go on to the tip, which isn't there. */
static void test_no_vertex_leaves_the_points(void **state) {
    (void)state;
    struct dense dense = cone_points();
    struct mesh mesh = cone_mesh();
    struct refine_facts facts;
    double top = 0;
    refine(&mesh, &dense, REFINE_FULL, PLACEMENT_OPTIMAL, &facts);
    assert_true(facts.moves > CONE_AROUND && facts.mean_after < 0.8 * facts.mean_before);
    for (size_t v = 0; v < mesh.vertex_count; v++) top = fmax(top, mesh.vertex[v].z);
    assert_true(top < 0.3 + 8 * facts.mean_before);
    mesh_done(&mesh);
    dense_done(&dense);
}

/* ---------------------------------------------------------------------------------------------- faults */

static void fail_each_allocation(const struct dense *dense, const struct neighbourhood *neighbours,
                                 enum placement placement) {
    struct mesh mesh = sphere_mesh(dense), copy = sphere_mesh(dense);
    struct refine_input input = dense_input(dense);
    struct refine_options options = {REFINE_FULL, placement, 1};
    int failures = 0;
    input.neighbours = neighbours;
    for (;;) {
        faults_in_memory(failures + 1, false);
        enum status status = refine_mesh(&mesh, &input, &options, NULL, NULL);
        bool happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        if (!happened) break;
        failures++;
        assert_memory_equal(mesh.vertex, copy.vertex, mesh.vertex_count * sizeof(vec3));
        assert_memory_equal(mesh.triangle, copy.triangle, mesh.triangle_count * sizeof(uint32_t[3]));
    }
    assert_true(failures > 10);
    mesh_done(&mesh);
    mesh_done(&copy);
}

static void test_failure_leaves_the_mesh(void **state) {
    (void)state;
    struct dense dense = sphere_points(), fewer = fewer_sphere_points();
    struct neighbourhood neighbours = dense_neighbourhood(&fewer);
    fail_each_allocation(&dense, NULL, PLACEMENT_SUBSET);
    fail_each_allocation(&fewer, &neighbours, PLACEMENT_OPTIMAL);
    neighbourhood_done(&neighbours);
    dense_done(&dense), dense_done(&fewer);
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
    struct refine_input input = dense_input(&dense);
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
        cmocka_unit_test(test_samples_made_beforehand_change_nothing),
        cmocka_unit_test(test_a_closer_look_has_all_samples_in_the_lists),
        cmocka_unit_test(test_closed_stays_closed_and_gets_better),
        cmocka_unit_test(test_a_split_that_gains_much_may_fold),
        cmocka_unit_test(test_four_triangles_at_an_edge_are_no_border),
        cmocka_unit_test(test_what_crosses_is_parted),
        cmocka_unit_test(test_subset_stays_a_subset),
        cmocka_unit_test(test_threads_change_nothing),
        cmocka_unit_test(test_ends_without_points_stay),
        cmocka_unit_test(test_no_vertex_leaves_the_points),
        cmocka_unit_test(test_zones_are_compact),
        cmocka_unit_test(test_threads_change_nothing_in_many_zones),
        cmocka_unit_test(test_failure_leaves_the_mesh),
        cmocka_unit_test(test_cancel_leaves_the_mesh),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
