/* Reconstructions: from the Delaunay tetrahedra of points to the surface through them.  One table of them all.
 *
 * To add one: a file that defines reconstruct_NAME, and its row here.  The values of the parameter `reconstruction`,
 * their help and the schema are those of the table.  A method makes the closed surface of points in space; points on
 * one plane, open boundaries and what is counted are the same for all, and done by reconstruct_surface.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_RECONSTRUCT_H
#define WHITTLE_CORE_SURFACE_RECONSTRUCT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/mesh/mesh.h"
#include "core/params.h"
#include "core/surface/tets.h"

/* constant, name (of the parameter's value and of the function), name in the report, what it is, its source.  The
 * order is that of the values: new ones come last. */
#define RECONSTRUCTION_ROWS(ROW)                                                                                       \
    ROW(TIGHT, tight, "tight-cocone", "Tight Cocone with dense normals and consistent marking",                        \
        "after Dey and Goswami 2003")                                                                                  \
    ROW(LITERAL, literal, "literal", "Tight Cocone as published", "Dey and Goswami 2003")

#define ROW(constant, name, reported, what, source) RECONSTRUCTION_##constant,
enum { RECONSTRUCTION_ROWS(ROW) RECONSTRUCTIONS };
#undef ROW

struct knn;
struct neighbourhood;
struct creases;

/* How far points are from their neighbours' feet in the plane of a height field, once that is known. */
struct plane_reach {
    vec3 up;      /* the plane's normal */
    float *reach; /* n, owned; NULL = not known */
    float median;
};

/* The points that those to be meshed were chosen from.  All borrowed. */
struct reconstruct_dense {
    size_t n;
    const vec3 *point, *normal;             /* n; unit normals of either sign */
    const float *spacing;                   /* n: mean distance to the neighbours */
    const uint32_t *site;                   /* n: which of the points to be meshed stands for each */
    const struct knn *knn;                  /* over them */
    const struct neighbourhood *neighbours; /* of them; NULL = not known: their nearest ones are looked for */
    const struct creases *creases;          /* of them; NULL = not known */
    struct plane_reach *plane;              /* of them, which a height field remembers for the next; or NULL */
};

/* How many pieces a closed surface may have, without the smallest ones, which may be left out afterwards as far as they
 * have at most this share of the vertices together.  Zeroed: any number. */
struct reconstruct_pieces {
    size_t most;
    double left_out;
};

struct reconstruct_input {
    const vec3 *points; /* n, those that the tetrahedra are of */
    size_t n;
    const vec3 *normals;   /* n unit vectors with any sign, better ones than so few points give; NULL = not known */
    const double *support; /* n: how far around each point the points that it stands for reach; NULL = not known: then
                              no facet is a hole's */
    const struct reconstruct_dense
        *dense;    /* what surfaces are judged by; NULL = not known: then there is nothing to choose */
    bool bars;     /* many points are on bars hardly thicker than they are apart: tubes stay (surface/tubes.h) */
    bool oriented; /* the normals of each piece point outwards, nearly all of them, or inwards */
    double gaps; /* what a surface across edges that are long for their points costs, by what it does usually; 0 = 1 */
    struct reconstruct_pieces pieces; /* what has too many of them isn't mended, as it is of no use */
};

/* Tells whether a closed surface is enough as it is, before errors of its labelling are mended: at first, and at later
 * stages where its last answer was to ask again.  Vertices' sources are as in the result. */
enum reconstruct_stage { STAGE_LABELLED, STAGE_JUDGED, STAGE_REPAIRED };
enum reconstruct_answer { ANSWER_GO_ON, ANSWER_ASK_AGAIN, ANSWER_ENOUGH };
struct reconstruct_probe {
    enum status (*is_enough)(void *ctx, const struct mesh *rough, enum reconstruct_stage stage,
                             enum reconstruct_answer *answer);
    void *ctx;
};

