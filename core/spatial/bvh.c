/* A bounding volume hierarchy with four children to a node, searched nearest box first.
 *
 * Triangles are copied, moved by the centre of their bounding box and scaled by a power of two into [-1/2, 1/2], which
 * loses nothing but what the move rounds.  Nodes hold their children's boxes as float, so that a node is two cache
 * lines and its four boxes are measured as one vector; triangles are measured in double.
 *
 *     node   lo.x[4] lo.y[4] lo.z[4] hi.x[4] hi.y[4] hi.z[4] | link[4]
 *     link   count = 0: another node, node[first]            count > 0: a leaf, triangles first .. first + count - 1
 *            count = NESTED: a part with a frame of its own, part[first]
 *
 * Float can't tell boxes apart that are small against where they are: two scans a million times as far apart as they
 * are long would be two heaps of equal boxes.  A run of triangles that lie that close becomes a part: moved and scaled
 * to about one again, with nodes in that frame, and parts within parts.  Meshes of ordinary scans have none.
 *
 * Invariant: for every query, a box's distance as it is computed is at most the computed distance of each triangle in
 * it. Boxes are padded by PAD and distances reduced by SLACK for this: inside [-2, 2] rounding to float costs less than
 * the pad, and farther out it costs less than the slack, since there the distance is at least half of the coordinate.
 * In a part the pad also is more than what distances are rounded by, which depends on how far off the part is.
 * So a triangle is passed over only where it can't win, and the answer (the least distance, and the lowest id of those
 * that have it) depends neither on the hint nor on the order of the search.
 *
 * From very far away all boxes are as near, as far as float tells.  Such a query passes over what could win by next to
 * nothing alone, and takes no hint, so that its answer depends on nothing but the hierarchy.
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
#include "core/spatial/bvh.h"

#include <assert.h>
#include <float.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/cloud/most.h"
#include "core/math/simd.h"
#include "core/math/triangle.h"

enum { WIDTH = 4, LEAF = 3, ROUGH_LEAF = 2, DEEP = 40, STACK = WIDTH * (DEEP + 40) };
enum { BINS = 16, FEW = 8, MANY = 32 };               /* runs of less than these get fewer bins */
enum { TASK = 1024, GRAIN = 512, ITEM_GRAIN = 4096 }; /* triangles of a subtree that is built apart; queries; items */

#define PAD 0x1p-20f
#define SLACK (1 - 0x1p-18f)
#define FAR 0x1p50           /* where squares of float come near their end */
#define AWAY 0x1p12          /* extents from which on a nearly nearest point will do */
#define NEARLY (1 - 0x1p-16) /* of its squared distance: more than float boxes lose there */

/* Parts: of at least so many triangles, so deep within each other, where the square of the extent for each triangle is
 * that of 32 pads or less, and so small that there is something to gain. */
enum { PART_FEWEST = 64, PART_DEEPEST = 8 };
#define PART_AREA 0x1p-30f
#define PART_EXTENT 0x1p-4f
#define PART_ROUNDING 0x1p-49 /* of distances, in where the part is */
#define NESTED UINT32_MAX

struct link {
    uint32_t first, count;
};

struct node {
    f32x4 lo[3], hi[3];
    struct link link[WIDTH];
};

struct corners {
    vec3 a, b, c;
};

/* Where nodes have their boxes: (place - centre) * scale, a power of two.  Places are in the hierarchy's frame, and so
 * are those of parts within parts. */
struct frame {
    vec3 centre;
    double scale;
};

struct part {
    struct frame frame;
    struct link root, all; /* all: the triangles, as if it were a leaf */
};

struct bvh {
    vec3 centre;
    double scale, unscale; /* powers of two, inverse to each other */
    size_t triangle_count;
    struct corners *corners; /* in the order of the leaves, moved and scaled */
    uint32_t *id;            /* of each of corners, its triangle */
    uint32_t *slot;          /* of each triangle, its place in corners */
    struct node *node;
    struct part *part;
    struct part whole; /* in the hierarchy's own frame */
};

