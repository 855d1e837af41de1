/* Planes first: three points near each other span one, which is kept while ever more of the points around are on it;
 * only what has many is looked at.  On a plane each point is joined to the nearest one and to the nearest on the other
 * side (Dey and Kumar's curves by nearest neighbours, 1999), and rings are where all of these agree.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/flat_faces.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/cloud/on_grid_lines.h"
#include "core/math/sym3.h"

enum {
    LEAST_ON_PLANE = 16,
    MOST_ON_PLANE = 2048,
    PLANES_MOST = 4096,       /* that all points are compared with, */
    COMPARED_MOST = 20000000, /* and together; */
    PAIRS_MOST = 100000000,   /* pairs of those on a plane */
    PLANES_OF_POINT = 8 /* that are remembered of each */,
    FIRST_NEIGHBOURS = 8,
    AROUND = KNN_MAX_K, /* points */
    LEAST_RING = 8,
    EACH = 3, /* of so many points one is looked around at */
    LEAST_PLACES = 8,
    PLACES_SHARE = 2 /* of the points: at most one place for so many */
};

static const double ON_PLANE = 3e-6 /* of the diagonal: coordinates are written with six digits */, TURNED = 0.25;

struct plane {
    vec3 at, normal;
};

/* A ring: points of `order` from `first` on, its nesting, and the ring around it. */
struct ring {
    size_t first, count, depth, outer;
    bool inner; /* a face goes around it */
};

struct search {
    const struct knn *knn;
    const struct neighbourhood *neighbours;
    const vec3 *point;
    size_t n;
    unsigned threads;
    uint32_t (*plane_of)[PLANES_OF_POINT]; /* of each point, from 1 on; 0: no more */
    size_t planes, pairs;                  /* so far */
    /* Of the plane that is looked at: */
    struct plane plane;
    size_t m;
    uint32_t *on;        /* the points on it */
    double (*place)[2];  /* where, in it */
    double *alone_sq;    /* squared distance of each to the nearest other */
    uint32_t (*next)[2]; /* whom each would be joined to, by rank; NONE */
    uint32_t *order;     /* ranks, ring by ring */
    uint8_t *in_ring;
    size_t rings;
    struct ring *ring;
    struct flat_faces found;
    uint8_t *walled; /* of each point: a wall has been found from its ring */
    size_t room;
};

/* ------------------------------------------------------------------------------------------------ planes */

static double height(const struct plane *plane, vec3 place) {
    return vec3_dot(vec3_sub(place, plane->at), plane->normal);
}

/* The plane that is nearest to those of some points that are on one. */
static size_t fit_to_those_on(const struct search *s, const uint32_t *id, size_t count, struct plane *plane) {
    vec3 mean = {0, 0, 0}, axis[3];
    sym3 moment = {0};
    double value[3];
    size_t on = 0;
    for (size_t i = 0; i < count; i++) {
        vec3 at = s->point[id ? id[i] : i];
        if (fabs(height(plane, at)) > ON_PLANE) continue;
        mean = vec3_add(mean, at);
        on++;
    }
    if (on < 4) return on;
    mean = vec3_scale(mean, 1 / (double)on);
    for (size_t i = 0; i < count; i++) {
        vec3 at = s->point[id ? id[i] : i];
        if (fabs(height(plane, at)) > ON_PLANE) continue;
        moment = sym3_add(moment, sym3_outer(vec3_sub(at, mean)));
    }
    sym3_eigen(moment, value, axis);
    *plane = (struct plane){mean, axis[0]};
    return on;
}

static bool share_plane(const struct search *s, uint32_t a, uint32_t b, uint32_t c) {
    for (int i = 0; i < PLANES_OF_POINT && s->plane_of[a][i]; i++)
        for (int j = 0; j < PLANES_OF_POINT && s->plane_of[b][j]; j++)
            for (int k = 0; k < PLANES_OF_POINT && s->plane_of[c][k]; k++)
                if (s->plane_of[a][i] == s->plane_of[b][j] && s->plane_of[b][j] == s->plane_of[c][k]) return true;
    return false;
}

