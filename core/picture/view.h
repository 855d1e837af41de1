/* Where a picture is taken from: a parallel projection, so that one scale bar holds for all of it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PICTURE_VIEW_H
#define WHITTLE_CORE_PICTURE_VIEW_H

#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

/* Which axis of the file points upwards.  AUTO: z of what is flat, as terrain is; else y or z, whichever has the wider
 * footing: feet and plinths span much of the box, a nose or a tail little. */
enum view_up { VIEW_UP_AUTO, VIEW_UP_X, VIEW_UP_Y, VIEW_UP_Z };

/* What AUTO means for n >= 1 finite points: VIEW_UP_Y or VIEW_UP_Z.  O(n). */
enum view_up view_choose_up(const vec3 *point, size_t n);

/* right, up and towards (the viewer) are orthogonal unit vectors.  Pixels: x to the right, y downwards, from the
 * picture's upper left corner; depth grows away from the viewer, in pixels too. */
struct view {
    vec3 centre, right, up, towards;
    double scale; /* pixels for a unit of the file; > 0 */
    double width, height;
};

/* Looks at n >= 1 finite points from azimuth (0 = the front: -y where z is up, +z where y is; positive = from further
 * right; NAN = the widest side, 30 degrees from its right or left, whichever turns the front away less) and elevation
 * (90 = from above), both in degrees.  The picture is width pixels wide and as high as the points ask for, half that to
 * width; points fill it but for a margin, and a few far from all others are left outside.  O(n).  STATUS_NO_MEMORY. */
enum status view_fit(const vec3 *point, size_t n, enum view_up up, double azimuth, double elevation, size_t width,
                     struct view *view) MUST_CHECK;

/* x, y, depth. */
vec3 view_project(const struct view *view, vec3 point);

/* A direction of the file as right, up, towards. */
vec3 view_turn(const struct view *view, vec3 direction);

#endif
