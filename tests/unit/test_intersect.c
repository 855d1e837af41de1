/* Exact signs, and meshes that pass through themselves.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <float.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/math/predicates.h"
#include "core/mesh/intersect.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

static size_t count_of(const vec3 *vertex, size_t vertices, const uint32_t (*triangle)[3], size_t triangles) {
    struct mesh mesh = {.vertex_count = vertices,
                        .vertex = (vec3 *)vertex,
                        .triangle_count = triangles,
                        .triangle = (uint32_t(*)[3])triangle};
    size_t one = 7, two = 8;
    assert_int_equal(mesh_count_intersections(&mesh, 1, &one), STATUS_OK);
    assert_int_equal(mesh_count_intersections(&mesh, 3, &two), STATUS_OK);
    assert_int_equal(one, two);
    return one;
}

/* Near the plane x = y, where a determinant in double is all rounding. */
static void signs_are_exact(void **state) {
    (void)state;
    const vec3 a = {12, 12, 0}, b = {24, 24, 0}, c = {24, 24, 24};
    const double step = DBL_EPSILON / 2;
    for (int i = 0; i < 40; i++)
        for (int j = 0; j < 40; j++) {
            vec3 p = {0.5 + i * step, 0.5 + j * step, 0.1};
            int side = (i > j) - (i < j);
            assert_int_equal(predicate_side(a, b, c, p), side);
            assert_int_equal(predicate_side(b, a, c, p), -side);
            assert_int_equal(predicate_turn(a, b, p, 2), -side);
            assert_int_equal(predicate_turn(b, a, p, 2), side);
        }
}

static void sides_are_those_of_the_normal(void **state) {
    (void)state;
    const vec3 o = {0, 0, 0}, x = {1, 0, 0}, y = {0, 1, 0}, z = {0, 0, 1};
    assert_int_equal(predicate_side(o, x, y, z), 1);
    assert_int_equal(predicate_side(o, y, x, z), -1);
    assert_int_equal(predicate_side(o, x, y, (vec3){3, 4, 0}), 0);
    assert_int_equal(predicate_side(o, x, (vec3){2, 0, 0}, z), 0);
    assert_int_equal(predicate_turn(o, x, y, 2), 1);
    assert_int_equal(predicate_turn(o, y, z, 0), 1);
    assert_int_equal(predicate_turn(o, z, x, 1), 1);
    assert_int_equal(predicate_turn(o, x, y, 0), 0);
}

/* What two triangles have in common, and whether that is more than what they share. */
static void pairs_are_told_apart(void **state) {
    (void)state;
    static const vec3 base[3] = {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}};
    static const struct {
        vec3 other[3];
        size_t pairs;
    } cases[] = {
        {{{1, 1, 1}, {2, 1, 1}, {1, 2, 1}}, 0},       /* above */
        {{{1, 1, -1}, {1, 1, 1}, {9, 9, 1}}, 1},      /* through the middle */
        {{{9, 9, -1}, {9, 9, 1}, {8, 9, 1}}, 0},      /* through the plane, beside it */
        {{{1, 1, 0}, {1, 1, 5}, {2, 1, 5}}, 1},       /* stands on it */
        {{{2, 2, 0}, {9, 9, 5}, {9, 8, 5}}, 1},       /* touches an edge */
        {{{5, 5, 0}, {9, 5, 0}, {5, 9, 0}}, 0},       /* in the plane, beside it */
        {{{1, 1, 0}, {9, 1, 0}, {1, 9, 0}}, 1},       /* in the plane, over it */
        {{{1, 1, 0}, {2, 1, 0}, {1, 2, 0}}, 1},       /* in the plane, within it */
        {{{-9, -9, 0}, {30, -9, 0}, {-9, 30, 0}}, 1}, /* in the plane, around it */
        {{{0, 0, 0}, {-4, 0, 1}, {0, -4, 1}}, 0},     /* shares a corner */
        {{{0, 0, 0}, {2, 2, -1}, {2, 2, 1}}, 1},      /* shares a corner, and cuts on */
        {{{0, 0, 0}, {2, 1, 0}, {-1, -3, 0}}, 1},     /* shares a corner, and lies over it */
        {{{0, 0, 0}, {2, 0, 0}, {1, -3, 1}}, 1},      /* shares a corner and half an edge */
        {{{4, 0, 0}, {0, 0, 0}, {0, 0, 4}}, 0},       /* shares an edge */
        {{{4, 0, 0}, {0, 0, 0}, {1, -4, 0}}, 0},      /* shares an edge, in the plane */
        {{{4, 0, 0}, {0, 0, 0}, {1, 1, 0}}, 1},       /* folded onto it */
        {{{0, 4, 0}, {0, 0, 0}, {4, 0, 0}}, 1},       /* the same corners */
        {{{1, 1, -1}, {1, 1, 1}, {1, 1, 3}}, 0},      /* has no area */
        {{{0, 0, 0}, {0, 0, 0}, {4, 0, 0}}, 0},       /* nor has this */
    };
    static const uint32_t two[2][3] = {{0, 1, 2}, {3, 4, 5}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++)
        for (int turn = 0; turn < 6; turn++) {
            vec3 vertex[6];
            for (int k = 0; k < 3; k++) {
                vertex[turn % 2 ? 3 + k : k] = base[(turn + k) % 3];
                vertex[turn % 2 ? k : 3 + k] = cases[i].other[(turn / 2 + k) % 3];
            }
            assert_int_equal(count_of(vertex, 6, two, 2), cases[i].pairs);
        }
}

