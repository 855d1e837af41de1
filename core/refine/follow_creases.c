/* Where a crease runs between two of its points, but the mesh has the other diagonal of the two triangles, that corner
 * of the body is cut off, or a step is filled:
 *
 *          c                  c
 *        / | \              /   \         a and b are on the crease, c and d on the faces beside it:
 *       a  |  b     =>     a ---- b       then each of the triangles lies in its face
 *        \ | /              \   /
 *          d                  d
 *
 * Triangles have to be along the sheets better by area, and by angle alone.  Where points are on the creases, few edges
 * are wrong.  Where they are beside them, strips of triangles cut the creases off along all their length, rightly as
 * far as anything is known; many edges could be flipped then, and each would put a notch into such a strip: nothing is.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/follow_creases.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"

enum { ROUNDS_MOST = 12 };
static const double FEW = 0.05;       /* flips at most, for each point on a crease */
static const double LEAST_AREA = 0.1; /* that comes to lie along sheets, of both triangles */
static const double LEAST_TURN = 0.1; /* likewise, of the cosines' distance to 1, each triangle's mean */
static const double FOLD = -0.75;     /* cosine between the normals of neighbours, at least */
static const double THIN = 0.02;      /* twice the area by the square of the longest edge, at least */

struct following {
    struct mesh *mesh;
    struct halfedge he;
    const struct creases *creases;
    const vec3 *normal;
    uint8_t *touched; /* of each triangle: it has changed in this round or the one before */
    size_t flips;
};

/* How far two triangles are from lying along the sheets at their corners. */
struct misfit {
    double area, turn;
};

static vec3 triangle_normal(const struct following *f, const uint32_t corner[3]) {
    const vec3 *vertex = f->mesh->vertex;
    return vec3_triangle_normal(vertex[corner[0]], vertex[corner[1]], vertex[corner[2]]);
}

/* How well a direction is normal to what is at a vertex, 0 to 1. */
static double agreement(const struct following *f, uint32_t vertex, vec3 direction) {
    uint32_t point = f->mesh->source[vertex];
    if (point == NONE) return 1;
    const struct sheets *sheets = creases_at(f->creases, point);
    if (sheets && sheets->count) return sheets_agreement(sheets, direction);
    return fabs(vec3_dot(direction, f->normal[point]));
}

static void add_misfit(const struct following *f, const uint32_t corner[3], struct misfit *misfit) {
    vec3 normal = triangle_normal(f, corner), direction = vec3_unit(normal);
    double sum = 0;
    for (int k = 0; k < 3; k++) sum += (1 - agreement(f, corner[k], direction)) / 3;
    misfit->area += 3 * vec3_length(normal) * sum;
    misfit->turn += sum;
}

static double shape(const struct following *f, const uint32_t corner[3]) {
    double longest_sq = 0;
    for (int k = 0; k < 3; k++)
        longest_sq =
            fmax(longest_sq, vec3_distance_sq(f->mesh->vertex[corner[k]], f->mesh->vertex[corner[(k + 1) % 3]]));
    return vec3_length(triangle_normal(f, corner)) / longest_sq;
}

static bool stands_on_crease(const struct following *f, uint32_t vertex) {
    uint32_t point = f->mesh->source[vertex];
    const struct sheets *sheets = point == NONE ? NULL : creases_at(f->creases, point);
    return sheets && sheets->count > 1;
}

/* Whether a new triangle is folded onto the neighbour across one of the old half-edges, which it takes over. */
static bool is_folded(const struct following *f, const uint32_t corner[3], uint32_t h) {
    uint32_t twin = f->he.twin[h];
    if (twin == NONE) return false;
    vec3 normal = vec3_unit(triangle_normal(f, corner));
    return vec3_dot(normal, vec3_unit(triangle_normal(f, f->mesh->triangle[twin / 3]))) < FOLD;
}

