/* The triangles around a vertex in frames of their own (triangle_frame.h), in float and eight at a time.
 *
 * A vertex is tried at several places for each time that it moves, and most of what that takes isn't measuring but
 * making the frames to measure in and seeing to it that nothing folds: so both are done for a whole star at once.  All
 * places are relative to an origin nearby.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_KERNELS_STAR_FRAMES_H
#define WHITTLE_CORE_REFINE_KERNELS_STAR_FRAMES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/math/vec3.h"

enum { STAR_MOST = 32, STAR_ROOM = STAR_MOST + 16 };

/* Directions or places.  Behind the n-th the first comes again, and what is further behind has no meaning. */
struct star_vectors {
    float x[STAR_ROOM], y[STAR_ROOM], z[STAR_ROOM];
};

/* The neighbours of a vertex: triangle i is made of the vertex and neighbours i and i + 1. */
struct star_rim {
    size_t n;  /* triangles: 3 .. STAR_MOST; of an open star, which has one neighbour more, 1 .. STAR_MOST - 1 */
    bool open; /* on a border: there is no triangle between the last neighbour and the first */
    struct star_vectors place;
};

/* The members are some of struct triangle_frame's.  A triangle without area has a shape of 0, and (0, 0, 0) as its
 * normal. */
struct star_frames {
    size_t n;
    size_t sectors; /* n, and of an open star one more: its last edge as a triangle without area */
    float ax, ay, az;
    struct star_vectors u, v, normal;
    float bx[STAR_ROOM], bx_inverse[STAR_ROOM], cx[STAR_ROOM], cy[STAR_ROOM], cy_inverse[STAR_ROOM];
    float bc_x[STAR_ROOM], bc_y[STAR_ROOM], bc_half[STAR_ROOM];    /* half: of the edge's length */
    float ac_x[STAR_ROOM], ac_y[STAR_ROOM], ac_inverse[STAR_ROOM]; /* inverse: of the edge's length */
    float shape[STAR_ROOM];
};

static inline vec3 star_vectors_at(const struct star_vectors *of, size_t i) {
    return (vec3){(double)of->x[i], (double)of->y[i], (double)of->z[i]};
}

/* Puts n vectors less the origin into `to`. */
void star_vectors_set(struct star_vectors *to, const vec3 *const *from, size_t n, vec3 origin);

/* With the vertex at `place`, which is relative to the rim's origin. */
void star_frames_make(struct star_frames *star, const struct star_rim *rim, vec3 place);

/* How far triangles may change. */
struct star_limits {
    float turn; /* smallest cosine between the normals of a triangle before and after */
    float thin; /* shape below which no triangle may get thinner */
    float fold; /* smallest cosine between the normals of neighbours, where it wasn't smaller before */
    bool steep; /* neighbours may turn against each other as far as they like */
};

/* Whether the star may change from one to the other: no triangle gets too thin or turns too far, nor do two neighbours
 * (of which `outside` are the normals of those across the rim) fold onto each other, unless it was as bad before. */
bool star_may_become(const struct star_frames *old, const struct star_frames *new, const struct star_vectors *outside,
                     struct star_limits limits);

#endif
