/* Refinement: a mesh of the simplified cloud is fitted to the original points.
 *
 * Most of the error of a reconstruction from few points is in the choice of triangles, and some in that of the points.
 * Edges are flipped, vertices are moved, and vertices that are worth little are put where the mesh is farthest off.
 * Flips and moves are made where they lower a cost (fit.h): the distances of the original points to the mesh, weighted
 * by area, large ones counted more.  Putting a vertex elsewhere may raise it a little, since moves follow
 * (reallocate.c), and parting triangles that pass through each other doesn't regard it (uncross.c).  The other
 * direction is a bound, no part of the cost: no change takes the middle of a triangle far from the points' tangent
 * planes.  It ends with its schedule, not when nothing gains any more.
 *
 * Hoppe, DeRose, Duchamp, McDonald, Stuetzle: Mesh optimization (1993), whose operations these are: vertices move for
 * the least distance of the points, edges swap, collapse and split.  Here as many vertices come as go.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_REFINE_H
#define WHITTLE_CORE_REFINE_REFINE_H

#include <stdbool.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/mesh/mesh.h"
#include "core/params.h"
#include "core/spatial/neighbourhood.h"

/* A surface that is known: what is between the points is sampled on its triangles. */
struct refine_faces {
    size_t count;
    const uint32_t (*triangle)[3]; /* ids of points, by the lowest of each */
    const uint8_t *fixed; /* of each point: a vertex that stands there stays, and no other comes there; NULL: none is */
};

/* The original points, in the normalised frame (bounding-box diagonal 1). */
struct refine_input {
    const vec3 *points;   /* n; in space-filling order it is faster */
    const vec3 *normals;  /* n, unit, of either sign; NULL, as spacing: faces tell */
    const float *spacing; /* n: mean distance to the neighbours */
    size_t n;             /* at least 1, less than 2^28 */
    /* Of the points: the mesh is fitted to the middles of triangles between neighbours as well, which keeps it from
     * bending between few points; NULL: to the points alone. */
    const struct neighbourhood *neighbours;
    const struct creases *creases; /* of the points; NULL: not known */
    /* What an earlier stage has found of the points; taken, and zeroed when done with.  NULL or zeroed: it is found
     * here, as are samples that are others than the mesh wants. */
    struct local_delaunay *local_delaunay;
    struct samples *samples;
    vec3 up;     /* unit: where all triangles of a height field face; zero: the surface is none */
    bool viewed; /* all of the surface was seen from view, and faces it */
    vec3 view;
    const struct refine_faces *faces; /* the true surface through the points, where it is known; else NULL */
    bool settled;  /* the mesh was a dense one, collapsed to where its vertices cost least: fewer sweeps will do */
    bool anywhere; /* the points are exact and lie anywhere on a body, on none of its edges: triangles between them cut
                    * off what is sharp or round, and hardly count where a point is */
    bool sharp;    /* the faces have creases, and the mesh may fold there */
    bool smoothed; /* the points were moved to where their surface seems to be: more sweeps at points fit what is left
                    * of noise */
    bool exact;    /* the faces are the surface itself, with its creases: the mesh may fold, and fewer still will do */
};

/* Whether the middles of triangles between neighbours are of use to a mesh of so many triangles; where there are many
 * points for each, they aren't. */
bool refine_uses_local_delaunay(size_t points, size_t triangles);

struct refine_options {
    enum refine_form form;    /* none: nothing is done; flips: edges alone; full: vertices as well */
    enum placement placement; /* of vertices that move: at other original points, each used once, or anywhere */
    unsigned threads;         /* 0 = all processors */
};

struct refine_facts {
    size_t flips, moves, reallocations; /* vertices taken out in one place and put in at another */
    size_t uncrossed;                   /* flips and moves because triangles passed through each other */
    double mean_before, mean_after;     /* distance of the points (and middles) to the mesh, weighted by area */
};

/* Refines the mesh in place: the number of its vertices stays, as do its orientation, its topology and whatever isn't
 * manifold, so a closed mesh stays closed, with as many triangles.  A border is fitted like the rest, and reaches for
 * the points beyond it; its vertices stand at points, or move along their normals.  The shorter the border gets,
 * the more triangles there are.  No triangle folds onto a neighbour that it wasn't folded onto before, unless nothing
 * else keeps it from passing through another; those of a height field get as steep as they like, but keep facing up, as
 * those of a surface that was seen from one place face that.
 * No triangles pass through each other in the end, but where very many did, as noise makes them. mesh->source (may be
 * NULL with optimal placement; ids of points) follows the vertices: NONE for those that stand at no point.  A triangle
 * made of one that fills a hole and one that doesn't counts as supported.
 *
 * The same for any number of threads; about 5 us for each point.  *mesh and *facts (may be NULL) are untouched on
 * failure: STATUS_NO_MEMORY, STATUS_LIMIT (2^28 points or triangles), STATUS_CANCELLED (stage "refine"). */
enum status refine_mesh(struct mesh *mesh, const struct refine_input *input, const struct refine_options *options,
                        const struct progress *progress, struct refine_facts *facts) MUST_CHECK;

#endif
