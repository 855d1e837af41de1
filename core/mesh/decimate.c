/* A queue of vertices, each with what its cheapest collapse would cost.  Costs of neighbours are found anew after each
 * collapse, but whether a collapse is allowed, and how far it strays, only when it comes first: a vertex whose cheapest
 * isn't, or costs more than was known, goes back with the cost of the cheapest that is.
 *
 * Where vertices stay at points, quadrics are summed up as Garland and Heckbert do, weighted by area.  Where they move,
 * nothing is remembered, as in Lindstrom, Turk: Fast and memory efficient polygonal simplification (1998): a place
 * costs the squares of the volumes that it has over the triangles as they are now.  What has been collapsed to good
 * places stands for what was there before, while sums hold on to places that have gone.  Where that costs least, what
 * is round or ends in a tip has lost volume, and where none is lost, as they have it, the vertex stands out as far as
 * the surface is cut off otherwise: a vertex is put half-way.  A thin tip has next to no volume, so what is cut off or
 * stands out costs as much again as if it were about as thick as it is long.
 *
 * Quadrics are about the origin: coordinates are those of the normalised frame, so little cancels in double.
 *
 * A large mesh whose vertices stay at points is collapsed in parts first, side by side: rows of vertices by their
 * numbers, which follow a curve through space.  Invariant: what has a neighbour in another part stays, so that a part
 * alone has what it changes: the triangles of which all corners are its own, the links across their edges, and what is
 * known of its vertices.  All parts take what is cheap in the whole mesh, round by round, and leave enough for the last
 * word to be the queue's of the whole; parts of a second kind lie across the rims of the first.  They don't depend on
 * the number of threads.
 *
 * A border, or a seam, is the edge of what its triangles tell: a plane through each of its edges, upright on the
 * triangle, has it keep its course.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/decimate.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/math/triangle.h"
#include "core/mesh/edge_costs.h"
#include "core/mesh/halfedge.h"

#define UNUSED UINT32_MAX
#define LEAST_TURN 0.25 /* cosine between a triangle's normals before and after a collapse */
#define THIN 0.02       /* twice the area by the square of the longest edge: no triangle gets under it */
#define COURSE 2.0      /* what the plane through a border's edge weighs, times its length squared */
#define STAY 1e-3       /* of a vertex's area: what its own distance weighs beside that to the planes */
#define STAY_MOVES 1e-7 /* the same beside volumes, where vertices move: more draws them off edges and corners */
#define STRAY 10.0      /* six times the volume that something counts for which is cut off or stands out by 1 */
enum { RING_MOST = EDGE_COSTS_MOST }; /* neighbours of a vertex */

enum { PART = 8192 };     /* vertices of a part */
enum { KEYS_STEP = 4 };   /* the costs of one vertex in so many tell those of all */
#define LARGEST_ROUND 0.4 /* of what is left, that may go between two looks at the costs of all parts */
static const double part_goals[] = {4, 2}; /* vertices that parts leave, by how many there will be */

/* Of a mesh, or of a part of it beside others: then all below `he` but what is for each vertex is the part's own. */
struct decimation {
    struct mesh *mesh;
    struct decimate_rules rules;
    struct halfedge he;
    struct plane *plane;     /* of each triangle, where vertices move */
    struct error_form *form; /* of each vertex */
    double *key;             /* of each vertex: what its cheapest collapse costs, as far as is known */
    uint32_t *heap, *place;  /* vertices by key and number, the least first; where each is, or UNUSED */
    uint32_t *changed;       /* of each vertex: the step after which its triangles are as they are */
    struct looked_at *found; /* of each vertex: its cheapest collapse that is allowed */
    uint8_t *rim;            /* of each vertex, in parts: it has a neighbour in another one, and stays */
    bool in_parts;
    uint32_t begin, end; /* the vertices that it is of */
    size_t count;        /* in the heap */
    size_t left;         /* vertices that are used */
    uint32_t step;       /* collapses so far, and one */
    uint32_t forgotten;  /* what was found at that step or before isn't known any more */
};

/* What a vertex's cheapest allowed collapse was at a step; 0 = it hasn't been looked for. */
struct looked_at {
    uint32_t step, way;
};

static double form_value(const struct error_form *form, vec3 x) {
    return vec3_dot(x, vec3_add(sym3_mul(form->a, x), vec3_scale(form->b, 2))) + form->c;
}

