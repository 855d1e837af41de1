/* Two ways to the triangles, and one on from there: those that no original point supports go, and where only corners
 * hold the rest together each part gets a vertex of its own.
 *
 * The plane's triangles are judged in the plane, where a wall or a tree is no gap.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/sheet.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/math/sym3.h"
#include "core/mesh/halfedge.h"
#include "core/mesh/submesh.h"
#include "core/spatial/knn.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/sheet/carve.h"
#include "core/surface/sheet/front.h"
#include "core/surface/sheet/orient.h"
#include "core/surface/sheet/rim.h"
#include "core/surface/sheet/support.h"

static const struct sheet_limit FAR = {3, 4.2, 2.5, 0, 0}, FAR_IN_PLANE = {4, 4.2, 0, 0, 0};
/* Of what one place has seen: gaps are gaps between rays, which grow with the distance, and on ground with its square.
 * A few rays that went far span a large part of the area, of which hardly anything is near a point.  Between rings of a
 * turning scanner it is as large, but seen. */
static const struct sheet_limit FAR_SEEN = {5, 5, 0, 0, 0.45}, FAR_IN_RINGS = {5, 5, 0, 0, 0};
/* Share of the points whose neighbours lie along a line, at least: of rings .11 to .19, of a random half of some .029,
 * of other scans at most .021. */
static const double IN_RINGS = 0.025;
/* Of landscapes: gaps beside crowns and roofs are their shadows, and are seen across; walls that nothing was seen of
 * are none. */
static const struct sheet_limit FAR_IN_LANDSCAPE = {9, 9, 0, 0, 0}, FAR_ON_WALLS = {5.5, 5.5, 0, 0, 0};
/* Of few triangles one may be a whole wall, so that a corner in a gap doesn't cost the rest of it. */
static const double SPARED = 0.15;
static const double WALL = 0.3; /* cosine to the vertical: below, a triangle covers hardly any ground */

/* A mesh of all points and no triangles so far. */
static enum status mesh_of(const struct reconstruct_input *input, struct mesh *mesh) {
    mesh->vertex = alloc_array(input->n, sizeof *mesh->vertex);
    mesh->source = alloc_array(input->n, sizeof *mesh->source);
    if (!mesh->vertex || !mesh->source) return STATUS_NO_MEMORY;
    mesh->vertex_count = input->n;
    memcpy(mesh->vertex, input->points, input->n * sizeof *mesh->vertex);
    for (uint32_t i = 0; i < input->n; i++) mesh->source[i] = i;
    return STATUS_OK;
}

/* The original points, in space or in the plane, as mesh->vertex is. */
struct originals {
    const vec3 *point;
    size_t n;
    const struct knn *knn;
    const struct neighbourhood *neighbours; /* NULL = not known */
    const vec3 *normal;                     /* likewise */
    const vec3 *place;                      /* of the mesh's vertices in space, where these are in the plane, or NULL */
    const struct knn *in_space;             /* the originals there, likewise */
    struct plane_reach *known;              /* of originals in the plane with this normal, or NULL */
    vec3 up;
};

/* How far apart the originals are, as it is known or looked for. */
static enum status find_reach(const struct originals *originals, unsigned threads, float *reach, float *median) {
    struct plane_reach *known = originals->known;
    if (originals->neighbours) return sheet_reach_in(originals->neighbours, originals->point, threads, reach, median);
    if (known && known->reach && vec3_equal(known->up, originals->up)) {
        memcpy(reach, known->reach, originals->n * sizeof *reach);
        *median = known->median;
        return STATUS_OK;
    }
    enum status status = sheet_reach(originals->knn, originals->point, originals->n, threads, reach, median);
    if (status || !known) return status;
    if (!known->reach) known->reach = alloc_array(originals->n, sizeof *reach);
    if (!known->reach) return STATUS_NO_MEMORY;
    memcpy(known->reach, reach, originals->n * sizeof *reach);
    known->up = originals->up, known->median = *median;
    return STATUS_OK;
}

