/* The triangles of a surface of all points, which a mesh of fewer vertices is fitted to.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/radix.h"
#include "core/cloud/cloud.h"
#include "core/pipeline/pipeline_run.h"

void surface_faces_done(struct surface_faces *faces) {
    free(faces->face), free(faces->point), free(faces->normal), free(faces->spacing);
    *faces = (struct surface_faces){0};
}

/* Triangles that close a cut have corners at no point, as those at a crease have, which come last of all vertices.
 * points: with those made up. */
static enum status number_corners(const struct mesh *surface, size_t points, size_t sharp, uint32_t **number) {
    *number = alloc_array(surface->vertex_count, sizeof **number);
    if (!*number) return STATUS_NO_MEMORY;
    size_t first = surface->vertex_count - sharp;
    for (size_t v = 0; v < surface->vertex_count; v++)
        (*number)[v] = v < first ? surface->source[v] : (uint32_t)(points + v - first);
    return STATUS_OK;
}

/* The surface's triangles as ids of points, in the order of the lowest of each, but for those that close a cut: what
 * the mesh is fitted to. */
static enum status list_faces(const struct mesh *surface, const uint32_t *number, unsigned threads,
                              struct surface_faces *faces) {
    size_t n = surface->triangle_count, count = 0;
    uint64_t *item = alloc_array(n, sizeof *item), *spare = alloc_array(n, sizeof *spare), *sorted = NULL;
    faces->face = alloc_array(n, sizeof *faces->face);
    bool room = item && spare && faces->face;
    for (size_t t = 0; room && t < n; t++) {
        const uint32_t *corner = surface->triangle[t];
        uint32_t lowest = number[corner[0]], highest = lowest;
        for (int k = 1; k < 3; k++) {
            uint32_t id = number[corner[k]];
            lowest = id < lowest ? id : lowest, highest = id > highest ? id : highest;
        }
        if (highest != NONE) item[count++] = radix_item(lowest, (uint32_t)t);
    }
    if (room) sorted = radix_sort(item, spare, count, threads);
    for (size_t i = 0; room && i < count; i++)
        for (int k = 0; k < 3; k++) faces->face[i][k] = number[surface->triangle[radix_value(sorted[i])][k]];
    faces->count = count;
    free(item), free(spare);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

static size_t points_known(const struct run *run) { return run->points.count + (run->with_made ? run->made.count : 0); }

/* Points, and behind them those made up and the surface's last vertices, which stand at none. */
static enum status add_sharp(const struct run *run, const struct mesh *surface, size_t sharp,
                             struct surface_faces *faces) {
    const struct made_points *made = &run->made;
    size_t points = run->points.count, n = points_known(run) + sharp;
    faces->n = n;
    faces->point = alloc_array(n, sizeof *faces->point);
    faces->normal = alloc_zeroed(n, sizeof *faces->normal);
    faces->spacing = alloc_zeroed(n, sizeof *faces->spacing);
    if (!faces->point || !faces->normal || !faces->spacing) return STATUS_NO_MEMORY;
    memcpy(faces->point, run->points.point, points * sizeof *faces->point);
    memcpy(faces->normal, pipeline_normals_told(run), points * sizeof *faces->normal);
    memcpy(faces->spacing, run->neighbours.spacing, points * sizeof *faces->spacing);
    if (n - sharp > points) {
        memcpy(faces->point + points, made->point + points, made->count * sizeof *faces->point);
        memcpy(faces->normal + points, made->normal + points, made->count * sizeof *faces->normal);
        memcpy(faces->spacing + points, made->spacing + points, made->count * sizeof *faces->spacing);
        points += made->count;
    }
    memcpy(faces->point + points, surface->vertex + surface->vertex_count - sharp, sharp * sizeof *faces->point);
    for (size_t f = 0; f < faces->count; f++)
        for (int k = 0; k < 3; k++) {
            const uint32_t *corner = faces->face[f];
            uint32_t at = corner[k], beside = corner[(k + 1) % 3];
            if (at >= points && beside < points) faces->spacing[at] = fmaxf(faces->spacing[at], faces->spacing[beside]);
        }
    return STATUS_OK;
}

enum status pipeline_list_faces(const struct run *run, const struct mesh *surface, size_t sharp,
                                struct surface_faces *faces) {
    uint32_t *number = NULL;
    enum status status = number_corners(surface, points_known(run), sharp, &number);
    if (!status) status = list_faces(surface, number, run->threads, faces);
    if (!status && (sharp || run->with_made)) status = add_sharp(run, surface, sharp, faces);
    free(number);
    return status;
}
