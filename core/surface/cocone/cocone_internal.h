/* Stages of Tight Cocone that only this room takes, from the bottom up: frames and orientation of points, labels of
 * cells and their repair, the literal rules, discs and shells.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_COCONE_INTERNAL_H
#define WHITTLE_CORE_SURFACE_COCONE_COCONE_INTERNAL_H

#include "core/base/progress.h"
#include "core/mesh/mesh.h"
#include "core/spatial/sheets.h"
#include "core/surface/cocone/star.h"
#include "core/surface/reconstruct.h"

/* ------------------------------------------------------------------------------------------------ frame.c */

/* The frame at each point: its normal, and the poles on both sides.  Part of Tight Cocone. */

/* sin(pi / 8): the cocone at a point is the complement of the double cone of 3 pi / 8 around its normal. */
#define COCONE_FRAME_SIN 0.38268343236508977

/* There are two, with normals that are given and with those of the poles. */
enum { COCONE_FRAMES = 2 };

/* Sides of a point: that to which its normal points is 0, the other one 1. */
struct cocone_frame {
    vec3 *normal;        /* n unit vectors, on the side of the positive pole; owned */
    uint32_t (*pole)[2]; /* n: on each side the finite cell whose Voronoi vertex is highest over the tangent plane; NONE
                            where there is none; owned */
    uint8_t *hull;       /* n: bit k = an infinite cell is on side k; owned */
};

/* Builds count frames at once: the first with the given unit vectors where dense is not NULL, with the poles' sign, the
 * others with normals from the poles (Amenta, Bern; Dey, Goswami section 2).  O(cells).  STATUS_NO_MEMORY, and then
 * whoever calls gives what is there to cocone_frame_done. */
enum status cocone_frame_build(const struct cocone_star *star, const vec3 *dense, unsigned threads,
                               struct cocone_frame frame[], int count) MUST_CHECK;

/* Accepts a zeroed frame. */
void cocone_frame_done(struct cocone_frame *frame);

/* Turns a normal around, and the sides with it. */
void cocone_frame_turn(struct cocone_frame *frame, uint32_t vertex);

/* Cosine between a cell's dual direction and the normal at its vertex; 0 where the direction is zero. */
double cocone_frame_cosine(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t cell,
                           uint32_t vertex);

/* Whether the dual edge of the facet (the Voronoi edge between its two circumcentres) meets the cocone of the vertex.
 */
bool cocone_frame_accepts(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t half,
                          uint32_t vertex);

/* ------------------------------------------------------------------------------------------------ orient.c */

/* Which way is out, at every point.  Part of Tight Cocone. */

/* How the cells lie to their vertices.  lie[c][i] > 0: cell c is above vertex i, on the side to which its normal
 * points; < 0: below.  The size is how certain that is, up to 1.  3 for the vertex at infinity. */
struct cocone_lies {
    float (*lie)[4]; /* cell_count; owned */
};

/* Measures the lies in each of count frames.  O(cells).  STATUS_NO_MEMORY, and then whoever calls gives what is there
 * to cocone_orient_done. */
enum status cocone_orient_measure(const struct cocone_star *star, const struct cocone_frame frame[], int count,
                                  unsigned threads, struct cocone_lies lies[]) MUST_CHECK;

/* Accepts zeroed lies. */
void cocone_orient_done(struct cocone_lies *lies);

/* Room to work in for cocone_orient, which can't fail then.  STATUS_NO_MEMORY. */
struct cocone_gathering;
enum status cocone_gathering_new(const struct cocone_star *star, struct cocone_gathering **room) MUST_CHECK;

/* Accepts NULL. */
void cocone_gathering_free(struct cocone_gathering *room);

/* Turns the normals outwards, all of them, and the lies with them.  Returns the number of cells that two of their
 * vertices still see on opposite sides with certainty.  support (n, see struct reconstruct_input): normals of points of
 * one piece stay as they are to each other, since they came so; NULL: only their directions are known.  room:
 * fresh.  O(cells log cells) in practice. */
size_t cocone_orient(const struct cocone_star *star, const double *support, struct cocone_frame *frame,
                     struct cocone_lies *lies, struct cocone_gathering *room);