/* Takes unsupported triangles out; where `up` isn't NULL, walls alone. */
static enum status cut(struct mesh *mesh, const struct originals *originals, struct sheet_limit limit, const vec3 *up,
                       unsigned threads, const struct progress *progress) {
    struct halfedge he = {0};
    bool has_planes = originals->neighbours && originals->normal;
    struct sheet_points points = {.knn = originals->knn, .point = originals->point};
    float *reach = alloc_array(originals->n, sizeof *reach);
    float *inner = has_planes ? alloc_array(originals->n, sizeof *inner) : NULL;
    uint8_t *out = alloc_array(mesh->triangle_count, 1);
    uint8_t *wall = up ? alloc_array(mesh->triangle_count, 1) : NULL;
    if (!mesh->tag) mesh->tag = alloc_zeroed(mesh->triangle_count, 1);
    bool ok = reach && out && mesh->tag && (inner || !has_planes) && (wall || !up);
    enum status status = ok ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = find_reach(originals, threads, reach, &points.median);
    points.reach = reach, points.inner = inner;
    if (has_planes) points.normal = originals->normal;
    if (!status && inner) sheet_inner_reach(originals->neighbours, reach, threads, inner);
    for (size_t t = 0; !status && up && t < mesh->triangle_count; t++)
        wall[t] = fabs(vec3_dot(vec3_unit(mesh_triangle_normal(mesh, t)), *up)) < WALL;
    if (!status) status = sheet_unsupported(mesh, &points, limit, wall, threads, progress, out);
    if (!status) status = halfedge_init(&he, mesh, threads);
    if (!status && originals->place)
        status = rim_mark_slivers(mesh, &he, &points, originals->place, originals->in_space, out);
    if (!status) status = submesh_without(mesh, &he, out);
    halfedge_done(&he);
    free(reach), free(inner), free(out), free(wall);
    return status;
}

static enum status cut_in_space(struct mesh *mesh, const struct reconstruct_dense *dense,
                                const struct sheet_limit *limit, const vec3 *up, unsigned threads,
                                const struct progress *progress) {
    const struct originals originals = {.point = dense->point,
                                        .n = dense->n,
                                        .knn = dense->knn,
                                        .neighbours = dense->neighbours,
                                        .normal = dense->normal};
    return cut(mesh, &originals, *limit, up, threads, progress);
}

/* Whether what is near a point lies along a line, more or less. */
static bool is_along_line(const struct neighbourhood *near, const vec3 *point, size_t p) {
    enum { ENOUGH = 8 };
    static const double THIN = 0.03; /* of the variance along it */
    size_t n = near->count[p] < ENOUGH ? near->count[p] : ENOUGH;
    const uint32_t *id = &near->id[p * near->stride];
    sym3 moment = {0};
    vec3 mean = point[p], axis[3];
    double value[3];
    for (size_t i = 0; i < n; i++) mean = vec3_add(mean, point[id[i]]);
    mean = vec3_scale(mean, 1 / (double)(n + 1));
    for (size_t i = 0; i <= n; i++) moment = sym3_add(moment, sym3_outer(vec3_sub(point[i < n ? id[i] : p], mean)));
    sym3_eigen(moment, value, axis);
    return value[1] < THIN * value[2];
}

bool sheet_is_in_rings(const struct neighbourhood *neighbours, const vec3 *point) {
    enum { STEP = 7 }; /* one of so many tells */
    size_t along = 0, all = 0;
    for (size_t p = 0; p < neighbours->n; p += STEP, all++) along += is_along_line(neighbours, point, p);
    return (double)along > IN_RINGS * (double)all;
}

/* What is far in a scan from one place. */
static struct sheet_limit far_seen(const struct reconstruct_dense *dense) {
    return dense->neighbours && sheet_is_in_rings(dense->neighbours, dense->point) ? FAR_IN_RINGS : FAR_SEEN;
}

static enum status open_within(const struct tets *tets, const struct reconstruct_input *input,
                               const struct sheet_limit *limit, unsigned threads, const struct progress *progress,
                               struct mesh *mesh) {
    struct mesh made = {0};
    enum status status = mesh_of(input, &made);
    if (!status)
        status = sheet_front(tets, input->points, input->n, threads, progress, &made.triangle, &made.triangle_count);
    if (!status) status = cut_in_space(&made, input->dense, limit, NULL, threads, progress);
    if (!status) {
        *mesh = made;
        made = (struct mesh){0};
    }
    mesh_done(&made);
    return status;
}

enum status sheet_open(const struct tets *tets, const struct reconstruct_input *input, unsigned threads,
                       const struct progress *progress, struct mesh *mesh) {
    return open_within(tets, input, &FAR, threads, progress, mesh);
}

