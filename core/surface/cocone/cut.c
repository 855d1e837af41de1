/* The labelling of cells as a minimum cut.
 *
 * Tight Cocone marks the cells around the points whose umbrella is good and peels the others off one by one; a wrong
 * mark or a leak spoils everything after it.  Here every point votes instead, and the labels that agree best with all
 * votes, at the least price of the surface between, are found at once.
 *
 * Votes.  A cell that stands over a point, on the outer side of its normal, is out for that point, and in below; the
 * certainty is that of orientation.  The two poles of a point, the farthest Voronoi vertices on both sides, have votes
 * of their own: with the outer one out and the inner one in, the point is on the surface.
 *
 * Prices.  A facet is cheap when it agrees with the normals of its vertices, the right way round, and when its edges
 * are supported: points that were merged into its ends are near enough for it to be surface.  Agreement with the
 * normals takes the place of the test whether the dual edge meets the cocones: with dense normals it chooses better
 * triangles.
 *
 * Sources: T. K. Dey, S. Goswami, Tight Cocone (2003), for the cocone and the labels.  P. Labatut, J.-P. Pons, R.
 * Keriven, Robust and efficient surface reconstruction from range data (2009), for the cut over Delaunay cells.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/surface/mincut.h"

enum { GRAIN = 2048 };

#define SUPPORT_FACTOR 1.2     /* kappa */
#define PRICE_ANY 0.1          /* of each facet */
#define PRICE_TURNED 0.4       /* for each vertex, times 1 - cosine between its normal and the facet's */
#define PRICE_UNSUPPORTED 12.0 /* for each edge, times its excess over the supported length */
#define EXCESS_MOST 4.0
#define VOTE_CELL 1.0 /* of a cell that is certain to a point */
#define VOTE_POLE 2.0 /* of each pole of a point */
#define OUTSIDE 1e6   /* of the infinite cells */
#define CLEARLY 0.999 /* rounding aside */

struct job {
    const struct cocone_voters *voters;
    struct cocone_cost *cost;
    int count;
};

struct cocone_cut {
    struct cocone_voters voters;
    struct mincut graph;
    struct mincut_search *search;
    uint8_t *listed; /* of each vertex: its votes are being changed */
};

static int32_t units(double cost) { return (int32_t)(cost * COCONE_CUT_UNIT); }

/* How many times the supported length the edge is.  Most edges are that short, which squares tell, too. */
static double stretch(const vec3 *point, const double *support, uint32_t a, uint32_t b) {
    if (!support) return 0;
    double most = SUPPORT_FACTOR * (support[a] + support[b]), length_sq = vec3_distance_sq(point[a], point[b]);
    if (length_sq < CLEARLY * most * most) return 0;
    double length = sqrt(length_sq);
    return length <= most ? 0 : most > 0 ? length / most : INFINITY;
}

bool cocone_cut_supported(const vec3 *point, const double *support, const uint32_t facet[3]) {
    for (int k = 0; k < 3; k++)
        if (stretch(point, support, facet[k], facet[(k + 1) % 3]) > 1) return false;
    return true;
}

/* What the facet costs from either side. */
static double facet_price(const struct cocone_voters *voters, const uint32_t v[3]) {
    double price = PRICE_ANY;
    for (int k = 0; k < 3; k++) {
        double excess = stretch(voters->star->point, voters->support, v[k], v[(k + 1) % 3]) - 1;
        if (excess > 0) price += PRICE_UNSUPPORTED * voters->gaps * (excess < EXCESS_MOST ? excess : EXCESS_MOST);
    }
    return price;
}

/* The prices of a half facet of a finite cell and of its twin, in each frame: they fall with the cosines between the
 * facet's normal, into the cell, and the normals of its vertices.  A vertex on a crease has those of the sheets, of
 * which the facet belongs to one; so what spans a crease askew to both is dear. */