/* Lists the vertices whose normals disagree with the labels of most cells around them; how many.  O(cells). */
size_t cocone_orient_doubt(const struct cocone_star *star, const uint8_t *inside, const struct cocone_lies *lies,
                           uint32_t *list);

/* Turns the normal of a vertex, and the lies with it. */
void cocone_orient_turn(const struct cocone_star *star, struct cocone_frame *frame, struct cocone_lies *lies,
                        uint32_t vertex);

/* ------------------------------------------------------------------------------------------------ groups.c */

/* Groups of vertices that may be turned together.  Part of Tight Cocone. */
struct cocone_groups {
    uint8_t *marked;  /* n: what falls into groups, to be set by whoever asks; owned, as all are */
    uint32_t *root;   /* n: of a marked vertex: its group, as a disjoint set */
    double *evidence; /* n: of a root, that its group isn't to be turned */
};

/* Nothing is marked.  STATUS_NO_MEMORY, and then whoever calls gives what is there to cocone_groups_done. */
enum status cocone_groups_new(size_t n, struct cocone_groups *groups) MUST_CHECK;

/* Accepts zeroed groups. */
void cocone_groups_done(struct cocone_groups *groups);

/* Lists the marked vertices of groups of which more cells would agree if they were turned; how many.  list: room for n.
 * O(n) and the cells of what is marked. */
size_t cocone_groups_against(const struct cocone_star *star, const struct cocone_lies *lies,
                             struct cocone_groups *groups, uint32_t *list);

/* ------------------------------------------------------------------------------------------------ creases.c */

/* Where sheets of the surface meet at the points to be meshed, as the original points tell: on a crease no facet lies
 * along the point's normal, but each along one of the sheets'. */

/* The creases among the points to be meshed: their `of` is the caller's to free, their sheets are borrowed of
 * input->dense.  Zeroed where nothing is known.  O(n).  STATUS_NO_MEMORY. */
enum status cocone_creases_find(const struct reconstruct_input *input, struct creases *creases) MUST_CHECK;

/* The largest cosines between a unit vector, and its opposite, and the normals at a point: those of its sheets, on the
 * side of its oriented normal, or that normal itself. */
struct cocone_cosines {
    double along, against;
};

static inline struct cocone_cosines cocone_creases_cosines(const struct creases *creases, uint32_t point, vec3 normal,
                                                           vec3 direction) {
    const struct sheets *sheets = creases_at(creases, point);
    double cosine = vec3_dot(normal, direction);
    struct cocone_cosines most = {cosine, -cosine};
    if (!sheets) return most;
    most = (struct cocone_cosines){-1, -1};
    for (unsigned k = 0; k < sheets->count; k++) {
        vec3 own = sheets_normal(sheets, k);
        cosine = vec3_dot(own, direction);
        if (vec3_dot(own, normal) < 0) cosine = -cosine;
        most.along = fmax(most.along, cosine), most.against = fmax(most.against, -cosine);
    }
    return most;
}

/* ------------------------------------------------------------------------------------------------ cut.c */

/* In or out, for every cell at once: the cut that agrees best with the oriented points.  Part of Tight Cocone. */

/* Costs are whole numbers of parts: so many are the vote of a cell that is certain to a point. */
enum { COCONE_CUT_UNIT = 256 };

/* What a labelling costs.  The cost of a labelling is the sum of |vote| over the cells that are
 * labelled against their vote and of the prices of the facets between an inner and an outer cell.  A cut changes them,
 * but not by how much one labelling is dearer than another. */
struct cocone_cost {
    int32_t (*price)[4]; /* cell_count: of each half facet, for its cell outside and the other one inside; owned */
    int32_t *vote;       /* cell_count: > 0 out, < 0 in; owned */
};

/* What votes and prices come from.  All borrowed. */
struct cocone_voters {
    const struct cocone_star *star;
    const double *support;            /* n or NULL, see struct reconstruct_input */
    const struct cocone_frame *frame; /* with oriented normals */
    const struct cocone_lies *lies;
    const struct creases *creases; /* of the points */
    double gaps;                   /* what spanning them costs, by what it does usually */
};

