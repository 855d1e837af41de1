/* Surfaces with borders: what comes out is a manifold with the borders that the scan has, and nothing where no points
 * are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/cloud/cloud.h"
#include "core/simplify/normals.h"
#include "core/spatial/knn.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/reconstruct.h"
#include "core/surface/sheet/carve.h"
#include "core/surface/sheet/kind.h"
#include "core/surface/sheet/orient.h"
#include "core/surface/sheet/sheet.h"
#include "tests/unit/dense.h"
#include "tests/unit/faults.h"

enum { POINTS = 8000, EACH = 8 /* so many points for each that is kept */ };

/* ------------------------------------------------------------------------------------------------ scans */

static double fraction(size_t i, unsigned axis) { return (double)(hash64(2 * i + axis + 1) >> 11) * 0x1p-53; }

/* Evenly spread over the unit square, though not on a grid. */
static void place(size_t i, size_t n, double *u, double *v) {
    size_t side = (size_t)sqrt((double)n);
    *u = ((double)(i % side) + 0.2 + 0.6 * fraction(i, 0)) / (double)side;
    *v = ((double)(i / side) + 0.2 + 0.6 * fraction(i, 1)) / (double)side;
}

/* From the unit square to a surface; false where there is none. */
typedef bool shape(double u, double v, vec3 *p);

static bool waves(double u, double v, vec3 *p) {
    *p = (vec3){u, v, 0.08 * sin(9 * u) * cos(7 * v)};
    return true;
}

static bool waves_with_hole(double u, double v, vec3 *p) {
    waves(u, v, p);
    return hypot(u - 0.5, v - 0.5) > 0.2;
}

static bool flat_with_hole(double u, double v, vec3 *p) {
    *p = (vec3){u, v, 0};
    return hypot(u - 0.5, v - 0.5) > 0.2;
}

static bool hills(double u, double v, vec3 *p) {
    *p = (vec3){u, v, 0.3 * sin(15 * u) * sin(13 * v + 1)};
    return true;
}

static bool two_islands(double u, double v, vec3 *p) {
    waves(u, v, p);
    return fabs(u - 0.5) > 0.1;
}

/* Lambert's equal areas. */
static bool half_sphere(double u, double v, vec3 *p) {
    double x = 2 * u - 1, y = 2 * v - 1, rr = x * x + y * y;
    *p = vec3_scale((vec3){x * sqrt(2 - rr), y * sqrt(2 - rr), 1 - rr}, 0.4);
    return rr < 1;
}

/* Five sides of a box. */
static bool box(double u, double v, vec3 *p) {
    int side = (int)(5 * u);
    double a = 5 * u - side, s[5][3] = {{0, a, v}, {1, a, v}, {a, 0, v}, {a, 1, v}, {a, v, 0}};
    *p = (vec3){0.5 * s[side][0], 0.5 * s[side][1], 0.5 * s[side][2]};
    return true;
}

struct scan {
    struct dense dense;
    struct knn *knn;
    vec3 *kept;
    size_t kept_count;
    bool viewed; /* all of it from view */
    vec3 view;
};

static struct scan scan_of(shape *of) {
    struct scan scan = {.dense = dense_new(POINTS), .kept = calloc(POINTS, sizeof(vec3))};
    size_t n = 0;
    assert_non_null(scan.kept);
    for (size_t i = 0; i < POINTS; i++) {
        double u, v;
        place(i, POINTS, &u, &v);
        if (of(u, v, &scan.dense.point[n])) n++;
    }
    scan.dense.n = n;
    for (size_t i = 0; i < n; i++) {
        scan.dense.spacing[i] = (float)sqrt(1.0 / POINTS);
        if (hash64(i) % EACH == 0) scan.kept[scan.kept_count++] = scan.dense.point[i];
    }
    assert_int_equal(knn_new(scan.dense.point, n, 1, &scan.knn, NULL), STATUS_OK);
    return scan;
}

static void scan_done(struct scan *scan) {
    knn_free(scan->knn);
    free(scan->kept);
    dense_done(&scan->dense);
}

static enum status made_within(const struct scan *scan, enum surface_form form, unsigned threads,
                               const struct progress *progress, struct mesh *mesh, struct reconstruct_facts *facts) {
    struct reconstruct_dense dense = {
        scan->dense.n, scan->dense.point, scan->dense.normal, scan->dense.spacing, NULL, scan->knn, NULL, NULL, NULL};
    struct reconstruct_input input = {.points = scan->kept, .n = scan->kept_count, .dense = &dense};
    struct reconstruct_options options = {
        .threads = threads, .surface = form, .up = {0, 0, 1}, .viewed = scan->viewed, .view = scan->view};
    struct tets tets = {0};
    enum status status = delaunay_build(scan->kept, scan->kept_count, 1, NULL, &tets, NULL);
    if (!status) status = reconstruct_sheet(&tets, &input, &options, progress, mesh, facts, NULL);
    tets_done(&tets);
    return status;
}

static struct mesh made(const struct scan *scan, enum surface_form form, struct reconstruct_facts *facts) {
    struct mesh mesh = {0};
    assert_int_equal(made_within(scan, form, 1, NULL, &mesh, facts), STATUS_OK);
    return mesh;
}

/* ------------------------------------------------------------------------------------------------ what is before */

/* A wall, ground that is seen at a slant, a triangle in the air before the wall, one before nothing, one behind it; two
 * small ones, before the wall and on it. */
static void triangles_that_rays_went_through_are_told(void **state) {
    (void)state;
    enum { SIDE = 60 };
    static vec3 point[2 * SIDE * SIDE];
    vec3 vertex[] = {{-2, 0, 4},  {2, 0, 4},  {0, 2, 4},    {-1, -.5, 2}, {1, -.5, 2}, {0, -.5, 3.9}, {-.6, .1, 2},
                     {.6, .1, 2}, {0, .7, 2}, {-1, 1, -2},  {1, 1, -2},   {0, 2, -2},  {-2, .1, 6},   {2, .1, 6},
                     {0, 2, 6},   {0, .3, 2}, {.02, .3, 2}, {0, .32, 2},  {0, .3, 4},  {.02, .3, 4},  {0, .32, 4}};
    uint32_t triangle[][3] = {{0, 1, 2}, {3, 4, 5}, {6, 7, 8}, {9, 10, 11}, {12, 13, 14}, {15, 16, 17}, {18, 19, 20}};
    const struct mesh mesh = {.vertex = vertex, .vertex_count = 21, .triangle = triangle, .triangle_count = 7};
    static const uint8_t through[] = {0, 0, 1, 0, 0, 1, 0};
    uint8_t out[7] = {9, 9, 9, 9, 9, 9, 9};
    size_t n = 0;
    for (int i = 0; i < SIDE; i++)
        for (int k = 0; k < SIDE; k++) {
            double u = (i + .5) / SIDE, v = (k + .5) / SIDE;
            point[n++] = (vec3){6 * u - 3, 3 * v - .5, 4};
            point[n++] = (vec3){6 * u - 3, -.5, 4 / (1 + 3 * v)}; /* as rays are apart */
        }
    assert_int_equal(carve_seen_through(&mesh, point, n, (vec3){0, 0, 0}, 1, out), STATUS_OK);
    assert_memory_equal(out, through, sizeof out);
    faults_in_memory(1, false);
    assert_int_equal(carve_seen_through(&mesh, point, n, (vec3){0, 0, 0}, 1, out), STATUS_NO_MEMORY);
    faults_stop();
}

/* ------------------------------------------------------------------------------------------------ tests */

static void is_a_manifold_with_borders(const struct mesh *mesh, struct mesh_facts *facts) {
    assert_int_equal(mesh_examine(mesh, facts), STATUS_OK);
    assert_int_equal(facts->nonmanifold_edges + facts->misoriented_edges + facts->nonmanifold_vertices, 0);
    assert_int_equal(facts->unused_vertices, 0);
    assert_true(facts->manifold && !facts->watertight && facts->boundary_edges > 0);
}

/* Farthest that the middle of a triangle is from all original points. */
static double farthest_middle(const struct mesh *mesh, const struct scan *scan) {
    double farthest = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        vec3 middle = vec3_add(vec3_add(mesh->vertex[v[0]], mesh->vertex[v[1]]), mesh->vertex[v[2]]);
        uint32_t id;
        double distance_sq;
        middle = vec3_scale(middle, 1.0 / 3);
        assert_int_equal(knn_search(scan->knn, &middle, 1, 1, 1, &id, &distance_sq), STATUS_OK);
        farthest = fmax(farthest, sqrt(distance_sq));
    }
    return farthest;
}

