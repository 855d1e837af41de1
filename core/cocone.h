/* Tight Cocone: a watertight surface through points, from their Delaunay tetrahedralisation.
 *
 * T. K. Dey, S. Goswami, Tight Cocone: a water-tight surface reconstructor (2003).  COCONE_LITERAL is the paper's
 * method rule by rule.  COCONE_TIGHT, the default, keeps the cocone and the labels of cells, but finds the labels by
 * one cut over all votes and repairs what is left: it needs no point to have a good umbrella, which few have after
 * simplification.  It labels twice, with the normals given and with those of the poles, and takes of both what lies
 * nearer to the original points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_COCONE_H
#define WHITTLE_CORE_COCONE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/mesh.h"
#include "core/params.h"
#include "core/progress.h"
#include "core/status.h"
#include "core/tets.h"
#include "core/vec3.h"

struct knn;

/* The points that those to be meshed were chosen from.  All borrowed. */
struct cocone_dense {
    size_t n;
    const vec3 *point, *normal; /* n; unit normals of either sign */
    const float *spacing;       /* n: mean distance to the neighbours */
    const uint32_t *site;       /* n: which of the points to be meshed stands for each */
    const struct knn *knn;      /* over them */
};

struct cocone_input {
    const vec3 *points; /* n, those that the tetrahedra are of */
    size_t n;
    const vec3 *normals; /* n unit vectors with any sign, better ones than so few points give; NULL = from the poles */
    const double *support; /* n: how far around each point the points that it stands for reach; NULL = not known: then
                              no facet is a hole's */
    const struct cocone_dense
        *dense; /* what surfaces are judged by; NULL = not known: then there is nothing to choose */
};

struct cocone_options {
    enum cocone_form form;
    enum boundary_form boundary; /* BOUNDARY_KEEP leaves out what spans holes: the mesh may be open */
    unsigned threads;            /* 0 = all processors */
};

struct cocone_facts {
    const char *form;      /* "tight-cocone", "literal" or "planar" */
    size_t points_lost;    /* points that are no vertex of the mesh */
    size_t vertices_split; /* vertices over one for each point */
    size_t hole_fill;      /* facets tagged as such, or left out */
    size_t conflicts;      /* cells on which two of their points disagree with certainty, after orientation */
    size_t flips;          /* cells whose label the repair changed */
    size_t closed;         /* handles, tunnels and shells that nothing spoke for */
    size_t reconsidered;   /* cells whose label the normals from the poles gave, as the better one */
};

/* Reconstructs.  With BOUNDARY_FILL the mesh is closed: each edge has exactly two triangles, in opposite directions,
 * and the triangles at each vertex are one fan.  Triangles are counter-clockwise seen from outside, so each component
 * has a positive volume, unless it is the wall of a cavity.  mesh->source says which point a vertex is; split copies
 * share one.  Points on one plane (dimension 2) give an open mesh of it.  All inputs are borrowed; *mesh and *facts
 * (may be NULL) are untouched on failure.
 *
 * The same for any number of threads.  O(cells log cells) in practice.  STATUS_DEGENERATE where there is no surface,
 * STATUS_NO_MEMORY, STATUS_LIMIT (2^30 cells), STATUS_CANCELLED (stage "cocone"). */
enum status cocone_reconstruct(const struct tets *tets, const struct cocone_input *input,
                               const struct cocone_options *options, const struct progress *progress, struct mesh *mesh,
                               struct cocone_facts *facts) MUST_CHECK;

#endif
