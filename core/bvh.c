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
 * Splits are by the surface area heuristic over binned centres.  Meshes that defeat it (all centres equal, sizes
 * that shrink exponentially) are halved after DEEP levels, which bounds the stack.
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

enum { WIDTH = 4, LEAF = 3, BINS = 16, DEEP = 40, STACK = WIDTH * (DEEP + 40), GRAIN = 512 };

#define PAD 0x1p-20
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

struct box {
    double lo[3], hi[3];
};

/* A triangle, as far as building goes. */
struct item {
    struct box box;
    uint32_t id;
};

struct build {
    struct item *item; /* in the order of the leaves in the making */
    struct node *node;
    uint32_t node_count;
};

static const struct box EMPTY = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

static void box_add_point(struct box *box, vec3 p) {
    const double x[3] = {p.x, p.y, p.z};
    for (int i = 0; i < 3; i++) {
        box->lo[i] = x[i] < box->lo[i] ? x[i] : box->lo[i];
        box->hi[i] = x[i] > box->hi[i] ? x[i] : box->hi[i];
    }
}

static void box_add_box(struct box *box, const struct box *other) {
    for (int i = 0; i < 3; i++) {
        box->lo[i] = other->lo[i] < box->lo[i] ? other->lo[i] : box->lo[i];
        box->hi[i] = other->hi[i] > box->hi[i] ? other->hi[i] : box->hi[i];
    }
}

/* Half of the surface; 0 when empty. */
static double box_area(const struct box *box) {
    double x = box->hi[0] - box->lo[0], y = box->hi[1] - box->lo[1], z = box->hi[2] - box->lo[2];
    return x < 0 ? 0 : x * y + y * z + z * x;
}

/* Twice the centre, along an axis. */
static double centre_of(const struct box *box, int axis) { return box->lo[axis] + box->hi[axis]; }

/* A run of triangles that becomes one child: item[begin] .. item[end - 1]. */
struct run {
    uint32_t begin, end;
    struct box box;
};

/* A way to cut a run: bins of centres below `cut` to the left. */
struct cut {
    int axis, cut;
    double low, per_length, cost;
};

static int bin_of(const struct cut *cut, const struct box *box) {
    int bin = (int)((centre_of(box, cut->axis) - cut->low) * cut->per_length);
    return bin < BINS ? bin : BINS - 1;
}

struct bin {
    struct box box;
    uint32_t count;
};

/* The best of the BINS - 1 cuts along an axis; cost INFINITY where there is none. */
static void sweep(const struct bin *bins, struct cut *cut) {
    double right_cost[BINS];
    struct bin side = {.box = EMPTY};
    for (int i = BINS - 1; i > 0; i--) {
        box_add_box(&side.box, &bins[i].box);
        side.count += bins[i].count;
        right_cost[i] = side.count ? box_area(&side.box) * side.count : INFINITY;
    }
    side = (struct bin){.box = EMPTY};
    for (int i = 1; i < BINS; i++) {
        box_add_box(&side.box, &bins[i - 1].box);
        side.count += bins[i - 1].count;
        double cost = (side.count ? box_area(&side.box) * side.count : INFINITY) + right_cost[i];
        if (cost < cut->cost) cut->cost = cost, cut->cut = i;
    }
}

static struct cut best_cut_along(const struct build *build, const struct run *run, int axis, double low, double high) {
    struct cut cut = {.axis = axis, .low = low, .per_length = BINS / (high - low), .cost = INFINITY};
    if (!(high > low) || !isfinite(cut.per_length)) return cut;
    struct bin bins[BINS];
    for (int i = 0; i < BINS; i++) bins[i] = (struct bin){.box = EMPTY};
    for (uint32_t i = run->begin; i < run->end; i++) {
        const struct box *box = &build->item[i].box;
        struct bin *bin = &bins[bin_of(&cut, box)];
        box_add_box(&bin->box, box);
        bin->count++;
    }
    sweep(bins, &cut);
    return cut;
}

static struct cut best_cut(const struct build *build, const struct run *run) {
    struct box centres = EMPTY;
    for (uint32_t i = run->begin; i < run->end; i++) {
        const struct box *box = &build->item[i].box;
        box_add_point(&centres, (vec3){centre_of(box, 0), centre_of(box, 1), centre_of(box, 2)});
    }
    struct cut best = {.cost = INFINITY};
    for (int axis = 0; axis < 3; axis++) {
        struct cut cut = best_cut_along(build, run, axis, centres.lo[axis], centres.hi[axis]);
        if (cut.cost < best.cost) best = cut;
    }
    return best;
}

/* Moves the left side of the cut to the front; returns where the right side begins. */
static uint32_t partition(struct build *build, const struct run *run, const struct cut *cut) {
    uint32_t left = run->begin;
    for (uint32_t i = run->begin; i < run->end; i++) {
        struct item item = build->item[i];
        if (bin_of(cut, &item.box) >= cut->cut) continue;
        build->item[i] = build->item[left];
        build->item[left++] = item;
    }
    return left;
}

