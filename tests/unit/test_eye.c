/* Where scans were taken from, found by the order of their points, and by the lattice of their rays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"
#include "core/surface/sheet/eye.h"
#include "core/surface/sheet/globe.h"
#include "core/surface/sheet/hidden.h"
#include "core/surface/sheet/lattice.h"
#include "core/surface/sheet/sweep.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { WIDE = 160, HIGH = 120, MOST = 2 * WIDE * HIGH };

struct scan {
    size_t n;
    vec3 point[MOST];
};

/* The inside of a room, a chest and a board within it: the nearest along a ray from `eye`. */
static double room_along(vec3 eye, vec3 ray) {
    static const vec3 room = {4, 7, 2.5};
    static const vec3 low[] = {{1, 1.6, 0}, {2.8, 2.4, 0}}, high[] = {{1.8, 2.2, .9}, {2.9, 3.6, 1.6}};
    const double o[] = {eye.x, eye.y, eye.z}, d[] = {ray.x, ray.y, ray.z}, size[] = {room.x, room.y, room.z};
    double nearest = INFINITY;
    for (int k = 0; k < 3; k++) nearest = fmin(nearest, ((d[k] > 0 ? size[k] : 0) - o[k]) / d[k]);
    for (int b = 0; b < 2; b++) {
        const double l[] = {low[b].x, low[b].y, low[b].z}, h[] = {high[b].x, high[b].y, high[b].z};
        double enter = 0, leave = INFINITY;
        for (int k = 0; k < 3; k++) {
            double first = (l[k] - o[k]) / d[k], second = (h[k] - o[k]) / d[k];
            enter = fmax(enter, fmin(first, second)), leave = fmin(leave, fmax(first, second));
        }
        if (enter < leave) nearest = fmin(nearest, enter);
    }
    return nearest;
}

/* A depth image from eye towards +y, turned and tilted. */
static void take(struct scan *scan, vec3 eye, double turn) {
    for (int j = 0; j < HIGH; j++)
        for (int i = 0; i < WIDE; i++) {
            double u = 1.2 * (i + .5) / WIDE - .6, w = .9 * (j + .5) / HIGH - .45 - .3;
            vec3 ray = {u * cos(turn) - sin(turn) + 1e-9, u * sin(turn) + cos(turn) + 1e-9, w + 1e-9};
            scan->point[scan->n++] = vec3_add(eye, vec3_scale(ray, room_along(eye, ray)));
        }
}

/* ------------------------------------------------------------------------------------------------ by their order */

static struct sweep sweep_of(const struct scan *scan, unsigned threads) {
    struct sweep sweep, one;
    assert_int_equal(sweep_find(scan->point, scan->n, false, threads, &sweep), STATUS_OK);
    assert_true(sweep.complete);
    assert_int_equal(sweep_find(scan->point, scan->n, true, threads, &one), STATUS_OK);
    assert_int_equal(one.one, sweep.one);
    if (one.one) assert_memory_equal(one.eye, sweep.eye, sizeof one.eye);
    return sweep;
}

static void shuffle(struct scan *scan) {
    uint64_t random = 7;
    for (size_t i = scan->n - 1; i > 0; i--) {
        size_t other = (size_t)(random_unit(&random) * (double)(i + 1));
        vec3 p = scan->point[i];
        scan->point[i] = scan->point[other], scan->point[other] = p;
    }
}

static void each_of_two_scans_tells_where_it_was_taken(void **state) {
    struct scan *scan = *state;
    static const vec3 eye[] = {{1.9, .4, 1.5}, {2.2, 6.5, 1.7}};
    scan->n = 0;
    take(scan, eye[0], .2);
    take(scan, eye[1], 2.9);
    struct sweep sweep = sweep_of(scan, 1), same = sweep_of(scan, 3);
    assert_int_equal(sweep.parts, 32);
    assert_int_equal(sweep.places, 2);
    assert_true(sweep.share == 1);
    for (size_t i = 0; i < sweep.parts; i++) {
        assert_true(sweep.known[i]);
        assert_true(vec3_distance(sweep.eye[i], eye[i >= sweep.parts / 2]) < .01);
    }
    assert_memory_equal(sweep.eye, same.eye, sizeof sweep.eye);
}

