/* A kd-tree of FLANN's bounds what lies in a node by the cuts above it alone.  Beside a surface that is enough.  From
 * far off it isn't: a query over the hollow of a curve is within the cuts of most nodes, though their points are far,
 * and looks at very many of them.
 *
 *     level 1    [           box            ] [ ...        WIDTH boxes of the level below to each
 *     level 0    [ box ][ box ][ box ][ box ] [ ...        LEAF points to each, by their ids
 *
 * Boxes of points that follow each other along a space-filling curve are tight, and need no building but for looking at
 * each point once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/knn_boxes.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"

enum { LEAF = 32, WIDTH = 4, MOST_LEVELS = 16 /* 2^31 points have 14 */ };
static const double ROUNDING = 1 + 1e-12; /* more than distances of boxes are off by */

struct box {
    vec3 least, most;
};

struct knn_boxes {
    const vec3 *point;
    size_t n;
    struct box *box;
    unsigned levels;
    size_t first[MOST_LEVELS], count[MOST_LEVELS]; /* the boxes of each level; one in the highest */
};

static struct box box_of(const vec3 *point, size_t n) {
    struct box box = {point[0], point[0]};
    for (size_t i = 1; i < n; i++) box.least = vec3_min(box.least, point[i]), box.most = vec3_max(box.most, point[i]);
    return box;
}

static struct box join(const struct box *part, size_t n) {
    struct box box = part[0];
    for (size_t i = 1; i < n; i++)
        box.least = vec3_min(box.least, part[i].least), box.most = vec3_max(box.most, part[i].most);
    return box;
}

/* Plans the levels; returns how many boxes they have. */
static size_t plan(struct knn_boxes *boxes) {
    size_t count = (boxes->n - 1) / LEAF + 1, all = 0;
    for (;; count = (count - 1) / WIDTH + 1) {
        boxes->first[boxes->levels] = all, boxes->count[boxes->levels++] = count;
        all += count;
        if (count == 1) return all;
    }
}

enum status knn_boxes_new(const vec3 *points, size_t n, struct knn_boxes **out) {
    struct knn_boxes *boxes = alloc_zeroed(1, sizeof *boxes);
    if (!boxes) return STATUS_NO_MEMORY;
    boxes->point = points, boxes->n = n;
    struct box *box = boxes->box = alloc_array(plan(boxes), sizeof *boxes->box);
    if (!box) {
        knn_boxes_free(boxes);
        return STATUS_NO_MEMORY;
    }
    for (size_t begin = 0; begin < n; begin += LEAF)
        *box++ = box_of(&points[begin], n - begin < LEAF ? n - begin : LEAF);
    for (unsigned level = 1; level < boxes->levels; level++)
        for (size_t begin = 0, below = boxes->count[level - 1]; begin < below; begin += WIDTH)
            *box++ = join(&boxes->box[boxes->first[level - 1] + begin], below - begin < WIDTH ? below - begin : WIDTH);
    *out = boxes;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ queries */

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

static double box_distance_sq(const struct box *box, vec3 p) {
    return vec3_distance_sq(p, vec3_min(vec3_max(p, box->least), box->most));
}

/* The boxes below one, the nearest first. */
static void look_into(struct search *s, unsigned level, size_t at) {
    const struct knn_boxes *boxes = s->boxes;
    if (level == 0) {
        look_at_points(s, at);
        return;
    }
    size_t child[WIDTH], count = 0, begin = at * WIDTH, below = boxes->count[level - 1];
    double distance_sq[WIDTH];
    for (size_t c = begin; c < begin + WIDTH && c < below; c++) {
        double d = box_distance_sq(&boxes->box[boxes->first[level - 1] + c], s->query);
        size_t i = count++;
        for (; i > 0 && distance_sq[i - 1] > d; i--) distance_sq[i] = distance_sq[i - 1], child[i] = child[i - 1];
        distance_sq[i] = d, child[i] = c;
    }
    for (size_t i = 0; i < count && distance_sq[i] <= s->worst_sq; i++) look_into(s, level - 1, child[i]);
}

unsigned knn_boxes_nearest(const struct knn_boxes *boxes, vec3 query, unsigned k, const struct knn_slack *slack,
                           double bound_sq, uint32_t *id, double *distance_sq) {
    struct search s = {boxes, query, k, 0, slack, id, distance_sq, bound_sq * ROUNDING};
    look_into(&s, boxes->levels - 1, 0);
    return s.found;
}

void knn_boxes_free(struct knn_boxes *boxes) {
    if (!boxes) return;
    free(boxes->box);
    free(boxes);
}