static const struct row {
    shape *shape;
    enum surface_form form;
    size_t components;
    long euler;  /* 1 for each disk, 0 for a disk with a hole */
    double area; /* at least 0.9 of it and at most all, but for little */
} rows[] = {
    {waves, SURFACE_OPEN, 1, 1, 1.098},           {waves, SURFACE_HEIGHTFIELD, 1, 1, 1.098},
    {waves_with_hole, SURFACE_OPEN, 1, 0, 0.959}, {waves_with_hole, SURFACE_HEIGHTFIELD, 1, 0, 0.959},
    {two_islands, SURFACE_OPEN, 2, 2, 0.881},     {two_islands, SURFACE_HEIGHTFIELD, 2, 2, 0.881},
    {half_sphere, SURFACE_OPEN, 1, 1, 1.005},     {box, SURFACE_OPEN, 1, 1, 1.25},
};

static void sheets_keep_their_borders_and_holes(void **state) {
    (void)state;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct scan scan = scan_of(rows[i].shape);
        struct reconstruct_facts facts;
        struct mesh mesh = made(&scan, rows[i].form, &facts);
        struct mesh_facts found;
        is_a_manifold_with_borders(&mesh, &found);
        assert_int_equal(found.components, rows[i].components);
        assert_int_equal(found.euler, rows[i].euler);
        assert_true(found.area > 0.9 * rows[i].area && found.area < 1.08 * rows[i].area);
        assert_true(farthest_middle(&mesh, &scan) < 4.5 * 1.2 * sqrt(1.0 / POINTS));
        assert_true(facts.points_lost < scan.kept_count / 50);
        mesh_done(&mesh), scan_done(&scan);
    }
}

static void a_height_field_faces_up(void **state) {
    (void)state;
    struct scan scan = scan_of(waves);
    struct mesh mesh = made(&scan, SURFACE_HEIGHTFIELD, NULL);
    for (size_t t = 0; t < mesh.triangle_count; t++) {
        const uint32_t *v = mesh.triangle[t];
        assert_true(vec3_triangle_normal(mesh.vertex[v[0]], mesh.vertex[v[1]], mesh.vertex[v[2]]).z > 0);
    }
    mesh_done(&mesh), scan_done(&scan);
}

static bool same(const struct mesh *a, const struct mesh *b) {
    return a->vertex_count == b->vertex_count && a->triangle_count == b->triangle_count &&
           memcmp(a->source, b->source, a->vertex_count * sizeof *a->source) == 0 &&
           memcmp(a->triangle, b->triangle, a->triangle_count * sizeof *a->triangle) == 0;
}

/* Facets of a grid are all alike, and many corners on one sphere. */
static void a_folded_grid_is_one_sheet(void **state) {
    (void)state;
    enum { SIDE = 40 };
    struct scan scan = {.dense = dense_field(2 * SIDE + 1, dense_flat), .kept = calloc(POINTS, sizeof(vec3))};
    for (size_t i = 0; i < scan.dense.n; i++) {
        vec3 *p = &scan.dense.point[i];
        if (p->x > 0.5) *p = (vec3){0.5, p->y, p->x - 0.5};
        if (i % 2 == 0 && i / (2 * SIDE + 1) % 2 == 0) scan.kept[scan.kept_count++] = *p;
    }
    assert_int_equal(knn_new(scan.dense.point, scan.dense.n, 1, &scan.knn, NULL), STATUS_OK);
    struct mesh first = made(&scan, SURFACE_OPEN, NULL);
    struct mesh_facts facts;
    is_a_manifold_with_borders(&first, &facts);
    assert_int_equal(facts.components, 1);
    assert_int_equal(facts.euler, 1);
    assert_int_equal(facts.borders, 1);
    mesh_done(&first), scan_done(&scan);
}

static struct surface_signs signs_of(shape *of) {
    struct scan scan = scan_of(of);
    struct neighbourhood neighbours = dense_neighbourhood(&scan.dense);
    struct surface_signs signs;
    normals_fit(scan.dense.point, &neighbours, 1, scan.dense.normal, NULL);
    assert_int_equal(surface_signs_of(scan.dense.point, scan.dense.normal, scan.dense.n, 1, &signs), STATUS_OK);
    neighbourhood_done(&neighbours);
    scan_done(&scan);
    return signs;
}

static bool sphere(double u, double v, vec3 *p) {
    double z = 2 * v - 1, angle = 2 * 3.14159265358979 * u, r = 0.4 * sqrt(fmax(0, 1 - z * z));
    *p = (vec3){r * cos(angle), r * sin(angle), 0.4 * z};
    return v < 1;
}

/* On its side, so that no axis is the right direction. */
static bool tilted_waves(double u, double v, vec3 *p) {
    waves(u, v, p);
    *p = (vec3){(p->x + p->z) / sqrt(2), p->y, (p->z - p->x) / sqrt(2)};
    return true;
}

/* Crowns over a fifth of the ground, through which every other point is of the ground. */
static bool trees(double u, double v, vec3 *p) {
    double x = 6 * u - floor(6 * u) - 0.5, y = 6 * v - floor(6 * v) - 0.5;
    waves(u, v, p);
    if (x * x + y * y < 0.06 && fmod(u * 7919, 1) < 0.5) p->z += 0.15;
    return true;
}

/* The same from beside them, near one corner: the farther off, the fewer points. */
static bool trees_from_a_corner(double u, double v, vec3 *p) { return trees(pow(u, 2.5), pow(v, 2.5), p); }

static void points_say_what_they_are_of(void **state) {
    (void)state;
    struct {
        shape *of;
        bool told;
        enum surface_form form;
    } rows_of[] = {{waves, true, SURFACE_HEIGHTFIELD},
                   {tilted_waves, true, SURFACE_HEIGHTFIELD},
                   {waves_with_hole, true, SURFACE_HEIGHTFIELD},
                   {trees, true, SURFACE_HEIGHTFIELD},
                   {trees_from_a_corner, true, SURFACE_OPEN},
                   {half_sphere, true, SURFACE_OPEN},
                   {sphere, false, SURFACE_CLOSED}};
    for (size_t i = 0; i < sizeof rows_of / sizeof *rows_of; i++) {
        struct surface_signs signs = signs_of(rows_of[i].of);
        struct surface_choice choice = {.form = SURFACE_CLOSED};
        assert_int_equal(surface_choose_by_signs(&signs, &choice), rows_of[i].told);
        assert_int_equal(choice.form, rows_of[i].form);
        if (!rows_of[i].told) surface_choose_by_lid(&signs, &(struct surface_lid){0, 0}, &choice);
        assert_int_equal(choice.form, rows_of[i].form);
        assert_true(choice.sure && choice.reason[0]);
    }
    struct surface_signs few = {.points = 100, .layered = 0};
    struct surface_choice choice;
    assert_false(surface_choose_by_signs(&few, &choice));
}

static void landscapes_are_seen_from_above(void **state) {
    (void)state;
    static const struct {
        double layered, steep, uneven;
        bool told;
        enum surface_form form;
    } rows_of[] = {{.2, .05, .6, true, SURFACE_HEIGHTFIELD},   /* trees and roofs, strips that overlap */
                   {.17, .2, .4, true, SURFACE_HEIGHTFIELD},   /* conifers */
                   {.18, .32, .45, true, SURFACE_HEIGHTFIELD}, /* more of their crowns */
                   {.18, .32, .6, true, SURFACE_OPEN},
                   {.3, .1, .4, true, SURFACE_OPEN},          /* crowns that one sees through */
                   {.38, .18, .6, true, SURFACE_HEIGHTFIELD}, /* streets between high houses */
                   {.42, .18, .6, true, SURFACE_HEIGHTFIELD}, /* higher ones */
                   {.18, .14, 1.4, true, SURFACE_OPEN},       /* things on a table, from beside it */
                   {.38, .18, 1.4, true, SURFACE_OPEN},       /* a street, from within */
                   {.42, .18, 1.4, false, SURFACE_CLOSED}};
    for (size_t i = 0; i < sizeof rows_of / sizeof *rows_of; i++) {
        struct surface_signs signs = {POINTS, {0, 0, 1}, rows_of[i].layered, rows_of[i].steep, rows_of[i].uneven};
        struct surface_choice choice = {.form = SURFACE_CLOSED};
        assert_int_equal(surface_choose_by_signs(&signs, &choice), rows_of[i].told);
        assert_int_equal(choice.form, rows_of[i].form);
    }
}

