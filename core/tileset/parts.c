/* Tiles of more points than memory holds.
 *
 * From the top: of a file of points, the most important ones are a tile, and the others go to eight files, as
 * core/tileset/octree.h does it with arrays; a file that fits into memory becomes a tree.  The tiles are those that
 * memory would make of all points at once.
 *
 * What is below a tile is known when all of its files have become trees; until then the points of the tiles above the
 * present file are kept, and how far others are from them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/radix.h"
#include "core/tileset/node_error.h"
#include "core/tileset/writing.h"

enum { PATH_BYTES = 4096, HELD = 2 * OCTREE_TILE_POINTS };

struct parts {
    struct writing *w;
    const struct cloud *like; /* what records are */
    size_t record_bytes;
    size_t files; /* that have been made */
    struct node_chain chain;
    struct octree shown[OCTREE_DEEPEST + 1]; /* what the chain finds points of */
};

/* Points in a file, all of a cube. */
struct part_file {
    char path[PATH_BYTES];
    uint64_t count;
    struct octree_cube cube;
    unsigned depth;
};

static enum status parts_no_memory(const struct parts *parts) { return writing_no_memory(parts->w); }

/* ------------------------------------------------------------------------------------------------ trees */

/* Their order by key. */
static enum status sort_by_key(const struct parts *parts, const struct kept_points *points, uint32_t *order) {
    unsigned threads = parts->w->points->threads;
    size_t n = points->count;
    uint64_t *item = alloc_array(n, sizeof *item), *spare = alloc_array(n, sizeof *spare), *sorted = item;
    bool room = item && spare;
    if (room) { /* by the lower half, then by the upper one */
        for (size_t i = 0; i < n; i++) item[i] = radix_item((uint32_t)points->key[i], (uint32_t)i);
        sorted = radix_sort(item, spare, n, threads);
        for (size_t i = 0; i < n; i++)
            sorted[i] = radix_item((uint32_t)(points->key[radix_value(sorted[i])] >> 32), radix_value(sorted[i]));
        sorted = radix_sort(sorted, sorted == item ? spare : item, n, threads);
        for (size_t i = 0; i < n; i++) order[i] = radix_value(sorted[i]);
    }
    free(item), free(spare);
    return room ? STATUS_OK : parts_no_memory(parts);
}

/* A tree of points in memory, which are freed; whole: they are one tile. */
static enum status put_grown(struct parts *parts, struct kept_points *points, struct octree_cube cube, unsigned depth,
                             bool whole) {
    struct writing *w = parts->w;
    size_t n = points->count;
    struct cloud cloud = *parts->like;
    uint32_t *order = alloc_array(n, sizeof *order);
    vec3 *place = alloc_array(n, sizeof *place);
    enum status status = order && place ? sort_by_key(parts, points, order) : parts_no_memory(parts);
    for (size_t i = 0; !status && i < n; i++) place[i] = vec3_sub(points->position[order[i]], w->origin);
    free(points->key), free(points->position);
    points->key = NULL, points->position = NULL;
    octree_done(&w->tree);
    if (!status && octree_make(place, n, cube, depth, whole, w->points->threads, &w->tree))
        status = parts_no_memory(parts);
    free(place);
    if (!status && node_errors(&w->tree, &parts->chain, w->points->threads)) status = parts_no_memory(parts);
    cloud.count = n;
    cloud.record = points->record;
    if (!status) status = writing_put_tree(w, &cloud, order);
    free(order);
    kept_points_done(points);
    return status;
}

static enum status put_file(struct parts *parts, const struct part_file *file) {
    struct kept_reader reader;
    struct kept_points points;
    if (kept_points_make(&points, (size_t)file->count, parts->record_bytes)) return parts_no_memory(parts);
    enum status status = kept_reader_open(&reader, file->path, file->count, parts->record_bytes, parts->w->error);
    while (!status && points.count < file->count) {
        status = kept_reader_next(&reader, file->path, parts->w->error);
        for (size_t i = 0; !status && i < reader.points.count; i++)
            kept_points_add(&points, &reader.points, i, parts->record_bytes);
    }
    kept_reader_close(&reader);
    if (!status) status = put_grown(parts, &points, file->cube, file->depth, false);
    kept_points_done(&points);
    return status;
}

/* ------------------------------------------------------------------------------------------------ files */

static int compare_keys(const void *one, const void *other) {
    uint64_t a = *(const uint64_t *)one, b = *(const uint64_t *)other;
    return (a > b) - (a < b);
}

/* What is to be known of a file before it is divided. */
struct looked {
    vec3 low, high;
    uint64_t last; /* the key of the last of its most important points */
    double colour_scale;
};

