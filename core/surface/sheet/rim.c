/* Delaunay triangles fill the hull of the points' feet, so along a border that is straight but for the points' chance
 * they are slivers.  On flat ground those do no harm; between two hills or trees, or a roof and the ground, they are
 * walls of air:
 *
 *        b--.___
 *         \     '--.__        a, b: points high up.  The points below the edge are near its foot in the plane, and far
 *          c . . . . .'a      from it in space.
 *
 * Slivers are searched from the border inwards; with each wall those go that lie before it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/rim.h"

#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

static const double LONG = 3;       /* reaches: points of a sheet have neighbours nearer than that */
static const double NARROW = 1;     /* reaches: its height over its longest side */
static const double FAR = 5;        /* reaches: of the middle of a side from all points */
static const double OFF = 1;        /* likewise where it is upright: amid points no place is farther */
static const double UPRIGHT = 0.04; /* area in the plane by that in space: below, a sliver covers hardly any ground */

struct rim {
    const struct mesh *mesh;
    const struct halfedge *he;
    const struct sheet_points *feet;
    const vec3 *place;
    const struct knn *knn;
    uint8_t *out;
    uint32_t *holds;  /* for each vertex its triangles that are left */
    uint32_t *queue;  /* slivers that are reached from a border through others, and what is beyond them */
    uint32_t *before; /* for each triangle the one it was reached through; itself on a border; NONE so far */
    uint32_t *path;   /* from a sliver to the border */
    size_t begin, end;
};

static bool is_border(const struct rim *rim, uint32_t h) {
    uint32_t twin = rim->he->twin[h];
    return twin == NONE || rim->out[twin / 3];
}

/* The half-edge of the longest side of a triangle, in the plane. */
static uint32_t longest_in_plane(const struct rim *rim, uint32_t t) {
    const vec3 *foot = rim->mesh->vertex;
    uint32_t longest = 3 * t;
    double most = 0;
    for (uint32_t h = 3 * t; h < 3 * t + 3; h++) {
        double length = vec3_distance_sq(foot[halfedge_from(rim->he, h)], foot[halfedge_to(rim->he, h)]);
        if (length > most) most = length, longest = h;
    }
    return longest;
}

static bool is_sliver(const struct rim *rim, uint32_t longest, double reach) {
    const vec3 *foot = rim->mesh->vertex;
    vec3 a = foot[halfedge_from(rim->he, longest)], along = vec3_sub(foot[halfedge_to(rim->he, longest)], a);
    vec3 apex = foot[halfedge_apex(rim->he, longest)];
    double length = vec3_length(along), area = vec3_length(vec3_cross(along, vec3_sub(apex, a)));
    return length > LONG * reach && area <= NARROW * reach * length;
}

static vec3 middle(const struct rim *rim, const vec3 *of, uint32_t h) {
    return vec3_scale(vec3_add(of[halfedge_from(rim->he, h)], of[halfedge_to(rim->he, h)]), 0.5);
}

/* Whether a triangle is nearly upright in space. */
static bool is_wall(const struct rim *rim, uint32_t t) {
    const uint32_t *v = rim->mesh->triangle[t];
    const vec3 *p = rim->place;
    double in_space = vec3_length(vec3_cross(vec3_sub(p[v[1]], p[v[0]]), vec3_sub(p[v[2]], p[v[0]])));
    return vec3_length(mesh_triangle_normal(rim->mesh, t)) < UPRIGHT * in_space;
}

/* Whether a triangle is a sliver, and then whether it is one far from the points. */
static enum status weigh_triangle(const struct rim *rim, uint32_t t, bool *sliver, bool *far) {
    uint32_t longest = longest_in_plane(rim, t), nearest[3];
    double distance_sq[3];
    *far = false;
    *sliver = is_sliver(rim, longest, (double)rim->feet->median); /* no reach is below the median */
    if (!*sliver) return STATUS_OK;
    vec3 foot = middle(rim, rim->mesh->vertex, longest), place[3];
    enum status status = knn_search(rim->feet->knn, &foot, 1, 1, 1, nearest, distance_sq);
    double reach = status ? 0 : (double)rim->feet->reach[nearest[0]];
    *sliver = !status && is_sliver(rim, longest, reach);
    if (!*sliver) return status;
    for (uint32_t k = 0; k < 3; k++) place[k] = middle(rim, rim->place, 3 * t + k);
    status = knn_search(rim->knn, place, 3, 1, 1, nearest, distance_sq);
    double most = (is_wall(rim, t) ? OFF : FAR) * reach;
    for (int k = 0; !status && k < 3; k++) *far = *far || distance_sq[k] > most * most;
    return status;
}

/* Takes out a triangle, unless it alone holds a corner. */
static bool take_out(struct rim *rim, uint32_t t) {
    const uint32_t *v = rim->mesh->triangle[t];
    if (rim->holds[v[0]] < 2 || rim->holds[v[1]] < 2 || rim->holds[v[2]] < 2) return false;
    for (int k = 0; k < 3; k++) rim->holds[v[k]]--;
    rim->out[t] = 1;
    return true;
}

/* Takes out what lies before a triangle, from the border on, and then it. */
static void take_from_border(struct rim *rim, uint32_t t) {
    size_t length = 0;
    for (uint32_t on = t; !rim->out[on]; on = rim->before[on]) {
        rim->path[length++] = on;
        if (rim->before[on] == on) break;
    }
    while (length > 0 && take_out(rim, rim->path[length - 1])) length--;
}

static enum status search(struct rim *rim) {
    while (rim->begin < rim->end) {
        uint32_t t = rim->queue[rim->begin++];
        bool sliver, far;
        enum status status = weigh_triangle(rim, t, &sliver, &far);
        if (status) return status;
        if (!sliver) continue;
        for (uint32_t h = 3 * t; h < 3 * t + 3; h++) {
            uint32_t twin = rim->he->twin[h];
            if (twin == NONE || rim->before[twin / 3] != NONE) continue;
            rim->before[twin / 3] = t, rim->queue[rim->end++] = twin / 3;
        }
        if (far) take_from_border(rim, t);
    }
    return STATUS_OK;
}

static void begin_at_borders(struct rim *rim) {
    for (uint32_t t = 0; t < rim->mesh->triangle_count; t++) {
        const uint32_t *v = rim->mesh->triangle[t];
        rim->before[t] = rim->out[t] ? t : NONE;
        if (rim->out[t]) continue;
        for (int k = 0; k < 3; k++) rim->holds[v[k]]++;
        if (!is_border(rim, 3 * t) && !is_border(rim, 3 * t + 1) && !is_border(rim, 3 * t + 2)) continue;
        rim->before[t] = t, rim->queue[rim->end++] = t;
    }
}

enum status rim_mark_slivers(const struct mesh *mesh, const struct halfedge *he, const struct sheet_points *feet,
                             const vec3 *place, const struct knn *knn, uint8_t *out) {
    size_t n = mesh->triangle_count;
    struct rim rim = {.mesh = mesh, .he = he, .feet = feet, .place = place, .knn = knn, .out = out};
    rim.holds = alloc_zeroed(mesh->vertex_count, sizeof *rim.holds);
    rim.queue = alloc_array(n, sizeof *rim.queue), rim.before = alloc_array(n, sizeof *rim.before);
    rim.path = alloc_array(n, sizeof *rim.path);
    enum status status = rim.holds && rim.queue && rim.path && rim.before ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) begin_at_borders(&rim);
    if (!status) status = search(&rim);
    free(rim.holds), free(rim.queue), free(rim.path), free(rim.before);
    return status;
}