enum status sheet_trim(struct mesh *mesh, const struct reconstruct_dense *dense, bool viewed, unsigned threads) {
    struct sheet_limit limit = viewed ? far_seen(dense) : FAR;
    limit.share = SPARED;
    return cut_in_space(mesh, dense, &limit, NULL, threads, NULL);
}

enum status sheet_trim_walls(struct mesh *mesh, const struct reconstruct_dense *dense, vec3 up, unsigned threads) {
    return cut_in_space(mesh, dense, &FAR_ON_WALLS, &up, threads, NULL);
}

/* ------------------------------------------------------------------------------------------------ height fields */

struct plane {
    vec3 up, u, v;
};

static vec3 foot(const struct plane *plane, vec3 p) { return (vec3){vec3_dot(p, plane->u), vec3_dot(p, plane->v), 0}; }

/* The triangles between the points' feet, counter-clockwise seen from above. */
static enum status triangulate(struct mesh *mesh, unsigned threads, const struct progress *progress,
                               struct error *error) {
    return delaunay_in_plane(mesh->vertex, mesh->vertex_count, threads, progress, &mesh->triangle,
                             &mesh->triangle_count, error);
}

static enum status cut_in_plane(struct mesh *mesh, const struct reconstruct_input *input, const struct plane *plane,
                                const struct sheet_limit *limit, unsigned threads, const struct progress *progress) {
    const struct reconstruct_dense *dense = input->dense;
    struct knn *knn = NULL;
    vec3 *feet = alloc_array(dense->n, sizeof *feet);
    enum status status = feet ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < dense->n; i++) feet[i] = foot(plane, dense->point[i]);
    if (!status) status = knn_new(feet, dense->n, threads, &knn, NULL);
    struct originals originals = {.point = feet,
                                  .n = dense->n,
                                  .knn = knn,
                                  .place = input->points,
                                  .in_space = dense->knn,
                                  .known = dense->plane,
                                  .up = plane->up};
    if (!status) status = cut(mesh, &originals, *limit, NULL, threads, progress);
    knn_free(knn);
    free(feet);
    return status;
}

enum status sheet_heightfield(const struct reconstruct_input *input, vec3 up, bool landscape, unsigned threads,
                              const struct progress *progress, struct mesh *mesh, struct error *error) {
    const struct sheet_limit *limit = landscape ? &FAR_IN_LANDSCAPE : &FAR_IN_PLANE;
    struct mesh made = {0};
    struct plane plane = {.up = up};
    vec3_basis(up, &plane.u, &plane.v);
    enum status status = mesh_of(input, &made);
    for (size_t i = 0; !status && i < input->n; i++) made.vertex[i] = foot(&plane, input->points[i]);
    if (!status) status = triangulate(&made, threads, progress, error);
    if (!status && made.triangle_count > 0) status = cut_in_plane(&made, input, &plane, limit, threads, progress);
    for (size_t v = 0; !status && v < made.vertex_count; v++) made.vertex[v] = input->points[made.source[v]];
    if (!status) {
        *mesh = made;
        made = (struct mesh){0};
    }
    mesh_done(&made);
    return status;
}

/* ------------------------------------------------------------------------------------------------ single views */

/* Circles on the sphere are circles in the plane of its stereographic projection, so that Delaunay triangles of one are
 * those of the other, but for circles around the point that is projected to infinity: that is behind, where fewest
 * points are. */
static void project(const vec3 *point, size_t n, vec3 view, vec3 *foot) {
    vec3 ahead = {0, 0, 0}, u, v;
    for (size_t i = 0; i < n; i++) ahead = vec3_add(ahead, vec3_unit(vec3_sub(point[i], view)));
    ahead = vec3_unit(ahead);
    if (vec3_length_sq(ahead) == 0) ahead = (vec3){0, 0, -1};
    vec3_basis(ahead, &u, &v);
    for (size_t i = 0; i < n; i++) {
        vec3 towards = vec3_unit(vec3_sub(point[i], view));
        double scale = 1 / fmax(1 + vec3_dot(towards, ahead), 1e-9);
        foot[i] = (vec3){vec3_dot(towards, u) * scale, vec3_dot(towards, v) * scale, 0};
    }
}

