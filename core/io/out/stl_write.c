/* Meshes as binary STL.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/stl_write.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/io/formats/stl_origin.h"
#include "core/io/out/mesh_attributes.h"
#include "core/io/out/write.h"
#include "core/text/number.h"

enum { HEADER_BYTES = 80, DIGITS = 9 };

static void stl_put_vector(struct sink *sink, vec3 p) {
    for (int axis = 0; axis < 3; axis++) {
        float value = (float)(&p.x)[axis];
        cloud_write_scalar(sink, &value, SCALAR_FLOAT32, ENCODING_BINARY);
    }
}

/* The middle of the mesh, of as many digits as the header has room for; 0 where float32 holds all coordinates, or holds
 * them around 0 as well but for a bit. */
static vec3 stl_choose_origin(const struct mesh *mesh) {
    vec3 low = {INFINITY, INFINITY, INFINITY}, high = {-INFINITY, -INFINITY, -INFINITY}, origin = {0, 0, 0};
    if (mesh_attributes_fit_f32(mesh)) return origin;
    for (size_t v = 0; v < mesh->vertex_count; v++)
        low = vec3_min(low, mesh->vertex[v]), high = vec3_max(high, mesh->vertex[v]);
    double size = fmax(fmax(high.x - low.x, high.y - low.y), high.z - low.z);
    for (int axis = 0; axis < 3; axis++) {
        char text[NUMBER_TEXT_BYTES];
        double middle = (&low.x)[axis] / 2 + (&high.x)[axis] / 2;
        if (!(fabs(middle) > 2 * size)) continue;
        number_print(text, DIGITS, middle);
        (&origin.x)[axis] = number_read(text, NULL);
    }
    return origin;
}

static bool is_moved(vec3 origin) { return origin.x != 0 || origin.y != 0 || origin.z != 0; }

static void stl_name(vec3 origin, char header[HEADER_BYTES]) {
    char text[3][NUMBER_TEXT_BYTES];
    memset(header, 0, HEADER_BYTES);
    for (int axis = 0; axis < 3; axis++) number_print(text[axis], DIGITS, (&origin.x)[axis]);
    if (is_moved(origin))
        snprintf(header, HEADER_BYTES, STL_ORIGIN_BEGIN "%.16s %.16s %.16s" STL_ORIGIN_END, text[0], text[1], text[2]);
    else
        snprintf(header, HEADER_BYTES, "binary STL by whittle"); /* it must not begin with "solid" */
}

static void stl_note(const struct mesh *mesh, vec3 origin, struct left_out *left_out) {
    if (is_moved(origin))
        left_out_add(left_out, "mesh.stl",
                     LEFT_OUT_WARNING "coordinates are float32 around %.*g %.*g %.*g, to be added; off by up to %.2g",
                     DIGITS, origin.x, DIGITS, origin.y, DIGITS, origin.z, mesh_attributes_f32_error(mesh, origin));
    else if (!mesh_attributes_fit_f32(mesh))
        left_out_add(left_out, "mesh.stl", "precision: coordinates are float32, off by up to %.2g",
                     mesh_attributes_f32_error(mesh, origin));
}

/* The facet's unit normal; 0 where it has none. */
static vec3 normal_of(const vec3 corner[3]) {
    vec3 n = vec3_cross(vec3_sub(corner[1], corner[0]), vec3_sub(corner[2], corner[0]));
    double length = vec3_length(n);
    return length > 0 ? vec3_scale(n, 1 / length) : (vec3){0, 0, 0};
}

static void put_facet(struct sink *sink, const struct mesh *mesh, vec3 origin, size_t t) {
    static const uint16_t nothing;
    vec3 corner[3];
    for (int k = 0; k < 3; k++) corner[k] = mesh->vertex[mesh->triangle[t][k]];
    stl_put_vector(sink, normal_of(corner));
    for (int k = 0; k < 3; k++) stl_put_vector(sink, vec3_sub(corner[k], origin));
    cloud_write_scalar(sink, &nothing, SCALAR_UINT16, ENCODING_BINARY);
}

enum status mesh_write_stl(int fd, const struct mesh *mesh, const struct cloud *cloud, struct left_out *left_out,
                           struct error *error) {
    char header[HEADER_BYTES];
    const vec3 origin = stl_choose_origin(mesh);
    struct sink sink;
    struct mesh_attributes attributes;
    if (mesh->triangle_count > UINT32_MAX)
        return error_set(error, STATUS_LIMIT, "write", "%zu triangles are more than STL can hold",
                         mesh->triangle_count);
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    mesh_attributes_find(mesh, cloud, &attributes);
    mesh_attributes_note(&attributes, cloud, "mesh.stl", NULL, false, left_out);
    stl_note(mesh, origin, left_out);
    stl_name(origin, header);
    uint32_t count = (uint32_t)mesh->triangle_count;
    sink_bytes(&sink, header, sizeof header);
    cloud_write_scalar(&sink, &count, SCALAR_UINT32, ENCODING_BINARY);
    for (size_t t = 0; t < mesh->triangle_count && !sink.failure; t++) put_facet(&sink, mesh, origin, t);
    return sink_done(&sink, STATUS_OK, error);
}