struct reconstruct_options {
    unsigned method;             /* row of the table */
    enum boundary_form boundary; /* BOUNDARY_KEEP leaves out what spans holes: the mesh may be open */
    unsigned threads;            /* 0 = all processors */
    enum surface_form surface;   /* of reconstruct_sheet: open or heightfield */
    vec3 up;                     /* of a height field: unit normal of its plane */
    bool landscape;              /* likewise: seen from above (kind.h), with the shadows that crowns and roofs have */
    bool viewed;                 /* a surface with borders, all of which was seen from view; without tets */
    vec3 view;
    const struct reconstruct_probe *probe; /* of a closed surface; NULL = whatever it is like it is to be improved */
};

struct reconstruct_facts {
    const char *form;      /* the method's name in the report, or "planar", "advancing-front", "delaunay-2d" (of a
                              height field), "delaunay-of-view" */
    size_t points_lost;    /* points that are no vertex of the mesh */
    size_t vertices_split; /* vertices over one for each point */
    size_t hole_fill;      /* facets tagged as such, or left out */
    size_t conflicts;      /* cells on which two of their points disagree with certainty, after orientation */
    size_t flips;          /* cells whose label the repair changed */
    size_t closed;         /* handles, tunnels and shells that nothing spoke for */
    bool too_many_pieces;  /* by input->pieces: it isn't mended */
    size_t reconsidered;   /* cells whose label the normals from the poles gave, as the better one */
};

/* What a method is given.  All borrowed. */
struct reconstruct_task {
    const struct tets *tets; /* of dimension 3 */
    const struct reconstruct_input *input;
    const struct reconstruct_options *options;
    const struct progress *progress;
};

/* A method: a mesh that is closed and oriented outwards, with a source for each vertex and a tag for each triangle, or
 * an empty one where it finds no surface; zeroed or unfinished on failure, for the caller to free.  Of *facts it counts
 * what it alone knows.  The same for any number of threads. */
#define ROW(constant, name, reported, what, source)                                                                    \
    enum status reconstruct_##name(const struct reconstruct_task *task, struct mesh *mesh,                             \
                                   struct reconstruct_facts *facts) MUST_CHECK;
RECONSTRUCTION_ROWS(ROW)
#undef ROW

/* Reconstructs.  With BOUNDARY_FILL the mesh is closed: each edge has exactly two triangles, in opposite directions,
 * and the triangles at each vertex are one fan.  Triangles are counter-clockwise seen from outside, so each component
 * has a positive volume, unless it is the wall of a cavity.  mesh->source says which point a vertex is; split copies
 * share one.  Points on one plane (dimension 2) give an open mesh of it.  All inputs are borrowed; *mesh and *facts
 * (may be NULL) are untouched on failure.
 *
 * The same for any number of threads.  O(cells log cells) in practice.  STATUS_DEGENERATE where there is no surface,
 * STATUS_NO_MEMORY, STATUS_LIMIT (2^30 cells), STATUS_CANCELLED (stage "cocone"). */
enum status reconstruct_surface(const struct tets *tets, const struct reconstruct_input *input,
                                const struct reconstruct_options *options, const struct progress *progress,
                                struct mesh *mesh, struct reconstruct_facts *facts) MUST_CHECK;

/* Reconstructs a surface with borders, through points in space: sheets (SURFACE_OPEN), which of whose sides is in front
 * is arbitrary, or one sheet that faces up (SURFACE_HEIGHTFIELD).  Nothing spans what the original points
 * (input->dense, which must be known) say wasn't scanned.  The mesh is oriented and a manifold with borders, and all
 * its triangles are tagged as supported; mesh->source is as above.  Points may be left out (facts->points_lost).  Not
 * all points may be on one plane, but for a height field's.
 *
 * Failures as above, and STATUS_ENGINE where CGAL fails; error (may be NULL) says why but for lack of memory and of a
 * surface. */
enum status reconstruct_sheet(const struct tets *tets, const struct reconstruct_input *input,
                              const struct reconstruct_options *options, const struct progress *progress,
                              struct mesh *mesh, struct reconstruct_facts *facts, struct error *error) MUST_CHECK;

#endif
