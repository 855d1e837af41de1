/* A bounding volume hierarchy with four children to a node, searched nearest box first.
 *
 * Triangles are copied, moved by the centre of their bounding box and scaled by a power of two into [-1/2, 1/2], which
 * loses nothing but what the move rounds.  Nodes hold their children's boxes as float, so that a node is two cache
 * lines and its four boxes are measured as one vector; triangles are measured in double.
 *
 *     node   lo.x[4] lo.y[4] lo.z[4] hi.x[4] hi.y[4] hi.z[4] | link[4]
 *     link   count = 0: another node, node[first]            count > 0: a leaf, triangles first .. first + count - 1
 *
 * Invariant: for every query, a box's distance as it is computed is at most the computed distance of each triangle in
 * it. Boxes are padded by PAD and distances reduced by SLACK for this: inside [-2, 2] rounding to float costs less than
 * the pad, and farther out it costs less than the slack, since there the distance is at least half of the coordinate.
 * So a triangle is passed over only where it can't win, and the answer (the least distance, and the lowest id of those
 * that have it) depends neither on the hint nor on the order of the search.
 *
 * Splits are by the surface area heuristic over binned centres.  One thread makes the upper levels, any thread the
 * subtrees below, each with nodes of its own, so that the tree doesn't depend on the threads.  Meshes that defeat it
 * (all centres equal, sizes that shrink exponentially) are halved after DEEP levels, which bounds the stack.
 *
 * The rough kind takes triangles in their order, two to a leaf, and puts WIDTH neighbours under one node, level by
 * level.  What holds for every query holds there too, so it finds the same.
 *
 * Sources: Goldsmith and Salmon 1987; Wald, On fast construction of SAH-based bounding volume hierarchies, 2007;
 * Dammertz, Hanika and Keller, Shallow bounding volume hierarchies, 2008.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/bvh.h"

#include <assert.h>
#include <float.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/alloc.h"
#include "core/cloud.h"
#include "core/par.h"
#include "core/triangle.h"

enum { WIDTH = 4, LEAF = 3, ROUGH_LEAF = 2, DEEP = 40, STACK = WIDTH * (DEEP + 40) };
enum { BINS = 16, FEW = 8, MANY = 32 };               /* runs of less than these get fewer bins */
enum { TASK = 1024, GRAIN = 512, ITEM_GRAIN = 4096 }; /* triangles of a subtree that is built apart; queries; items */

#define PAD 0x1p-20f
#define SLACK (1 - 0x1p-18f)
#define FAR 0x1p50 /* where squares of float come near their end */

struct link {
    uint32_t first, count;
};

/* Four numbers that are computed with at once: an extension of GCC and Clang that works on any processor. */
typedef float lanes __attribute__((vector_size(WIDTH * sizeof(float))));
typedef int32_t masks __attribute__((vector_size(WIDTH * sizeof(int32_t))));

struct node {
    lanes lo[3], hi[3];
    struct link link[WIDTH];
};

struct corners {
    vec3 a, b, c;
};

struct bvh {
    vec3 centre;
    double scale, unscale; /* powers of two, inverse to each other */
    size_t triangle_count;
    struct corners *corners; /* in the order of the leaves, moved and scaled */
    uint32_t *id;            /* of each of corners, its triangle */
    uint32_t *slot;          /* of each triangle, its place in corners */
    struct node *node;
    struct link root;
};

/* ------------------------------------------------------------------------------------------------- building */

/* As float, which is what nodes hold; the fourth lanes mean nothing. */
struct box {
    lanes lo, hi;
};

/* A triangle, as far as building goes. */
struct item {
    struct box box;
    uint32_t id;
};

/* A run of triangles that becomes one child: item[begin] .. item[end - 1]. */
struct run {
    uint32_t begin, end;
    struct box box;
};

/* A subtree that is put off, to be built by any thread: its nodes are node[first] and on. */
struct task {
    struct run run;
    int depth;
    uint32_t first;
};

struct build {
    struct item *item; /* in the order of the leaves in the making */
    struct node *node;
    uint32_t node_count;
    struct task *task; /* NULL: nothing is put off */
    uint32_t task_count, most_tasks;
};