static enum status look_at_colours(const struct parts *parts, const struct kept_points *points, struct looked *looked) {
    struct cloud cloud = *parts->like;
    struct mesh_attributes attributes;
    uint32_t *all = alloc_array(points->count, sizeof *all);
    const struct mesh mesh = {.vertex_count = points->count, .source = all};
    if (!all) return parts_no_memory(parts);
    for (size_t i = 0; i < points->count; i++) all[i] = (uint32_t)i;
    cloud.count = points->count;
    cloud.record = points->record;
    mesh_attributes_find(&mesh, &cloud, &attributes);
    if (attributes.colour[0]) looked->colour_scale = fmin(looked->colour_scale, attributes.colour_scale);
    free(all);
    return STATUS_OK;
}

static enum status look(const struct parts *parts, const struct part_file *file, bool colours, struct looked *looked) {
    struct kept_reader reader;
    size_t held = 0;
    uint64_t *key = alloc_array(HELD, sizeof *key);
    enum status status = kept_reader_open(&reader, file->path, file->count, parts->record_bytes, parts->w->error);
    if (!status && !key) status = parts_no_memory(parts);
    *looked = (struct looked){.last = UINT64_MAX, .colour_scale = 1};
    for (bool first = true; !status && reader.done < file->count; first = false) {
        status = kept_reader_next(&reader, file->path, parts->w->error);
        const struct kept_points *points = &reader.points;
        if (!status && first) looked->low = looked->high = points->position[0];
        for (size_t i = 0; !status && i < points->count; i++) {
            looked->low = vec3_min(looked->low, points->position[i]);
            looked->high = vec3_max(looked->high, points->position[i]);
            if (points->key[i] > looked->last) continue;
            key[held++] = points->key[i];
            if (held < HELD) continue;
            qsort(key, held, sizeof *key, compare_keys);
            held = OCTREE_TILE_POINTS;
            looked->last = key[held - 1];
        }
        if (!status && colours) status = look_at_colours(parts, points, looked);
    }
    if (!status && held >= OCTREE_TILE_POINTS) {
        qsort(key, held, sizeof *key, compare_keys);
        looked->last = key[OCTREE_TILE_POINTS - 1];
    }
    kept_reader_close(&reader);
    free(key);
    return status;
}

/* Eight files that are being written. */
struct dividing {
    struct part_file *part; /* OCTREE_PARTS of them */
    struct file_out file[OCTREE_PARTS];
    struct sink sink[OCTREE_PARTS];
    bool begun[OCTREE_PARTS];
};

static enum status begin_part(struct parts *parts, struct dividing *d, unsigned p) {
    const struct kept_head head = {.mark = KEPT_MARK};
    struct part_file *part = &d->part[p];
    struct error *error = parts->w->error;
    int n = snprintf(part->path, sizeof part->path, "%s.%zu", parts->w->points->file->path, parts->files++);
    if (n >= (int)sizeof part->path)
        return error_set(error, STATUS_IO, "tiles", "the scratch folder's name is too long");
    enum status status = file_out_begin(&d->file[p], part->path, error);
    if (status) return status;
    d->begun[p] = true;
    status = sink_init(&d->sink[p], d->file[p].fd);
    if (status) return parts_no_memory(parts);
    sink_bytes(&d->sink[p], &head, sizeof head);
    return STATUS_OK;
}

/* Files that aren't needed after a crash get their names without a sync: they are written anew. */
static enum status end_part(struct dividing *d, unsigned p, enum status status, struct error *error) {
    if (!d->begun[p]) return status;
    status = sink_done(&d->sink[p], status, error);
    if (!status && rename(d->file[p].temporary, d->part[p].path) != 0)
        status = error_set(error, STATUS_IO, "tiles", "can't rename %s", d->part[p].path);
    file_out_abort(&d->file[p]);
    return status;
}

/* The points of the tile into *own; the others into files of eighths. */
static enum status divide_file(struct parts *parts, const struct part_file *file, uint64_t last,
                               struct kept_points *own, struct part_file *part) {
    struct dividing d = {.part = part};
    struct kept_reader reader;
    struct error *error = parts->w->error;
    enum status status = kept_reader_open(&reader, file->path, file->count, parts->record_bytes, error);
    for (bool more = true; !status && more && reader.done < file->count;) {
        status = kept_reader_next(&reader, file->path, error);
        const struct kept_points *points = &reader.points;
        for (size_t i = 0; !status && i < points->count; i++) {
            if (points->key[i] <= last) {
                kept_points_add(own, points, i, parts->record_bytes);
                continue;
            }
            unsigned p = octree_part_of(&file->cube, vec3_sub(points->position[i], parts->w->origin));
            if (!d.begun[p]) status = begin_part(parts, &d, p);
            if (status) break;
            kept_put(&d.sink[p], points->key[i], points->position[i], points->record + i * parts->record_bytes,
                     parts->record_bytes);
            part[p].count++;
        }
    }
    kept_reader_close(&reader);
    for (unsigned p = 0; p < OCTREE_PARTS; p++) {
        part[p].cube = octree_cube_part(&file->cube, p);
        part[p].depth = file->depth + 1;
        status = end_part(&d, p, status, error);
    }
    return status;
}