/* Whether ever more of the points around p are on the plane through it and two neighbours, one to either side. */
static enum status grow_plane(struct search *s, uint32_t p, uint32_t a, uint32_t b, bool *grows) {
    uint32_t around[AROUND];
    double distance_sq[AROUND];
    const struct neighbourhood *all = s->neighbours;
    vec3 across = vec3_triangle_normal(s->point[p], s->point[a], s->point[b]);
    struct plane plane = {s->point[p], vec3_unit(across)};
    *grows = vec3_length_sq(plane.normal) > 0;
    size_t on = 0, before = 4;
    for (size_t i = 0; i < all->count[p]; i++)
        on += fabs(height(&plane, s->point[all->id[p * all->stride + i]])) < ON_PLANE;
    if (on < 3 || !*grows) { /* with the two */
        *grows = false;
        return STATUS_OK;
    }
    enum status status = knn_search(s->knn, &s->point[p], 1, AROUND, 1, around, distance_sq);
    for (size_t k = 2 * FIRST_NEIGHBOURS; !status && *grows && k <= AROUND && k < s->n; k *= 2) {
        on = fit_to_those_on(s, around, k, &plane);
        *grows = on >= before && fabs(height(&plane, s->point[p])) < ON_PLANE;
        before = on + 1;
    }
    if (!status && *grows) s->plane = plane;
    return status;
}

static void remember_plane(struct search *s, size_t p) {
    uint32_t *of = s->plane_of[p];
    for (int k = 0; k < PLANES_OF_POINT; k++)
        if (!of[k]) {
            of[k] = (uint32_t)s->planes;
            return;
        }
}

/* Lists the points on the plane, as many as may be on one, once it has been brought to all of them. */
static void list_on_plane(struct search *s) {
    for (int round = 0; round < 3; round++) fit_to_those_on(s, NULL, s->n, &s->plane);
    s->m = 0;
    s->planes++;
    for (size_t i = 0; i < s->n; i++) {
        if (fabs(height(&s->plane, s->point[i])) >= ON_PLANE) continue;
        if (s->m < MOST_ON_PLANE) s->on[s->m++] = (uint32_t)i;
        remember_plane(s, i);
    }
    vec3 u, v;
    vec3_basis(s->plane.normal, &u, &v);
    for (size_t i = 0; i < s->m; i++) {
        vec3 from = vec3_sub(s->point[s->on[i]], s->plane.at);
        s->place[i][0] = vec3_dot(from, u), s->place[i][1] = vec3_dot(from, v);
    }
}

/* ------------------------------------------------------------------------------------------------ rings */

static double apart_sq(const struct search *s, size_t i, size_t j) {
    double x = s->place[i][0] - s->place[j][0], y = s->place[i][1] - s->place[j][1];
    return x * x + y * y;
}

/* Of the points on the plane the one that is nearest to another for how far these two are from others at least, and
 * isn't on the side of a third (NONE: any). */
static uint32_t nearest_on_plane(const struct search *s, size_t i, uint32_t aside) {
    double least = INFINITY, x = 0, y = 0;
    uint32_t nearest = NONE;
    if (aside != NONE) {
        double length = sqrt(apart_sq(s, i, aside));
        x = (s->place[aside][0] - s->place[i][0]) / length, y = (s->place[aside][1] - s->place[i][1]) / length;
    }
    for (size_t j = 0; j < s->m; j++) {
        double distance_sq = apart_sq(s, i, j), share = distance_sq / fmin(s->alone_sq[i], s->alone_sq[j]);
        if (j == i || !(share < least)) continue;
        double along = x * (s->place[j][0] - s->place[i][0]) + y * (s->place[j][1] - s->place[i][1]);
        if (aside != NONE && along > 0 && along * along > TURNED * TURNED * distance_sq) continue;
        least = share, nearest = (uint32_t)j;
    }
    return nearest;
}

static bool joined(const struct search *s, uint32_t i, uint32_t j) {
    return j != NONE && (s->next[j][0] == i || s->next[j][1] == i);
}

