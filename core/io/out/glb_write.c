/* Meshes, and points of a cloud, as binary glTF 2.0 (Khronos Group, 2021).
 *
 *     "glTF" 2 length | length "JSON" {...} blanks | length "BIN\0" views        lengths are uint32, of multiples of 4
 *
 * Every attribute is a column of the binary part: one view, one accessor, described by a row of the plan.  The JSON
 * text is made of the plan first, since its length comes before it; then each column is written from the mesh.
 *
 *     POSITION | NORMAL | COLOR_0 | TEXCOORD_0 | _NAME ... | indices
 *
 * A view of scalars of 1 or 2 bytes has a stride of 4, as the format demands.  Points have no indices.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/glb_write.h"

#include <ctype.h>
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/version.h"
#include "core/cloud/attribute_names.h"
#include "core/io/formats/glb_up.h"
#include "core/io/out/mesh_attributes.h"
#include "core/io/out/meshopt.h"
#include "core/io/out/write.h"

enum {
    GLB_HEADER_BYTES = 12,
    CHUNK_HEADER_BYTES = 8,
    JSON_FIXED_BYTES = 4096,
    JSON_COLUMN_BYTES = 1024,
    TYPE_I8 = 5120,
    TYPE_U16 = 5123,
    TYPE_U32 = 5125,
    TYPE_F32 = 5126,
    TARGET_VERTICES = 34962,
    TARGET_INDICES = 34963,
    MODE_POINTS = 0
};

enum column_kind { COLUMN_POSITION, COLUMN_NORMAL, COLUMN_COLOUR, COLUMN_TEXTURE, COLUMN_PROPERTY };

struct column {
    enum column_kind kind;
    const struct property *from; /* COLUMN_PROPERTY */
    char name[PROPERTY_NAME_BYTES + 8];
    const char *shape; /* "VEC3" ... */
    int type;          /* of the components */
    size_t stride;     /* bytes for each vertex */
    bool normalised;
};

struct plan {
    const struct mesh *mesh;
    struct mesh_attributes attributes;
    bool moved; /* positions are relative to origin */
    vec3 origin;
    bool points; /* without faces; y is upwards */
    enum up up;  /* which axis the node turns to y */
    struct glb_packing packing;
    double step; /* quantised: what a position's whole numbers are multiplied by, from origin on */
    /* Compressed: all columns, then the indices, one behind the other; each ends at end[i].  Owned. */
    struct sink packed;
    size_t end[CLOUD_MAX_PROPERTIES + 1];
    size_t count;
    struct column column[CLOUD_MAX_PROPERTIES];
};

/* ------------------------------------------------------------------------------------------------ plan */

static void find_box(const struct mesh *mesh, double low[3], double high[3]) {
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = INFINITY, high[axis] = -INFINITY;
        for (size_t v = 0; v < mesh->vertex_count; v++) {
            low[axis] = fmin(low[axis], (&mesh->vertex[v].x)[axis]);
            high[axis] = fmax(high[axis], (&mesh->vertex[v].x)[axis]);
        }
    }
}

static void glb_find_origin(struct plan *plan) {
    double low[3], high[3];
    plan->moved = !mesh_attributes_fit_f32(plan->mesh);
    if (!plan->moved) return;
    find_box(plan->mesh, low, high);
    for (int axis = 0; axis < 3; axis++) (&plan->origin.x)[axis] = low[axis] / 2 + high[axis] / 2;
}

/* Whole numbers of 16 bits from the lowest corner on, with the same step along all axes, which normals need. */
static void find_steps(struct plan *plan) {
    double low[3], high[3], most = 0;
    if (!plan->packing.quantized || !plan->mesh->vertex_count) return;
    find_box(plan->mesh, low, high);
    for (int axis = 0; axis < 3; axis++) most = fmax(most, high[axis] - low[axis]);
    plan->origin = (vec3){low[0], low[1], low[2]};
    plan->step = most > 0 ? most / UINT16_MAX : 1;
    plan->moved = true;
}