/* ------------------------------------------------------------------------------------------------ in one plane */

struct place {
    int x, y;
};

static int turn_of(struct place a, struct place b, struct place c) {
    int area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    return (area > 0) - (area < 0);
}

static bool is_between(int a, int b, int c) { return (a <= b && b <= c) || (c <= b && b <= a); }

static bool is_on_segment(struct place a, struct place b, struct place p) {
    return turn_of(a, b, p) == 0 && is_between(a.x, p.x, b.x) && is_between(a.y, p.y, b.y);
}

static bool segments_meet(struct place a, struct place b, struct place c, struct place d) {
    bool touch = is_on_segment(a, b, c) || is_on_segment(a, b, d) || is_on_segment(c, d, a) || is_on_segment(c, d, b);
    if (touch) return true;
    return turn_of(a, b, c) * turn_of(a, b, d) < 0 && turn_of(c, d, a) * turn_of(c, d, b) < 0;
}

static bool holds(const struct place t[3], struct place p) {
    int one = turn_of(t[0], t[1], p), two = turn_of(t[1], t[2], p), three = turn_of(t[2], t[0], p);
    return (one >= 0 && two >= 0 && three >= 0) || (one <= 0 && two <= 0 && three <= 0);
}

/* Where an edge of one meets one of the other, or one is within the other. */
static bool have_place_in_common(const struct place a[3], const struct place b[3]) {
    bool meet = holds(a, b[0]) || holds(b, a[0]);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) meet = meet || segments_meet(a[i], a[(i + 1) % 3], b[k], b[(k + 1) % 3]);
    return meet;
}

static bool share_corner(const struct place a[3], const struct place b[3]) {
    for (int i = 0; i < 9; i++)
        if (a[i / 3].x == b[i % 3].x && a[i / 3].y == b[i % 3].y) return true;
    return false;
}

/* Planes across each axis, and a slanted one. */
static vec3 lifted(struct place p, int plane) {
    if (plane == 0) return (vec3){p.x, p.y, 0.1};
    if (plane == 1) return (vec3){0.1, p.x, p.y};
    if (plane == 2) return (vec3){p.y, 0.1, p.x};
    return (vec3){p.x, p.y, p.x + 2 * p.y};
}

static void triangles_of_one_plane_meet_where_they_have_a_place_in_common(void **state) {
    (void)state;
    static const uint32_t two[2][3] = {{0, 1, 2}, {3, 4, 5}};
    uint64_t random = 11;
    size_t met[2] = {0, 0};
    for (int trial = 0; trial < 20000; trial++) {
        struct place t[2][3];
        for (int i = 0; i < 6; i++)
            t[i / 3][i % 3] = (struct place){(int)(9 * random_unit(&random)), (int)(9 * random_unit(&random))};
        bool flat = turn_of(t[0][0], t[0][1], t[0][2]) == 0 || turn_of(t[1][0], t[1][1], t[1][2]) == 0;
        if (flat || share_corner(t[0], t[1])) continue;
        vec3 vertex[6];
        for (int i = 0; i < 6; i++) vertex[i] = lifted(t[i / 3][i % 3], trial % 4);
        size_t expected = have_place_in_common(t[0], t[1]) ? 1 : 0;
        assert_int_equal(count_of(vertex, 6, two, 2), expected);
        met[expected]++;
    }
    assert_true(met[0] > 1000 && met[1] > 1000);
}

/* Many small triangles: as many pairs as looking at each pair finds. */
static void all_pairs_are_found(void **state) {
    (void)state;
    enum { N = 600 };
    static vec3 vertex[3 * N];
    static uint32_t triangle[N][3];
    uint64_t random = 3;
    size_t expected = 0;
    for (uint32_t t = 0; t < N; t++) {
        vec3 at = {random_unit(&random), random_unit(&random), random_unit(&random)};
        for (uint32_t k = 0; k < 3; k++) {
            vec3 off = {random_unit(&random), random_unit(&random), random_unit(&random)};
            vertex[3 * t + k] = vec3_add(at, vec3_scale(off, 0.2));
            triangle[t][k] = 3 * t + k;
        }
    }
    for (uint32_t t = 0; t < N; t++)
        for (uint32_t u = t + 1; u < N; u++) {
            uint32_t two[2][3];
            memcpy(two[0], triangle[t], sizeof two[0]), memcpy(two[1], triangle[u], sizeof two[1]);
            struct mesh pair = {.vertex_count = 3 * N, .vertex = vertex, .triangle_count = 2, .triangle = two};
            size_t meets = 0;
            assert_int_equal(mesh_count_intersections(&pair, 1, &meets), STATUS_OK);
            expected += meets;
        }
    assert_true(expected > 20);
    assert_int_equal(count_of(vertex, 3 * N, (const uint32_t(*)[3])triangle, N), expected);
    assert_int_equal(count_of(vertex, 0, NULL, 0), 0);
}

