/* Each triangle votes with its area, for its own side or against it, by each of the things that may tell.  A component
 * follows the first one on which its votes agree.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/orient.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"
#include "core/mesh/submesh.h"
#include "core/surface/sheet/gallery.h"
#include "core/surface/sheet/sight.h"

enum { SIDES = SIDE_OUT + 1 };
enum { TURNED_LEAST = 50 /* triangles of a part that is cut off */, SMOOTHED = 12 /* rounds, of guessed views */ };
enum { FACES_DOWN_LEAST = 16, SMOOTHED_UP = 5 }; /* the same where a landscape is seen from above: half of a crown */
static const double AGREE[SIDES] = {0.5, 0.2, 0.3, 0.5, 0}; /* sum of the votes by the sum of their sizes */
static const double SEES = 0.02, AMID = 0.2; /* of what is seen from a side: others; where it stands amid them */
static const double CLEARLY = 0.85; /* likewise: a table sees the floor, but walls too, a ceiling nothing above it */
static const double GROUND = 0.5;   /* area of terrain that faces up, less what faces down: rooms have less */
static const double LOW = 0.5;      /* height of what may be a city, by its lesser width */
static const double LYING = 0.1;    /* part of the area, seen from above */
static const double MOSTLY = 0.5;   /* of that: what faces up, less what faces down */
static const double TURNED_WITHIN = 0.1; /* of a room's largest component: below, it faces one way */
static const double FLAT = 0.25;         /* height of what lies, by its lesser width, less than this */

struct votes {
    double sum[SIDES], size[SIDES];
    double area;
    vec3 middle;
    vec3 low, high; /* of its corners; upwards is z */
};

/* What is as z in the votes. */
struct upright {
    vec3 x, y, z;
};

static void vote(struct votes *votes, enum sheet_side side, double value) {
    votes->sum[side] += value;
    votes->size[side] += fabs(value);
}

static vec3 middle_of(const struct mesh *mesh, size_t t) {
    const uint32_t *v = mesh->triangle[t];
    return vec3_scale(vec3_add(vec3_add(mesh->vertex[v[0]], mesh->vertex[v[1]]), mesh->vertex[v[2]]), 1.0 / 3);
}

/* To be called before the triangle's votes are counted. */
static void stretch_box(const struct mesh *mesh, const struct upright *frame, size_t t, struct votes *votes) {
    for (int k = 0; k < 3; k++) {
        vec3 p = mesh->vertex[mesh->triangle[t][k]];
        vec3 at = {vec3_dot(p, frame->x), vec3_dot(p, frame->y), vec3_dot(p, frame->z)};
        bool first = votes->area == 0 && k == 0;
        vec3 low = first ? at : votes->low, high = first ? at : votes->high;
        votes->low = (vec3){fmin(low.x, at.x), fmin(low.y, at.y), fmin(low.z, at.z)};
        votes->high = (vec3){fmax(high.x, at.x), fmax(high.y, at.y), fmax(high.z, at.z)};
    }
}

static void vote_all(const struct mesh *mesh, const struct sheet_sides *sides, size_t t, struct votes *votes) {
    vec3 area = mesh_triangle_normal(mesh, t), middle = middle_of(mesh, t);
    for (int k = 0; k < 3 && sides->normal; k++) {
        uint32_t source = mesh->source[mesh->triangle[t][k]];
        if (source != NONE) vote(votes, SIDE_NORMALS, vec3_dot(area, vec3_unit(sides->normal[source])));
    }
    vec3 forward = sides->away ? vec3_sub(middle, sides->view) : vec3_sub(sides->view, middle);
    if (sides->viewed) vote(votes, SIDE_VIEW, vec3_dot(area, vec3_unit(forward)));
    for (int k = 0; k < 3 && sides->views; k++) {
        uint32_t vertex = mesh->triangle[t][k], source = mesh->source[vertex];
        if (source == NONE) continue;
        vec3 towards = vec3_sub(sides->views[source], mesh->vertex[vertex]);
        vote(votes, SIDE_VIEW, vec3_dot(area, vec3_unit(towards)));
    }
    vote(votes, SIDE_UP, vec3_dot(area, sides->up));
    double size = vec3_length(area);
    votes->area += size;
    votes->middle = vec3_add(votes->middle, vec3_scale(middle, size));
}

