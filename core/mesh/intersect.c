/* Boxes of triangles in a hierarchy; each triangle is held against those whose boxes meet its own, with exact signs.
 *
 * Two triangles without a common corner meet where an edge of one meets the other.  Where they share a corner, the edge
 * across from it does, of one of them at least; where they share an edge, one lies on the other.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/intersect.h"

#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/math/predicates.h"

enum { LEAF = 4, GRAIN = 256, STACK = 512 /* at the worst split of all nodes, 2^32 triangles are 340 deep */ };

struct box {
    float low[3], high[3];
};

/* A node holds triangle[begin .. begin + count); where that is more than a leaf's, its children are the next node and
 * `right`. */
struct node {
    struct box box;
    uint32_t begin, count, right;
};

struct search {
    const struct mesh *mesh;
    struct box *box;    /* of each triangle */
    uint32_t *triangle; /* in the order of the leaves */
    struct node *node;
    size_t nodes;
    atomic_size_t pairs;
};

/* ------------------------------------------------------------------------------------------------ two triangles */

/* Whether the two ends of a segment aren't both on the same side. */
static bool differ(int a, int b) { return a * b <= 0; }

/* A projection along which the triangle has area; false where it has none. */
static bool find_axis(const vec3 t[3], int *axis, int *turn) {
    for (*axis = 0; *axis < 3; ++*axis)
        if ((*turn = predicate_turn(t[0], t[1], t[2], *axis)) != 0) return true;
    return false;
}

/* Whether p, in the plane of t, is within it. */
static bool is_within(const vec3 t[3], vec3 p, int axis, int turn) {
    for (int k = 0; k < 3; k++)
        if (predicate_turn(t[k], t[(k + 1) % 3], p, axis) * turn < 0) return false;
    return true;
}

static bool cross_in_plane(vec3 a, vec3 b, vec3 c, vec3 d, int axis) {
    int c_side = predicate_turn(a, b, c, axis), d_side = predicate_turn(a, b, d, axis);
    int a_side = predicate_turn(c, d, a, axis), b_side = predicate_turn(c, d, b, axis);
    bool lined_up = c_side == 0 && d_side == 0;
    return !lined_up && differ(c_side, d_side) && differ(a_side, b_side);
}

/* Whether a segment in the plane of t meets it.  One on the line of an edge meets that edge where an end of either is
 * within the other, which the ends within t and the crossings of the other two edges tell. */
static bool meets_in_plane(const vec3 t[3], vec3 p, vec3 q, int axis, int turn) {
    if (is_within(t, p, axis, turn) || is_within(t, q, axis, turn)) return true;
    for (int k = 0; k < 3; k++)
        if (cross_in_plane(p, q, t[k], t[(k + 1) % 3], axis)) return true;
    return false;
}

/* Whether the segment pq, whose ends are on these sides of t's plane, meets t. */
static bool meets(const vec3 t[3], vec3 p, vec3 q, int p_side, int q_side) {
    int axis, turn;
    if (!differ(p_side, q_side)) return false;
    if (p_side == 0 && q_side == 0) return find_axis(t, &axis, &turn) && meets_in_plane(t, p, q, axis, turn);
    int side[3];
    for (int k = 0; k < 3; k++) side[k] = predicate_side(p, q, t[k], t[(k + 1) % 3]);
    bool left = side[0] >= 0 && side[1] >= 0 && side[2] >= 0;
    return left || (side[0] <= 0 && side[1] <= 0 && side[2] <= 0);
}

/* The triangle's corners, from number k on. */
static void turned(const vec3 from[3], int k, vec3 to[3]) {
    for (int i = 0; i < 3; i++) to[i] = from[(k + i) % 3];
}

/* They share a[0] = b[0] alone. */
static bool meet_beside_corner(const vec3 a[3], const vec3 b[3]) {
    int of_b[2] = {predicate_side(a[0], a[1], a[2], b[1]), predicate_side(a[0], a[1], a[2], b[2])};
    if (!differ(of_b[0], of_b[1])) return false;
    int of_a[2] = {predicate_side(b[0], b[1], b[2], a[1]), predicate_side(b[0], b[1], b[2], a[2])};
    return meets(a, b[1], b[2], of_b[0], of_b[1]) || meets(b, a[1], a[2], of_a[0], of_a[1]);
}

