/* A labelling of tetrahedra makes a surface of their facets, and which of two diagonals a facet has is as the ball that
 * is empty in space happens to be.  A surface that was tessellated has other habits:
 *
 *          c
 *        /   \           its triangles' angles across from an edge are not wide, as measured in the triangles
 *       a ---- b         themselves, whatever the fold between them; it bends little, where it bends at all along its
 *        \   /           edges; and about six edges meet at a vertex.
 *          d
 *
 * None of these holds everywhere.  Each is evidence for one of the diagonals, and together they decide.
 *
 * What wasn't tessellated has none of these habits.  But where a gap is much wider than points are apart there is no
 * other evidence of how the surface goes, and what bends little is likelier there in any case.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/likely_edges.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"

enum { ROUNDS_MOST = 12 };

/* Logarithms of the odds (DECISIONS.md): for each radian of the angles across from the edge over those across from the
 * other diagonal; for each that the surface turns more by, along as much as the rim is long; for each edge that
 * vertices have too many; and for staying. */
static const double OF_ANGLES = 1.77, OF_BENDS = 3.45, OF_EDGES = 0.12, OF_STAYING = 0.41;
static const double MOST_BENDS = 0.2, MOST_EDGES = 6; /* that count */

static const double GAP = 3; /* times as far apart as points are */

struct likely {
    struct mesh *mesh;
    struct halfedge he;
    uint32_t *edges;  /* of each vertex */
    uint8_t *touched; /* of each triangle: it has changed in this round or the one before */
    /* By source; NULL: all edges may be flipped, else those alone that are over gap times as long at both ends. */
    const float *spacing;
    double gap;
};

/* Two triangles that share an edge, what they become, and those around. */
struct pair {
    uint32_t a, b, c, d;
    vec3 now[2], then[2]; /* unit normals */
    uint32_t rim[4];      /* half-edges b c, c a, a d, d b */
};

static vec3 unit_normal(const struct likely *l, uint32_t a, uint32_t b, uint32_t c) {
    const vec3 *vertex = l->mesh->vertex;
    return vec3_unit(vec3_triangle_normal(vertex[a], vertex[b], vertex[c]));
}

static double angle_between(vec3 a, vec3 b) { return acos(fmax(-1, fmin(1, vec3_dot(a, b)))); }

static double corner_angle(const struct likely *l, uint32_t at, uint32_t a, uint32_t b) {
    const vec3 *vertex = l->mesh->vertex;
    return angle_between(vec3_unit(vec3_sub(vertex[a], vertex[at])), vec3_unit(vec3_sub(vertex[b], vertex[at])));
}

static double edge_length(const struct likely *l, uint32_t h) {
    return vec3_distance(l->mesh->vertex[halfedge_from(&l->he, h)], l->mesh->vertex[halfedge_to(&l->he, h)]);
}

static vec3 normal_across(const struct likely *l, uint32_t h, vec3 otherwise) {
    uint32_t twin = l->he.twin[h];
    if (twin == NONE) return otherwise;
    const uint32_t *corner = l->mesh->triangle[twin / 3];
    return unit_normal(l, corner[0], corner[1], corner[2]);
}

static double angles_for(const struct likely *l, const struct pair *p) {
    return corner_angle(l, p->c, p->a, p->b) + corner_angle(l, p->d, p->a, p->b) - corner_angle(l, p->a, p->c, p->d) -
           corner_angle(l, p->b, p->c, p->d);
}

/* How much less the surface turns across the five edges, by the length of the four. */
static double bends_for(const struct likely *l, const struct pair *p) {
    const vec3 *vertex = l->mesh->vertex;
    const vec3 *now[4] = {&p->now[0], &p->now[0], &p->now[1], &p->now[1]};
    const vec3 *then[4] = {&p->then[1], &p->then[0], &p->then[0], &p->then[1]};
    double less = angle_between(p->now[0], p->now[1]) * vec3_distance(vertex[p->a], vertex[p->b]) -
                  angle_between(p->then[0], p->then[1]) * vec3_distance(vertex[p->c], vertex[p->d]);
    double around = 0;
    for (int k = 0; k < 4; k++) {
        double length = edge_length(l, p->rim[k]);
        vec3 across = normal_across(l, p->rim[k], *now[k]);
        less += length * (angle_between(across, *now[k]) - angle_between(across, *then[k]));
        around += length;
    }
    return fmax(-MOST_BENDS, fmin(MOST_BENDS, less / around));
}