static float position_of(const struct plan *plan, size_t v, int axis) {
    double from = (&plan->mesh->vertex[v].x)[axis] - (&plan->origin.x)[axis];
    return (float)(plan->step > 0 ? nearbyint(from / plan->step) : from);
}

/* Whether all vertices have values that float32 holds. */
static bool is_single(const struct mesh_attributes *attributes, const struct property *property) {
    for (size_t v = 0; v < attributes->mesh->vertex_count; v++) {
        double value = scalar_load(mesh_attributes_record(attributes, v) + property->offset_bytes, property->type);
        if (!isnan(value) && (double)(float)value != value) return false;
    }
    return true;
}

/* glTF's code of a type, or 0 where an attribute can't have it. */
static int code_of(enum scalar_type type) {
    static const int codes[SCALAR_TYPE_COUNT] = {5120, 5121, 5122, TYPE_U16, 0, 0, TYPE_F32, 0};
    return codes[type];
}

/* That of a property.  Whole numbers of 32 bits and doubles, as labels are, go as float32 where nothing is lost. */
static int glb_code_of(const struct mesh_attributes *attributes, const struct property *property) {
    if (property->is_list) return 0;
    if (code_of(property->type)) return code_of(property->type);
    return is_single(attributes, property) ? TYPE_F32 : 0;
}

static bool glb_keeps(const struct mesh_attributes *attributes, const struct property *property) {
    return mesh_attributes_knows(attributes, property) || glb_code_of(attributes, property);
}

/* "_NAME": letters, digits and underscores, none twice. */
static void name_column(struct plan *plan, struct column *column) {
    size_t n = 0;
    column->name[n++] = '_';
    for (const char *c = column->from->name; *c; c++)
        column->name[n++] = isalnum((unsigned char)*c) ? (char)toupper((unsigned char)*c) : '_';
    for (size_t i = 0; i < plan->count; i++)
        if (strcmp(plan->column[i].name, column->name) == 0)
            snprintf(column->name + n, sizeof column->name - n, "_%zu", plan->count);
}

/* What viewers colour points by: other properties would multiply what they have to load. */
static bool is_shown(const struct property *property) {
    const char *name = attribute_usual_name(property->name);
    return name && (strcmp(name, "intensity") == 0 || strcmp(name, "classification") == 0);
}

static void glb_add_properties(struct plan *plan) {
    const struct cloud *cloud = plan->attributes.cloud;
    for (size_t j = 0; cloud && j < cloud->property_count && plan->count < CLOUD_MAX_PROPERTIES; j++) {
        const struct property *property = &cloud->property[j];
        if (cloud_axis_of(cloud, j) >= 0 || mesh_attributes_knows(&plan->attributes, property)) continue;
        if (plan->points && !is_shown(property)) continue;
        int code = glb_code_of(&plan->attributes, property);
        if (!code) continue;
        struct column column = {COLUMN_PROPERTY, property, "", "SCALAR", code, 4, false};
        name_column(plan, &column);
        plan->column[plan->count++] = column;
    }
}

static void add_columns(struct plan *plan) {
    bool whole = plan->packing.quantized;
    find_steps(plan);
    plan->column[plan->count++] =
        (struct column){COLUMN_POSITION, NULL, "POSITION", "VEC3", whole ? TYPE_U16 : TYPE_F32, whole ? 8 : 12, false};
    if (plan->attributes.normal[0])
        plan->column[plan->count++] =
            (struct column){COLUMN_NORMAL, NULL, "NORMAL", "VEC3", whole ? TYPE_I8 : TYPE_F32, whole ? 4 : 12, whole};
    if (plan->attributes.colour[0])
        plan->column[plan->count++] = (struct column){COLUMN_COLOUR, NULL, "COLOR_0", "VEC4", TYPE_U16, 8, true};
    if (plan->attributes.texture[0])
        plan->column[plan->count++] = (struct column){COLUMN_TEXTURE, NULL, "TEXCOORD_0", "VEC2", TYPE_F32, 8, false};
    glb_add_properties(plan);
}

