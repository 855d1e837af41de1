/* Where points lie anywhere on the faces of a body and none on its edges, a surface through them cuts the edges off, by
 * strips of triangles from the points of one face to those of the other.  The points tell where the edge is all the
 * same: where the planes of both faces meet.
 *
 *         x           p is on one face, q on the other.  A face's plane at p is the one through p that most of the
 *        / \          vertices around lie on, which those beyond the edge don't.  p q is split at the place x of both
 *       /   \         planes that is nearest to its middle.
 *      p --- q
 *     /       \
 *
 * A surface that is round turns from vertex to vertex as well, but it does so everywhere: on a crease it turns far more
 * than beside it.  So does one whose edge is round, but no rounder than points are apart.  Planes beside such an edge
 * meet here and there in front of it, those beside a sharp one all along a line, but for what noise does to them.
 *
 * Attene, Falcidieno, Rossignac, Spagnuolo: Sharpen & Bend (2005), which tells faces by the angles across edges.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/sharpen.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/mesh/halfedge.h"

enum { RING = 32, AROUND = 96, LEAST_ON = 3, ROUNDS = 4 };
static const double FLAT = 0.97;      /* cosine between the triangles around a vertex that has one plane */
static const double ON = 0.15;        /* sine between a plane and the direction to what is on it */
static const double CREASE = 0.87;    /* cosine between the planes at both ends of an edge that is split, at most */
static const double MORE = 4;         /* times as much it turns there as beside it */
static const double LEAST_OFF = 0.05; /* of an edge's length: how far its ends are from each other's plane */
static const double REACH = 1;        /* of the edge, or of those around it: how far what it is split at may be */
static const double LEAST_DET = 0.01; /* square of the sine between planes that meet */
static const double STRAIGHT = 0.05;  /* of an edge's length: how far beside a crease the places next to it are */
static const double LIES = 0.5;       /* cosine between a new triangle and the planes at its corners, at least */
static const double LONG = 1;         /* edges split, for the root of the number of vertices, at least */
static const double MOST = 0.25;      /* the same, for each vertex: where there are more the surface is no body's */
static const double SHORT = 0.35;     /* of the mean around a vertex: shorter edges than that it has none of, */
static const double UNEVEN = 0.01;    /* but for this share of the vertices, where points were put evenly */
static const double TIGHT = 0.7;      /* shortest edge by mean one, from which on nothing is left between points */
static const double FAR = 0.7;     /* of the mean around a vertex: how far it is from the crease beside it, at least, */
static const double WIDELY = 0.17; /* for this share of those beside one, where points were put without regard to it */

struct sharpening {
    const struct mesh *mesh;
    struct halfedge he;
    vec3 *normal;    /* of each vertex: its face's plane; zero: there is none */
    float *bend;     /* of each vertex: by how much its face turns from there to the next ones, as an angle */
    float *length;   /* of each vertex: of its edges, in the mean */
    uint32_t *split; /* of each half-edge: the new vertex, or NONE */
};

/* ------------------------------------------------------------------------------------------------ planes */

static vec3 unit_normal_of(const struct sharpening *s, uint32_t triangle) {
    return vec3_unit(mesh_triangle_normal(s->mesh, triangle));
}

/* The half-edges out of a vertex; none where the surface isn't one, or ends. */
static size_t ring_of(const struct sharpening *s, uint32_t v, uint32_t ring[RING]) {
    return s->he.locked[v] || s->he.out[v] == NONE ? 0 : halfedge_ring(&s->he, v, ring, RING);
}

/* Vertices around one, each once, and triangles around these. */
struct around {
    unsigned n, triangles;
    vec3 to[AROUND]; /* directions */
    uint32_t id[AROUND], triangle[AROUND];
};

static void add_id(uint32_t *list, unsigned *n, uint32_t id) {
    for (unsigned i = 0; i < *n; i++)
        if (list[i] == id) return;
    if (*n < AROUND) list[(*n)++] = id;
}

