/* Tight Cocone: whatever the points, a mesh that is closed, oriented and a manifold; and on shapes with known answers
 * the right one.  The checks count edges and fans on their own, without core/mesh/mesh.c.
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
#include "core/surface/cocone/cocone_internal.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/mincut.h"
#include "core/surface/reconstruct.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

static const double PI = 3.14159265358979323846;

/* ------------------------------------------------------------------------------------------------ clouds */

struct points {
    size_t n;
    vec3 *point, *normal;
    double *support;
};

static struct points points_new(size_t most) {
    struct points p = {0, alloc_array(most, sizeof(vec3)), alloc_array(most, sizeof(vec3)),
                       alloc_array(most, sizeof(double))};
    assert_true(p.point && p.normal && p.support);
    return p;
}

static void points_done(struct points *p) { free(p->point), free(p->normal), free(p->support); }

static void points_add(struct points *p, vec3 point, vec3 normal, double support) {
    p->point[p->n] = point;
    p->normal[p->n] = normal;
    p->support[p->n++] = support;
}

/* Part of a sphere: the points with z up to top.  Every other normal points inwards. */
static void add_sphere(struct points *p, size_t n, double radius, vec3 centre, double top) {
    vec3 *sphere = shape_sphere(n, 1);
    for (size_t i = 0; i < n; i++) {
        if (sphere[i].z > top) continue;
        vec3 place = vec3_add(centre, vec3_scale(sphere[i], radius));
        points_add(p, place, vec3_scale(sphere[i], i % 2 ? 1 : -1), radius * 3 / sqrt((double)n));
    }
    free(sphere);
}

/* The surface of the cube of the given side on a grid with step, normals as a mesh would average them. */
static void add_cube(struct points *p, int side, double step) {
    for (int x = 0; x <= side; x++)
        for (int y = 0; y <= side; y++)
            for (int z = 0; z <= side; z++) {
                vec3 n = {(x == side) - (x == 0), (y == side) - (y == 0), (z == side) - (z == 0)};
                if (vec3_length_sq(n) == 0) continue;
                vec3 place = {(x - side / 2.0) * step, (y - side / 2.0) * step, (z - side / 2.0) * step};
                points_add(p, place, vec3_unit(n), step * 0.8);
            }
}

static void add_noise(struct points *p, size_t n, uint64_t seed) {
    for (size_t i = 0; i < n; i++) {
        vec3 place = {random_unit(&seed) - 0.5, random_unit(&seed) - 0.5, random_unit(&seed) - 0.5};
        vec3 normal = {random_unit(&seed) - 0.5, random_unit(&seed) - 0.5, random_unit(&seed) - 0.5};
        points_add(p, place, vec3_unit(normal), 0.05 * random_unit(&seed));
    }
}

/* ------------------------------------------------------------------------------------------------ running */

static enum status run(const struct points *p, struct reconstruct_options options, struct mesh *mesh,
                       struct reconstruct_facts *facts) {
    struct tets tets = {0};
    assert_int_equal(delaunay_build(p->point, p->n, 1, NULL, &tets, NULL), STATUS_OK);
    struct reconstruct_input input = {.points = p->point, .n = p->n, .normals = p->normal, .support = p->support};
    enum status status = reconstruct_surface(&tets, &input, &options, NULL, mesh, facts);
    tets_done(&tets);
    return status;
}

static struct mesh made(const struct points *p, unsigned form, enum boundary_form boundary,
                        struct reconstruct_facts *facts) {
    struct mesh mesh = {0};
    struct reconstruct_options options = {.method = form, .boundary = boundary, .threads = 1};
    assert_int_equal(run(p, options, &mesh, facts), STATUS_OK);
    return mesh;
}

/* ------------------------------------------------------------------------------------------------ checks */

struct arrow {
    uint32_t from, to;
};

static int by_ends(const void *x, const void *y) {
    const struct arrow *a = x, *b = y;
    if (a->from != b->from) return a->from < b->from ? -1 : 1;
    return a->to < b->to ? -1 : a->to > b->to;
}

