/* Meshes as OBJ.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/obj_write.h"

#include <stdbool.h>

#include "core/io/out/mesh_attributes.h"
#include "core/io/out/sink.h"
#include "core/text/number.h"

static void obj_put_number(struct sink *sink, double value, bool narrow) {
    char *to = (char *)sink_reserve(sink, NUMBER_TEXT_BYTES + 1);
    to[0] = ' ';
    sink_advance(sink, 1 + (narrow ? number_format_f32(to + 1, (float)value) : number_format_f64(to + 1, value)));
}

static void obj_put_vector(struct sink *sink, const char *word, vec3 p, bool narrow) {
    sink_text(sink, word);
    obj_put_number(sink, p.x, narrow);
    obj_put_number(sink, p.y, narrow);
    obj_put_number(sink, p.z, narrow);
}

static void put_vertices(struct sink *sink, const struct mesh *mesh, const struct mesh_attributes *attributes,
                         bool narrow) {
    for (size_t v = 0; v < mesh->vertex_count && !sink->failure; v++) {
        double rgba[4];
        obj_put_vector(sink, "v", mesh->vertex[v], narrow);
        if (attributes->colour[0]) {
            mesh_attributes_colour(attributes, v, rgba);
            for (int k = 0; k < 3; k++) obj_put_number(sink, rgba[k], true);
        }
        sink_text(sink, "\n");
    }
    for (size_t v = 0; attributes->normal[0] && v < mesh->vertex_count && !sink->failure; v++) {
        obj_put_vector(sink, "vn", mesh_attributes_normal(attributes, v),
                       attributes->normal[0]->type == SCALAR_FLOAT32);
        sink_text(sink, "\n");
    }
}

static void put_texture(struct sink *sink, const struct mesh *mesh, const struct mesh_attributes *attributes) {
    bool narrow = attributes->texture[0] && attributes->texture[0]->type == SCALAR_FLOAT32;
    for (size_t v = 0; attributes->texture[0] && v < mesh->vertex_count && !sink->failure; v++) {
        double st[2];
        mesh_attributes_texture(attributes, v, st);
        sink_text(sink, "vt");
        for (int k = 0; k < 2; k++) obj_put_number(sink, st[k], narrow);
        sink_text(sink, "\n");
    }
}

static void put_triangles(struct sink *sink, const struct mesh *mesh, bool texture, bool normals) {
    int tag = -1;
    for (size_t t = 0; t < mesh->triangle_count && !sink->failure; t++) {
        if (mesh->tag && mesh->tag[t] != tag) {
            tag = mesh->tag[t];
            sink_text(sink, tag == MESH_HOLE_FILL ? "g hole_fill\n" : "g surface\n");
        }
        sink_text(sink, "f");
        for (int k = 0; k < 3; k++) {
            unsigned long id = (unsigned long)mesh->triangle[t][k] + 1;
            sink_format(sink, " %lu", id);
            if (texture) sink_format(sink, "/%lu", id);
            if (normals) sink_format(sink, texture ? "/%lu" : "//%lu", id);
        }
        sink_text(sink, "\n");
    }
}

static bool obj_keeps(const struct mesh_attributes *attributes, const struct property *property) {
    return mesh_attributes_knows(attributes, property) && property != attributes->colour[3];
}

enum status mesh_write_obj(int fd, const struct mesh *mesh, const struct cloud *cloud, struct left_out *left_out,
                           struct error *error) {
    struct sink sink;
    struct mesh_attributes attributes;
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    mesh_attributes_find(mesh, cloud, &attributes);
    mesh_attributes_note(&attributes, cloud, "mesh.obj", obj_keeps, true, left_out);
    bool narrow = mesh_attributes_fit_f32(mesh) && cloud;
    for (int axis = 0; narrow && axis < 3; axis++) narrow = cloud->property[cloud->xyz[axis]].type == SCALAR_FLOAT32;
    put_vertices(&sink, mesh, &attributes, narrow);
    put_texture(&sink, mesh, &attributes);
    put_triangles(&sink, mesh, attributes.texture[0] != NULL, attributes.normal[0] != NULL);
    return sink_done(&sink, STATUS_OK, error);
}