static void look_around(const struct sharpening *s, uint32_t v, struct around *around) {
    uint32_t ring[RING], next[RING];
    size_t n = ring_of(s, v, ring);
    around->n = around->triangles = 0;
    for (size_t i = 0; i < n; i++) add_id(around->id, &around->n, halfedge_to(&s->he, ring[i]));
    for (size_t i = 0; i < n; i++) {
        size_t m = ring_of(s, halfedge_to(&s->he, ring[i]), next);
        for (size_t k = 0; k < m; k++) {
            uint32_t w = halfedge_to(&s->he, next[k]);
            if (w != v) add_id(around->id, &around->n, w);
            add_id(around->triangle, &around->triangles, next[k] / 3);
        }
    }
    for (unsigned i = 0; i < around->n; i++)
        around->to[i] = vec3_unit(vec3_sub(s->mesh->vertex[around->id[i]], s->mesh->vertex[v]));
}

static double support_of(const struct around *around, vec3 normal) {
    double sum = 0;
    for (unsigned i = 0; i < around->n; i++) {
        double off = vec3_dot(around->to[i], normal) / ON;
        if (fabs(off) < 1) sum += 1 - off * off;
    }
    return sum;
}

/* The plane through what is on a plane to a sine; how much that is: 0: too little. */
static unsigned fit_support(const struct around *around, double sine, vec3 *normal) {
    sym3 moment = {0};
    double value[3];
    vec3 axis[3];
    unsigned on = 0;
    for (unsigned i = 0; i < around->n; i++)
        if (fabs(vec3_dot(around->to[i], *normal)) < sine) moment = sym3_add(moment, sym3_outer(around->to[i])), on++;
    if (on < LEAST_ON) return 0;
    sym3_eigen(moment, value, axis);
    if (value[1] < ON * ON * on) return 0; /* along a line */
    *normal = axis[0];
    return on;
}

/* At last without what is beyond a crease but near the plane, as far as the face itself is no rougher. */
static bool fit_face(const struct around *around, vec3 *normal) {
    if (!fit_support(around, ON, normal)) return false;
    unsigned on = fit_support(around, ON, normal);
    for (double sine = ON / 2; on && sine > ON / 10; sine /= 2) {
        vec3 closer = *normal;
        unsigned left = fit_support(around, sine, &closer);
        if (left * 4 < on * 3) break;
        *normal = closer;
    }
    return on > 0;
}

static vec3 find_face(const struct sharpening *s, uint32_t v, vec3 side) {
    static const vec3 none = {0};
    struct around around;
    look_around(s, v, &around);
    vec3 best = none;
    double most = 0;
    for (unsigned i = 0; i < around.triangles; i++) {
        vec3 normal = unit_normal_of(s, around.triangle[i]);
        double support = support_of(&around, normal);
        if (support > most) most = support, best = normal;
    }
    if (!(most > 0) || !fit_face(&around, &best)) return none;
    return vec3_dot(best, side) < 0 ? vec3_scale(best, -1) : best;
}

static void find_plane(const struct sharpening *s, uint32_t v) {
    uint32_t ring[RING];
    size_t n = ring_of(s, v, ring);
    vec3 sum = {0}, unit[RING];
    double length = 0;
    for (size_t i = 0; i < n; i++) {
        vec3 normal = mesh_triangle_normal(s->mesh, ring[i] / 3);
        unit[i] = vec3_unit(normal);
        sum = vec3_add(sum, normal);
        length += vec3_distance(s->mesh->vertex[v], s->mesh->vertex[halfedge_to(&s->he, ring[i])]);
    }
    s->normal[v] = vec3_unit(sum);
    s->length[v] = n ? (float)(length / (double)n) : 0;
    for (size_t i = 0; i < n; i++)
        if (vec3_dot(unit[i], s->normal[v]) < FLAT) {
            s->normal[v] = find_face(s, v, s->normal[v]);
            break;
        }
}

