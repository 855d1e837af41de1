/* Pictures of known scenes: what shows where, that nothing depends on threads, and that every failure is told.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <fcntl.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/picture/picture.h"
#include "core/picture/png_write.h"
#include "core/picture/view.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { SIDE = 60, SIZE = 120 };
static const unsigned char PAPER[3] = {250, 250, 248};

/* A square of points on z = 0, red left of the middle and blue right of it, with as many normals and deviations; what
 * a test leaves alone is freed by scene_done. */
struct made {
    struct cloud cloud;
    struct property property[6];
    float (*normal)[3], *deviation;
    uint32_t *kept;
    struct picture_scene scene;
};

static void put_point(struct made *made, size_t i, vec3 p) {
    struct record {
        double x, y, z;
        unsigned char rgb[3];
    } __attribute__((packed)) record = {p.x, p.y, p.z, {200, 30, 30}};
    if (p.x > 0.5) memcpy(record.rgb, (unsigned char[]){30, 30, 200}, 3);
    memcpy(&made->cloud.record[i * sizeof record], &record, sizeof record);
    made->cloud.position[i] = p;
    made->normal[i][0] = 0, made->normal[i][1] = 0, made->normal[i][2] = i % 2 ? 1 : -1;
    made->deviation[i] = p.y > 0.5 ? 2 : 0;
    made->kept[i] = (uint32_t)i;
}

static struct made *scene_of(const vec3 *point, size_t n) {
    static const char *const names[] = {"x", "y", "z", "red", "green", "blue"};
    struct made *made = calloc(1, sizeof *made);
    made->cloud = (struct cloud){.count = n,
                                 .property_count = 6,
                                 .property = made->property,
                                 .record_bytes = 27,
                                 .position = malloc(n * sizeof(vec3)),
                                 .record = malloc(n * 27),
                                 .xyz = {0, 1, 2}};
    for (unsigned j = 0; j < 6; j++) {
        snprintf(made->property[j].name, sizeof made->property[j].name, "%s", names[j]);
        made->property[j].type = j < 3 ? SCALAR_FLOAT64 : SCALAR_UINT8;
        made->property[j].offset_bytes = j < 3 ? 8 * j : 21 + j;
    }
    made->normal = malloc(n * sizeof *made->normal);
    made->deviation = malloc(n * sizeof *made->deviation);
    made->kept = malloc(n * sizeof *made->kept);
    for (size_t i = 0; i < n; i++) put_point(made, i, point[i]);
    made->scene = (struct picture_scene){.cloud = &made->cloud,
                                         .normal = (const float(*)[3])made->normal,
                                         .deviation = made->deviation,
                                         .kept = made->kept,
                                         .kept_count = n,
                                         .mean = 1,
                                         .largest = 2};
    return made;
}

static struct made *scene_square(void) {
    vec3 *point = shape_height_field(SIDE, height_plane);
    for (size_t i = 0; i < SIDE * SIDE; i++) point[i].z = 0;
    struct made *made = scene_of(point, SIDE * SIDE);
    free(point);
    return made;
}

static void scene_done(struct made *made) {
    free(made->cloud.position), free(made->cloud.record), free(made->normal), free(made->deviation), free(made->kept);
    free(made);
}

static struct picture make(const struct made *made, double azimuth, double elevation, unsigned threads) {
    const struct picture_view view = {SIZE, azimuth, elevation, VIEW_UP_Z};
    struct picture picture = {0};
    assert_int_equal(picture_make(&made->scene, &view, threads, &picture), STATUS_OK);
    return picture;
}

/* The pixel at these shares of the i-th picture; pictures are as wide as high here. */
static const unsigned char *at(const struct picture *picture, size_t i, double across, double down) {
    size_t gap = SIZE / 40 + 1, top = (size_t)(3.2 * 8);
    size_t x = gap + i * (SIZE + gap) + (size_t)(across * SIZE), y = top + (size_t)(down * SIZE);
    return &picture->rgb[3 * (y * picture->width + x)];
}

static bool is_paper(const unsigned char *rgb) { return memcmp(rgb, PAPER, 3) == 0; }

