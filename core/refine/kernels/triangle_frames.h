/* The frames of a few triangles (triangle_frame.h), made and kept four at a time.
 *
 * Refinement tries tens of surfaces of two to ten triangles for each point, and measures a few samples to each: making
 * their frames one after the other took as long as the measuring.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_KERNELS_TRIANGLE_FRAMES_H
#define WHITTLE_CORE_REFINE_KERNELS_TRIANGLE_FRAMES_H

#include <stddef.h>

#include "core/math/triangle_frame.h"
#include "core/math/vec3.h"

enum { FRAMES_WIDTH = 4, FRAMES_MOST = 32 };

/* Four triangles; the members are those of struct triangle_frame. */
struct frames_four {
    double ax[FRAMES_WIDTH], ay[FRAMES_WIDTH], az[FRAMES_WIDTH];
    double ux[FRAMES_WIDTH], uy[FRAMES_WIDTH], uz[FRAMES_WIDTH];
    double vx[FRAMES_WIDTH], vy[FRAMES_WIDTH], vz[FRAMES_WIDTH];
    double nx[FRAMES_WIDTH], ny[FRAMES_WIDTH], nz[FRAMES_WIDTH];
    double bx[FRAMES_WIDTH], cx[FRAMES_WIDTH], cy[FRAMES_WIDTH];
    double bc_x[FRAMES_WIDTH], bc_y[FRAMES_WIDTH], bc_length[FRAMES_WIDTH];
    double ac_x[FRAMES_WIDTH], ac_y[FRAMES_WIDTH], ac_length[FRAMES_WIDTH];
    double shape[FRAMES_WIDTH];
};

struct triangle_frames {
    struct frames_four four[FRAMES_MOST / FRAMES_WIDTH];
};

/* Triangles first .. first + n - 1 of some: a small piece of surface. */
struct surface {
    const struct frames_four *four;
    size_t first, n;
};

/* Where the corners of a triangle are. */
struct triangle_corners {
    const vec3 *a, *b, *c;
};

/* The frames of n (1 .. FRAMES_MOST) triangles, with the bits that triangle_frame_of gives each. */
struct surface triangle_frames_make(struct triangle_frames *frames, const struct triangle_corners *corners, size_t n);

static inline vec3 surface_normal(const struct surface *surface, size_t i) {
    size_t k = surface->first + i, lane = k % FRAMES_WIDTH;
    const struct frames_four *four = &surface->four[k / FRAMES_WIDTH];
    return (vec3){four->nx[lane], four->ny[lane], four->nz[lane]};
}

static inline double surface_shape(const struct surface *surface, size_t i) {
    size_t k = surface->first + i;
    return surface->four[k / FRAMES_WIDTH].shape[k % FRAMES_WIDTH];
}

static inline double surface_area(const struct surface *surface, size_t i) {
    size_t k = surface->first + i, lane = k % FRAMES_WIDTH;
    const struct frames_four *four = &surface->four[k / FRAMES_WIDTH];
    return four->bx[lane] * four->cy[lane] / 2;
}

vec3 surface_middle(const struct surface *surface, size_t i);

#endif