static double turn_between(vec3 a, vec3 b) { return acos(fmax(-1, fmin(1, vec3_dot(a, b)))); }

static bool is_plane(vec3 normal) { return vec3_length_sq(normal) > 0; }

/* Of the vertices around that are on the same face, in the mean. */
static void find_bend(const struct sharpening *s, uint32_t v) {
    uint32_t ring[RING];
    size_t n = ring_of(s, v, ring), count = 0;
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
        vec3 other = s->normal[halfedge_to(&s->he, ring[i])];
        if (!is_plane(other) || vec3_dot(other, s->normal[v]) < CREASE) continue;
        sum += turn_between(other, s->normal[v]);
        count++;
    }
    s->bend[v] = count ? (float)(sum / (double)count) : INFINITY;
}

/* ------------------------------------------------------------------------------------------------ splits */

/* How far a place is in front of the plane at a vertex. */
static double in_front(const struct sharpening *s, uint32_t v, vec3 place) {
    return vec3_dot(s->normal[v], vec3_sub(place, s->mesh->vertex[v]));
}

/* The place on the planes at both ends of an edge that is nearest to its middle; false where it isn't across a crease.
 */
static bool find_place(const struct sharpening *s, uint32_t h, vec3 *place) {
    if (h > s->he.twin[h]) h = s->he.twin[h];
    uint32_t v = halfedge_from(&s->he, h), w = halfedge_to(&s->he, h);
    vec3 p = s->mesh->vertex[v], q = s->mesh->vertex[w], n = s->normal[v], m = s->normal[w];
    if (!is_plane(n) || !is_plane(m)) return false;
    double cosine = vec3_dot(n, m), turn = turn_between(n, m), length = vec3_distance(p, q);
    if (cosine > CREASE || turn < MORE * fmax((double)s->bend[v], (double)s->bend[w])) return false;
    double behind_v = -in_front(s, v, q), behind_w = -in_front(s, w, p), least = LEAST_OFF * length;
    bool convex = behind_v > least && behind_w > least, concave = behind_v < -least && behind_w < -least;
    if (!convex && !concave) return false;
    double det = 1 - cosine * cosine; /* the middle is half as far behind the planes */
    double along_n = (behind_v - cosine * behind_w) / (2 * det), along_m = (behind_w - cosine * behind_v) / (2 * det);
    vec3 middle = vec3_lerp(p, q, 0.5);
    *place = vec3_add(middle, vec3_add(vec3_scale(n, along_n), vec3_scale(m, along_m)));
    double reach = REACH * fmax(length, fmax((double)s->length[v], (double)s->length[w]));
    return det > LEAST_DET && vec3_distance(*place, middle) < reach;
}

static bool is_split(const struct sharpening *s, uint32_t h) { return s->split[h] != NONE; }

static void unsplit(struct sharpening *s, uint32_t h) { s->split[h] = s->split[s->he.twin[h]] = NONE; }

static unsigned splits_of(const struct sharpening *s, uint32_t t) {
    return (unsigned)is_split(s, 3 * t) + (unsigned)is_split(s, 3 * t + 1) + (unsigned)is_split(s, 3 * t + 2);
}

static void mark_splits(struct sharpening *s) {
    for (uint32_t h = 0; h < 3 * s->mesh->triangle_count; h++) s->split[h] = NONE;
    for (uint32_t h = 0; h < 3 * s->mesh->triangle_count; h++) {
        uint32_t g = s->he.twin[h];
        if (g == NONE || h > g) continue;
        vec3 place;
        if (find_place(s, h, &place)) s->split[h] = s->split[g] = 0;
    }
}

