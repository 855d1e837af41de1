/* Telling holes of the scan from long triangles.
 *
 * After simplification the length of a triangle says little: flat parts of the surface have long ones, and narrow holes
 * are bridged by triangles no longer than those around.  The original points know.  Each has a foot, the point of the
 * mesh that is nearest to it.  Feet lie on what was scanned as densely as the points do, however coarse the mesh is and
 * however far it bends away from them; where a hole is spanned there are none.
 *
 *        . . . . .                . . . .          gap of a place = its distance to the nearest foot
 *       +---------+--------------+-------+                         / spacing of that foot's point
 *        feet        none: hole    feet
 *
 * Only the corners around a place and feet on triangles that face the same way count: both sides of a thin part, or a
 * shallow bowl and its lid, may be nearer to each other than their points are.
 *
 * An edge is bare if the gap in its middle is wider than usual in the mesh.  Triangles are of one group with those
 * across their bare edges, and with what is outside where the mesh ends at one.  A group is a hole if it comes to a gap
 * of WIDE times the usual, or to the outside: so the border of a hole runs along edges with points beside them, and
 * neither a chance void between points nor uneven scanning makes a hole.  Usual is what nine tenths of the edges don't
 * exceed; but twice the median where more of them span holes, as where one side of a flat sheet is a lid; and no less
 * than EVEN, since between the points of an even grid many edges have a foot right in their middle, and no place has a
 * wider gap.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/holes.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/spatial/bvh.h"
#include "core/spatial/knn.h"

enum { NEAREST = 8, CHUNK = 4096 };
static const double WIDE = 3, USUAL = 0.9, OF_MEDIAN = 2, EVEN = 0.6;
static const float ENDLESS = 1e6F;

struct search {
    const struct mesh *mesh;
    const struct halfedge *he;
    const struct reconstruct_dense *dense;
    size_t sites;
    unsigned threads;
    vec3 *foot;         /* of each original point */
    uint32_t *standing; /* the triangle that its foot is on */
    struct knn *feet;
    float *spacing;  /* of each site's own point; 0 = not known */
    size_t count;    /* places: middles of edges, then of triangles */
    uint32_t *place; /* the smaller of the edge's half-edges, or 3 * triangle_count + the triangle */
    float *gap;      /* of each place */
    uint8_t *hole;
};

/* Some places, and the feet near them. */
struct chunk {
    vec3 middle[CHUNK];
    uint32_t id[CHUNK * NEAREST];
    double distance_sq[CHUNK * NEAREST];
};

/* ------------------------------------------------------------------------------------------------ feet */

static void stand(struct search *s, size_t x, const struct bvh_hit *hit) {
    s->foot[x] = hit->point;
    s->standing[x] = hit->triangle;
    for (int k = 0; k < 3; k++) {
        uint32_t v = s->mesh->triangle[hit->triangle][k];
        if (vec3_distance(s->dense->point[x], s->mesh->vertex[v]) == 0)
            s->spacing[s->mesh->source[v]] = s->dense->spacing[x];
    }
}

static enum status find_feet(struct search *s) {
    struct bvh *bvh = NULL;
    struct bvh_hit *hit = alloc_array(CHUNK, sizeof *hit);
    enum status status = hit ? bvh_new(s->mesh, s->threads, &bvh) : STATUS_NO_MEMORY;
    for (size_t begin = 0; !status && begin < s->dense->n; begin += CHUNK) {
        size_t count = s->dense->n - begin < CHUNK ? s->dense->n - begin : CHUNK;
        bvh_closest_all(bvh, &s->dense->point[begin], count, s->threads, hit);
        for (size_t i = 0; i < count; i++) stand(s, begin + i, &hit[i]);
    }
    bvh_free(bvh);
    free(hit);
    return status ? status : knn_new(s->foot, s->dense->n, s->threads, &s->feet, NULL);
}