static void form_add(struct error_form *form, const struct error_form *other) {
    form->a = sym3_add(form->a, other->a);
    form->b = vec3_add(form->b, other->b);
    form->c += other->c;
    form->area = vec3_add(form->area, other->area);
    form->volume += other->volume;
}

static void form_add_plane(struct error_form *form, vec3 normal, double d, double weight) {
    form->a = sym3_add(form->a, sym3_scale(sym3_outer(normal), weight));
    form->b = vec3_add(form->b, vec3_scale(normal, weight * d));
    form->c += weight * d * d;
}

static void form_add_plane_at(struct error_form *form, vec3 normal, vec3 at, double weight) {
    form_add_plane(form, normal, -vec3_dot(normal, at), weight);
}

static void form_add_point(struct error_form *form, vec3 at, double weight) {
    form->a.xx += weight, form->a.yy += weight, form->a.zz += weight;
    form->b = vec3_sub(form->b, vec3_scale(at, weight));
    form->c += weight * vec3_length_sq(at);
}

/* Whether corners of one vertex differ across the edge of h, which has a twin. */
static bool is_seam(const struct decimation *d, uint32_t h) {
    const uint32_t *record = d->rules.record ? d->rules.record[0] : NULL;
    uint32_t g = d->he.twin[h];
    return record && (record[h] != record[halfedge_next(g)] || record[halfedge_next(h)] != record[g]);
}

static bool has_course(const struct decimation *d, uint32_t h) {
    return d->he.twin[h] == NONE ? d->rules.borders : is_seam(d, h);
}

/* The plane through the edge of h, upright on its triangle, counts as a triangle of so many times the edge's square. */
static void add_course(const struct decimation *d, uint32_t h, struct error_form *form) {
    vec3 a = d->mesh->vertex[halfedge_from(&d->he, h)];
    vec3 edge = vec3_sub(d->mesh->vertex[halfedge_to(&d->he, h)], a);
    vec3 across = vec3_cross(edge, mesh_triangle_normal(d->mesh, h / 3));
    double length = vec3_length(across), twice = COURSE * vec3_length_sq(edge);
    if (length > 0) form_add_plane_at(form, vec3_scale(across, 1 / length), a, d->rules.moves ? twice * twice : twice);
}

static void set_sums(struct decimation *d) {
    const vec3 *vertex = d->mesh->vertex;
    for (size_t t = 0; t < d->mesh->triangle_count; t++) {
        const uint32_t *corner = d->mesh->triangle[t];
        vec3 normal = vec3_triangle_normal(vertex[corner[0]], vertex[corner[1]], vertex[corner[2]]);
        double twice = vec3_length(normal);
        if (!(twice > 0)) continue;
        normal = vec3_scale(normal, 1 / twice);
        for (int k = 0; k < 3; k++) {
            form_add_plane_at(&d->form[corner[k]], normal, vertex[corner[k]], twice);
            form_add_point(&d->form[corner[k]], vertex[corner[k]], STAY * twice);
        }
    }
    for (uint32_t h = 0; h < 3 * d->mesh->triangle_count; h++) {
        if (!has_course(d, h)) continue;
        add_course(d, h, &d->form[halfedge_from(&d->he, h)]);
        add_course(d, h, &d->form[halfedge_to(&d->he, h)]);
    }
}

static void set_plane(struct decimation *d, size_t triangle) {
    const uint32_t *corner = d->mesh->triangle[triangle];
    vec3 a = d->mesh->vertex[corner[0]], b = d->mesh->vertex[corner[1]], c = d->mesh->vertex[corner[2]];
    vec3 normal = vec3_triangle_normal(a, b, c);
    d->plane[triangle] = (struct plane){normal, -vec3_dot(normal, a)};
}

/* Adds, or takes off, the volume over a triangle, by 6, and its square. */
static void add_volume(const struct decimation *d, size_t triangle, double times, struct error_form *form) {
    const struct plane *plane = &d->plane[triangle];
    form_add_plane(form, plane->normal, plane->d, times);
    form->area = vec3_add(form->area, vec3_scale(plane->normal, times));
    form->volume -= times * plane->d;
}