static void colours_are_where_their_points_are(void **state) {
    (void)state;
    struct made *made = scene_square();
    struct picture p = make(made, 0, 90, 1);
    for (size_t i = 0; i < 2; i++) {
        const unsigned char *left = at(&p, i, 0.3, 0.5), *right = at(&p, i, 0.7, 0.5);
        assert_true(left[0] > 120 && left[0] > 3 * left[2]);
        assert_true(right[2] > 120 && right[2] > 3 * right[0]);
    }
    for (size_t i = 0; i < 3; i++) {
        assert_true(is_paper(at(&p, i, 0.005, 0.005)) && is_paper(at(&p, i, 0.99, 0.99)));
        assert_false(is_paper(at(&p, i, 0.08, 0.08)));
        assert_false(is_paper(at(&p, i, 0.92, 0.92)));
    }
    picture_done(&p);
    scene_done(made);
}

static void points_that_are_all_black_have_no_colours(void **state) {
    (void)state;
    struct made *made = scene_square();
    for (size_t i = 0; i < made->cloud.count; i++) memset(&made->cloud.record[i * made->cloud.record_bytes + 24], 0, 3);
    struct picture p = make(made, 0, 90, 1);
    for (size_t i = 0; i < 2; i++) assert_true(at(&p, i, 0.3, 0.5)[0] > 120 && at(&p, i, 0.7, 0.5)[2] > 120);
    picture_done(&p);
    scene_done(made);
}

/* What comes of rounding isn't shown as if it were the largest that there is. */
static void deviation_of_rounding_is_pale(void **state) {
    (void)state;
    struct made *made = scene_square();
    for (size_t i = 0; i < SIDE * SIDE; i++) made->deviation[i] *= 1e-15f;
    made->scene.mean = 1e-15, made->scene.largest = 2e-15;
    struct picture p = make(made, 0, 90, 1);
    for (double down = 0.2; down < 0.9; down += 0.6) {
        const unsigned char *seen = at(&p, 2, 0.5, down), *none = at(&p, 2, 0.5, 0.8);
        for (int c = 0; c < 3; c++) assert_true(abs(seen[c] - none[c]) < 4);
    }
    picture_done(&p);
    scene_done(made);
}

static void deviation_is_pale_where_it_is_none_and_dark_where_it_is_largest(void **state) {
    (void)state;
    struct made *made = scene_square();
    struct picture p = make(made, 0, 90, 2);
    unsigned char none[3], most[3];
    const unsigned char *above = at(&p, 2, 0.5, 0.2), *below = at(&p, 2, 0.5, 0.8); /* y = 1 is above */
    picture_deviation_colour(0, none);
    picture_deviation_colour(1, most);
    assert_true(none[0] > most[0] + 80);
    assert_true(abs((below[0] - below[2]) - (none[0] - none[2])) < 12 && below[0] > 150);
    assert_true(above[0] > 2 * above[1] && above[0] < 150);
    picture_done(&p);
    scene_done(made);
}

