/* Meshes as PLY.
 *
 * What a vertex record is made of is decided once, as a list of columns; then each vertex is written column by column.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/ply_write.h"

#include <assert.h>
#include <stdbool.h>
#include <string.h>

#include "core/io/out/write.h"

struct column {
    const char *name;
    enum scalar_type type;
    int axis;                    /* 0, 1, 2, or -1 */
    const struct property *from; /* of the cloud; NULL: from the mesh's position alone */
};

struct layout {
    const struct cloud *cloud; /* NULL: no vertex has a source */
    size_t columns;
    struct column column[CLOUD_MAX_PROPERTIES];
};

/* Whether vertex i stands where its point does. */
static bool is_at_source(const struct mesh *mesh, const struct cloud *cloud, size_t i) {
    uint32_t source = mesh->source[i];
    return source != NONE && vec3_equal(mesh->vertex[i], cloud->position[source]);
}

static bool all_at_source(const struct mesh *mesh, const struct cloud *cloud) {
    for (size_t i = 0; i < mesh->vertex_count; i++)
        if (!is_at_source(mesh, cloud, i)) return false;
    return true;
}

static bool ply_all_have_source(const struct mesh *mesh) {
    for (size_t i = 0; i < mesh->vertex_count; i++)
        if (mesh->source[i] == NONE) return false;
    return true;
}

static void lay_out_positions(struct layout *layout) {
    static const char *const names[3] = {"x", "y", "z"};
    layout->columns = 3;
    for (int axis = 0; axis < 3; axis++)
        layout->column[axis] = (struct column){names[axis], SCALAR_FLOAT64, axis, NULL};
}

static bool has_integer_positions(const struct cloud *cloud) {
    for (int axis = 0; axis < 3; axis++)
        if (cloud->property[cloud->xyz[axis]].type < SCALAR_FLOAT32) return true;
    return false;
}

static void lay_out_from_cloud(struct layout *layout, const struct mesh *mesh, const struct cloud *cloud) {
    bool all = ply_all_have_source(mesh), widen = has_integer_positions(cloud) && !all_at_source(mesh, cloud);
    layout->cloud = cloud;
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *from = &cloud->property[j];
        int axis = cloud_axis_of(cloud, j);
        if (from->is_list || (axis < 0 && !all)) continue;
        enum scalar_type type = axis >= 0 && widen ? SCALAR_FLOAT64 : from->type;
        layout->column[layout->columns++] = (struct column){from->name, type, axis, from};
    }
}

static void ply_put_header(struct sink *sink, const struct mesh *mesh, const struct layout *layout, bool tags,
                           enum encoding encoding) {
    cloud_write_ply_start(sink, layout->cloud ? layout->cloud->comments : NULL, encoding);
    sink_format(sink, "element vertex %zu\n", mesh->vertex_count);
    for (size_t j = 0; j < layout->columns; j++)
        sink_format(sink, "property %s %s\n", cloud_write_type_name(layout->column[j].type), layout->column[j].name);
    sink_format(sink, "element face %zu\nproperty list uchar int vertex_indices\n", mesh->triangle_count);
    sink_text(sink, tags ? "property uchar hole_fill\nend_header\n" : "end_header\n");
}

static void put_vertex(struct sink *sink, const struct mesh *mesh, const struct layout *layout, size_t i,
                       enum encoding encoding) {
    const struct cloud *cloud = layout->cloud;
    bool at_source = cloud && is_at_source(mesh, cloud, i);
    const unsigned char *record =
        cloud && mesh->source[i] != NONE ? cloud->record + mesh->source[i] * cloud->record_bytes : NULL;
    double position[3] = {mesh->vertex[i].x, mesh->vertex[i].y, mesh->vertex[i].z};
    for (size_t j = 0; j < layout->columns; j++) {
        const struct column *column = &layout->column[j];
        bool original = column->axis < 0 || (at_source && column->type == column->from->type);
        unsigned char scalar[8];
        if (!original) scalar_store(scalar, column->type, position[column->axis]);
        cloud_write_scalar(sink, original ? record + column->from->offset_bytes : scalar, column->type, encoding);
    }
    cloud_write_end_record(sink, encoding);
}

static void put_triangle(struct sink *sink, const struct mesh *mesh, size_t t, bool tags, enum encoding encoding) {
    const uint8_t three = 3, tag = tags && mesh->tag[t] == MESH_HOLE_FILL;
    cloud_write_scalar(sink, &three, SCALAR_UINT8, encoding);
    for (int k = 0; k < 3; k++) {
        assert(mesh->triangle[t][k] < mesh->vertex_count);
        cloud_write_scalar(sink, &mesh->triangle[t][k], SCALAR_INT32, encoding);
    }
    if (tags) cloud_write_scalar(sink, &tag, SCALAR_UINT8, encoding);
    cloud_write_end_record(sink, encoding);
}

static bool has_hole_fill(const struct mesh *mesh) {
    for (size_t t = 0; mesh->tag && t < mesh->triangle_count; t++)
        if (mesh->tag[t] == MESH_HOLE_FILL) return true;
    return false;
}

enum status mesh_write_ply(int fd, const struct mesh *mesh, const struct cloud *cloud, enum encoding encoding,
                           struct error *error) {
    if (mesh->vertex_count > INT32_MAX)
        return error_set(error, STATUS_LIMIT, "write", "%zu vertices, at most %d can be written", mesh->vertex_count,
                         INT32_MAX);
    struct sink sink;
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    struct layout layout = {0};
    if (cloud && mesh->source)
        lay_out_from_cloud(&layout, mesh, cloud);
    else
        lay_out_positions(&layout);
    bool tags = has_hole_fill(mesh);
    ply_put_header(&sink, mesh, &layout, tags, encoding);
    for (size_t i = 0; i < mesh->vertex_count && !sink.failure; i++) put_vertex(&sink, mesh, &layout, i, encoding);
    for (size_t t = 0; t < mesh->triangle_count && !sink.failure; t++) put_triangle(&sink, mesh, t, tags, encoding);
    return sink_done(&sink, STATUS_OK, error);
}