/* The form of the triangles that are around v now.  That of a vertex which nothing is merged into isn't needed. */
static void form_anew(struct decimation *d, uint32_t v) {
    uint32_t ring[RING_MOST];
    struct error_form form = {0};
    bool is_needed = d->he.out[v] != UNUSED && d->he.locked[v] != HALFEDGE_KNOTTED;
    size_t n = is_needed ? halfedge_ring(&d->he, v, ring, RING_MOST) : 0;
    for (size_t i = 0; i < n; i++) {
        add_volume(d, ring[i] / 3, 1, &form);
        if (has_course(d, ring[i])) add_course(d, ring[i], &form);
    }
    if (n && d->he.locked[v] && d->rules.borders) add_course(d, halfedge_prev(ring[n - 1]), &form);
    form_add_point(&form, d->mesh->vertex[v], STAY_MOVES * sym3_trace(form.a));
    d->form[v] = form;
}

/* What is in the form's room for a volume where vertices stay: each neighbour that may be merged into v asks for it. */
static void set_own_value(struct decimation *d, uint32_t v) {
    d->form[v].volume = form_value(&d->form[v], d->mesh->vertex[v]);
}

/* In the form's room for an area, likewise: what v's cheapest way costs, allowed or not, and to whom it leads. */
static void set_lowest(struct decimation *d, uint32_t v, double cost, uint32_t to) {
    d->form[v].area = (vec3){cost, to, 0};
}

static void set_forms(struct decimation *d) {
    if (!d->rules.moves) {
        set_sums(d);
        for (uint32_t v = 0; v < d->mesh->vertex_count; v++) set_own_value(d, v);
        return;
    }
    for (size_t t = 0; t < d->mesh->triangle_count; t++) set_plane(d, t);
    for (uint32_t v = 0; v < d->mesh->vertex_count; v++) form_anew(d, v);
}

/* ------------------------------------------------------------------------------------------------ the queue */

static bool comes_before(const struct decimation *d, uint32_t v, uint32_t w) {
    return d->key[v] < d->key[w] || (d->key[v] == d->key[w] && v < w);
}

static void put(struct decimation *d, size_t at, uint32_t v) {
    d->heap[at] = v;
    d->place[v] = (uint32_t)at;
}

static void sift_up(struct decimation *d, size_t at, uint32_t v) {
    for (; at > 0 && comes_before(d, v, d->heap[(at - 1) / 2]); at = (at - 1) / 2) put(d, at, d->heap[(at - 1) / 2]);
    put(d, at, v);
}

static void sift_down(struct decimation *d, size_t at, uint32_t v) {
    for (size_t child; (child = 2 * at + 1) < d->count; at = child) {
        if (child + 1 < d->count && comes_before(d, d->heap[child + 1], d->heap[child])) child++;
        if (!comes_before(d, d->heap[child], v)) break;
        put(d, at, d->heap[child]);
    }
    put(d, at, v);
}

static void dequeue(struct decimation *d, uint32_t v) {
    size_t at = d->place[v];
    if (at == UNUSED) return;
    d->place[v] = UNUSED;
    uint32_t last = d->heap[--d->count];
    if (last == v) return;
    if (at > 0 && comes_before(d, last, d->heap[(at - 1) / 2]))
        sift_up(d, at, last);
    else
        sift_down(d, at, last);
}

static void enqueue(struct decimation *d, uint32_t v, double key) {
    size_t at = d->place[v];
    if (!(key < INFINITY)) {
        dequeue(d, v);
        d->key[v] = key;
        return;
    }
    bool earlier = at == UNUSED || key < d->key[v];
    d->key[v] = key;
    if (at == UNUSED) at = d->count++;
    if (earlier)
        sift_up(d, at, v);
    else
        sift_down(d, at, v);
}

/* ------------------------------------------------------------------------------------------------ collapses */

/* What a vertex may be merged into: the ends of half-edges out of it, or, along a border, where the one half-edge that
 * runs to it comes from. */
struct ways {
    size_t n;     /* triangles around it; 0: it stays */
    size_t count; /* half-edges whose edge may be collapsed */
    uint32_t ring[RING_MOST], way[RING_MOST];
};

static uint32_t other_end(const struct decimation *d, uint32_t h, uint32_t v) {
    return halfedge_from(&d->he, h) == v ? halfedge_to(&d->he, h) : halfedge_from(&d->he, h);
}