/* ------------------------------------------------------------------------------------------------- building */

/* As float, which is what nodes hold; the fourth lanes mean nothing. */
struct box {
    f32x4 lo, hi;
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

/* What the boxes of nodes and items are in, while the part is built; nested: how deep that is. */
struct view {
    struct frame frame;
    float pad;
    int nested;
};

/* A subtree that is put off, to be built by any thread: its nodes are node[first] and on, its parts likewise. */
struct task {
    struct run run;
    int depth;
    uint32_t first, first_part;
    struct view view;
};

struct build {
    struct item *item; /* in the order of the leaves in the making */
    struct node *node;
    struct part *part;
    uint32_t node_count, part_count;
    struct task *task; /* NULL: nothing is put off */
    uint32_t task_count, most_tasks;
    const struct bvh *bvh;
    const struct mesh *mesh;
    struct view view;
};

static const struct box EMPTY = {{INFINITY, INFINITY, INFINITY, INFINITY},
                                 {-INFINITY, -INFINITY, -INFINITY, -INFINITY}};

static inline void box_add_point(struct box *box, f32x4 p) {
    box->lo = f32x4_pick(p < box->lo, p, box->lo);
    box->hi = f32x4_pick(p > box->hi, p, box->hi);
}

static inline void box_add_box(struct box *box, const struct box *other) {
    box->lo = f32x4_pick(other->lo < box->lo, other->lo, box->lo);
    box->hi = f32x4_pick(other->hi > box->hi, other->hi, box->hi);
}

/* Half of the surface; 0 when empty. */
static float box_area(const struct box *box) {
    f32x4 d = box->hi - box->lo;
    return d[0] < 0 ? 0 : d[0] * d[1] + d[1] * d[2] + d[2] * d[0];
}

/* Twice the centre. */
static inline f32x4 centre_of(const struct box *box) { return box->lo + box->hi; }

/* How the centres of a run are put into bins, along all axes at once. */
struct ruler {
    int bins;
    f32x4 low, per_length;
};

static inline i32x4 bins_of(const struct ruler *ruler, const struct box *box) {
    i32x4 bin = __builtin_convertvector((centre_of(box) - ruler->low) * ruler->per_length, i32x4);
    i32x4 last = (i32x4){0} + (ruler->bins - 1);
    i32x4 over = bin > last;
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
        i32x4 bin = bins_of(ruler, &one.box);
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

static void set_lane(struct node *node, int lane, const struct box *box, float pad, struct link link) {
    for (int i = 0; i < 3; i++) {
        node->lo[i][lane] = box->lo[i] - pad;
        node->hi[i][lane] = box->hi[i] + pad;
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

/* The most parts of a subtree: as deep as each other they share no triangle. */
static uint32_t most_parts(uint32_t n) { return n / PART_FEWEST * PART_DEEPEST; }

static vec3 to_inside(const struct bvh *bvh, vec3 p) { return vec3_scale(vec3_sub(p, bvh->centre), bvh->scale); }

static struct corners corners_of(const struct bvh *bvh, const struct mesh *mesh, size_t t) {
    const uint32_t *v = mesh->triangle[t];
    return (struct corners){to_inside(bvh, mesh->vertex[v[0]]), to_inside(bvh, mesh->vertex[v[1]]),
                            to_inside(bvh, mesh->vertex[v[2]])};
}

static f32x4 to_lanes(vec3 p) { return (f32x4){(float)p.x, (float)p.y, (float)p.z}; }

static void box_add_corners(struct box *box, const struct corners *corners) {
    box_add_point(box, to_lanes(corners->a));
    box_add_point(box, to_lanes(corners->b));
    box_add_point(box, to_lanes(corners->c));
}

static vec3 to_frame(const struct frame *frame, vec3 p) { return vec3_scale(vec3_sub(p, frame->centre), frame->scale); }

static float extent_of(const struct box *box) {
    f32x4 d = box->hi - box->lo;
    return fmaxf(d[0], fmaxf(d[1], d[2]));
}

static bool is_part(const struct build *build, const struct run *run) {
    uint32_t n = run->end - run->begin;
    float extent = extent_of(&run->box);
    return n >= PART_FEWEST && build->view.nested < PART_DEEPEST && extent < PART_EXTENT &&
           extent * extent < PART_AREA * (float)n;
}

/* The frame in which the triangles of a run are about one long; false where they are all one place. */
static bool frame_run(const struct build *build, const struct run *run, struct view *view) {
    vec3 lo = {INFINITY, INFINITY, INFINITY}, hi = vec3_scale(lo, -1);
    for (uint32_t i = run->begin; i < run->end; i++) {
        struct corners t = corners_of(build->bvh, build->mesh, build->item[i].id);
        lo = vec3_min(lo, vec3_min(t.a, vec3_min(t.b, t.c)));
        hi = vec3_max(hi, vec3_max(t.a, vec3_max(t.b, t.c)));
    }
    vec3 side = vec3_sub(hi, lo);
    double extent = fmax(side.x, fmax(side.y, side.z)), off = 0;
    int exponent;
    if (!(extent > 0)) return false;
    frexp(extent, &exponent);
    for (int axis = 0; axis < 3; axis++) off = fmax(off, fmax(fabs((&lo.x)[axis]), fabs((&hi.x)[axis])));
    view->frame.centre = vec3_lerp(lo, hi, 0.5);
    view->frame.scale = ldexp(1, exponent < -900 ? 900 : -exponent);
    view->pad = PAD + (float)fmin(1, PART_ROUNDING * off * view->frame.scale);
    view->nested = build->view.nested + 1;
    return true;
}

static void load_item(const struct build *build, uint32_t id, struct item *item) {
    const struct frame *frame = &build->view.frame;
    struct corners t = corners_of(build->bvh, build->mesh, id);
    *item = (struct item){.box = EMPTY, .id = id};
    box_add_corners(&item->box, &(struct corners){to_frame(frame, t.a), to_frame(frame, t.b), to_frame(frame, t.c)});
}

static struct link build_run(struct build *build, const struct run *whole, int depth);

/* Makes a part of a run. */
static struct link build_part(struct build *build, const struct run *whole, const struct view *view) {
    struct view outer = build->view;
    struct run run = *whole;
    uint32_t self = build->part_count++;
    build->view = *view;
    for (uint32_t i = run.begin; i < run.end; i++) load_item(build, build->item[i].id, &build->item[i]);
    measure_run(build, &run);
    struct link root = build_run(build, &run, 0);
    build->part[self] = (struct part){view->frame, root, {run.begin, run.end - run.begin}};
    build->view = outer;
    return (struct link){self, NESTED};
}

/* Makes the subtree over a run, or puts it off. */
static struct link build_run(struct build *build, const struct run *whole, int depth) {
    uint32_t n = whole->end - whole->begin, self = build->node_count;
    struct view view;
    if (n <= LEAF) return (struct link){whole->begin, n};
    if (is_part(build, whole) && frame_run(build, whole, &view)) return build_part(build, whole, &view);
    if (build->task_count < build->most_tasks && n <= TASK) {
        build->task[build->task_count++] = (struct task){*whole, depth, self, build->part_count, build->view};
        build->node_count += most_nodes(n);
        build->part_count += most_parts(n);
        return (struct link){self, 0};
    }
    build->node_count++;
    struct run runs[WIDTH] = {*whole};
    int count = 1;
    for (int i; count < WIDTH && (i = run_to_split(runs, count)) >= 0; count++)
        split(build, depth >= DEEP, &runs[i], &runs[count]);
    for (int i = 0; i < WIDTH; i++) {
        if (i < count)
            set_lane(&build->node[self], i, &runs[i].box, build->view.pad, build_run(build, &runs[i], depth + 1));
        else
            set_lane(&build->node[self], i, &EMPTY, PAD, (struct link){0, 0});
    }
    return (struct link){self, 0};
}

static void build_tasks(void *ctx, size_t begin, size_t end) {
    const struct build *whole = ctx;
    for (size_t i = begin; i < end; i++) {
        const struct task *task = &whole->task[i];
        struct build build = {.item = whole->item,
                              .node = whole->node,
                              .part = whole->part,
                              .node_count = task->first,
                              .part_count = task->first_part,
                              .bvh = whole->bvh,
                              .mesh = whole->mesh,
                              .view = task->view};
        build_run(&build, &task->run, task->depth);
    }
}

/* Where most triangles are, if some lie so far off that the middle of all would take digits from the others. */
static bool centre_of_most(const struct mesh *mesh, double extent, vec3 *centre) {
    vec3 sample[MOST_SAMPLES], least, most;
    size_t taken = mesh->triangle_count < MOST_SAMPLES ? mesh->triangle_count : MOST_SAMPLES;
    for (size_t i = 0; i < taken; i++) sample[i] = mesh->vertex[mesh->triangle[i * mesh->triangle_count / taken][0]];
    if (!most_of(sample, taken, &least, &most)) return false;
    vec3 side = vec3_sub(most, least);
    *centre = vec3_lerp(least, most, 0.5);
    return fmax(side.x, fmax(side.y, side.z)) < extent / MOST_SPOILT;
}

/* Where to move and how to scale so that the triangles lie in [-1/2, 1/2], or where most are far off the middle in
 * [-1, 1]. */
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
    if (mesh->triangle_count && !centre_of_most(mesh, extent, &bvh->centre))
        bvh->centre = vec3_add(vec3_scale(lo, 0.5), vec3_scale(hi, 0.5));
}

static bool allocate(struct bvh *bvh, size_t n, size_t nodes, size_t parts) {
    bvh->triangle_count = n;
    bvh->corners = alloc_array(n, sizeof *bvh->corners);
    bvh->id = alloc_array(n, sizeof *bvh->id);
    bvh->slot = alloc_array(n, sizeof *bvh->slot);
    bvh->node = alloc_array(nodes, sizeof *bvh->node);
    bvh->part = alloc_array(parts, sizeof *bvh->part);
    bvh->whole.frame.scale = 1;
    bvh->whole.all = (struct link){0, (uint32_t)n};
    return bvh->corners && bvh->id && bvh->slot && bvh->node && bvh->part;
}

static void load_items(void *ctx, size_t begin, size_t end) {
    const struct build *build = ctx;
    for (size_t t = begin; t < end; t++) load_item(build, (uint32_t)t, &build->item[t]);
}

struct storing {
    struct bvh *bvh;
    const struct mesh *mesh;
    const struct item *item;
};

static void store_items(void *ctx, size_t begin, size_t end) {
    const struct storing *storing = ctx;
    struct bvh *bvh = storing->bvh;
    for (size_t i = begin; i < end; i++) {
        uint32_t id = bvh->id[i] = storing->item[i].id;
        bvh->slot[id] = (uint32_t)i;
        bvh->corners[i] = corners_of(bvh, storing->mesh, id);
    }
}

static void build_nodes(struct bvh *bvh, const struct mesh *mesh, unsigned threads, struct build *build) {
    struct run whole = {.begin = 0, .end = (uint32_t)bvh->triangle_count};
    struct storing storing = {bvh, mesh, build->item};
    build->bvh = bvh, build->mesh = mesh;
    build->node = bvh->node, build->part = bvh->part;
    build->view = (struct view){bvh->whole.frame, PAD, 0};
    par_for(threads, whole.end, ITEM_GRAIN, load_items, build);
    measure_run(build, &whole);
    bvh->whole.root = build_run(build, &whole, 0);
    par_for(threads, build->task_count, 1, build_tasks, build);
    par_for(threads, whole.end, ITEM_GRAIN, store_items, &storing);
    assert(build->node_count <= most_nodes(whole.end) && build->part_count <= most_parts(whole.end));
}

enum status bvh_new(const struct mesh *mesh, unsigned threads, struct bvh **out) {
    assert(mesh->triangle_count < NONE);
    enum status status = STATUS_NO_MEMORY;
    struct build build = {.most_tasks = (uint32_t)(mesh->triangle_count / (TASK / WIDTH))};
    build.item = alloc_array(mesh->triangle_count, sizeof *build.item);
    build.task = alloc_array(build.most_tasks, sizeof *build.task);
    struct bvh *bvh = alloc_zeroed(1, sizeof *bvh);
    size_t n = mesh->triangle_count;
    if (!build.item || !build.task || !bvh || !allocate(bvh, n, most_nodes((uint32_t)n), most_parts((uint32_t)n)))
        goto out;
    choose_frame(bvh, mesh);
    build_nodes(bvh, mesh, threads, &build);
    *out = bvh;
    bvh = NULL;
    status = STATUS_OK;
out:
    bvh_free(bvh);
    free(build.item), free(build.task);
    return status;
}

/* A leaf or a node with all that is under it. */
struct brick {
    struct box box;
    struct link link;
};

struct stacking {
    struct bvh *bvh;
    const struct mesh *mesh;
    const struct brick *below; /* n; the bricks of a level are made of those below */
    size_t n;
    struct brick *brick;
    uint32_t first_node;
};

static void make_leaves(void *ctx, size_t begin, size_t end) {
    const struct stacking *stacking = ctx;
    struct bvh *bvh = stacking->bvh;
    for (size_t i = begin; i < end; i++) {
        uint32_t first = (uint32_t)(ROUGH_LEAF * i), left = (uint32_t)bvh->triangle_count - first;
        struct brick brick = {EMPTY, {first, left < ROUGH_LEAF ? left : ROUGH_LEAF}};
        for (uint32_t t = first; t < first + brick.link.count; t++) {
            bvh->corners[t] = corners_of(bvh, stacking->mesh, t);
            bvh->id[t] = bvh->slot[t] = t;
            box_add_corners(&brick.box, &bvh->corners[t]);
        }
        stacking->brick[i] = brick;
    }
}

static void make_level(void *ctx, size_t begin, size_t end) {
    const struct stacking *stacking = ctx;
    const struct brick nothing = {EMPTY, {0, 0}};
    for (size_t i = begin; i < end; i++) {
        uint32_t self = stacking->first_node + (uint32_t)i;
        struct brick brick = {EMPTY, {self, 0}};
        for (int lane = 0; lane < WIDTH; lane++) {
            size_t child = WIDTH * i + (size_t)lane;
            const struct brick *below = child < stacking->n ? &stacking->below[child] : &nothing;
            set_lane(&stacking->bvh->node[self], lane, &below->box, PAD, below->link);
            box_add_box(&brick.box, &below->box);
        }
        stacking->brick[i] = brick;
    }
}

/* n leaves; brick: room for those of all levels, which follow each other. */
static void stack_up(struct bvh *bvh, const struct mesh *mesh, size_t n, unsigned threads, struct brick *brick) {
    struct stacking level = {.bvh = bvh, .mesh = mesh, .brick = brick};
    par_for(threads, n, GRAIN, make_leaves, &level);
    while (n > 1) {
        level.below = level.brick, level.n = n;
        level.brick += n, n = (n + WIDTH - 1) / WIDTH;
        par_for(threads, n, GRAIN, make_level, &level);
        level.first_node += (uint32_t)n;
    }
    if (n) bvh->whole.root = level.brick->link;
}

enum status bvh_new_rough(const struct mesh *mesh, unsigned threads, struct bvh **out) {
    assert(mesh->triangle_count < NONE);
    size_t leaves = (mesh->triangle_count + ROUGH_LEAF - 1) / ROUGH_LEAF; /* there are fewer nodes */
    struct brick *brick = alloc_array(2 * leaves, sizeof *brick);
    struct bvh *bvh = alloc_zeroed(1, sizeof *bvh);
    bool enough = brick && bvh && allocate(bvh, mesh->triangle_count, leaves, 0);
    if (enough) {
        choose_frame(bvh, mesh);
        stack_up(bvh, mesh, leaves, threads, brick);
        *out = bvh;
    } else {
        bvh_free(bvh);
    }
    free(brick);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}

void bvh_free(struct bvh *bvh) {
    if (!bvh) return;
    free(bvh->corners);
    free(bvh->id);
    free(bvh->slot);
    free(bvh->node);
    free(bvh->part);
    free(bvh);
}

/* ------------------------------------------------------------------------------------------------- searching */

/* The best so far, in the hierarchy's own frame. */
struct search {
    const struct bvh *bvh;
    vec3 p, point;
    double distance_sq;
    uint32_t triangle;
    size_t visits; /* of nodes and leaves */
    double nearly; /* what is nearer than by this factor of the squared distance is looked for; 1 = the nearest */
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

/* Lower bounds of the squared distances to the four boxes of a node. */
static inline f32x4 measure_boxes(const struct node *node, const float p[3]) {
    f32x4 sum = {0};
    for (int i = 0; i < 3; i++) {
        f32x4 outside = f32x4_positive(node->lo[i] - p[i]) + f32x4_positive(p[i] - node->hi[i]);
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
    f32x4 bound = measure_boxes(node, p);
    struct todo *bottom = top;
    for (int lane = 0; lane < WIDTH; lane++) {
        if (!((double)bound[lane] <= limit) || bound[lane] > FLT_MAX) continue;
        struct todo *place = top++;
        for (; place > bottom && place[-1].bound < bound[lane]; place--) *place = place[-1];
        *place = (struct todo){node->link[lane], bound[lane]};
    }
    return top;
}

static bool exceeds(vec3 p, double limit) { return !(fabs(p.x) < limit && fabs(p.y) < limit && fabs(p.z) < limit); }

static void descend(struct search *s, const struct part *part) {
    vec3 q = to_frame(&part->frame, s->p);
    double per_sq = part->frame.scale * part->frame.scale * s->nearly;
    const float p[3] = {(float)q.x, (float)q.y, (float)q.z};
    struct todo stack[STACK], *top = stack;
    if (exceeds(q, FAR)) {
        s->visits += part->all.count;
        try_slots(s, part->all);
        return;
    }
    *top++ = (struct todo){part->root, 0};
    while (top > stack) {
        struct todo next = *--top;
        if ((double)next.bound > s->distance_sq * per_sq) continue;
        s->visits++;
        if (next.link.count == 0)
            top = push_children(top, &s->bvh->node[next.link.first], p, s->distance_sq * per_sq);
        else if (next.link.count == NESTED)
            descend(s, &s->bvh->part[next.link.first]);
        else
            try_slots(s, next.link);
    }
}

static struct search search_from(const struct bvh *bvh, vec3 p) {
    vec3 inside = to_inside(bvh, p);
    double nearly = exceeds(inside, AWAY) ? NEARLY : 1;
    return (struct search){.bvh = bvh, .p = inside, .distance_sq = INFINITY, .triangle = NONE, .nearly = nearly};
}

struct bvh_hit bvh_closest_within(const struct bvh *bvh, vec3 p, uint32_t hint, double bound_sq) {
    struct bvh_hit hit = {.distance_sq = INFINITY, .triangle = NONE};
    if (bvh->triangle_count == 0) return hit;
    struct search s = search_from(bvh, p);
    s.distance_sq = bound_sq * bvh->scale * bvh->scale;
    if (hint != NONE && s.nearly == 1) try_slot(&s, bvh->slot[hint]);
    descend(&s, &bvh->whole);
    if (s.triangle == NONE) return hit;
    hit.distance_sq = s.distance_sq * bvh->unscale * bvh->unscale;
    hit.point = vec3_add(bvh->centre, vec3_scale(s.point, bvh->unscale));
    hit.triangle = s.triangle;
    return hit;
}

size_t bvh_visits(const struct bvh *bvh, const vec3 *p, size_t n, size_t most) {
    size_t visits = 0;
    for (size_t i = 0; i < n && visits <= most; i++) {
        struct search s = search_from(bvh, p[i]);
        if (bvh->triangle_count) descend(&s, &bvh->whole);
        visits += s.visits;
    }
    return visits;
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
