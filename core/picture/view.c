/* The frame is that of the coordinates seen from the camera, without one in five hundred at each side: strays of a scan
 * would make all else small.  Where those are no strays, the frame that all points have is hardly larger and is taken.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/picture/view.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"

static const double SMALLEST = 1e-200; /* half a box's side: what is smaller is one place */
static const double FLAT = 0.4;        /* of both other sides: what is lower lies, as terrain does */
static const double LOWEST = 0.03;     /* of the height is what things stand on */
static const double USUAL = 30;        /* degrees that the widest side is turned away by, so that depth is seen */
static const double LONG = 1.2;        /* variances along the widest side and across it: what has less is round */
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

enum view_up view_choose_up(const vec3 *point, size_t n) {
    vec3 middle, box = box_of(point, n, &middle);
    return choose_up(point, n, middle, box);
}

struct axes {
    vec3 above, front, side;
};

static struct axes axes_of(enum view_up up) {
    static const vec3 x = {1, 0, 0}, y = {0, 1, 0}, z = {0, 0, 1};
    vec3 above = up == VIEW_UP_X ? x : up == VIEW_UP_Y ? y : z;
    vec3 front = up == VIEW_UP_X ? z : up == VIEW_UP_Y ? z : (vec3){0, -1, 0};
    return (struct axes){above, front, vec3_cross(above, front)};
}

static void set_axes(struct view *view, enum view_up up, double azimuth, double elevation) {
    struct axes axes = axes_of(up);
    vec3 above = axes.above, front = axes.front, side = axes.side;
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

/* A point seen from `view`, in multiples of `largest`: to the right and upwards. */
static void see(const struct view *view, vec3 point, double largest, float *x, float *y) {
    vec3 p = vec3_scale(vec3_sub(point, view->centre), 1 / largest);
    *x = (float)vec3_dot(p, view->right), *y = (float)vec3_dot(p, view->up);
}

/* What the points extend over in the picture; x and y: scratch for n each. */
static void see_all(const struct view *view, const vec3 *point, size_t n, double largest, float *x, float *y,
                    struct extent *across, struct extent *along) {
    for (size_t i = 0; i < n; i++) see(view, point[i], largest, &x[i], &y[i]);
    *across = extent_of(x, n), *along = extent_of(y, n);
}

/* The angle of the longer axis of what is seen, strays left out, in degrees from the picture's right; NAN: it is about
 * as long in every direction. */
static double long_axis(const struct view *view, const vec3 *point, size_t n, double largest, float *x, float *y) {
    struct extent across, along;
    see_all(view, point, n, largest, x, y, &across, &along);
    double sum_x = 0, sum_y = 0, xx = 0, xy = 0, yy = 0, count = 0;
    for (size_t i = 0; i < n; i++) {
        see(view, point[i], largest, &x[0], &y[0]);
        double a = (double)x[0], b = (double)y[0];
        if (a < across.low || a > across.high || b < along.low || b > along.high) continue;
        sum_x += a, sum_y += b, xx += a * a, xy += a * b, yy += b * b, count++;
    }
    if (count < 2) return NAN;
    xx -= sum_x * sum_x / count, xy -= sum_x * sum_y / count, yy -= sum_y * sum_y / count;
    double half = (xx + yy) / 2, apart = sqrt((xx - yy) * (xx - yy) / 4 + xy * xy);
    return half + apart > LONG * (half - apart) ? atan2(2 * xy, xx - yy) / 2 / DEGREE : NAN;
}

/* Of the azimuths that turn the widest side away by USUAL, the one that turns the front away least; that of the front,
 * turned as much, where no side is wider. */
static double choose_azimuth(const vec3 *point, size_t n, enum view_up up, vec3 middle, double largest, float *x,
                             float *y) {
    struct view from_above = {.centre = middle};
    set_axes(&from_above, up, 0, 90);
    double angle = long_axis(&from_above, point, n, largest, x, y), best = INFINITY;
    if (isnan(angle)) return USUAL;
    for (int turn = -1; turn <= 1; turn++)
        for (int sign = -1; sign <= 1; sign += 2) {
            double azimuth = angle + 180 * turn + USUAL * sign;
            if (fabs(azimuth - USUAL) < fabs(best - USUAL)) best = azimuth;
        }
    return best;
}

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
    if (up == VIEW_UP_AUTO) up = choose_up(point, n, made.centre, box);
    if (isnan(azimuth)) azimuth = choose_azimuth(point, n, up, made.centre, largest, x, y);
    set_axes(&made, up, azimuth, elevation);
    struct extent across, along;
    see_all(&made, point, n, largest, x, y, &across, &along);
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