/* A vertex on a seam is merged along it; where seams end or cross it stays. */
static void keep_to_seams(const struct decimation *d, bool on_border, struct ways *ways) {
    uint32_t seam[RING_MOST];
    size_t count = 0;
    for (size_t i = on_border; i < ways->n; i++)
        if (is_seam(d, ways->ring[i])) seam[count++] = ways->ring[i];
    if (count == 0) return;
    ways->count = count == 2 && !on_border ? 2 : 0;
    memcpy(ways->way, seam, ways->count * sizeof *seam);
}

static void find_ways(const struct decimation *d, uint32_t v, struct ways *ways) {
    bool on_border = d->he.locked[v] == HALFEDGE_BORDER;
    ways->n = ways->count = 0;
    if (d->he.out[v] == UNUSED || d->he.locked[v] == HALFEDGE_KNOTTED || (on_border && !d->rules.borders)) return;
    ways->n = halfedge_ring(&d->he, v, ways->ring, RING_MOST);
    if (ways->n == 0) return;
    if (on_border) {
        ways->way[0] = ways->ring[0], ways->way[1] = halfedge_prev(ways->ring[ways->n - 1]);
        ways->count = 2;
    } else {
        memcpy(ways->way, ways->ring, ways->n * sizeof *ways->ring);
        ways->count = ways->n;
    }
    if (d->rules.record) keep_to_seams(d, on_border, ways);
}

/* Of numbers alone: fmin and fmax, which know what to do with a NaN, are calls. */
static double lesser(double a, double b) { return a < b ? a : b; }
static double greater(double a, double b) { return a > b ? a : b; }

static double longest_sq_of(vec3 a, vec3 b, vec3 c) {
    return greater(vec3_distance_sq(b, c), greater(vec3_distance_sq(a, b), vec3_distance_sq(a, c)));
}

/* Whether the triangles around v, but those that `to` has as well, may have v at a place. */
static bool may_stand(const struct decimation *d, uint32_t v, const uint32_t *ring, size_t n, uint32_t to, vec3 place) {
    const vec3 *vertex = d->mesh->vertex;
    for (size_t i = 0; i < n; i++) {
        uint32_t b = halfedge_to(&d->he, ring[i]), c = halfedge_apex(&d->he, ring[i]);
        if (b == to || c == to) continue;
        vec3 before = vec3_triangle_normal(vertex[v], vertex[b], vertex[c]);
        vec3 after = vec3_triangle_normal(place, vertex[b], vertex[c]);
        double length = vec3_length(after), was = vec3_length(before);
        double longest_sq = longest_sq_of(place, vertex[b], vertex[c]);
        bool thin = !(length >= THIN * longest_sq);
        if (thin && d->rules.slivers)
            thin = !(length > 0 && length * longest_sq_of(vertex[v], vertex[b], vertex[c]) >= was * longest_sq);
        if (thin || vec3_dot(before, after) < LEAST_TURN * length * was) return false;
        if (d->rules.viewed && vec3_dot(after, vec3_sub(d->rules.view, place)) < 0 &&
            vec3_dot(before, vec3_sub(d->rules.view, vertex[v])) >= 0)
            return false;
    }
    return true;
}

/* Whether vertex v may be merged into the other end of one of its ways, which is put at a place then. */
static bool is_fair(const struct decimation *d, uint32_t v, const struct ways *ways, uint32_t way, vec3 place) {
    uint32_t to = other_end(d, way, v), others[RING_MOST];
    size_t m = d->he.locked[to] == HALFEDGE_KNOTTED ? 0 : halfedge_ring(&d->he, to, others, RING_MOST);
    if (m == 0 || ways->n + m > RING_MOST + 4 || !may_stand(d, v, ways->ring, ways->n, to, place)) return false;
    bool stays = memcmp(&place, &d->mesh->vertex[to], sizeof place) == 0;
    return (stays || may_stand(d, to, others, m, v, place)) && halfedge_may_collapse(&d->he, way, v);
}

/* What it costs that v is merged into another vertex where that is, if vertices stay. */
static double cost_to(const struct decimation *d, uint32_t v, uint32_t to) {
    return form_value(&d->form[v], d->mesh->vertex[to]) + d->form[to].volume;
}