static const struct box EMPTY = {{INFINITY, INFINITY, INFINITY, INFINITY},
                                 {-INFINITY, -INFINITY, -INFINITY, -INFINITY}};

static inline lanes pick(masks m, lanes a, lanes b) { return (lanes)((m & (masks)a) | (~m & (masks)b)); }

static inline void box_add_point(struct box *box, lanes p) {
    box->lo = pick(p < box->lo, p, box->lo);
    box->hi = pick(p > box->hi, p, box->hi);
}

static inline void box_add_box(struct box *box, const struct box *other) {
    box->lo = pick(other->lo < box->lo, other->lo, box->lo);
    box->hi = pick(other->hi > box->hi, other->hi, box->hi);
}

/* Half of the surface; 0 when empty. */
static float box_area(const struct box *box) {
    lanes d = box->hi - box->lo;
    return d[0] < 0 ? 0 : d[0] * d[1] + d[1] * d[2] + d[2] * d[0];
}

/* Twice the centre. */
static inline lanes centre_of(const struct box *box) { return box->lo + box->hi; }

/* How the centres of a run are put into bins, along all axes at once. */
struct ruler {
    int bins;
    lanes low, per_length;
};

static inline masks bins_of(const struct ruler *ruler, const struct box *box) {
    masks bin = __builtin_convertvector((centre_of(box) - ruler->low) * ruler->per_length, masks);
    masks last = (masks){0} + (ruler->bins - 1);
    masks over = bin > last;
    return (over & last) | (~over & bin);
}

static struct ruler ruler_of(const struct build *build, const struct run *run) {
    struct box centres = EMPTY;
    uint32_t n = run->end - run->begin;
    struct ruler ruler = {.bins = n < FEW ? BINS / 4 : n < MANY ? BINS / 2 : BINS};
    for (uint32_t i = run->begin; i < run->end; i++) box_add_point(&centres, centre_of(&build->item[i].box));
    ruler.low = centres.lo;
    for (int axis = 0; axis < 3; axis++) {
        float per_length = (float)ruler.bins / (centres.hi[axis] - centres.lo[axis]);
        if (per_length <= FLT_MAX) ruler.per_length[axis] = per_length;
    }
    return ruler;
}

struct bin {
    struct box box;
    uint32_t count;
};

static void bin_add(struct bin *bin, const struct bin *other) {
    box_add_box(&bin->box, &other->box);
    bin->count += other->count;
}

/* A way to cut a run: bins below `cut` to the left. */
struct cut {
    int axis, cut;
    float cost;
    struct box left, right;
};

/* Takes the best of the cuts along an axis if that is better; there is none where all centres are in one bin. */
static void sweep(const struct bin *bins, int count, int axis, struct cut *best) {
    struct bin right[BINS + 1], left = {.box = EMPTY};
    right[count] = left;
    for (int i = count - 1; i > 0; i--) {
        right[i] = right[i + 1];
        bin_add(&right[i], &bins[i]);
    }
    for (int i = 1; i < count; i++) {
        bin_add(&left, &bins[i - 1]);
        if (left.count == 0 || right[i].count == 0) continue;
        float cost = box_area(&left.box) * (float)left.count + box_area(&right[i].box) * (float)right[i].count;
        if (cost < best->cost) *best = (struct cut){axis, i, cost, left.box, right[i].box};
    }
}

static struct cut best_cut(const struct build *build, const struct run *run, const struct ruler *ruler) {
    struct bin bins[3][BINS];
    struct cut best = {.cost = INFINITY};
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i < ruler->bins; i++) bins[axis][i] = (struct bin){.box = EMPTY};
    for (uint32_t i = run->begin; i < run->end; i++) {
        const struct bin one = {build->item[i].box, 1};
        masks bin = bins_of(ruler, &one.box);
        for (int axis = 0; axis < 3; axis++) bin_add(&bins[axis][bin[axis]], &one);
    }
    for (int axis = 0; axis < 3; axis++) sweep(bins[axis], ruler->bins, axis, &best);
    return best;
}

