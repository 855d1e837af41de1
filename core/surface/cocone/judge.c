/* Judging by the original points.
 *
 * Two labellings of the same cells differ in a few groups of cells: a thin part that one fills and the other leaves
 * out, a gap that one bridges.  For each group both surfaces are there to be measured, in both directions:
 *
 *     from the points   distances of the original points to the two surfaces, where they differ; by the area that a
 *                       point stands for
 *     from the surface  distances of the facets that only one surface has to the tangent disks of the points nearest
 *                       to them; by the facet's area
 *
 * less a part of the facets' own size, so that nothing is changed for a hair's breadth: two ways to mesh the same
 * surface are the refinement's business.  Groups that are too thin to make up for that part aren't measured at all; on
 * a dense cloud most are.
 *
 * A score is a volume: about the one that lies between surface and points.  Only points that stand for a vertex of a
 * cell that differs are measured, and only facets that touch such a vertex.
 *
 * Invariant: sums are added up in the order of points and of facets, so the result doesn't depend on threads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/judge.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/spatial/bvh.h"
#include "core/spatial/knn.h"
#include "core/surface/cocone/boundary.h"

enum { GRAIN = 256, CORNER_GRAIN = 4096, BATCH = 1 << 14, PLACES = 4 };

static const uint32_t NOT_JUDGED = NONE - 1; /* the group of cells whose difference is too small */

#define DISK 2.0 /* radius of a tangent disk, in spacings of its point */

static const double FAR = 4096,
                    NEARLY = 0x1p-11; /* struct knn_slack: no place within the box of a scan is so far off */

/* Where a facet is measured: the middle, and towards the middles of its edges. */
static const double place_at[PLACES][3] = {
    {1 / 3.0, 1 / 3.0, 1 / 3.0}, {0.1, 0.45, 0.45}, {0.45, 0.1, 0.45}, {0.45, 0.45, 0.1}};

/* One of the two surfaces, near the differences. */
struct side {
    const uint8_t *inside;
    struct mesh mesh;
    uint32_t *half; /* of each triangle, of the inner cell; owned */
    struct bvh *bvh;
};

struct judge {
    const struct cocone_star *star;
    const struct reconstruct_dense *dense;
    unsigned threads;
    struct side side[2]; /* inside as it is; the other */
    double patience, matters;
    uint32_t *group; /* of each cell that differs, or NOT_JUDGED; NONE for the others */
    uint32_t group_count;
    uint8_t *near;   /* of each vertex: it belongs to a cell that differs */
    double *score;   /* of each group: > 0 when the other is better */
    uint32_t *point; /* the original points to be measured */
    size_t point_count;
    struct bvh_hit (*hit)[2];
};

/* ------------------------------------------------------------------------------------------------ groups */

static bool differs(const struct judge *j, uint32_t cell) { return j->side[0].inside[cell] != j->side[1].inside[cell]; }

/* Lists the cells connected with the first one of the list that differ, too; how many. */
static size_t flood_group(struct judge *j, uint32_t *list) {
    size_t count = 1;
    j->group[list[0]] = j->group_count;
    for (size_t k = 0; k < count; k++) {
        for (int i = 0; i < 4; i++) {
            uint32_t other = j->star->tets->neighbour[list[k]][i];
            if (j->group[other] != NONE || !differs(j, other)) continue;
            j->group[other] = j->group_count;
            list[count++] = other;
        }
    }
    return count;
}

static double volume_of(const struct judge *j, uint32_t cell) {
    const uint32_t *v = j->star->tets->vertex[cell];
    const vec3 *p = j->star->point;
    vec3 normal = vec3_triangle_normal(p[v[0]], p[v[1]], p[v[2]]);
    return fabs(vec3_dot(normal, vec3_sub(p[v[3]], p[v[0]]))) / 6;
}

/* What a facet of one surface alone has to be better by. */
static double facet_matters(const struct judge *j, const uint32_t v[3]) {
    const vec3 *p = j->star->point;
    double area = vec3_length(vec3_triangle_normal(p[v[0]], p[v[1]], p[v[2]])) / 2;
    return j->matters * area * sqrt(area);
}

/* The same of all facets that either surface has at the cell, each of them once. */
static double cell_matters(const struct judge *j, uint32_t cell) {
    double sum = 0;
    for (unsigned i = 0; i < 4; i++) {
        uint32_t other = j->star->tets->neighbour[cell][i], v[3];
        if (j->group[other] == j->group_count && other < cell) continue;
        cocone_star_vertices(j->star, cocone_star_pack(cell, i), v);
        for (int s = 0; s < 2; s++)
            if (j->side[s].inside[cell] != j->side[s].inside[other]) sum += facet_matters(j, v);
    }
    return sum;
}