static void plan_mesh(struct plan *plan, const struct mesh *mesh, const struct cloud *cloud,
                      const struct glb_packing *packing) {
    *plan = (struct plan){.mesh = mesh, .packing = *packing};
    mesh_attributes_find(mesh, cloud, &plan->attributes);
    glb_find_origin(plan);
    add_columns(plan);
}

/* Of all views as they are when they have been read. */
static uint64_t plain_bytes(const struct plan *plan) {
    uint64_t bytes = (uint64_t)plan->mesh->triangle_count * 12;
    for (size_t i = 0; i < plan->count; i++) bytes += (uint64_t)plan->mesh->vertex_count * plan->column[i].stride;
    return bytes;
}

static uint64_t binary_bytes(const struct plan *plan) {
    return plan->packing.compressed ? (plan->packed.used + 3) / 4 * 4 : plain_bytes(plan);
}

/* ------------------------------------------------------------------------------------------------ JSON */

struct text {
    char *bytes; /* owned */
    size_t used, capacity;
};

static void __attribute__((format(printf, 2, 3))) add(struct text *text, const char *format, ...) {
    va_list args;
    va_start(args, format);
    int n = vsnprintf(text->bytes + text->used, text->capacity - text->used, format, args);
    va_end(args);
    if (n > 0) text->used += (size_t)n;
}

static void add_bounds(struct text *text, const struct plan *plan) {
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (size_t v = 0; v < plan->mesh->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++) {
            low[axis] = fminf(low[axis], position_of(plan, v, axis));
            high[axis] = fmaxf(high[axis], position_of(plan, v, axis));
        }
    add(text, ",\"min\":[%.17g,%.17g,%.17g],\"max\":[%.17g,%.17g,%.17g]", (double)low[0], (double)low[1],
        (double)low[2], (double)high[0], (double)high[1], (double)high[2]);
}

static void add_accessors(struct text *text, const struct plan *plan) {
    add(text, "\"accessors\":[");
    for (size_t i = 0; i < plan->count; i++) {
        const struct column *column = &plan->column[i];
        add(text, "%s{\"bufferView\":%zu,\"componentType\":%d,%s\"count\":%zu,\"type\":\"%s\"", i ? "," : "", i,
            column->type, column->normalised ? "\"normalized\":true," : "", plan->mesh->vertex_count, column->shape);
        if (column->kind == COLUMN_POSITION) add_bounds(text, plan);
        add(text, "}");
    }
    if (!plan->points)
        add(text, ",{\"bufferView\":%zu,\"componentType\":%d,\"count\":%zu,\"type\":\"SCALAR\"}", plan->count, TYPE_U32,
            plan->mesh->triangle_count * 3);
    add(text, "],");
}

/* What a view of the plain bytes is made of. */
static void add_packed(struct text *text, const struct plan *plan, size_t i, size_t stride, size_t n,
                       const char *mode) {
    size_t from = i ? plan->end[i - 1] : 0;
    if (plan->packing.compressed)
        add(text,
            ",\"extensions\":{\"EXT_meshopt_compression\":{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu,"
            "\"byteStride\":%zu,\"mode\":\"%s\",\"count\":%zu}}",
            from, plan->end[i] - from, stride, mode, n);
}