/* What it costs that v is merged into the other end of each of its ways, which is put at a place then. */
static void find_costs(const struct decimation *d, uint32_t v, const struct ways *ways, double *cost, vec3 *place) {
    struct edge_end end[RING_MOST];
    for (size_t i = 0; i < ways->count; i++) {
        uint32_t h = ways->way[i], to = other_end(d, h, v), twin = d->he.twin[h];
        place[i] = d->mesh->vertex[to];
        if (d->rules.moves)
            end[i] = (struct edge_end){&d->form[to],
                                       &d->mesh->vertex[to],
                                       {&d->plane[h / 3], twin == NONE ? NULL : &d->plane[twin / 3]},
                                       d->he.locked[v] || d->he.locked[to]};
        else
            cost[i] = cost_to(d, v, to);
    }
    if (d->rules.moves) edge_costs_find(&d->form[v], d->mesh->vertex[v], end, (unsigned)ways->count, cost, place);
}

/* Triangles around a vertex. */
struct star {
    size_t n;
    uint32_t ring[RING_MOST];
};

/* How far `from` is from the triangles of a star, whose middle is at a place, but those that `to` has as well. */
static double nearest_sq(const struct decimation *d, const struct star *star, uint32_t to, vec3 place, vec3 from) {
    double least_sq = INFINITY;
    for (size_t i = 0; i < star->n; i++) {
        uint32_t b = halfedge_to(&d->he, star->ring[i]), c = halfedge_apex(&d->he, star->ring[i]);
        if (b == to || c == to) continue;
        vec3 nearest = triangle_closest(from, place, d->mesh->vertex[b], d->mesh->vertex[c]);
        double far_sq = vec3_distance_sq(from, nearest);
        least_sq = far_sq < least_sq ? far_sq : least_sq;
    }
    return least_sq;
}

/* What it costs that both ends of an edge are off the surface with `place` in place of them, and it off theirs. */
static double cost_of_straying(const struct decimation *d, uint32_t v, uint32_t to, vec3 place) {
    vec3 a = d->mesh->vertex[v], b = d->mesh->vertex[to];
    struct star of_v, of_to;
    of_v.n = halfedge_ring(&d->he, v, of_v.ring, RING_MOST);
    of_to.n = halfedge_ring(&d->he, to, of_to.ring, RING_MOST);
    double first = lesser(nearest_sq(d, &of_v, to, place, a), nearest_sq(d, &of_to, v, place, a));
    double second = lesser(nearest_sq(d, &of_v, to, place, b), nearest_sq(d, &of_to, v, place, b));
    double put = lesser(nearest_sq(d, &of_v, UNUSED, a, place), nearest_sq(d, &of_to, UNUSED, b, place));
    double far_sq = greater(put, greater(first, second));
    return STRAY * STRAY * far_sq * far_sq * far_sq;
}

/* The cheapest collapse of a vertex: of those that are allowed, or of all by volumes or sums alone, which is no more;
 * INFINITY: there is none. */
static double cheapest(const struct decimation *d, uint32_t v, bool allowed, uint32_t *best, vec3 *best_at) {
    struct ways ways;
    double cost[RING_MOST], least = INFINITY;
    vec3 place[RING_MOST];
    find_ways(d, v, &ways);
    find_costs(d, v, &ways, cost, place);
    for (size_t tried = 0; tried < ways.count; tried++) {
        size_t next = 0;
        for (size_t i = 1; i < ways.count; i++)
            if (cost[i] < cost[next]) next = i;
        double value = cost[next];
        cost[next] = INFINITY;
        if (!(value < least)) break;
        if (allowed && !is_fair(d, v, &ways, ways.way[next], place[next])) continue;
        if (allowed && d->rules.moves) value += cost_of_straying(d, v, other_end(d, ways.way[next], v), place[next]);
        if (value < least) least = value, *best = ways.way[next], *best_at = place[next];
    }
    return least;
}

/* Gives the corners of v the records of `to`, each those of its own side of the seam: around v from the triangle of h
 * to the next seam, which h is part of unless there is none, and on to h's twin. */
static void hand_over_records(struct decimation *d, uint32_t v, const struct ways *ways, uint32_t way) {
    uint32_t *record = d->rules.record[0];
    bool outward = halfedge_from(&d->he, way) == v;
    uint32_t twin = d->he.twin[way], side = record[outward ? halfedge_next(way) : way];
    uint32_t other = twin == NONE ? side : record[twin];
    size_t first = 0;
    while (outward && ways->ring[first] != way) first++;
    uint32_t given[RING_MOST];
    for (size_t k = 0; k < ways->n; k++) {
        size_t i = (first + k) % ways->n;
        if (k > 0 && twin != NONE && is_seam(d, ways->ring[i])) side = other;
        given[i] = side;
    }
    for (size_t i = 0; i < ways->n; i++) record[ways->ring[i]] = given[i];
}

