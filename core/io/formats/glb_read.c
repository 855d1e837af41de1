/* Binary glTF 2.0 (Khronos Group, 2021).
 *
 *     "glTF" 2 length | length "JSON" {...} | [length "BIN\0" bytes]      lengths are uint32, little endian
 *
 * A scene is a tree of nodes with transforms; a node may have a mesh, a mesh has primitives, and those name accessors
 * (columns of numbers in the binary part) by what they are of: POSITION, NORMAL, COLOR_0, TEXCOORD_0, _NAME, indices.
 * All primitives of the scene become one cloud, at the places that their nodes give them; where all have float32
 * positions and no node moves any, coordinates are float32, else float64.  A node that whittle wrote to turn another
 * axis to glTF's y (GLB_UP_MARK) is undone.  Attributes that all primitives have are
 * kept: normals (turned with their nodes), colours as 8 bits of sRGB (glTF has linear ones), texture coordinates with
 * their origin at the bottom (glTF's is at the top), and scalars of "_NAME" as name.  Triangles, strips and fans become
 * triangles; primitives beside each other with the same columns share their points.
 *
 * What is compressed (EXT_meshopt_compression, KHR_draco_mesh_compression), sparse or in other files is refused with a
 * word about it; KHR_mesh_quantization is nothing but other types of numbers.
 *
 * Invariants: a column is looked up whole, so its cells are in the file; each node is visited once; there are at most
 * as many points as bytes, though instances of a mesh may make more points than the file has.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"

#include <ctype.h>
#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"
#include "core/io/build.h"
#include "core/io/first_bytes.h"
#include "core/io/formats/glb_up.h"
#include "core/params.h"

enum {
    HEADER = 12,
    CHUNK = 8,
    CHUNK_JSON = 0x4e4f534a,
    CHUNK_BIN = 0x004e4942,
    DEEPEST_NODE = 64,
    EXTRAS_MOST = 64 /* columns of _NAME */
};
/* What the JSON takes once it is read, at most: for each array or object, each quote, each comma or colon, each byte;
 * and in all. */
enum { OPENING_BYTES = 256, QUOTE_BYTES = 40, SEPARATOR_BYTES = 48, TEXT_BYTES = 2, SCENE_MOST_BYTES = 512 << 20 };
enum { GLTF_POINTS = 0, GLTF_TRIANGLES = 4, GLTF_STRIP = 5, GLTF_FAN = 6 };

/* 3 rows of 4: what a point (x, y, z, 1) is multiplied by. */
struct transform {
    double row[3][4];
};
static const struct transform STILL = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};

/* A column of numbers. */
struct column {
    const unsigned char *at; /* of the first cell */
    size_t stride;
    uint64_t count;
    enum scalar_type type;
    int width; /* numbers in a cell */
    bool normalised;
};

enum table { ACCESSORS, VIEWS, BUFFERS, NODES, MESHES, TABLES };
static const char *const table_names[TABLES] = {"accessors", "bufferViews", "buffers", "nodes", "meshes"};

/* A primitive where a node has it. */
struct instance {
    const json_t *primitive;
    struct transform place;
};

struct extra {
    char name[PROPERTY_NAME_BYTES], attribute[PROPERTY_NAME_BYTES];
    enum scalar_type type;
};

struct reader {
    struct cloud_build build;
    const unsigned char *bytes;
    size_t n;
    json_t *json; /* owned */
    const unsigned char *bin;
    size_t bin_bytes;
    const json_t *table[TABLES]; /* arrays of the JSON, NULL where it has none */
    uint8_t *visited;            /* of each node; owned */
    struct instance *instance;
    size_t instances, instance_room;
    uint64_t points; /* of all instances, at most */
    bool wide;       /* coordinates are float64 */
    bool normal, colour, alpha, texture;
    struct extra extra[EXTRAS_MOST];
    size_t extras;
};

static enum status glb_bad(struct reader *r, const char *where, const char *what, uint64_t which) {
    return cloud_build_bad(&r->build, where, (struct cloud_place){0, HEADER}, what, which);
}

static enum status glb_refuse(struct reader *r, const char *where, const char *what) {
    return error_set_at(r->build.error, STATUS_UNSUPPORTED, where, 0, HEADER, "%s", what);
}

/* ------------------------------------------------------------------------------------------------ chunks, tables */

/* The memory that the JSON takes at most, counted before any of it is there: what is nested and tiny takes eighty times
 * its text. */