/* Distances that are off by up to a share of their squares, and every so many pixels nothing, as of a real camera. */
static void take_noisy(struct scan *scan, vec3 eye, double turn, double off, size_t lacking) {
    uint64_t random = 11;
    size_t begin = scan->n, n = begin;
    take(scan, eye, turn);
    for (size_t i = begin; i < scan->n; i++) {
        vec3 ray = vec3_sub(scan->point[i], eye);
        double factor = 1 + off * vec3_length(ray) * (2 * random_unit(&random) - 1);
        if (random_unit(&random) * (double)lacking >= 1) scan->point[n++] = vec3_add(eye, vec3_scale(ray, factor));
    }
    scan->n = n;
}

/* To a thousandth of its distance to what it sees, although rays are nearer to each other at the rim. */
static void a_camera_is_found_exactly(void **state) {
    struct scan *scan = *state;
    static const vec3 eye[] = {{1.9, .4, 1.5}, {2.2, 6.5, 1.7}};
    scan->n = 0;
    take_noisy(scan, eye[0], .2, .005, 12);
    struct sweep sweep = sweep_of(scan, 1);
    assert_int_equal(sweep.places, 1);
    assert_true(sweep.share == 1);
    assert_true(vec3_distance(sweep.eye[0], eye[0]) < .003);
    scan->n = 0;
    take_noisy(scan, eye[0], .2, .005, 1000000);
    take_noisy(scan, eye[1], 2.9, .005, 1000000);
    sweep = sweep_of(scan, 1);
    assert_int_equal(sweep.places, 2);
    for (size_t i = 0; i < sweep.parts; i++) assert_true(vec3_distance(sweep.eye[i], eye[i >= sweep.parts / 2]) < .003);
}

/* A scanner that turns in the room: ring after ring, of these pitches. */
static void turn_around(struct scan *scan, vec3 eye, const double *pitch, int beams, int steps, uint64_t random) {
    for (int k = 0; k < beams; k++)
        for (int i = 0; i < steps; i++) {
            double yaw = 6.283185307 * i / steps + 1e-4;
            vec3 ray = {cos(pitch[k]) * cos(yaw), cos(pitch[k]) * sin(yaw), sin(pitch[k]) + 1e-9};
            double far = room_along(eye, ray) + .01 * (random_unit(&random) - .5);
            scan->point[scan->n++] = vec3_add(eye, vec3_scale(ray, far));
        }
}

static void uneven_beams_are_found_exactly(void **state) {
    enum { BEAMS = 32 };
    struct scan *scan = *state;
    vec3 eye = {1.7, 3.1, 1.2};
    uint64_t random = 5;
    double pitch[BEAMS] = {-.5};
    for (int k = 1; k < BEAMS; k++) pitch[k] = pitch[k - 1] + .01 + .04 * random_unit(&random);
    scan->n = 0;
    turn_around(scan, eye, pitch, BEAMS, 900, random);
    struct sweep sweep = sweep_of(scan, 1);
    assert_int_equal(sweep.places, 1);
    assert_true(sweep.one);
    assert_true(vec3_distance(sweep.eye[0], eye) < .003);
}

/* From a place that explains the one half, and tells nothing of the other, not all was seen. */
static void two_scanners_are_not_one(void **state) {
    enum { BEAMS = 32 };
    struct scan *scan = *state;
    static const vec3 eye[] = {{.8, 1, 1.4}, {3.2, 6, 1.2}};
    double pitch[BEAMS];
    for (int k = 0; k < BEAMS; k++) pitch[k] = -.9 + 2.0 * k / BEAMS;
    scan->n = 0;
    for (int k = 0; k < 2; k++) turn_around(scan, eye[k], pitch, BEAMS, 560, 7);
    struct sweep sweep = sweep_of(scan, 1);
    assert_int_equal(sweep.places, 2);
    assert_false(sweep.one);
    for (size_t i = 0; i < sweep.parts; i++) assert_true(vec3_distance(sweep.eye[i], eye[i >= sweep.parts / 2]) < .01);
}

/* Half the order from one place and half from another: a place between them explains neither. */
static void several_places_are_not_taken_for_one(void **state) {
    struct scan *scan = *state;
    static const vec3 eye[] = {{1.9, .4, 1.5}, {2.4, .5, 1.4}};
    scan->n = 0;
    take_noisy(scan, eye[0], .1, .005, 1000000);
    take_noisy(scan, eye[1], .3, .005, 1000000);
    struct sweep sweep = sweep_of(scan, 1);
    assert_int_equal(sweep.places, 2);
    for (size_t i = 0; i < sweep.parts; i++) assert_true(vec3_distance(sweep.eye[i], eye[i >= sweep.parts / 2]) < .003);
}