static void cities_are_seen_from_above_and_have_walls(void **state) {
    (void)state;
    const struct {
        double layered, steep, uneven, z;
        bool from_above, landscape;
    } rows_of[] = {{.24, .12, .78, 1, true, true},  {.2, .14, .95, 1, true, false},   {.2, .14, 1.3, 1, false, false},
                   {.18, .32, .6, 1, true, false},  {.2, .45, .5, 1, false, false},   {.5, .14, .6, 1, false, false},
                   {.01, .05, .4, 1, false, false}, {.24, .12, .78, .8, false, false}};
    for (size_t i = 0; i < sizeof rows_of / sizeof *rows_of; i++) {
        struct surface_signs signs = {
            POINTS, {0, 0, rows_of[i].z}, rows_of[i].layered, rows_of[i].steep, rows_of[i].uneven};
        assert_int_equal(surface_is_from_above(&signs), rows_of[i].from_above);
        assert_int_equal(surface_is_landscape(&signs), rows_of[i].landscape);
    }
    const struct surface_match few = {.area = 1, .distance = 1e-3}, nearer = {.area = 1, .distance = 5e-4},
                               hardly = {.area = 1, .distance = 8e-4}, farther = {.area = 1, .distance = 6e-3};
    const struct surface_signs city = {.points = POINTS, .layered = 0.2}, hill = {.points = POINTS, .layered = 0.01};
    struct surface_choice choice = {.form = SURFACE_HEIGHTFIELD, .up = {0, 0, 1}, .sure = true};
    assert_false(surface_leave_walls(&hill, &few, &farther, &choice));
    assert_false(surface_leave_walls(&city, &few, &nearer, &choice));
    assert_true(choice.form == SURFACE_HEIGHTFIELD && choice.sure);
    assert_true(surface_leave_walls(&city, &few, &hardly, &choice));
    assert_true(choice.form == SURFACE_OPEN && !choice.sure && choice.reason[0]);
    choice.form = SURFACE_HEIGHTFIELD;
    assert_true(surface_leave_walls(&city, &few, &farther, &choice));
    assert_int_equal(choice.form, SURFACE_OPEN);
}

static void woods_that_one_sees_through_may_be_a_field(void **state) {
    (void)state;
    const struct {
        double layered, uneven, z;
        bool may;
    } rows_of[] = {{.2, .6, 1, true},  {.4, .6, 1, true},   {.01, .6, 1, false}, /* hardly layered */
                   {.7, .6, 1, false}, {.2, 1.5, 1, false}, {.2, .6, .8, false}};
    for (size_t i = 0; i < sizeof rows_of / sizeof *rows_of; i++) {
        struct surface_signs signs = {POINTS, {0, 0, rows_of[i].z}, rows_of[i].layered, .9, rows_of[i].uneven};
        assert_int_equal(surface_may_be_field(&signs, false), rows_of[i].may);
    }
    const struct surface_signs woods = {POINTS, {0, 0, 1}, .3, .5, .6};
    const struct surface_match near = {.area = 1, .distance = 1e-3}, hardly = {.area = 1, .distance = 1.1e-3},
                               far = {.area = 1, .distance = 2e-3}, none = {.area = 0, .distance = 0};
    struct surface_choice choice = {.form = SURFACE_OPEN, .sure = true};
    assert_false(surface_take_field(&woods, &near, &far, false, false, &choice));
    assert_false(surface_take_field(&woods, &near, &none, false, false, &choice));
    assert_false(surface_take_field(&woods, &near, &hardly, true, false, &choice)); /* than from one of few points */
    assert_true(choice.form == SURFACE_OPEN && choice.sure);
    assert_true(surface_take_field(&woods, &hardly, &near, true, false, &choice));
    choice = (struct surface_choice){.form = SURFACE_OPEN, .sure = true};
    assert_true(surface_take_field(&woods, &near, &hardly, false, false, &choice));
    assert_true(choice.form == SURFACE_HEIGHTFIELD && choice.up.z > 0 && !choice.sure && choice.reason[0]);
    choice = (struct surface_choice){.form = SURFACE_CLOSED, .sure = true};
    assert_true(surface_take_field(&woods, &near, &hardly, false, false, &choice) &&
                choice.form == SURFACE_HEIGHTFIELD);
    const struct surface_match farther = {.area = 1, .distance = 1.35e-3};
    choice = (struct surface_choice){.form = SURFACE_CLOSED, .sure = true};
    assert_false(surface_take_field(&woods, &near, &far, true, false, &choice));
    assert_true(surface_take_field(&woods, &near, &farther, true, false, &choice));
    choice = (struct surface_choice){.form = SURFACE_OPEN, .sure = true};
    assert_false(surface_take_field(&woods, &near, &farther, false, false, &choice));
    choice = (struct surface_choice){.form = SURFACE_OPEN, .sure = true}; /* left for its steps */
    assert_false(surface_take_field(&woods, &near, &near, false, true, &choice));
    assert_true(surface_take_field(&woods, &hardly, &near, false, true, &choice));
    const struct surface_signs thinned = {.points = 1 << 16, .up = {0, 0, 1}, .layered = 0.55, .uneven = 0.54};
    struct surface_signs room = thinned;
    room.layered = 0.72;
    assert_true(surface_may_be_field(&thinned, false) && !surface_may_be_field(&room, false));
    assert_true(surface_may_be_field(&room, true));
}

/* No surface goes through what fills a volume, so that a field of it needn't be as near as of other points. */
static void leaves_that_were_seen_from_above_are_a_field(void **state) {
    (void)state;
    const struct surface_signs woods = {POINTS, {0, 0, 1}, .64, .18, .42},
                               scanned_within = {POINTS, {0, 0, 1}, .64, .18, .96};
    const struct surface_match open = {.area = 2.1, .distance = 1.55e-3, .missed = .03},
                               field = {.area = 6.7, .distance = 2.2e-3, .missed = .02},
                               far = {.area = 6.7, .distance = 2.9e-3, .missed = .02},
                               farther = {.area = 3.9, .distance = 2.9e-3, .missed = .39};
    const struct surface_choice others = {.form = SURFACE_OPEN}, leaves = {.form = SURFACE_OPEN, .volume = true};
    struct surface_choice choice = others;
    assert_false(surface_take_field(&woods, &open, &field, true, false, &choice));
    choice = leaves;
    assert_false(surface_take_field(&woods, &open, &farther, true, false, &choice));
    assert_false(surface_take_field(&scanned_within, &open, &field, true, false, &choice));
    assert_true(surface_take_field(&woods, &open, &far, true, false, &choice));
    assert_int_equal(choice.form, SURFACE_HEIGHTFIELD);
}

/* An open mesh that misses many of the points is taken for none that misses hardly fewer. */
static void what_faces_away_is_left_for_what_misses_no_more(void **state) {
    (void)state;
    const struct surface_match few = {.area = 1, .missed = 0.02}, many = {.area = 1, .missed = 0.2},
                               more = {.area = 1, .missed = 0.28}, most = {.area = 1, .missed = 0.32}, none = {0};
    struct surface_choice choice = {.form = SURFACE_CLOSED};
    assert_false(surface_leave_away(&few, &many, &choice));
    assert_false(surface_leave_away(&many, &most, &choice));
    assert_false(surface_leave_away(&many, &none, &choice));
    assert_true(choice.form == SURFACE_CLOSED && !choice.sure);
    assert_true(surface_leave_away(&many, &more, &choice));
    assert_true(choice.form == SURFACE_OPEN && choice.sure && choice.reason[0]);
}

static void the_lid_decides_where_points_do_not(void **state) {
    (void)state;
    struct surface_signs signs = {.points = POINTS, .layered = 0.9};
    struct {
        struct surface_lid lid;
        enum surface_form form;
        bool sure;
    } lids[] = {{{0, 0}, SURFACE_CLOSED, true},          {{0, 0.03}, SURFACE_CLOSED, false}, /* up to a sparse rim */
                {{0.006, 0.006}, SURFACE_CLOSED, false}, {{0.05, 0.05}, SURFACE_CLOSED, false},
                {{0.06, 0.15}, SURFACE_CLOSED, false},   {{0.09, 0.09}, SURFACE_OPEN, false},
                {{0.2, 0.2}, SURFACE_OPEN, true}};
    for (size_t i = 0; i < sizeof lids / sizeof *lids; i++) {
        struct surface_choice choice;
        surface_choose_by_lid(&signs, &lids[i].lid, &choice);
        assert_int_equal(choice.form, lids[i].form);
        assert_int_equal(choice.sure, lids[i].sure);
    }
    struct surface_choice field = {.form = SURFACE_HEIGHTFIELD};
    const vec3 z = {0, 0, 1}, x = {1, 0, 0};
    struct surface_signs terrain = {.points = POINTS, .up = z, .layered = 0.01}, forest = terrain, across = terrain;
    forest.layered = 0.2;
    across.layered = 0.2, across.up = x;
    assert_false(surface_leave_field(&terrain, 0.001, false, &field));
    assert_false(surface_leave_field(&forest, 0.03, false, &field));
    assert_true(surface_leave_field(&terrain, 0.03, false, &field));
    assert_int_equal(field.form, SURFACE_OPEN);
    field.form = SURFACE_HEIGHTFIELD;
    assert_false(surface_leave_field(&forest, 0.15, false, &field)); /* a city's walls, which are trimmed */
    assert_true(surface_leave_field(&forest, 0.5, false, &field));
    assert_int_equal(field.form, SURFACE_OPEN);
    field.form = SURFACE_HEIGHTFIELD;
    struct surface_signs cliffs = forest;
    cliffs.steep = 0.15;
    assert_true(surface_leave_field(&cliffs, 0.15, false, &(struct surface_choice){.form = SURFACE_HEIGHTFIELD}));
    assert_true(surface_may_have_steps(&forest, 0.15) && surface_leave_field(&forest, 0.15, true, &field));
    assert_int_equal(field.form, SURFACE_OPEN);
    assert_false(surface_may_have_steps(&forest, 0.03) || surface_may_have_steps(&terrain, 0.15));
    assert_true(surface_leave_field(&across, 0.03, false, &field));
    assert_true(surface_is_landscape(&forest) && !surface_is_landscape(&terrain) && !surface_is_landscape(&across));
}