/* All directed edges, sorted. */
static struct arrow *arrows_of(const struct mesh *mesh) {
    struct arrow *arrow = alloc_array(3 * mesh->triangle_count, sizeof *arrow);
    assert_non_null(arrow);
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            arrow[3 * t + (size_t)k] = (struct arrow){mesh->triangle[t][k], mesh->triangle[t][(k + 1) % 3]};
    qsort(arrow, 3 * mesh->triangle_count, sizeof *arrow, by_ends);
    return arrow;
}

/* Directed edges without their opposite; none may be there twice. */
static size_t count_open_edges(const struct mesh *mesh) {
    size_t open = 0, count = 3 * mesh->triangle_count;
    struct arrow *arrow = arrows_of(mesh);
    for (size_t i = 0; i < count; i++) {
        struct arrow back = {arrow[i].to, arrow[i].from};
        assert_true(arrow[i].from != arrow[i].to);
        assert_true(i == 0 || by_ends(&arrow[i - 1], &arrow[i]) != 0);
        open += bsearch(&back, arrow, count, sizeof *arrow, by_ends) == NULL;
    }
    free(arrow);
    return open;
}

/* The triangle that follows t around v, across the edge that leaves v's corner backwards; NONE at a boundary. */
static uint32_t next_around(const struct mesh *mesh, uint32_t t, uint32_t v) {
    uint32_t k = 0;
    while (mesh->triangle[t][k] != v) k++;
    uint32_t u = mesh->triangle[t][(k + 2) % 3];
    for (uint32_t other = 0; other < mesh->triangle_count; other++)
        for (uint32_t j = 0; j < 3; j++)
            if (mesh->triangle[other][j] == v && mesh->triangle[other][(j + 1) % 3] == u) return other;
    return NONE;
}

/* In a closed mesh: turning around each vertex from one of its triangles comes by all of them. */
static void check_fans(const struct mesh *mesh) {
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        size_t all = 0, met = 0;
        uint32_t first = NONE;
        for (uint32_t t = 0; t < mesh->triangle_count; t++) {
            bool there = mesh->triangle[t][0] == v || mesh->triangle[t][1] == v || mesh->triangle[t][2] == v;
            all += there;
            if (there && first == NONE) first = t;
        }
        assert_true(all >= 3);
        uint32_t t = first;
        do {
            t = next_around(mesh, t, v);
            met++;
        } while (t != first && t != NONE && met <= all);
        assert_int_equal(met, all);
    }
}

static double volume_of(const struct mesh *mesh) {
    double volume = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        volume += vec3_dot(mesh->vertex[v[0]], vec3_cross(mesh->vertex[v[1]], mesh->vertex[v[2]])) / 6;
    }
    return volume;
}

static long euler_of(const struct mesh *mesh) {
    return (long)mesh->vertex_count - (long)(3 * mesh->triangle_count / 2) + (long)mesh->triangle_count;
}

/* Closed, oriented, a manifold; vertices at the points that they stand for. */
static void check_solid(const struct mesh *mesh, const struct points *p) {
    assert_true(mesh->triangle_count >= 4);
    assert_int_equal(count_open_edges(mesh), 0);
    check_fans(mesh);
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        assert_true(mesh->source[v] < p->n);
        assert_true(vec3_equal(mesh->vertex[v], p->point[mesh->source[v]]));
    }
    assert_true(volume_of(mesh) > 0);
}

/* ------------------------------------------------------------------------------------------------ shapes */

static void four_points_are_a_tetrahedron(void **state) {
    (void)state;
    struct points p = points_new(4);
    vec3 corner[] = {{0, 0, 0}, {0.5, 0, 0}, {0, 0.5, 0}, {0, 0, 0.5}};
    for (int i = 0; i < 4; i++)
        points_add(&p, corner[i], vec3_unit(vec3_sub(corner[i], (vec3){0.125, 0.125, 0.125})), 1);
    struct reconstruct_facts facts;
    struct mesh mesh = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, &facts);
    check_solid(&mesh, &p);
    assert_int_equal(mesh.triangle_count, 4);
    assert_true(fabs(volume_of(&mesh) - 0.5 * 0.5 * 0.5 / 6) < 1e-12);
    assert_int_equal(facts.points_lost + facts.vertices_split + facts.hole_fill, 0);
    mesh_done(&mesh);
    points_done(&p);
}