static bool is_fair(const struct following *f, uint32_t h, uint32_t (*then)[3]) {
    uint32_t g = f->he.twin[h], a = halfedge_from(&f->he, h), b = halfedge_to(&f->he, h);
    uint32_t c = halfedge_apex(&f->he, h), d = halfedge_apex(&f->he, g);
    if (c == d || f->he.locked[a] || f->he.locked[b] || f->he.locked[c] || f->he.locked[d]) return false;
    double thinnest = fmin(shape(f, f->mesh->triangle[h / 3]), shape(f, f->mesh->triangle[g / 3]));
    for (int i = 0; i < 2; i++)
        if (shape(f, then[i]) < fmin(THIN, thinnest)) return false;
    vec3 one = vec3_unit(triangle_normal(f, then[0])), other = vec3_unit(triangle_normal(f, then[1]));
    if (vec3_dot(one, other) < FOLD || halfedge_joined(&f->he, c, d)) return false;
    return !is_folded(f, then[0], halfedge_prev(h)) && !is_folded(f, then[0], halfedge_next(g)) &&
           !is_folded(f, then[1], halfedge_next(h)) && !is_folded(f, then[1], halfedge_prev(g));
}

/* Whether the edge of h is better as the other diagonal. */
static bool gains(const struct following *f, uint32_t h) {
    uint32_t g = f->he.twin[h], a = halfedge_from(&f->he, h), b = halfedge_to(&f->he, h);
    uint32_t c = halfedge_apex(&f->he, h), d = halfedge_apex(&f->he, g);
    if (!stands_on_crease(f, c) && !stands_on_crease(f, d) && !stands_on_crease(f, a) && !stands_on_crease(f, b))
        return false;
    uint32_t then[2][3] = {{a, d, c}, {d, b, c}};
    const uint32_t(*now)[3] = f->mesh->triangle;
    struct misfit before = {0}, after = {0};
    double area = vec3_length(triangle_normal(f, now[h / 3])) + vec3_length(triangle_normal(f, now[g / 3]));
    add_misfit(f, now[h / 3], &before), add_misfit(f, now[g / 3], &before);
    if (before.area < LEAST_AREA * area || before.turn < LEAST_TURN) return false;
    add_misfit(f, then[0], &after), add_misfit(f, then[1], &after);
    return after.area < before.area - LEAST_AREA * area && after.turn < before.turn - LEAST_TURN && is_fair(f, h, then);
}

static void flip_diagonal(struct following *f, uint32_t h) {
    uint32_t t = h / 3, s = f->he.twin[h] / 3;
    halfedge_flip(&f->he, h);
    f->touched[t] = f->touched[s] = 2;
    if (f->mesh->tag && (f->mesh->tag[t] == MESH_SUPPORTED || f->mesh->tag[s] == MESH_SUPPORTED))
        f->mesh->tag[t] = f->mesh->tag[s] = MESH_SUPPORTED;
}

/* Whether the triangle, or one beside it, has changed since its edges were looked at. */
static bool triangle_is_due(const struct following *f, uint32_t t) {
    if (f->touched[t]) return true;
    for (uint32_t h = 3 * t; h < 3 * t + 3; h++)
        if (f->he.twin[h] != NONE && f->touched[f->he.twin[h] / 3]) return true;
    return false;
}

/* Rounds of flips, until there are none left or too many. */
static void flip_all(struct following *f, size_t most) {
    size_t made = 1;
    for (int i = 0; i < ROUNDS_MOST && made && f->flips <= most; i++) {
        made = 0;
        for (uint32_t h = 0; h < 3 * f->mesh->triangle_count; h++) {
            if (f->he.twin[h] == NONE || h > f->he.twin[h] || !triangle_is_due(f, h / 3) || !gains(f, h)) continue;
            flip_diagonal(f, h);
            made++;
        }
        for (size_t t = 0; t < f->mesh->triangle_count; t++) f->touched[t] = f->touched[t] == 2;
        f->flips += made;
    }
}

enum status follow_creases(struct mesh *mesh, const struct creases *creases, const vec3 *normal, size_t *flips) {
    size_t most = (size_t)(FEW * (double)creases->several);
    struct mesh followed = {0};
    struct following f = {.mesh = &followed, .creases = creases, .normal = normal};
    f.touched = alloc_array(mesh->triangle_count, 1);
    enum status status = f.touched ? mesh_copy(&followed, mesh) : STATUS_NO_MEMORY;
    if (!status) status = halfedge_init(&f.he, &followed, 1);
    if (!status) {
        memset(f.touched, 1, mesh->triangle_count);
        flip_all(&f, most);
        if (f.flips <= most) {
            struct mesh before = *mesh;
            *mesh = followed, followed = before;
        }
        if (flips) *flips = f.flips <= most ? f.flips : 0;
    }
    halfedge_done(&f.he);
    mesh_done(&followed);
    free(f.touched);
    return status;
}
