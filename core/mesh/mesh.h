/* A triangle mesh as flat arrays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_MESH_H
#define WHITTLE_CORE_MESH_MESH_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

enum mesh_tag {
    MESH_SUPPORTED = 0, /* the points around it say that there is surface */
    MESH_HOLE_FILL = 1  /* closes a hole that no point supports */
};

struct mesh {
    size_t vertex_count;
    vec3 *vertex; /* owned */
    uint32_t
        *source; /* for each vertex the point that it stands for, or NONE for a free position; owned; may be NULL */
    size_t triangle_count;
    uint32_t (*triangle)[3]; /* counter-clockwise seen from outside; owned */
    uint8_t *tag;            /* enum mesh_tag for each triangle; owned; may be NULL (all supported) */
};

/* Frees everything that the mesh owns and zeroes it.  Accepts a zeroed mesh. */
void mesh_done(struct mesh *mesh);

/* A mesh with memory of its own, to be done with in any case.  STATUS_NO_MEMORY. */
enum status mesh_copy(struct mesh *copy, const struct mesh *mesh) MUST_CHECK;

/* What a mesh is, combinatorially.  An edge is regular when exactly two triangles share it, in opposite directions. */
struct mesh_facts {
    size_t edges, boundary_edges, nonmanifold_edges /* more than two triangles */, misoriented_edges;
    size_t nonmanifold_vertices /* triangles around it form more than one fan */, unused_vertices, components;
    long euler;           /* V - E + F over the used vertices */
    size_t borders;       /* connected sets of boundary edges: of a manifold, closed loops */
    double border_length; /* of all boundary edges */
    double area, volume;  /* volume signed by the divergence theorem: positive when closed and oriented outwards */
    int watertight;       /* at least one triangle, every edge regular */
    int manifold;         /* watertight, or open with boundary, and no non-manifold edge or vertex */
};

/* Counts the facts.  O(triangles log triangles).  STATUS_NO_MEMORY only. */
enum status mesh_examine(const struct mesh *mesh, struct mesh_facts *facts) MUST_CHECK;

/* The normal of triangle t, by its corners' order; its length is twice the area. */
static inline vec3 mesh_triangle_normal(const struct mesh *mesh, size_t t) {
    const uint32_t *v = mesh->triangle[t];
    return vec3_triangle_normal(mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]]);
}

#endif
