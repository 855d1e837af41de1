/* Meshes as binary STL.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/stl_write.h"

#include <stdio.h>
#include <string.h>

#include "core/io/out/mesh_attributes.h"
#include "core/io/out/write.h"

enum { HEADER_BYTES = 80 };

static void stl_put_vector(struct sink *sink, vec3 p) {
    for (int axis = 0; axis < 3; axis++) {
        float value = (float)(&p.x)[axis];
        cloud_write_scalar(sink, &value, SCALAR_FLOAT32, ENCODING_BINARY);
    }
}

/* The facet's unit normal; 0 where it has none. */
static vec3 normal_of(const vec3 corner[3]) {
    vec3 n = vec3_cross(vec3_sub(corner[1], corner[0]), vec3_sub(corner[2], corner[0]));
    double length = vec3_length(n);
    return length > 0 ? vec3_scale(n, 1 / length) : (vec3){0, 0, 0};
}

static void put_facet(struct sink *sink, const struct mesh *mesh, size_t t) {
    static const uint16_t nothing;
    vec3 corner[3];
    for (int k = 0; k < 3; k++) corner[k] = mesh->vertex[mesh->triangle[t][k]];
    stl_put_vector(sink, normal_of(corner));
    for (int k = 0; k < 3; k++) stl_put_vector(sink, corner[k]);
    cloud_write_scalar(sink, &nothing, SCALAR_UINT16, ENCODING_BINARY);
}

enum status mesh_write_stl(int fd, const struct mesh *mesh, const struct cloud *cloud, struct left_out *left_out,
                           struct error *error) {
    char header[HEADER_BYTES] = "binary STL by whittle"; /* it must not begin with "solid" */
    struct sink sink;
    struct mesh_attributes attributes;
    if (mesh->triangle_count > UINT32_MAX)
        return error_set(error, STATUS_LIMIT, "write", "%zu triangles are more than STL can hold",
                         mesh->triangle_count);
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    mesh_attributes_find(mesh, cloud, &attributes);
    mesh_attributes_note(&attributes, cloud, "mesh.stl", NULL, false, left_out);
    if (!mesh_attributes_fit_f32(mesh))
        left_out_add(left_out, "mesh.stl", "precision: coordinates are float32, off by up to %.2g",
                     mesh_attributes_f32_error(mesh, (vec3){0, 0, 0}));
    uint32_t count = (uint32_t)mesh->triangle_count;
    sink_bytes(&sink, header, sizeof header);
    cloud_write_scalar(&sink, &count, SCALAR_UINT32, ENCODING_BINARY);
    for (size_t t = 0; t < mesh->triangle_count && !sink.failure; t++) put_facet(&sink, mesh, t);
    return sink_done(&sink, STATUS_OK, error);
}