static void a_mesh_shows_as_its_triangles(void **state) {
    (void)state;
    struct made *made = scene_square();
    vec3 vertex[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    uint32_t triangle[][3] = {{0, 1, 2}};
    struct mesh mesh = {.vertex_count = 3, .vertex = vertex, .triangle_count = 1, .triangle = triangle};
    made->scene.mesh = &mesh;
    struct picture p = make(made, 0, 90, 1), back;
    assert_false(is_paper(at(&p, 1, 0.2, 0.7)));
    assert_true(is_paper(at(&p, 1, 0.8, 0.2)));
    assert_false(is_paper(at(&p, 0, 0.8, 0.2)));
    size_t covered = 0;
    for (int y = 0; y < SIZE; y++)
        for (int x = 0; x < SIZE; x++) covered += !is_paper(at(&p, 1, (x + 0.5) / SIZE, (y + 0.5) / SIZE));
    double half = 0.5 * 0.92 * 0.92 * SIZE * SIZE;
    assert_true((double)covered > half && (double)covered < 1.05 * half);
    triangle[0][1] = 2, triangle[0][2] = 1; /* from its other side */
    back = make(made, 0, 90, 1);
    assert_memory_equal(back.rgb, p.rgb, 3 * p.width * p.height);
    picture_done(&p);
    picture_done(&back);
    scene_done(made);
}

static void what_is_nearer_hides_what_is_behind(void **state) {
    (void)state;
    vec3 *point = shape_height_field(SIDE, height_plane);
    vec3 *both = malloc(2 * SIDE * SIDE * sizeof *both);
    for (size_t i = 0; i < SIDE * SIDE; i++) {
        both[2 * i] = (vec3){0.5 * point[i].x, point[i].y, 1};             /* red, above */
        both[2 * i + 1] = (vec3){0.5 * point[i].x + 0.501, point[i].y, 0}; /* blue, below */
    }
    struct made *made = scene_of(both, 2 * SIDE * SIDE);
    for (size_t i = 0; i < made->cloud.count; i++)
        if (made->cloud.position[i].z == 0) made->cloud.position[i].x -= 0.501; /* under the red ones */
    struct picture above = make(made, 0, 90, 1), below = make(made, 0, -90, 1);
    const unsigned char *seen = at(&above, 0, 0.5, 0.5), *under = at(&below, 0, 0.5, 0.5);
    assert_true(seen[0] > 3 * seen[2] && under[2] > 3 * under[0]);
    picture_done(&above);
    picture_done(&below);
    scene_done(made);
    free(point), free(both);
}

static void light_comes_from_above_left(void **state) {
    (void)state;
    size_t n = 20000;
    vec3 *point = shape_sphere(n, 1);
    struct made *made = scene_of(point, n);
    made->cloud.property_count = 3; /* no colours */
    for (size_t i = 0; i < n; i++)
        made->normal[i][0] = (float)point[i].x, made->normal[i][1] = (float)point[i].y,
        made->normal[i][2] = (float)point[i].z;
    struct picture p = make(made, 40, 20, 2);
    int lit = at(&p, 0, 0.32, 0.3)[0], side = at(&p, 0, 0.5, 0.5)[0], shade = at(&p, 0, 0.72, 0.74)[0];
    assert_true(lit > side && side > shade + 20);
    picture_done(&p);
    scene_done(made);
    free(point);
}

static void bits_are_the_same_for_any_number_of_threads(void **state) {
    (void)state;
    struct made *made = scene_square();
    struct picture one = make(made, 33, 21, 1);
    for (unsigned threads = 2; threads < 6; threads++) {
        struct picture p = make(made, 33, 21, threads);
        assert_int_equal(p.width, one.width);
        assert_int_equal(p.height, one.height);
        assert_memory_equal(p.rgb, one.rgb, 3 * one.width * one.height);
        picture_done(&p);
    }
    picture_done(&one);
    scene_done(made);
}

static void strays_do_not_make_all_else_small(void **state) {
    (void)state;
    struct made *made = scene_square();
    struct picture without = make(made, 0, 90, 1), with;
    made->cloud.position[7] = (vec3){4000, 0, 0};
    with = make(made, 0, 90, 1);
    assert_true(with.height <= without.height && with.height + 2 > without.height);
    assert_false(is_paper(at(&with, 0, 0.08, 0.5)) || is_paper(at(&with, 0, 0.9, 0.5)));
    picture_done(&with);
    picture_done(&without);
    scene_done(made);
}

static void clouds_without_extent_have_a_picture(void **state) {
    static const vec3 one[] = {{5, 6, 7}}, line[] = {{0, 0, 1e300}, {0, 0, -1e300}},
                      same[] = {{1e-310, 0, 0}, {0, 0, 0}, {1e-310, 0, 0}};
    static const struct {
        const vec3 *point;
        size_t n;
    } cases[] = {{one, 1}, {line, 2}, {same, 3}};
    (void)state;
    for (size_t i = 0; i < 3; i++) {
        struct made *made = scene_of(cases[i].point, cases[i].n);
        memset(made->deviation, 0, cases[i].n * sizeof *made->deviation);
        made->scene.normal = NULL;
        struct picture p = make(made, 10, 20, 1);
        bool drawn = false;
        for (int y = 0; y < SIZE / 2; y++)
            for (int x = 0; x < SIZE; x++) drawn |= !is_paper(at(&p, 0, (x + 0.5) / SIZE, (y + 0.5) / SIZE));
        assert_true(drawn);
        made->scene.deviation = NULL;
        struct picture two = make(made, 10, 20, 1);
        assert_true(two.width < p.width);
        picture_done(&p);
        picture_done(&two);
        scene_done(made);
    }
}

/* A bar of 4 by 1, turned by `turn` degrees around z as seen from above, on each of 41 by 41 places, and a stray. */
static struct view view_of_bar(double turn, double length, double azimuth) {
    enum { ACROSS = 41 };
    static vec3 point[ACROSS * ACROSS + 1];
    struct view view;
    double c = cos(turn * 0.017453292519943295), s = sin(turn * 0.017453292519943295);
    for (size_t i = 0; i < ACROSS * ACROSS; i++) {
        double x = length * ((double)(i % ACROSS) / (ACROSS - 1) - 0.5), y = (double)(i / ACROSS) / (ACROSS - 1) - 0.5;
        point[i] = (vec3){70 + c * x - s * y, 30 + s * x + c * y, i % 2 ? 1 : -1};
    }
    point[ACROSS * ACROSS] = (vec3){70 + 50 * s, 30 - 50 * c, 0};
    assert_int_equal(view_fit(point, ACROSS * ACROSS + 1, VIEW_UP_Z, azimuth, 0, SIZE, &view), STATUS_OK);
    return view;
}

/* Without an azimuth: 30 degrees from it, and what is in front at azimuth 0 in front still. */
static void the_widest_side_is_towards_the_viewer(void **state) {
    (void)state;
    for (int turn = -180; turn <= 180; turn += 15) {
        struct view view = view_of_bar(turn, 4, NAN);
        vec3 along = {cos(turn * 0.017453292519943295), sin(turn * 0.017453292519943295), 0};
        if (fabs(fabs(vec3_dot(view.right, along)) - sqrt(0.75)) > 1e-3)
            fail_msg("a bar turned by %d degrees is %.3f wide", turn, fabs(vec3_dot(view.right, along)));
        assert_true(view.towards.y < 0.01);
    }
    struct view usual = view_of_bar(20, 1, NAN), same = view_of_bar(20, 1, 30), asked = view_of_bar(90, 4, 0);
    assert_memory_equal(&usual, &same, sizeof usual);
    assert_true(fabs(asked.right.x - 1) < 1e-12);
}

static void every_allocation_that_fails_is_told(void **state) {
    const struct picture_view view = {SIZE, 0, 30, VIEW_UP_AUTO};
    (void)state;
    struct made *made = scene_square();
    FILE *file = tmpfile();
    long nth = 1;
    for (bool failed = true; failed; nth++) {
        struct picture p = {0};
        struct error error = {0};
        faults_in_memory(nth, true);
        enum status status = picture_make(&made->scene, &view, 1, &p);
        if (!status) status = picture_write_png(fileno(file), &p, &error);
        failed = faults_stop();
        assert_int_equal(status, failed ? STATUS_NO_MEMORY : STATUS_OK);
        picture_done(&p);
    }
    assert_true(nth > 15);
    fclose(file);
    scene_done(made);
}

static void a_file_that_cannot_be_written_is_told(void **state) {
    (void)state;
    struct made *made = scene_square();
    struct picture p = make(made, 0, 30, 1);
    struct error error = {0};
    int fd = open("/dev/full", O_WRONLY);
    assert_true(fd >= 0);
    assert_int_equal(picture_write_png(fd, &p, &error), STATUS_NO_SPACE);
    assert_non_null(strstr(error.text, "No space"));
    close(fd);
    picture_done(&p);
    scene_done(made);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(colours_are_where_their_points_are),
        cmocka_unit_test(points_that_are_all_black_have_no_colours),
        cmocka_unit_test(deviation_of_rounding_is_pale),
        cmocka_unit_test(deviation_is_pale_where_it_is_none_and_dark_where_it_is_largest),
        cmocka_unit_test(a_mesh_shows_as_its_triangles),
        cmocka_unit_test(what_is_nearer_hides_what_is_behind),
        cmocka_unit_test(light_comes_from_above_left),
        cmocka_unit_test(bits_are_the_same_for_any_number_of_threads),
        cmocka_unit_test(strays_do_not_make_all_else_small),
        cmocka_unit_test(clouds_without_extent_have_a_picture),
        cmocka_unit_test(the_widest_side_is_towards_the_viewer),
        cmocka_unit_test(every_allocation_that_fails_is_told),
        cmocka_unit_test(a_file_that_cannot_be_written_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
