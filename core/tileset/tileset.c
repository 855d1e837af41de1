/* Tiles of a cloud: the tree, its errors, a file for each node, and the JSON that joins them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tileset/tileset.h"

#include <errno.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/version.h"
#include "core/io/formats/las_fields.h"
#include "core/tileset/node_error.h"
#include "core/tileset/writing.h"

enum { PATH_BYTES = 4096, SYSTEM_BYTES = 256 };
static const char WHERE[] = "tileset";
/* Boxes are wider than the points by a share of their size, for what rounding to float32 moves, and never flat.
 * Quantized points move more. */
static const double ROUNDING = 0x1p-22, THINNEST = 1e-6;

enum status writing_no_memory(const struct writing *w) {
    return error_set(w->error, STATUS_NO_MEMORY, WHERE, "not enough memory for tiles of %zu points", w->points->n);
}

/* ------------------------------------------------------------------------------------------------ the tree */

static void name_tile(char name[ARCHIVE_NAME_BYTES], size_t t) {
    snprintf(name, ARCHIVE_NAME_BYTES, "tiles/%zu.glb", t);
}

static enum status make_tree(struct writing *w) {
    const struct tileset_points *points = w->points;
    vec3 *place = alloc_array(points->n, sizeof *place);
    if (!place) return writing_no_memory(w);
    vec3 low = points->cloud->position[points->kept[0]], high = low;
    for (size_t i = 0; i < points->n; i++) {
        place[i] = points->cloud->position[points->kept[i]];
        low = vec3_min(low, place[i]);
        high = vec3_max(high, place[i]);
    }
    w->origin = vec3_lerp(low, high, 0.5);
    for (size_t i = 0; i < points->n; i++) place[i] = vec3_sub(place[i], w->origin);
    const struct octree_cube cube = octree_cube_around(vec3_sub(low, w->origin), vec3_sub(high, w->origin));
    enum status status = octree_make(place, points->n, cube, 0, false, points->threads, &w->tree);
    free(place);
    if (!status) status = node_errors(&w->tree, NULL, points->threads);
    return status ? writing_no_memory(w) : STATUS_OK;
}

/* From ranks to ids: attributes are found by these. */
static void find_attributes(struct writing *w, const struct cloud *cloud, const uint32_t *id) {
    for (size_t i = 0; i < w->tree.points; i++) w->tree.rank[i] = id[w->tree.rank[i]];
    w->all = (struct mesh){.vertex_count = w->tree.points, .vertex = w->tree.point, .source = w->tree.rank};
    mesh_attributes_find(&w->all, cloud, &w->attributes);
    if (w->colour_scale > 0) w->attributes.colour_scale = w->colour_scale;
}