/* A crease goes on from triangle to triangle. */
static size_t drop_lonely(struct sharpening *s) {
    size_t dropped = 0;
    for (uint32_t h = 0; h < 3 * s->mesh->triangle_count; h++) {
        uint32_t g = s->he.twin[h];
        if (!is_split(s, h) || h > g || splits_of(s, h / 3) > 1 || splits_of(s, g / 3) > 1) continue;
        unsplit(s, h);
        dropped++;
    }
    return dropped;
}

/* A triangle's parts; corners 0 to 2 are its own, 3 to 5 what its edges are split at, 6 the corner of the body. */
struct parts {
    unsigned n;
    uint8_t corner[6][3];
    bool has_middle;
    vec3 place[7];
};

static void add_part(struct parts *parts, unsigned a, unsigned b, unsigned c) {
    uint8_t *corner = parts->corner[parts->n++];
    corner[0] = (uint8_t)a, corner[1] = (uint8_t)b, corner[2] = (uint8_t)c;
}

/* Where three planes meet. */
static bool find_corner(const struct sharpening *s, uint32_t t, vec3 *place) {
    const uint32_t *corner = s->mesh->triangle[t];
    vec3 n[3], across[3], middle = {0}, sum = {0};
    double reach = 0;
    for (int k = 0; k < 3; k++) {
        n[k] = s->normal[corner[k]], middle = vec3_add(middle, vec3_scale(s->mesh->vertex[corner[k]], 1.0 / 3));
        reach = fmax(reach, vec3_distance(s->mesh->vertex[corner[k]], s->mesh->vertex[corner[(k + 1) % 3]]));
    }
    for (int k = 0; k < 3; k++) across[k] = vec3_cross(n[(k + 1) % 3], n[(k + 2) % 3]);
    double det = vec3_dot(n[0], across[0]);
    if (fabs(det) < 0.1) return false;
    for (int k = 0; k < 3; k++) {
        double off = vec3_dot(n[k], vec3_sub(s->mesh->vertex[corner[k]], middle));
        sum = vec3_add(sum, vec3_scale(across[k], off / det));
    }
    *place = vec3_add(middle, sum);
    return vec3_length(sum) < REACH * reach;
}

static vec3 part_normal(const struct parts *parts, unsigned i) {
    const uint8_t *corner = parts->corner[i];
    return vec3_unit(vec3_triangle_normal(parts->place[corner[0]], parts->place[corner[1]], parts->place[corner[2]]));
}

/* The least cosine between a part and the plane of one of its own corners: others may be on the crease. */
static double least_agreement(const struct sharpening *s, uint32_t t, const struct parts *parts) {
    double least = 1;
    for (unsigned i = 0; i < parts->n; i++) {
        bool own = false;
        double most = -1;
        for (int k = 0; k < 3; k++) {
            if (parts->corner[i][k] > 2) continue;
            vec3 normal = s->normal[s->mesh->triangle[t][parts->corner[i][k]]];
            most = fmax(most, vec3_dot(normal, part_normal(parts, i))), own = true;
        }
        if (own) least = fmin(least, most);
    }
    return least;
}

/* With two split edges, which meet at corner b. */
static void part_in_three(const struct sharpening *s, uint32_t t, unsigned b, struct parts *parts) {
    unsigned c = (b + 1) % 3, d = (b + 2) % 3, x = 3 + b, y = 3 + d; /* x is on b c, y on d b */
    struct parts other = *parts;
    add_part(parts, b, x, y), add_part(parts, x, c, d), add_part(parts, x, d, y);
    add_part(&other, b, x, y), add_part(&other, x, c, y), add_part(&other, c, d, y);
    if (least_agreement(s, t, &other) > least_agreement(s, t, parts)) *parts = other;
}