static void a_sphere_is_one_whatever_the_signs_of_its_normals(void **state) {
    (void)state;
    struct points p = points_new(600);
    add_sphere(&p, 600, 0.25, (vec3){0.1, 0, 0}, 1);
    for (unsigned form = RECONSTRUCTION_TIGHT; form <= RECONSTRUCTION_LITERAL; form++) {
        struct reconstruct_facts facts;
        struct mesh mesh = made(&p, form, BOUNDARY_FILL, &facts);
        check_solid(&mesh, &p);
        assert_int_equal(euler_of(&mesh), 2);
        assert_int_equal(mesh.vertex_count, 600);
        assert_int_equal(facts.points_lost + facts.vertices_split + facts.hole_fill, 0);
        assert_string_equal(facts.form, form == RECONSTRUCTION_LITERAL ? "literal" : "tight-cocone");
        double whole = 4 * PI / 3 * 0.25 * 0.25 * 0.25;
        assert_true(volume_of(&mesh) > 0.98 * whole && volume_of(&mesh) < whole);
        mesh_done(&mesh);
    }
    points_done(&p);
}

static void without_normals_and_support_the_poles_do(void **state) {
    (void)state;
    struct points p = points_new(400);
    add_sphere(&p, 400, 0.3, (vec3){0, 0, 0}, 1);
    struct points bare = {p.n, p.point, NULL, NULL};
    struct mesh mesh = made(&bare, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, NULL);
    check_solid(&mesh, &p);
    assert_int_equal(mesh.vertex_count, 400);
    assert_int_equal(euler_of(&mesh), 2);
    mesh_done(&mesh);
    points_done(&p);
}

static void a_cospherical_cube_keeps_its_edges_and_corners(void **state) {
    (void)state;
    struct points p = points_new(1000);
    add_cube(&p, 8, 0.0625);
    struct reconstruct_facts facts;
    struct mesh mesh = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, &facts);
    check_solid(&mesh, &p);
    assert_int_equal(facts.points_lost, 0);
    assert_int_equal(euler_of(&mesh), 2);
    assert_true(fabs(volume_of(&mesh) - 0.125) < 1e-12);
    mesh_done(&mesh);
    points_done(&p);
}

static void two_spheres_are_two_solids(void **state) {
    (void)state;
    struct points p = points_new(800);
    add_sphere(&p, 400, 0.15, (vec3){-0.25, 0, 0}, 1);
    add_sphere(&p, 400, 0.15, (vec3){0.25, 0, 0}, 1);
    struct reconstruct_facts facts;
    struct mesh mesh = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, &facts);
    check_solid(&mesh, &p);
    assert_int_equal(euler_of(&mesh), 4);
    assert_int_equal(facts.points_lost + facts.hole_fill, 0);
    assert_true(fabs(volume_of(&mesh) / (2 * 4 * PI / 3 * 0.15 * 0.15 * 0.15) - 1) < 0.03);
    mesh_done(&mesh);
    points_done(&p);
}