static void add_views(struct text *text, const struct plan *plan) {
    uint64_t at = 0;
    int buffer = plan->packing.compressed;
    const struct mesh *mesh = plan->mesh;
    add(text, "\"bufferViews\":[");
    for (size_t i = 0; i < plan->count; i++) {
        size_t stride = plan->column[i].stride;
        uint64_t bytes = (uint64_t)mesh->vertex_count * stride;
        add(text, "%s{\"buffer\":%d,\"byteOffset\":%llu,\"byteLength\":%llu,\"byteStride\":%zu,\"target\":%d",
            i ? "," : "", buffer, (unsigned long long)at, (unsigned long long)bytes, stride, TARGET_VERTICES);
        add_packed(text, plan, i, stride, mesh->vertex_count, "ATTRIBUTES");
        add(text, "}");
        at += bytes;
    }
    if (!plan->points) {
        add(text, ",{\"buffer\":%d,\"byteOffset\":%llu,\"byteLength\":%llu,\"target\":%d", buffer,
            (unsigned long long)at, (unsigned long long)mesh->triangle_count * 12, TARGET_INDICES);
        add_packed(text, plan, plan->count, 4, 3 * mesh->triangle_count, "INDICES");
        add(text, "}");
    }
    add(text, "],\"buffers\":[{\"byteLength\":%llu}", (unsigned long long)binary_bytes(plan));
    if (plan->packing.compressed)
        add(text, ",{\"byteLength\":%llu,\"extensions\":{\"EXT_meshopt_compression\":{\"fallback\":true}}}",
            (unsigned long long)plain_bytes(plan));
    add(text, "]");
}

/* The extensions that are used, and those without which nothing is seen. */
static void add_extensions(struct text *text, const struct plan *plan, bool unlit) {
    const char *compressed = plan->packing.compressed ? "\"EXT_meshopt_compression\"" : "";
    const char *quantized = plan->packing.quantized ? "\"KHR_mesh_quantization\"" : "";
    const char *between = *compressed && *quantized ? "," : "";
    bool required = *compressed || *quantized;
    if (required) add(text, "\"extensionsRequired\":[%s%s%s],", compressed, between, quantized);
    if (required || unlit)
        add(text, "\"extensionsUsed\":[%s%s%s%s%s],", compressed, between, quantized, required && unlit ? "," : "",
            unlit ? "\"KHR_materials_unlit\"" : "");
}

/* As a point with this axis upwards stands with y upwards; x goes on to the right where it can. */
static vec3 turn_y_up(vec3 p, enum up up) {
    return up == UP_Z ? (vec3){p.x, p.z, -p.y} : up == UP_X ? (vec3){-p.y, p.x, p.z} : p;
}

/* What the node does to positions, column by column, and the mark that it turns them. */
static void add_turn(struct text *text, const struct plan *plan) {
    double step = plan->step > 0 ? plan->step : 1;
    const vec3 column[4] = {{step, 0, 0}, {0, step, 0}, {0, 0, step}, plan->origin};
    add(text, ",\"matrix\":[");
    for (int k = 0; k < 4; k++) {
        vec3 turned = turn_y_up(column[k], plan->up);
        add(text, "%s%.17g,%.17g,%.17g,%d", k ? "," : "", turned.x + 0.0, turned.y + 0.0, turned.z + 0.0, k == 3);
    }
    add(text, "],\"extras\":{\"" GLB_UP_MARK "\":\"%s\"}", plan->up == UP_X ? "x" : "z");
}

static void add_place(struct text *text, const struct plan *plan) {
    if (plan->moved) add(text, ",\"translation\":[%.17g,%.17g,%.17g]", plan->origin.x, plan->origin.y, plan->origin.z);
    if (plan->step > 0) add(text, ",\"scale\":[%.17g,%.17g,%.17g]", plan->step, plan->step, plan->step);
}

static void add_mesh(struct text *text, const struct plan *plan) {
    add(text, "\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0");
    plan->up == UP_X || plan->up == UP_Z ? add_turn(text, plan) : add_place(text, plan);
    bool unlit = plan->points && !plan->attributes.normal[0];
    add(text, "}],\"materials\":[{\"pbrMetallicRoughness\":{\"metallicFactor\":0}%s}],",
        unlit          ? ",\"extensions\":{\"KHR_materials_unlit\":{}}"
        : plan->points ? ""
                       : ",\"doubleSided\":true");
    add_extensions(text, plan, unlit);
    add(text, "\"meshes\":[{\"primitives\":[{\"attributes\":{");
    for (size_t i = 0; i < plan->count; i++) add(text, "%s\"%s\":%zu", i ? "," : "", plan->column[i].name, i);
    if (plan->points)
        add(text, "},\"mode\":%d,\"material\":0}]}],", MODE_POINTS);
    else
        add(text, "},\"indices\":%zu,\"material\":0}]}],", plan->count);
}