static bool lies_flat(const struct votes *votes) {
    vec3 box = vec3_sub(votes->high, votes->low);
    return box.z < FLAT * fmin(box.x, box.y);
}

/* What upwards counts by.  Of the others' sizes a wall's is nothing, so it is the area; of what lies, the ground's
 * below it, which the crowns of a forest have many times (areas are doubled here). */
static double size_upwards(const struct votes *votes) {
    vec3 box = vec3_sub(votes->high, votes->low);
    return lies_flat(votes) ? fmin(votes->area, 2 * box.x * box.y) : votes->area;
}

static bool agrees(const struct votes *votes, enum sheet_side side, double least) {
    double size = side == SIDE_UP ? size_upwards(votes) : votes->size[side];
    return size > 0 && fabs(votes->sum[side]) > least * size;
}

/* What the largest component tells of the whole. */
struct setting {
    bool within; /* a room, whose ceiling faces down */
    bool ground; /* terrain, of which guessed views tell nothing */
    bool field;  /* one sheet, however steep: upwards where neither normals nor the view tell */
};

static enum sheet_side choose(const struct votes *votes, const struct setting *setting) {
    if (setting->within && agrees(votes, SIDE_SIGHT, CLEARLY)) return SIDE_SIGHT;
    for (enum sheet_side side = SIDE_NORMALS; side < SIDE_OUT; side++)
        if (agrees(votes, side, setting->field && side == SIDE_UP ? 0 : AGREE[side]) &&
            !(setting->ground && side == SIDE_VIEW))
            return side;
    return SIDE_OUT;
}

/* Where nothing else tells: of what isn't upright most faces up or down, as roofs and streets between walls do. */
static bool lies_mostly(const struct votes *votes) {
    vec3 box = vec3_sub(votes->high, votes->low);
    double size = votes->size[SIDE_UP];
    bool low = box.z < LOW * fmin(box.x, box.y);
    return low && size > LYING * votes->area && fabs(votes->sum[SIDE_UP]) > MOSTLY * size;
}

/* Which component each triangle is of, by its first triangle. */
static enum status find_oriented_components(const struct mesh *mesh, bool as_one, unsigned threads,
                                            uint32_t *component) {
    struct halfedge he = {0};
    for (uint32_t t = 0; t < mesh->triangle_count; t++) component[t] = as_one ? 0 : t;
    if (as_one) return STATUS_OK;
    enum status status = halfedge_init(&he, mesh, threads);
    for (uint32_t h = 0; !status && h < 3 * mesh->triangle_count; h++)
        if (he.twin[h] != NONE) disjoint_set_unite(component, h / 3, he.twin[h] / 3);
    halfedge_done(&he);
    for (uint32_t t = 0; !status && t < mesh->triangle_count; t++) component[t] = disjoint_set_root(component, t);
    return status;
}

/* What a component sees of others is before it.  Where it sees them from both sides, it stands amid them, and that side
 * from which one sees farther is in front. */
static void vote_by_sight(const struct sight sight[2], struct votes *votes) {
    double front = sight[SIGHT_FRONT].others, back = sight[SIGHT_BACK].others;
    bool amid = fmin(front, back) > AMID;
    double more = amid ? sight[SIGHT_FRONT].depth - sight[SIGHT_BACK].depth : front - back;
    double all = amid ? sight[SIGHT_FRONT].depth + sight[SIGHT_BACK].depth : front + back;
    if (!amid && fmax(front, back) < SEES) return;
    votes->sum[SIDE_SIGHT] = more / all;
    votes->size[SIDE_SIGHT] = amid ? fabs(more / all) : 1;
}