/* A sphere: a cap of normals points inwards, and is to be turned; another one that is asked for isn't. */
static void a_patch_that_most_cells_are_against_is_turned(void **state) {
    (void)state;
    enum { N = 600 };
    struct points p = points_new(N);
    add_sphere(&p, N, 0.4, (vec3){0, 0, 0}, 1);
    struct tets tets = {0};
    struct cocone_star star = {0};
    struct cocone_frame frame = {0};
    struct cocone_lies lies = {0};
    struct cocone_groups groups = {0};
    uint32_t list[N];
    assert_int_equal(delaunay_build(p.point, p.n, 1, NULL, &tets, NULL), STATUS_OK);
    assert_int_equal(cocone_star_build(&tets, p.point, p.n, 1, &star), STATUS_OK);
    assert_int_equal(cocone_frame_build(&star, p.normal, 1, &frame, 1), STATUS_OK);
    for (uint32_t v = 0; v < p.n; v++)
        if ((vec3_dot(frame.normal[v], p.point[v]) > 0) == (p.point[v].z > 0.3)) cocone_frame_turn(&frame, v);
    assert_int_equal(cocone_orient_measure(&star, &frame, 1, 1, &lies), STATUS_OK);
    assert_int_equal(cocone_groups_new(p.n, &groups), STATUS_OK);
    size_t wrong = 0;
    for (uint32_t v = 0; v < p.n; v++) {
        groups.marked[v] = fabs(p.point[v].z) > 0.3;
        wrong += p.point[v].z > 0.3;
    }
    assert_int_equal(cocone_groups_against(&star, &lies, &groups, list), wrong);
    for (size_t i = 0; i < wrong; i++) assert_true(p.point[list[i]].z > 0.3);
    cocone_groups_done(&groups);
    cocone_orient_done(&lies);
    cocone_frame_done(&frame);
    cocone_star_done(&star);
    tets_done(&tets);
    points_done(&p);
}

/* Two spheres whose normals are told, those of the caps that face each other wrongly: where spanning gaps costs little
 * the gap would be filled. */
static void wrong_normals_make_no_web_where_gaps_cost_little(void **state) {
    (void)state;
    struct points p = points_new(1600);
    add_sphere(&p, 800, 0.2, (vec3){-0.25, 0, 0}, 1);
    add_sphere(&p, 800, 0.2, (vec3){0.25, 0, 0}, 1);
    for (size_t i = 0; i < p.n; i++) {
        vec3 outwards = vec3_sub(p.point[i], (vec3){p.point[i].x < 0 ? -0.25 : 0.25, 0, 0});
        bool faces = fabs(p.point[i].x) < 0.12;
        if ((vec3_dot(p.normal[i], outwards) < 0) != faces) p.normal[i] = vec3_scale(p.normal[i], -1);
    }
    struct tets tets = {0};
    struct mesh mesh = {0};
    struct reconstruct_facts facts;
    struct reconstruct_options options = {.method = RECONSTRUCTION_TIGHT, .boundary = BOUNDARY_FILL, .threads = 1};
    struct reconstruct_input input = {
        .points = p.point, .n = p.n, .normals = p.normal, .support = p.support, .oriented = true, .gaps = 1 / 12.0};
    assert_int_equal(delaunay_build(p.point, p.n, 1, NULL, &tets, NULL), STATUS_OK);
    assert_int_equal(reconstruct_surface(&tets, &input, &options, NULL, &mesh, &facts), STATUS_OK);
    check_solid(&mesh, &p);
    assert_int_equal(euler_of(&mesh), 4);
    assert_true(fabs(volume_of(&mesh) / (2 * 4 * PI / 3 * 0.2 * 0.2 * 0.2) - 1) < 0.03);
    mesh_done(&mesh);
    tets_done(&tets);
    points_done(&p);
}

static void an_inner_sphere_is_a_cavity(void **state) {
    (void)state;
    struct points p = points_new(1500);
    add_sphere(&p, 1000, 0.4, (vec3){0, 0, 0}, 1);
    add_sphere(&p, 400, 0.2, (vec3){0.05, 0, 0}, 1);
    struct reconstruct_facts facts;
    struct mesh mesh = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, &facts);
    check_solid(&mesh, &p);
    assert_int_equal(facts.points_lost, 0);
    assert_int_equal(euler_of(&mesh), 4);
    double walls = 4 * PI / 3 * (0.4 * 0.4 * 0.4 - 0.2 * 0.2 * 0.2);
    assert_true(fabs(volume_of(&mesh) / walls - 1) < 0.03);
    mesh_done(&mesh);
    points_done(&p);
}