/* Whether all three edges of the facet are as short as the support radii of their ends allow: |ab| <= 1.2 (rho_a +
 * rho_b).  True where support is NULL. */
bool cocone_cut_supported(const vec3 *point, const double *support, const uint32_t facet[3]);

/* The costs with each of count frames and lies of the voters.  O(cells).  STATUS_NO_MEMORY, and then whoever calls
 * gives what is there to cocone_cost_done. */
enum status cocone_cut_costs(const struct cocone_voters *voters, int count, unsigned threads,
                             struct cocone_cost cost[]) MUST_CHECK;

/* Accepts zeroed costs. */
void cocone_cost_done(struct cocone_cost *cost);

/* A cut by the costs of the voters' first frame; borrows both.  STATUS_NO_MEMORY. */
struct cocone_cut;
enum status cocone_cut_new(const struct cocone_voters *voters, struct cocone_cost *cost,
                           struct cocone_cut **cut) MUST_CHECK;

/* Accepts NULL. */
void cocone_cut_free(struct cocone_cut *cut);

/* inside[c] = 1 for the cells inside; infinite cells are outside always.  STATUS_CANCELLED. */
enum status cocone_cut_label(struct cocone_cut *cut, const struct progress *progress, uint8_t *inside) MUST_CHECK;

/* Changes what spanning gaps costs, for which the voters have 1 still, to that. */
void cocone_cut_span_gaps(struct cocone_cut *cut, double gaps);

/* Takes the votes of count vertices (listed without repeats) out of the costs, by = -1, or puts them in as the frame
 * and the lies are now, by = 1: what there is to do before and after they are turned.  Time for what changes alone, and
 * so for cocone_cut_label after it. */
void cocone_cut_change(struct cocone_cut *cut, const uint32_t *vertex, size_t count, int by);

/* ------------------------------------------------------------------------------------------------ repair.c */

/* Flips of single cells that bring lost points back and make the surface a manifold.  Part of Tight Cocone. */

/* Flips labels (inside, see cocone_cut_label) of finite cells as long as that takes defects away; among equals the flip
 * that costs least.  *flips counts the cells.  O(cells) and then a few microseconds for each defect.
 * STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status cocone_repair(const struct cocone_star *star, const struct cocone_cost *cost,
                          const struct progress *progress, unsigned threads, uint8_t *inside, size_t *flips) MUST_CHECK;

/* Repairs of single places, to see what would come of a change. */
struct cocone_repair;

enum { COCONE_REPAIR_TRIAL_CELLS = 64 };

/* What a change of some cells leads to. */
struct cocone_repair_trial {
    uint32_t cell[COCONE_REPAIR_TRIAL_CELLS]; /* to be flipped, all of them */
    size_t count;                             /* 0: it takes more than there is room for */
    int defects;                              /* how many more there are then, at all vertices of the cells */
    int lost;                                 /* how many more of them are lost */
    int euler;                                /* how much larger V - E + F is then; a shell is 2, a handle -2 */
    int64_t cost;                             /* what that adds to the cost of the labelling */
};

/* Borrows all, inside as well, which it changes.  *repair is the caller's, to be given to cocone_repair_free.
 * STATUS_NO_MEMORY. */
enum status cocone_repair_new(const struct cocone_star *star, const struct cocone_cost *cost, uint8_t *inside,
                              struct cocone_repair **repair) MUST_CHECK;

/* Accepts NULL. */
void cocone_repair_free(struct cocone_repair *repair);

/* Whether there is time for more trials: all of them together may take about as long as a reconstruction. */
bool cocone_repair_may_try(const struct cocone_repair *repair);

/* Flips the seeds (at least one, finite, all of one label), which are held from then on, and mends what gets defects by
 * that: by flipping cells of that label as far as possible, then others too.  Tells what came out, and puts everything
 * back.  Microseconds in easy cases, a millisecond at most. */
void cocone_repair_try(struct cocone_repair *repair, const uint32_t *seed, size_t count,
                       struct cocone_repair_trial *trial);

/* To be told when somebody else has flipped a trial's cells. */
void cocone_repair_forget(struct cocone_repair *repair, const struct cocone_repair_trial *trial);

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