static void measure_run(const struct build *build, struct run *run) {
    run->box = EMPTY;
    for (uint32_t i = run->begin; i < run->end; i++) box_add_box(&run->box, &build->item[i].box);
}

static void split(struct build *build, bool halve, struct run *run, struct run *right) {
    struct cut cut = {.cost = INFINITY};
    if (!halve) cut = best_cut(build, run);
    uint32_t middle = run->begin + (run->end - run->begin) / 2;
    if (cut.cost < INFINITY) middle = partition(build, run, &cut);
    *right = (struct run){.begin = middle, .end = run->end};
    run->end = middle;
    measure_run(build, run);
    measure_run(build, right);
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
        node->lo[i][lane] = (float)(box->lo[i] - PAD);
        node->hi[i][lane] = (float)(box->hi[i] + PAD);
    }
    node->link[lane] = link;
}

/* Makes the subtree over a run. */
static struct link build_run(struct build *build, const struct run *whole, int depth) {
    if (whole->end - whole->begin <= LEAF) return (struct link){whole->begin, whole->end - whole->begin};
    uint32_t self = build->node_count++;
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

static vec3 to_inside(const struct bvh *bvh, vec3 p) { return vec3_scale(vec3_sub(p, bvh->centre), bvh->scale); }

/* Where to move and how to scale so that the triangles lie in [-1/2, 1/2]. */
static void choose_frame(struct bvh *bvh, const struct mesh *mesh) {
    struct box box = EMPTY;
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int i = 0; i < 3; i++) box_add_point(&box, mesh->vertex[mesh->triangle[t][i]]);
    double extent = 0;
    for (int i = 0; i < 3; i++) extent = fmax(extent, box.hi[i] / 2 - box.lo[i] / 2);
    int exponent = 0;
    if (extent > 0) frexp(extent, &exponent);
    exponent = exponent < -900 ? -900 : exponent > 900 ? 900 : exponent;
    bvh->scale = ldexp(1, -exponent - 1);
    bvh->unscale = ldexp(1, exponent + 1);
    if (mesh->triangle_count)
        bvh->centre =
            (vec3){box.lo[0] / 2 + box.hi[0] / 2, box.lo[1] / 2 + box.hi[1] / 2, box.lo[2] / 2 + box.hi[2] / 2};
}

static struct corners corners_of(const struct bvh *bvh, const struct mesh *mesh, size_t t) {
    const uint32_t *v = mesh->triangle[t];
    return (struct corners){to_inside(bvh, mesh->vertex[v[0]]), to_inside(bvh, mesh->vertex[v[1]]),
                            to_inside(bvh, mesh->vertex[v[2]])};
}

/* There are at most (n - 1) / 3 nodes.  By induction: a node has at least LEAF + 1 triangles, so one without children
 * that are nodes keeps the bound; one with such children has WIDTH children, and (1 for itself) + the sum of
 * (n_i - 1) / 3 over some of them is at most 1 + (n - WIDTH) / 3. */
static bool allocate(struct bvh *bvh, size_t n) {
    static_assert(LEAF >= 3 && WIDTH == 4, "or there are more nodes");
    bvh->triangle_count = n;
    bvh->corners = alloc_array(n, sizeof *bvh->corners);
    bvh->id = alloc_array(n, sizeof *bvh->id);
    bvh->slot = alloc_array(n, sizeof *bvh->slot);
    bvh->node = alloc_array(n / 3, sizeof *bvh->node);
    return bvh->corners && bvh->id && bvh->slot && bvh->node;
}

static void build_tree(struct bvh *bvh, const struct mesh *mesh, struct item *item) {
    struct build build = {.item = item, .node = bvh->node};
    struct run whole = {.begin = 0, .end = (uint32_t)bvh->triangle_count};
    for (uint32_t t = 0; t < whole.end; t++) {
        struct corners corners = corners_of(bvh, mesh, t);
        item[t] = (struct item){.box = EMPTY, .id = t};
        box_add_point(&item[t].box, corners.a);
        box_add_point(&item[t].box, corners.b);
        box_add_point(&item[t].box, corners.c);
    }
    measure_run(&build, &whole);
    bvh->root = build_run(&build, &whole, 0);
    for (uint32_t i = 0; i < whole.end; i++) {
        bvh->id[i] = item[i].id;
        bvh->slot[item[i].id] = i;
        bvh->corners[i] = corners_of(bvh, mesh, item[i].id);
    }
    assert(build.node_count <= bvh->triangle_count / 3);
}

enum status bvh_new(const struct mesh *mesh, struct bvh **out) {
    assert(mesh->triangle_count < NONE);
    enum status status = STATUS_NO_MEMORY;
    struct item *item = alloc_array(mesh->triangle_count, sizeof *item);
    struct bvh *bvh = alloc_zeroed(1, sizeof *bvh);
    if (!item || !bvh || !allocate(bvh, mesh->triangle_count)) goto out;
    choose_frame(bvh, mesh);
    build_tree(bvh, mesh, item);
    *out = bvh;
    bvh = NULL;
    status = STATUS_OK;
out:
    bvh_free(bvh);
    free(item);
    return status;
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