static void find_rings(struct search *s) {
    size_t listed = 0;
    for (size_t i = 0; i < s->m; i++) {
        s->alone_sq[i] = INFINITY;
        for (size_t j = 0; j < s->m; j++)
            if (j != i) s->alone_sq[i] = fmin(s->alone_sq[i], apart_sq(s, i, j));
    }
    for (size_t i = 0; i < s->m; i++) {
        s->next[i][0] = nearest_on_plane(s, i, NONE);
        s->next[i][1] = s->next[i][0] == NONE ? NONE : nearest_on_plane(s, i, s->next[i][0]);
        s->in_ring[i] = 0;
    }
    s->rings = 0;
    for (uint32_t start = 0; start < s->m; start++) {
        size_t first = listed;
        uint32_t at = start, from = NONE;
        bool closed = false, goes_on = !s->in_ring[start];
        while (goes_on) {
            uint32_t to = s->next[at][0] == from ? s->next[at][1] : s->next[at][0];
            goes_on = joined(s, at, s->next[at][0]) && joined(s, at, s->next[at][1]) && !s->in_ring[at];
            if (!goes_on) break;
            s->in_ring[at] = 1, s->order[listed++] = at;
            from = at, at = to;
            closed = at == start;
            goes_on = !closed;
        }
        if (closed && listed - first >= LEAST_RING)
            s->ring[s->rings++] = (struct ring){.first = first, .count = listed - first};
        else {
            while (listed > first) s->in_ring[s->order[--listed]] = 2; /* not looked at again */
        }
    }
}

static const double *ring_place(const struct search *s, const struct ring *ring, size_t i) {
    return s->place[s->order[ring->first + i % ring->count]];
}

static bool is_in_ring(const struct search *s, const struct ring *ring, const double at[2]) {
    bool in = false;
    for (size_t i = 0; i < ring->count; i++) {
        const double *a = ring_place(s, ring, i), *b = ring_place(s, ring, i + 1);
        if ((a[1] > at[1]) != (b[1] > at[1]) && at[0] < a[0] + (b[0] - a[0]) * (at[1] - a[1]) / (b[1] - a[1])) in = !in;
    }
    return in;
}

/* How many rings are around each, and which is the one next to it. */
static void nest_rings(struct search *s) {
    for (size_t i = 0; i < s->rings; i++) {
        struct ring *ring = &s->ring[i];
        const double *at = ring_place(s, ring, 0);
        for (size_t j = 0; j < s->rings; j++) ring->depth += j != i && is_in_ring(s, &s->ring[j], at);
    }
    for (size_t i = 0; i < s->rings; i++) {
        struct ring *ring = &s->ring[i];
        ring->outer = s->rings;
        for (size_t j = 0; j < s->rings; j++)
            if (j != i && s->ring[j].depth + 1 == ring->depth && is_in_ring(s, &s->ring[j], ring_place(s, ring, 0)))
                ring->outer = j;
    }
}

/* ------------------------------------------------------------------------------------------------ faces */

static bool is_of_face(const struct search *s, size_t ring, size_t outer) {
    return ring == outer || s->ring[ring].outer == outer;
}

/* Whether a place of the plane is within the outer ring and none of those inside. */
static bool is_on_face(const struct search *s, size_t outer, const double at[2]) {
    if (!is_in_ring(s, &s->ring[outer], at)) return false;
    for (size_t i = 0; i < s->rings; i++)
        if (s->ring[i].outer == outer && is_in_ring(s, &s->ring[i], at)) return false;
    return true;
}

/* Whether the surface goes through the plane at a point of a ring: others are right above and below, or near by. */
static enum status goes_through(const struct search *s, uint32_t p, double edge, bool *through) {
    static const double UPRIGHT = 0.8, NEAR = 2.5 /* edges of the ring */, OFF = 4;
    uint32_t around[AROUND];
    double distance_sq[AROUND];
    bool side[2] = {false, false};
    enum status status = knn_search(s->knn, &s->point[p], 1, AROUND, 1, around, distance_sq);
    for (int i = 1; i < AROUND && !status && around[i] != NONE; i++) {
        double h = height(&s->plane, s->point[around[i]]), distance = sqrt(distance_sq[i]);
        if (fabs(h) > OFF * ON_PLANE && (fabs(h) > UPRIGHT * distance || distance < NEAR * edge)) side[h > 0] = true;
    }
    *through = side[0] && side[1];
    return status;
}