static bool is_elsewhere(const struct decimation *d, uint32_t v) { return v < d->begin || v >= d->end; }

/* Sets where v stands in the queue by the costs of all its ways. */
static void queue(struct decimation *d, uint32_t v) {
    uint32_t best = UNUSED;
    vec3 nowhere;
    if (d->in_parts && d->rim[v]) return;
    double cost = cheapest(d, v, false, &best, &nowhere);
    if (!d->rules.moves) set_lowest(d, v, cost, best == UNUSED ? UNUSED : other_end(d, best, v));
    enqueue(d, v, cost);
}

static void queue_again(struct decimation *d, uint32_t v) {
    if (is_elsewhere(d, v)) return;
    d->changed[v] = d->step;
    queue(d, v);
}

/* The same of a neighbour v of a vertex that another one was merged into: where vertices stay, what its other ways cost
 * is what they did, and of them the cheapest is known unless it led to one of the two. */
static void queue_beside(struct decimation *d, uint32_t v, uint32_t to, uint32_t gone) {
    if (is_elsewhere(d, v) || (d->in_parts && d->rim[v])) {
        queue_again(d, v);
        return;
    }
    double lowest = d->form[v].area.x, leads_to = d->form[v].area.y;
    bool knows = !d->rules.moves && !d->rules.record && !d->he.locked[v] && lowest < INFINITY && leads_to != to &&
                 leads_to != gone;
    if (!knows || (d->forgotten && d->changed[v] <= d->forgotten)) {
        queue_again(d, v);
        return;
    }
    double cost = cost_to(d, v, to);
    if (cost < lowest) set_lowest(d, v, cost, to);
    d->changed[v] = d->step;
    enqueue(d, v, lesser(cost, lowest));
}

static void change_forms(struct decimation *d, uint32_t v, const uint32_t *ring, size_t n) {
    for (size_t i = 0; i < n; i++) set_plane(d, ring[i] / 3);
    form_anew(d, v);
    for (size_t i = 0; i < n; i++) form_anew(d, halfedge_to(&d->he, ring[i]));
    if (n && d->he.locked[v] == HALFEDGE_BORDER) form_anew(d, halfedge_apex(&d->he, ring[n - 1]));
}

/* Puts what is left at a place, where it isn't its point any more if it moves. */
static void collapse(struct decimation *d, uint32_t gone, uint32_t h, vec3 place) {
    uint32_t to = other_end(d, h, gone), ring[RING_MOST];
    struct ways ways;
    find_ways(d, gone, &ways);
    if (d->rules.record) hand_over_records(d, gone, &ways, h);
    struct halfedge_spare spare = halfedge_collapse(&d->he, h, gone);
    d->step++;
    for (int k = 0; k < 2; k++)
        if (spare.triangle[k] != NONE) d->mesh->triangle[spare.triangle[k]][0] = UNUSED;
    if (!d->rules.moves) form_add(&d->form[to], &d->form[gone]);
    if (d->mesh->source && memcmp(&place, &d->mesh->vertex[to], sizeof place) != 0) d->mesh->source[to] = NONE;
    d->mesh->vertex[to] = place;
    if (!d->rules.moves) set_own_value(d, to);
    size_t n = halfedge_ring(&d->he, to, ring, RING_MOST);
    if (d->rules.moves) change_forms(d, to, ring, n);
    if (n == 0) d->forgotten = d->step - 1; /* of more neighbours than can be told */
    queue_again(d, to);
    for (size_t i = 0; i < n; i++) queue_beside(d, halfedge_to(&d->he, ring[i]), to, gone);
    if (n && d->he.locked[to] == HALFEDGE_BORDER) queue_again(d, halfedge_apex(&d->he, ring[n - 1]));
}

/* Whether what was found of a vertex still holds: it was found with the triangles that are around it and its neighbours
 * now.  Then *best and *best_at are that, as `cheapest` sets them. */