static bool has_content(const struct plan *plan) { return plan->points || plan->mesh->triangle_count > 0; }

/* The whole text, filled up with blanks to a multiple of four; bytes NULL: no memory. */
static struct text make_json(const struct plan *plan) {
    struct text text = {.capacity = JSON_FIXED_BYTES + (plan->count + 1) * JSON_COLUMN_BYTES};
    text.bytes = alloc_array(text.capacity, 1);
    if (!text.bytes) return text;
    add(&text, "{\"asset\":{\"version\":\"2.0\",\"generator\":\"whittle %s\"}", whittle_version());
    if (has_content(plan)) {
        add(&text, ",");
        add_mesh(&text, plan);
        add_accessors(&text, plan);
        add_views(&text, plan);
    }
    add(&text, "}");
    while (text.used % 4) add(&text, " ");
    return text;
}

/* ------------------------------------------------------------------------------------------------ columns */

static void put_u32(struct sink *sink, uint32_t value) {
    cloud_write_scalar(sink, &value, SCALAR_UINT32, ENCODING_BINARY);
}

static void put_f32(struct sink *sink, float value) {
    cloud_write_scalar(sink, &value, SCALAR_FLOAT32, ENCODING_BINARY);
}

/* As it is where it is about a unit long, as the format requires; else made so. */
static void put_normal(struct sink *sink, const struct plan *plan, vec3 n) {
    double length = vec3_length(n);
    if (!(length > 0) || !isfinite(length)) n = (vec3){0, 0, 1}, length = 1;
    if (fabs(length - 1) > 1e-3) n = vec3_scale(n, 1 / length);
    if (!plan->packing.quantized) {
        put_f32(sink, (float)n.x), put_f32(sink, (float)n.y), put_f32(sink, (float)n.z);
        return;
    }
    const int8_t whole[4] = {(int8_t)nearbyint(n.x * INT8_MAX), (int8_t)nearbyint(n.y * INT8_MAX),
                             (int8_t)nearbyint(n.z * INT8_MAX), 0};
    sink_bytes(sink, whole, sizeof whole);
}

static void put_position(struct sink *sink, const struct plan *plan, size_t v) {
    uint16_t whole[4] = {0};
    for (int axis = 0; axis < 3; axis++) {
        if (!plan->packing.quantized)
            put_f32(sink, position_of(plan, v, axis));
        else
            whole[axis] = (uint16_t)position_of(plan, v, axis);
    }
    for (int k = 0; plan->packing.quantized && k < 4; k++)
        cloud_write_scalar(sink, &whole[k], SCALAR_UINT16, ENCODING_BINARY);
}

/* From sRGB (IEC 61966-2-1) to linear. */
static double linear(double value) { return value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4); }

static void glb_put_colour(struct sink *sink, const double rgba[4]) {
    for (int k = 0; k < 4; k++) {
        uint16_t value = (uint16_t)nearbyint((k < 3 ? linear(rgba[k]) : rgba[k]) * UINT16_MAX);
        cloud_write_scalar(sink, &value, SCALAR_UINT16, ENCODING_BINARY);
    }
}

/* glTF's pictures begin at the top, others' at the bottom. */
static void put_texture_place(struct sink *sink, const double st[2]) {
    put_f32(sink, isfinite(st[0]) ? (float)st[0] : 0);
    put_f32(sink, isfinite(st[1]) ? (float)(1 - st[1]) : 0);
}