static void closed_surfaces_are_left_where_open_ones_go_through_the_points_better(void **state) {
    (void)state;
    static const struct {
        struct surface_match closed, open;
        bool left, inwards;
    } tries[] = {
        {{1.9, .064, .237, 0, 0}, {.957, .058, .145, 0, 0}, true, false},   /* to and fro between walls */
        {{1.9, .064, .19, 0, 0}, {.957, .058, .145, 0, 0}, false, false},   /* as they lie */
        {{1.05, .064, .237, 0, 0}, {.957, .058, .145, 0, 0}, false, false}, /* a small bottom */
        {{1.9, .02, .237, 0, 0}, {.957, .058, .145, 0, 0}, false, false},   /* the open one misses the points */
        {{1.1, .36, .237, 0, 0}, {.957, .058, .145, 0, 0}, true, false},    /* the closed one does */
        {{1.13, .062, .237, 0, 0}, {1, .064, .145, 0, 0}, true, false},     /* a lid: the open one is about as near */
        {{1.13, .062, .2, 0, 0}, {1, .064, .145, 0, 0}, false, false},      /* as the points lie */
        {{1.13, .042, .237, 0, 0}, {1, .064, .145, 0, 0}, false, false},    /* there are points */
        {{1.1, 0, .1, 0, 0}, {0, 0, 0, 0, 0}, false, false},                /* none */
        {{1.9, .1, .2, 0, 0}, {.9, 0, .1, 0, 0}, true, false},
        {{1.9, 0, .12, 0, .05}, {1, .0004, .05, 0, .05}, true, false}, /* through all points, as hardly one isn't */
        {{1.9, 0, .12, 0, .05}, {1, .0006, .05, 0, .05}, false, false},
        {{3.3, .04, .28, .03, 0}, {1, .11, .4, .06, 0}, true, false}, /* far more area than there is to cover */
        {{3.3, .04, .28, .03, 0}, {1, .11, .4, .3, 0}, false, false}, /* which the open one doesn't */
        {{2.1, .04, .1, .03, 0}, {1, .11, .4, .06, 0}, false, false}, /* two sides of a thin body */
        {{1.1, .068, .2, 0, 0}, {1, .058, .1, 0, 0}, false, false},   /* hardly nearer */
        {{1.1, .055, .2, 0, 0}, {1, .058, .1, 0, 0}, true, true},
        {{1.1, .053, .2, 0, 0}, {1, .058, .1, 0, 0}, false, true},
        {{2.5, .04, .39, .06, 0}, {1.4, .05, .38, .09, 0}, true, false},    /* across the normals, as in foliage */
        {{2.5, .04, .3, .06, 0}, {1.4, .05, .28, .09, 0}, false, false},    /* as of a noisy solid */
        {{1.05, .084, .32, .06, 0}, {.62, .083, .29, .05, 0}, true, false}, /* rocks among trees */
        {{2.5, .04, .39, .06, 0}, {1.4, .05, .38, .17, 0}, false, false},   /* the open one misses the points */
    };
    for (size_t i = 0; i < sizeof tries / sizeof *tries; i++) {
        struct surface_choice choice = {.form = SURFACE_CLOSED};
        assert_int_equal(surface_leave_closed(&tries[i].closed, &tries[i].open, tries[i].inwards, &choice),
                         tries[i].left);
        assert_int_equal(choice.form, tries[i].left ? SURFACE_OPEN : SURFACE_CLOSED);
        assert_true(!tries[i].left || choice.reason[0]);
    }
}

/* A mesh that all can be seen of from within is left for one with borders, but not a solid's, which that one misses. */
static void rooms_are_left_unless_the_points_are_far_nearer_to_the_closed_mesh(void **state) {
    (void)state;
    static const struct {
        struct surface_match closed, open;
        bool left;
    } tries[] = {
        {{1.1, .055, .2, 0, 0}, {1, .058, .1, 0, 0}, true},
        {{1.1, 0, .2, 0, .05}, {1, .0004, .1, 0, .05}, true},  /* of all points */
        {{1.1, .005, .2, 0, 0}, {1, .058, .1, .03, 0}, false}, /* prongs that see each other */
        {{1.1, .055, .2, 0, 0}, {1, .058, .1, .2, 0}, false},  /* much isn't covered */
        {{1.1, .055, .2, 0, 0}, {0, 0, 0, 0, 0}, false},       /* none */
    };
    for (size_t i = 0; i < sizeof tries / sizeof *tries; i++) {
        struct surface_choice choice = {.form = SURFACE_CLOSED, .sure = true};
        assert_int_equal(surface_leave_room(&tries[i].closed, &tries[i].open, .05, &choice), tries[i].left);
        assert_int_equal(choice.form, tries[i].left ? SURFACE_OPEN : SURFACE_CLOSED);
        assert_int_equal(choice.room, tries[i].left);
        assert_true(choice.sure != tries[i].left);
    }
}

/* Twenty times as dense along lines as across: what is between two lines is part of the surface all the same. */
static void lines_far_apart_are_one_sheet(void **state) {
    (void)state;
    enum { LINES = 20, EACH_LINE = 400 };
    struct scan scan = {.dense = dense_new((size_t)LINES * EACH_LINE), .kept = calloc(LINES * EACH_LINE, sizeof(vec3))};
    for (size_t i = 0; i < scan.dense.n; i++) {
        size_t line = i / EACH_LINE, at = i % EACH_LINE;
        waves(((double)at + 0.3 * fraction(i, 0)) / EACH_LINE, (double)line / (LINES - 1), &scan.dense.point[i]);
        if (at % 10 == line % 10) scan.kept[scan.kept_count++] = scan.dense.point[i];
    }
    assert_int_equal(knn_new(scan.dense.point, scan.dense.n, 1, &scan.knn, NULL), STATUS_OK);
    struct neighbourhood neighbours = dense_neighbourhood(&scan.dense);
    for (int known = 0; known < 2; known++) {
        struct reconstruct_dense dense = {.n = scan.dense.n,
                                          .point = scan.dense.point,
                                          .normal = scan.dense.normal,
                                          .spacing = scan.dense.spacing,
                                          .knn = scan.knn,
                                          .neighbours = known ? &neighbours : NULL};
        struct reconstruct_input input = {.points = scan.kept, .n = scan.kept_count, .dense = &dense};
        struct reconstruct_options options = {.threads = 1, .surface = SURFACE_OPEN};
        struct tets tets = {0};
        struct mesh mesh = {0};
        struct mesh_facts facts = {0};
        assert_int_equal(delaunay_build(scan.kept, scan.kept_count, 1, NULL, &tets, NULL), STATUS_OK);
        enum status status = reconstruct_sheet(&tets, &input, &options, NULL, &mesh, NULL, NULL);
        if (!status) is_a_manifold_with_borders(&mesh, &facts);
        assert_int_equal(facts.area > 1 && facts.components == 1, known);
        mesh_done(&mesh), tets_done(&tets);
    }
    neighbourhood_done(&neighbours), scan_done(&scan);
}

/* A vertex that is moved far off takes its triangles along; they go, and nothing else. */
static void what_is_moved_off_the_points_is_trimmed(void **state) {
    (void)state;
    struct scan scan = scan_of(waves);
    struct neighbourhood neighbours = dense_neighbourhood(&scan.dense);
    struct reconstruct_dense dense = {
        scan.dense.n, scan.dense.point, scan.dense.normal, scan.dense.spacing, NULL, scan.knn, &neighbours, NULL, NULL};
    struct mesh mesh = made(&scan, SURFACE_OPEN, NULL);
    size_t before = mesh.triangle_count, around = 0;
    uint32_t moved = 0;
    struct mesh_facts facts;
    assert_int_equal(sheet_trim(&mesh, &dense, false, 1), STATUS_OK);
    assert_true(mesh.triangle_count <= before && 20 * mesh.triangle_count > 19 * before); /* neighbours are known now */
    before = mesh.triangle_count;
    assert_int_equal(sheet_trim(&mesh, &dense, false, 1), STATUS_OK);
    assert_int_equal(mesh.triangle_count, before);
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        double to_middle = hypot(mesh.vertex[v].x - 0.5, mesh.vertex[v].y - 0.5);
        if (to_middle < hypot(mesh.vertex[moved].x - 0.5, mesh.vertex[moved].y - 0.5)) moved = v;
    }
    mesh.vertex[moved].z += 0.4;
    for (size_t t = 0; t < before; t++)
        for (int k = 0; k < 3; k++) around += mesh.triangle[t][k] == moved;
    assert_int_equal(sheet_trim(&mesh, &dense, false, 1), STATUS_OK);
    assert_int_equal(mesh.triangle_count, before - around);
    is_a_manifold_with_borders(&mesh, &facts);
    assert_int_equal(facts.borders, 2);
    neighbourhood_done(&neighbours), mesh_done(&mesh), scan_done(&scan);
}

