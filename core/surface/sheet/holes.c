/* Closing of holes: the triangulation of a loop with the smallest area, by dynamic programming over its arcs
 * (Barequet, Sharir 1995).
 *
 *     least area between corners i and j = min over m between: area(i, m) + area(m, j) + triangle(i, m, j)
 *
 * A diagonal that is an edge of the mesh already would have four triangles: such an arc can't be.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/holes.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"

static const double AROUND = 2; /* a border's length squared by its component's area: that of a disc is 12.6 */

struct closing {
    const struct mesh *mesh;
    struct halfedge he;
    uint32_t *border;    /* of each vertex: the half-edge of a border that starts there, or NONE */
    uint32_t *component; /* of each triangle */
    double *area;        /* of each component, by its first triangle */
    uint32_t *longest;   /* likewise: the loop, by its first half-edge, or NONE */
    double *length;      /* likewise: of that */
    uint8_t *seen;       /* of each half-edge */
    uint32_t corner[SHEET_HOLE_CORNERS];
    double *least;    /* corners squared: of the arc i .. j at i * corners + j */
    uint16_t *middle; /* likewise */
    uint32_t (*triangle)[3];
    size_t made, room;
};

static uint32_t next_on_border(const struct closing *c, uint32_t h) { return c->border[halfedge_to(&c->he, h)]; }

/* The loop's length and number of edges; marks it. */
static double follow(struct closing *c, uint32_t first, size_t *edges) {
    double length = 0;
    uint32_t h = first;
    *edges = 0;
    do {
        c->seen[h] = 1;
        length += vec3_distance(c->mesh->vertex[halfedge_from(&c->he, h)], c->mesh->vertex[halfedge_to(&c->he, h)]);
        ++*edges;
        h = next_on_border(c, h);
    } while (h != first && h != NONE && !c->seen[h]);
    return length;
}

static double double_area(const struct mesh *mesh, uint32_t a, uint32_t b, uint32_t c) {
    return vec3_length(vec3_triangle_normal(mesh->vertex[a], mesh->vertex[b], mesh->vertex[c]));
}

static void find_hole_components(struct closing *c) {
    const struct mesh *mesh = c->mesh;
    for (uint32_t t = 0; t < mesh->triangle_count; t++) c->component[t] = t;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) c->border[v] = NONE;
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++) {
        if (c->he.twin[h] != NONE)
            disjoint_set_unite(c->component, h / 3, c->he.twin[h] / 3);
        else
            c->border[halfedge_from(&c->he, h)] = h;
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        c->longest[t] = NONE;
        c->area[disjoint_set_root(c->component, t)] += double_area(mesh, v[0], v[1], v[2]) / 2;
    }
}

static void find_longest(struct closing *c) {
    size_t edges;
    for (uint32_t h = 0; h < 3 * c->mesh->triangle_count; h++) {
        if (c->he.twin[h] != NONE || c->seen[h]) continue;
        uint32_t root = disjoint_set_root(c->component, h / 3);
        double length = follow(c, h, &edges);
        if (c->longest[root] == NONE || length > c->length[root]) c->longest[root] = h, c->length[root] = length;
    }
    memset(c->seen, 0, 3 * c->mesh->triangle_count);
}

/* ------------------------------------------------------------------------------------------------ one hole */

/* An arc of more than an edge that is an edge of the mesh. */
static bool is_taken(const struct closing *c, size_t i, size_t j, size_t n) {
    if (j == i + 1 || (i == 0 && j == n - 1)) return false;
    return halfedge_joined(&c->he, c->corner[i], c->corner[j]);
}

/* Whether there is a triangulation. */
static bool solve(struct closing *c, size_t n) {
    for (size_t i = 0; i + 1 < n; i++) c->least[i * n + i + 1] = 0;
    for (size_t apart = 2; apart < n; apart++)
        for (size_t i = 0; i + apart < n; i++) {
            size_t j = i + apart;
            double least = INFINITY;
            for (size_t m = i + 1; m < j && !is_taken(c, i, j, n); m++) {
                double area = c->least[i * n + m] + c->least[m * n + j];
                if (area >= least) continue;
                area += double_area(c->mesh, c->corner[i], c->corner[m], c->corner[j]);
                if (area < least) least = area, c->middle[i * n + j] = (uint16_t)m;
            }
            c->least[i * n + j] = least;
        }
    return c->least[n - 1] < INFINITY;
}

static enum status make_room(struct closing *c, size_t more) {
    if (c->room - c->made >= more) return STATUS_OK;
    size_t room = c->room + c->room / 2 + more;
    void *grown = alloc_resize(c->triangle, room, sizeof *c->triangle);
    if (!grown) return STATUS_NO_MEMORY;
    c->triangle = grown, c->room = room;
    return STATUS_OK;
}