static enum status add_nodes(struct writing *w) {
    size_t n = w->nodes + w->tree.count;
    if (n > w->nodes_room) {
        size_t room = n + n / 2;
        struct octree_node *node = alloc_resize(w->node, room, sizeof *node);
        if (!node || room > UINT32_MAX) return writing_no_memory(w);
        w->node = node;
        w->nodes_room = room;
    }
    for (size_t t = 0; t < w->tree.count; t++) {
        struct octree_node *node = &w->node[w->nodes + t];
        *node = w->tree.node[t];
        node->next += (uint32_t)w->nodes;
    }
    w->nodes = n;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ tiles */

static struct glb_points points_of(const struct writing *w, size_t t) {
    const struct octree_node *node = &w->tree.node[t];
    return (struct glb_points){.attributes = &w->attributes,
                               .ids = w->tree.rank + node->first,
                               .position = w->tree.point + node->first,
                               .n = node->own,
                               .packing = w->points->packing,
                               .centre = vec3_lerp(node->own_low, node->own_high, 0.5)};
}

/* Half a step of what is quantized; else how far off float32 around the tile's centre puts a coordinate, 0 where that
 * of the input is itself float32 and rounding to it gives it back. */
static double find_moved(const struct writing *w, const struct glb_points *points) {
    const double exact = 0x1p-48; /* of a coordinate: what its sum with the origin loses */
    double worst = 0;
    if (points->packing.quantized) {
        vec3 low = points->position[0], high = low;
        for (size_t i = 0; i < points->n; i++) {
            low = vec3_min(low, points->position[i]);
            high = vec3_max(high, points->position[i]);
        }
        vec3 wide = vec3_sub(high, low);
        return fmax(wide.x, fmax(wide.y, wide.z)) / UINT16_MAX / 2;
    }
    for (size_t i = 0; i < points->n; i++)
        for (int axis = 0; axis < 3; axis++) {
            double origin = (&w->origin.x)[axis], centre = (&points->centre.x)[axis];
            double place = (&points->position[i].x)[axis], put = (double)(float)(place - centre) + centre;
            double least = exact * fmax(fabs(origin), fabs(place));
            float single = (float)(place + origin);
            bool comes_back = fabs((double)single - (place + origin)) <= least && (float)(put + origin) == single;
            if (!comes_back && fabs(put - place) > least) worst = fmax(worst, fabs(put - place));
        }
    return worst;
}

static void make_tiles(void *ctx, size_t begin, size_t end) {
    struct writing *w = ctx;
    for (size_t i = begin; i < end; i++) {
        const struct glb_points points = points_of(w, w->first + i);
        sink_restart(&w->glb[i]);
        w->made[i] = cloud_put_glb(&w->glb[i], &points);
        w->moved[i] = find_moved(w, &points);
        if (!w->made[i] && w->glb[i].failure) w->made[i] = STATUS_NO_MEMORY;
    }
}

static enum status commit_tiles(struct writing_target *target, struct error *error) {
    size_t n = target->files;
    target->files = 0;
    return n ? file_out_commit(target->file, n, error) : STATUS_OK;
}

static enum status put_in_folder(struct writing_target *target, const char *name, const void *bytes, size_t n,
                                 struct error *error) {
    char path[PATH_BYTES];
    struct sink sink;
    struct file_out *file = &target->file[target->files];
    if (snprintf(path, sizeof path, "%s/%s", target->folder, name) >= (int)sizeof path)
        return error_set(error, STATUS_IO, "output", "the name is too long: %.80s...", target->folder);
    enum status status = file_out_begin(file, path, error);
    if (status) return status;
    target->files++;
    status = sink_init(&sink, file->fd);
    if (!status) sink_bytes(&sink, bytes, n);
    return sink_done(&sink, status, error);
}

static enum status put_tile(struct writing *w, size_t t, const struct sink *glb) {
    char name[ARCHIVE_NAME_BYTES];
    name_tile(name, t);
    if (w->target->folder) return put_in_folder(w->target, name, glb->buffer, glb->used, w->error);
    return archive_add(w->target->archive, name, glb->buffer, (uint32_t)glb->used) ? writing_no_memory(w) : STATUS_OK;
}

enum status writing_put_tree(struct writing *w, const struct cloud *cloud, const uint32_t *id) {
    size_t base = w->nodes;
    enum status status = add_nodes(w);
    find_attributes(w, cloud, id);
    if (base == 0) {
        const struct glb_points first = points_of(w, 0);
        cloud_glb_note(&first, WHERE, w->left_out);
    }
    for (w->first = 0; w->first < w->tree.count && !status; w->first += WRITING_ABREAST) {
        size_t n = w->tree.count - w->first < WRITING_ABREAST ? w->tree.count - w->first : WRITING_ABREAST;
        par_for(w->points->threads, n, 1, make_tiles, w);
        for (size_t i = 0; i < n && !status; i++) {
            w->most_moved = fmax(w->most_moved, w->moved[i]);
            status = w->made[i] == STATUS_NO_MEMORY ? writing_no_memory(w)
                     : w->made[i]                   ? error_set(w->error, w->made[i], WHERE, "a tile is beyond 4 GiB")
                                                    : put_tile(w, base + w->first + i, &w->glb[i]);
        }
        if (!status) status = commit_tiles(w->target, w->error);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ JSON */

/* Center, and half an axis each, of a box around these corners. */
static void put_box(struct sink *json, const struct writing *w, vec3 low, vec3 high) {
    vec3 middle = vec3_lerp(low, high, 0.5), half = vec3_scale(vec3_sub(high, low), 0.5);
    double most = fmax(half.x, fmax(half.y, half.z));
    double least = most > 0 ? most * THINNEST : THINNEST;
    vec3 wide = {fmax(half.x, least), fmax(half.y, least), fmax(half.z, least)};
    double moved = most * (w->points->packing.quantized ? 1.0 / UINT16_MAX : ROUNDING);
    wide = vec3_add(wide, (vec3){moved, moved, moved});
    sink_format(json, "\"boundingVolume\":{\"box\":[%.17g,%.17g,%.17g,%.17g,0,0,0,%.17g,0,0,0,%.17g]}", middle.x,
                middle.y, middle.z, wide.x, wide.y, wide.z);
}

/* A tile and those below it. */
static void put_node(struct sink *json, const struct writing *w, size_t t) {
    const struct octree_node *node = &w->node[t];
    char name[ARCHIVE_NAME_BYTES];
    name_tile(name, t);
    sink_text(json, "{");
    put_box(json, w, node->low, node->high);
    sink_format(json, ",\"geometricError\":%.17g,", node->error);
    if (t == 0)
        sink_format(json, "\"refine\":\"ADD\",\"transform\":[1,0,0,0,0,1,0,0,0,0,1,0,%.17g,%.17g,%.17g,1],",
                    w->origin.x, w->origin.y, w->origin.z);
    sink_format(json, "\"content\":{\"uri\":\"%s\"}", name);
    for (size_t child = t + 1; child < node->next; child = w->node[child].next) {
        sink_text(json, child == t + 1 ? ",\"children\":[\n" : ",\n");
        put_node(json, w, child);
    }
    sink_text(json, t + 1 < node->next ? "]}" : "}");
}

/* A text without what JSON has a meaning for. */
static void put_plain(struct sink *json, const char *text) {
    for (; *text; text++)
        if ((unsigned char)*text >= ' ' && *text != '"' && *text != '\\') sink_bytes(json, text, 1);
}

/* What the tileset says of itself: how many points it has, and their coordinate system, where the input names one. */
static void put_metadata(struct sink *json, const struct writing *w) {
    char system[SYSTEM_BYTES] = "";
    if (w->points->cloud->las) las_records_system(w->points->cloud->las, system, sizeof system);
    sink_text(json, "\"schema\":{\"id\":\"whittle\",\"classes\":{\"tileset\":{\"properties\":{"
                    "\"points\":{\"type\":\"SCALAR\",\"componentType\":\"UINT32\",\"required\":true}");
    if (system[0])
        sink_text(json, ",\"coordinateSystem\":{\"type\":\"STRING\",\"description\":\"What the input says its "
                        "coordinates are in; they are as they were\"}");
    sink_format(json, "}}}},\n\"metadata\":{\"class\":\"tileset\",\"properties\":{\"points\":%zu", w->points->n);
    if (system[0]) {
        sink_text(json, ",\"coordinateSystem\":\"");
        put_plain(json, system);
        sink_text(json, "\"");
    }
    sink_text(json, "}},\n");
}

static void put_json(struct sink *json, const struct writing *w) {
    const struct octree_node *root = &w->node[0];
    sink_format(json, "{\"asset\":{\"version\":\"1.1\",\"generator\":\"whittle %s\"},\n", whittle_version());
    put_metadata(json, w);
    sink_format(json, "\"geometricError\":%.17g,\n\"root\":", vec3_distance(root->low, root->high));
    put_node(json, w, 0);
    sink_text(json, "}\n");
}

/* ------------------------------------------------------------------------------------------------ the whole */

static void writing_done(struct writing *w) {
    for (size_t i = 0; i < WRITING_ABREAST; i++) free(w->glb[i].buffer);
    for (size_t i = 0; i < w->target->files; i++) file_out_abort(&w->target->file[i]);
    octree_done(&w->tree);
    free(w->node);
}

static void note_moved(const struct writing *w) {
    if (w->most_moved > 0)
        left_out_add(w->left_out, WHERE, "precision: coordinates are %s of a tile, off by up to %.2g",
                     w->points->packing.quantized ? "whole numbers of 16 bits from the corner"
                                                  : "float32 around the centre",
                     w->most_moved);
}

/* Everything but tileset.json. */
static enum status put_all_tiles(struct writing *w) {
    enum status status = STATUS_OK;
    for (size_t i = 0; i < WRITING_ABREAST && !status; i++) status = sink_init_memory(&w->glb[i]);
    if (status) return writing_no_memory(w);
    if (w->points->file) {
        status = parts_put(w);
    } else {
        status = make_tree(w);
        if (!status) status = writing_put_tree(w, w->points->cloud, w->points->kept);
    }
    if (!status) note_moved(w);
    return status;
}

/* tileset.json comes behind the tiles: it is in memory until then. */
static enum status archive_json(struct writing *w) {
    struct sink json;
    enum status status = sink_init_memory(&json);
    if (!status) put_json(&json, w);
    if (!status && json.failure) status = STATUS_NO_MEMORY;
    if (!status) status = archive_add(w->target->archive, "tileset.json", json.buffer, (uint32_t)json.used);
    if (!status) status = archive_finish(w->target->archive);
    free(json.buffer);
    return status ? writing_no_memory(w) : STATUS_OK;
}

enum status tileset_write_archive(int fd, const struct tileset_points *points, struct left_out *left_out,
                                  struct error *error) {
    struct sink sink;
    struct archive archive;
    struct writing_target target = {.archive = &archive};
    struct writing w = {.points = points, .target = &target, .left_out = left_out, .error = error};
    enum status status = sink_init(&sink, fd);
    archive_init(&archive, &sink);
    status = status ? writing_no_memory(&w) : put_all_tiles(&w);
    if (!status) status = archive_json(&w);
    writing_done(&w);
    archive_done(&archive);
    return sink_done(&sink, status, error);
}

enum status tileset_write_folder(int fd, const char *folder, const struct tileset_points *points,
                                 struct left_out *left_out, struct error *error) {
    char path[PATH_BYTES];
    struct sink sink;
    struct writing_target target = {.folder = folder};
    struct writing w = {.points = points, .target = &target, .left_out = left_out, .error = error};
    if (snprintf(path, sizeof path, "%s/tiles", folder) >= (int)sizeof path)
        return error_set(error, STATUS_IO, "output", "the name is too long: %.80s...", folder);
    if (mkdir(path, 0777) != 0 && errno != EEXIST)
        return error_set(error, status_from_errno(errno), "output", "can't make the folder %s: %s", path,
                         strerror(errno));
    enum status status = sink_init(&sink, fd);
    status = status ? writing_no_memory(&w) : put_all_tiles(&w);
    if (!status) put_json(&sink, &w);
    writing_done(&w);
    return sink_done(&sink, status, error);
}