/* One whose corner lies in a hole stays, and one that lies over the hole goes. */
static void what_is_mostly_near_is_not_trimmed(void **state) {
    (void)state;
    static const double corner[6][2] = {{0.2, 0.1}, {0.8, 0.1}, {0.5, 0.44}, {0.35, 0.4}, {0.65, 0.4}, {0.5, 0.65}};
    struct scan scan = scan_of(flat_with_hole);
    struct neighbourhood neighbours = dense_neighbourhood(&scan.dense);
    struct reconstruct_dense dense = {
        scan.dense.n, scan.dense.point, scan.dense.normal, scan.dense.spacing, NULL, scan.knn, &neighbours, NULL, NULL};
    struct mesh mesh = {6, alloc_array(6, sizeof *mesh.vertex),   alloc_array(6, sizeof *mesh.source),
                        2, alloc_array(2, sizeof *mesh.triangle), NULL};
    assert_true(mesh.vertex && mesh.source && mesh.triangle);
    for (uint32_t v = 0; v < 6; v++) {
        mesh.vertex[v] = (vec3){corner[v][0], corner[v][1], 0};
        mesh.source[v] = v, mesh.triangle[v / 3][v % 3] = v;
    }
    assert_int_equal(sheet_trim(&mesh, &dense, false, 1), STATUS_OK);
    assert_int_equal(mesh.triangle_count, 1);
    for (size_t v = 0; v < mesh.vertex_count; v++) assert_true(mesh.source[v] < 3);
    neighbourhood_done(&neighbours), mesh_done(&mesh), scan_done(&scan);
}

/* Where hills are cut off straight, no triangles hang between them. */
static void hills_have_no_curtains(void **state) {
    (void)state;
    struct scan scan = scan_of(hills);
    struct mesh mesh = made(&scan, SURFACE_HEIGHTFIELD, NULL);
    double all = 0, upright = 0;
    for (size_t t = 0; t < mesh.triangle_count; t++) {
        vec3 normal = mesh_triangle_normal(&mesh, t);
        double area = vec3_length(normal);
        all += area, upright += fabs(normal.z) < 0.1 * area ? area : 0;
    }
    assert_true(all > 2 && upright < 0.03 * all);
    mesh_done(&mesh), scan_done(&scan);
}

static void landscapes_go_on_in_shadows(void **state) {
    (void)state;
    struct scan scan = scan_of(two_islands);
    struct reconstruct_dense dense = {
        scan.dense.n, scan.dense.point, scan.dense.normal, scan.dense.spacing, NULL, scan.knn, NULL, NULL, NULL};
    struct reconstruct_input input = {.points = scan.kept, .n = scan.kept_count, .dense = &dense};
    struct reconstruct_options options = {.threads = 1, .surface = SURFACE_HEIGHTFIELD, .up = {0, 0, 1}};
    for (size_t islands = 2; islands > 0; islands--) {
        struct mesh mesh = {0};
        struct mesh_facts facts;
        options.landscape = islands == 1;
        assert_int_equal(reconstruct_sheet(NULL, &input, &options, NULL, &mesh, NULL, NULL), STATUS_OK);
        is_a_manifold_with_borders(&mesh, &facts);
        assert_int_equal(facts.components, islands);
        mesh_done(&mesh);
    }
    scan_done(&scan);
}

/* What is remembered of the points' feet is that of another plane, then that of this one. */
static void height_fields_are_the_same_whatever_is_remembered(void **state) {
    (void)state;
    struct scan scan = scan_of(waves_with_hole);
    struct plane_reach plane = {{0, 0, 0}, NULL, 0};
    struct reconstruct_dense dense = {
        scan.dense.n, scan.dense.point, scan.dense.normal, scan.dense.spacing, NULL, scan.knn, NULL, NULL, &plane};
    struct reconstruct_input input = {.points = scan.kept, .n = scan.kept_count, .dense = &dense};
    struct reconstruct_options options = {.threads = 1, .surface = SURFACE_HEIGHTFIELD, .up = {0.6, 0, 0.8}};
    struct mesh plain = made(&scan, SURFACE_HEIGHTFIELD, NULL), tilted = {0};
    assert_int_equal(reconstruct_sheet(NULL, &input, &options, NULL, &tilted, NULL, NULL), STATUS_OK);
    mesh_done(&tilted);
    for (int time = 0; time < 2; time++) {
        struct mesh mesh = {0};
        options.up = (vec3){0, 0, 1};
        assert_int_equal(reconstruct_sheet(NULL, &input, &options, NULL, &mesh, NULL, NULL), STATUS_OK);
        assert_true(vec3_equal(plane.up, options.up));
        assert_int_equal(mesh.triangle_count, plain.triangle_count);
        assert_memory_equal(mesh.triangle, plain.triangle, plain.triangle_count * sizeof *plain.triangle);
        mesh_done(&mesh);
    }
    free(plane.reach);
    mesh_done(&plain), scan_done(&scan);
}

static const vec3 ABOVE = {0.5, 0.45, 4};

/* A floor that is seen through the one above it, so that neighbours as seen from ABOVE are of both. */
static bool two_floors(double u, double v, vec3 *p) {
    *p = u < 0.5 ? (vec3){2 * u, v, 0} : (vec3){2 * u - 1, v, 0.3};
    return true;
}

static void what_one_place_has_seen_faces_it(void **state) {
    (void)state;
    shape *const shapes[] = {waves, two_floors};
    for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++) {
        struct scan scan = scan_of(shapes[i]);
        struct reconstruct_facts found = {0};
        struct mesh_facts facts;
        scan.viewed = true, scan.view = ABOVE;
        struct mesh mesh = made(&scan, SURFACE_OPEN, &found);
        is_a_manifold_with_borders(&mesh, &facts);
        assert_string_equal(found.form, "delaunay-of-view");
        assert_true(found.points_lost * 10 < scan.kept_count);
        double area = 0;
        for (size_t t = 0; t < mesh.triangle_count; t++) {
            vec3 normal = mesh_triangle_normal(&mesh, t);
            assert_true(vec3_dot(normal, vec3_sub(ABOVE, mesh.vertex[mesh.triangle[t][0]])) >= 0);
            area += vec3_length(normal) / 2;
        }
        assert_true(area > 0.4 && area < 2.2); /* of both floors, where chance leaves gaps between those of one */
        mesh_done(&mesh), scan_done(&scan);
    }
}

/* Ground with fourteen spacings between its rings. */
static bool two_rings(double u, double v, vec3 *p) {
    double gap = 14 * sqrt(1.0 / POINTS);
    *p = (vec3){u < 0.5 ? u : u + gap, v, 0.1 * sin(9 * u) * cos(7 * v)};
    return true;
}

static void between_rays_from_one_place_gaps_are_wider(void **state) {
    (void)state;
    struct scan scan = scan_of(two_rings);
    struct mesh_facts facts;
    for (int viewed = 0; viewed < 2; viewed++) {
        scan.viewed = viewed, scan.view = ABOVE;
        struct mesh mesh = made(&scan, SURFACE_OPEN, NULL);
        is_a_manifold_with_borders(&mesh, &facts);
        assert_int_equal(facts.components, viewed ? 1 : 2);
        mesh_done(&mesh);
    }
    scan_done(&scan);
}

/* A floor, and beside it another one that a few rays from ABOVE have reached, thirty times as far apart. */
static bool floor_and_depths(double u, double v, vec3 *p) {
    bool far = u > 0.95;
    *p = (vec3){far ? 1.05 + 4 * (u - 0.95) : u / 0.95, v, 0};
    if (far) *p = vec3_add(ABOVE, vec3_scale(vec3_sub(*p, ABOVE), 16));
    return true;
}

static void a_few_rays_that_went_far_span_no_surface(void **state) {
    (void)state;
    struct scan scan = scan_of(floor_and_depths);
    double area[2] = {0, 0};
    scan.viewed = true, scan.view = ABOVE;
    scan.kept_count = scan.dense.n;
    memcpy(scan.kept, scan.dense.point, scan.dense.n * sizeof *scan.kept);
    struct mesh mesh = made(&scan, SURFACE_OPEN, NULL);
    for (size_t t = 0; t < mesh.triangle_count; t++)
        area[mesh.vertex[mesh.triangle[t][0]].z < -1] += vec3_length(mesh_triangle_normal(&mesh, t)) / 2;
    assert_true(area[0] > 0.9);
    assert_true(area[1] < 20); /* of 51 */
    mesh_done(&mesh), scan_done(&scan);
}