static void find_prices(const struct cocone_voters *voters, uint32_t half, int count, int32_t price[][2]) {
    const vec3 *point = voters->star->point;
    uint32_t v[3];
    cocone_star_vertices(voters->star, half, v);
    double both = facet_price(voters, v) + 3 * PRICE_TURNED;
    vec3 facet_normal = vec3_unit(vec3_triangle_normal(point[v[0]], point[v[1]], point[v[2]]));
    for (int k = 0; k < count; k++) {
        double along = 0, against = 0;
        for (int i = 0; i < 3; i++) {
            struct cocone_cosines most =
                cocone_creases_cosines(voters->creases, v[i], voters->frame[k].normal[v[i]], facet_normal);
            along += most.along, against += most.against;
        }
        price[k][0] = units(both - PRICE_TURNED * along);
        price[k][1] = units(both - PRICE_TURNED * against);
    }
}

/* What the vertices of a finite cell say to it, in frame k. */
static int32_t find_vote(const struct cocone_voters *voters, int k, uint32_t cell) {
    const struct cocone_frame *frame = &voters->frame[k];
    double vote = 0;
    for (int i = 0; i < 4; i++) {
        uint32_t v = voters->star->tets->vertex[cell][i];
        vote += VOTE_CELL * (double)voters->lies[k].lie[cell][i];
        if (frame->pole[v][0] == cell && !(frame->hull[v] & 1)) vote += VOTE_POLE;
        if (frame->pole[v][1] == cell) vote -= VOTE_POLE;
    }
    return units(vote);
}

/* Facets are priced by the cell with the smaller id; those between infinite cells are never cut. */
static void price_facet(const struct job *job, uint32_t half) {
    const struct cocone_star *star = job->voters->star;
    uint32_t twin = cocone_star_twin(star, half), cell = cocone_star_cell(half), other = cocone_star_cell(twin);
    int32_t price[COCONE_FRAMES][2] = {{0}};
    if (other < cell) return;
    if (cocone_star_is_finite(star, cell)) find_prices(job->voters, half, job->count, price);
    for (int k = 0; k < job->count; k++) {
        job->cost[k].price[cell][cocone_star_index(half)] = price[k][0];
        job->cost[k].price[other][cocone_star_index(twin)] = price[k][1];
    }
}

static void cost_range(void *ctx, size_t begin, size_t end) {
    const struct job *job = ctx;
    for (uint32_t c = (uint32_t)begin; c < end; c++) {
        bool finite = cocone_star_is_finite(job->voters->star, c);
        for (unsigned i = 0; i < 4; i++) price_facet(job, cocone_star_pack(c, i));
        for (int k = 0; k < job->count; k++)
            job->cost[k].vote[c] = finite ? find_vote(job->voters, k, c) : units(OUTSIDE);
    }
}

enum status cocone_cut_costs(const struct cocone_voters *voters, int count, unsigned threads,
                             struct cocone_cost cost[]) {
    size_t cells = voters->star->tets->cell_count;
    for (int k = 0; k < count; k++) {
        cost[k].price = alloc_array(cells, sizeof *cost->price);
        cost[k].vote = alloc_array(cells, sizeof *cost->vote);
        if (!cost[k].price || !cost[k].vote) return STATUS_NO_MEMORY;
    }
    struct job job = {voters, cost, count};
    par_for(threads, cells, GRAIN, cost_range, &job);
    return STATUS_OK;
}

void cocone_cost_done(struct cocone_cost *cost) {
    free(cost->price), free(cost->vote);
    *cost = (struct cocone_cost){0};
}

/* ------------------------------------------------------------------------------------------------ the cut */

enum status cocone_cut_new(const struct cocone_voters *voters, struct cocone_cost *cost, struct cocone_cut **out) {
    const struct tets *tets = voters->star->tets;
    struct cocone_cut *cut = alloc_zeroed(1, sizeof *cut);
    if (!cut) return STATUS_NO_MEMORY;
    cut->voters = *voters;
    cut->graph = (struct mincut){tets->cell_count, (const uint32_t(*)[4])tets->neighbour,
                                 (const uint8_t(*)[4])voters->star->mirror, cost->price, cost->vote};
    cut->listed = alloc_zeroed(voters->star->n, 1);
    enum status status = cut->listed ? mincut_new(&cut->graph, &cut->search) : STATUS_NO_MEMORY;
    if (status)
        cocone_cut_free(cut);
    else
        *out = cut;
    return status;
}