static void a_bowl_is_closed_by_tagged_facets_or_left_open(void **state) {
    (void)state;
    struct points p = points_new(1000);
    add_sphere(&p, 1000, 0.4, (vec3){0, 0, 0}, 0.1);
    struct reconstruct_facts facts;
    struct mesh filled = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, &facts);
    check_solid(&filled, &p);
    assert_int_equal(facts.points_lost, 0);
    assert_true(facts.hole_fill > 10);
    size_t tagged = 0;
    for (size_t t = 0; t < filled.triangle_count; t++) {
        const uint32_t *v = filled.triangle[t];
        bool lid = filled.vertex[v[0]].z > 0 && filled.vertex[v[1]].z > 0 && filled.vertex[v[2]].z > 0;
        if (filled.tag[t] == MESH_HOLE_FILL) assert_true(lid);
        tagged += filled.tag[t] == MESH_HOLE_FILL;
    }
    assert_int_equal(tagged, facts.hole_fill);
    struct mesh open = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_KEEP, NULL);
    assert_int_equal(open.triangle_count, filled.triangle_count - tagged);
    assert_true(count_open_edges(&open) > 20);
    mesh_done(&filled);
    mesh_done(&open);
    points_done(&p);
}

static void a_plane_is_an_open_mesh_of_all_points(void **state) {
    (void)state;
    struct points p = points_new(100);
    for (int x = 0; x < 10; x++)
        for (int y = 0; y < 10; y++) points_add(&p, (vec3){x / 16.0, y / 16.0, 0}, (vec3){0, 0, 1}, 0.06);
    struct reconstruct_facts facts;
    struct mesh mesh = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, &facts);
    assert_string_equal(facts.form, "planar");
    assert_int_equal(mesh.vertex_count, 100);
    assert_int_equal(mesh.triangle_count, 2 * 81);
    assert_int_equal(count_open_edges(&mesh), 4 * 9);
    assert_int_equal(facts.hole_fill, 0);
    mesh_done(&mesh);
    points_done(&p);
}

/* Two triangles with a corner in common: the facets between them aren't supported. */
static void planar_patches_that_touch_get_a_vertex_each(void **state) {
    (void)state;
    struct points p = points_new(5);
    const double place[][2] = {{0, 0}, {0.2, 0.1}, {0.2, -0.1}, {-0.2, 0.1}, {-0.2, -0.1}};
    for (int i = 0; i < 5; i++) points_add(&p, (vec3){place[i][0], place[i][1], 0}, (vec3){0, 0, 1}, 0.12);
    struct reconstruct_facts facts;
    struct mesh mesh = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_KEEP, &facts);
    assert_int_equal(facts.points_lost, 0);
    assert_int_equal(facts.vertices_split, 1);
    assert_int_equal(mesh.triangle_count, 2);
    mesh_done(&mesh);
    points_done(&p);
}

static void points_on_a_line_are_degenerate(void **state) {
    (void)state;
    struct points p = points_new(5);
    for (int i = 0; i < 5; i++) points_add(&p, (vec3){i / 8.0, 0, 0}, (vec3){0, 0, 1}, 1);
    struct mesh mesh = {0};
    struct reconstruct_options options = {.method = RECONSTRUCTION_TIGHT, .boundary = BOUNDARY_FILL, .threads = 1};
    for (p.n = 1; p.n <= 5; p.n++) assert_int_equal(run(&p, options, &mesh, NULL), STATUS_DEGENERATE);
    assert_null(mesh.vertex);
    points_done(&p);
}

/* ------------------------------------------------------------------------------------------------ properties */

static void noise_still_gives_a_closed_manifold(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 12; seed++) {
        struct points p = points_new(300);
        add_noise(&p, 20 + 23 * seed, seed);
        for (unsigned form = RECONSTRUCTION_TIGHT; form <= RECONSTRUCTION_LITERAL; form++) {
            struct mesh mesh = {0};
            struct reconstruct_options options = {.method = form, .boundary = BOUNDARY_FILL, .threads = 1};
            enum status status = run(&p, options, &mesh, NULL);
            if (status == STATUS_OK)
                check_solid(&mesh, &p);
            else
                assert_int_equal(status, STATUS_DEGENERATE);
            assert_true(form == RECONSTRUCTION_LITERAL || status == STATUS_OK);
            mesh_done(&mesh);
        }
        points_done(&p);
    }
}