/* A step of which both sides were scanned and nothing between; a slope down which the points go on. */
static bool step(double u, double v, vec3 *p) {
    *p = (vec3){u, v, u > 0.5 ? 0.5 : 0.2 * u};
    return true;
}

static bool cliff(double u, double v, vec3 *p) {
    *p = u < 0.4   ? (vec3){u, v, 0}
         : u > 0.8 ? (vec3){u - 0.38, v, 0.6}
                   : (vec3){0.4 + 0.05 * (u - 0.4), v, 1.5 * u - 0.6};
    return true;
}

static void walls_of_no_points_are_trimmed(void **state) {
    (void)state;
    shape *const shapes[] = {step, cliff};
    for (size_t i = 0; i < 2; i++) {
        struct scan scan = scan_of(shapes[i]);
        struct neighbourhood neighbours = dense_neighbourhood(&scan.dense);
        struct reconstruct_dense dense = {scan.dense.n, scan.dense.point, scan.dense.normal, scan.dense.spacing,
                                          NULL,         scan.knn,         &neighbours,       NULL,
                                          NULL};
        struct mesh mesh = made(&scan, SURFACE_HEIGHTFIELD, NULL);
        struct mesh_facts before, after;
        is_a_manifold_with_borders(&mesh, &before);
        assert_int_equal(before.components, 1);
        assert_int_equal(sheet_trim_walls(&mesh, &dense, (vec3){0, 0, 1}, 1), STATUS_OK);
        is_a_manifold_with_borders(&mesh, &after);
        assert_int_equal(after.components, i == 0 ? 2 : 1);
        assert_true(i == 0 ? after.area < before.area - 0.4 : after.area > 0.97 * before.area);
        neighbourhood_done(&neighbours), mesh_done(&mesh), scan_done(&scan);
    }
}

/* The lid of a closed mesh; with_strays: known as such. */
static double lid_of(const struct scan *scan, bool with_strays) {
    struct reconstruct_input input = {.points = scan->kept, .n = scan->kept_count};
    struct reconstruct_options options = {.threads = 1};
    struct tets tets = {0};
    struct mesh mesh = {0};
    struct neighbourhood neighbours = dense_neighbourhood(&scan->dense);
    float *reach = calloc(scan->dense.n, sizeof *reach);
    uint8_t *stray = calloc(scan->dense.n, 1);
    struct sheet_points points = {.knn = scan->knn, .reach = reach, .stray = with_strays ? stray : NULL};
    struct surface_lid lid = {-1, -1};
    assert_true(reach && stray);
    assert_int_equal(delaunay_build(scan->kept, scan->kept_count, 1, NULL, &tets, NULL), STATUS_OK);
    assert_int_equal(reconstruct_surface(&tets, &input, &options, NULL, &mesh, NULL), STATUS_OK);
    assert_int_equal(sheet_reach_in(&neighbours, scan->dense.point, 1, reach, &points.median), STATUS_OK);
    sheet_find_strays(&neighbours, reach, 1, stray);
    /* Sources are of kept points, and each EACHth point or so is kept. */
    for (size_t v = 0, p = 0; v < mesh.vertex_count; v++) {
        for (p = 0; vec3_distance(scan->dense.point[p], mesh.vertex[v]) > 0;) p++;
        mesh.source[v] = (uint32_t)p;
    }
    assert_int_equal(surface_lid_of(&mesh, &points, SURFACE_CLOSED, 1, &lid), STATUS_OK);
    free(reach), free(stray);
    neighbourhood_done(&neighbours), mesh_done(&mesh), tets_done(&tets);
    assert_true(lid.to_rims >= lid.share);
    return lid.share;
}

/* Outliers reach into the box, and facets with them. */
static void outliers_are_no_lid(void **state) {
    (void)state;
    struct scan scan = scan_of(sphere);
    for (size_t i = 0; i < scan.kept_count; i += 8) {
        size_t p = 0;
        while (vec3_distance(scan.dense.point[p], scan.kept[i]) > 0) p++;
        for (int k = 0; k < 3; k++) (&scan.kept[i].x)[k] = 0.8 * fraction(i, (unsigned)k + 2) - 0.4;
        scan.dense.point[p] = scan.kept[i];
    }
    knn_free(scan.knn);
    assert_int_equal(knn_new(scan.dense.point, scan.dense.n, 1, &scan.knn, NULL), STATUS_OK);
    assert_true(lid_of(&scan, false) > 0.05);
    assert_true(lid_of(&scan, true) < 0.008);
    scan_done(&scan);
}

static void a_stray_is_no_lid(void **state) {
    (void)state;
    struct scan scan = scan_of(sphere);
    scan.kept[scan.kept_count++] = scan.dense.point[scan.dense.n - 1] = (vec3){90, 30, 20};
    knn_free(scan.knn);
    assert_int_equal(knn_new(scan.dense.point, scan.dense.n, 1, &scan.knn, NULL), STATUS_OK);
    assert_true(lid_of(&scan, false) > 0.2);
    assert_true(lid_of(&scan, true) < 0.001);
    scan_done(&scan);
}

/* Mean of the normals' z, weighted by area. */
static double uprightness(const struct mesh *mesh) {
    vec3 sum = {0, 0, 0};
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        sum = vec3_add(sum, vec3_triangle_normal(mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]]));
    }
    return sum.z;
}

static void sides_follow_what_is_known(void **state) {
    (void)state;
    struct scan scan = scan_of(two_islands);
    struct mesh mesh = made(&scan, SURFACE_OPEN, NULL);
    vec3 *normal = calloc(scan.kept_count, sizeof *normal);
    enum sheet_side side;
    assert_non_null(normal);
    for (size_t i = 0; i < scan.kept_count; i++) normal[i] = (vec3){0, 0, -2};
    struct sheet_sides sides = {.normal = normal, .viewed = true, .view = {0.5, 0.5, 9}, .up = {0, 0, 1}};
    assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
    assert_int_equal(side, SIDE_NORMALS);
    assert_true(uprightness(&mesh) < -1);
    /* Random ones tell nothing. */
    for (size_t i = 0; i < scan.kept_count; i++) normal[i] = (vec3){0, 0, hash64(i) % 2 ? 1 : -1};
    assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
    assert_int_equal(side, SIDE_VIEW);
    assert_true(uprightness(&mesh) > 1);
    sides.view.z = -9;
    assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
    assert_true(uprightness(&mesh) < -1);
    sides.viewed = false;
    assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
    assert_int_equal(side, SIDE_UP);
    assert_true(uprightness(&mesh) > 1);
    struct mesh_facts facts;
    is_a_manifold_with_borders(&mesh, &facts);
    free(normal);
    mesh_done(&mesh), scan_done(&scan);
    scan = scan_of(half_sphere), mesh = made(&scan, SURFACE_OPEN, NULL);
    sides = (struct sheet_sides){.up = {1, 0, 0}};
    assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
    assert_int_equal(side, SIDE_OUT);
    assert_true(uprightness(&mesh) > 0);
    mesh_done(&mesh), scan_done(&scan);
}

/* Folds of four times the ground's area, in a hollow and on a hill, of forty times in a height field, and on a slope,
 * which face down at first. */
static void what_lies_faces_upwards(void **state) {
    (void)state;
    enum { FOLDS = 41, ENDS = 2 };
    for (int k = 0; k < 4; k++) {
        bool hill = k == 1, field = k == 2;
        const struct sheet_sides sides = {.up = {0, 0, 1}, .field = field};
        vec3 vertex[ENDS * FOLDS];
        uint32_t triangle[2 * (FOLDS - 1)][3], source[ENDS * FOLDS];
        struct mesh mesh = {.vertex_count = ENDS * FOLDS,
                            .vertex = vertex,
                            .triangle_count = 2 * (FOLDS - 1),
                            .triangle = triangle,
                            .source = source};
        enum sheet_side side;
        for (uint32_t i = 0; i < FOLDS; i++) {
            double x = 0.2 * i, bend = 0.02 * (x - 4) * (x - 4),
                   z = (field ? 8 : 0.8) * (i % 2) + (hill ? -bend : bend) + (k == 3 ? x / 3 : 0);
            vertex[2 * i] = (vec3){x, 0, z}, vertex[2 * i + 1] = (vec3){x, 8, z};
            source[2 * i] = 2 * i, source[2 * i + 1] = 2 * i + 1;
        }
        for (uint32_t i = 0; i + 1 < FOLDS; i++) {
            const uint32_t low = 2 * i, down[2][3] = {{low, low + 1, low + 2}, {low + 1, low + 3, low + 2}};
            memcpy(triangle[2 * i], down, sizeof down);
        }
        assert_true(uprightness(&mesh) < -1);
        assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
        assert_int_equal(side, SIDE_UP);
        assert_true(uprightness(&mesh) > 1);
    }
}