static void points_in_no_order_tell_nothing(void **state) {
    struct scan *scan = *state;
    scan->n = 0;
    take(scan, (vec3){1.9, .4, 1.5}, .2);
    assert_int_equal(sweep_of(scan, 1).places, 1);
    scan->n = 1000;
    assert_int_equal(sweep_of(scan, 1).places, 0);
    scan->n = WIDE * HIGH;
    shuffle(scan);
    assert_int_equal(sweep_of(scan, 1).places, 0);
}

/* From either side of a wall its points are seen alike. */
static void a_wall_tells_nothing(void **state) {
    struct scan *scan = *state;
    scan->n = 0;
    for (int j = 0; j < HIGH; j++)
        for (int i = 0; i < WIDE; i++) {
            double u = 1.2 * (i + .5) / WIDE - .3, w = .9 * (j + .5) / HIGH - .45;
            vec3 ray = {u, 1 - .6 * u, w};
            scan->point[scan->n++] = vec3_scale(ray, 2 / ray.y);
        }
    assert_int_equal(sweep_of(scan, 1).places, 0);
}

/* A solid's points come one beside the other, too, but from no place. */
static void a_spiral_tells_nothing(void **state) {
    struct scan *scan = *state;
    scan->n = 0;
    for (int i = 0; i < WIDE * HIGH; i++) {
        double z = 1 - (2 * i + 1.0) / (WIDE * HIGH), r = sqrt(1 - z * z), angle = i * .05;
        scan->point[scan->n++] = (vec3){r * cos(angle), 1.5 * r * sin(angle), z};
    }
    assert_int_equal(sweep_of(scan, 1).places, 0);
}

/* What has no place in any quarter isn't looked at further where one place is all that is asked. */
static void one_place_is_told_by_large_parts(void **state) {
    struct scan *scan = *state;
    struct sweep sweep;
    scan->n = 0;
    for (int i = 0; i < WIDE * HIGH; i++) {
        double z = 1 - (2 * i + 1.0) / (WIDE * HIGH), r = sqrt(1 - z * z), angle = i * .05;
        scan->point[scan->n++] = (vec3){r * cos(angle), 1.5 * r * sin(angle), z};
    }
    assert_int_equal(sweep_find(scan->point, scan->n, true, 1, &sweep), STATUS_OK);
    assert_false(sweep.one || sweep.complete);
    assert_int_equal(sweep.parts, 0);
}

