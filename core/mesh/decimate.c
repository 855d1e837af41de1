/* A queue of vertices, each with what its cheapest collapse would cost.  Costs of neighbours are found anew after each
 * collapse, but whether a collapse is allowed only when it comes first: a vertex whose cheapest isn't goes back with
 * the cost of the cheapest that is.
 *
 * Quadrics are about the origin: coordinates are those of the normalised frame, so little cancels in double.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/decimate.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/math/sym3.h"
#include "core/mesh/halfedge.h"

#define UNUSED UINT32_MAX
#define LEAST_TURN 0.25  /* cosine between a triangle's normals before and after a collapse */
#define THIN 0.02        /* twice the area by the square of the longest edge: no triangle gets under it */
#define STAY 1e-3        /* of a vertex's area: what its own distance weighs beside that to the planes */
enum { RING_MOST = 30 }; /* neighbours of a vertex */

struct error_form { /* E(x) = x^T a x + 2 b . x + c */
    sym3 a;
    vec3 b;
    double c;
};

struct decimation {
    struct mesh *mesh;
    struct halfedge he;
    struct error_form *form; /* of each vertex */
    double *key;             /* of each vertex: what its cheapest collapse costs, as far as is known */
    uint32_t *heap, *place;  /* vertices by key and number, the least first; where each is, or UNUSED */
    size_t count;            /* in the heap */
};

static double form_value(const struct error_form *form, vec3 x) {
    return vec3_dot(x, vec3_add(sym3_mul(form->a, x), vec3_scale(form->b, 2))) + form->c;
}

static void form_add(struct error_form *form, const struct error_form *other) {
    form->a = sym3_add(form->a, other->a);
    form->b = vec3_add(form->b, other->b);
    form->c += other->c;
}

static void form_add_plane(struct error_form *form, vec3 normal, vec3 at, double weight) {
    double d = -vec3_dot(normal, at);
    form->a = sym3_add(form->a, sym3_scale(sym3_outer(normal), weight));
    form->b = vec3_add(form->b, vec3_scale(normal, weight * d));
    form->c += weight * d * d;
}

static void form_add_point(struct error_form *form, vec3 at, double weight) {
    form->a.xx += weight, form->a.yy += weight, form->a.zz += weight;
    form->b = vec3_sub(form->b, vec3_scale(at, weight));
    form->c += weight * vec3_length_sq(at);
}

static void set_forms(struct decimation *d) {
    const vec3 *vertex = d->mesh->vertex;
    for (size_t t = 0; t < d->mesh->triangle_count; t++) {
        const uint32_t *corner = d->mesh->triangle[t];
        vec3 normal = vec3_triangle_normal(vertex[corner[0]], vertex[corner[1]], vertex[corner[2]]);
        double twice = vec3_length(normal);
        if (!(twice > 0)) continue;
        normal = vec3_scale(normal, 1 / twice);
        for (int k = 0; k < 3; k++) {
            form_add_plane(&d->form[corner[k]], normal, vertex[corner[k]], twice);
            form_add_point(&d->form[corner[k]], vertex[corner[k]], STAY * twice);
        }
    }
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
    dequeue(d, v);
    d->key[v] = key;
    if (key < INFINITY) sift_up(d, d->count++, v);
}

/* ------------------------------------------------------------------------------------------------ collapses */

/* Whether the vertex of the ring may be put where the end of half-edge h, one of the ring, is. */
static bool is_fair(const struct decimation *d, const uint32_t *ring, size_t n, uint32_t h) {
    const vec3 *vertex = d->mesh->vertex;
    uint32_t to = halfedge_to(&d->he, h), gone = halfedge_from(&d->he, h);
    for (size_t i = 0; i < n; i++) {
        uint32_t b = halfedge_to(&d->he, ring[i]), c = halfedge_apex(&d->he, ring[i]);
        if (b == to || c == to) continue;
        vec3 before = vec3_triangle_normal(vertex[gone], vertex[b], vertex[c]);
        vec3 after = vec3_triangle_normal(vertex[to], vertex[b], vertex[c]);
        double length = vec3_length(after), was = vec3_length(before);
        double longest_sq = fmax(vec3_distance_sq(vertex[b], vertex[c]), fmax(vec3_distance_sq(vertex[to], vertex[b]),
                                                                              vec3_distance_sq(vertex[to], vertex[c])));
        if (!(length >= THIN * longest_sq) || vec3_dot(before, after) < LEAST_TURN * length * was) return false;
    }
    uint32_t others[RING_MOST];
    size_t m = halfedge_ring(&d->he, to, others, RING_MOST);
    return m > 0 && n + m <= RING_MOST + 4 && halfedge_may_collapse(&d->he, h, gone);
}