static void a_few_outliers_leave_the_surface_as_it_is(void **state) {
    (void)state;
    struct points p = points_new(500);
    add_sphere(&p, 400, 0.3, (vec3){0, 0, 0}, 1);
    add_noise(&p, 6, 9);
    struct mesh mesh = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, NULL);
    check_solid(&mesh, &p);
    assert_true(fabs(volume_of(&mesh) / (4 * PI / 3 * 0.027) - 1) < 0.25);
    mesh_done(&mesh);
    points_done(&p);
}

static void assert_same_mesh(const struct mesh *a, const struct mesh *b) {
    assert_int_equal(a->vertex_count, b->vertex_count);
    assert_int_equal(a->triangle_count, b->triangle_count);
    assert_memory_equal(a->source, b->source, a->vertex_count * sizeof *a->source);
    assert_memory_equal(a->triangle, b->triangle, a->triangle_count * sizeof *a->triangle);
    assert_memory_equal(a->tag, b->tag, a->triangle_count);
}

static void the_number_of_threads_does_not_matter(void **state) {
    (void)state;
    struct points p = points_new(3000);
    add_sphere(&p, 2500, 0.4, (vec3){0, 0, 0}, 0.7);
    add_noise(&p, 100, 4);
    struct reconstruct_options one = {.method = RECONSTRUCTION_TIGHT, .boundary = BOUNDARY_FILL, .threads = 1},
                               many = one;
    many.threads = 7;
    struct mesh a = {0}, b = {0};
    assert_int_equal(run(&p, one, &a, NULL), STATUS_OK);
    assert_int_equal(run(&p, many, &b, NULL), STATUS_OK);
    assert_same_mesh(&a, &b);
    mesh_done(&a), mesh_done(&b);
    points_done(&p);
}

static void the_order_of_points_does_not_matter_on_a_good_sample(void **state) {
    (void)state;
    enum { N = 500 };
    struct points p = points_new(N), q = points_new(N);
    add_sphere(&p, N, 0.3, (vec3){0, 0, 0}, 1);
    for (size_t i = 0; i < N; i++) {
        size_t j = (i * 7 + 3) % N;
        points_add(&q, p.point[j], p.normal[j], p.support[j]);
    }
    struct mesh a = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, NULL);
    struct mesh b = made(&q, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, NULL);
    assert_int_equal(a.triangle_count, b.triangle_count);
    assert_true(fabs(volume_of(&a) - volume_of(&b)) < 1e-12);
    mesh_done(&a), mesh_done(&b);
    points_done(&p), points_done(&q);
}

/* ------------------------------------------------------------------------------------------------ the cut */

/* Five nodes in a row with arcs of 4, 2, 5 and 1; the other arcs lead around with no capacity. */
static void the_cut_goes_through_the_cheapest_arc(void **state) {
    (void)state;
    enum { N = 5 };
    uint32_t neighbour[N][4];
    uint8_t mirror[N][4];
    int32_t capacity[N][4] = {{0}};
    const int32_t price[N] = {4, 2, 5, 1, 0};
    for (uint32_t c = 0; c < N; c++) {
        for (int i = 0; i < 4; i++) neighbour[c][i] = (c + (i % 2 ? N - 1 : 1)) % N, mirror[c][i] = (uint8_t)(i ^ 1);
        capacity[c][0] = price[c];
        capacity[(c + 1) % N][1] = price[c];
    }
    const struct {
        int32_t terminal[N];
        uint8_t side[N];
    } cases[] = {
        {{9, 0, 0, 0, -9}, {1, 1, 1, 1, 0}},  {{9, 0, 0, -9, 0}, {1, 1, 0, 0, 0}},  {{1, 0, 0, 0, -9}, {0, 0, 0, 0, 0}},
        {{-9, 0, 3, 0, -9}, {0, 0, 0, 0, 0}}, {{-9, 0, 4, 3, -9}, {0, 0, 1, 1, 0}},
    };
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        int32_t left[N][4], terminal[N];
        uint8_t side[N];
        memcpy(left, capacity, sizeof left);
        memcpy(terminal, cases[k].terminal, sizeof terminal);
        struct mincut graph = {N, (const uint32_t(*)[4])neighbour, (const uint8_t(*)[4])mirror, left, terminal};
        struct mincut_search *search = NULL;
        assert_int_equal(mincut_new(&graph, &search), STATUS_OK);
        assert_int_equal(mincut_flow(search, "cut", NULL), STATUS_OK);
        for (uint32_t c = 0; c < N; c++) side[c] = mincut_is_source(search, c);
        mincut_free(search);
        assert_memory_equal(side, cases[k].side, sizeof side);
    }
}