/* The votes of each component, but for sight; returns the largest one. */
static size_t count_votes(const struct mesh *mesh, const struct sheet_sides *sides, const uint32_t *component,
                          struct votes *votes) {
    size_t largest = 0;
    struct upright frame = {.z = sides->up};
    vec3_basis(sides->up, &frame.x, &frame.y);
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        stretch_box(mesh, &frame, t, &votes[component[t]]);
        vote_all(mesh, sides, t, &votes[component[t]]);
    }
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        struct votes *own = &votes[component[t]];
        vec3 away = vec3_sub(middle_of(mesh, t), vec3_scale(own->middle, 1 / own->area));
        vote(own, SIDE_OUT, vec3_dot(mesh_triangle_normal(mesh, t), away));
        if (own->area > votes[largest].area) largest = component[t];
    }
    return largest;
}

static bool is_ground(const struct votes *votes) { return lies_flat(votes) && agrees(votes, SIDE_UP, GROUND); }

static void face(struct votes *votes, double side) {
    votes->sum[SIDE_SIGHT] = side, votes->size[SIDE_SIGHT] = fabs(side);
}

/* Turns components by their votes. */
static enum sheet_side turn(struct mesh *mesh, const uint32_t *component, const struct setting *setting,
                            const struct votes *votes) {
    double by[SIDES] = {0};
    enum sheet_side most = SIDE_NORMALS;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const struct votes *own = &votes[component[t]];
        uint32_t *v = mesh->triangle[t], second = v[1];
        enum sheet_side side = choose(own, setting);
        if (side == SIDE_OUT && lies_mostly(own)) side = SIDE_UP;
        by[side] += vec3_length(mesh_triangle_normal(mesh, t));
        if (own->sum[side] < 0) v[1] = v[2], v[2] = second;
    }
    for (enum sheet_side side = SIDE_NORMALS; side <= SIDE_OUT; side++)
        if (by[side] > by[most]) most = side;
    return most;
}

/* Lets components vote for what they see of others. */
static enum status look_at_others(const struct mesh *mesh, const uint32_t *component, unsigned threads,
                                  struct votes *votes) {
    struct sight(*sight)[2] = alloc_array(mesh->triangle_count, sizeof *sight);
    enum status status = sight ? sight_find(mesh, component, threads, sight) : STATUS_NO_MEMORY;
    for (size_t c = 0; c < mesh->triangle_count && !status; c++) vote_by_sight(sight[c], &votes[c]);
    free(sight);
    return status;
}

/* Lets components of a room vote for those who see it from within. */
static enum status look_from_within(const struct mesh *mesh, const struct sheet_sides *sides, const uint32_t *component,
                                    unsigned threads, struct setting *setting, struct votes *votes) {
    struct gallery gallery;
    double *facing = alloc_zeroed(mesh->triangle_count, sizeof *facing);
    enum status status = facing ? gallery_find(mesh, component, threads, &gallery, facing) : STATUS_NO_MEMORY;
    setting->within = !status && (gallery.room || sides->room);
    if (!status && sides->gallery) *sides->gallery = gallery;
    for (size_t c = 0; setting->within && c < mesh->triangle_count; c++)
        if (fabs(facing[c]) > 0) face(&votes[c], facing[c]);
    free(facing);
    return status;
}

enum status sheet_orient(struct mesh *mesh, const struct sheet_sides *sides, unsigned threads, enum sheet_side *side) {
    bool told = sides->normal || sides->viewed || sides->views || sides->field;
    size_t n = mesh->triangle_count;
    *side = SIDE_OUT;
    if (n == 0) return STATUS_OK;
    uint32_t *component = alloc_array(n, sizeof *component);
    struct votes *votes = alloc_zeroed(n, sizeof *votes);
    enum status status = component && votes ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = find_oriented_components(mesh, sides->field, threads, component);
    struct votes *first = status ? NULL : &votes[count_votes(mesh, sides, component, votes)];
    if (!status && !told) status = look_at_others(mesh, component, threads, votes);
    struct setting setting = {.field = sides->field};
    if (!status) setting.within = !told && agrees(first, SIDE_SIGHT, CLEARLY) && !agrees(first, SIDE_UP, GROUND);
    if (!status) setting.ground = sides->guessed && is_ground(first);
    if (!status && !told && choose(first, &setting) == SIDE_OUT)
        status = look_from_within(mesh, sides, component, threads, &setting, votes);
    if (!status && !told && sides->inside && choose(first, &setting) == SIDE_OUT) {
        setting.within = true;
        face(first, -first->sum[SIDE_OUT]);
    }
    if (!status) *side = turn(mesh, component, &setting, votes);
    free(component), free(votes);
    return status;
}