/* Moves the left side of the cut to the front; returns where the right side begins. */
static uint32_t partition(struct build *build, const struct run *run, const struct ruler *ruler,
                          const struct cut *cut) {
    uint32_t left = run->begin;
    for (uint32_t i = run->begin; i < run->end; i++) {
        struct item item = build->item[i];
        if (bins_of(ruler, &item.box)[cut->axis] >= cut->cut) continue;
        build->item[i] = build->item[left];
        build->item[left++] = item;
    }
    return left;
}

static void measure_run(const struct build *build, struct run *run) {
    run->box = EMPTY;
    for (uint32_t i = run->begin; i < run->end; i++) box_add_box(&run->box, &build->item[i].box);
}

static void halve(const struct build *build, struct run *run, struct run *right) {
    *right = (struct run){.begin = run->begin + (run->end - run->begin) / 2, .end = run->end};
    run->end = right->begin;
    measure_run(build, run);
    measure_run(build, right);
}

static void split(struct build *build, bool too_deep, struct run *run, struct run *right) {
    struct ruler ruler = ruler_of(build, run);
    struct cut cut = {.cost = INFINITY};
    if (!too_deep) cut = best_cut(build, run, &ruler);
    if (!(cut.cost < INFINITY)) {
        halve(build, run, right);
        return;
    }
    uint32_t middle = partition(build, run, &ruler, &cut);
    *right = (struct run){middle, run->end, cut.right};
    *run = (struct run){run->begin, middle, cut.left};
}

/* The run of the largest box that is too long for a leaf, or -1. */
static int run_to_split(const struct run *runs, int count) {
    int best = -1;
    for (int i = 0; i < count; i++) {
        if (runs[i].end - runs[i].begin <= LEAF) continue;
        if (best < 0 || box_area(&runs[i].box) > box_area(&runs[best].box)) best = i;
    }
    return best;
}

static void set_lane(struct node *node, int lane, const struct box *box, struct link link) {
    for (int i = 0; i < 3; i++) {
        node->lo[i][lane] = box->lo[i] - PAD;
        node->hi[i][lane] = box->hi[i] + PAD;
    }
    node->link[lane] = link;
}

/* The most nodes of a subtree.  By induction: a node has at least LEAF + 1 triangles, so one without children that are
 * nodes keeps the bound; one with such children has WIDTH children, and (1 for itself) + the sum of (n_i - 1) / 3 over
 * some of them is at most 1 + (n - WIDTH) / 3. */
static uint32_t most_nodes(uint32_t n) {
    static_assert(LEAF >= 3 && WIDTH == 4, "or there are more nodes");
    return n ? (n - 1) / 3 : 0;
}

/* Makes the subtree over a run, or puts it off. */
static struct link build_run(struct build *build, const struct run *whole, int depth) {
    uint32_t n = whole->end - whole->begin, self = build->node_count;
    if (n <= LEAF) return (struct link){whole->begin, n};
    if (build->task_count < build->most_tasks && n <= TASK) {
        build->task[build->task_count++] = (struct task){*whole, depth, self};
        build->node_count += most_nodes(n);
        return (struct link){self, 0};
    }
    build->node_count++;
    struct run runs[WIDTH] = {*whole};
    int count = 1;
    for (int i; count < WIDTH && (i = run_to_split(runs, count)) >= 0; count++)
        split(build, depth >= DEEP, &runs[i], &runs[count]);
    for (int i = 0; i < WIDTH; i++) {
        if (i < count)
            set_lane(&build->node[self], i, &runs[i].box, build_run(build, &runs[i], depth + 1));
        else
            set_lane(&build->node[self], i, &EMPTY, (struct link){0, 0});
    }
    return (struct link){self, 0};
}

static void build_tasks(void *ctx, size_t begin, size_t end) {
    const struct build *whole = ctx;
    for (size_t i = begin; i < end; i++) {
        const struct task *task = &whole->task[i];
        struct build build = {.item = whole->item, .node = whole->node, .node_count = task->first};
        build_run(&build, &task->run, task->depth);
    }
}

static vec3 to_inside(const struct bvh *bvh, vec3 p) { return vec3_scale(vec3_sub(p, bvh->centre), bvh->scale); }

