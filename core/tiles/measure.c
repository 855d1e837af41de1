/* How far all points of the input are from what was made of those that memory has room for.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/base/par.h"
#include "core/measure/metro.h"
#include "core/measure/tangent.h"
#include "core/spatial/bvh.h"
#include "core/spatial/knn.h"
#include "core/tiles/pieces.h"
#include "core/tiles/tiles.h"

/* Places of the frame. */
struct places {
    size_t slots; /* a power of two, more than there are places; 0: there are none */
    vec3 *slot;   /* owned; NAN where it is free */
};

/* What a level's points are measured to, and what they come to. */
struct level {
    struct bvh *mesh;
    struct knn *knn; /* over the kept points, along the curve */
    vec3 *kept, *normal;
    struct distance_sum to_mesh, to_planes;
};

struct measuring {
    const char *folder;
    unsigned threads;
    const struct progress *progress;
    const struct cloud *cloud;
    const float (*facing)[3];
    const struct pipeline_result *made;
    struct error *error;
    struct scratch scratch;
    struct places dropped; /* owned, as all that follows */
    size_t level_count;
    struct level level[PARAMS_MAX_LEVELS];
    vec3 *left; /* of a piece, without those that were dropped */
};

/* ------------------------------------------------------------------------------------------------ dropped points */

static vec3 *find_place(const struct places *places, vec3 p) {
    uint64_t bits[3];
    memcpy(bits, &p, sizeof bits);
    size_t s = (size_t)hash64(bits[0] ^ hash64(bits[1] ^ hash64(bits[2]))) & (places->slots - 1);
    while (!isnan(places->slot[s].x) && memcmp(&places->slot[s], &p, sizeof p) != 0) s = (s + 1) & (places->slots - 1);
    return &places->slot[s];
}

