/* Where a scan was taken from, found by how its points lie.
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
#include "core/surface/sheet/eye.h"

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

static struct eye find_with(const struct scan *scan, vec3 origin, unsigned threads) {
    struct eye eye;
    assert_int_equal(eye_find(scan->point, scan->n, origin, threads, &eye), STATUS_OK);
    return eye;
}

static void one_depth_image_tells_where_it_was_taken(void **state) {
    struct scan *scan = *state;
    vec3 eye = {1.9, .4, 1.5};
    scan->n = 0;
    take(scan, eye, .2);
    struct eye found = find_with(scan, (vec3){90, 90, 90}, 1), same = find_with(scan, (vec3){90, 90, 90}, 3);
    assert_true(found.found);
    assert_true(vec3_distance(found.at, eye) < 1.5);
    assert_true(found.at.x > 0 && found.at.x < 4 && found.at.y < 1.4 && found.at.z > .2 && found.at.z < 2.5);
    assert_memory_equal(&found.at, &same.at, sizeof found.at);
    found = find_with(scan, eye, 1);
    assert_true(found.found && vec3_equal(found.at, eye));
}

static void even_points_tell_nothing(void **state) {
    struct scan *scan = *state;
    scan->n = 0;
    for (int i = 0; i < WIDE * HIGH; i++) {
        double z = 1 - (2 * i + 1.0) / (WIDE * HIGH), r = sqrt(1 - z * z), angle = i * 2.399963229728653;
        scan->point[scan->n++] = (vec3){r * cos(angle), 1.5 * r * sin(angle), z};
    }
    assert_false(find_with(scan, (vec3){0, 0, 0}, 1).found);
}

static void few_points_tell_nothing(void **state) {
    struct scan *scan = *state;
    scan->n = 0;
    take(scan, (vec3){1.9, .4, 1.5}, .2);
    scan->n = 4000;
    assert_false(find_with(scan, (vec3){1.9, .4, 1.5}, 1).found);
}

static int begin(void **state) {
    *state = alloc_array(1, sizeof(struct scan));
    return *state ? 0 : -1;
}

static int end(void **state) {
    free(*state);
    return 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_depth_image_tells_where_it_was_taken),
        cmocka_unit_test(even_points_tell_nothing),
        cmocka_unit_test(few_points_tell_nothing),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
