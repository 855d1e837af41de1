/* Points that are made up on flat faces which have points along their edges alone (core/spatial/flat_faces.h).
 *
 * A surface of all points is made of them too, and they count where it is judged: elsewhere that a mesh goes where no
 * points are speaks against it.  They are listed behind the points, as vertices that stand at none are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/pipeline/pipeline_run.h"
#include "core/spatial/flat_faces.h"

/* Behind each other what the points have and what those made up have. */
static enum status join(const struct run *run, const struct flat_faces *faces, struct made_points *made) {
    size_t n = run->points.count, all = n + faces->count;
    made->point = alloc_array(all, sizeof *made->point);
    made->normal = alloc_array(all, sizeof *made->normal);
    made->spacing = alloc_array(all, sizeof *made->spacing);
    if (run->creases.of) made->crease_of = alloc_array(all, sizeof *made->crease_of);
    if (!made->point || !made->normal || !made->spacing || (run->creases.of && !made->crease_of))
        return STATUS_NO_MEMORY;
    memcpy(made->point, run->points.point, n * sizeof *made->point);
    memcpy(made->point + n, faces->point, faces->count * sizeof *made->point);
    memcpy(made->normal, run->normal, n * sizeof *made->normal);
    memcpy(made->normal + n, faces->normal, faces->count * sizeof *made->normal);
    memcpy(made->spacing, run->neighbours.spacing, n * sizeof *made->spacing);
    memcpy(made->spacing + n, faces->spacing, faces->count * sizeof *made->spacing);
    made->creases = run->creases;
    if (made->crease_of) {
        memcpy(made->crease_of, run->creases.of, n * sizeof *made->crease_of);
        memset(made->crease_of + n, 0xff, faces->count * sizeof *made->crease_of);
        made->creases.of = made->crease_of;
    }
    return knn_new(made->point, all, run->threads, &made->knn, NULL);
}

enum status made_points_find(struct run *run) {
    struct made_points *made = &run->made;
    struct flat_faces faces = {0};
    if (made->sought) return STATUS_OK;
    enum status status =
        flat_faces_find(run->knn, &run->neighbours, run->points.point, run->points.count, run->threads, &faces);
    made->holes = faces.holes;
    if (!status && faces.count) status = join(run, &faces, made);
    made->count = status ? 0 : faces.count;
    made->sought = !status;
    flat_faces_done(&faces);
    return status;
}

enum status made_points_add(const struct run *run, struct sites *sites) {
    const struct made_points *made = &run->made;
    size_t n = run->points.count, k = sites->count, all = k + made->count;
    uint32_t *id = alloc_resize(sites->id, all, sizeof *id);
    if (id) sites->id = id;
    vec3 *point = alloc_resize(sites->point, all, sizeof *point);
    if (point) sites->point = point;
    vec3 *normal = alloc_resize(sites->normal, all, sizeof *normal);
    if (normal) sites->normal = normal;
    double *support = alloc_resize(sites->support, all, sizeof *support);
    if (support) sites->support = support;
    uint32_t *of_point = alloc_resize(sites->of_point, n + made->count, sizeof *of_point);
    if (of_point) sites->of_point = of_point;
    if (!id || !point || !normal || !support || !of_point) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < made->count; i++) {
        id[k + i] = (uint32_t)(n + i);
        point[k + i] = made->point[n + i], normal[k + i] = made->normal[n + i];
        support[k + i] = (double)made->spacing[n + i];
        of_point[n + i] = (uint32_t)(k + i);
    }
    sites->count = all, sites->made = made->count;
    return STATUS_OK;
}

void made_points_tell(const struct run *run) {
    memcpy(run->made.normal, pipeline_normals_told(run), run->points.count * sizeof *run->made.normal);
}

struct metro_reference pipeline_reference(const struct run *run) {
    if (run->with_made) {
        made_points_tell(run);
        const struct made_points *made = &run->made;
        return (struct metro_reference){
            run->points.count + made->count, made->point, made->normal, made->spacing, made->knn, NULL};
    }
    return (struct metro_reference){run->points.count,       run->points.point, pipeline_normals_told(run),
                                    run->neighbours.spacing, run->knn,          NULL};
}

void made_points_done(struct made_points *made) {
    free(made->point), free(made->normal), free(made->spacing), free(made->crease_of);
    knn_free(made->knn);
    *made = (struct made_points){0};
}