static void find_parts(const struct sharpening *s, uint32_t t, struct parts *parts) {
    bool split[3];
    unsigned count = splits_of(s, t);
    parts->n = 0, parts->has_middle = false;
    for (unsigned k = 0; k < 3; k++) {
        split[k] = is_split(s, 3 * t + k);
        parts->place[k] = s->mesh->vertex[s->mesh->triangle[t][k]];
        if (split[k]) find_place(s, 3 * t + k, &parts->place[3 + k]);
    }
    if (count == 0) add_part(parts, 0, 1, 2);
    for (unsigned k = 0; k < 3; k++) {
        unsigned next = (k + 1) % 3, last = (k + 2) % 3;
        if (count == 1 && split[k]) add_part(parts, k, 3 + k, last), add_part(parts, 3 + k, next, last);
        if (count == 2 && !split[next]) part_in_three(s, t, k, parts);
    }
    if (count < 3) return;
    parts->has_middle = find_corner(s, t, &parts->place[6]);
    for (unsigned k = 0; k < 3; k++) {
        if (parts->has_middle)
            add_part(parts, k, 3 + k, 6), add_part(parts, 3 + k, (k + 1) % 3, 6);
        else
            add_part(parts, k, 3 + k, 3 + (k + 2) % 3);
    }
    if (!parts->has_middle) add_part(parts, 3, 4, 5);
}

/* Splits that would fold the surface aren't made. */
static size_t drop_folded(struct sharpening *s) {
    size_t dropped = 0;
    for (uint32_t t = 0; t < s->mesh->triangle_count; t++) {
        struct parts parts;
        if (!splits_of(s, t)) continue;
        find_parts(s, t, &parts);
        if (least_agreement(s, t, &parts) > LIES) continue;
        for (uint32_t h = 3 * t; h < 3 * t + 3; h++)
            if (is_split(s, h)) unsplit(s, h), dropped++;
    }
    return dropped;
}

/* How far beside the crease through a place, which runs along both planes, the places next to it are, in the mean;
 * negative: there are none. */
static double beside_crease(const struct sharpening *s, uint32_t h) {
    uint32_t g = s->he.twin[h];
    const uint32_t next[4] = {halfedge_next(h), halfedge_prev(h), halfedge_next(g), halfedge_prev(g)};
    vec3 along = vec3_unit(vec3_cross(s->normal[halfedge_from(&s->he, h)], s->normal[halfedge_to(&s->he, h)]));
    vec3 here, there;
    double sum = 0;
    unsigned count = 0;
    find_place(s, h, &here);
    for (int k = 0; k < 4; k++) {
        if (!is_split(s, next[k])) continue;
        find_place(s, next[k], &there);
        sum += vec3_length(vec3_cross(vec3_sub(there, here), along));
        count++;
    }
    return count ? sum / count : -1;
}

/* Whether most places lie beside the creases through the next ones, by more than noise, an estimate of its standard
 * deviation, has put them there: an angle between planes errs by about as much as noise is of an edge's length. */
static bool is_round(const struct sharpening *s, double noise) {
    size_t places = 0, beside = 0;
    for (uint32_t h = 0; h < 3 * s->mesh->triangle_count; h++) {
        if (!is_split(s, h) || h > s->he.twin[h]) continue;
        vec3 p = s->mesh->vertex[halfedge_from(&s->he, h)], q = s->mesh->vertex[halfedge_to(&s->he, h)];
        double off = beside_crease(s, h);
        places += off >= 0;
        beside += off > STRAIGHT * vec3_distance(p, q) + noise;
    }
    return 2 * beside > places;
}

/* ------------------------------------------------------------------------------------------------ the mesh */

/* Numbers what is new; how many vertices and triangles there will be. */
static void number_splits(struct sharpening *s, size_t *vertices, size_t *triangles) {
    *vertices = s->mesh->vertex_count, *triangles = 0;
    for (uint32_t h = 0; h < 3 * s->mesh->triangle_count; h++)
        if (is_split(s, h) && h < s->he.twin[h]) s->split[h] = s->split[s->he.twin[h]] = (uint32_t)(*vertices)++;
    for (uint32_t t = 0; t < s->mesh->triangle_count; t++) {
        struct parts parts;
        find_parts(s, t, &parts);
        *vertices += parts.has_middle, *triangles += parts.n;
    }
}

