/* A tube that isn't there runs from one sheet to another without a point on its way: each of its triangles has corners
 * on both.  Cut along the loop at one end, it still hangs on the sheet at the other.
 *
 *       ____a     b____            ____a_____b____
 *           |     |       cut at                        the stub: the disc from a to b, and all triangles
 *           |     |       a b          a_____b          beside that.  It ends at c and d, where a lid is
 *           |     |       =>           |     |          far smaller
 *       ____|     |____            ____|     |____
 *           c     d                    c     d
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pipeline/stubs.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"
#include "core/mesh/submesh.h"
#include "core/surface/sheet/holes.h"

enum { RIM_MOST = 64 /* edges of what a stub ends at */, PARTS_MOST = 512 /* triangles of one */ };
static const double FAR_LARGER = 3; /* a stub than its lid */

struct stub {
    uint32_t triangle[PARTS_MOST];
    size_t count;
    double times; /* as large as its lid; 0: none */
};

static bool is_part(const struct stub *stub, uint32_t t) {
    for (size_t i = 0; i < stub->count; i++)
        if (stub->triangle[i] == t) return true;
    return false;
}

/* Adds the triangles around a vertex; false: there are too many. */
static bool add_around(const struct halfedge *he, uint32_t v, struct stub *stub) {
    uint32_t start = he->out[v], h = start;
    do {
        if (!is_part(stub, h / 3)) {
            if (stub->count == PARTS_MOST) return false;
            stub->triangle[stub->count++] = h / 3;
        }
        h = halfedge_around(he, h);
    } while (h != start);
    return true;
}

static bool is_outer(const struct halfedge *he, const struct stub *stub, uint32_t h) {
    return is_part(stub, h / 3) && !is_part(stub, he->twin[h] / 3);
}

/* The half-edge of the outline after this one. */
static uint32_t next_outer(const struct halfedge *he, const struct stub *stub, uint32_t h) {
    h = halfedge_next(h);
    while (is_part(stub, he->twin[h] / 3)) h = halfedge_next(he->twin[h]);
    return h;
}

/* The outline's vertices in order; 0 where it isn't one loop that meets each of them once. */
static size_t outline_of(const struct halfedge *he, const struct stub *stub, uint32_t *rim) {
    uint32_t first = NONE;
    size_t edges = 0, n = 0;
    for (size_t i = 0; i < stub->count; i++)
        for (uint32_t h = 3 * stub->triangle[i]; h < 3 * stub->triangle[i] + 3; h++)
            if (is_outer(he, stub, h)) first = h, edges++;
    if (edges < 3 || edges > RIM_MOST) return 0;
    uint32_t h = first;
    do {
        for (size_t k = 0; k < n; k++)
            if (rim[k] == halfedge_from(he, h)) return 0;
        rim[n++] = halfedge_from(he, h);
        h = next_outer(he, stub, h);
    } while (h != first && n < edges);
    return n == edges && h == first ? n : 0;
}

static double area_of_stub(const struct mesh *mesh, const struct stub *stub) {
    double area = 0;
    for (size_t i = 0; i < stub->count; i++) area += vec3_length(mesh_triangle_normal(mesh, stub->triangle[i])) / 2;
    return area;
}

static double area_of_lid(const struct mesh *mesh, const uint32_t *rim, size_t n) {
    vec3 middle = {0};
    double area = 0;
    for (size_t i = 0; i < n; i++) middle = vec3_add(middle, vec3_scale(mesh->vertex[rim[i]], 1 / (double)n));
    for (size_t i = 0; i < n; i++)
        area += vec3_length(vec3_triangle_normal(middle, mesh->vertex[rim[i]], mesh->vertex[rim[(i + 1) % n]])) / 2;
    return area;
}

/* The disc around a middle and what is beside its rim, if they are a disc as well. */
static void find_stub(const struct mesh *mesh, const struct halfedge *he, uint32_t middle, struct stub *stub) {
    uint32_t ring[RIM_MOST], rim[RIM_MOST];
    size_t n = halfedge_ring(he, middle, ring, RIM_MOST);
    bool room = n > 0;
    stub->count = 0, stub->times = 0;
    for (size_t i = 0; i < n && room; i++) room = add_around(he, halfedge_to(he, ring[i]), stub);
    size_t outer = room ? outline_of(he, stub, rim) : 0;
    bool is_disc = outer > 0 && stub->count == 2 * n + outer; /* with the middle, n + 1 vertices inside */
    if (is_disc) stub->times = area_of_stub(mesh, stub) / area_of_lid(mesh, rim, outer);
}

static bool mark_stub(const struct stub *stub, uint8_t *out) {
    for (size_t i = 0; i < stub->count; i++)
        if (out[stub->triangle[i]]) return false;
    for (size_t i = 0; i < stub->count; i++) out[stub->triangle[i]] = 1;
    return true;
}

static size_t mark_stubs(const struct mesh *mesh, const struct halfedge *he, const uint32_t (*middle)[2], size_t cuts,
                         uint8_t *out) {
    size_t marked = 0;
    for (size_t i = 0; i < cuts; i++) {
        struct stub side[2];
        for (int k = 0; k < 2; k++) find_stub(mesh, he, middle[i][k], &side[k]);
        const struct stub *larger = &side[side[1].times > side[0].times];
        if (larger->times > FAR_LARGER) marked += mark_stub(larger, out);
    }
    return marked;
}

/* Replaces the mesh by what is left of it, if that can be closed. */
static enum status close_without(struct mesh *mesh, const struct halfedge *he, const uint8_t *out, unsigned threads) {
    struct mesh left = {0};
    struct mesh_facts facts = {0};
    size_t holes;
    enum status status = mesh_copy(&left, mesh);
    if (!status) status = submesh_without(&left, he, out);
    if (!status) status = sheet_close_holes(&left, INFINITY, threads, &holes);
    if (!status) status = mesh_examine(&left, &facts);
    if (!status && facts.watertight && facts.manifold) {
        struct mesh whole = *mesh;
        *mesh = left, left = whole;
    }
    mesh_done(&left);
    return status;
}

enum status stubs_leave_out(struct mesh *mesh, const uint32_t (*middle)[2], size_t cuts, unsigned threads) {
    struct halfedge he = {0};
    size_t marked = 0;
    uint8_t *out = alloc_zeroed(mesh->triangle_count, 1);
    enum status status = out ? halfedge_init(&he, mesh, threads) : STATUS_NO_MEMORY;
    if (!status) marked = mark_stubs(mesh, &he, middle, cuts, out);
    if (!status && marked) status = close_without(mesh, &he, out, threads);
    halfedge_done(&he);
    free(out);
    return status;
}