/* Points on either side of a line were seen from opposite sides: no surface joins them, whatever is nearest. */
static void what_faces_the_other_way_is_cut_off(void **state) {
    (void)state;
    struct scan scan = scan_of(waves);
    struct mesh mesh = made(&scan, SURFACE_OPEN, NULL);
    struct mesh_facts before, after;
    enum sheet_side side;
    vec3 *normal = alloc_array(scan.kept_count, sizeof *normal);
    assert_non_null(normal);
    double low = INFINITY, high = -INFINITY;
    for (size_t i = 0; i < scan.kept_count; i++) low = fmin(low, scan.kept[i].x), high = fmax(high, scan.kept[i].x);
    for (size_t i = 0; i < scan.kept_count; i++)
        normal[i] = (vec3){0, 0, scan.kept[i].x > (low + 2 * high) / 3 ? -1 : 1};
    struct sheet_sides sides = {.up = {0, 0, 1}};
    is_a_manifold_with_borders(&mesh, &before);
    assert_int_equal(sheet_part_turned(&mesh, &sides, 1), STATUS_OK);
    is_a_manifold_with_borders(&mesh, &after);
    assert_int_equal(after.components, before.components);
    sides.normal = normal;
    assert_int_equal(sheet_part_turned(&mesh, &sides, 1), STATUS_OK);
    assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
    is_a_manifold_with_borders(&mesh, &after);
    assert_true(after.components > before.components);
    double against = 0, all = 0;
    for (size_t t = 0; t < mesh.triangle_count; t++) {
        vec3 area = mesh_triangle_normal(&mesh, t);
        all += vec3_length(area);
        against += vec3_dot(area, normal[mesh.source[mesh.triangle[t][0]]]) < 0 ? vec3_length(area) : 0;
    }
    assert_true(against < 0.03 * all);
    free(normal);
    mesh_done(&mesh), scan_done(&scan);
}

enum { WALL_SQUARES = 16 };

/* A sheet of squares from place to place, wound so that it faces the cross product of u and v.  Returns its first
 * vertex. */
static uint32_t add_sheet(struct mesh *mesh, vec3 corner, vec3 u, vec3 v) {
    uint32_t first = (uint32_t)mesh->vertex_count, row = WALL_SQUARES + 1;
    for (uint32_t i = 0; i < row * row; i++) {
        vec3 over = vec3_add(vec3_scale(u, i % row), vec3_scale(v, i / row));
        mesh->vertex[mesh->vertex_count++] = vec3_add(corner, vec3_scale(over, 1.0 / WALL_SQUARES));
    }
    for (uint32_t i = 0; i < WALL_SQUARES * WALL_SQUARES; i++) {
        uint32_t at = first + i / WALL_SQUARES * row + i % WALL_SQUARES;
        const uint32_t half[2][3] = {{at, at + 1, at + row + 1}, {at, at + row + 1, at + row}};
        memcpy(mesh->triangle[mesh->triangle_count], half, sizeof half);
        mesh->triangle_count += 2;
    }
    return first;
}

/* Joins the last column of one sheet to the first one of another, row by row. */
static void join_sheets(struct mesh *mesh, uint32_t left, uint32_t right) {
    uint32_t row = WALL_SQUARES + 1;
    for (uint32_t i = 0; i < WALL_SQUARES; i++) {
        uint32_t a = left + i * row + WALL_SQUARES, c = right + i * row;
        const uint32_t half[2][3] = {{a, c, c + row}, {a, c + row, a + row}};
        memcpy(mesh->triangle[mesh->triangle_count], half, sizeof half);
        mesh->triangle_count += 2;
    }
}

/* A room with a lamp, whose walls are joined all around; if twisted, two of them face outwards for all that the joint
 * between them and the others tells.  Those within see it, cut there, and turn them. */
static void walls_that_those_within_see_turned_are_cut_off(void **state) {
    (void)state;
    enum { SHEETS = 12, MOST = SHEETS * (WALL_SQUARES + 1) * (WALL_SQUARES + 1) };
    const vec3 x = {6, 0, 0}, y = {0, 4, 0}, z = {0, 0, 2.6}, gap = {0.1, 0.1, 0};
    for (int twisted = 0; twisted < 2; twisted++) {
        struct mesh mesh = {.vertex = alloc_array(MOST, sizeof *mesh.vertex),
                            .source = alloc_array(MOST, sizeof *mesh.source),
                            .triangle = alloc_array(2 * MOST, sizeof *mesh.triangle),
                            .tag = alloc_zeroed(2 * MOST, 1)};
        assert_true(mesh.vertex && mesh.source && mesh.triangle && mesh.tag);
        vec3 wide = vec3_sub(x, (vec3){0.2, 0, 0}), deep = vec3_sub(y, (vec3){0, 0.2, 0});
        vec3 back = vec3_scale(wide, -1), fore = vec3_scale(deep, -1);
        uint32_t west = add_sheet(&mesh, vec3_sub(vec3_add(y, gap), (vec3){0.1, 0.2, 0}), fore, z);
        uint32_t south = add_sheet(&mesh, (vec3){0.1, 0, 0}, wide, z), east, north;
        /* The other two, upside down if twisted: then row by row the strip between crosses over. */
        vec3 rise = twisted ? vec3_scale(z, -1) : z, foot = twisted ? z : (vec3){0, 0, 0};
        east = add_sheet(&mesh, vec3_add(vec3_add(x, (vec3){0, 0.1, 0}), foot), deep, rise);
        north = add_sheet(&mesh, vec3_add(vec3_add(vec3_add(x, y), (vec3){-0.1, 0, 0}), foot), back, rise);
        join_sheets(&mesh, west, south), join_sheets(&mesh, south, east), join_sheets(&mesh, east, north);
        add_sheet(&mesh, (vec3){0, 0, -0.05}, x, y), add_sheet(&mesh, vec3_add(z, (vec3){0, 0, 0.05}), y, x);
        size_t walls = 4 * 2 * WALL_SQUARES * WALL_SQUARES;
        const vec3 low = {3.5, 2, 1.4}, size[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 0.6}};
        for (int face = 0; face < 6; face++) {
            vec3 u = size[(face + 1) % 3], v = size[(face + 2) % 3], at = face < 3 ? vec3_add(low, size[face]) : low;
            add_sheet(&mesh, at, face < 3 ? u : v, face < 3 ? v : u);
        }
        for (size_t v = 0; v < mesh.vertex_count; v++) mesh.source[v] = (uint32_t)v;
        struct mesh_facts before, after;
        struct gallery gallery;
        enum sheet_side side;
        const struct sheet_sides sides = {.up = {0, 0, 1}, .gallery = &gallery};
        is_a_manifold_with_borders(&mesh, &before);
        assert_int_equal(sheet_part_turned(&mesh, &sides, 2), STATUS_OK);
        is_a_manifold_with_borders(&mesh, &after);
        assert_true(twisted ? after.components > before.components : after.edges == before.edges);
        assert_int_equal(sheet_orient(&mesh, &sides, 2, &side), STATUS_OK);
        double against = 0, all = 0;
        for (size_t t = 0; t < mesh.triangle_count && t < walls; t++) {
            vec3 area = mesh_triangle_normal(&mesh, t), at = mesh.vertex[mesh.triangle[t][0]];
            all += vec3_length(area);
            against += vec3_dot(area, vec3_sub((vec3){3, 2, at.z}, at)) < 0 ? vec3_length(area) : 0;
        }
        assert_true(against < 0.1 * all);
        mesh_done(&mesh);
    }
}

/* Four walls without anything between them look away from their middle, unless they are known to be a room's. */
static void walls_of_a_room_face_their_middle(void **state) {
    (void)state;
    enum { MOST = 4 * (WALL_SQUARES + 1) * (WALL_SQUARES + 1) };
    const vec3 x = {6, 0, 0}, y = {0, 4, 0}, z = {0, 0, 2.6};
    for (int inside = 0; inside < 2; inside++) {
        struct mesh mesh = {.vertex = alloc_array(MOST, sizeof *mesh.vertex),
                            .source = alloc_array(MOST, sizeof *mesh.source),
                            .triangle = alloc_array(2 * MOST, sizeof *mesh.triangle)};
        assert_true(mesh.vertex && mesh.source && mesh.triangle);
        uint32_t south = add_sheet(&mesh, (vec3){0.1, 0, 0}, (vec3){5.8, 0, 0}, z);
        uint32_t east = add_sheet(&mesh, (vec3){6, 0.1, 0}, (vec3){0, 3.8, 0}, z);
        uint32_t north = add_sheet(&mesh, (vec3){5.9, 4, 0}, (vec3){-5.8, 0, 0}, z);
        join_sheets(&mesh, south, east), join_sheets(&mesh, east, north);
        for (size_t v = 0; v < mesh.vertex_count; v++) mesh.source[v] = (uint32_t)v;
        const struct sheet_sides sides = {.up = {0, 0, 1}, .inside = inside};
        const vec3 middle = vec3_scale(vec3_add(vec3_add(x, y), z), 0.5);
        enum sheet_side side;
        assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
        assert_int_equal(side, inside ? SIDE_SIGHT : SIDE_OUT);
        for (size_t t = 0; t < mesh.triangle_count; t++) {
            vec3 within = vec3_sub(middle, mesh.vertex[mesh.triangle[t][0]]);
            assert_true((vec3_dot(mesh_triangle_normal(&mesh, t), within) > 0) == inside);
        }
        mesh_done(&mesh);
    }
}