static uint64_t scene_bytes(const char *text, size_t n) {
    uint64_t bytes = 1 << 12;
    for (size_t i = 0; i < n; i++) {
        char c = text[i];
        bytes += TEXT_BYTES;
        if (c == '{' || c == '[') bytes += OPENING_BYTES;
        if (c == '"') bytes += QUOTE_BYTES;
        if (c == ',' || c == ':') bytes += SEPARATOR_BYTES;
    }
    return bytes;
}

/* Not all that isn't read is no JSON. */
static const char *json_fault(enum json_error_code code) {
    switch (code) {
    case json_error_stack_overflow: return "its arrays and objects are nested too deeply";
    case json_error_numeric_overflow: return "a number is too large for float64";
    case json_error_null_byte_in_key: return "a name has a NUL";
    default: return "this is no JSON";
    }
}

/* The library may take a string for another where it can't have memory for a byte of it, so whether there is enough is
 * asked beforehand. */
static enum status parse_scene(struct reader *r, size_t at, size_t n) {
    const char *text = (const char *)r->bytes + at;
    uint64_t bytes = scene_bytes(text, n);
    json_error_t wrong;
    if (bytes > SCENE_MOST_BYTES)
        return error_set_at(r->build.error, STATUS_LIMIT, "JSON", 0, at, "a scene of that many parts isn't read");
    void *room = alloc_array((size_t)bytes, 1);
    if (!room) return error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for what the scene says");
    free(room);
    r->json = json_loadb(text, n, JSON_DECODE_INT_AS_REAL | JSON_ALLOW_NUL, &wrong);
    if (r->json) return STATUS_OK;
    if (json_error_code(&wrong) == json_error_out_of_memory)
        return error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for what the scene says");
    return cloud_build_bad(&r->build, "JSON", (struct cloud_place){0, at + (size_t)wrong.position}, "%s",
                           json_fault(json_error_code(&wrong)));
}

static enum status find_chunks(struct reader *r) {
    size_t at = HEADER;
    uint64_t length = r->n >= HEADER ? load_little_endian(r->bytes + 8, 4) : 0;
    if (r->n < HEADER || length > r->n || length < HEADER)
        return cloud_build_bad(&r->build, "length", (struct cloud_place){0, 8},
                               "%" PRIu64 " bytes are promised, %zu bytes are there", length, r->n);
    if (load_little_endian(r->bytes + 4, 4) != 2) return glb_refuse(r, "version", "glTF of another version than 2");
    for (size_t chunk = 0; at + CHUNK <= length; chunk++) {
        uint64_t bytes = load_little_endian(r->bytes + at, 4), type = load_little_endian(r->bytes + at + 4, 4);
        at += CHUNK;
        if (bytes > length - at)
            return cloud_build_bad(&r->build, "chunk", (struct cloud_place){0, at - CHUNK},
                                   "%" PRIu64 " bytes are promised, %" PRIu64 " are left", bytes, length - at);
        if (chunk == 0) {
            if (type != CHUNK_JSON) return glb_bad(r, "chunk", "the first one isn't JSON, but %#" PRIx64, type);
            enum status status = parse_scene(r, at, (size_t)bytes);
            if (status) return status;
        } else if (type == CHUNK_BIN && !r->bin) {
            r->bin = r->bytes + at, r->bin_bytes = (size_t)bytes;
        }
        at += (size_t)bytes;
    }
    return r->json ? STATUS_OK : glb_bad(r, "chunk", "there is none of JSON in %" PRIu64 " bytes", length);
}

static enum status find_tables(struct reader *r) {
    for (int t = 0; t < TABLES; t++) {
        const json_t *array = json_object_get(r->json, table_names[t]);
        r->table[t] = json_is_array(array) ? array : NULL;
    }
    r->visited = alloc_zeroed(json_array_size(r->table[NODES]) + 1, sizeof *r->visited);
    return r->visited ? STATUS_OK : error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for the scene");
}

/* false: it is no whole number from 0 to 2^53. */
static bool whole_value(const json_t *value, uint64_t *number) {
    double found = json_is_number(value) ? json_number_value(value) : -1;
    if (!(found >= 0 && found <= 0x1p53) || found != (double)(uint64_t)found) return false;
    *number = (uint64_t)found;
    return true;
}

/* What a member names by its number in a table; NULL where it isn't there.  false: there is no such one. */
static bool look_up(const struct reader *r, const json_t *object, const char *name, enum table table,
                    const json_t **found) {
    const json_t *member = json_object_get(object, name);
    uint64_t i;
    *found = NULL;
    if (!member) return true;
    if (!whole_value(member, &i) || i >= json_array_size(r->table[table])) return false;
    *found = json_array_get(r->table[table], (size_t)i);
    return true;
}