/* ------------------------------------------------------------------------------------------------ faults */

/* How often a probe was asked, and what it answers: that one, and from the `last` time on another one. */
struct answer {
    size_t asked, last;
    const struct points *points;
    enum reconstruct_answer first, then;
};

static enum status give_answer(void *ctx, const struct mesh *rough, enum reconstruct_stage stage,
                               enum reconstruct_answer *answer) {
    struct answer *own = ctx;
    assert_int_equal(stage, own->asked == 0 ? STAGE_LABELLED : STAGE_REPAIRED); /* nothing is there to judge by */
    if (own->points) check_solid(rough, own->points);
    *answer = ++own->asked < own->last ? own->first : own->then;
    return STATUS_OK;
}

static void what_is_enough_is_not_improved(void **state) {
    (void)state;
    struct points p = points_new(3000);
    add_noise(&p, 1000, 3);
    for (int enough = 0; enough < 2; enough++) {
        struct answer answer = {.points = &p, .then = enough ? ANSWER_ENOUGH : ANSWER_GO_ON};
        const struct reconstruct_probe probe = {give_answer, &answer};
        struct reconstruct_options options = {.method = RECONSTRUCTION_TIGHT, .threads = 1, .probe = &probe};
        struct reconstruct_facts facts;
        struct mesh mesh = {0};
        assert_int_equal(run(&p, options, &mesh, &facts), STATUS_OK);
        assert_int_equal(answer.asked, 1);
        assert_true(enough == (facts.flips == 0));
        check_solid(&mesh, &p);
        mesh_done(&mesh);
    }
    points_done(&p);
}

/* Without an answer that asks for it, nobody asks a second time; where the mended labels are enough they are the mesh.
 */
static void what_is_in_doubt_is_asked_again_when_it_is_repaired(void **state) {
    (void)state;
    struct points p = points_new(3000);
    add_noise(&p, 1000, 3);
    struct mesh plain = made(&p, RECONSTRUCTION_TIGHT, BOUNDARY_FILL, NULL);
    for (int enough = 0; enough < 2; enough++) {
        struct answer answer = {
            .last = 2, .first = ANSWER_ASK_AGAIN, .then = enough ? ANSWER_ENOUGH : ANSWER_GO_ON, .points = &p};
        const struct reconstruct_probe probe = {give_answer, &answer};
        struct reconstruct_options options = {.method = RECONSTRUCTION_TIGHT, .threads = 1, .probe = &probe};
        struct reconstruct_facts facts;
        struct mesh mesh = {0};
        assert_int_equal(run(&p, options, &mesh, &facts), STATUS_OK);
        assert_int_equal(answer.asked, 2);
        assert_true(facts.flips > 0);
        assert_int_equal(mesh.triangle_count, plain.triangle_count);
        mesh_done(&mesh);
    }
    mesh_done(&plain);
    points_done(&p);
}

/* Whether the nth allocation was there to fail. */
static bool fails_at(const struct tets *tets, const struct reconstruct_input *input, unsigned form, int nth) {
    struct mesh mesh = {0};
    struct answer answer = {.then = nth % 2 > 0 ? ANSWER_ENOUGH : ANSWER_GO_ON};
    const struct reconstruct_probe probe = {give_answer, &answer};
    struct reconstruct_options options = {
        .method = form, .boundary = BOUNDARY_FILL, .threads = 1, .probe = nth % 3 > 0 ? &probe : NULL};
    faults_in_memory(nth, false);
    enum status status = reconstruct_surface(tets, input, &options, NULL, &mesh, NULL);
    bool happened = faults_stop();
    assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    assert_true(happened == !mesh.vertex);
    mesh_done(&mesh);
    return happened;
}