static void an_order_needs_memory(void **state) {
    struct scan *scan = *state;
    struct sweep sweep;
    long failed = 0;
    scan->n = 0;
    take(scan, (vec3){1.9, .4, 1.5}, .2);
    for (bool happened = true; happened; failed += happened) {
        faults_in_memory(failed + 1, false);
        enum status status = sweep_find(scan->point, 2048, false, 1, &sweep);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_true(failed > 2);
    assert_true(sweep.parts > 0);
}

/* ------------------------------------------------------------------------------------------------ by the lattice */

static struct lattice lattice_of(const struct scan *scan, unsigned threads) {
    struct lattice lattice;
    struct knn *knn;
    assert_int_equal(knn_new(scan->point, scan->n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(lattice_find(scan->point, scan->n, knn, threads, &lattice), STATUS_OK);
    knn_free(knn);
    return lattice;
}

static void a_camera_is_found_whatever_the_order(void **state) {
    struct scan *scan = *state;
    vec3 eye = {1.9, .4, 1.5};
    scan->n = 0;
    take_noisy(scan, eye, .2, .005, 50);
    shuffle(scan);
    assert_int_equal(sweep_of(scan, 1).places, 0);
    struct lattice lattice = lattice_of(scan, 1), same = lattice_of(scan, 3);
    assert_true(lattice.found);
    assert_true(vec3_distance(lattice.at, eye) < .005);
    assert_memory_equal(&lattice.at, &same.at, sizeof lattice.at);
}

/* Nor does a place between two cameras explain what both have seen. */
static void several_cameras_are_no_lattice(void **state) {
    struct scan *scan = *state;
    scan->n = 0;
    take_noisy(scan, (vec3){1.9, .4, 1.5}, .1, .005, 1000000);
    take_noisy(scan, (vec3){2.2, .6, 1.3}, .2, .005, 1000000);
    shuffle(scan);
    assert_false(lattice_of(scan, 1).found);
}

/* As one random half of a scan is, which is fitted to be measured by the other. */
static void half_of_a_lattice_is_enough(void **state) {
    struct scan *scan = *state;
    vec3 eye = {1.9, .4, 1.5};
    scan->n = 0;
    take_noisy(scan, eye, .2, .005, 1000000);
    shuffle(scan);
    scan->n /= 2;
    struct lattice lattice = lattice_of(scan, 1);
    assert_true(lattice.found);
    assert_true(vec3_distance(lattice.at, eye) < .005);
}

/* Few of a quarter's points have one opposite, but those have it exactly. */
static void a_quarter_of_a_lattice_tells_about_where(void **state) {
    struct scan *scan = *state;
    vec3 eye = {1.9, .4, 1.5};
    scan->n = 0;
    take_noisy(scan, eye, .2, .005, 1000000);
    shuffle(scan);
    scan->n /= 4;
    struct lattice lattice = lattice_of(scan, 1), same = lattice_of(scan, 3);
    assert_true(lattice.found);
    assert_true(vec3_distance(lattice.at, eye) < .1);
    assert_memory_equal(&lattice.at, &same.at, sizeof lattice.at);
}

static bool is_lattice_from(const struct scan *scan, vec3 place, unsigned threads) {
    bool is;
    struct knn *knn;
    assert_int_equal(knn_new(scan->point, scan->n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(lattice_is_from(scan->point, scan->n, knn, threads, place, &is), STATUS_OK);
    knn_free(knn);
    return is;
}

static void a_place_is_checked(void **state) {
    struct scan *scan = *state;
    const vec3 eye = {1.9, .4, 1.5}, beside = {1.7, .6, 1.1}, behind = {1.9, 6, 1.5};
    const size_t parts[] = {1, 2, 4};
    for (int k = 0; k < 3; k++) {
        scan->n = 0;
        take_noisy(scan, eye, .2, .005, 1000000);
        shuffle(scan);
        scan->n /= parts[k];
        for (unsigned threads = 1; threads < 4; threads += 2) {
            assert_true(is_lattice_from(scan, eye, threads));
            assert_false(is_lattice_from(scan, beside, threads));
            assert_false(is_lattice_from(scan, behind, threads));
        }
    }
    scan->n = 1000;
    assert_false(is_lattice_from(scan, eye, 1));
}

/* A grid of heights is even from any place far off, and a wall from either side. */
static void grids_are_a_lattice_from_no_place(void **state) {
    struct scan *scan = *state;
    const vec3 places[] = {{0, 0, 0}, {.5, .5, -3}, {.5, .5, 3}, {0, 0, -.2}};
    for (int flat = 0; flat < 2; flat++) {
        scan->n = 0;
        for (int j = 0; j < HIGH; j++)
            for (int i = 0; i < WIDE; i++) {
                double x = (double)i / WIDE, y = (double)j / HIGH;
                scan->point[scan->n++] = (vec3){x, y, flat ? .3 : .3 + .05 * sin(9 * x) * cos(7 * y)};
            }
        shuffle(scan);
        for (int k = 0; k < 4; k++) assert_false(is_lattice_from(scan, places[k], 1));
    }
}

/* The place of most points isn't that of all. */
static void two_to_one_is_no_lattice(void **state) {
    struct scan *scan = *state;
    scan->n = 0;
    take_noisy(scan, (vec3){1.9, .4, 1.5}, .1, .005, 1000000);
    shuffle(scan);
    scan->n /= 2;
    take_noisy(scan, (vec3){.3, .9, 1.3}, .2, .005, 1000000);
    shuffle(scan);
    assert_false(lattice_of(scan, 1).found);
}

static void a_tenth_of_a_lattice_is_none(void **state) {
    struct scan *scan = *state;
    scan->n = 0;
    take_noisy(scan, (vec3){1.9, .4, 1.5}, .2, .005, 1000000);
    shuffle(scan);
    scan->n /= 10;
    assert_false(lattice_of(scan, 1).found);
}

/* A smooth body's points are even from everywhere, or from nowhere. */
static void a_body_is_no_lattice(void **state) {
    struct scan *scan = *state;
    uint64_t random = 3;
    for (int k = 0; k < 2; k++) {
        scan->n = 0;
        for (int i = 0; i < WIDE * HIGH; i++) {
            double z = k ? 2 * random_unit(&random) - 1 : 1 - (2 * i + 1.0) / (WIDE * HIGH), r = sqrt(1 - z * z);
            double angle = k ? 6.283185307 * random_unit(&random) : i * 2.399963229728653;
            scan->point[scan->n++] = (vec3){r * cos(angle), 1.5 * r * sin(angle), z};
        }
        assert_false(lattice_of(scan, 1).found);
    }
}

static void a_lattice_needs_memory(void **state) {
    struct scan *scan = *state;
    struct lattice lattice;
    struct knn *knn;
    long failed = 0;
    scan->n = 0;
    take(scan, (vec3){1.9, .4, 1.5}, .2);
    assert_int_equal(knn_new(scan->point, scan->n, 1, &knn, NULL), STATUS_OK);
    for (bool happened = true; happened; failed += happened) {
        faults_in_memory(failed + 1, false);
        enum status status = lattice_find(scan->point, scan->n, knn, 1, &lattice);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_true(failed > 2);
    failed = 0;
    for (bool happened = true, is = false; happened; failed += happened) {
        faults_in_memory(failed + 1, false);
        enum status status = lattice_is_from(scan->point, scan->n, knn, 1, (vec3){1.9, .4, 1.5}, &is);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    knn_free(knn);
    assert_true(failed > 2);
}

/* ------------------------------------------------------------------------------------------------ program */

static int begin(void **state) {
    *state = alloc_array(1, sizeof(struct scan));
    return *state ? 0 : -1;
}

/* ------------------------------------------------------------------------------------------------ by what is hidden */

static double hidden_from(const struct scan *scan, vec3 place, unsigned threads) {
    double share;
    assert_int_equal(hidden_share(scan->point, scan->n, place, threads, &share), STATUS_OK);
    return share;
}

static void hardly_anything_is_hidden_from_where_it_was_scanned(void **state) {
    static const vec3 elsewhere[] = {{2, 9, 1}, {-1, 3, 1}, {2, 4, 5}, {6, 8, 3}};
    struct scan *scan = *state;
    scan->n = 0;
    take(scan, (vec3){1.9, .4, 1.5}, .2);
    assert_true(hidden_from(scan, (vec3){1.9, .4, 1.5}, 1) < .03);
    for (int i = 0; i < 4; i++)
        if (hidden_from(scan, elsewhere[i], 1) < .05) fail_msg("%d: %g", i, hidden_from(scan, elsewhere[i], 1));
    assert_true(hidden_from(scan, elsewhere[0], 1) == hidden_from(scan, elsewhere[0], 3));
    scan->n = 5; /* tell nothing */
    assert_true(hidden_from(scan, elsewhere[0], 1) == 0);
}

static void half_of_a_ball_is_hidden_from_outside(void **state) {
    struct scan *scan = *state;
    for (scan->n = 0; scan->n < 20000; scan->n++) {
        double h = 1 - (2. * (double)scan->n + 1) / 20000, r = sqrt(1 - h * h), turn = 2.4 * (double)scan->n;
        scan->point[scan->n] = (vec3){r * cos(turn), r * sin(turn), h};
    }
    double share = hidden_from(scan, (vec3){2, 1, 0}, 1);
    if (share < .25 || share > .5) fail_msg("%g", share);
    assert_true(hidden_from(scan, (vec3){.3, .1, 0}, 1) == 0);
}

static void what_is_hidden_needs_memory(void **state) {
    struct scan *scan = *state;
    double share;
    long failed = 0;
    scan->n = 0;
    take(scan, (vec3){1.9, .4, 1.5}, .2);
    for (bool happened = true; happened; failed += happened) {
        faults_in_memory(failed + 1, false);
        enum status status = hidden_share(scan->point, scan->n, (vec3){0, 9, 0}, 1, &share);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_true(failed >= 6);
}

/* ------------------------------------------------------------------------------------------------ globes */

/* Meridians and parallels around (5, 3, 2), of so many radians in all, with mountains. */
static void map_globe(struct scan *scan, double wide, double high) {
    for (scan->n = 0; scan->n < 20000; scan->n++) {
        double turn = wide * ((double)(scan->n % 200) / 200 - .5), lift = high * ((double)(scan->n / 200) / 100 - .5);
        double r = 4 * (1 + .03 * sin(9 * turn) * cos(13 * lift));
        scan->point[scan->n] = (vec3){5 + r * cos(lift) * cos(turn), 3 + r * cos(lift) * sin(turn), 2 + r * sin(lift)};
    }
}

static bool is_globe_around(const struct scan *scan, vec3 place) {
    bool is;
    vec3 middle;
    assert_int_equal(globe_is_around(scan->point, scan->n, place, &middle, &is), STATUS_OK);
    if (is) assert_true(vec3_distance(middle, (vec3){5, 3, 2}) < .3);
    return is;
}

static void a_globe_is_told_from_a_scan(void **state) {
    struct scan *scan = *state;
    map_globe(scan, 2 * M_PI, M_PI);
    assert_true(is_globe_around(scan, (vec3){5, 3, 2}));
    map_globe(scan, 1.2, .9);
    assert_true(is_globe_around(scan, (vec3){5.2, 3, 2}));
    assert_false(is_globe_around(scan, (vec3){13, 3, 2})); /* who is before it */
    scan->n = 0;
    take(scan, (vec3){1.9, .4, 1.5}, .2);
    assert_false(is_globe_around(scan, (vec3){1.9, .4, 1.5}));
    scan->n = 0;
    assert_false(is_globe_around(scan, (vec3){1.9, .4, 1.5}));
}

static bool is_map(const struct scan *scan, vec3 origin) {
    bool is;
    assert_int_equal(globe_is_map(scan->point, scan->n, origin, &is), STATUS_OK);
    return is;
}

static void a_region_is_told_by_the_origin(void **state) {
    struct scan *scan = *state;
    map_globe(scan, 1.4, 1.4);
    assert_true(is_map(scan, (vec3){5, 3, 2}));
    assert_false(is_map(scan, (vec3){7, 3, 2}));
    map_globe(scan, 3, 3); /* a bowl's */
    assert_false(is_map(scan, (vec3){5, 3, 2}));
    map_globe(scan, .1, .1); /* rather flat */
    assert_false(is_map(scan, (vec3){5, 3, 2}));
    scan->n = 0;
    assert_false(is_map(scan, (vec3){5, 3, 2}));
}

static void a_plane_is_no_globe(void **state) {
    struct scan *scan = *state;
    for (scan->n = 0; scan->n < 20000; scan->n++)
        scan->point[scan->n] = (vec3){(double)(scan->n % 200), (double)(scan->n / 200), 150};
    assert_false(is_globe_around(scan, (vec3){100, 50, 0}));
    assert_false(is_map(scan, (vec3){100, 50, 0}));
    for (scan->n = 0; scan->n < 20000; scan->n++) scan->point[scan->n].z = 1e-3 * (double)(scan->n * 7919 % 20000);
    assert_false(is_globe_around(scan, (vec3){100, 50, 0}));
}

static void a_globe_needs_memory(void **state) {
    struct scan *scan = *state;
    map_globe(scan, 1, 1);
    long failed = 0;
    for (bool happened = true; happened; failed += happened) {
        bool is;
        vec3 middle;
        faults_in_memory(failed + 1, false);
        enum status status = globe_is_around(scan->point, scan->n, (vec3){5, 3, 2}, &middle, &is);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_int_equal(failed, 2);
}

static int end(void **state) {
    free(*state);
    return 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(each_of_two_scans_tells_where_it_was_taken),
        cmocka_unit_test(a_camera_is_found_exactly),
        cmocka_unit_test(uneven_beams_are_found_exactly),
        cmocka_unit_test(two_scanners_are_not_one),
        cmocka_unit_test(several_places_are_not_taken_for_one),
        cmocka_unit_test(points_in_no_order_tell_nothing),
        cmocka_unit_test(a_wall_tells_nothing),
        cmocka_unit_test(a_spiral_tells_nothing),
        cmocka_unit_test(one_place_is_told_by_large_parts),
        cmocka_unit_test(an_order_needs_memory),
        cmocka_unit_test(a_camera_is_found_whatever_the_order),
        cmocka_unit_test(several_cameras_are_no_lattice),
        cmocka_unit_test(half_of_a_lattice_is_enough),
        cmocka_unit_test(a_quarter_of_a_lattice_tells_about_where),
        cmocka_unit_test(a_place_is_checked),
        cmocka_unit_test(grids_are_a_lattice_from_no_place),
        cmocka_unit_test(two_to_one_is_no_lattice),
        cmocka_unit_test(a_tenth_of_a_lattice_is_none),
        cmocka_unit_test(a_body_is_no_lattice),
        cmocka_unit_test(a_lattice_needs_memory),
        cmocka_unit_test(hardly_anything_is_hidden_from_where_it_was_scanned),
        cmocka_unit_test(half_of_a_ball_is_hidden_from_outside),
        cmocka_unit_test(what_is_hidden_needs_memory),
        cmocka_unit_test(a_globe_is_told_from_a_scan),
        cmocka_unit_test(a_region_is_told_by_the_origin),
        cmocka_unit_test(a_plane_is_no_globe),
        cmocka_unit_test(a_globe_needs_memory),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