static vec3 normal_of(const struct mesh *mesh, uint32_t t) { return vec3_unit(mesh_triangle_normal(mesh, t)); }

/* ------------------------------------------------------------------------------------------------ gaps */

static void list_places(struct search *s) {
    uint32_t triangles = (uint32_t)s->mesh->triangle_count;
    for (uint32_t e = 0; e < 3 * triangles; e++)
        if (e < s->he->twin[e]) s->place[s->count++] = e; /* NONE is the largest */
    for (uint32_t t = 0; t < triangles; t++) s->place[s->count++] = 3 * triangles + t;
}

/* The half-edges out of the corners around a place; how many. */
static uint32_t corners_of(const struct search *s, uint32_t place, uint32_t corner[3]) {
    uint32_t half_edges = 3 * (uint32_t)s->mesh->triangle_count, first = place;
    if (place >= half_edges) first = 3 * (place - half_edges);
    for (uint32_t k = 0, h = first; k < 3; k++, h = halfedge_next(h)) corner[k] = h;
    return place < half_edges ? 2 : 3;
}

static vec3 middle_of(const struct search *s, uint32_t place) {
    uint32_t corner[3], count = corners_of(s, place, corner);
    vec3 sum = {0, 0, 0};
    for (uint32_t k = 0; k < count; k++) sum = vec3_add(sum, s->mesh->vertex[halfedge_from(s->he, corner[k])]);
    return vec3_scale(sum, 1.0 / count);
}

static vec3 direction_of(const struct search *s, uint32_t place) {
    uint32_t corner[3], count = corners_of(s, place, corner);
    vec3 normal = normal_of(s->mesh, corner[0] / 3);
    uint32_t twin = count == 2 ? s->he->twin[place] : NONE;
    return twin == NONE ? normal : vec3_add(normal, normal_of(s->mesh, twin / 3));
}

static float gap_to(double distance, float spacing) {
    return spacing > 0 ? fminf((float)distance / spacing, ENDLESS) : ENDLESS;
}

static float gap_of(const struct search *s, uint32_t place, vec3 middle, const uint32_t *id,
                    const double *distance_sq) {
    uint32_t corner[3], count = corners_of(s, place, corner);
    vec3 direction = direction_of(s, place);
    float gap = ENDLESS;
    for (uint32_t k = 0; k < count; k++) {
        uint32_t v = halfedge_from(s->he, corner[k]);
        gap = fminf(gap, gap_to(vec3_distance(middle, s->mesh->vertex[v]), s->spacing[s->mesh->source[v]]));
    }
    for (int i = 0; i < NEAREST && id[i] != NONE; i++)
        if (vec3_dot(direction, normal_of(s->mesh, s->standing[id[i]])) > 0)
            return fminf(gap, gap_to(sqrt(distance_sq[i]), s->dense->spacing[id[i]]));
    return gap;
}

static enum status find_gaps(struct search *s) {
    struct chunk *chunk = alloc_array(1, sizeof *chunk);
    enum status status = chunk ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t begin = 0; !status && begin < s->count; begin += CHUNK) {
        size_t count = s->count - begin < CHUNK ? s->count - begin : CHUNK;
        for (size_t i = 0; i < count; i++) chunk->middle[i] = middle_of(s, s->place[begin + i]);
        status = knn_search(s->feet, chunk->middle, count, NEAREST, s->threads, chunk->id, chunk->distance_sq);
        for (size_t i = 0; !status && i < count; i++)
            s->gap[begin + i] = gap_of(s, s->place[begin + i], chunk->middle[i], &chunk->id[i * NEAREST],
                                       &chunk->distance_sq[i * NEAREST]);
    }
    free(chunk);
    return status;
}