/* Takes out of a mesh the triangles that face away from a place, or have a point that is used. */
static enum status leave_facing(struct mesh *mesh, vec3 view, const uint8_t *used, unsigned threads) {
    struct halfedge he = {0};
    uint8_t *out = alloc_array(mesh->triangle_count, 1);
    enum status status = out ? halfedge_init(&he, mesh, threads) : STATUS_NO_MEMORY;
    for (size_t t = 0; !status && t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        bool away = !used && vec3_dot(mesh_triangle_normal(mesh, t), vec3_sub(view, mesh->vertex[v[0]])) < 0;
        out[t] = away || (used && (used[mesh->source[v[0]]] || used[mesh->source[v[1]]] || used[mesh->source[v[2]]]));
    }
    if (!status) status = submesh_without(mesh, &he, out);
    halfedge_done(&he);
    free(out);
    return status;
}

/* Adds the vertices and triangles of another mesh; both have sources and tags. */
static enum status append_mesh(struct mesh *mesh, const struct mesh *other) {
    size_t n = mesh->vertex_count + other->vertex_count, m = mesh->triangle_count + other->triangle_count;
    struct mesh both = {n, alloc_array(n, sizeof *both.vertex),   alloc_array(n, sizeof *both.source),
                        m, alloc_array(m, sizeof *both.triangle), alloc_array(m, 1)};
    if (!both.vertex || !both.source || !both.triangle || !both.tag) {
        mesh_done(&both);
        return STATUS_NO_MEMORY;
    }
    memcpy(both.vertex, mesh->vertex, mesh->vertex_count * sizeof *both.vertex);
    memcpy(both.source, mesh->source, mesh->vertex_count * sizeof *both.source);
    memcpy(both.triangle, mesh->triangle, mesh->triangle_count * sizeof *both.triangle);
    memcpy(both.tag, mesh->tag, mesh->triangle_count);
    memcpy(&both.vertex[mesh->vertex_count], other->vertex, other->vertex_count * sizeof *both.vertex);
    memcpy(&both.source[mesh->vertex_count], other->source, other->vertex_count * sizeof *both.source);
    memcpy(&both.tag[mesh->triangle_count], other->tag, other->triangle_count);
    for (size_t t = 0; t < other->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            both.triangle[mesh->triangle_count + t][k] = (uint32_t)mesh->vertex_count + other->triangle[t][k];
    mesh_done(mesh);
    *mesh = both;
    return STATUS_OK;
}

/* Points of a surface of which the mesh has no triangle, and beside them those that stop an advancing front. */
struct rest {
    struct reconstruct_input input;
    vec3 *point;
    uint32_t *id; /* of each in the whole */
    uint8_t *used;
};

static void rest_done(struct rest *rest) { free(rest->point), free(rest->id), free(rest->used); }

/* whole: the n triangles before any were taken out, by their vertices' sources; an empty rest where few are left. */
static enum status find_rest(const struct reconstruct_input *input, const struct mesh *mesh, uint32_t (*whole)[3],
                             size_t n, struct rest *rest) {
    enum { FEW = 1000 /* one of so many */, LEAST = 4, UNUSED = 0, USED, BESIDE };
    uint8_t *role = alloc_zeroed(input->n, 1);
    size_t unused = 0;
    *rest = (struct rest){.input = *input};
    for (size_t v = 0; role && v < mesh->vertex_count; v++) role[mesh->source[v]] = USED;
    for (size_t i = 0; role && i < input->n; i++) unused += role[i] == UNUSED;
    if (!role || unused * FEW < input->n || unused < LEAST) {
        free(role);
        return role ? STATUS_OK : STATUS_NO_MEMORY;
    }
    for (size_t t = 0; t < n; t++)
        for (int k = 0; k < 3; k++)
            if (role[whole[t][k]] == USED &&
                (role[whole[t][(k + 1) % 3]] == UNUSED || role[whole[t][(k + 2) % 3]] == UNUSED))
                role[whole[t][k]] = BESIDE;
    size_t count = 0;
    for (size_t i = 0; i < input->n; i++) count += role[i] != USED;
    rest->point = alloc_array(count, sizeof *rest->point);
    rest->id = alloc_array(count, sizeof *rest->id);
    rest->used = alloc_array(count, 1);
    bool ok = rest->point && rest->id && rest->used;
    count = 0;
    for (uint32_t i = 0; ok && i < input->n; i++)
        if (role[i] != USED)
            rest->point[count] = input->points[i], rest->used[count] = role[i] == BESIDE, rest->id[count++] = i;
    rest->input.points = rest->point, rest->input.n = count;
    free(role);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

/* Adds the sheets through points that the mesh has no triangle of, as far as they face the place: those of rings that
 * are far apart have nothing but their neighbours along the ring. */
static enum status add_rest(const struct rest *rest, vec3 view, unsigned threads, const struct progress *progress,
                            struct mesh *mesh, struct error *error) {
    enum { CROWDED = 48 }; /* tetrahedra for each: points along few lines have more, and stay out */
    const struct sheet_sides sides = {.viewed = true, .view = view};
    size_t n = rest->input.n;
    enum sheet_side side;
    struct tets tets = {0};
    struct mesh made = {0};
    enum status status = delaunay_build_within(rest->point, n, CROWDED * n, threads, progress, &tets, error);
    if (status == STATUS_LIMIT) return STATUS_OK;
    if (!status && tets.dimension == 3) {
        struct sheet_limit limit = FAR;
        limit.apart = far_seen(rest->input.dense).apart;
        status = open_within(&tets, &rest->input, &limit, threads, progress, &made);
        if (!status) status = leave_facing(&made, view, rest->used, threads);
        if (!status) status = sheet_orient(&made, &sides, threads, &side);
        if (!status) status = leave_facing(&made, view, NULL, threads);
        for (size_t v = 0; !status && v < made.vertex_count; v++) made.source[v] = rest->id[made.source[v]];
        if (!status && made.triangle_count > 0) status = append_mesh(mesh, &made);
    }
    tets_done(&tets);
    mesh_done(&made);
    return status;
}

/* All triangles of the points' directions, which face the place. */
static enum status triangulate_view(const struct reconstruct_input *input, vec3 view, unsigned threads,
                                    const struct progress *progress, struct mesh *mesh, struct error *error) {
    project(input->points, input->n, view, mesh->vertex);
    enum status status = triangulate(mesh, threads, progress, error);
    for (size_t v = 0; !status && v < mesh->vertex_count; v++) mesh->vertex[v] = input->points[mesh->source[v]];
    for (size_t t = 0; !status && t < mesh->triangle_count; t++) {
        uint32_t *v = mesh->triangle[t], second = v[1];
        vec3 towards = vec3_sub(view, mesh->vertex[v[0]]);
        if (vec3_dot(mesh_triangle_normal(mesh, t), towards) < 0) v[1] = v[2], v[2] = second;
    }
    return status;
}

/* Takes out what the place has seen through. */
static enum status leave_unpierced(struct mesh *mesh, const struct reconstruct_dense *dense, vec3 view,
                                   unsigned threads) {
    struct halfedge he = {0};
    uint8_t *out = alloc_array(mesh->triangle_count, 1);
    enum status status = out ? halfedge_init(&he, mesh, threads) : STATUS_NO_MEMORY;
    if (!status) status = carve_seen_through(mesh, dense->point, dense->n, view, threads, out);
    if (!status) status = submesh_without(mesh, &he, out);
    halfedge_done(&he);
    free(out);
    return status;
}

enum status sheet_viewed(const struct reconstruct_input *input, vec3 view, unsigned threads,
                         const struct progress *progress, struct mesh *mesh, struct error *error) {
    struct mesh made = {0};
    struct rest rest = {0};
    enum status status = mesh_of(input, &made);
    if (!status) status = triangulate_view(input, view, threads, progress, &made, error);
    size_t n = made.triangle_count;
    uint32_t(*whole)[3] = status ? NULL : alloc_array(n, sizeof *whole);
    if (!status && !whole) status = STATUS_NO_MEMORY;
    if (!status && n > 0) {
        memcpy(whole, made.triangle, n * sizeof *whole);
        const struct sheet_limit limit = far_seen(input->dense);
        status = cut_in_space(&made, input->dense, &limit, NULL, threads, progress);
    }
    if (!status) status = find_rest(input, &made, whole, n, &rest);
    free(whole);
    if (!status && rest.point) status = add_rest(&rest, view, threads, progress, &made, error);
    rest_done(&rest);
    if (!status && made.triangle_count > 0) status = leave_unpierced(&made, input->dense, view, threads);
    if (!status) {
        *mesh = made;
        made = (struct mesh){0};
    }
    mesh_done(&made);
    return status;
}
