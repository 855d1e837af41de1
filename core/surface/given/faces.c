/* Which of an input's faces count, and the mesh of them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/given/faces.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/radix.h"
#include "core/surface/given/seams.h"
#include "core/surface/given/sides.h"

void faces_done(struct faces *faces) {
    free(faces->triangle), free(faces->record), free(faces->on_seam);
    *faces = (struct faces){0};
}

/* ------------------------------------------------------------------------------------------------ which count */

struct sorting {
    const struct cloud *cloud;
    const struct ordered_points *points;
    bool keep_flat;
};

/* The key of a face's corners, the k-th smallest: equal for those that are one place. */
static uint32_t corner_key(const struct sorting *s, uint32_t t, int k) {
    uint32_t key[3];
    for (int i = 0; i < 3; i++) {
        uint32_t corner = s->cloud->triangle[t][i], distinct = s->points->distinct[corner];
        key[i] = distinct == NONE ? corner : s->points->original[distinct];
    }
    for (int i = 1; i < 3; i++)
        for (int j = i; j > 0 && key[j] < key[j - 1]; j--) {
            uint32_t larger = key[j - 1];
            key[j - 1] = key[j], key[j] = larger;
        }
    return key[k];
}

static bool same_corners(const struct sorting *s, uint32_t t, uint32_t u) {
    for (int k = 0; k < 3; k++)
        if (corner_key(s, t, k) != corner_key(s, u, k)) return false;
    return true;
}

/* Whether a face is a point or a line, as far as its corners' coordinates tell, or its corners do. */
static bool is_flat(const struct sorting *s, uint32_t t) {
    const uint32_t *corner = s->cloud->triangle[t];
    if (s->keep_flat) return corner_key(s, t, 0) == corner_key(s, t, 1) || corner_key(s, t, 1) == corner_key(s, t, 2);
    vec3 p[3];
    for (int k = 0; k < 3; k++)
        p[k] = vec3_scale(vec3_sub(s->cloud->position[corner[k]], s->points->centre), 1 / s->points->scale);
    return !(vec3_length_sq(vec3_triangle_normal(p[0], p[1], p[2])) > 0);
}

/* Faces in the order of their corners' keys, the largest first: those of equal ones stand together, by their ids.
 * item: n and as many more. */
static uint64_t *sort_faces(const struct sorting *s, uint64_t *item, size_t n, unsigned threads) {
    uint64_t *spare = item + n;
    for (int k = 2; k >= 0; k--) {
        for (size_t i = 0; i < n; i++) {
            uint32_t t = k == 2 ? (uint32_t)i : radix_value(item[i]);
            item[i] = radix_item(corner_key(s, t, k), t);
        }
        uint64_t *sorted = radix_sort(item, spare, n, threads);
        if (sorted != item) spare = item, item = sorted;
    }
    return item;
}