/* An eighth of few points becomes the tile's own. */
static enum status take_few(struct parts *parts, struct part_file *part, struct kept_points *own) {
    struct kept_reader reader;
    enum status status = kept_reader_open(&reader, part->path, part->count, parts->record_bytes, parts->w->error);
    if (!status) status = kept_reader_next(&reader, part->path, parts->w->error);
    for (size_t i = 0; !status && i < reader.points.count; i++)
        kept_points_add(own, &reader.points, i, parts->record_bytes);
    kept_reader_close(&reader);
    unlink(part->path);
    part->count = 0;
    return status;
}

static enum status put_own(struct parts *parts, const struct part_file *file, const struct looked *looked,
                           struct kept_points *own, size_t *number) {
    struct writing *w = parts->w;
    struct node_chain *chain = &parts->chain;
    *number = w->nodes;
    enum status status = put_grown(parts, own, file->cube, file->depth, true);
    if (status) return status;
    struct octree_node *node = &w->node[*number];
    node->count = (size_t)file->count;
    node->low = vec3_sub(looked->low, w->origin);
    node->high = vec3_sub(looked->high, w->origin);
    parts->shown[file->depth] = w->tree;
    w->tree = (struct octree){0};
    chain->error[file->depth] = 0;
    chain->count = file->depth + 1;
    const struct octree *shown = &parts->shown[file->depth];
    return knn_new(shown->point, shown->points, w->points->threads, &chain->above[file->depth], NULL)
               ? parts_no_memory(parts)
               : STATUS_OK;
}

static enum status put_any(struct parts *parts, struct part_file *file, bool is_first);

/* The tiles of a file that doesn't fit: what is below comes behind it. */
static enum status put_large(struct parts *parts, struct part_file *file, bool is_first) {
    struct part_file *part = alloc_zeroed(OCTREE_PARTS, sizeof *part);
    struct kept_points own = {0};
    struct looked looked;
    size_t number = 0;
    enum status status = part ? STATUS_OK : parts_no_memory(parts);
    if (!status) status = look(parts, file, is_first, &looked);
    if (!status && is_first) {
        vec3 origin = vec3_lerp(looked.low, looked.high, 0.5);
        parts->w->origin = origin;
        parts->w->colour_scale = looked.colour_scale;
        file->cube = octree_cube_around(vec3_sub(looked.low, origin), vec3_sub(looked.high, origin));
    }
    if (!status &&
        kept_points_make(&own, OCTREE_TILE_POINTS + (size_t)OCTREE_PARTS * OCTREE_LEAST_POINTS, parts->record_bytes))
        status = parts_no_memory(parts);
    if (!status) status = divide_file(parts, file, looked.last, &own, part);
    if (!status && !is_first) unlink(file->path);
    for (unsigned p = 0; !status && p < OCTREE_PARTS; p++)
        if (part[p].count > 0 && part[p].count < OCTREE_LEAST_POINTS) status = take_few(parts, &part[p], &own);
    if (!status) status = put_own(parts, file, &looked, &own, &number);
    kept_points_done(&own);
    for (unsigned p = 0; part && p < OCTREE_PARTS; p++) {
        if (!status && part[p].count) status = put_any(parts, &part[p], false);
        if (part[p].path[0]) unlink(part[p].path);
    }
    if (!status) {
        parts->w->node[number].error = parts->chain.error[file->depth];
        parts->w->node[number].next = (uint32_t)parts->w->nodes;
    }
    knn_free(parts->chain.above[file->depth]);
    parts->chain.above[file->depth] = NULL;
    octree_done(&parts->shown[file->depth]);
    parts->chain.count = file->depth;
    free(part);
    return status;
}

static enum status put_any(struct parts *parts, struct part_file *file, bool is_first) {
    struct writing *w = parts->w;
    if (!is_first && file->count <= w->points->file->most_points) return put_file(parts, file);
    if (file->depth < OCTREE_DEEPEST) return put_large(parts, file, is_first);
    return error_set(w->error, STATUS_NO_MEMORY, "tiles", "%" PRIu64 " points lie within a billionth of the cloud",
                     file->count);
}

enum status parts_put(struct writing *w) {
    const struct kept_file *file = w->points->file;
    struct parts *parts = alloc_zeroed(1, sizeof *parts);
    struct part_file *all = alloc_zeroed(1, sizeof *all);
    enum status status = parts && all ? STATUS_OK : writing_no_memory(w);
    if (!status) {
        parts->w = w;
        parts->like = w->points->cloud;
        parts->record_bytes = file->record_bytes;
        all->count = file->count;
        if (snprintf(all->path, sizeof all->path, "%s", file->path) >= (int)sizeof all->path)
            status = error_set(w->error, STATUS_IO, "tiles", "the scratch folder's name is too long");
    }
    if (!status) status = put_any(parts, all, true);
    free(parts), free(all);
    return status;
}