/* Half of what the squares of edges too many or too few get less by. */
static double edges_for(const struct likely *l, const struct pair *p) {
    double sum = (double)l->edges[p->a] + (double)l->edges[p->b] - (double)l->edges[p->c] - (double)l->edges[p->d] - 2;
    return fmax(-MOST_EDGES, fmin(MOST_EDGES, sum));
}

static bool pair_of(const struct likely *l, uint32_t h, struct pair *p) {
    uint32_t g = l->he.twin[h];
    *p = (struct pair){.a = halfedge_from(&l->he, h),
                       .b = halfedge_to(&l->he, h),
                       .c = halfedge_apex(&l->he, h),
                       .d = halfedge_apex(&l->he, g)};
    const uint8_t *locked = l->he.locked;
    if (p->c == p->d || locked[p->a] || locked[p->b] || locked[p->c] || locked[p->d]) return false;
    p->now[0] = unit_normal(l, p->a, p->b, p->c), p->now[1] = unit_normal(l, p->b, p->a, p->d);
    p->then[0] = unit_normal(l, p->a, p->d, p->c), p->then[1] = unit_normal(l, p->d, p->b, p->c);
    p->rim[0] = halfedge_next(h), p->rim[1] = halfedge_prev(h);
    p->rim[2] = halfedge_next(g), p->rim[3] = halfedge_prev(g);
    return true;
}

static bool is_across_gap(const struct likely *l, uint32_t a, uint32_t b) {
    uint32_t from = l->mesh->source[a], to = l->mesh->source[b];
    if (from == NONE || to == NONE) return false;
    double apart = fmax((double)l->spacing[from], (double)l->spacing[to]);
    return vec3_distance(l->mesh->vertex[a], l->mesh->vertex[b]) > l->gap * apart;
}

/* Whether the edge of h is rather the other diagonal. */
static bool is_unlikely(const struct likely *l, uint32_t h) {
    struct pair p;
    if (!pair_of(l, h, &p)) return false;
    if (l->spacing && !(is_across_gap(l, p.a, p.b) && is_across_gap(l, p.c, p.d))) return false;
    double odds = OF_ANGLES * angles_for(l, &p) + OF_EDGES * edges_for(l, &p) - OF_STAYING;
    if (odds <= -OF_BENDS * MOST_BENDS) return false;
    odds += OF_BENDS * bends_for(l, &p);
    return odds > 0 && !halfedge_joined(&l->he, p.c, p.d);
}

static void take_other_diagonal(struct likely *l, uint32_t h) {
    uint32_t t = h / 3, s = l->he.twin[h] / 3;
    l->edges[halfedge_from(&l->he, h)]--, l->edges[halfedge_to(&l->he, h)]--;
    l->edges[halfedge_apex(&l->he, h)]++, l->edges[halfedge_apex(&l->he, l->he.twin[h])]++;
    halfedge_flip(&l->he, h);
    l->touched[t] = l->touched[s] = 2;
    uint8_t *tag = l->mesh->tag;
    if (tag && (tag[t] == MESH_SUPPORTED || tag[s] == MESH_SUPPORTED)) tag[t] = tag[s] = MESH_SUPPORTED;
}

/* Whether the two triangles, or one beside them, have changed since the edge was looked at. */
static bool edge_is_due(const struct likely *l, uint32_t h) {
    uint32_t of[2] = {h / 3, l->he.twin[h] / 3};
    for (int i = 0; i < 2; i++) {
        if (l->touched[of[i]]) return true;
        for (uint32_t k = 3 * of[i]; k < 3 * of[i] + 3; k++)
            if (l->he.twin[k] != NONE && l->touched[l->he.twin[k] / 3]) return true;
    }
    return false;
}