static double from_to(const double a[2], const double b[2]) {
    double x = a[0] - b[0], y = a[1] - b[1];
    return sqrt(x * x + y * y);
}

/* The part of the rings' length at which the surface doesn't go through, and how long their edges are, by length. */
static enum status survey_rings(const struct search *s, size_t outer, double *one_sided, double *edge) {
    double length = 0, squares = 0, part = 0;
    enum status status = STATUS_OK;
    for (size_t r = 0; r < s->rings; r++)
        for (size_t i = 0; is_of_face(s, r, outer) && i < s->ring[r].count; i++) {
            const double *a = ring_place(s, &s->ring[r], i), *b = ring_place(s, &s->ring[r], i + 1);
            double l = from_to(a, b);
            length += l, squares += l * l;
        }
    *edge = squares / length;
    for (size_t r = 0; r < s->rings; r++)
        for (size_t i = 0; is_of_face(s, r, outer) && i < s->ring[r].count && !status; i++) {
            const double *a = ring_place(s, &s->ring[r], i), *b = ring_place(s, &s->ring[r], i + 1);
            bool through = false;
            status = goes_through(s, s->on[s->order[s->ring[r].first + i]], *edge, &through);
            if (!through) part += from_to(a, b);
        }
    *one_sided = part / length;
    return status;
}

static bool is_near_ring(const struct search *s, size_t outer, const double at[2], double reach) {
    for (size_t r = 0; r < s->rings; r++)
        for (size_t i = 0; is_of_face(s, r, outer) && i < s->ring[r].count; i++) {
            const double *a = ring_place(s, &s->ring[r], i);
            double x = at[0] - a[0], y = at[1] - a[1];
            if (x * x + y * y < reach * reach) return true;
        }
    return false;
}

static enum status add_place(struct search *s, vec3 place, vec3 upright, double step) {
    struct flat_faces *found = &s->found;
    if (found->count == s->room) {
        size_t room = 2 * s->room + AROUND;
        vec3 *point = alloc_resize(found->point, room, sizeof *point);
        if (point) found->point = point;
        vec3 *normal = alloc_resize(found->normal, room, sizeof *normal);
        if (normal) found->normal = normal;
        float *spacing = alloc_resize(found->spacing, room, sizeof *spacing);
        if (spacing) found->spacing = spacing;
        if (!point || !normal || !spacing) return STATUS_NO_MEMORY;
        s->room = room;
    }
    found->point[found->count] = place;
    found->normal[found->count] = upright;
    found->spacing[found->count++] = (float)step;
    return STATUS_OK;
}

/* A grid of triangles over the face, not too near to its rings; none where it holds but a few. */
static enum status fill_face(struct search *s, size_t outer, double step) {
    enum { OF_FACE = 3 /* points, for each place of a face that is square, at least */ };
    static const double ASIDE = 0.5, ROW = 0.8660254037844386;
    const struct ring *ring = &s->ring[outer];
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    size_t before = s->found.count;
    vec3 u, v;
    vec3_basis(s->plane.normal, &u, &v);
    for (size_t i = 0; i < ring->count; i++)
        for (int k = 0; k < 2; k++) {
            low[k] = fmin(low[k], ring_place(s, ring, i)[k]), high[k] = fmax(high[k], ring_place(s, ring, i)[k]);
        }
    double least = sqrt((high[0] - low[0]) * (high[1] - low[1]) * OF_FACE / (double)s->n);
    if (step < least) step = least;
    enum status status = STATUS_OK;
    size_t row = 0;
    for (double y = low[1]; y < high[1] && !status; y = low[1] + (double)++row * ROW * step)
        for (double x = low[0] + (double)(row % 2) * step / 2; x < high[0] && !status; x += step) {
            const double at[2] = {x, y};
            if (!is_on_face(s, outer, at) || is_near_ring(s, outer, at, ASIDE * step)) continue;
            if (s->found.count == s->n / PLACES_SHARE) { /* a part of a face is worse than none */
                s->found.count = before;
                return STATUS_OK;
            }
            status = add_place(s, vec3_add(s->plane.at, vec3_add(vec3_scale(u, x), vec3_scale(v, y))), s->plane.normal,
                               step);
        }
    if (s->found.count < before + LEAST_PLACES) s->found.count = before;
    return status;
}