/* The number of that name, or `otherwise` where there is none; false: it is no whole one. */
static bool whole_member(const json_t *object, const char *name, uint64_t otherwise, uint64_t *value) {
    const json_t *member = json_object_get(object, name);
    *value = otherwise;
    return !member || whole_value(member, value);
}

/* ------------------------------------------------------------------------------------------------ extensions */

/* What changes how things look, not where they are. */
static bool glb_may_pass(const char *name) {
    static const char *const beginnings[] = {"KHR_mesh_quantization", "KHR_materials_", "KHR_texture_",
                                             "EXT_texture_",          "MSFT_texture_",  "KHR_lights_"};
    for (size_t i = 0; i < sizeof beginnings / sizeof *beginnings; i++)
        if (strncmp(name, beginnings[i], strlen(beginnings[i])) == 0) return true;
    return false;
}

static enum status check_extensions(struct reader *r) {
    const json_t *required = json_object_get(r->json, "extensionsRequired"), *value;
    size_t i;
    json_array_foreach(required, i, value) {
        const char *name = json_is_string(value) ? json_string_value(value) : "?";
        char text[160], quote[80];
        size_t n = 0;
        if (glb_may_pass(name)) continue;
        for (; name[n] && n + 1 < sizeof quote; n++) quote[n] = name[n] > ' ' && name[n] < 127 ? name[n] : '?';
        quote[n] = 0;
        snprintf(text, sizeof text, "the extension %s, which isn't read; write the file without it", quote);
        return glb_refuse(r, "extensionsRequired", text);
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ columns */

static bool type_of(uint64_t code, enum scalar_type *type) {
    static const enum scalar_type types[] = {SCALAR_INT8,  SCALAR_UINT8,  SCALAR_INT16,  SCALAR_UINT16,
                                             SCALAR_INT32, SCALAR_UINT32, SCALAR_FLOAT32};
    enum { FIRST = 5120, SIGNED_32 = 5124 };
    if (code < FIRST || code >= FIRST + sizeof types / sizeof *types || code == SIGNED_32) return false;
    *type = types[code - FIRST];
    return true;
}

static int width_of(const json_t *accessor) {
    static const char *const names[] = {"SCALAR", "VEC2", "VEC3", "VEC4"};
    const char *type = json_string_value(json_object_get(accessor, "type"));
    for (int i = 0; type && i < 4; i++)
        if (strcmp(type, names[i]) == 0) return i + 1;
    return 0;
}

/* The accessor that a member of an object names. */
static enum status find_column(struct reader *r, const json_t *object, const char *name, struct column *column) {
    const json_t *accessor, *view, *buffer;
    uint64_t code, at, from, bytes, stride, buffer_at, which = 0;
    if (!look_up(r, object, name, ACCESSORS, &accessor) || !accessor)
        return glb_bad(r, name, "it names no accessor; there are %" PRIu64, json_array_size(r->table[ACCESSORS]));
    (void)whole_member(object, name, 0, &which);
    if (json_object_get(accessor, "sparse")) return glb_refuse(r, name, "a sparse accessor, which isn't read");
    if (!look_up(r, accessor, "bufferView", VIEWS, &view))
        return glb_bad(r, name, "accessor %" PRIu64 " names no bufferView", which);
    if (!view) return glb_refuse(r, name, "an accessor without a bufferView, which may be compressed");
    if (!look_up(r, view, "buffer", BUFFERS, &buffer) || !buffer)
        return glb_bad(r, name, "the bufferView of accessor %" PRIu64 " names no buffer", which);
    if (buffer != json_array_get(r->table[BUFFERS], 0) || json_object_get(buffer, "uri"))
        return glb_refuse(r, name, "a buffer outside the binary part; write one file that has all");
    column->width = width_of(accessor);
    if (!whole_member(accessor, "componentType", 0, &code) || !type_of(code, &column->type) || !column->width)
        return glb_bad(r, name, "accessor %" PRIu64 " is of no type that there is", which);
    size_t cell = scalar_bytes(column->type) * (size_t)column->width;
    bool fits = whole_member(accessor, "count", 0, &column->count) && whole_member(accessor, "byteOffset", 0, &at) &&
                whole_member(view, "byteOffset", 0, &from) && whole_member(view, "byteLength", 0, &bytes) &&
                whole_member(view, "byteStride", cell, &stride) && whole_member(buffer, "byteLength", 0, &buffer_at);
    fits = fits && column->count >= 1 && stride >= cell && stride <= 65535 && from <= r->bin_bytes &&
           bytes <= r->bin_bytes - from && at <= bytes && bytes - at >= cell &&
           column->count - 1 <= (bytes - at - cell) / stride;
    if (!fits) return glb_bad(r, name, "accessor %" PRIu64 " isn't within the binary part", which);
    column->at = r->bin + from + at;
    column->stride = (size_t)stride;
    column->normalised = json_is_true(json_object_get(accessor, "normalized"));
    return STATUS_OK;
}

static uint64_t whole_cell(const struct column *column, uint64_t i) {
    return load_little_endian(column->at + i * column->stride, scalar_bytes(column->type));
}

/* Cell i's k-th number. */
static double cell(const struct column *column, uint64_t i, int k) {
    size_t bytes = scalar_bytes(column->type);
    uint64_t bits = load_little_endian(column->at + i * column->stride + (size_t)k * bytes, bytes);
    unsigned char native[8];
    memcpy(native, &bits, sizeof native);
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    memmove(native, native + 8 - bytes, bytes);
#endif
    double value = scalar_load(native, column->type);
    if (!column->normalised || column->type == SCALAR_FLOAT32) return value;
    bool has_sign = column->type == SCALAR_INT8 || column->type == SCALAR_INT16;
    return fmax(-1, value / (double)((1ull << (8 * bytes - has_sign)) - 1));
}

/* ------------------------------------------------------------------------------------------------ the scene */

static struct transform after(const struct transform *outer, const struct transform *inner) {
    struct transform both;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) {
            both.row[i][j] = j == 3 ? outer->row[i][3] : 0;
            for (int k = 0; k < 3; k++) both.row[i][j] += outer->row[i][k] * inner->row[k][j];
        }
    return both;
}

/* So many numbers of an array; false: it hasn't that many.  What isn't there stays. */
static bool numbers(const json_t *object, const char *name, double *value, size_t count) {
    const json_t *array = json_object_get(object, name);
    if (!array) return true;
    if (json_array_size(array) != count) return false;
    for (size_t i = 0; i < count; i++) {
        const json_t *number = json_array_get(array, i);
        if (!json_is_number(number)) return false;
        value[i] = json_number_value(number);
    }
    return true;
}

/* matrix (16 numbers, column by column), or translation * rotation (x y z w) * scale. */
static bool transform_of(const json_t *node, struct transform *own) {
    double m[16], t[3] = {0, 0, 0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
    if (json_object_get(node, "matrix")) {
        if (!numbers(node, "matrix", m, 16)) return false;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 4; j++) own->row[i][j] = m[4 * j + i];
        return true;
    }
    if (!numbers(node, "translation", t, 3) || !numbers(node, "rotation", q, 4) || !numbers(node, "scale", s, 3))
        return false;
    double x = q[0], y = q[1], z = q[2], w = q[3];
    const double turn[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
                               {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
                               {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) own->row[i][j] = turn[i][j] * s[j];
        own->row[i][3] = t[i];
    }
    return true;
}

static enum status add_instance(struct reader *r, const json_t *primitive, const struct transform *place) {
    struct column position;
    if (r->instances == r->instance_room) {
        size_t room = r->instance_room ? 2 * r->instance_room : 16;
        struct instance *instance = alloc_resize(r->instance, room, sizeof *instance);
        if (!instance) return error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for the scene");
        r->instance = instance, r->instance_room = room;
    }
    enum status status = find_column(r, json_object_get(primitive, "attributes"), "POSITION", &position);
    if (status) return status;
    if (position.width != 3)
        return glb_bad(r, "POSITION", "it has %" PRIu64 " numbers, not 3", (uint64_t)position.width);
    r->points += position.count;
    if (r->points > r->n) return glb_refuse(r, "nodes", "instances of meshes make more points than the file has bytes");
    if (position.type != SCALAR_FLOAT32 || memcmp(place, &STILL, sizeof STILL) != 0) r->wide = true;
    r->instance[r->instances++] = (struct instance){primitive, *place};
    return STATUS_OK;
}

static enum status note_of_mesh(struct reader *r, const json_t *primitive) {
    enum status status = STATUS_OK;
    if (json_object_get(primitive, "targets"))
        status = cloud_build_leave_out(&r->build, "morph targets: the mesh is as it is without them");
    if (!status && json_object_get(primitive, "material"))
        status = cloud_build_leave_out(&r->build, "materials and pictures");
    return status;
}

static enum status add_mesh(struct reader *r, const json_t *mesh, const struct transform *place) {
    const json_t *primitives = json_object_get(mesh, "primitives"), *primitive;
    size_t i;
    json_array_foreach(primitives, i, primitive) {
        enum status status = add_instance(r, primitive, place);
        if (!status) status = note_of_mesh(r, primitive);
        if (status) return status;
    }
    return STATUS_OK;
}

static enum status add_node(struct reader *r, uint64_t node, const struct transform *outer, int depth) {
    struct transform own;
    const json_t *mesh, *child;
    size_t i;
    if (node >= json_array_size(r->table[NODES])) return glb_bad(r, "nodes", "there is no node %" PRIu64, node);
    if (r->visited[node]) return glb_bad(r, "nodes", "node %" PRIu64 " is in the scene twice", node);
    if (depth == DEEPEST_NODE) return glb_bad(r, "nodes", "they are more than %" PRIu64 " deep", DEEPEST_NODE);
    r->visited[node] = 1;
    const json_t *value = json_array_get(r->table[NODES], (size_t)node), *children = json_object_get(value, "children");
    if (!transform_of(value, &own)) return glb_bad(r, "nodes", "the transform of node %" PRIu64 " is none", node);
    own = after(outer, &own);
    if (!look_up(r, value, "mesh", MESHES, &mesh)) return glb_bad(r, "nodes", "node %" PRIu64 " has no mesh", node);
    enum status status = STATUS_OK;
    if (json_object_get(value, "skin"))
        status = cloud_build_leave_out(&r->build, "skins: the mesh is as it is without them");
    if (!status && mesh) status = add_mesh(r, mesh, &own);
    if (status) return status;
    json_array_foreach(children, i, child) {
        uint64_t id;
        if (!whole_value(child, &id)) return glb_bad(r, "nodes", "children of node %" PRIu64 " aren't", node);
        status = add_node(r, id, &own, depth + 1);
        if (status) return status;
    }
    return STATUS_OK;
}

/* What undoes the turn of the only node of a scene, where a mark says that it turned another axis to y; the cloud has
 * its own axes then. */
static struct transform undo_turn(struct reader *r, const json_t *nodes) {
    static const struct transform from_z = {{{1, 0, 0, 0}, {0, 0, -1, 0}, {0, 1, 0, 0}}},
                                  from_x = {{{0, 1, 0, 0}, {-1, 0, 0, 0}, {0, 0, 1, 0}}};
    uint64_t id;
    r->build.cloud.up = UP_Y;
    if (json_array_size(nodes) != 1 || !whole_value(json_array_get(nodes, 0), &id)) return STILL;
    const json_t *node = json_array_get(r->table[NODES], (size_t)id), *extras = json_object_get(node, "extras");
    const char *mark = json_string_value(json_object_get(extras, GLB_UP_MARK));
    if (!mark || (strcmp(mark, "x") != 0 && strcmp(mark, "z") != 0)) return STILL;
    r->build.cloud.up = mark[0] == 'x' ? UP_X : UP_Z;
    return mark[0] == 'x' ? from_x : from_z;
}

/* The scene that is shown first, or the first; where there is none all meshes. */
static enum status walk_scene(struct reader *r) {
    uint64_t shown, id;
    const json_t *mesh, *node;
    size_t i;
    enum status status = STATUS_OK;
    if (!whole_member(r->json, "scene", 0, &shown)) return glb_bad(r, "scene", "it is none of %" PRIu64, 0);
    const json_t *scene = json_array_get(json_object_get(r->json, "scenes"), (size_t)shown);
    const json_t *nodes = json_object_get(scene, "nodes");
    if (!scene) {
        json_array_foreach(r->table[MESHES], i, mesh) {
            status = add_mesh(r, mesh, &STILL);
            if (status) return status;
        }
    }
    const struct transform outer = undo_turn(r, nodes);
    json_array_foreach(nodes, i, node) {
        if (!whole_value(node, &id)) return glb_bad(r, "scene", "of its nodes one is none of %" PRIu64, 0);
        status = add_node(r, id, &outer, 0);
        if (status) return status;
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ attributes */

static json_t *attributes_of(const struct reader *r, size_t i) {
    return json_object_get(r->instance[i].primitive, "attributes");
}

/* Whether all have it; what only some have is noted. */
static enum status glb_all_have(struct reader *r, const char *attribute, const char *what, bool *all) {
    size_t have = 0;
    for (size_t i = 0; i < r->instances; i++) have += json_object_get(attributes_of(r, i), attribute) != NULL;
    *all = have > 0 && have == r->instances;
    if (have == 0 || *all) return STATUS_OK;
    char note[PROPERTY_NAME_BYTES + 40];
    snprintf(note, sizeof note, "%s, which only some of the meshes have", what);
    return cloud_build_leave_out(&r->build, note);
}

static enum status find_extra(struct reader *r, const char *name) {
    size_t length = strlen(name);
    struct extra *extra = &r->extra[r->extras];
    struct column column;
    bool all;
    if (length < 2 || length >= sizeof extra->attribute || r->extras == EXTRAS_MOST) return STATUS_OK;
    memcpy(extra->attribute, name, length + 1);
    for (size_t k = 1; k <= length; k++) extra->name[k - 1] = (char)tolower((unsigned char)extra->attribute[k]);
    enum status status = glb_all_have(r, extra->attribute, extra->attribute, &all);
    for (size_t i = 0; !status && all && i < r->instances; i++) {
        status = find_column(r, attributes_of(r, i), extra->attribute, &column);
        if (status || column.width != 1) return status ? status : cloud_build_leave_out(&r->build, extra->attribute);
        bool plain = !column.normalised || column.type == SCALAR_FLOAT32;
        if (i == 0) extra->type = plain ? column.type : SCALAR_FLOAT64;
        if (column.type != extra->type || !plain) extra->type = SCALAR_FLOAT64;
    }
    r->extras += !status && all;
    return status;
}

static enum status find_attributes(struct reader *r) {
    struct column column;
    enum status status = glb_all_have(r, "NORMAL", "normals", &r->normal);
    if (!status) status = glb_all_have(r, "COLOR_0", "colours", &r->colour);
    if (!status) status = glb_all_have(r, "TEXCOORD_0", "texture coordinates", &r->texture);
    for (size_t i = 0; !status && r->colour && i < r->instances; i++) {
        status = find_column(r, attributes_of(r, i), "COLOR_0", &column);
        r->alpha = r->alpha || column.width == 4;
    }
    const char *name;
    const json_t *accessor;
    json_object_foreach(attributes_of(r, 0), name, accessor) {
        if (!status && name[0] == '_') status = find_extra(r, name);
    }
    return status;
}

static enum status describe_columns(struct reader *r) {
    static const char *const xyz[] = {"x", "y", "z"}, *const normal[] = {"nx", "ny", "nz"};
    static const char *const colour[] = {"red", "green", "blue", "alpha"}, *const texture[] = {"s", "t"};
    enum status status = STATUS_OK;
    for (int k = 0; !status && k < 3; k++)
        status = cloud_build_property(&r->build, xyz[k], r->wide ? SCALAR_FLOAT64 : SCALAR_FLOAT32);
    for (int k = 0; !status && r->normal && k < 3; k++)
        status = cloud_build_property(&r->build, normal[k], SCALAR_FLOAT32);
    for (int k = 0; !status && r->colour && k < 3 + r->alpha; k++)
        status = cloud_build_property(&r->build, colour[k], SCALAR_UINT8);
    for (int k = 0; !status && r->texture && k < 2; k++)
        status = cloud_build_property(&r->build, texture[k], SCALAR_FLOAT32);
    for (size_t k = 0; !status && k < r->extras; k++)
        status = cloud_build_property(&r->build, r->extra[k].name, r->extra[k].type);
    return status;
}

/* ------------------------------------------------------------------------------------------------ points */

/* The columns of a primitive, as far as the cloud has them. */
struct columns {
    struct column position, normal, colour, texture, extra[EXTRAS_MOST];
};

static enum status find_as(struct reader *r, const json_t *attributes, const char *name, int least, int most,
                           uint64_t count, struct column *column) {
    enum status status = find_column(r, attributes, name, column);
    if (!status && (column->width < least || column->width > most || column->count != count))
        status = glb_bad(r, name, "it isn't as many numbers as %" PRIu64 " positions want", count);
    return status;
}

static enum status find_columns(struct reader *r, const json_t *attributes, struct columns *c) {
    enum status status = find_column(r, attributes, "POSITION", &c->position);
    uint64_t count = c->position.count;
    if (!status && r->normal) status = find_as(r, attributes, "NORMAL", 3, 3, count, &c->normal);
    if (!status && r->colour) status = find_as(r, attributes, "COLOR_0", 3, 4, count, &c->colour);
    if (!status && r->texture) status = find_as(r, attributes, "TEXCOORD_0", 2, 2, count, &c->texture);
    for (size_t k = 0; !status && k < r->extras; k++)
        status = find_as(r, attributes, r->extra[k].attribute, 1, 1, count, &c->extra[k]);
    return status;
}

/* From linear to sRGB (IEC 61966-2-1). */
static double to_srgb(double value) { return value <= 0.0031308 ? 12.92 * value : 1.055 * pow(value, 1 / 2.4) - 0.055; }

static vec3 place_point(const struct transform *t, vec3 p) {
    return (vec3){t->row[0][0] * p.x + t->row[0][1] * p.y + t->row[0][2] * p.z + t->row[0][3],
                  t->row[1][0] * p.x + t->row[1][1] * p.y + t->row[1][2] * p.z + t->row[1][3],
                  t->row[2][0] * p.x + t->row[2][1] * p.y + t->row[2][2] * p.z + t->row[2][3]};
}

static vec3 row_of(const struct transform *t, int i) { return (vec3){t->row[i][0], t->row[i][1], t->row[i][2]}; }

/* By the matrix of cofactors, which is the inverse transposed but for its length. */
static vec3 turn_normal(const struct transform *t, vec3 n) {
    vec3 a = row_of(t, 0), b = row_of(t, 1), c = row_of(t, 2);
    vec3 turned = {vec3_dot(vec3_cross(b, c), n), vec3_dot(vec3_cross(c, a), n), vec3_dot(vec3_cross(a, b), n)};
    double length = vec3_length(turned);
    return length > 0 ? vec3_scale(turned, 1 / length) : n;
}

static size_t store(const struct reader *r, unsigned char *record, size_t property, double value) {
    const struct property *p = &r->build.cloud.property[property];
    scalar_store(record + p->offset_bytes, p->type, value);
    return property + 1;
}

static void make_record(const struct reader *r, const struct columns *c, const struct transform *place, bool still,
                        uint64_t i, unsigned char *record) {
    vec3 p = {cell(&c->position, i, 0), cell(&c->position, i, 1), cell(&c->position, i, 2)};
    size_t at = 0;
    if (!still) p = place_point(place, p);
    at = store(r, record, at, p.x), at = store(r, record, at, p.y), at = store(r, record, at, p.z);
    if (r->normal) {
        vec3 n = {cell(&c->normal, i, 0), cell(&c->normal, i, 1), cell(&c->normal, i, 2)};
        if (!still) n = turn_normal(place, n);
        at = store(r, record, at, n.x), at = store(r, record, at, n.y), at = store(r, record, at, n.z);
    }
    for (int k = 0; r->colour && k < 3 + r->alpha; k++) {
        double value = k < c->colour.width ? cell(&c->colour, i, k) : 1;
        value = value > 0 ? fmin(value, 1) : 0;
        at = store(r, record, at, nearbyint(255 * (k < 3 ? to_srgb(value) : value)));
    }
    if (r->texture) {
        at = store(r, record, at, cell(&c->texture, i, 0));
        at = store(r, record, at, 1 - cell(&c->texture, i, 1));
    }
    for (size_t k = 0; k < r->extras; k++) at = store(r, record, at, cell(&c->extra[k], i, 0));
}

static enum status glb_add_points(struct reader *r, const struct columns *c, const struct transform *place) {
    bool still = memcmp(place, &STILL, sizeof STILL) == 0;
    unsigned char *record = alloc_zeroed(1, r->build.cloud.record_bytes);
    enum status status =
        record ? STATUS_OK : error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for a point");
    for (uint64_t i = 0; !status && i < c->position.count; i++) {
        make_record(r, c, place, still, i, record);
        uint64_t byte = (uint64_t)(c->position.at - r->bytes) + i * c->position.stride;
        status = cloud_build_point(&r->build, record, (struct cloud_place){0, byte});
    }
    free(record);
    return status;
}

/* ------------------------------------------------------------------------------------------------ faces */

/* The corners of a primitive: as its indices say, or one point after the other. */
struct corners {
    struct column index;
    bool indexed;
    uint64_t count, points;
    uint32_t base; /* the id of point 0 */
};

static enum status corner(struct reader *r, const struct corners *c, uint64_t i, uint32_t *id) {
    uint64_t point = c->indexed ? whole_cell(&c->index, i) : i;
    if (point >= c->points) return glb_bad(r, "indices", "there is no point %" PRIu64, point);
    *id = c->base + (uint32_t)point;
    return STATUS_OK;
}

/* Triangle t of a list, a strip (every other one the other way round) or a fan.  mirrored: its node turns sides. */
static enum status add_triangle(struct reader *r, const struct corners *c, uint64_t mode, uint64_t t, bool mirrored) {
    uint64_t at[3] = {3 * t, 3 * t + 1, 3 * t + 2};
    uint32_t id[3];
    if (mode == GLTF_STRIP) at[0] = t, at[1] = t + 1 + t % 2, at[2] = t + 2 - t % 2;
    if (mode == GLTF_FAN) at[0] = t + 1, at[1] = t + 2, at[2] = 0;
    enum status status = STATUS_OK;
    for (int k = 0; !status && k < 3; k++) status = corner(r, c, at[k], &id[k]);
    if (status || id[0] == id[1] || id[1] == id[2] || id[2] == id[0]) return status;
    return cloud_build_triangle(&r->build, id[0], id[mirrored ? 2 : 1], id[mirrored ? 1 : 2]);
}

static double determinant(const struct transform *t) {
    return vec3_dot(row_of(t, 0), vec3_cross(row_of(t, 1), row_of(t, 2)));
}

static enum status add_faces(struct reader *r, const struct instance *of, uint64_t points, uint32_t base) {
    uint64_t mode;
    struct corners c = {.count = points, .points = points, .base = base};
    if (!whole_member(of->primitive, "mode", GLTF_TRIANGLES, &mode) || mode > GLTF_FAN)
        return glb_bad(r, "mode", "there is none such; the last is %" PRIu64, GLTF_FAN);
    if (mode == GLTF_POINTS) return STATUS_OK;
    if (mode < GLTF_TRIANGLES) return cloud_build_leave_out(&r->build, "lines: their points are kept");
    c.indexed = json_object_get(of->primitive, "indices") != NULL;
    enum status status = c.indexed ? find_column(r, of->primitive, "indices", &c.index) : STATUS_OK;
    if (!status && c.indexed) {
        enum scalar_type type = c.index.type;
        if (c.index.width != 1 || (type != SCALAR_UINT8 && type != SCALAR_UINT16 && type != SCALAR_UINT32))
            return glb_bad(r, "indices", "they aren't whole numbers, %" PRIu64 " of them", c.index.count);
        c.count = c.index.count;
    }
    uint64_t triangles = mode == GLTF_TRIANGLES ? c.count / 3 : c.count < 3 ? 0 : c.count - 2;
    bool mirrored = determinant(&of->place) < 0;
    for (uint64_t t = 0; !status && t < triangles; t++) status = add_triangle(r, &c, mode, t, mirrored);
    return status;
}

/* Primitives of one mesh often differ in indices alone. */
static bool has_same_points(const struct reader *r, size_t i) {
    if (i == 0 || memcmp(&r->instance[i].place, &r->instance[i - 1].place, sizeof r->instance->place) != 0)
        return false;
    return json_equal(attributes_of(r, i), attributes_of(r, i - 1));
}

static enum status read_scene(struct reader *r) {
    enum status status = find_chunks(r);
    if (!status) status = check_extensions(r);
    if (!status) status = find_tables(r);
    if (!status) status = walk_scene(r);
    if (!status && !r->instances)
        return glb_bad(r, "scene", "it has no mesh; %" PRIu64 " are defined", json_array_size(r->table[MESHES]));
    if (!status) status = find_attributes(r);
    if (!status) status = describe_columns(r);
    uint32_t base = 0;
    struct columns *c = alloc_array(1, sizeof *c);
    if (!status && !c) status = error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for the scene");
    for (size_t i = 0; !status && i < r->instances; i++) {
        bool shared = has_same_points(r, i);
        status = find_columns(r, attributes_of(r, i), c);
        if (!status && !shared) base = (uint32_t)r->build.cloud.count;
        if (!status && !shared) status = glb_add_points(r, c, &r->instance[i].place);
        if (!status) status = add_faces(r, &r->instance[i], c->position.count, base);
    }
    free(c);
    return status;
}

const char *cloud_glb_look(const struct first_bytes *first) { return first_begins(first, "glTF", 4) ? "glb" : ""; }

enum status cloud_glb_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct reader r = {.bytes = bytes, .n = n};
    cloud_build_start(&r.build, "glb", n, limits, progress, error);
    enum status status = read_scene(&r);
    json_decref(r.json);
    free(r.visited), free(r.instance);
    return cloud_build_end(&r.build, status, cloud);
}