static void put_property(struct sink *sink, const struct property *property, const unsigned char *record) {
    static const uint8_t nothing;
    if (!code_of(property->type)) {
        put_f32(sink, (float)scalar_load(record + property->offset_bytes, property->type));
        return;
    }
    cloud_write_scalar(sink, record + property->offset_bytes, property->type, ENCODING_BINARY);
    for (size_t i = scalar_bytes(property->type); i < 4; i++)
        cloud_write_scalar(sink, &nothing, SCALAR_UINT8, ENCODING_BINARY);
}

static void put_cell(struct sink *sink, const struct plan *plan, const struct column *column, size_t v) {
    double rgba[4], st[2];
    switch (column->kind) {
    case COLUMN_POSITION: put_position(sink, plan, v); break;
    case COLUMN_NORMAL: {
        vec3 n = mesh_attributes_normal(&plan->attributes, v);
        put_normal(sink, plan, plan->points ? turn_y_up(n, UP_Z) : n);
        break;
    }
    case COLUMN_COLOUR:
        mesh_attributes_colour(&plan->attributes, v, rgba);
        glb_put_colour(sink, rgba);
        break;
    case COLUMN_TEXTURE:
        mesh_attributes_texture(&plan->attributes, v, st);
        put_texture_place(sink, st);
        break;
    case COLUMN_PROPERTY: put_property(sink, column->from, mesh_attributes_record(&plan->attributes, v)); break;
    }
}

static void put_column(struct sink *sink, const struct plan *plan, const struct column *column) {
    for (size_t v = 0; v < plan->mesh->vertex_count && !sink->failure; v++) put_cell(sink, plan, column, v);
}

static void put_binary(struct sink *sink, const struct plan *plan) {
    static const unsigned char nothing[3];
    const struct mesh *mesh = plan->mesh;
    if (plan->packing.compressed) {
        sink_bytes(sink, plan->packed.buffer, plan->packed.used);
        sink_bytes(sink, nothing, binary_bytes(plan) - plan->packed.used);
        return;
    }
    for (size_t i = 0; i < plan->count; i++) put_column(sink, plan, &plan->column[i]);
    for (size_t t = 0; t < mesh->triangle_count && !sink->failure; t++)
        for (int k = 0; k < 3; k++) put_u32(sink, mesh->triangle[t][k]);
}