static vec3 ring_point(const struct search *s, const struct ring *ring, size_t i) {
    return s->point[s->on[s->order[ring->first + i % ring->count]]];
}

/* How far a ring has to be moved along the plane's normal, to one side, to where there are points as well; 0: nowhere.
 */
static enum status find_copy(const struct search *s, const struct ring *ring, double side, double *by) {
    static const double SAME = 2 * ON_PLANE;
    vec3 first = ring_point(s, ring, 0);
    double nearest = INFINITY;
    enum status status = STATUS_OK;
    *by = 0;
    for (size_t i = 0; i < s->n; i++) {
        vec3 to = vec3_sub(s->point[i], first);
        double h = side * vec3_dot(to, s->plane.normal);
        if (h > SAME && h < nearest && vec3_length_sq(to) - h * h < SAME * SAME) nearest = h;
    }
    if (!isfinite(nearest)) return STATUS_OK;
    for (size_t i = 0; i < ring->count && !status; i++) {
        vec3 there = vec3_add(ring_point(s, ring, i), vec3_scale(s->plane.normal, side * nearest));
        uint32_t found = NONE;
        double distance_sq = 0;
        status = knn_search(s->knn, &there, 1, 1, 1, &found, &distance_sq);
        if (!status && distance_sq > SAME * SAME) return STATUS_OK;
        if (!status && i == 0 && s->walled[found]) return STATUS_OK;
    }
    *by = side * nearest;
    return status;
}

/* The wall of a hole from one ring to its like: rows of places as far apart as the points in the ring, but a few. */
static enum status fill_wall(struct search *s, const struct ring *ring, double by) {
    enum { ROWS_MOST = 3 };
    double edge = 0;
    for (size_t i = 0; i < ring->count; i++)
        edge += vec3_distance(ring_point(s, ring, i), ring_point(s, ring, i + 1)) / (double)ring->count;
    double rows = fmin(floor(fabs(by) / edge), ROWS_MOST), step = fmax(edge, fabs(by) / (rows + 1));
    size_t each = step < 2 * edge ? 1 : (size_t)(step / edge);
    enum status status = STATUS_OK;
    for (size_t i = 0; i < ring->count; i++) s->walled[s->on[s->order[ring->first + i]]] = 1;
    if (rows < 2) return STATUS_OK; /* the rings are near enough */
    for (size_t i = 0; i < ring->count && !status; i += each) {
        vec3 at = ring_point(s, ring, i);
        vec3 along = vec3_sub(ring_point(s, ring, i + 1), ring_point(s, ring, i + ring->count - 1));
        vec3 normal = vec3_unit(vec3_cross(along, s->plane.normal));
        for (double row = 1; row <= rows && !status && s->found.count < s->n / PLACES_SHARE; row++)
            status = add_place(s, vec3_add(at, vec3_scale(s->plane.normal, by * row / (rows + 1))), normal, step);
    }
    return status;
}

/* A ring in a face and another one right across from it, to one side alone, are the ends of a hole or of what stands on
 * the face. */
static enum status find_wall(struct search *s, const struct ring *ring, bool inner) {
    double up = 0, down = 0;
    if (s->walled[s->on[s->order[ring->first]]]) return STATUS_OK;
    enum status status = find_copy(s, ring, 1, &up);
    if (!status) status = find_copy(s, ring, -1, &down);
    if (status || (up != 0) == (down != 0)) return status;
    s->found.holes += inner;
    return fill_wall(s, ring, up + down);
}