/* The cheapest collapse of a vertex, of those that are allowed, or of all; INFINITY: there is none. */
static double cheapest(const struct decimation *d, uint32_t v, bool allowed, uint32_t *best) {
    uint32_t ring[RING_MOST];
    double least = INFINITY;
    size_t n =
        d->he.out[v] == UNUSED || d->he.locked[v] != HALFEDGE_FREE ? 0 : halfedge_ring(&d->he, v, ring, RING_MOST);
    for (size_t i = 0; i < n; i++) {
        uint32_t to = halfedge_to(&d->he, ring[i]);
        vec3 place = d->mesh->vertex[to];
        double cost = form_value(&d->form[v], place) + form_value(&d->form[to], place);
        if (cost < least && (!allowed || is_fair(d, ring, n, ring[i]))) least = cost, *best = ring[i];
    }
    return least;
}

static void collapse(struct decimation *d, uint32_t h) {
    uint32_t gone = halfedge_from(&d->he, h), to = halfedge_to(&d->he, h), ring[RING_MOST], ignored;
    struct halfedge_spare spare = halfedge_collapse(&d->he, h, gone);
    for (int k = 0; k < 2; k++) d->mesh->triangle[spare.triangle[k]][0] = UNUSED;
    form_add(&d->form[to], &d->form[gone]);
    size_t n = halfedge_ring(&d->he, to, ring, RING_MOST);
    enqueue(d, to, cheapest(d, to, false, &ignored));
    for (size_t i = 0; i < n; i++) {
        uint32_t v = halfedge_to(&d->he, ring[i]);
        enqueue(d, v, cheapest(d, v, false, &ignored));
    }
}

static void collapse_down_to(struct decimation *d, size_t vertices, size_t count) {
    uint32_t h = UNUSED;
    while (vertices > count && d->count > 0) {
        uint32_t v = d->heap[0];
        double known = d->key[v], cost = cheapest(d, v, true, &h);
        dequeue(d, v);
        if (cost > known) {
            enqueue(d, v, cost);
            continue;
        }
        collapse(d, h);
        vertices--;
    }
}

/* Leaves out triangles and vertices that aren't there any more. */
static void compact(struct mesh *mesh, uint32_t *number) {
    size_t triangles = 0, vertices = 0;
    memset(number, 0xff, mesh->vertex_count * sizeof *number);
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        if (mesh->triangle[t][0] == UNUSED) continue;
        memmove(mesh->triangle[triangles], mesh->triangle[t], sizeof *mesh->triangle);
        if (mesh->tag) mesh->tag[triangles] = mesh->tag[t];
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

enum status mesh_decimate(struct mesh *mesh, size_t count) {
    size_t n = mesh->vertex_count, used = 0;
    struct decimation d = {.mesh = mesh};
    uint32_t ignored;
    enum status status = halfedge_init(&d.he, mesh, 1);
    d.form = alloc_zeroed(n, sizeof *d.form);
    d.key = alloc_array(n, sizeof *d.key);
    d.heap = alloc_array(n, sizeof *d.heap);
    d.place = alloc_array(n, sizeof *d.place);
    if (!status && d.form && d.key && d.heap && d.place) {
        set_forms(&d);
        memset(d.place, 0xff, n * sizeof *d.place);
        for (uint32_t v = 0; v < n; v++) {
            used += d.he.out[v] != UNUSED;
            enqueue(&d, v, cheapest(&d, v, false, &ignored));
        }
        collapse_down_to(&d, used, count);
        compact(mesh, d.place);
    } else {
        status = STATUS_NO_MEMORY;
    }
    free(d.form), free(d.key), free(d.heap), free(d.place);
    halfedge_done(&d.he);
    return status;
}