/* Compresses all views, where that is asked for. */
static enum status pack(struct plan *plan) {
    struct sink plain;
    if (!plan->packing.compressed || !has_content(plan)) {
        plan->packing.compressed = false;
        return STATUS_OK;
    }
    if (sink_init_memory(&plan->packed)) return STATUS_NO_MEMORY;
    enum status status = sink_init_memory(&plain);
    for (size_t i = 0; i < plan->count && !status; i++) {
        sink_restart(&plain);
        put_column(&plain, plan, &plan->column[i]);
        if (plain.failure) status = STATUS_NO_MEMORY;
        if (!status)
            meshopt_put_attributes(&plan->packed, plain.buffer, plan->mesh->vertex_count, plan->column[i].stride);
        plan->end[i] = plan->packed.used;
    }
    if (!status && !plan->points)
        meshopt_put_indices(&plan->packed, &plan->mesh->triangle[0][0], 3 * plan->mesh->triangle_count);
    plan->end[plan->count] = plan->packed.used;
    free(plain.buffer);
    return status || plan->packed.failure ? STATUS_NO_MEMORY : STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static void glb_note(const struct plan *plan, const struct cloud *cloud, struct left_out *left_out) {
    bool rounded = false;
    mesh_attributes_note(&plan->attributes, cloud, "mesh.glb", glb_keeps, false, left_out);
    if (plan->step > 0)
        left_out_add(left_out, "mesh.glb", "precision: coordinates are whole numbers of 16 bits, off by up to %.2g",
                     plan->step / 2);
    for (size_t v = 0; plan->moved && !(plan->step > 0) && !rounded && v < plan->mesh->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++)
            rounded = rounded ||
                      (double)position_of(plan, v, axis) + (&plan->origin.x)[axis] != (&plan->mesh->vertex[v].x)[axis];
    if (rounded)
        left_out_add(left_out, "mesh.glb",
                     "precision: coordinates are float32 around %.10g %.10g %.10g, off by up to %.2g", plan->origin.x,
                     plan->origin.y, plan->origin.z, mesh_attributes_f32_error(plan->mesh, plan->origin));
}

static uint64_t whole_bytes(const struct plan *plan, const struct text *json) {
    uint64_t binary = has_content(plan) ? binary_bytes(plan) : 0;
    return GLB_HEADER_BYTES + CHUNK_HEADER_BYTES + json->used + (binary ? CHUNK_HEADER_BYTES + binary : 0);
}

static void put_chunk_header(struct sink *sink, size_t bytes, const char type[4]) {
    put_u32(sink, (uint32_t)bytes);
    sink_bytes(sink, type, 4);
}

static void put_whole(struct sink *sink, const struct plan *plan, const struct text *json) {
    uint64_t binary = has_content(plan) ? binary_bytes(plan) : 0;
    sink_text(sink, "glTF");
    put_u32(sink, 2);
    put_u32(sink, (uint32_t)whole_bytes(plan, json));
    put_chunk_header(sink, json->used, "JSON");
    sink_bytes(sink, json->bytes, json->used);
    if (binary) put_chunk_header(sink, binary, "BIN\0");
    if (binary) put_binary(sink, plan);
}

enum status mesh_write_glb(int fd, const struct mesh *mesh, const struct cloud *cloud,
                           const struct glb_packing *packing, enum up up, struct left_out *left_out,
                           struct error *error) {
    struct plan plan;
    struct sink sink = {0};
    struct text json = {0};
    plan_mesh(&plan, mesh, cloud, packing);
    plan.up = up;
    enum status status = pack(&plan);
    if (!status) json = make_json(&plan);
    if (status || !json.bytes || sink_init(&sink, fd))
        status = error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    else if (whole_bytes(&plan, &json) > UINT32_MAX || mesh->vertex_count >= UINT32_MAX)
        status = error_set(error, STATUS_LIMIT, "write", "the mesh is larger than the 4 GiB that glTF can hold");
    if (!status) {
        glb_note(&plan, cloud, left_out);
        put_whole(&sink, &plan, &json);
    }
    free(json.bytes), free(plan.packed.buffer);
    return sink_done(&sink, status, error);
}

/* ------------------------------------------------------------------------------------------------ points */

static bool glb_shows(const struct mesh_attributes *attributes, const struct property *property) {
    return mesh_attributes_knows(attributes, property) || is_shown(property);
}

void cloud_glb_note(const struct glb_points *points, const char *where, struct left_out *left_out) {
    mesh_attributes_note(points->attributes, points->attributes->cloud, where, glb_shows, true, left_out);
}

enum status cloud_put_glb(struct sink *sink, const struct glb_points *points) {
    vec3 *place = alloc_array(points->n, sizeof *place);
    if (!place) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < points->n; i++) place[i] = turn_y_up(points->position[i], UP_Z);
    const struct mesh mesh = {.vertex_count = points->n, .vertex = place, .source = (uint32_t *)(uintptr_t)points->ids};
    struct plan plan = {.mesh = &mesh, .attributes = *points->attributes, .points = true, .moved = true};
    struct text json = {0};
    plan.packing = points->packing;
    plan.attributes.mesh = &mesh;
    plan.origin = turn_y_up(points->centre, UP_Z);
    add_columns(&plan);
    enum status status = pack(&plan);
    if (!status) json = make_json(&plan);
    if (!json.bytes) status = STATUS_NO_MEMORY;
    if (!status && whole_bytes(&plan, &json) > UINT32_MAX) status = STATUS_LIMIT;
    if (!status) put_whole(sink, &plan, &json);
    free(json.bytes), free(place), free(plan.packed.buffer);
    return status;
}
