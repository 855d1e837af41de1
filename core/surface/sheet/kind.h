/* What a cloud is of: the skin of solids, sheets with borders, or one sheet seen from above.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_KIND_H
#define WHITTLE_CORE_SURFACE_SHEET_KIND_H

#include <stdbool.h>

#include "core/mesh/mesh.h"
#include "core/params.h"
#include "core/surface/sheet/support.h"

enum { SURFACE_REASON_BYTES = 160 };

/* What is taken a cloud for; never SURFACE_AUTO. */
struct surface_choice {
    enum surface_form form;
    vec3 up;                           /* of a height field: unit normal of its plane */
    bool sure;                         /* nothing that was measured is near its limit */
    bool room;                         /* it was left open since it is a room's, seen from within */
    bool lid;                          /* it was left open since a closed mesh has a lid, but is right without that */
    bool volume;                       /* it was left open since a closed mesh lies across the normals, as in foliage */
    char reason[SURFACE_REASON_BYTES]; /* a sentence without a full stop; "" = it was asked for */
};

/* Shares of the points, by samples. */
struct surface_signs {
    size_t points;
    vec3 up;        /* the direction that the points are seen from best */
    double layered; /* of those with others above or below them */
    double steep;   /* of those whose surface leans by over 60 degrees */
    double uneven;  /* across up: standard deviation by mean of the number of points at places that have any */
};

/* The direction that n points (distinct, in any frame) are a height field of, or nearest to it: the z axis, the normal
 * of the plane that fits them, or the one that most normals point along.  O(n).  STATUS_NO_MEMORY. */
enum status surface_signs_of(const vec3 *point, const vec3 *normal, size_t n, unsigned threads,
                             struct surface_signs *signs) MUST_CHECK;

/* Whether points were seen from above (z), as a landscape is: what lies over others, crowns and roofs, is little of it
 * and hardly steep, and no part of the plan has far more points than others, as what is near a camera has. */
bool surface_is_landscape(const struct surface_signs *signs);

/* The same of whatever surface, as that of a city's walls is: its parts face up. */
bool surface_is_from_above(const struct surface_signs *signs);

/* What those signs say: true where they suffice, and *choice is filled. */
bool surface_choose_by_signs(const struct surface_signs *signs, struct surface_choice *choice);

/* The part of a mesh's area that is farther from all points than they are from each other: a lid over what wasn't
 * scanned.  to_rims: the same where points that are sparse are taken to be hardly more apart than others: those of a
 * rim that was seen from the side are, and a lid reaches to them. */
struct surface_lid {
    double share, to_rims;
};

/* *lid of a mesh, closed or a height field, whose both shares are the same.  Triangles to a stray don't count: one
 * point far off would outweigh all others.  mesh->source are ids of the points.  As sheet_far_share. */
enum status surface_lid_of(const struct mesh *mesh, const struct sheet_points *points, enum surface_form of,
                           unsigned threads, struct surface_lid *lid) MUST_CHECK;

/* What that of a closed mesh says where signs didn't suffice. */
void surface_choose_by_lid(const struct surface_signs *signs, const struct surface_lid *lid,
                           struct surface_choice *choice);

/* Whether a landscape's mesh, of which that is the share, has walls where nothing was scanned that may be steps between
 * what one place sees and what is behind it. */
bool surface_may_have_steps(const struct surface_signs *signs, double share);

/* Whether what looks like a height field is none, as its mesh, of which that is the share, has walls where nothing was
 * scanned, more of them than it may have: a landscape, which has others above some of its points, more than other
 * fields, but fewer where one place sees all of it (seen) or it is steep; then *choice becomes open. */
bool surface_leave_field(const struct surface_signs *signs, double share, bool seen, struct surface_choice *choice);

/* How a mesh goes through points, to be compared with another of the same. */
struct surface_match {
    double area;
    double distance; /* mean of the points to it, each at most three times the distance to its neighbours */
    double leaning;  /* 1 - mean over the area of |cosine| between a triangle and the normals of its corners */
    double missed;   /* share of the points that are farther from it than from their neighbours */
    double spacing;  /* mean distance of the points to their neighbours */
};

/* The points of a cloud: n of each, normals of unit length and any sign. */
struct surface_points {
    size_t n;
    const vec3 *point, *normal;
    const float *spacing; /* mean distance to neighbours */
};

/* *match of a mesh whose sources are ids of the points; all zero without triangles.  Of many points every so many are
 * looked at.  About 1 us for each of 16 384 points and each triangle.  STATUS_NO_MEMORY. */
enum status surface_match_of(const struct mesh *mesh, const struct surface_points *points, unsigned threads,
                             struct surface_match *match) MUST_CHECK;

/* Whether points that were taken for a solid's, without being sure, are none's after all, as the mesh with borders goes
 * through them better than the closed one; then *choice becomes open.  inwards: most of that with borders faces what it
 * sees, as a room's walls do, though nothing tells where it was seen from. */
bool surface_leave_closed(const struct surface_match *closed, const struct surface_match *open, bool inwards,
                          struct surface_choice *choice);

/* The same where the closed one faces away from where its points were seen from, unless the mesh with borders misses a
 * tenth of them that the closed one doesn't. */
bool surface_leave_away(const struct surface_match *closed, const struct surface_match *open,
                        struct surface_choice *choice);

/* The same where the closed one is of a room, of which that share is hidden from outside; not sure.  Not where the
 * points are far nearer to the closed one. */
bool surface_leave_room(const struct surface_match *closed, const struct surface_match *open, double hidden,
                        struct surface_choice *choice);

/* Whether a height field is none since points lie over each other on walls, which have zigzags of many points: then one
 * of many, with as few vertices, goes through them hardly better than one of few; *choice becomes open, not sure. */
bool surface_leave_walls(const struct surface_signs *signs, const struct surface_match *few,
                         const struct surface_match *many, struct surface_choice *choice);

/* Whether points that signs call open, or tell nothing of, may be a landscape's after all, as woods that one sees
 * through have it: they were seen from above, and not nearly all of them lies over others, unless they are known to
 * fill a volume. */
bool surface_may_be_field(const struct surface_signs *signs, bool volume);

/* Of such points: whether a height field is hardly farther from them than the other surface, which choice->form tells;
 * then *choice is it, not sure.  of_more: the field is of more points than are kept, and the other surface isn't;
 * left: it was left for its steps, and has to be nearer.  Of points that fill a volume it needn't be near: it has to
 * miss hardly more of them. */
bool surface_take_field(const struct surface_signs *signs, const struct surface_match *other,
                        const struct surface_match *field, bool of_more, bool left, struct surface_choice *choice);

#endif
