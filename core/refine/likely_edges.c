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
 * Angles are no evidence along a crease whose points are farther apart than those across it, nor where fine parts end
 * at coarse ones: the likely diagonals are teeth and spikes there.  Once the others are right, what bends is weighed
 * more.
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
 * other diagonal; for each that the surface turns more by, along as much as the rim is long, which counts up to most;
 * for each edge that vertices have too many; and for staying. */
struct odds {
    double of_angles, of_bends, most_bends, of_edges, of_staying;
};
static const struct odds USUAL = {1.77, 3.45, 0.2, 0.12, 0.41}, SMOOTH = {1, 8, 1, 0.12, 0.7};
static const double MOST_EDGES = 6; /* that count */

static const double GAP = 3; /* times as far apart as points are */

struct likely {
    struct mesh *mesh;
    struct halfedge he;
    const struct odds *odds;
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

/* How much less the surface turns across the five edges, by the length of the four; *turns, unless it is NULL: how much
 * it turns now. */
static double bends_for(const struct likely *l, const struct pair *p, double *turns) {
    const vec3 *vertex = l->mesh->vertex;
    const vec3 *now[4] = {&p->now[0], &p->now[0], &p->now[1], &p->now[1]};
    const vec3 *then[4] = {&p->then[1], &p->then[0], &p->then[0], &p->then[1]};
    double turn = angle_between(p->now[0], p->now[1]) * vec3_distance(vertex[p->a], vertex[p->b]);
    double other = angle_between(p->then[0], p->then[1]) * vec3_distance(vertex[p->c], vertex[p->d]), around = 0;
    for (int k = 0; k < 4; k++) {
        double length = edge_length(l, p->rim[k]);
        vec3 across = normal_across(l, p->rim[k], *now[k]);
        turn += length * angle_between(across, *now[k]), other += length * angle_between(across, *then[k]);
        around += length;
    }
    if (turns) *turns = turn / around;
    return fmax(-l->odds->most_bends, fmin(l->odds->most_bends, (turn - other) / around));
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
    double odds = l->odds->of_angles * angles_for(l, &p) + l->odds->of_edges * edges_for(l, &p) - l->odds->of_staying;
    if (odds <= -l->odds->of_bends * l->odds->most_bends) return false;
    odds += l->odds->of_bends * bends_for(l, &p, NULL);
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

/* The odds for the other diagonal in place of the edge of h, which may be flipped then; and how much the surface turns
 * around it. */
static bool odds_of(const struct likely *l, uint32_t h, double *odds, double *turns) {
    struct pair p;
    if (l->he.twin[h] == NONE || !pair_of(l, h, &p)) return false;
    bool flat = vec3_length_sq(p.then[0]) == 0 || vec3_length_sq(p.then[1]) == 0;
    if (flat || halfedge_joined(&l->he, p.c, p.d)) return false;
    *odds = l->odds->of_angles * angles_for(l, &p) + l->odds->of_edges * edges_for(l, &p) - l->odds->of_staying +
            l->odds->of_bends * bends_for(l, &p, turns);
    return true;
}

/* Flips the edge of h, and one beside it, if both together are likelier so, else nothing.  odds: of the first flip. */
static bool flip_two(struct likely *l, uint32_t h, double odds) {
    uint32_t t = h / 3, s = l->he.twin[h] / 3, best = NONE;
    uint8_t touched[2] = {l->touched[t], l->touched[s]};
    take_other_diagonal(l, h);
    const uint32_t rim[4] = {3 * t, 3 * t + 2, 3 * s, 3 * s + 1};
    double most = 0, other = 0, turns;
    for (int k = 0; k < 4; k++)
        if (odds_of(l, rim[k], &other, &turns) && odds + other > most) most = odds + other, best = rim[k];
    if (best != NONE) {
        take_other_diagonal(l, best);
        return true;
    }
    take_other_diagonal(l, 3 * t + 1);
    l->touched[t] = touched[0], l->touched[s] = touched[1];
    return false;
}

/* Flips single edges that are unlikely, and pairs of which one leads to the other where the surface turns. */
static size_t flip_to_smooth(struct likely *l) {
    static const double LEAST = -3, TURNS = 0.2;
    size_t flips = 0, made = 1;
    memset(l->touched, 1, l->mesh->triangle_count);
    for (int i = 0; i < ROUNDS_MOST && made; i++) {
        made = 0;
        for (uint32_t h = 0; h < 3 * l->mesh->triangle_count; h++) {
            double odds = 0, turns = 0;
            if (l->he.twin[h] == NONE || h > l->he.twin[h] || !edge_is_due(l, h)) continue;
            if (!odds_of(l, h, &odds, &turns) || odds <= LEAST) continue;
            if (odds > 0) take_other_diagonal(l, h);
            made += odds > 0 || (turns > TURNS && flip_two(l, h, odds));
        }
        for (size_t t = 0; t < l->mesh->triangle_count; t++) l->touched[t] = l->touched[t] == 2;
        flips += made;
    }
    return flips;
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

/* The surface gets smoother, by so little that chance hardly does it. */
static bool is_smoother(const struct irregularity *before, const struct irregularity *after) {
    static const double LESS = 0.998;
    return after->turn < LESS * before->turn;
}

/* Flips edges of a copy of the mesh, which takes its place where it is the better one. */
static enum status flip_if(struct mesh *mesh, const struct odds *odds, size_t (*flip)(struct likely *),
                           bool (*is_better)(const struct irregularity *, const struct irregularity *), size_t *flips) {
    struct mesh taken = {0};
    struct likely l = {.odds = odds};
    enum status status = mesh_copy(&taken, mesh);
    if (!status) status = likely_init(&l, &taken);
    if (!status) {
        const struct irregularity before = find_irregularity(&l);
        size_t made = flip(&l);
        const struct irregularity after = find_irregularity(&l);
        bool is_taken = is_better(&before, &after);
        struct mesh plain = *mesh;
        if (is_taken) *mesh = taken, taken = plain;
        if (flips) *flips = is_taken ? made : 0;
    }
    likely_done(&l);
    mesh_done(&taken);
    return status;
}

enum status take_likely_edges(struct mesh *mesh, size_t *flips) {
    return flip_if(mesh, &USUAL, flip_unlikely, was_tessellated, flips);
}

enum status take_smooth_edges(struct mesh *mesh, size_t *flips) {
    return flip_if(mesh, &SMOOTH, flip_to_smooth, is_smoother, flips);
}

enum status take_likely_edges_across_gaps(struct mesh *mesh, const float *spacing, double share, size_t *flips) {
    struct likely l = {.odds = &USUAL, .spacing = spacing, .gap = GAP / sqrt(share)};
    enum status status = likely_init(&l, mesh);
    size_t made = status ? 0 : flip_unlikely(&l);
    if (!status && flips) *flips = made;
    likely_done(&l);
    return status;
}