/* Three quarters of a tube, round which the surface goes on to below. */
static bool curl(double u, double v, vec3 *p) {
    double angle = 1.5 * M_PI * u;
    *p = (vec3){0.3 * cos(angle), v, 0.3 * sin(angle)};
    return true;
}

/* Nobody has seen a landscape from below. */
static void all_of_a_landscape_faces_upwards(void **state) {
    (void)state;
    struct scan scan = scan_of(curl);
    for (int landscape = 0; landscape < 2; landscape++) {
        struct mesh mesh = made(&scan, SURFACE_OPEN, NULL);
        struct mesh_facts facts;
        enum sheet_side side;
        const struct sheet_sides sides = {.up = {0, 0, 1}, .landscape = landscape};
        assert_int_equal(sheet_part_turned(&mesh, &sides, 1), STATUS_OK);
        assert_int_equal(sheet_orient(&mesh, &sides, 1, &side), STATUS_OK);
        is_a_manifold_with_borders(&mesh, &facts);
        double down = 0;
        for (size_t t = 0; t < mesh.triangle_count; t++) down -= fmin(mesh_triangle_normal(&mesh, t).z, 0) / 2;
        assert_true(landscape ? down < 0.02 : down > 0.2);
        mesh_done(&mesh);
    }
    scan_done(&scan);
}

/* Guesses are wrong of some points, as along this line: they cut nothing.  Where they are of all points beyond a line
 * they do, unless what they are of is ground, which lies. */
static void single_guesses_cut_nothing(void **state) {
    (void)state;
    const double NARROW = 0.035;
    const vec3 upwards[] = {{1, 0, 0}, {1, 0, 0}, {0, 0, 1}};
    struct scan scan = scan_of(waves);
    vec3 *eye = alloc_array(scan.kept_count, sizeof *eye);
    assert_non_null(eye);
    double low = INFINITY, high = -INFINITY;
    for (size_t i = 0; i < scan.kept_count; i++) low = fmin(low, scan.kept[i].x), high = fmax(high, scan.kept[i].x);
    for (int k = 0; k < 3; k++) {
        struct mesh mesh = made(&scan, SURFACE_OPEN, NULL);
        struct mesh_facts before, after;
        struct sheet_sides sides = {.views = eye, .guessed = true, .up = upwards[k]};
        for (size_t i = 0; i < scan.kept_count; i++) {
            bool below = k == 0 ? fabs(scan.kept[i].x - (low + high) / 2) < NARROW * (high - low)
                                : scan.kept[i].x > (low + 2 * high) / 3;
            eye[i] = vec3_add(scan.kept[i], (vec3){0, 0, below ? -9 : 9});
        }
        is_a_manifold_with_borders(&mesh, &before);
        assert_int_equal(sheet_part_turned(&mesh, &sides, 1), STATUS_OK);
        is_a_manifold_with_borders(&mesh, &after);
        assert_true(k == 1 ? after.components > before.components : after.edges == before.edges);
        mesh_done(&mesh);
    }
    free(eye);
    scan_done(&scan);
}

static void threads_make_the_same_mesh(void **state) {
    (void)state;
    const enum surface_form forms[] = {SURFACE_OPEN, SURFACE_HEIGHTFIELD};
    struct scan scan = scan_of(waves_with_hole);
    for (int i = 0; i < 2; i++) {
        struct mesh one = made(&scan, forms[i], NULL), three = {0};
        assert_int_equal(made_within(&scan, forms[i], 3, NULL, &three, NULL), STATUS_OK);
        assert_true(same(&one, &three));
        mesh_done(&one), mesh_done(&three);
    }
    scan_done(&scan);
}

static int stop_in(void *ctx, const char *stage, double fraction) {
    (void)fraction;
    return strcmp(stage, ctx) == 0;
}

static void all_stages_can_be_cancelled(void **state) {
    (void)state;
    static char front[] = "front", support[] = "support", delaunay[] = "delaunay";
    struct {
        char *stage;
        enum surface_form form;
        bool viewed;
    } stops[] = {{front, SURFACE_OPEN, false},
                 {support, SURFACE_OPEN, false},
                 {delaunay, SURFACE_HEIGHTFIELD, false},
                 {support, SURFACE_HEIGHTFIELD, false},
                 {delaunay, SURFACE_OPEN, true},
                 {support, SURFACE_OPEN, true},
                 {front, SURFACE_OPEN, true}};
    struct scan scan = scan_of(two_floors);
    scan.view = ABOVE;
    for (size_t i = 0; i < sizeof stops / sizeof *stops; i++) {
        scan.viewed = stops[i].viewed;
        struct progress progress = {stop_in, stops[i].stage};
        struct mesh mesh = {0};
        assert_int_equal(made_within(&scan, stops[i].form, 1, &progress, &mesh, NULL), STATUS_CANCELLED);
        assert_null(mesh.triangle);
    }
    scan_done(&scan);
}

static void a_failing_allocation_is_told(void **state) {
    (void)state;
    static const struct {
        shape *of;
        enum surface_form form;
        bool viewed;
        int each; /* allocation that fails */
    } rows_of[] = {
        {waves, SURFACE_OPEN, false, 1}, {waves, SURFACE_HEIGHTFIELD, false, 1}, {two_floors, SURFACE_OPEN, true, 4}};
    for (size_t i = 0; i < sizeof rows_of / sizeof *rows_of; i++) {
        struct scan scan = scan_of(rows_of[i].of);
        bool happened = true;
        scan.viewed = rows_of[i].viewed, scan.view = ABOVE;
        for (int nth = 1; happened; nth += rows_of[i].each) {
            struct mesh mesh = {0};
            faults_in_memory(nth, false);
            enum status status = made_within(&scan, rows_of[i].form, 1, NULL, &mesh, NULL);
            happened = faults_stop();
            assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
            mesh_done(&mesh);
        }
        scan_done(&scan);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(closed_surfaces_are_left_where_open_ones_go_through_the_points_better),
        cmocka_unit_test(rooms_are_left_unless_the_points_are_far_nearer_to_the_closed_mesh),
        cmocka_unit_test(triangles_that_rays_went_through_are_told),
        cmocka_unit_test(sheets_keep_their_borders_and_holes),
        cmocka_unit_test(a_height_field_faces_up),
        cmocka_unit_test(a_folded_grid_is_one_sheet),
        cmocka_unit_test(points_say_what_they_are_of),
        cmocka_unit_test(landscapes_are_seen_from_above),
        cmocka_unit_test(cities_are_seen_from_above_and_have_walls),
        cmocka_unit_test(woods_that_one_sees_through_may_be_a_field),
        cmocka_unit_test(leaves_that_were_seen_from_above_are_a_field),
        cmocka_unit_test(what_faces_away_is_left_for_what_misses_no_more),
        cmocka_unit_test(the_lid_decides_where_points_do_not),
        cmocka_unit_test(sides_follow_what_is_known),
        cmocka_unit_test(what_lies_faces_upwards),
        cmocka_unit_test(what_faces_the_other_way_is_cut_off),
        cmocka_unit_test(walls_that_those_within_see_turned_are_cut_off),
        cmocka_unit_test(walls_of_a_room_face_their_middle),
        cmocka_unit_test(all_of_a_landscape_faces_upwards),
        cmocka_unit_test(single_guesses_cut_nothing),
        cmocka_unit_test(landscapes_go_on_in_shadows),
        cmocka_unit_test(height_fields_are_the_same_whatever_is_remembered),
        cmocka_unit_test(what_one_place_has_seen_faces_it),
        cmocka_unit_test(between_rays_from_one_place_gaps_are_wider),
        cmocka_unit_test(a_few_rays_that_went_far_span_no_surface),
        cmocka_unit_test(walls_of_no_points_are_trimmed),
        cmocka_unit_test(threads_make_the_same_mesh),
        cmocka_unit_test(all_stages_can_be_cancelled),
        cmocka_unit_test(a_failing_allocation_is_told),
        cmocka_unit_test(a_stray_is_no_lid),
        cmocka_unit_test(what_is_moved_off_the_points_is_trimmed),
        cmocka_unit_test(what_is_mostly_near_is_not_trimmed),
        cmocka_unit_test(hills_have_no_curtains),
        cmocka_unit_test(lines_far_apart_are_one_sheet),
        cmocka_unit_test(outliers_are_no_lid),
    };
    return cmocka_run_group_tests_name("sheet", tests, NULL, NULL);
}
