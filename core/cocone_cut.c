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
#include "core/cocone_cut.h"

#include <stdlib.h>

#include "core/alloc.h"
#include "core/mincut.h"
#include "core/par.h"

enum { GRAIN = 2048 };

#define SUPPORT_FACTOR 1.2     /* kappa */
#define PRICE_ANY 0.1          /* of each facet */
#define PRICE_TURNED 0.4       /* for each vertex, times 1 - cosine between its normal and the facet's */
#define PRICE_UNSUPPORTED 12.0 /* for each edge, times its excess over the supported length */
#define EXCESS_MOST 4.0
#define VOTE_CELL 1.0 /* of a cell that is certain to a point */
#define VOTE_POLE 2.0 /* of each pole of a point */
#define OUTSIDE 1e6   /* of the infinite cells */

struct job {
    const struct cocone_star *star;
    const struct cocone_frame *frame;
    const struct cocone_lies *lies;
    const double *support;
    struct cocone_cost *cost;
    uint32_t (*pole)[2]; /* n: cells of the outer and the inner pole of each point; NONE = none */
};

static int32_t units(double cost) { return (int32_t)(cost * COCONE_CUT_UNIT); }

/* How many times the supported length the edge is. */
static double stretch(const vec3 *point, const double *support, uint32_t a, uint32_t b) {
    if (!support) return 0;
    double most = SUPPORT_FACTOR * (support[a] + support[b]), length = vec3_distance(point[a], point[b]);
    return length <= most ? 0 : most > 0 ? length / most : INFINITY;
}

bool cocone_cut_supported(const vec3 *point, const double *support, const uint32_t facet[3]) {
    for (int k = 0; k < 3; k++)
        if (stretch(point, support, facet[k], facet[(k + 1) % 3]) > 1) return false;
    return true;
}

/* What the facet costs from either side. */
static double facet_price(const struct job *job, const uint32_t v[3]) {
    double price = PRICE_ANY;
    for (int k = 0; k < 3; k++) {
        double excess = stretch(job->star->point, job->support, v[k], v[(k + 1) % 3]) - 1;
        if (excess > 0) price += PRICE_UNSUPPORTED * fmin(excess, EXCESS_MOST);
    }
    return price;
}

/* The sum of the cosines between the facet's normal, into the cell of the half facet, and those of its vertices. */
static double agreement(const struct job *job, const uint32_t v[3]) {
    const vec3 *point = job->star->point, *normal = job->frame->normal;
    vec3 facet_normal = vec3_unit(vec3_triangle_normal(point[v[0]], point[v[1]], point[v[2]]));
    return vec3_dot(facet_normal, vec3_add(vec3_add(normal[v[0]], normal[v[1]]), normal[v[2]]));
}

/* Facets are priced by the cell with the smaller id; those between infinite cells are never cut. */
static void price_range(void *ctx, size_t begin, size_t end) {
    const struct job *job = ctx;
    const struct tets *tets = job->star->tets;
    for (uint32_t c = (uint32_t)begin; c < end; c++) {
        for (unsigned i = 0; i < 4; i++) {
            uint32_t half = cocone_star_pack(c, i), twin = cocone_star_twin(job->star, half), v[3];
            int32_t *price = &job->cost->price[c][i];
            int32_t *other = &job->cost->price[cocone_star_cell(twin)][cocone_star_index(twin)];
            if (cocone_star_cell(twin) < c) continue;
            *price = *other = 0;
            if (c >= tets->finite_count) continue;
            cocone_star_vertices(job->star, half, v);
            double both = facet_price(job, v), turn = PRICE_TURNED * agreement(job, v);
            *price = units(both + 3 * PRICE_TURNED - turn);
            *other = units(both + 3 * PRICE_TURNED + turn);
        }
    }
}

/* The cells of the farthest Voronoi vertices on either side; an infinite cell is farther than any. */
static void find_poles(const struct job *job, uint32_t v, uint32_t pole[2]) {
    const struct cocone_star *star = job->star;
    double farthest[2] = {0, 0};
    pole[0] = pole[1] = UINT32_MAX;
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
        uint32_t cell = cocone_star_cell(star->corner[i]);
        double height = vec3_dot(cocone_star_dual(star, cell, v), job->frame->normal[v]);
        int side = height < 0;
        double distance = cocone_star_is_finite(star, cell) ? fabs(height) : height > 0 ? INFINITY : 0;
        if (distance > farthest[side]) farthest[side] = distance, pole[side] = cell;
    }
}

static void pole_range(void *ctx, size_t begin, size_t end) {
    const struct job *job = ctx;
    for (uint32_t v = (uint32_t)begin; v < end; v++) find_poles(job, v, job->pole[v]);
}

static void vote_range(void *ctx, size_t begin, size_t end) {
    const struct job *job = ctx;
    for (uint32_t c = (uint32_t)begin; c < end; c++) {
        double vote = 0;
        for (int i = 0; i < 4; i++) {
            uint32_t v = job->star->tets->vertex[c][i];
            vote += VOTE_CELL * (double)job->lies->lie[c][i];
            if (job->pole[v][0] == c) vote += VOTE_POLE;
            if (job->pole[v][1] == c) vote -= VOTE_POLE;
        }
        job->cost->vote[c] = units(vote);
    }
}

enum status cocone_cut_costs(const struct cocone_star *star, const struct cocone_frame *frame,
                             const struct cocone_lies *lies, const double *support, unsigned threads,
                             struct cocone_cost *out) {
    const struct tets *tets = star->tets;
    struct cocone_cost cost = {alloc_array(tets->cell_count, sizeof *cost.price),
                               alloc_array(tets->cell_count, sizeof *cost.vote)};
    struct job job = {star, frame, lies, support, &cost, alloc_array(star->n, sizeof *job.pole)};
    if (!cost.price || !cost.vote || !job.pole) {
        free(job.pole);
        cocone_cut_done(&cost);
        return STATUS_NO_MEMORY;
    }
    par_for(threads, tets->cell_count, GRAIN, price_range, &job);
    par_for(threads, star->n, GRAIN, pole_range, &job);
    par_for(threads, tets->finite_count, GRAIN, vote_range, &job);
    for (size_t c = tets->finite_count; c < tets->cell_count; c++) cost.vote[c] = units(OUTSIDE);
    free(job.pole);
    *out = cost;
    return STATUS_OK;
}

void cocone_cut_done(struct cocone_cost *cost) {
    free(cost->price);
    free(cost->vote);
    *cost = (struct cocone_cost){0};
}

enum status cocone_cut_label(const struct cocone_star *star, const struct cocone_cost *cost,
                             const struct progress *progress, uint8_t *inside) {
    const struct tets *tets = star->tets;
    int32_t(*capacity)[4] = alloc_array(tets->cell_count, sizeof *capacity);
    int32_t *terminal = alloc_array(tets->cell_count, sizeof *terminal);
    enum status status = STATUS_NO_MEMORY;
    if (!capacity || !terminal) goto out;
    for (size_t c = 0; c < tets->cell_count; c++) {
        for (int i = 0; i < 4; i++) capacity[c][i] = cost->price[c][i];
        terminal[c] = cost->vote[c];
    }
    struct mincut graph = {tets->cell_count, (const uint32_t(*)[4])tets->neighbour, (const uint8_t(*)[4])star->mirror,
                           capacity, terminal};
    status = mincut_solve(&graph, "cocone", progress, inside);
    for (size_t c = 0; c < tets->cell_count && !status; c++) inside[c] = !inside[c];
out:
    free(capacity), free(terminal);
    return status;
}
