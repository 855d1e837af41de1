/* A kd-tree of FLANN's bounds what lies in a node by the cuts above it alone, and has its points looked at one by one,
 * by calls.  These boxes are tight, and looked at as many at a time as a register holds, as their points are.
 *
 *     level 1    [           node           ] [ ...        WIDTH boxes to each node, of the nodes below
 *     level 0    [ box | box | box | box    ] [ ...        LEAF points to each, by their ids
 *
 * Boxes of points that follow each other along a space-filling curve need no building but for looking at each point
 * once.  Of points in no order they are of no use for balls: who looks at too many of them is told so.
 *
 * From far off cuts aren't enough: a query over the hollow of a curve is within the cuts of most nodes, though their
 * points are far, and looks at very many of them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/knn_boxes.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/simd.h"

enum { LEAF = 16, WIDTH = 4, MOST_LEVELS = 16 /* 2^31 points have 14 */ };
enum { MOST_WAITING = (WIDTH - 1) * MOST_LEVELS + 1 };
static const double ROUNDING = 1 + 1e-12; /* more than distances of boxes are off by */

/* Boxes side by side.  What isn't there is infinitely far. */
struct node {
    double least[3][WIDTH], most[3][WIDTH];
};

struct knn_boxes {
    const vec3 *point;
    size_t n;
    struct node *node;
    unsigned levels;
    size_t first[MOST_LEVELS], count[MOST_LEVELS]; /* the nodes of each level; one in the highest */
};

static void set_box(struct node *node, size_t i, vec3 least, vec3 most) {
    node->least[0][i] = least.x, node->least[1][i] = least.y, node->least[2][i] = least.z;
    node->most[0][i] = most.x, node->most[1][i] = most.y, node->most[2][i] = most.z;
}

static void clear(struct node *node) {
    static const vec3 far = {INFINITY, INFINITY, INFINITY};
    for (size_t i = 0; i < WIDTH; i++) set_box(node, i, far, vec3_scale(far, -1));
}

static void box_points(struct node *node, size_t i, const vec3 *point, size_t n) {
    vec3 least = point[0], most = point[0];
    for (size_t p = 1; p < n; p++) least = vec3_min(least, point[p]), most = vec3_max(most, point[p]);
    set_box(node, i, least, most);
}

/* Of what lies in a node. */
static void box_node(struct node *node, size_t i, const struct node *below) {
    for (unsigned axis = 0; axis < 3; axis++) {
        double least = below->least[axis][0], most = below->most[axis][0];
        for (unsigned k = 1; k < WIDTH; k++) {
            least = below->least[axis][k] < least ? below->least[axis][k] : least;
            most = below->most[axis][k] > most ? below->most[axis][k] : most;
        }
        node->least[axis][i] = least, node->most[axis][i] = most;
    }
}

/* Plans the levels; returns how many nodes they have. */
static size_t plan(struct knn_boxes *boxes) {
    size_t all = 0;
    for (size_t count = (boxes->n - 1) / LEAF / WIDTH + 1;; count = (count - 1) / WIDTH + 1) {
        boxes->first[boxes->levels] = all, boxes->count[boxes->levels++] = count;
        all += count;
        if (count == 1) return all;
    }
}

static void build(struct knn_boxes *boxes) {
    for (size_t begin = 0, i = 0; begin < boxes->n; begin += LEAF, i++) {
        struct node *node = &boxes->node[i / WIDTH];
        size_t left = boxes->n - begin;
        if (i % WIDTH == 0) clear(node);
        box_points(node, i % WIDTH, &boxes->point[begin], left < LEAF ? left : LEAF);
    }
    for (unsigned level = 1; level < boxes->levels; level++)
        for (size_t i = 0; i < boxes->count[level - 1]; i++) {
            struct node *node = &boxes->node[boxes->first[level] + i / WIDTH];
            if (i % WIDTH == 0) clear(node);
            box_node(node, i % WIDTH, &boxes->node[boxes->first[level - 1] + i]);
        }
}