void cocone_cut_free(struct cocone_cut *cut) {
    if (!cut) return;
    mincut_free(cut->search);
    free(cut->listed);
    free(cut);
}

enum status cocone_cut_label(struct cocone_cut *cut, const struct progress *progress, uint8_t *inside) {
    enum status status = mincut_flow(cut->search, "cocone", progress);
    for (uint32_t c = 0; c < cut->graph.node_count && !status; c++) inside[c] = !mincut_is_source(cut->search, c);
    return status;
}

/* Whether v is the first of the cell's vertices that are listed, so that each cell has its turn once. */
static bool is_first_listed(const struct cocone_cut *cut, uint32_t cell, uint32_t v) {
    const uint32_t *vertex = cut->voters.star->tets->vertex[cell];
    int i = 0;
    while (!cut->listed[vertex[i]]) i++;
    return vertex[i] == v;
}

static bool has_listed(const struct cocone_cut *cut, uint32_t half) {
    uint32_t v[3];
    cocone_star_vertices(cut->voters.star, half, v);
    return cut->listed[v[0]] || cut->listed[v[1]] || cut->listed[v[2]];
}

/* Puts what the facet costs in, by = 1, or takes it out. */
static void change_facet(struct cocone_cut *cut, uint32_t half, int by) {
    uint32_t twin = cocone_star_twin(cut->voters.star, half);
    int32_t price[1][2];
    find_prices(&cut->voters, half, 1, price);
    mincut_add_arc(cut->search, cocone_star_cell(half), cocone_star_index(half), by * price[0][0]);
    mincut_add_arc(cut->search, cocone_star_cell(twin), cocone_star_index(twin), by * price[0][1]);
}

/* The cell's vote, and the facets that it prices. */
static void change_cell(struct cocone_cut *cut, uint32_t cell, int by) {
    const struct cocone_star *star = cut->voters.star;
    mincut_add_terminal(cut->search, cell, by * find_vote(&cut->voters, 0, cell));
    for (unsigned i = 0; i < 4; i++) {
        uint32_t half = cocone_star_pack(cell, i);
        if (cocone_star_cell(cocone_star_twin(star, half)) >= cell && has_listed(cut, half))
            change_facet(cut, half, by);
    }
}

void cocone_cut_change(struct cocone_cut *cut, const uint32_t *vertex, size_t count, int by) {
    const struct cocone_star *star = cut->voters.star;
    for (size_t i = 0; i < count; i++) cut->listed[vertex[i]] = 1;
    for (size_t i = 0; i < count; i++) {
        for (uint32_t k = star->begin[vertex[i]]; k < star->begin[vertex[i] + 1]; k++) {
            uint32_t cell = cocone_star_cell(star->corner[k]);
            if (cocone_star_is_finite(star, cell) && is_first_listed(cut, cell, vertex[i])) change_cell(cut, cell, by);
        }
    }
    for (size_t i = 0; i < count; i++) cut->listed[vertex[i]] = 0;
}

/* Of the facets that a cell prices, those that span gaps. */
static void change_gaps(struct cocone_cut *cut, uint32_t cell, int by) {
    const struct cocone_star *star = cut->voters.star;
    for (unsigned i = 0; i < 4 && cocone_star_is_finite(star, cell); i++) {
        uint32_t half = cocone_star_pack(cell, i), v[3];
        cocone_star_vertices(star, half, v);
        if (cocone_star_cell(cocone_star_twin(star, half)) >= cell &&
            !cocone_cut_supported(star->point, cut->voters.support, v))
            change_facet(cut, half, by);
    }
}

void cocone_cut_span_gaps(struct cocone_cut *cut, double gaps) {
    double before = cut->voters.gaps;
    for (uint32_t c = 0; c < cut->voters.star->tets->cell_count; c++) {
        cut->voters.gaps = before, change_gaps(cut, c, -1);
        cut->voters.gaps = gaps, change_gaps(cut, c, 1);
    }
}