enum status faces_sort_out(const struct cloud *cloud, const struct ordered_points *points, bool keep_flat,
                           unsigned threads, uint8_t *left_out, size_t *flat, size_t *repeated) {
    struct sorting s = {cloud, points, keep_flat};
    size_t n = cloud->triangle_count;
    uint64_t *item = alloc_array(n, 2 * sizeof *item);
    if (!item) return STATUS_NO_MEMORY;
    *flat = *repeated = 0;
    const uint64_t *sorted = sort_faces(&s, item, n, threads);
    for (size_t i = 0; i < n; i++) {
        uint32_t t = radix_value(sorted[i]);
        left_out[t] = is_flat(&s, t);
        *flat += left_out[t];
        if (left_out[t] || i == 0 || !same_corners(&s, radix_value(sorted[i - 1]), t)) continue;
        left_out[t] = 1, ++*repeated;
    }
    free(item);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the surface */

static bool is_dropped(const struct cloud *cloud, const struct ordered_points *points, size_t t) {
    for (int k = 0; k < 3; k++)
        if (points->distinct[cloud->triangle[t][k]] == NONE) return true;
    return false;
}

static uint32_t lowest_corner(const struct ordered_points *points, const uint32_t corner[3]) {
    uint32_t lowest = points->distinct[corner[0]];
    for (int k = 1; k < 3; k++)
        if (points->distinct[corner[k]] < lowest) lowest = points->distinct[corner[k]];
    return lowest;
}

/* The triangles that count by their lowest corner, so that neighbours in space are neighbours in memory.  start:
 * zeroed, one for each point, and one more. */
static void fill(const struct cloud *cloud, const struct ordered_points *points, const uint8_t *left_out,
                 uint32_t *start, struct faces *faces) {
    for (size_t t = 0; t < cloud->triangle_count; t++)
        if (!left_out[t]) start[lowest_corner(points, cloud->triangle[t]) + 1]++;
    for (size_t p = 0; p < points->count; p++) start[p + 1] += start[p];
    for (size_t t = 0; t < cloud->triangle_count; t++) {
        if (left_out[t]) continue;
        size_t at = start[lowest_corner(points, cloud->triangle[t])]++;
        memcpy(faces->record[at], cloud->triangle[t], sizeof *faces->record);
        for (int k = 0; k < 3; k++) faces->triangle[at][k] = points->distinct[cloud->triangle[t][k]];
        faces->count++;
    }
}

static enum status take_faces(const struct cloud *cloud, const struct ordered_points *points, unsigned threads,
                              struct faces *faces, struct faces_facts *facts) {
    size_t n = cloud->triangle_count, count = 0;
    uint8_t *left_out = alloc_zeroed(n, 1);
    uint32_t *start = alloc_zeroed(points->count + 1, sizeof *start);
    enum status status = left_out && start
                             ? faces_sort_out(cloud, points, true, threads, left_out, &facts->flat, &facts->repeated)
                             : STATUS_NO_MEMORY;
    for (size_t t = 0; !status && t < n; t++) {
        left_out[t] |= is_dropped(cloud, points, t);
        count += !left_out[t];
    }
    if (!status) {
        faces->triangle = alloc_array(count, sizeof *faces->triangle);
        faces->record = alloc_array(count, sizeof *faces->record);
        status = faces->triangle && faces->record ? STATUS_OK : STATUS_NO_MEMORY;
    }
    if (!status) fill(cloud, points, left_out, start, faces);
    free(left_out), free(start);
    return status;
}

enum status faces_make(const struct cloud *cloud, const struct ordered_points *points, unsigned threads,
                       struct faces *faces, struct faces_facts *facts) {
    struct faces made = {0};
    struct faces_facts found = {0};
    enum status status = take_faces(cloud, points, threads, &made, &found);
    if (!status) status = sides_agree(&made, points->count, threads, &found);
    if (!status) status = seams_find(cloud, points, threads, &made, &found);
    if (status) {
        faces_done(&made);
        return status;
    }
    *faces = made;
    *facts = found;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ as a mesh */

enum status faces_mesh(const struct faces *faces, const struct ordered_points *points, struct mesh *mesh) {
    struct mesh made = {.vertex_count = points->count, .triangle_count = faces->count};
    made.vertex = alloc_array(points->count, sizeof *made.vertex);
    made.source = alloc_array(points->count, sizeof *made.source);
    made.triangle = alloc_array(faces->count, sizeof *made.triangle);
    made.tag = alloc_zeroed(faces->count, sizeof *made.tag);
    if (!made.vertex || !made.source || !made.triangle || !made.tag) {
        mesh_done(&made);
        return STATUS_NO_MEMORY;
    }
    memcpy(made.vertex, points->point, points->count * sizeof *made.vertex);
    for (size_t v = 0; v < points->count; v++) made.source[v] = (uint32_t)v;
    memcpy(made.triangle, faces->triangle, faces->count * sizeof *made.triangle);
    *mesh = made;
    return STATUS_OK;
}

/* Of the copies of a vertex, the one that has this record; a new one where none has. */
static uint32_t copy_with(uint32_t *next, uint32_t *record, size_t *count, uint32_t v, uint32_t wanted) {
    while (record[v] != NONE && record[v] != wanted) {
        if (next[v] == NONE) {
            next[v] = (uint32_t)*count;
            next[*count] = record[*count] = NONE;
            ++*count;
        }
        v = next[v];
    }
    record[v] = wanted;
    return v;
}

enum status faces_cut(struct mesh *mesh, const uint32_t (*record)[3], uint32_t **of_vertex) {
    size_t n = mesh->vertex_count, most = n + 3 * mesh->triangle_count, count = n;
    uint32_t *next = alloc_array(most, sizeof *next), *of = alloc_array(most, sizeof *of);
    vec3 *vertex = NULL;
    uint32_t *source = NULL;
    enum status status = next && of ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) {
        memset(next, 0xff, n * sizeof *next), memset(of, 0xff, n * sizeof *of);
        for (size_t t = 0; t < mesh->triangle_count; t++)
            for (int k = 0; k < 3; k++) copy_with(next, of, &count, mesh->triangle[t][k], record[t][k]);
        vertex = alloc_array(count, sizeof *vertex), source = alloc_array(count, sizeof *source);
        status = vertex && source ? STATUS_OK : STATUS_NO_MEMORY;
    }
    if (!status) {
        for (size_t t = 0; t < mesh->triangle_count; t++)
            for (int k = 0; k < 3; k++) {
                uint32_t v = mesh->triangle[t][k], copy = copy_with(next, of, &count, v, record[t][k]);
                mesh->triangle[t][k] = copy;
                vertex[copy] = mesh->vertex[v], source[copy] = mesh->source[v];
            }
        for (size_t v = 0; v < n; v++) vertex[v] = mesh->vertex[v], source[v] = mesh->source[v];
        free(mesh->vertex), free(mesh->source);
        mesh->vertex = vertex, mesh->source = source, mesh->vertex_count = count;
        *of_vertex = of;
    } else {
        free(vertex), free(source), free(of);
    }
    free(next);
    return status;
}