enum status sheet_is_room(const struct mesh *mesh, unsigned threads, struct gallery *gallery) {
    uint32_t *component = alloc_array(mesh->triangle_count, sizeof *component);
    enum status status = component ? find_oriented_components(mesh, false, threads, component) : STATUS_NO_MEMORY;
    if (!status) status = gallery_find(mesh, component, threads, gallery, NULL);
    free(component);
    return status;
}

double sheet_facing(const struct mesh *mesh, const struct sheet_sides *sides) {
    struct votes votes = {0};
    for (size_t t = 0; t < mesh->triangle_count; t++) vote_all(mesh, sides, t, &votes);
    return votes.size[SIDE_VIEW] > 0 ? votes.sum[SIDE_VIEW] / votes.size[SIDE_VIEW] : 0;
}

/* ------------------------------------------------------------------------------------------------ turned parts */

/* Triangles by how they face: parts are components of those that face the same way. */
struct facing_parts {
    uint8_t *in_front;
    uint32_t *whole, *part; /* sets */
    double *front;          /* by a component's root: area in front, less that which isn't */
    uint32_t *count;        /* of triangles, by a part's root */
    uint32_t least;         /* triangles of a part that is cut off */
};

/* Replaces each vote by the mean of it and those across its edges, so many times. */
static enum status smooth_votes(const struct halfedge *he, size_t n, int rounds, double *vote) {
    double *mean = alloc_array(n, sizeof *mean);
    for (int round = 0; mean && round < rounds; round++) {
        for (size_t t = 0; t < n; t++) {
            double sum = vote[t], count = 1;
            for (int k = 0; k < 3; k++) {
                uint32_t across = he->twin[3 * t + (size_t)k];
                if (across != NONE) sum += vote[across / 3], count++;
            }
            mean[t] = sum / count;
        }
        memcpy(vote, mean, n * sizeof *vote);
    }
    free(mean);
    return mean ? STATUS_OK : STATUS_NO_MEMORY;
}

/* What those within see of each triangle, where the largest component is seen from both sides; else nothing. */
static enum status vote_from_within(const struct mesh *mesh, unsigned threads, double *vote) {
    uint32_t *component = alloc_array(mesh->triangle_count, sizeof *component);
    enum status status = component ? find_oriented_components(mesh, false, threads, component) : STATUS_NO_MEMORY;
    double turned = 0;
    if (!status) status = gallery_sides(mesh, component, threads, vote, &turned);
    for (size_t t = 0; t < mesh->triangle_count; t++)
        vote[t] = turned > TURNED_WITHIN ? vote[t] * vec3_length(mesh_triangle_normal(mesh, t)) : 0;
    free(component);
    return status;
}

/* Marks the triangles that are in front by what is told of them, or most around them. */
static enum status find_front(const struct mesh *mesh, const struct halfedge *he, const struct sheet_sides *sides,
                              enum sheet_side told, unsigned threads, uint8_t *in_front) {
    size_t n = mesh->triangle_count;
    double *vote = alloc_array(n, sizeof *vote);
    enum status status = vote ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t t = 0; t < n && !status && told != SIDE_SIGHT; t++) {
        struct votes votes = {0};
        vote_all(mesh, sides, t, &votes);
        vote[t] = votes.sum[told];
    }
    if (!status && told == SIDE_SIGHT) status = vote_from_within(mesh, threads, vote);
    if (!status && (told == SIDE_UP || told == SIDE_SIGHT || sides->guessed))
        status = smooth_votes(he, n, told == SIDE_UP ? SMOOTHED_UP : SMOOTHED, vote);
    for (size_t t = 0; t < n && !status; t++) in_front[t] = vote[t] >= 0;
    free(vote);
    return status;
}