/* A face is within a ring that is around others, if an even number is around it, and holds no other points. */
static enum status find_faces(struct search *s) {
    static const double LOOSE = 0.02 /* of the rings' points */, ONE_SIDED = 0.3 /* of their length */;
    enum status status = STATUS_OK;
    for (size_t outer = 0; outer < s->rings && !status; outer++) {
        size_t inner = 0, points = s->ring[outer].count, loose = 0, before = s->found.count;
        double one_sided = 0, edge = 0;
        for (size_t i = 0; i < s->rings; i++)
            if (s->ring[i].outer == outer) inner++, points += s->ring[i].count;
        if (!inner || s->ring[outer].depth % 2) continue;
        for (size_t i = 0; i < s->m; i++) loose += s->in_ring[i] != 1 && is_on_face(s, outer, s->place[i]);
        if ((double)loose > LOOSE * (double)points) continue;
        status = survey_rings(s, outer, &one_sided, &edge);
        if (!status && one_sided > ONE_SIDED) status = fill_face(s, outer, edge);
        if (s->found.count == before) continue;
        for (size_t i = 0; i < s->rings && !status; i++)
            if (is_of_face(s, i, outer)) status = find_wall(s, &s->ring[i], i != outer);
    }
    return status;
}

/* Whether looking farther would take long: such points are of something else. */
static bool is_enough(const struct search *s) {
    return s->planes >= PLANES_MOST || s->planes * s->n >= COMPARED_MOST || s->pairs >= PAIRS_MOST;
}

/* Looks at the planes through a point and two of its neighbours, one to either side. */
static enum status search_around(struct search *s, uint32_t p) {
    enum { OF_NEAREST = 3, OTHERS = 2 };
    const struct neighbourhood *all = s->neighbours;
    const uint32_t *id = all->id + (size_t)p * all->stride;
    enum status status = STATUS_OK;
    for (int i = 0; i < OF_NEAREST && i < all->count[p] && !status; i++) {
        vec3 to = vec3_unit(vec3_sub(s->point[id[i]], s->point[p]));
        int others = 0;
        for (int j = i + 1; j < all->count[p] && others < OTHERS && !is_enough(s) && !status; j++) {
            bool grows = false;
            if (vec3_dot(to, vec3_unit(vec3_sub(s->point[id[j]], s->point[p]))) > -0.5) continue;
            others++;
            if (share_plane(s, p, id[i], id[j])) continue;
            status = grow_plane(s, p, id[i], id[j], &grows);
            if (status || !grows) continue;
            list_on_plane(s);
            if (s->m < LEAST_ON_PLANE || s->m == MOST_ON_PLANE) continue;
            s->pairs += s->m * s->m;
            find_rings(s);
            if (s->rings < 2) continue;
            nest_rings(s);
            status = find_faces(s);
        }
    }
    return status;
}

enum status flat_faces_find(const struct knn *knn, const struct neighbourhood *neighbours, const vec3 *point, size_t n,
                            unsigned threads, struct flat_faces *faces) {
    struct search s = {knn, neighbours, point, n, threads, .m = 0};
    bool grid = false;
    enum status status = on_grid_lines(point, n, threads, &grid);
    s.plane_of = alloc_zeroed(n, sizeof *s.plane_of);
    s.walled = alloc_zeroed(n, 1);
    s.on = alloc_array(MOST_ON_PLANE, sizeof *s.on);
    s.place = alloc_array(MOST_ON_PLANE, sizeof *s.place);
    s.alone_sq = alloc_array(MOST_ON_PLANE, sizeof *s.alone_sq);
    s.next = alloc_array(MOST_ON_PLANE, sizeof *s.next);
    s.order = alloc_array(MOST_ON_PLANE, sizeof *s.order);
    s.in_ring = alloc_array(MOST_ON_PLANE, 1);
    s.ring = alloc_array(MOST_ON_PLANE, sizeof *s.ring);
    bool room = s.plane_of && s.walled && s.on && s.place && s.alone_sq && s.next && s.order && s.in_ring && s.ring;
    if (!status && !room) status = STATUS_NO_MEMORY;
    for (uint32_t p = 0; p < n && !status && !grid; p += EACH) status = search_around(&s, p);
    free(s.plane_of), free(s.walled), free(s.on), free(s.place), free(s.alone_sq), free(s.next), free(s.order),
        free(s.in_ring), free(s.ring);
    if (status)
        flat_faces_done(&s.found);
    else
        *faces = s.found;
    return status;
}

void flat_faces_done(struct flat_faces *faces) {
    free(faces->point), free(faces->normal), free(faces->spacing);
    *faces = (struct flat_faces){0};
}
