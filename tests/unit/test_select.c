/* The part of a cloud that is asked for; normals as properties; spacings; sides of normals.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/normals.h"
#include "core/cloud/select.h"
#include "core/io/read.h"
#include "core/pipeline/pipeline.h"
#include "core/simplify/normal_sides.h"
#include "core/simplify/normals.h"
#include "core/simplify/spacing.h"
#include "core/spatial/knn.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { SIDE = 10 };

/* SIDE x SIDE x 2 points on whole coordinates, with a list, and two triangles. */
static struct cloud make_grid(void) {
    char *text = NULL;
    size_t bytes;
    struct cloud cloud = {0};
    struct error error = {0};
    FILE *out = open_memstream(&text, &bytes);
    fprintf(out,
            "ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
            "property uchar classification\nproperty list uchar int tags\nproperty float Intensity\n"
            "element face 2\nproperty list uchar int vertex_indices\nend_header\n",
            2 * SIDE * SIDE);
    for (int i = 0; i < 2 * SIDE * SIDE; i++)
        fprintf(out, "%d %d %d %d %d%s %s\n", i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE), i % 7, i % 3,
                i % 3 == 0   ? ""
                : i % 3 == 1 ? " 8"
                             : " 8 9",
                i == 5  ? "nan"
                : i % 2 ? "10.5"
                        : "20");
    fprintf(out, "3 0 1 2\n3 22 23 24\n");
    fclose(out);
    if (cloud_read_memory(text, bytes, NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    free(text);
    return cloud;
}

static enum status take(struct cloud *cloud, const char *crop, const char *where, struct selection *selection,
                        struct error *error) {
    struct params params;
    params_defaults(&params);
    if (crop) assert_int_equal(params_set(&params, "crop", crop, NULL), STATUS_OK);
    if (where) assert_int_equal(params_set(&params, "where", where, NULL), STATUS_OK);
    *selection = (struct selection){0};
    return select_in_place(cloud, &params, selection, error);
}

static void what_is_asked_for_stays(void **state) {
    (void)state;
    static const struct {
        const char *crop, *where;
        size_t left, cropped;
    } cases[] = {
        {"2,3,0,4,3,1", NULL, 6, 194},
        {"4,3,1,2,3,0", NULL, 6, 194}, /* corners in any order */
        {"-1,-1,0,99,99,0", NULL, 100, 100},
        {"-.5,-.5,3.5,-.5,3.5,3.5,-.5,3.5", NULL, 32, 168},
        {"-.5,-.5,2.6,-.5,-.5,2.6,-.5,-.5", NULL, 12, 188}, /* a triangle: x + y <= 2 */
        {"-.5,-.5,4.5,-.5,4.5,4.5,2.5,1.5,-.5,4.5", NULL, 0, 0},
        {NULL, "classification==2", 29, 0},
        {NULL, "class=2", 29, 0},
        {NULL, "class==2|6", 57, 0},
        {NULL, "class!=2|6", 143, 0},
        {NULL, "intensity>10.5", 100, 0},
        {NULL, "Intensity>=10.5", 199, 0},
        {NULL, "Intensity<20", 99, 0},
        {NULL, "Intensity<=20", 199, 0},
        {NULL, "Intensity!=20", 100, 0}, /* nan isn't 20 */
        {NULL, "x>=5,y<5,z==1", 25, 0},
        {"0,0,0,4,4,1", "z==1", 25, 150},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct cloud cloud = make_grid();
        struct selection selection;
        struct error error = {0};
        enum status status = take(&cloud, cases[i].crop, cases[i].where, &selection, &error);
        if (status) fail_msg("case %zu: %s", i, error.text);
        if (cases[i].left) {
            if (cloud.count != cases[i].left) fail_msg("case %zu: %zu points", i, cloud.count);
            assert_int_equal(selection.cropped, cases[i].cropped);
        } else { /* a polygon with a notch: less than its hull */
            assert_in_range(cloud.count, 20, 49);
        }
        assert_int_equal(selection.cropped + selection.filtered + cloud.count, 2 * SIDE * SIDE);
        cloud_done(&cloud);
    }
}

/* Records, positions, lists and triangles stay together. */
static void all_of_a_point_stays_with_it(void **state) {
    (void)state;
    struct cloud cloud = make_grid();
    struct selection selection;
    assert_int_equal(take(&cloud, NULL, "y>=2", &selection, NULL), STATUS_OK);
    assert_int_equal(cloud.count, 160);
    assert_int_equal(cloud.triangle_count, 1);
    assert_int_equal(cloud.triangle[0][0], 2);
    for (size_t i = 0; i < cloud.count; i++) {
        size_t was = i + 20 + (i >= 80 ? 20 : 0);
        const struct property *p = &cloud.property[3], *list = &cloud.property[4];
        double class = scalar_load(cloud.record + i * cloud.record_bytes + p->offset_bytes, p->type);
        assert_true(cloud.position[i].x == (double)(was % SIDE) && class == (double)(was % 7));
        assert_int_equal(list->list_offset[i + 1] - list->list_offset[i], was % 3 * sizeof(int32_t));
    }
    cloud_done(&cloud);
}

static void refusals_say_what_there_is(void **state) {
    (void)state;
    static const struct {
        const char *crop, *where, *name, *part;
    } cases[] = {
        {NULL, "colour>2", "where", "x, y, z, classification, Intensity"},
        {NULL, "tags==8", "where", "no property 'tags'"},
        {NULL, "class==9", "where", "no point meets the conditions, of 200"},
        {"20,20,20,30,30,30", NULL, "crop", "between 0 0 0 and 9 9 1"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct cloud cloud = make_grid();
        struct selection selection;
        struct error error = {0};
        assert_int_equal(take(&cloud, cases[i].crop, cases[i].where, &selection, &error), STATUS_BAD_PARAMETER);
        assert_string_equal(error.where, cases[i].name);
        if (!strstr(error.text, cases[i].part)) fail_msg("%s", error.text);
        assert_int_equal(cloud.count, 2 * SIDE * SIDE);
        cloud_done(&cloud);
    }
}

static void lists_that_are_none_are_refused(void **state) {
    (void)state;
    static const char *const where[] = {"",           "class",       "class==",  "==2",    "class==2,",
                                        "class==two", "class=<2",    "a>1|2",    "a b==1", "class===2",
                                        "class==2|",  "class==2||3", ",class==2"};
    static const char *const crop[] = {
        "", "1,2,3,4,5", "1,2,3,4,5,6,7", "1,2,3,4,5,x", "1,2,3,4,5,nan", "1,2,3,4,5,6,"};
    static const char *const viewpoint[] = {"", "1,2", "1,2,3,4", "1,2,inf"};
    struct params params;
    params_defaults(&params);
    for (size_t i = 0; i < sizeof where / sizeof *where; i++)
        if (!params_set(&params, "where", where[i], NULL)) fail_msg("%s", where[i]);
    for (size_t i = 0; i < sizeof crop / sizeof *crop; i++)
        if (!params_set(&params, "crop", crop[i], NULL)) fail_msg("%s", crop[i]);
    for (size_t i = 0; i < sizeof viewpoint / sizeof *viewpoint; i++)
        if (!params_set(&params, "viewpoint", viewpoint[i], NULL)) fail_msg("%s", viewpoint[i]);
    char text[PARAMS_TEXT_BYTES], longest[PARAMS_TEXT_BYTES] = "";
    size_t used = 0;
    for (int i = 0; i < PARAMS_MAX_NUMBERS; i++)
        used += (size_t)snprintf(longest + used, sizeof longest - used, "%s-1.2345678901234567e-123", i ? "," : "");
    assert_int_equal(params_set(&params, "crop", longest, NULL), STATUS_OK);
    params_format(&params, params_find("crop"), text, sizeof text);
    assert_string_equal(text, longest);
    snprintf(longest + used, sizeof longest - used, ",1,1");
    assert_int_equal(params_set(&params, "crop", longest, NULL), STATUS_BAD_PARAMETER);
}

static void normals_become_properties(void **state) {
    (void)state;
    struct cloud cloud = make_grid();
    float(*normal)[3] = calloc(cloud.count, sizeof *normal);
    for (int time = 1; time <= 2; time++) { /* added, then replaced */
        for (size_t i = 0; i < cloud.count; i++) normal[i][0] = (float)i, normal[i][2] = (float)time;
        assert_int_equal(cloud_set_normals(&cloud, (const float(*)[3])normal, NULL), STATUS_OK);
        assert_int_equal(cloud.property_count, 9);
        for (size_t i = 0; i < cloud.count; i++) {
            const unsigned char *record = cloud.record + i * cloud.record_bytes;
            const struct property *p = &cloud.property[6], *intensity = &cloud.property[5];
            assert_string_equal(p->name, "nx");
            assert_true(scalar_load(record + p[0].offset_bytes, p[0].type) == (double)i);
            assert_true(scalar_load(record + p[2].offset_bytes, p[2].type) == time);
            if (i != 5)
                assert_true(scalar_load(record + intensity->offset_bytes, intensity->type) == (i % 2 ? 10.5 : 20));
        }
    }
    free(normal);
    cloud_done(&cloud);
}

/* ------------------------------------------------------------------------------------------------ spacing */

/* Points of a ranking at random, in clusters of all densities. */
static void spacing_holds_and_leaves_no_room(void **state) {
    (void)state;
    enum { N = 3000 };
    static const double spacings[] = {1e-9, 0.003, 0.02, 0.1, 0.7, 5};
    vec3 *point = calloc(N, sizeof *point);
    for (size_t s = 0; s < sizeof spacings / sizeof *spacings; s++) {
        uint64_t seed = s + 1;
        struct contraction c = {.n = N,
                                .order = calloc(N, sizeof *c.order),
                                .into = calloc(N, sizeof *c.into),
                                .error = calloc(N, sizeof *c.error)};
        for (uint32_t i = 0; i < N; i++) {
            double wide = pow(10, -3 * random_unit(&seed));
            point[i] =
                (vec3){1e3 + wide * random_unit(&seed), wide * random_unit(&seed), -7 + wide * random_unit(&seed)};
            if (i % 10 == 9) point[i] = vec3_add(point[i - 1], (vec3){spacings[s], 0, 0});
            c.order[i] = i, c.error[i] = (float)i;
            c.into[i] = i + 1 < N ? i + 1 + (uint32_t)(random_next(&seed) % (N - 1 - i)) : NONE;
        }
        size_t fits;
        assert_int_equal(spacing_apply(&c, point, spacings[s], &fits), STATUS_OK);
        assert_int_equal(c.order[N - 1], N - 1);
        uint32_t *rank = calloc(N, sizeof *rank), *of = calloc(N, sizeof *of);
        for (uint32_t i = 0; i < N; i++) rank[c.order[i]] = i;
        double least_sq = spacings[s] * spacings[s];
        for (size_t i = N - fits; i < N; i++) {
            assert_true(i == N - fits || c.order[i] > c.order[i - 1]); /* the order of before */
            for (size_t j = i + 1; j < N; j++)
                assert_true(vec3_distance_sq(point[c.order[i]], point[c.order[j]]) >= least_sq);
        }
        for (size_t i = 0; i < N - fits; i++) { /* each other one is too near to one that ranks higher */
            uint32_t p = c.order[i], q = c.into[p];
            assert_true(vec3_distance_sq(point[p], point[q]) < least_sq && q > p && rank[q] >= N - fits);
        }
        for (size_t i = 1; i < N; i++) assert_true(c.error[i] >= c.error[i - 1]);
        for (uint32_t p = 0; p < N; p++) assert_true(p == N - 1 ? c.into[p] == NONE : rank[c.into[p]] > rank[p]);
        contraction_representatives(&c, fits, of);
        for (uint32_t p = 0; p < N; p++) assert_true(rank[of[p]] >= N - fits);
        free(rank), free(of);
        contraction_done(&c);
    }
    free(point);
}

/* ------------------------------------------------------------------------------------------------ sides */

struct shape {
    vec3 *point, *normal;
    struct neighbourhood neighbours;
    struct knn *knn;
};

static struct shape shape_of(vec3 *point, size_t n) {
    struct shape s = {.point = point, .normal = calloc(n, sizeof *s.normal)};
    struct neighbourhood_options options = {2.5, 6, 10, 1};
    assert_int_equal(knn_new(point, n, 1, &s.knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(s.knn, point, n, &options, &s.neighbours), STATUS_OK);
    normals_fit(point, &s.neighbours, 1, s.normal, NULL);
    uint64_t seed = 3;
    for (size_t i = 0; i < n; i++)
        if (random_next(&seed) % 2) s.normal[i] = vec3_scale(s.normal[i], -1);
    return s;
}

static void shape_done(struct shape *s) {
    knn_free(s->knn);
    neighbourhood_done(&s->neighbours);
    free(s->point), free(s->normal);
}

static void normals_turn_together(void **state) {
    (void)state;
    enum { N = 4000, WIDE = 40 };
    enum normal_side side;
    const struct normal_evidence nothing = {NULL, NULL};
    struct shape ball = shape_of(shape_sphere(N, 0.5), N);
    assert_int_equal(normals_turn(ball.point, &ball.neighbours, &nothing, ball.normal, &side), STATUS_OK);
    assert_int_equal(side, NORMALS_OUT);
    for (size_t i = 0; i < N; i++) assert_true(vec3_dot(ball.normal[i], ball.point[i]) > 0);
    struct shape field = shape_of(shape_height_field(WIDE, height_saddle), WIDE * WIDE);
    assert_int_equal(normals_turn(field.point, &field.neighbours, &nothing, field.normal, &side), STATUS_OK);
    assert_int_equal(side, NORMALS_UP);
    for (size_t i = 0; i < WIDE * WIDE; i++) assert_true(field.normal[i].z > 0);
    /* A viewer below. */
    vec3 *view = calloc(WIDE * WIDE, sizeof *view);
    for (size_t i = 0; i < WIDE * WIDE; i++) view[i] = (vec3){0.5, 0.5, -9};
    const struct normal_evidence seen = {NULL, view};
    assert_int_equal(normals_turn(field.point, &field.neighbours, &seen, field.normal, &side), STATUS_OK);
    assert_int_equal(side, NORMALS_BY_VIEW);
    for (size_t i = 0; i < WIDE * WIDE; i++) assert_true(field.normal[i].z < 0);
    free(view);
    shape_done(&ball), shape_done(&field);
}

static void only_normals_that_fit_are_believed(void **state) {
    (void)state;
    enum { N = 4000 };
    struct shape ball = shape_of(shape_sphere(N, 0.5), N);
    vec3 *given = calloc(N, sizeof *given);
    uint64_t seed = 9;
    for (size_t i = 0; i < N; i++) given[i] = vec3_scale(ball.point[i], -3);
    assert_true(normals_fit_points(given, ball.normal, &ball.neighbours));
    for (size_t i = 0; i < N; i++) /* noise of some 20 degrees */
        given[i] = vec3_add(vec3_unit(ball.point[i]),
                            (vec3){0.8 * random_unit(&seed) - 0.4, 0.8 * random_unit(&seed) - 0.4, 0});
    assert_true(normals_fit_points(given, ball.normal, &ball.neighbours));
    const struct normal_evidence evidence = {given, NULL};
    enum normal_side side;
    assert_int_equal(normals_turn(ball.point, &ball.neighbours, &evidence, ball.normal, &side), STATUS_OK);
    assert_int_equal(side, NORMALS_BY_GIVEN);
    for (size_t i = 0; i < N; i++) assert_true(vec3_dot(ball.normal[i], ball.point[i]) > 0);
    for (size_t i = 0; i < N; i++) given[i] = vec3_scale(ball.point[i], random_next(&seed) % 2 ? 1 : -1);
    assert_false(normals_fit_points(given, ball.normal, &ball.neighbours)); /* signs at random */
    for (size_t i = 0; i < N; i++)
        given[i] = (vec3){random_unit(&seed) - 0.5, random_unit(&seed) - 0.5, random_unit(&seed) - 0.5};
    assert_false(normals_fit_points(given, ball.normal, &ball.neighbours));
    for (size_t i = 0; i < N; i++) given[i] = (vec3){0, 0, 1};
    assert_false(normals_fit_points(given, ball.normal, &ball.neighbours)); /* all the same */
    for (size_t i = 0; i < N; i++) given[i] = i % 5 ? ball.point[i] : (vec3){0, 0, NAN};
    assert_false(normals_fit_points(given, ball.normal, &ball.neighbours)); /* too few */
    free(given);
    shape_done(&ball);
}

/* ------------------------------------------------------------------------------------------------ memory */

static void every_allocation_may_fail(void **state) {
    (void)state;
    struct shape ball = shape_of(shape_sphere(300, 0.5), 300);
    const struct normal_evidence nothing = {NULL, NULL};
    enum normal_side side;
    bool happened = true;
    for (int nth = 1; happened; nth++) {
        struct cloud cloud = make_grid();
        struct selection selection;
        struct error error = {0};
        float(*normal)[3] = calloc(cloud.count, sizeof *normal);
        struct contraction c = {.n = 2, .order = calloc(2, 4), .into = calloc(2, 4), .error = calloc(2, 4)};
        c.order[1] = c.into[0] = 1, c.into[1] = NONE;
        size_t fits;
        faults_in_memory(nth, false);
        enum status status = take(&cloud, NULL, "y>=2", &selection, &error);
        if (!status) status = cloud_set_normals(&cloud, (const float(*)[3])normal, &error);
        if (!status) status = spacing_apply(&c, ball.point, 1e-9, &fits);
        if (!status) status = normals_turn(ball.point, &ball.neighbours, &nothing, ball.normal, &side);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        contraction_done(&c);
        cloud_done(&cloud);
        free(normal);
    }
    shape_done(&ball);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_asked_for_stays),    cmocka_unit_test(all_of_a_point_stays_with_it),
        cmocka_unit_test(refusals_say_what_there_is), cmocka_unit_test(lists_that_are_none_are_refused),
        cmocka_unit_test(normals_become_properties),  cmocka_unit_test(spacing_holds_and_leaves_no_room),
        cmocka_unit_test(normals_turn_together),      cmocka_unit_test(only_normals_that_fit_are_believed),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return cmocka_run_group_tests_name("select", tests, NULL, NULL);
}