/* Where to move and how to scale so that the triangles lie in [-1/2, 1/2]. */
static void choose_frame(struct bvh *bvh, const struct mesh *mesh) {
    vec3 lo = {INFINITY, INFINITY, INFINITY}, hi = vec3_scale(lo, -1);
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int i = 0; i < 3; i++) {
            lo = vec3_min(lo, mesh->vertex[mesh->triangle[t][i]]);
            hi = vec3_max(hi, mesh->vertex[mesh->triangle[t][i]]);
        }
    vec3 half = vec3_sub(vec3_scale(hi, 0.5), vec3_scale(lo, 0.5));
    double extent = fmax(0, fmax(half.x, fmax(half.y, half.z)));
    int exponent = 0;
    if (extent > 0) frexp(extent, &exponent);
    exponent = exponent < -900 ? -900 : exponent > 900 ? 900 : exponent;
    bvh->scale = ldexp(1, -exponent - 1);
    bvh->unscale = ldexp(1, exponent + 1);
    if (mesh->triangle_count) bvh->centre = vec3_add(vec3_scale(lo, 0.5), vec3_scale(hi, 0.5));
}

static struct corners corners_of(const struct bvh *bvh, const struct mesh *mesh, size_t t) {
    const uint32_t *v = mesh->triangle[t];
    return (struct corners){to_inside(bvh, mesh->vertex[v[0]]), to_inside(bvh, mesh->vertex[v[1]]),
                            to_inside(bvh, mesh->vertex[v[2]])};
}

static bool allocate(struct bvh *bvh, size_t n, size_t nodes) {
    bvh->triangle_count = n;
    bvh->corners = alloc_array(n, sizeof *bvh->corners);
    bvh->id = alloc_array(n, sizeof *bvh->id);
    bvh->slot = alloc_array(n, sizeof *bvh->slot);
    bvh->node = alloc_array(nodes, sizeof *bvh->node);
    return bvh->corners && bvh->id && bvh->slot && bvh->node;
}

struct loading {
    struct bvh *bvh;
    const struct mesh *mesh;
    struct item *item;
};

static lanes to_lanes(vec3 p) { return (lanes){(float)p.x, (float)p.y, (float)p.z}; }

static void box_add_corners(struct box *box, const struct corners *corners) {
    box_add_point(box, to_lanes(corners->a));
    box_add_point(box, to_lanes(corners->b));
    box_add_point(box, to_lanes(corners->c));
}

static void load_items(void *ctx, size_t begin, size_t end) {
    const struct loading *loading = ctx;
    for (size_t t = begin; t < end; t++) {
        struct corners corners = corners_of(loading->bvh, loading->mesh, t);
        struct item item = {.box = EMPTY, .id = (uint32_t)t};
        box_add_corners(&item.box, &corners);
        loading->item[t] = item;
    }
}

static void store_items(void *ctx, size_t begin, size_t end) {
    const struct loading *loading = ctx;
    struct bvh *bvh = loading->bvh;
    for (size_t i = begin; i < end; i++) {
        uint32_t id = bvh->id[i] = loading->item[i].id;
        bvh->slot[id] = (uint32_t)i;
        bvh->corners[i] = corners_of(bvh, loading->mesh, id);
    }
}

static void build_tree(struct bvh *bvh, const struct mesh *mesh, unsigned threads, struct build *build) {
    struct run whole = {.begin = 0, .end = (uint32_t)bvh->triangle_count};
    struct loading loading = {bvh, mesh, build->item};
    par_for(threads, whole.end, ITEM_GRAIN, load_items, &loading);
    measure_run(build, &whole);
    bvh->root = build_run(build, &whole, 0);
    par_for(threads, build->task_count, 1, build_tasks, build);
    par_for(threads, whole.end, ITEM_GRAIN, store_items, &loading);
    assert(build->node_count <= most_nodes(whole.end));
}

enum status bvh_new(const struct mesh *mesh, unsigned threads, struct bvh **out) {
    assert(mesh->triangle_count < NONE);
    enum status status = STATUS_NO_MEMORY;
    struct build build = {.most_tasks = (uint32_t)(mesh->triangle_count / (TASK / WIDTH))};
    build.item = alloc_array(mesh->triangle_count, sizeof *build.item);
    build.task = alloc_array(build.most_tasks, sizeof *build.task);
    struct bvh *bvh = alloc_zeroed(1, sizeof *bvh);
    size_t n = mesh->triangle_count;
    if (!build.item || !build.task || !bvh || !allocate(bvh, n, most_nodes((uint32_t)n))) goto out;
    build.node = bvh->node;
    choose_frame(bvh, mesh);
    build_tree(bvh, mesh, threads, &build);
    *out = bvh;
    bvh = NULL;
    status = STATUS_OK;
out:
    bvh_free(bvh);
    free(build.item), free(build.task);
    return status;
}