FOR_EACH_PROCESSOR(enum status, knn_boxes_new)(const vec3 *points, size_t n, struct knn_boxes **out) {
    struct knn_boxes *boxes = alloc_zeroed(1, sizeof *boxes);
    if (!boxes) return STATUS_NO_MEMORY;
    boxes->point = points, boxes->n = n;
    boxes->node = alloc_array(plan(boxes), sizeof *boxes->node);
    if (!boxes->node) {
        free(boxes);
        return STATUS_NO_MEMORY;
    }
    build(boxes);
    *out = boxes;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ queries */

INLINE f64v beyond(const struct node *node, unsigned axis, unsigned k, double at) {
    f64v before = f64_load(&node->least[axis][k]) - f64_all(at), after = f64_all(at) - f64_load(&node->most[axis][k]);
    return f64_positive(f64_pick(f64_less(before, after), after, before));
}

/* How far a node's boxes are.  Rounding never makes it more than how far their points are. */
INLINE void measure_boxes(const struct node *node, vec3 p, double distance_sq[WIDTH]) {
    for (unsigned k = 0; k < WIDTH; k += F64_LANES) {
        f64v x = beyond(node, 0, k, p.x), y = beyond(node, 1, k, p.y), z = beyond(node, 2, k, p.z);
        f64_store(&distance_sq[k], x * x + y * y + z * z);
    }
}

/* Adds the points of a box that are nearer than that to what has been gathered, of which there is room for all. */
INLINE void gather_points(const struct knn_boxes *boxes, size_t box, vec3 centre, double radius_sq,
                          struct knn_gathered *to) {
    double *x = to->x, *y = to->y, *z = to->z;
    uint32_t *id = to->id;
    size_t begin = box * LEAF, left = boxes->n - begin;
    const vec3 *point = &boxes->point[begin];
    unsigned n = left < LEAF ? (unsigned)left : LEAF, count = to->count;
    for (unsigned i = 0; i < n; i++) { /* no branch to guess wrong */
        x[count] = point[i].x, y[count] = point[i].y, z[count] = point[i].z;
        id[count] = (uint32_t)(begin + i);
        count += vec3_distance_sq(centre, point[i]) < radius_sq;
    }
    to->count = count;
}

FOR_EACH_PROCESSOR(bool, knn_boxes_within)
(const struct knn_boxes *boxes, vec3 centre, double radius, unsigned most, struct knn_gathered *to) {
    static_assert((int)LEAF <= (int)KNN_BOXES_ROOM, "room for all points of a box");
    enum { VISITS = 64, TO_A_VISIT = 4 };
    double radius_sq = radius * radius;
    struct {
        unsigned level;
        size_t node;
    } waiting[MOST_WAITING] = {{boxes->levels - 1, 0}};
    unsigned visits = 0;
    to->count = 0;
    for (unsigned n = 1; n > 0 && to->count <= most;) {
        unsigned level = waiting[--n].level;
        size_t at = waiting[n].node;
        double distance_sq[WIDTH];
        if (++visits > VISITS + to->count / TO_A_VISIT) return false;
        measure_boxes(&boxes->node[boxes->first[level] + at], centre, distance_sq);
        for (unsigned i = 0; i < WIDTH && to->count <= most; i++) {
            if (!(distance_sq[i] < radius_sq)) continue;
            if (level == 0)
                gather_points(boxes, at * WIDTH + i, centre, radius_sq, to);
            else
                waiting[n].level = level - 1, waiting[n++].node = at * WIDTH + i;
        }
    }
    return true;
}

struct search {
    const struct knn_boxes *boxes;
    vec3 query;
    unsigned k, found;
    const struct knn_slack *slack;
    uint32_t *id;
    double *distance_sq, worst_sq; /* what is farther than the worst is passed by */
};

static bool is_after(const struct search *s, unsigned i, double distance_sq, uint32_t id) {
    return s->distance_sq[i] > distance_sq || (s->distance_sq[i] == distance_sq && s->id[i] > id);
}

static void set_worst(struct search *s) {
    double last_sq = s->distance_sq[s->k - 1], factor = ROUNDING;
    if (s->slack) {
        double own = s->slack->far * (double)s->slack->length[s->id[s->k - 1]];
        if (last_sq > own * own) factor = (1 - s->slack->share) * (1 - s->slack->share);
    }
    s->worst_sq = fmin(s->worst_sq, last_sq * factor);
}

static void add(struct search *s, double distance_sq, uint32_t id) {
    if (s->found == s->k && !is_after(s, s->k - 1, distance_sq, id)) return;
    unsigned i = s->found < s->k ? s->found++ : s->k - 1;
    for (; i > 0 && is_after(s, i - 1, distance_sq, id); i--)
        s->distance_sq[i] = s->distance_sq[i - 1], s->id[i] = s->id[i - 1];
    s->distance_sq[i] = distance_sq, s->id[i] = id;
    if (s->found == s->k) set_worst(s);
}

static void look_at_points(struct search *s, size_t leaf) {
    size_t begin = leaf * LEAF, left = s->boxes->n - begin, end = begin + (left < LEAF ? left : LEAF);
    for (size_t i = begin; i < end; i++) {
        double distance_sq = vec3_distance_sq(s->query, s->boxes->point[i]);
        if (distance_sq <= s->worst_sq) add(s, distance_sq, (uint32_t)i);
    }
}

/* The boxes of a node, the nearest first. */
static void look_into(struct search *s, unsigned level, size_t at) {
    const struct knn_boxes *boxes = s->boxes;
    size_t child[WIDTH], below = level == 0 ? (boxes->n - 1) / LEAF + 1 : boxes->count[level - 1];
    double distance_sq[WIDTH], sorted_sq[WIDTH];
    measure_boxes(&boxes->node[boxes->first[level] + at], s->query, distance_sq);
    for (size_t c = 0; c < WIDTH; c++) {
        size_t i = c;
        for (; i > 0 && sorted_sq[i - 1] > distance_sq[c]; i--)
            sorted_sq[i] = sorted_sq[i - 1], child[i] = child[i - 1];
        sorted_sq[i] = distance_sq[c], child[i] = at * WIDTH + c;
    }
    for (size_t i = 0; i < WIDTH && child[i] < below && sorted_sq[i] <= s->worst_sq; i++)
        if (level == 0)
            look_at_points(s, child[i]);
        else
            look_into(s, level - 1, child[i]);
}

FOR_EACH_PROCESSOR(unsigned, knn_boxes_nearest)
(const struct knn_boxes *boxes, vec3 query, unsigned k, const struct knn_slack *slack, double bound_sq, uint32_t *id,
 double *distance_sq) {
    struct search s = {boxes, query, k, 0, slack, id, distance_sq, bound_sq * ROUNDING};
    look_into(&s, boxes->levels - 1, 0);
    return s.found;
}

FOR_EACH_PROCESSOR(void, knn_boxes_free)(struct knn_boxes *boxes) {
    if (!boxes) return;
    free(boxes->node);
    free(boxes);
}