/* They share the edge a[0] a[1], and c is the other's third corner. */
static bool meet_beside_edge(const vec3 a[3], vec3 c) {
    int axis, turn;
    if (predicate_side(a[0], a[1], a[2], c) != 0 || !find_axis(a, &axis, &turn)) return false;
    return predicate_turn(a[0], a[1], c, axis) == turn;
}

static bool meet_apart(const vec3 a[3], const vec3 b[3]) {
    int of_b[3], of_a[3];
    for (int k = 0; k < 3; k++) of_b[k] = predicate_side(a[0], a[1], a[2], b[k]);
    if (of_b[0] == of_b[1] && of_b[1] == of_b[2] && of_b[0] != 0) return false;
    for (int k = 0; k < 3; k++) of_a[k] = predicate_side(b[0], b[1], b[2], a[k]);
    if (of_a[0] == of_a[1] && of_a[1] == of_a[2] && of_a[0] != 0) return false;
    for (int k = 0; k < 3; k++)
        if (meets(a, b[k], b[(k + 1) % 3], of_b[k], of_b[(k + 1) % 3]) ||
            meets(b, a[k], a[(k + 1) % 3], of_a[k], of_a[(k + 1) % 3]))
            return true;
    return false;
}

static void corners_of(const struct mesh *mesh, uint32_t triangle, vec3 corner[3]) {
    for (int k = 0; k < 3; k++) corner[k] = mesh->vertex[mesh->triangle[triangle][k]];
}

static bool has_area(const vec3 t[3]) {
    int axis, turn;
    return find_axis(t, &axis, &turn);
}

static bool intersect(const struct mesh *mesh, uint32_t first, uint32_t second) {
    vec3 a[3], b[3], from_a[3], from_b[3];
    int shared = 0, at_a = 0, at_b = 0, other_a = 0, other_b = 0;
    corners_of(mesh, first, a), corners_of(mesh, second, b);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            if (!vec3_equal(a[i], b[j])) continue;
            if (shared++ == 0)
                at_a = i, at_b = j;
            else
                other_a = i, other_b = j;
        }
    if (shared == 0) return meet_apart(a, b) && has_area(a) && has_area(b);
    if (shared == 1) {
        turned(a, at_a, from_a), turned(b, at_b, from_b);
        return meet_beside_corner(from_a, from_b) && has_area(a) && has_area(b);
    }
    if (shared > 3 || at_a == other_a || at_b == other_b) return false;
    if (shared == 3) return has_area(a) && has_area(b);
    vec3 edged[3] = {a[at_a], a[other_a], a[3 - at_a - other_a]};
    return meet_beside_edge(edged, b[3 - at_b - other_b]) && has_area(b);
}

/* ------------------------------------------------------------------------------------------------ the hierarchy */

static double coordinate(vec3 p, int axis) { return axis == 0 ? p.x : axis == 1 ? p.y : p.z; }

/* Rounded outwards. */
static void box_add(struct box *box, vec3 p) {
    for (int k = 0; k < 3; k++) {
        double x = coordinate(p, k);
        box->low[k] = fminf(box->low[k], nextafterf((float)x, -INFINITY));
        box->high[k] = fmaxf(box->high[k], nextafterf((float)x, INFINITY));
    }
}

static const struct box EMPTY = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

static void box_range(void *ctx, size_t begin, size_t end) {
    const struct search *search = ctx;
    for (size_t t = begin; t < end; t++) {
        vec3 corner[3];
        corners_of(search->mesh, (uint32_t)t, corner);
        search->box[t] = EMPTY;
        for (int k = 0; k < 3; k++) box_add(&search->box[t], corner[k]);
    }
}

static bool boxes_meet(const struct box *a, const struct box *b) {
    bool apart = false;
    for (int k = 0; k < 3; k++) apart |= a->high[k] < b->low[k] || b->high[k] < a->low[k];
    return !apart;
}