/* A leaf or a node with all that is under it. */
struct part {
    struct box box;
    struct link link;
};

struct stacking {
    struct bvh *bvh;
    const struct mesh *mesh;
    const struct part *below; /* n; the parts of a level are made of those below */
    size_t n;
    struct part *part;
    uint32_t first_node;
};

static void make_leaves(void *ctx, size_t begin, size_t end) {
    const struct stacking *stacking = ctx;
    struct bvh *bvh = stacking->bvh;
    for (size_t i = begin; i < end; i++) {
        uint32_t first = (uint32_t)(ROUGH_LEAF * i), left = (uint32_t)bvh->triangle_count - first;
        struct part part = {EMPTY, {first, left < ROUGH_LEAF ? left : ROUGH_LEAF}};
        for (uint32_t t = first; t < first + part.link.count; t++) {
            bvh->corners[t] = corners_of(bvh, stacking->mesh, t);
            bvh->id[t] = bvh->slot[t] = t;
            box_add_corners(&part.box, &bvh->corners[t]);
        }
        stacking->part[i] = part;
    }
}

static void make_level(void *ctx, size_t begin, size_t end) {
    const struct stacking *stacking = ctx;
    const struct part nothing = {EMPTY, {0, 0}};
    for (size_t i = begin; i < end; i++) {
        uint32_t self = stacking->first_node + (uint32_t)i;
        struct part part = {EMPTY, {self, 0}};
        for (int lane = 0; lane < WIDTH; lane++) {
            size_t child = WIDTH * i + (size_t)lane;
            const struct part *below = child < stacking->n ? &stacking->below[child] : &nothing;
            set_lane(&stacking->bvh->node[self], lane, &below->box, below->link);
            box_add_box(&part.box, &below->box);
        }
        stacking->part[i] = part;
    }
}

/* n leaves; part: room for those of all levels, which follow each other. */
static void stack_up(struct bvh *bvh, const struct mesh *mesh, size_t n, unsigned threads, struct part *part) {
    struct stacking level = {.bvh = bvh, .mesh = mesh, .part = part};
    par_for(threads, n, GRAIN, make_leaves, &level);
    while (n > 1) {
        level.below = level.part, level.n = n;
        level.part += n, n = (n + WIDTH - 1) / WIDTH;
        par_for(threads, n, GRAIN, make_level, &level);
        level.first_node += (uint32_t)n;
    }
    if (n) bvh->root = level.part->link;
}

enum status bvh_new_rough(const struct mesh *mesh, unsigned threads, struct bvh **out) {
    assert(mesh->triangle_count < NONE);
    size_t leaves = (mesh->triangle_count + ROUGH_LEAF - 1) / ROUGH_LEAF; /* there are fewer nodes */
    struct part *part = alloc_array(2 * leaves, sizeof *part);
    struct bvh *bvh = alloc_zeroed(1, sizeof *bvh);
    bool enough = part && bvh && allocate(bvh, mesh->triangle_count, leaves);
    if (enough) {
        choose_frame(bvh, mesh);
        stack_up(bvh, mesh, leaves, threads, part);
        *out = bvh;
    } else {
        bvh_free(bvh);
    }
    free(part);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}

void bvh_free(struct bvh *bvh) {
    if (!bvh) return;
    free(bvh->corners);
    free(bvh->id);
    free(bvh->slot);
    free(bvh->node);
    free(bvh);
}

/* ------------------------------------------------------------------------------------------------- searching */

/* The best so far, in the hierarchy's own frame. */
struct search {
    const struct bvh *bvh;
    vec3 p, point;
    double distance_sq;
    uint32_t triangle;
};