static bool is_known(const struct decimation *d, uint32_t v, uint32_t *best, vec3 *best_at) {
    struct ways ways;
    struct looked_at found = d->found[v];
    if (found.step <= d->forgotten || d->changed[v] > found.step) return false;
    find_ways(d, v, &ways);
    for (size_t i = 0; i < ways.n; i++)
        if (d->changed[halfedge_to(&d->he, ways.ring[i])] > found.step) return false;
    if (ways.n == 0 || (d->he.locked[v] && d->changed[halfedge_apex(&d->he, ways.ring[ways.n - 1])] > found.step))
        return false;
    double cost;
    ways.count = 1, ways.way[0] = *best = found.way;
    find_costs(d, v, &ways, &cost, best_at);
    return true;
}

/* Collapses what costs no more than `most`, the cheapest first, until `left` vertices are left. */
static void collapse_down_to(struct decimation *d, size_t left, double most) {
    uint32_t h = UNUSED;
    vec3 place;
    while (d->left > left && d->count > 0 && d->key[d->heap[0]] <= most) {
        uint32_t v = d->heap[0];
        if (!is_known(d, v, &h, &place)) {
            double known = d->key[v], cost = cheapest(d, v, true, &h, &place);
            if (cost > known) {
                d->found[v] = (struct looked_at){d->step, h};
                enqueue(d, v, cost);
                continue;
            }
        }
        dequeue(d, v);
        collapse(d, v, h, place);
        d->left--;
    }
}

/* Puts all vertices that it is of into an empty queue. */
static void queue_all(struct decimation *d) {
    size_t n = d->end - d->begin;
    d->count = d->left = 0;
    d->step = 1, d->forgotten = 0;
    memset(d->place + d->begin, 0xff, n * sizeof *d->place);
    memset(d->changed + d->begin, 0, n * sizeof *d->changed);
    memset(d->found + d->begin, 0, n * sizeof *d->found);
    for (uint32_t v = d->begin; v < d->end; v++) {
        if (d->he.out[v] == UNUSED) continue;
        d->left++;
        queue(d, v);
    }
}

/* ------------------------------------------------------------------------------------------------ parts */

struct parts {
    const struct decimation *whole;
    struct decimation *part;
    size_t count, left; /* parts; vertices that are used, of all of them */
    double most, share; /* what a collapse may cost in a round; how many of its vertices a part may lose */
    float *key;         /* scratch */
};

/* Whether a neighbour is in another part, or they can't be told. */
static bool is_on_rim(const struct decimation *d, uint32_t v) {
    uint32_t ring[RING_MOST];
    size_t n = d->he.locked[v] == HALFEDGE_KNOTTED ? 0 : halfedge_ring(&d->he, v, ring, RING_MOST);
    bool rim = n == 0;
    for (size_t i = 0; i < n && !rim; i++) rim = is_elsewhere(d, halfedge_to(&d->he, ring[i]));
    return rim || (d->he.locked[v] && is_elsewhere(d, halfedge_apex(&d->he, ring[n - 1])));
}

static void find_rims(void *ctx, size_t begin, size_t end) {
    const struct parts *parts = ctx;
    for (; begin < end; begin++) {
        const struct decimation *d = &parts->part[begin];
        for (uint32_t v = d->begin; v < d->end; v++) d->rim[v] = d->he.out[v] != UNUSED && is_on_rim(d, v);
    }
}

static void queue_parts(void *ctx, size_t begin, size_t end) {
    const struct parts *parts = ctx;
    for (; begin < end; begin++) queue_all(&parts->part[begin]);
}

static void collapse_parts(void *ctx, size_t begin, size_t end) {
    const struct parts *parts = ctx;
    for (; begin < end; begin++) {
        struct decimation *d = &parts->part[begin];
        collapse_down_to(d, d->left - (size_t)(parts->share * (double)d->left), parts->most);
    }
}

/* The next round takes what costs least of what is queued: a share of it, and of no part more than that.  False where
 * the goal is reached, or nothing went in the last one. */
static bool choose_most(struct parts *parts, size_t goal) {
    size_t n = 0, left = 0;
    for (size_t i = 0; i < parts->count; i++) {
        const struct decimation *d = &parts->part[i];
        left += d->left;
        for (uint32_t v = d->begin; v < d->end; v += KEYS_STEP)
            if (d->place[v] != UNUSED) parts->key[n++] = (float)d->key[v];
    }
    bool stuck = left == parts->left;
    parts->left = left;
    if (n == 0 || stuck || left <= goal) return false;
    parts->share = lesser(LARGEST_ROUND, (double)(left - goal) / (double)left);
    parts->most = (double)quantile_of(parts->key, n, parts->share);
    return true;
}