static float middle(const struct search *search, uint32_t triangle, int axis) {
    const struct box *box = &search->box[triangle];
    return box->low[axis] / 2 + box->high[axis] / 2;
}

static void swap(uint32_t *a, uint32_t *b) {
    uint32_t before = *a;
    *a = *b, *b = before;
}

/* Moves triangles of which the middle is under `at` to the front; their number. */
static uint32_t part(const struct search *search, uint32_t *triangle, uint32_t n, int axis, float at) {
    uint32_t front = 0;
    for (uint32_t i = 0; i < n; i++)
        if (middle(search, triangle[i], axis) < at) swap(&triangle[i], &triangle[front++]);
    return front;
}

/* Halves the box of the middles along its longest side, or where all are at one place, the list. */
static uint32_t halve(const struct search *search, uint32_t *triangle, uint32_t n) {
    struct box box = EMPTY;
    for (uint32_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) {
            float at = middle(search, triangle[i], k);
            box.low[k] = fminf(box.low[k], at), box.high[k] = fmaxf(box.high[k], at);
        }
    int axis = 0;
    for (int k = 1; k < 3; k++)
        if (box.high[k] - box.low[k] > box.high[axis] - box.low[axis]) axis = k;
    uint32_t front = part(search, triangle, n, axis, box.low[axis] / 2 + box.high[axis] / 2);
    return front > n / 16 && front < n - n / 16 ? front : n / 2;
}

static void build(struct search *search, uint32_t begin, uint32_t count) {
    struct node *node = &search->node[search->nodes++];
    *node = (struct node){EMPTY, begin, count, 0};
    for (uint32_t i = begin; i < begin + count; i++) {
        const struct box *box = &search->box[search->triangle[i]];
        for (int k = 0; k < 3; k++) {
            node->box.low[k] = fminf(node->box.low[k], box->low[k]);
            node->box.high[k] = fmaxf(node->box.high[k], box->high[k]);
        }
    }
    if (count <= LEAF) return;
    uint32_t front = halve(search, &search->triangle[begin], count);
    build(search, begin, front);
    node->right = (uint32_t)search->nodes;
    build(search, begin + front, count - front);
}

/* How many triangles with higher numbers this one intersects. */
static size_t count_of(const struct search *search, uint32_t triangle) {
    uint32_t stack[STACK];
    size_t depth = 0, count = 0;
    const struct box *box = &search->box[triangle];
    stack[depth++] = 0;
    while (depth > 0) {
        uint32_t at = stack[--depth];
        const struct node *node = &search->node[at];
        if (!boxes_meet(box, &node->box)) continue;
        if (node->count > LEAF) {
            stack[depth++] = node->right, stack[depth++] = at + 1;
            continue;
        }
        for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
            uint32_t other = search->triangle[i];
            count +=
                other > triangle && boxes_meet(box, &search->box[other]) && intersect(search->mesh, triangle, other);
        }
    }
    return count;
}

static void count_range(void *ctx, size_t begin, size_t end) {
    struct search *search = ctx;
    size_t count = 0;
    for (size_t t = begin; t < end; t++) count += count_of(search, (uint32_t)t);
    atomic_fetch_add(&search->pairs, count);
}

enum status mesh_count_intersections(const struct mesh *mesh, unsigned threads, size_t *pairs) {
    size_t n = mesh->triangle_count;
    struct search search = {.mesh = mesh};
    search.box = alloc_array(n, sizeof *search.box);
    search.triangle = alloc_array(n, sizeof *search.triangle);
    search.node = alloc_array(2 * n, sizeof *search.node);
    bool ok = search.box && search.triangle && search.node;
    if (ok && n > 0) {
        par_for(threads, n, GRAIN, box_range, &search);
        for (size_t t = 0; t < n; t++) search.triangle[t] = (uint32_t)t;
        build(&search, 0, (uint32_t)n);
        par_for(threads, n, GRAIN, count_range, &search);
    }
    if (ok) *pairs = atomic_load(&search.pairs);
    free(search.box), free(search.triangle), free(search.node);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}