static inline void try_slot(struct search *s, uint32_t slot) {
    const struct corners *t = &s->bvh->corners[slot];
    vec3 point = triangle_closest(s->p, t->a, t->b, t->c);
    double distance_sq = vec3_distance_sq(s->p, point);
    if (distance_sq > s->distance_sq) return;
    uint32_t id = s->bvh->id[slot];
    if (distance_sq == s->distance_sq && id >= s->triangle) return;
    s->point = point;
    s->distance_sq = distance_sq;
    s->triangle = id;
}

static void try_slots(struct search *s, struct link leaf) {
    for (uint32_t i = 0; i < leaf.count; i++) try_slot(s, leaf.first + i);
}

/* The lanes of x that are positive, 0 in the others. */
static inline lanes positive(lanes x) { return (lanes)((masks)x & (x > 0)); }

/* Lower bounds of the squared distances to the four boxes of a node. */
static inline lanes measure_boxes(const struct node *node, const float p[3]) {
    lanes sum = {0};
    for (int i = 0; i < 3; i++) {
        lanes outside = positive(node->lo[i] - p[i]) + positive(p[i] - node->hi[i]);
        sum += outside * outside;
    }
    return sum * SLACK;
}

struct todo {
    struct link link;
    float bound;
};

/* Puts the children that can hold something nearer on the stack, the nearest on top; returns the new top. */
static inline struct todo *push_children(struct todo *top, const struct node *node, const float p[3], double limit) {
    lanes bound = measure_boxes(node, p);
    struct todo *bottom = top;
    for (int lane = 0; lane < WIDTH; lane++) {
        if (!((double)bound[lane] <= limit) || bound[lane] > FLT_MAX) continue;
        struct todo *place = top++;
        for (; place > bottom && place[-1].bound < bound[lane]; place--) *place = place[-1];
        *place = (struct todo){node->link[lane], bound[lane]};
    }
    return top;
}

static void descend(struct search *s) {
    const float p[3] = {(float)s->p.x, (float)s->p.y, (float)s->p.z};
    struct todo stack[STACK], *top = stack;
    *top++ = (struct todo){s->bvh->root, 0};
    while (top > stack) {
        struct todo next = *--top;
        if ((double)next.bound > s->distance_sq) continue;
        if (next.link.count)
            try_slots(s, next.link);
        else
            top = push_children(top, &s->bvh->node[next.link.first], p, s->distance_sq);
    }
}

static bool is_far(vec3 p) { return !(fabs(p.x) < FAR && fabs(p.y) < FAR && fabs(p.z) < FAR); }

struct bvh_hit bvh_closest_within(const struct bvh *bvh, vec3 p, uint32_t hint, double bound_sq) {
    struct bvh_hit hit = {.distance_sq = INFINITY, .triangle = NONE};
    if (bvh->triangle_count == 0) return hit;
    struct search s = {.bvh = bvh, .p = to_inside(bvh, p), .triangle = NONE};
    s.distance_sq = bound_sq * bvh->scale * bvh->scale;
    if (hint != NONE) try_slot(&s, bvh->slot[hint]);
    if (is_far(s.p))
        try_slots(&s, (struct link){0, (uint32_t)bvh->triangle_count});
    else
        descend(&s);
    if (s.triangle == NONE) return hit;
    hit.distance_sq = s.distance_sq * bvh->unscale * bvh->unscale;
    hit.point = vec3_add(bvh->centre, vec3_scale(s.point, bvh->unscale));
    hit.triangle = s.triangle;
    return hit;
}

struct bvh_hit bvh_closest(const struct bvh *bvh, vec3 p, uint32_t hint) {
    return bvh_closest_within(bvh, p, hint, INFINITY);
}

struct batch {
    const struct bvh *bvh;
    const vec3 *p;
    struct bvh_hit *hit;
};

static void closest_range(void *ctx, size_t begin, size_t end) {
    const struct batch *batch = ctx;
    uint32_t hint = NONE;
    for (size_t i = begin; i < end; i++) {
        batch->hit[i] = bvh_closest(batch->bvh, batch->p[i], hint);
        hint = batch->hit[i].triangle;
    }
}

void bvh_closest_all(const struct bvh *bvh, const vec3 *p, size_t n, unsigned threads, struct bvh_hit *hit) {
    struct batch batch = {.bvh = bvh, .p = p, .hit = hit};
    par_for(threads, n, GRAIN, closest_range, &batch);
}
