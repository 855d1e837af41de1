/* The frame is that of the coordinates seen from the camera, without one in five hundred at each side: strays of a scan
 * would make all else small.  Where those are no strays, the frame that all points have is hardly larger and is taken.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/picture/view.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/quantile.h"

static const double SMALLEST = 1e-200; /* half a box's side: what is smaller is one place */
static const double FLAT = 0.4;        /* of both other sides: what is lower lies, as terrain does */
static const double LOWEST = 0.03;     /* of the height is what things stand on */
static const double MARGIN = 0.04, STRAYS = 0.002, HARDLY = 1.25, DEGREE = 0.017453292519943295;

struct extent {
    double low, high;
};

static vec3 box_of(const vec3 *point, size_t n, vec3 *middle) {
    vec3 low = point[0], high = point[0];
    for (size_t i = 1; i < n; i++) low = vec3_min(low, point[i]), high = vec3_max(high, point[i]);
    *middle = vec3_add(vec3_scale(low, 0.5), vec3_scale(high, 0.5));
    return vec3_sub(vec3_scale(high, 0.5), vec3_scale(low, 0.5)); /* halves, which don't overflow */
}

/* How much of its box what is lowest along an axis spans, in the other two: feet span much, a nose or a tail little. */
static double footing(const vec3 *point, size_t n, enum view_up up, vec3 low, vec3 size) {
    double base = up == VIEW_UP_Y ? low.y + LOWEST * size.y : low.z + LOWEST * size.z;
    struct extent x = {INFINITY, -INFINITY}, other = x;
    for (size_t i = 0; i < n; i++) {
        double height = up == VIEW_UP_Y ? point[i].y : point[i].z, across = up == VIEW_UP_Y ? point[i].z : point[i].y;
        if (height > base) continue;
        x = (struct extent){fmin(x.low, point[i].x), fmax(x.high, point[i].x)};
        other = (struct extent){fmin(other.low, across), fmax(other.high, across)};
    }
    double deep = up == VIEW_UP_Y ? size.z : size.y;
    return size.x > 0 && deep > 0 ? (x.high - x.low) / size.x * ((other.high - other.low) / deep) : 0;
}

/* box: half its sides. */
static enum view_up choose_up(const vec3 *point, size_t n, vec3 middle, vec3 box) {
    vec3 low = vec3_sub(middle, box), size = vec3_scale(box, 2);
    if (box.z < FLAT * box.x && box.z < FLAT * box.y) return VIEW_UP_Z;
    return footing(point, n, VIEW_UP_Y, low, size) > footing(point, n, VIEW_UP_Z, low, size) ? VIEW_UP_Y : VIEW_UP_Z;
}

static void set_axes(struct view *view, enum view_up up, double azimuth, double elevation) {
    static const vec3 x = {1, 0, 0}, y = {0, 1, 0}, z = {0, 0, 1};
    vec3 above = up == VIEW_UP_X ? x : up == VIEW_UP_Y ? y : z;
    vec3 front = up == VIEW_UP_X ? z : up == VIEW_UP_Y ? z : (vec3){0, -1, 0};
    vec3 side = vec3_cross(above, front);
    double a = azimuth * DEGREE, e = elevation * DEGREE;
    vec3 level = vec3_add(vec3_scale(front, cos(a)), vec3_scale(side, sin(a)));
    view->right = vec3_sub(vec3_scale(side, cos(a)), vec3_scale(front, sin(a)));
    view->towards = vec3_add(vec3_scale(level, cos(e)), vec3_scale(above, sin(e)));
    view->up = vec3_cross(view->towards, view->right);
}

/* The extent of n values without the strays; reorders them. */
static struct extent extent_of(float *value, size_t n) {
    struct extent all = {(double)value[0], (double)value[0]};
    for (size_t i = 1; i < n; i++)
        all.low = fmin(all.low, (double)value[i]), all.high = fmax(all.high, (double)value[i]);
    struct extent most = {(double)quantile_of(value, n, STRAYS), (double)quantile_of(value, n, 1 - STRAYS)};
    return all.high - all.low <= HARDLY * (most.high - most.low) ? all : most;
}

static double size_of(struct extent e) { return e.high - e.low; }

enum status view_fit(const vec3 *point, size_t n, enum view_up up, double azimuth, double elevation, size_t width,
                     struct view *view) {
    struct view made = {.scale = 1, .width = (double)width};
    vec3 box = box_of(point, n, &made.centre);
    double largest = fmax(fmax(box.x, box.y), box.z);
    if (largest < SMALLEST) largest = 1;
    float *x = alloc_array(n, sizeof *x), *y = alloc_array(n, sizeof *y);
    if (!x || !y) {
        free(x), free(y);
        return STATUS_NO_MEMORY;
    }
    set_axes(&made, up == VIEW_UP_AUTO ? choose_up(point, n, made.centre, box) : up, azimuth, elevation);
    for (size_t i = 0; i < n; i++) {
        vec3 p = vec3_scale(vec3_sub(point[i], made.centre), 1 / largest);
        x[i] = (float)vec3_dot(p, made.right), y[i] = (float)vec3_dot(p, made.up);
    }
    struct extent across = extent_of(x, n), along = extent_of(y, n);
    free(x), free(y);
    double wide = fmax(size_of(across), 1e-6), high = fmax(size_of(along), 1e-6), inner = made.width * (1 - 2 * MARGIN);
    made.height = floor(made.width * fmin(fmax(high / wide * (1 - 2 * MARGIN) + 2 * MARGIN, 0.5), 1));
    made.scale = fmin(inner / wide, (made.height - 2 * MARGIN * made.width) / high) / largest;
    vec3 to_middle = vec3_add(vec3_scale(made.right, largest * (across.low + across.high) / 2),
                              vec3_scale(made.up, largest * (along.low + along.high) / 2));
    made.centre = vec3_add(made.centre, to_middle);
    *view = made;
    return STATUS_OK;
}

vec3 view_project(const struct view *view, vec3 point) {
    vec3 p = view_turn(view, vec3_scale(vec3_sub(point, view->centre), view->scale));
    return (vec3){view->width / 2 + p.x, view->height / 2 - p.y, -p.z};
}

vec3 view_turn(const struct view *view, vec3 direction) {
    return (vec3){vec3_dot(direction, view->right), vec3_dot(direction, view->up), vec3_dot(direction, view->towards)};
}
