/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/vertex_normals.h"

void mesh_vertex_normals(const struct mesh *mesh, vec3 *normal) {
    for (size_t v = 0; v < mesh->vertex_count; v++) normal[v] = (vec3){0, 0, 0};
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        vec3 area = mesh_triangle_normal(mesh, t);
        for (int k = 0; k < 3; k++) {
            uint32_t v = mesh->triangle[t][k];
            normal[v] = vec3_add(normal[v], area);
        }
    }
}