/* Collapses edges within parts, of which the first has so many vertices, until as many as the goal are left. */
static void collapse_within(struct parts *parts, size_t first, size_t goal) {
    const struct decimation *whole = parts->whole;
    size_t n = whole->mesh->vertex_count, begin = 0;
    parts->count = 0, parts->left = 0;
    for (size_t end = first; begin < n; begin = end, end += PART) {
        struct decimation *part = &parts->part[parts->count++];
        *part = *whole;
        part->begin = (uint32_t)begin, part->end = (uint32_t)(end < n ? end : n), part->in_parts = true;
        part->heap = whole->heap + begin;
    }
    unsigned threads = whole->rules.threads;
    par_for(threads, parts->count, 1, find_rims, parts);
    par_for(threads, parts->count, 1, queue_parts, parts);
    while (choose_most(parts, goal)) par_for(threads, parts->count, 1, collapse_parts, parts);
}

/* Leaves out triangles and vertices that aren't there any more. */
static void compact(struct mesh *mesh, uint32_t (*record)[3], uint32_t *number) {
    size_t triangles = 0, vertices = 0;
    memset(number, 0xff, mesh->vertex_count * sizeof *number);
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        if (mesh->triangle[t][0] == UNUSED) continue;
        memmove(mesh->triangle[triangles], mesh->triangle[t], sizeof *mesh->triangle);
        if (mesh->tag) mesh->tag[triangles] = mesh->tag[t];
        if (record) memmove(record[triangles], record[t], sizeof *record);
        for (int k = 0; k < 3; k++) number[mesh->triangle[triangles][k]] = 0;
        triangles++;
    }
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        if (number[v] == UNUSED) continue;
        mesh->vertex[vertices] = mesh->vertex[v];
        if (mesh->source) mesh->source[vertices] = mesh->source[v];
        number[v] = (uint32_t)vertices++;
    }
    for (size_t t = 0; t < triangles; t++)
        for (int k = 0; k < 3; k++) mesh->triangle[t][k] = number[mesh->triangle[t][k]];
    mesh->triangle_count = triangles, mesh->vertex_count = vertices;
}

static bool allocate_decimation(struct decimation *d, struct parts *parts) {
    size_t n = d->mesh->vertex_count;
    d->plane = alloc_array(d->rules.moves ? d->mesh->triangle_count : 1, sizeof *d->plane);
    d->form = alloc_zeroed(n, sizeof *d->form);
    d->key = alloc_array(n, sizeof *d->key);
    d->heap = alloc_array(n, sizeof *d->heap);
    d->place = alloc_array(n, sizeof *d->place);
    d->changed = alloc_array(n, sizeof *d->changed);
    d->found = alloc_array(n, sizeof *d->found);
    d->rim = alloc_array(n, sizeof *d->rim);
    parts->part = alloc_array(n / PART + 2, sizeof *parts->part);
    parts->key = alloc_array(n / KEYS_STEP + n / PART + 2, sizeof *parts->key);
    return d->plane && d->form && d->key && d->heap && d->place && d->changed && d->found && d->rim && parts->part &&
           parts->key;
}

enum status mesh_decimate(struct mesh *mesh, const struct decimate_rules *rules, size_t count) {
    size_t n = mesh->vertex_count;
    struct decimation d = {
        .mesh = mesh, .rules = rules ? *rules : (struct decimate_rules){.threads = 1}, .end = (uint32_t)n};
    struct parts parts = {.whole = &d};
    enum status status = halfedge_init(&d.he, mesh, d.rules.threads);
    if (!status && !allocate_decimation(&d, &parts)) status = STATUS_NO_MEMORY;
    if (!status) {
        set_forms(&d);
        if (n >= (size_t)2 * PART && !d.rules.moves) {
            collapse_within(&parts, PART, (size_t)(part_goals[0] * (double)count));
            collapse_within(&parts, PART / 2, (size_t)(part_goals[1] * (double)count)); /* across those of before */
        }
        queue_all(&d);
        collapse_down_to(&d, count, INFINITY);
        compact(mesh, d.rules.record, d.place);
    }
    free(d.plane), free(d.form), free(d.key), free(d.heap), free(d.place), free(d.changed), free(d.found), free(d.rim);
    free(parts.part), free(parts.key);
    halfedge_done(&d.he);
    return status;
}