static void every_failing_allocation_is_a_status(void **state) {
    (void)state;
    struct points p = points_new(200);
    add_sphere(&p, 150, 0.3, (vec3){0, 0, 0}, 1);
    struct tets tets = {0};
    assert_int_equal(delaunay_build(p.point, p.n, 1, NULL, &tets, NULL), STATUS_OK);
    struct reconstruct_input input = {.points = p.point, .n = p.n, .normals = p.normal, .support = p.support};
    for (unsigned form = RECONSTRUCTION_TIGHT; form <= RECONSTRUCTION_LITERAL; form++) {
        int nth = 1;
        while (fails_at(&tets, &input, form, nth)) nth++;
        assert_true(nth > 20);
    }
    tets_done(&tets);
    points_done(&p);
}

static int stop(void *ctx, const char *stage, double fraction) {
    assert_string_equal(stage, "cocone");
    assert_true(fraction >= 0 && fraction <= 1);
    return (*(int *)ctx)-- == 0;
}

static void it_stops_whenever_it_is_asked(void **state) {
    (void)state;
    struct points p = points_new(2000); /* so many that the cut is asked, too */
    add_sphere(&p, 2000, 0.3, (vec3){0, 0, 0}, 1);
    struct tets tets = {0};
    assert_int_equal(delaunay_build(p.point, p.n, 1, NULL, &tets, NULL), STATUS_OK);
    struct reconstruct_input input = {.points = p.point, .n = p.n, .normals = p.normal, .support = p.support};
    struct reconstruct_options options = {.method = RECONSTRUCTION_TIGHT, .boundary = BOUNDARY_FILL, .threads = 1};
    struct mesh mesh = {0};
    bool stopped = true;
    int asked = 0;
    for (; stopped; asked++) {
        int left = asked;
        struct progress progress = {stop, &left};
        enum status status = reconstruct_surface(&tets, &input, &options, &progress, &mesh, NULL);
        stopped = left < 0;
        assert_int_equal(status, stopped ? STATUS_CANCELLED : STATUS_OK);
        assert_true(stopped == !mesh.vertex);
    }
    assert_true(asked > 5);
    mesh_done(&mesh);
    tets_done(&tets);
    points_done(&p);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(four_points_are_a_tetrahedron),
        cmocka_unit_test(a_sphere_is_one_whatever_the_signs_of_its_normals),
        cmocka_unit_test(without_normals_and_support_the_poles_do),
        cmocka_unit_test(a_cospherical_cube_keeps_its_edges_and_corners),
        cmocka_unit_test(two_spheres_are_two_solids),
        cmocka_unit_test(a_patch_that_most_cells_are_against_is_turned),
        cmocka_unit_test(wrong_normals_make_no_web_where_gaps_cost_little),
        cmocka_unit_test(an_inner_sphere_is_a_cavity),
        cmocka_unit_test(a_bowl_is_closed_by_tagged_facets_or_left_open),
        cmocka_unit_test(a_plane_is_an_open_mesh_of_all_points),
        cmocka_unit_test(planar_patches_that_touch_get_a_vertex_each),
        cmocka_unit_test(points_on_a_line_are_degenerate),
        cmocka_unit_test(noise_still_gives_a_closed_manifold),
        cmocka_unit_test(a_few_outliers_leave_the_surface_as_it_is),
        cmocka_unit_test(the_number_of_threads_does_not_matter),
        cmocka_unit_test(the_order_of_points_does_not_matter_on_a_good_sample),
        cmocka_unit_test(the_cut_goes_through_the_cheapest_arc),
        cmocka_unit_test(what_is_enough_is_not_improved),
        cmocka_unit_test(what_is_in_doubt_is_asked_again_when_it_is_repaired),
        cmocka_unit_test(every_failing_allocation_is_a_status),
        cmocka_unit_test(it_stops_whenever_it_is_asked),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