static enum status allocate_sharp(const struct mesh *mesh, size_t vertices, size_t triangles, struct mesh *sharp) {
    *sharp = (struct mesh){.vertex_count = vertices, .triangle_count = triangles};
    sharp->vertex = alloc_array(vertices, sizeof *sharp->vertex);
    sharp->triangle = alloc_array(triangles, sizeof *sharp->triangle);
    sharp->source = mesh->source ? alloc_array(vertices, sizeof *sharp->source) : NULL;
    sharp->tag = mesh->tag ? alloc_array(triangles, 1) : NULL;
    bool room = sharp->vertex && sharp->triangle && (sharp->source || !mesh->source) && (sharp->tag || !mesh->tag);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

static enum status make_sharp(struct sharpening *s, struct mesh *sharp) {
    const struct mesh *mesh = s->mesh;
    size_t vertices, triangles;
    number_splits(s, &vertices, &triangles);
    if (allocate_sharp(mesh, vertices, triangles, sharp)) return STATUS_NO_MEMORY;
    memcpy(sharp->vertex, mesh->vertex, mesh->vertex_count * sizeof *mesh->vertex);
    if (mesh->source) memcpy(sharp->source, mesh->source, mesh->vertex_count * sizeof *mesh->source);
    for (size_t v = mesh->vertex_count; mesh->source && v < vertices; v++) sharp->source[v] = NONE;
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++)
        if (is_split(s, h)) find_place(s, h, &sharp->vertex[s->split[h]]);
    size_t made = 0, last = vertices;
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        struct parts parts;
        find_parts(s, t, &parts);
        if (parts.has_middle) sharp->vertex[--last] = parts.place[6];
        for (unsigned i = 0; i < parts.n; i++, made++) {
            for (int k = 0; k < 3; k++) {
                unsigned corner = parts.corner[i][k];
                sharp->triangle[made][k] = corner < 3   ? mesh->triangle[t][corner]
                                           : corner < 6 ? s->split[3 * t + corner - 3]
                                                        : (uint32_t)last;
            }
            if (mesh->tag) sharp->tag[made] = mesh->tag[t];
        }
    }
    return STATUS_OK;
}

static size_t mark_all_splits(struct sharpening *s) {
    size_t n = s->mesh->vertex_count, count = 0;
    for (uint32_t v = 0; v < n; v++) find_plane(s, v);
    for (uint32_t v = 0; v < n; v++) find_bend(s, v);
    mark_splits(s);
    for (int i = 0; i < ROUNDS; i++)
        if (drop_lonely(s) + drop_folded(s) == 0) break;
    for (uint32_t h = 0; h < 3 * s->mesh->triangle_count; h++) count += is_split(s, h) && h < s->he.twin[h];
    return count;
}

static bool are_enough(const struct sharpening *s, size_t splits) {
    double n = (double)s->mesh->vertex_count;
    return (double)splits > LONG * sqrt(n) && (double)splits < MOST * n;
}

static enum status begin_sharpening(const struct mesh *mesh, struct sharpening *s) {
    size_t n = mesh->vertex_count;
    *s = (struct sharpening){.mesh = mesh,
                             .normal = alloc_array(n, sizeof *s->normal),
                             .bend = alloc_array(n, sizeof *s->bend),
                             .length = alloc_array(n, sizeof *s->length),
                             .split = alloc_array(3 * mesh->triangle_count, sizeof *s->split)};
    bool room = s->normal && s->bend && s->length && s->split;
    return room ? halfedge_init(&s->he, mesh, 1) : STATUS_NO_MEMORY;
}

static void end_sharpening(struct sharpening *s) {
    halfedge_done(&s->he);
    free(s->normal), free(s->bend), free(s->length), free(s->split);
}