/* A group is judged if it could win at all: in each of the two directions a score is about its volume at most. */
static void add_group(struct judge *j, uint32_t *list) {
    size_t count = flood_group(j, list);
    double volume = 0, matters = 0;
    for (size_t k = 0; k < count; k++) volume += volume_of(j, list[k]), matters += cell_matters(j, list[k]);
    if (2 * volume > matters) {
        for (size_t k = 0; k < count; k++)
            for (int i = 0; i < 4; i++) j->near[j->star->tets->vertex[list[k]][i]] = 1;
        j->group_count++;
    } else {
        for (size_t k = 0; k < count; k++) j->group[list[k]] = NOT_JUDGED;
    }
}

static void find_connected(struct judge *j, uint32_t *list) {
    for (uint32_t c = 0; c < j->star->tets->finite_count; c++) {
        if (j->group[c] != NONE || !differs(j, c)) continue;
        list[0] = c;
        add_group(j, list);
    }
}

static void copy_groups(struct judge *j, const struct cocone_proposal *proposal) {
    for (uint32_t c = 0; c < j->star->tets->finite_count; c++) {
        if (!differs(j, c)) continue;
        j->group[c] = proposal->group[c];
        for (int i = 0; i < 4; i++) j->near[j->star->tets->vertex[c][i]] = 1;
    }
    j->group_count = proposal->groups;
}

