/* Stages of Tight Cocone that one other file takes, in that order: cocone.c the labels and the literal rules, handles.c
 * discs and shells.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_COCONE_INTERNAL_H
#define WHITTLE_CORE_SURFACE_COCONE_COCONE_INTERNAL_H

#include "core/mesh/mesh.h"
#include "core/surface/cocone/cut.h"
#include "core/surface/cocone/frame.h"
#include "core/surface/cocone/star.h"
#include "core/surface/reconstruct.h"

/* ------------------------------------------------------------------------------------------------ label.c */

/* Labels of cells by orientation and cuts: with the normals given, with those of the poles, or with both side by side.
 */

struct cocone_label {
    uint8_t *inside;         /* of each cell; owned */
    struct cocone_cost cost; /* owned */
    size_t conflicts;        /* see struct reconstruct_facts */
};

/* Makes count labellings (at most COCONE_FRAMES), from one frame each, see cocone_frame_build.  O(cells log cells) in
 * practice, on a thread for each.  STATUS_NO_MEMORY, STATUS_CANCELLED, and then whoever calls gives what is there to
 * cocone_label_done. */
enum status cocone_label_make(const struct cocone_star *star, const struct reconstruct_input *input, unsigned threads,
                              const struct progress *progress, struct cocone_label label[], int count) MUST_CHECK;

/* Accepts a zeroed label. */
void cocone_label_done(struct cocone_label *label);

/* ------------------------------------------------------------------------------------------------ facets.c */

/* Candidate facets by the literal rules: which facets might be surface, before one is chosen of each pair of sheets. */

/* A facet has an id; both of its half facets lead to it. */
struct cocone_facets {
    size_t count;
    uint32_t *half;        /* count: the half facet in the cell with the smaller id; owned */
    uint32_t (*vertex)[3]; /* count; owned */
    uint8_t *alive;        /* count: 1 until the facet is deleted; owned */
    uint32_t *of_half;     /* 4 * cell_count: id or NONE; owned */
    uint32_t *begin;       /* n + 1: where the facets at each vertex begin; owned */
    uint32_t *around;      /* 3 * count; owned */
    uint8_t *flat;         /* n: 1 = the Voronoi cell is long and thin, so its normal can be trusted; owned */
};

/* Finds the flat points (Dey, Goswami, section 3) and the facets whose dual edges meet the cocones of all of their flat
 * vertices, of which there is one at least.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_facets_find(const struct cocone_star *star, const struct cocone_frame *frame,
                               struct cocone_facets *facets) MUST_CHECK;

/* Accepts zeroed facets. */
void cocone_facets_done(struct cocone_facets *facets);

/* Whether a facet has the vertex. */
bool cocone_facets_has(const struct cocone_facets *facets, uint32_t facet, uint32_t vertex);

/* The vertex of a facet that is neither a nor b. */
uint32_t cocone_facets_apex(const struct cocone_facets *facets, uint32_t facet, uint32_t a, uint32_t b);

/* Cosine of the angle between the normals of two facets at the edge (a, b): 1 where one continues the other, -1 where
 * it is folded back onto it. */
double cocone_facets_cosine(const struct cocone_star *star, const struct cocone_facets *facets, uint32_t f, uint32_t g,
                            uint32_t a, uint32_t b);

/* ------------------------------------------------------------------------------------------------ umbrella.c */

/* From candidate facets to a surface, by the literal rules: umbrellas, pruning, the walk. */

/* Deletes facets until the ones alive are a surface where the sampling is good; good[v] = 1 for the points that have an
 * umbrella: their facets form one closed cycle.  O(facets).  STATUS_NO_MEMORY. */
enum status cocone_umbrella_choose(const struct cocone_star *star, struct cocone_facets *facets,
                                   uint8_t *good) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ peel.c */

/* Labels by marking and peeling, the literal rules. */

/* Sets inside[c] = 1 for the cells that can't be peeled off from outside, else 0.  good as from cocone_umbrella_choose;
 * points that are never reached lose it.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_peel(const struct cocone_star *star, const struct cocone_facets *facets, uint8_t *good,
                        uint8_t *inside) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ disc.c */

/* The cells that a disc spanned into a loop runs through. */

/* A closed polygon of at least three points, by their ids. */
struct cocone_disc {
    const uint32_t *point; /* borrowed */
    size_t count;
    double shift; /* of the disc off its points, in sizes of its triangles: where it coincides with facets, the sign
                     chooses between the cells on either side */
};

/* Lists the finite cells of one label among those that the disc runs through: of inner or outer ones, whichever have
 * more of it.  The disc is the fan of triangles of the least area.  How many; 0 also where there are more than `most`.
 * Microseconds for each triangle of the fan. */
size_t cocone_disc_cells(const struct cocone_star *star, const uint8_t *inside, const struct cocone_disc *disc,
                         uint32_t *cell, size_t most);

/* ------------------------------------------------------------------------------------------------ shells.c */

/* Where the shells of a surface come near each other. */

enum { COCONE_SHELLS_CELLS = 6 };

/* Sums of it tell sets of points apart. */
static inline uint64_t cocone_shells_fingerprint(uint32_t point) {
    return (point + 1ull) * (point + 1ull) * (point + 1ull);
}

/* A shell, and the smallest cells that have vertices of it and of another one. */
struct cocone_shell {
    uint32_t cell[COCONE_SHELLS_CELLS];
    double size_sq[COCONE_SHELLS_CELLS]; /* of each: its longest edge, squared; ascending */
    size_t count;
    uint64_t fingerprint; /* the sum over its vertices */
    uint32_t vertices;
};

/* Lists the shells of a mesh of some labelling (mesh->source: points of the star), but for the largest.  *shell (owned)
 * has *count of them.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_shells_list(const struct cocone_star *star, const struct mesh *mesh, struct cocone_shell **shell,
                               size_t *count) MUST_CHECK;

#endif