enum status sharpen_creases(struct mesh *mesh, double noise, size_t *added) {
    struct sharpening s;
    struct mesh sharp = {0};
    enum status status = begin_sharpening(mesh, &s);
    bool enough = !status && are_enough(&s, mark_all_splits(&s)) && !is_round(&s, noise);
    if (enough) status = make_sharp(&s, &sharp);
    if (added) *added = !status && enough ? sharp.vertex_count - mesh->vertex_count : 0;
    if (!status && enough) {
        struct mesh before = *mesh;
        *mesh = sharp, sharp = before;
    }
    mesh_done(&sharp);
    end_sharpening(&s);
    return status;
}

/* ------------------------------------------------------------------------------------------------ even points */

/* Whether hardly any vertex has an edge that is far shorter than its others, and yet there is room for more: who leaves
 * none makes a mesh, whose strips along creases are the surface that is meant. */
static enum status are_even(const struct mesh *mesh, bool *even) {
    enum { SHORTER = 500 /* one edge in so many is shorter than what counts as the shortest */ };
    size_t n = mesh->vertex_count, halves = 3 * mesh->triangle_count, uneven = 0;
    float *length = alloc_array(halves, sizeof *length), *shortest = alloc_array(n, sizeof *shortest);
    float *sum = alloc_zeroed(n, sizeof *sum);
    uint32_t *count = alloc_zeroed(n, sizeof *count);
    bool room = length && shortest && sum && count;
    double all = 0;
    for (size_t v = 0; room && v < n; v++) shortest[v] = INFINITY;
    for (size_t h = 0; room && h < halves; h++) {
        uint32_t v = mesh->triangle[h / 3][h % 3], w = mesh->triangle[h / 3][(h + 1) % 3];
        length[h] = (float)vec3_distance(mesh->vertex[v], mesh->vertex[w]);
        shortest[v] = fminf(shortest[v], length[h]), shortest[w] = fminf(shortest[w], length[h]);
        sum[v] += length[h], count[v]++;
        all += (double)length[h];
    }
    for (size_t v = 0; room && v < n; v++) uneven += shortest[v] * (float)count[v] < (float)SHORT * sum[v];
    *even = room && halves && (double)uneven < UNEVEN * (double)n;
    if (*even) *even = (double)quantile_of(length, halves, 1.0 / SHORTER) < TIGHT * all / (double)halves;
    free(length), free(shortest), free(sum), free(count);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

/* From the crease that an edge is to be split at, which runs along both planes. */
static double distance_to_crease(const struct sharpening *s, uint32_t h) {
    uint32_t v = halfedge_from(&s->he, h);
    vec3 place, along = vec3_unit(vec3_cross(s->normal[v], s->normal[halfedge_to(&s->he, h)]));
    find_place(s, h, &place);
    return vec3_length(vec3_cross(vec3_sub(place, s->mesh->vertex[v]), along));
}

/* Whether vertices beside creases are as often far from them as near.  Those of a mesh that was made by the shape keep
 * close to them. */
static bool are_anywhere(const struct sharpening *s) {
    size_t beside = 0, far = 0;
    for (uint32_t v = 0; v < s->mesh->vertex_count; v++) {
        uint32_t ring[RING];
        double nearest = INFINITY;
        size_t n = ring_of(s, v, ring);
        for (size_t i = 0; i < n; i++)
            if (is_split(s, ring[i])) nearest = fmin(nearest, distance_to_crease(s, ring[i]));
        beside += nearest < INFINITY;
        far += nearest < INFINITY && nearest > FAR * (double)s->length[v];
    }
    return (double)far > WIDELY * (double)beside;
}

enum status sharpen_is_due(const struct mesh *mesh, bool *due) {
    struct sharpening s;
    enum status status = are_even(mesh, due);
    if (status || !*due) return status;
    status = begin_sharpening(mesh, &s);
    *due = !status && are_enough(&s, mark_all_splits(&s)) && are_anywhere(&s);
    end_sharpening(&s);
    return status;
}