static enum status find_groups(struct judge *j, const struct cocone_proposal *proposal) {
    const struct tets *tets = j->star->tets;
    j->group = alloc_array(tets->cell_count, sizeof *j->group);
    j->near = alloc_zeroed(j->star->n, 1);
    uint32_t *list = alloc_array(tets->finite_count, sizeof *list);
    bool ok = j->group && j->near && list;
    if (ok) memset(j->group, 0xff, tets->cell_count * sizeof *j->group);
    if (ok && proposal->group)
        copy_groups(j, proposal);
    else if (ok)
        find_connected(j, list);
    free(list);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

/* ------------------------------------------------------------------------------------------------ surfaces */

struct corners {
    const struct cocone_star *star;
    struct side *side;
};

static void corner_range(void *ctx, size_t begin, size_t end) {
    const struct corners *corners = ctx;
    for (size_t t = begin; t < end; t++)
        cocone_star_vertices(corners->star, corners->side->half[t], corners->side->mesh.triangle[t]);
}

static enum status build_side(const struct judge *j, struct side *side) {
    struct mesh *mesh = &side->mesh;
    struct corners corners = {j->star, side};
    enum status status =
        cocone_boundary_list(j->star, side->inside, j->near, j->threads, &side->half, &mesh->triangle_count);
    if (status) return status;
    mesh->triangle = alloc_array(mesh->triangle_count, sizeof *mesh->triangle);
    if (!mesh->triangle) return STATUS_NO_MEMORY;
    par_for(j->threads, mesh->triangle_count, CORNER_GRAIN, corner_range, &corners);
    mesh->vertex_count = j->star->n;
    mesh->vertex = (vec3 *)j->star->point;
    return bvh_new(mesh, j->threads, &side->bvh);
}

static void side_done(struct side *side) {
    free(side->half), free(side->mesh.triangle);
    bvh_free(side->bvh);
}

static bool is_judged(const struct judge *j, uint32_t cell) { return j->group[cell] < j->group_count; }

/* The group that a facet is one side's alone by; NONE when there is none that is judged. */
static uint32_t group_of(const struct judge *j, uint32_t half) {
    uint32_t cell = cocone_star_cell(half), other = j->star->tets->neighbour[cell][cocone_star_index(half)];
    return is_judged(j, cell) ? j->group[cell] : is_judged(j, other) ? j->group[other] : NONE;
}

/* ------------------------------------------------------------------------------------------------ from the points */

static void hit_range(void *ctx, size_t begin, size_t end) {
    struct judge *j = ctx;
    uint32_t hint[2] = {NONE, NONE};
    for (size_t i = begin; i < end; i++) {
        for (int s = 0; s < 2; s++) {
            j->hit[i][s] = bvh_closest(j->side[s].bvh, j->dense->point[j->point[i]], hint[s]);
            hint[s] = j->hit[i][s].triangle;
        }
    }
}

static double distance_of(const struct bvh_hit *hit) { return hit->triangle == NONE ? 1 : sqrt(hit->distance_sq); }

/* The nearer facet is one that the other side hasn't. */
static void score_point(struct judge *j, size_t i) {
    const struct bvh_hit *hit = j->hit[i];
    double now = distance_of(&hit[0]), then = distance_of(&hit[1]);
    if (now == then) return;
    int nearer = now > then;
    uint32_t group = group_of(j, j->side[nearer].half[hit[nearer].triangle]);
    double spacing = (double)j->dense->spacing[j->point[i]];
    if (group != NONE) j->score[group] += spacing * spacing * (j->patience * now - then);
}

static enum status score_points(struct judge *j) {
    const struct reconstruct_dense *dense = j->dense;
    j->point = alloc_array(dense->n, sizeof *j->point);
    if (!j->point) return STATUS_NO_MEMORY;
    for (uint32_t p = 0; p < dense->n; p++)
        if (j->near[dense->site[p]]) j->point[j->point_count++] = p;
    j->hit = alloc_array(j->point_count, sizeof *j->hit);
    if (!j->hit) return STATUS_NO_MEMORY;
    par_for(j->threads, j->point_count, GRAIN, hit_range, j);
    for (size_t i = 0; i < j->point_count; i++) score_point(j, i);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ from the surface */

/* Facets that are waiting for the points nearest to them. */
struct batch {
    size_t n;
    uint32_t group[BATCH / PLACES];
    double weight[BATCH / PLACES];
    vec3 place[BATCH];
    uint32_t nearest[BATCH];
    double distance_sq[BATCH];
};

static double to_disk(const struct reconstruct_dense *dense, vec3 place, uint32_t q, double distance_sq) {
    double reach = DISK * (double)dense->spacing[q];
    if (distance_sq > reach * reach) return sqrt(distance_sq);
    return fabs(vec3_dot(vec3_sub(place, dense->point[q]), dense->normal[q]));
}

static enum status score_batch(struct judge *j, struct batch *b) {
    enum status status = knn_search_nearly(j->dense->knn, &(struct knn_slack){j->dense->spacing, FAR, NEARLY}, b->place,
                                           b->n, 1, j->threads, b->nearest, b->distance_sq);
    for (size_t i = 0; i < b->n && !status; i++)
        j->score[b->group[i / PLACES]] +=
            b->weight[i / PLACES] * to_disk(j->dense, b->place[i], b->nearest[i], b->distance_sq[i]);
    b->n = 0;
    return status;
}

static void add_facet(const struct judge *j, struct batch *b, const uint32_t v[3], uint32_t group, double weight) {
    const vec3 *p = j->star->point;
    b->group[b->n / PLACES] = group;
    double area = vec3_length(vec3_triangle_normal(p[v[0]], p[v[1]], p[v[2]])) / 2;
    b->weight[b->n / PLACES] = weight * area / PLACES;
    j->score[group] -= facet_matters(j, v);
    for (int k = 0; k < PLACES; k++) {
        vec3 at = vec3_scale(p[v[0]], place_at[k][0]);
        at = vec3_add(at, vec3_scale(p[v[1]], place_at[k][1]));
        b->place[b->n++] = vec3_add(at, vec3_scale(p[v[2]], place_at[k][2]));
    }
}

static enum status score_facets(struct judge *j) {
    struct batch *b = alloc_array(1, sizeof *b);
    if (!b) return STATUS_NO_MEMORY;
    enum status status = STATUS_OK;
    b->n = 0;
    for (int s = 0; s < 2; s++) {
        const struct side *side = &j->side[s];
        for (size_t t = 0; t < side->mesh.triangle_count && !status; t++) {
            uint32_t group = group_of(j, side->half[t]);
            if (group == NONE) continue;
            add_facet(j, b, side->mesh.triangle[t], group, s ? -1 : j->patience);
            if (b->n == BATCH) status = score_batch(j, b);
        }
    }
    if (!status && b->n > 0) status = score_batch(j, b);
    free(b);
    return status;
}

/* ------------------------------------------------------------------------------------------------ */

static size_t take_better(const struct judge *j, uint8_t *inside) {
    size_t taken = 0;
    for (size_t c = 0; c < j->star->tets->finite_count; c++) {
        if (!is_judged(j, (uint32_t)c) || !(j->score[j->group[c]] > 0)) continue;
        inside[c] ^= 1;
        taken++;
    }
    return taken;
}

enum status cocone_judge(const struct cocone_star *star, const struct reconstruct_dense *dense, unsigned threads,
                         const struct cocone_proposal *proposal, uint8_t *inside, size_t *taken) {
    struct judge j = {.star = star,
                      .dense = dense,
                      .threads = threads,
                      .side = {{.inside = inside}, {.inside = proposal->inside}},
                      .patience = proposal->patience,
                      .matters = proposal->matters};
    enum status status = find_groups(&j, proposal);
    *taken = 0;
    if (!status && j.group_count > 0) {
        j.score = alloc_zeroed(j.group_count, sizeof *j.score);
        status = j.score ? STATUS_OK : STATUS_NO_MEMORY;
        for (int s = 0; s < 2 && !status; s++) status = build_side(&j, &j.side[s]);
        if (!status) status = score_points(&j);
        if (!status) status = score_facets(&j);
        if (!status) *taken = take_better(&j, inside);
    }
    side_done(&j.side[0]), side_done(&j.side[1]);
    free(j.group), free(j.near), free(j.score), free(j.point), free(j.hit);
    return status;
}