static enum status list_dropped(struct measuring *m) {
    struct places *places = &m->dropped;
    size_t slots = 2;
    if (!m->made->dropped) return STATUS_OK;
    while (slots < 2 * m->made->report.points_outliers) slots *= 2;
    places->slot = alloc_array(slots, sizeof *places->slot);
    if (!places->slot) return STATUS_NO_MEMORY;
    places->slots = slots;
    for (size_t i = 0; i < slots; i++) places->slot[i] = (vec3){NAN, NAN, NAN};
    for (size_t i = 0; i < m->cloud->count; i++) {
        vec3 p = order_in_frame(&m->scratch.head.whole, m->cloud->position[i]);
        if (m->made->dropped[i]) *find_place(places, p) = p;
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ levels */

static enum status prepare_mesh(const struct measuring *m, const struct mesh *mesh, struct level *level) {
    struct mesh framed = *mesh;
    if (!mesh->triangle_count) return STATUS_OK;
    framed.vertex = alloc_array(mesh->vertex_count, sizeof *framed.vertex);
    if (!framed.vertex) return STATUS_NO_MEMORY;
    for (size_t v = 0; v < mesh->vertex_count; v++)
        framed.vertex[v] = order_in_frame(&m->scratch.head.whole, mesh->vertex[v]);
    enum status status = bvh_new(&framed, m->threads, &level->mesh);
    free(framed.vertex);
    return status;
}

/* The planes at the k kept points, where they have been moved to, along the curve. */
static enum status prepare_planes(const struct measuring *m, size_t k, struct level *level) {
    const struct pipeline_result *made = m->made;
    const vec3 *position = made->moved ? made->moved : m->cloud->position;
    struct ordered_points along = {0};
    if (!m->facing || !made->kept) return STATUS_OK;
    level->kept = alloc_array(k, sizeof *level->kept);
    level->normal = alloc_array(k, sizeof *level->normal);
    if (!level->kept || !level->normal) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < k; i++) level->kept[i] = position[made->kept[i]];
    enum status status = order_points_of(&m->scratch.head.whole, level->kept, k, m->threads, &along);
    for (size_t i = 0; !status && i < along.count; i++) {
        const float *normal = m->facing[made->kept[along.original[i]]];
        level->kept[i] = along.point[i];
        level->normal[i] = (vec3){(double)normal[0], (double)normal[1], (double)normal[2]};
    }
    if (!status) status = knn_new(level->kept, along.count, m->threads, &level->knn, NULL);
    ordered_points_done(&along);
    return status;
}

static enum status prepare(struct measuring *m) {
    enum status status = list_dropped(m);
    m->left = alloc_array(PIECES_MOST_POINTS, sizeof *m->left);
    if (!m->left) status = STATUS_NO_MEMORY;
    m->level_count = m->made->level_count;
    for (size_t i = 0; !status && i < m->level_count; i++) {
        const struct pipeline_level *made = &m->made->level[i];
        status = prepare_mesh(m, &made->mesh, &m->level[i]);
        if (!status) status = prepare_planes(m, made->kept_count, &m->level[i]);
    }
    return status;
}

static void measuring_done(struct measuring *m) {
    for (size_t i = 0; i < m->level_count; i++) {
        bvh_free(m->level[i].mesh);
        knn_free(m->level[i].knn);
        free(m->level[i].kept), free(m->level[i].normal);
    }
    free(m->dropped.slot), free(m->left);
    scratch_done(&m->scratch);
}

/* ------------------------------------------------------------------------------------------------ all points */

static enum status measure_levels_of_piece(void *ctx, const vec3 *point, size_t n) {
    struct measuring *m = ctx;
    enum status status = STATUS_OK;
    if (m->dropped.slots) {
        size_t left = 0;
        for (size_t i = 0; i < n; i++)
            if (isnan(find_place(&m->dropped, point[i])->x)) m->left[left++] = point[i];
        point = m->left, n = left;
    }
    for (size_t i = 0; !status && i < m->level_count; i++) {
        struct level *level = &m->level[i];
        const struct tangent_planes planes = {level->knn, level->kept, level->normal};
        if (level->mesh) status = metro_add_points(level->mesh, point, n, m->threads, &level->to_mesh);
        if (!status && level->knn) status = tangent_add(&planes, point, n, m->threads, &level->to_planes);
    }
    return status;
}

static int measure_all_tick(void *ctx, double fraction) {
    const struct measuring *m = ctx;
    return progress_tick(m->progress, "measure_all", fraction);
}

static void report_all(const struct measuring *m, struct report *report) {
    double scale = m->scratch.head.whole.scale;
    for (size_t i = 0; i < m->level_count; i++) {
        struct report_level *to = &report->level[i];
        to->tangent = distance_sum_stats(&m->level[i].to_planes, scale);
        if (!m->level[i].mesh) continue;
        to->input_to_mesh = distance_sum_stats(&m->level[i].to_mesh, scale);
        report_set_symmetric(to);
    }
}

enum status tiles_measure(const char *folder, unsigned threads, const struct progress *progress,
                          const struct cloud *cloud, const float (*facing)[3], struct pipeline_result *made,
                          struct error *error) {
    struct measuring m = {.folder = folder,
                          .threads = threads,
                          .progress = progress,
                          .cloud = cloud,
                          .facing = facing,
                          .made = made,
                          .error = error};
    struct par_team *team = par_team_new();
    enum status status = team ? scratch_load(folder, &m.scratch, error) : STATUS_NO_MEMORY;
    const struct pieces pieces = {folder, &m.scratch, threads, measure_levels_of_piece, measure_all_tick, &m, error};
    if (!status) status = prepare(&m);
    if (!status) status = pieces_take(&pieces);
    par_team_free(team);
    if (status == STATUS_CANCELLED) error_set(error, status, "tiles", "cancelled");
    if (status == STATUS_NO_MEMORY) error_set(error, status, "tiles", "not enough memory to measure all points");
    if (!status) report_all(&m, &made->report);
    measuring_done(&m);
    return status;
}