static size_t flip_unlikely(struct likely *l) {
    size_t flips = 0, made = 1;
    memset(l->touched, 1, l->mesh->triangle_count);
    for (int i = 0; i < ROUNDS_MOST && made; i++) {
        made = 0;
        for (uint32_t h = 0; h < 3 * l->mesh->triangle_count; h++) {
            if (l->he.twin[h] == NONE || h > l->he.twin[h] || !edge_is_due(l, h) || !is_unlikely(l, h)) continue;
            take_other_diagonal(l, h);
            made++;
        }
        for (size_t t = 0; t < l->mesh->triangle_count; t++) l->touched[t] = l->touched[t] == 2;
        flips += made;
    }
    return flips;
}

/* How irregular a surface is: the mean square of what vertices have more or less than six edges, and how much it turns
 * across its edges, by length. */
struct irregularity {
    double edges, turn;
};

static struct irregularity find_irregularity(const struct likely *l) {
    struct irregularity found = {0};
    double length = 0, vertices = 0;
    for (size_t v = 0; v < l->mesh->vertex_count; v++) {
        double more = (double)l->edges[v] - 6;
        if (l->edges[v]) found.edges += more * more, vertices++;
    }
    for (uint32_t h = 0; h < 3 * l->mesh->triangle_count; h++) {
        struct pair p;
        if (l->he.twin[h] == NONE || h > l->he.twin[h] || !pair_of(l, h, &p)) continue;
        found.turn += edge_length(l, h) * angle_between(p.now[0], p.now[1]);
        length += edge_length(l, h);
    }
    if (vertices > 0) found.edges /= vertices;
    if (length > 0) found.turn /= length;
    return found;
}

/* Points of a scan are corners of nothing, and no diagonals but the smoothest are theirs.  Flips make what was
 * tessellated far more regular, or hardly rougher; scans neither. */
static bool was_tessellated(const struct irregularity *before, const struct irregularity *after) {
    static const double FAR_MORE = 0.6, HARDLY = 1.02;
    return after->edges <= FAR_MORE * before->edges || after->turn <= HARDLY * before->turn;
}

static enum status likely_init(struct likely *l, struct mesh *mesh) {
    l->mesh = mesh;
    l->touched = alloc_array(mesh->triangle_count, 1);
    l->edges = alloc_zeroed(mesh->vertex_count, sizeof *l->edges);
    enum status status = l->touched && l->edges ? halfedge_init(&l->he, mesh, 1) : STATUS_NO_MEMORY;
    if (status) return status;
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++) l->edges[mesh->triangle[t][k]]++;
    return STATUS_OK;
}

static void likely_done(struct likely *l) {
    halfedge_done(&l->he);
    free(l->touched), free(l->edges);
}

enum status take_likely_edges(struct mesh *mesh, size_t *flips) {
    struct mesh taken = {0};
    struct likely l = {0};

    enum status status = mesh_copy(&taken, mesh);
    if (!status) status = likely_init(&l, &taken);
    if (!status) {
        const struct irregularity before = find_irregularity(&l);
        size_t made = flip_unlikely(&l);
        const struct irregularity after = find_irregularity(&l);
        bool is_taken = was_tessellated(&before, &after);
        struct mesh plain = *mesh;
        if (is_taken) *mesh = taken, taken = plain;
        if (flips) *flips = is_taken ? made : 0;
    }
    likely_done(&l);
    mesh_done(&taken);
    return status;
}

enum status take_likely_edges_across_gaps(struct mesh *mesh, const float *spacing, double share, size_t *flips) {
    struct likely l = {.spacing = spacing, .gap = GAP / sqrt(share)};
    enum status status = likely_init(&l, mesh);
    size_t made = status ? 0 : flip_unlikely(&l);
    if (!status && flips) *flips = made;
    likely_done(&l);
    return status;
}