/* The triangles of the arc i .. j, without recursion: arcs that wait are on a stack, at most one for each corner. */
static void emit(struct closing *c, size_t n) {
    uint16_t stack[SHEET_HOLE_CORNERS][2];
    size_t waiting = 0;
    stack[waiting][0] = 0, stack[waiting++][1] = (uint16_t)(n - 1);
    while (waiting) {
        size_t i = stack[--waiting][0], j = stack[waiting][1];
        if (j <= i + 1) continue;
        uint16_t m = c->middle[i * n + j];
        uint32_t *v = c->triangle[c->made++];
        v[0] = c->corner[i], v[1] = c->corner[m], v[2] = c->corner[j];
        stack[waiting][0] = (uint16_t)i, stack[waiting++][1] = m;
        stack[waiting][0] = m, stack[waiting++][1] = (uint16_t)j;
    }
}

/* Fills the loop with n edges that begins at h; false in *filled where that can't be. */
static enum status fill_hole(struct closing *c, uint32_t h, size_t n, bool *filled) {
    for (size_t i = n; i-- > 0; h = next_on_border(c, h)) c->corner[i] = halfedge_from(&c->he, h);
    *filled = solve(c, n);
    if (!*filled) return STATUS_OK;
    enum status status = make_room(c, n - 2);
    if (!status) emit(c, n);
    return status;
}

/* ------------------------------------------------------------------------------------------------ all of them */

static bool is_hole(const struct closing *c, uint32_t h, double length) {
    uint32_t root = disjoint_set_root(c->component, h / 3);
    return h != c->longest[root] || length * length <= AROUND * c->area[root];
}

static enum status fill_all(struct closing *c, double longest, size_t *closed) {
    enum status status = STATUS_OK;
    for (uint32_t h = 0; !status && h < 3 * c->mesh->triangle_count; h++) {
        size_t edges;
        if (c->he.twin[h] != NONE || c->seen[h]) continue;
        double length = follow(c, h, &edges);
        bool filled = false;
        if (length <= longest && edges >= 3 && edges <= SHEET_HOLE_CORNERS && is_hole(c, h, length))
            status = fill_hole(c, h, edges, &filled);
        *closed += filled;
    }
    return status;
}

/* Puts the new triangles behind the mesh's. */
static enum status append(struct closing *c, struct mesh *mesh) {
    size_t before = mesh->triangle_count, count = before + c->made;
    uint32_t(*triangle)[3] = alloc_array(count, sizeof *triangle);
    uint8_t *tag = alloc_zeroed(count, 1);
    if (!triangle || !tag) {
        free(triangle), free(tag);
        return STATUS_NO_MEMORY;
    }
    memcpy(triangle, mesh->triangle, before * sizeof *triangle);
    memcpy(triangle + before, c->triangle, c->made * sizeof *triangle);
    if (mesh->tag) memcpy(tag, mesh->tag, before);
    memset(tag + before, MESH_HOLE_FILL, c->made);
    free(mesh->triangle), free(mesh->tag);
    mesh->triangle = triangle, mesh->tag = tag, mesh->triangle_count = count;
    return STATUS_OK;
}

static enum status begin(struct closing *c, unsigned threads) {
    size_t triangles = c->mesh->triangle_count, most = SHEET_HOLE_CORNERS;
    c->border = alloc_array(c->mesh->vertex_count, sizeof *c->border);
    c->component = alloc_array(triangles, sizeof *c->component);
    c->area = alloc_zeroed(triangles, sizeof *c->area);
    c->longest = alloc_array(triangles, sizeof *c->longest);
    c->length = alloc_zeroed(triangles, sizeof *c->length);
    c->seen = alloc_zeroed(triangles, 3);
    c->least = alloc_array(most * most, sizeof *c->least);
    c->middle = alloc_array(most * most, sizeof *c->middle);
    if (!c->border || !c->component || !c->area || !c->longest || !c->length || !c->seen || !c->least || !c->middle)
        return STATUS_NO_MEMORY;
    return halfedge_init(&c->he, c->mesh, threads);
}

enum status sheet_close_holes(struct mesh *mesh, double longest, unsigned threads, size_t *closed) {
    size_t count = 0;
    struct closing *c = alloc_zeroed(1, sizeof *c);
    if (!c) return STATUS_NO_MEMORY;
    c->mesh = mesh;
    enum status status = begin(c, threads);
    if (!status) {
        find_hole_components(c);
        find_longest(c);
        status = fill_all(c, longest, &count);
    }
    if (!status && c->made) status = append(c, mesh);
    if (!status) *closed = count;
    halfedge_done(&c->he);
    free(c->border), free(c->component), free(c->area), free(c->longest), free(c->length), free(c->seen);
    free(c->least), free(c->middle), free(c->triangle);
    free(c);
    return status;
}