/* After each change what is found is what a mesh that was so from the beginning has. */
static void changes_are_followed(void **state) {
    (void)state;
    enum { N = 100 };
    static vec3 vertex[3 * N];
    static uint32_t triangle[N][3];
    static uint8_t touched[N];
    struct mesh mesh = {.vertex_count = 3 * N, .vertex = vertex, .triangle_count = N, .triangle = triangle};
    struct intersections *found = NULL;
    uint64_t random = 5;
    uint32_t(*followed)[2] = NULL;
    size_t most = 0, followed_count = 0;
    for (uint32_t i = 0; i < 3 * N; i++) triangle[i / 3][i % 3] = i;
    assert_int_equal(intersections_new(&mesh, 2, &found), STATUS_OK);
    for (uint32_t step = 0; step < 2 * N; step++) {
        vec3 at = {random_unit(&random), random_unit(&random), random_unit(&random)};
        for (uint32_t k = 0; k < 3; k++) {
            vec3 off = {random_unit(&random), random_unit(&random), random_unit(&random)};
            vertex[3 * (step % N) + k] = vec3_add(at, vec3_scale(off, 0.5));
        }
        intersections_update(found, step % N);
        uint32_t(*pair)[2] = NULL, other[N];
        size_t pairs = 0, counted = 0, of_all = 0;
        assert_int_equal(intersections_list(found, 2, &pair, &pairs), STATUS_OK);
        assert_int_equal(mesh_count_intersections(&mesh, 1, &counted), STATUS_OK);
        assert_int_equal(pairs, counted);
        for (size_t i = 0; i < pairs; i++) assert_true(pair[i][0] < pair[i][1]);
        for (size_t i = 1; i < pairs; i++) assert_true(memcmp(pair[i - 1], pair[i], sizeof pair[i]) != 0);
        for (uint32_t t = 0; t < N; t++) {
            size_t n = intersections_of(found, &vertex[3 * t], NULL, 0, other, N), others = 0;
            for (size_t i = 0; i < n; i++) others += other[i] != t;
            assert_int_equal(intersections_of(found, &vertex[3 * t], &t, 1, other, N), others);
            for (size_t i = 0; i < others; i++) assert_int_not_equal(other[i], t);
            assert_int_equal(intersections_among(found, &vertex[3 * t], other, others), others);
            for (size_t few = 0; few <= others; few++) {
                uint32_t some[N + 1];
                size_t told = few < others ? few + 1 : others;
                assert_int_equal(intersections_of(found, &vertex[3 * t], &t, 1, some, few), told);
                assert_memory_equal(some, other, told * sizeof *some);
            }
            assert_int_equal(intersections_of(found, &vertex[3 * t], other, others, NULL, N), n - others);
            of_all += others;
        }
        assert_int_equal(of_all, 2 * pairs);
        most = pairs > most ? pairs : most;
        touched[step % N] = 1;
        if (step % 3 == 0) { /* several changes at once */
            assert_int_equal(intersections_list_again(found, touched, &followed, &followed_count), STATUS_OK);
            assert_int_equal(followed_count, pairs);
            if (pairs) assert_memory_equal(followed, pair, pairs * sizeof *pair);
            memset(touched, 0, sizeof touched);
        }
        free(pair);
    }
    assert_true(most > 20);
    free(followed);
    intersections_free(found);
    intersections_free(NULL);
}

static void without_memory_nothing_is_counted(void **state) {
    (void)state;
    static vec3 vertex[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    static uint32_t triangle[][3] = {{0, 1, 2}};
    struct mesh mesh = {.vertex_count = 3, .vertex = vertex, .triangle_count = 1, .triangle = triangle};
    for (long nth = 1; nth <= 6; nth++) {
        size_t pairs = 5;
        faults_in_memory(nth, false);
        enum status status = mesh_count_intersections(&mesh, 1, &pairs);
        assert_true(faults_stop());
        assert_int_equal(status, STATUS_NO_MEMORY);
        assert_int_equal(pairs, 5);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(signs_are_exact),
        cmocka_unit_test(sides_are_those_of_the_normal),
        cmocka_unit_test(pairs_are_told_apart),
        cmocka_unit_test(triangles_of_one_plane_meet_where_they_have_a_place_in_common),
        cmocka_unit_test(all_pairs_are_found),
        cmocka_unit_test(changes_are_followed),
        cmocka_unit_test(without_memory_nothing_is_counted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