/* What the middles of edges usually have. */
static enum status find_usual(const struct search *s, double *usual) {
    size_t edges = s->count - s->mesh->triangle_count;
    float *gap = alloc_array(edges, sizeof *gap);
    if (!gap) return STATUS_NO_MEMORY;
    memcpy(gap, s->gap, edges * sizeof *gap);
    double most = (double)quantile_of(gap, edges, USUAL), median = (double)quantile_of(gap, edges, 0.5);
    *usual = fmax(fmin(most, OF_MEDIAN * median), EVEN);
    free(gap);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ groups */

/* The widest gap of each group, at its root.  The outside is a member after all triangles. */
static void join_groups(const struct search *s, double usual, uint32_t *group, float *widest) {
    size_t triangles = s->mesh->triangle_count, edges = s->count - triangles;
    memcpy(widest, &s->gap[edges], triangles * sizeof *widest);
    widest[triangles] = ENDLESS;
    for (size_t i = 0; i < edges; i++) {
        if ((double)s->gap[i] <= usual) continue;
        uint32_t twin = s->he->twin[s->place[i]], other = twin == NONE ? (uint32_t)triangles : twin / 3;
        uint32_t a = disjoint_set_root(group, s->place[i] / 3), b = disjoint_set_root(group, other);
        float gap = fmaxf(s->gap[i], fmaxf(widest[a], widest[b]));
        disjoint_set_unite(group, a, b);
        widest[disjoint_set_root(group, a)] = gap;
    }
}

/* Points whose triangles would all be holes' keep the one with the smallest gap. */
static enum status keep_points(const struct search *s) {
    const float *gap = &s->gap[s->count - s->mesh->triangle_count];
    uint32_t *best = alloc_array(s->sites, sizeof *best);
    uint8_t *kept = alloc_zeroed(s->sites, 1);
    enum status status = best && kept ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < s->sites; i++) best[i] = NONE;
    for (uint32_t c = 0; !status && c < 3 * s->mesh->triangle_count; c++) {
        uint32_t site = s->mesh->source[halfedge_from(s->he, c)], t = c / 3;
        kept[site] |= !s->hole[t];
        if (best[site] == NONE || gap[t] < gap[best[site]]) best[site] = t;
    }
    for (size_t i = 0; !status && i < s->sites; i++)
        if (best[i] != NONE && !kept[i]) s->hole[best[i]] = 0;
    free(best), free(kept);
    return status;
}

static enum status choose(const struct search *s) {
    size_t triangles = s->mesh->triangle_count;
    double usual = 0;
    uint32_t *group = disjoint_set_new(triangles + 1);
    float *widest = alloc_array(triangles + 1, sizeof *widest);
    enum status status = group && widest ? find_usual(s, &usual) : STATUS_NO_MEMORY;
    if (!status) join_groups(s, usual, group, widest);
    for (uint32_t t = 0; !status && t < triangles; t++)
        s->hole[t] = (double)widest[disjoint_set_root(group, t)] >= WIDE * usual;
    free(group), free(widest);
    return status ? status : keep_points(s);
}

enum status cocone_holes_find(const struct mesh *mesh, const struct halfedge *he, const struct reconstruct_dense *dense,
                              size_t sites, unsigned threads, uint8_t *hole) {
    struct search s = {.mesh = mesh, .he = he, .dense = dense, .sites = sites, .threads = threads, .hole = hole};
    s.foot = alloc_array(dense->n, sizeof *s.foot);
    s.standing = alloc_array(dense->n, sizeof *s.standing);
    s.spacing = alloc_zeroed(sites, sizeof *s.spacing);
    s.place = alloc_array(4 * mesh->triangle_count, sizeof *s.place);
    s.gap = alloc_array(4 * mesh->triangle_count, sizeof *s.gap);
    enum status status = s.foot && s.standing && s.spacing && s.place && s.gap ? find_feet(&s) : STATUS_NO_MEMORY;
    if (!status) {
        list_places(&s);
        status = find_gaps(&s);
    }
    if (!status) status = choose(&s);
    knn_free(s.feet);
    free(s.foot), free(s.standing), free(s.spacing), free(s.place), free(s.gap);
    return status;
}