static void find_parts(const struct mesh *mesh, const struct halfedge *he, struct facing_parts *parts) {
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++) {
        uint32_t t = h / 3, across = he->twin[h] / 3;
        if (he->twin[h] == NONE) continue;
        disjoint_set_unite(parts->whole, t, across);
        if (parts->in_front[t] == parts->in_front[across]) disjoint_set_unite(parts->part, t, across);
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        double area = vec3_length(mesh_triangle_normal(mesh, t));
        parts->front[disjoint_set_root(parts->whole, t)] += parts->in_front[t] ? area : -area;
        parts->count[disjoint_set_root(parts->part, t)]++;
    }
}

/* The triangles of large parts along their edges to what faces as most of the component does. */
static void mark_seams(const struct halfedge *he, struct facing_parts *parts, uint8_t *out) {
    for (uint32_t h = 0; h < 3 * he->triangle_count; h++) {
        uint32_t t = h / 3;
        bool mostly_front = parts->front[disjoint_set_root(parts->whole, t)] >= 0;
        bool turned = parts->in_front[t] != mostly_front, seam = he->twin[h] != NONE;
        seam = seam && parts->in_front[he->twin[h] / 3] != parts->in_front[t];
        if (turned && seam && parts->count[disjoint_set_root(parts->part, t)] >= parts->least) out[t] = 1;
    }
}

/* Whether the views are guesses that ground tells more than. */
static enum status tells_less_than_ground(const struct mesh *mesh, const struct sheet_sides *sides, unsigned threads,
                                          bool *less) {
    *less = false;
    if (!sides->guessed || mesh->triangle_count == 0) return STATUS_OK;
    uint32_t *component = alloc_array(mesh->triangle_count, sizeof *component);
    struct votes *votes = alloc_zeroed(mesh->triangle_count, sizeof *votes);
    enum status status = component && votes ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = find_oriented_components(mesh, false, threads, component);
    if (!status) *less = is_ground(&votes[count_votes(mesh, sides, component, votes)]);
    free(component), free(votes);
    return status;
}

enum status sheet_part_turned(struct mesh *mesh, const struct sheet_sides *sides, unsigned threads) {
    size_t n = mesh->triangle_count;
    bool nothing = !sides->normal && !sides->viewed && !sides->views;
    enum status status = nothing ? STATUS_OK : tells_less_than_ground(mesh, sides, threads, &nothing);
    if (status || n == 0 || (nothing && sides->guessed && !sides->landscape)) return status;
    enum sheet_side told = nothing ? sides->landscape ? SIDE_UP : SIDE_SIGHT : sides->normal ? SIDE_NORMALS : SIDE_VIEW;
    struct halfedge he = {0};
    uint8_t *out = alloc_zeroed(n, 1);
    struct facing_parts parts = {alloc_array(n, 1),
                                 disjoint_set_new(n),
                                 disjoint_set_new(n),
                                 alloc_zeroed(n, sizeof *parts.front),
                                 alloc_zeroed(n, sizeof *parts.count),
                                 told == SIDE_UP ? FACES_DOWN_LEAST : TURNED_LEAST};
    bool ok = out && parts.in_front && parts.whole && parts.part && parts.front && parts.count;
    status = ok ? halfedge_init(&he, mesh, threads) : STATUS_NO_MEMORY;
    if (!status) status = find_front(mesh, &he, sides, told, threads, parts.in_front);
    if (!status) {
        find_parts(mesh, &he, &parts);
        mark_seams(&he, &parts, out);
        status = submesh_without(mesh, &he, out);
    }
    halfedge_done(&he);
    free(out);
    free(parts.in_front), free(parts.whole), free(parts.part), free(parts.front), free(parts.count);
    return status;
}
