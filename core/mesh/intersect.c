/* Boxes of triangles in a hierarchy; each triangle is held against those whose boxes meet its own, with exact signs.
 *
 * Two triangles without a common corner meet where an edge of one meets the other.  Where they share a corner, the edge
 * across from it does, of one of them at least; where they share an edge, one lies on the other.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/intersect.h"

#include <stdlib.h>
#include <string.h>

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

struct intersections {
    const struct mesh *mesh;
    size_t n;
    struct box *box;    /* of each triangle */
    uint32_t *triangle; /* in the order of the leaves */
    uint32_t *place;    /* of each triangle in that order */
    struct node *node;
    size_t nodes;
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
    int first = predicate_side(p, q, t[0], t[1]), second = predicate_side(p, q, t[1], t[2]);
    return first * second >= 0 && (first ? first : second) * predicate_side(p, q, t[2], t[0]) >= 0;
}

/* The triangle's corners, from number k on. */
static void turned(const vec3 from[3], int k, vec3 to[3]) {
    for (int i = 0; i < 3; i++) to[i] = from[(k + i) % 3];
}

/* Whether a projection shows b beyond one of the edges of a that begin at the corner that they share. */
static bool is_beside(const vec3 a[3], const vec3 b[3]) {
    int axis, turn;
    if (!find_axis(a, &axis, &turn)) return false;
    for (int k = 1; k < 3; k++) {
        int beyond = k == 1 ? -turn : turn;
        if (predicate_turn(a[0], a[k], b[1], axis) == beyond && predicate_turn(a[0], a[k], b[2], axis) == beyond)
            return true;
    }
    return false;
}

/* They share a[0] = b[0] alone. */
static bool meet_beside_corner(const vec3 a[3], const vec3 b[3]) {
    if (is_beside(a, b) || is_beside(b, a)) return false;
    int of_b[2] = {predicate_side(a[0], a[1], a[2], b[1]), predicate_side(a[0], a[1], a[2], b[2])};
    if (!differ(of_b[0], of_b[1])) return false;
    int of_a[2] = {predicate_side(b[0], b[1], b[2], a[1]), predicate_side(b[0], b[1], b[2], a[2])};
    return meets(a, b[1], b[2], of_b[0], of_b[1]) || meets(b, a[1], a[2], of_a[0], of_a[1]);
}

/* They share the edge a[0] a[1], and c is the other's third corner. */
static bool meet_beside_edge(const vec3 a[3], vec3 c) {
    int axis, turn;
    if (!find_axis(a, &axis, &turn) || predicate_turn(a[0], a[1], c, axis) != turn) return false;
    return predicate_side(a[0], a[1], a[2], c) == 0;
}

/* Whether all of b, in the plane of a, is beyond one of a's edges. */
static bool is_beyond_edge(const vec3 a[3], const vec3 b[3], int axis) {
    int turn = predicate_turn(a[0], a[1], a[2], axis);
    for (int k = 0; k < 3; k++) {
        int beyond = 0;
        while (beyond < 3 && predicate_turn(a[k], a[(k + 1) % 3], b[beyond], axis) == -turn) beyond++;
        if (beyond == 3) return true;
    }
    return false;
}

/* Of two triangles in one plane: they are apart where an edge of one has the other beyond it. */
static bool meet_in_plane(const vec3 a[3], const vec3 b[3]) {
    int axis, turn;
    if (!find_axis(a, &axis, &turn) || predicate_turn(b[0], b[1], b[2], axis) == 0) return false;
    return !is_beyond_edge(a, b, axis) && !is_beyond_edge(b, a, axis);
}

static bool meet_apart(const vec3 a[3], const vec3 b[3]) {
    int of_b[3], of_a[3];
    for (int k = 0; k < 3; k++) of_b[k] = predicate_side(a[0], a[1], a[2], b[k]);
    if (of_b[0] == of_b[1] && of_b[1] == of_b[2]) return of_b[0] == 0 && meet_in_plane(a, b);
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

/* Which corners may be at the same place: bit 3 i + j tells of a[i] and b[j].  All at once, since most are nowhere
 * near. */
static unsigned find_level(const vec3 a[3], const vec3 b[3]) {
    unsigned level = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) level |= (unsigned)(a[i].x == b[j].x) << (3 * i + j);
    return level;
}

bool triangles_intersect(const vec3 a[3], const vec3 b[3]) {
    vec3 from_a[3], from_b[3];
    int shared = 0, at_a = 0, at_b = 0, other_a = 0, other_b = 0;
    for (unsigned level = find_level(a, b); level; level &= level - 1) {
        int bit = __builtin_ctz(level), i = bit / 3, j = bit % 3;
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

static const struct box EMPTY = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

/* Rounded outwards. */
static struct box box_of(const vec3 corner[3]) {
    struct box box;
    for (int k = 0; k < 3; k++) {
        double a = coordinate(corner[0], k), b = coordinate(corner[1], k), c = coordinate(corner[2], k);
        double low = a < b ? a : b, high = a < b ? b : a;
        low = c < low ? c : low, high = c > high ? c : high;
        box.low[k] = (float)low, box.high[k] = (float)high;
        if ((double)box.low[k] > low) box.low[k] = nextafterf(box.low[k], -INFINITY);
        if ((double)box.high[k] < high) box.high[k] = nextafterf(box.high[k], INFINITY);
    }
    return box;
}

/* Comparisons, because calls of fminf and fmaxf take longer than all the rest of a search. */
static void box_join(struct box *box, const struct box *with) {
    for (int k = 0; k < 3; k++) {
        box->low[k] = with->low[k] < box->low[k] ? with->low[k] : box->low[k];
        box->high[k] = with->high[k] > box->high[k] ? with->high[k] : box->high[k];
    }
}

static void box_range(void *ctx, size_t begin, size_t end) {
    const struct intersections *found = ctx;
    for (size_t t = begin; t < end; t++) {
        vec3 corner[3];
        corners_of(found->mesh, (uint32_t)t, corner);
        found->box[t] = box_of(corner);
    }
}

static bool boxes_meet(const struct box *a, const struct box *b) {
    bool apart = false;
    for (int k = 0; k < 3; k++) apart |= a->high[k] < b->low[k] || b->high[k] < a->low[k];
    return !apart;
}

static float middle(const struct intersections *found, uint32_t triangle, int axis) {
    const struct box *box = &found->box[triangle];
    return box->low[axis] / 2 + box->high[axis] / 2;
}

static void swap(uint32_t *a, uint32_t *b) {
    uint32_t before = *a;
    *a = *b, *b = before;
}

/* Moves triangles of which the middle is under `at` to the front; their number. */
static uint32_t part(const struct intersections *found, uint32_t *triangle, uint32_t n, int axis, float at) {
    uint32_t front = 0;
    for (uint32_t i = 0; i < n; i++)
        if (middle(found, triangle[i], axis) < at) swap(&triangle[i], &triangle[front++]);
    return front;
}

/* Halves the box of the middles along its longest side, or where all are at one place, the list. */
static uint32_t halve(const struct intersections *found, uint32_t *triangle, uint32_t n) {
    struct box box = EMPTY;
    for (uint32_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) {
            float at = middle(found, triangle[i], k);
            box.low[k] = at < box.low[k] ? at : box.low[k], box.high[k] = at > box.high[k] ? at : box.high[k];
        }
    int axis = 0;
    for (int k = 1; k < 3; k++)
        if (box.high[k] - box.low[k] > box.high[axis] - box.low[axis]) axis = k;
    uint32_t front = part(found, triangle, n, axis, box.low[axis] / 2 + box.high[axis] / 2);
    return front > n / 16 && front < n - n / 16 ? front : n / 2;
}

static void build(struct intersections *found, uint32_t begin, uint32_t count) {
    struct node *node = &found->node[found->nodes++];
    *node = (struct node){EMPTY, begin, count, 0};
    for (uint32_t i = begin; i < begin + count; i++) box_join(&node->box, &found->box[found->triangle[i]]);
    if (count <= LEAF) return;
    uint32_t front = halve(found, &found->triangle[begin], count);
    build(found, begin, front);
    node->right = (uint32_t)found->nodes;
    build(found, begin + front, count - front);
}

enum status intersections_new(const struct mesh *mesh, unsigned threads, struct intersections **found) {
    size_t n = mesh->triangle_count;
    struct intersections *new = alloc_zeroed(1, sizeof *new);
    if (!new) return STATUS_NO_MEMORY;
    new->mesh = mesh, new->n = n;
    new->box = alloc_array(n, sizeof *new->box);
    new->triangle = alloc_array(n, sizeof *new->triangle);
    new->place = alloc_array(n, sizeof *new->place);
    new->node = alloc_array(2 * n, sizeof *new->node);
    if (!new->box || !new->triangle || !new->place || !new->node) {
        intersections_free(new);
        return STATUS_NO_MEMORY;
    }
    par_for(threads, n, GRAIN, box_range, new);
    for (size_t t = 0; t < n; t++) new->triangle[t] = (uint32_t)t;
    if (n > 0) build(new, 0, (uint32_t)n);
    for (size_t i = 0; i < n; i++) new->place[new->triangle[i]] = (uint32_t)i;
    *found = new;
    return STATUS_OK;
}

void intersections_free(struct intersections *found) {
    if (!found) return;
    free(found->box), free(found->triangle), free(found->place), free(found->node);
    free(found);
}

/* Boxes of nodes only grow. */
void intersections_update(struct intersections *found, uint32_t triangle) {
    vec3 corner[3];
    corners_of(found->mesh, triangle, corner);
    struct box box = found->box[triangle] = box_of(corner);
    for (uint32_t at = 0;;) {
        struct node *node = &found->node[at];
        box_join(&node->box, &box);
        if (node->count <= LEAF) return;
        at = found->place[triangle] < found->node[node->right].begin ? at + 1 : node->right;
    }
}

/* ------------------------------------------------------------------------------------------------ the pairs */

/* Which triangles intersect one: those from place `least` on, in the order of the leaves. */
struct query {
    const vec3 *corner;
    struct box box;
    uint32_t least;
    const uint32_t *without; /* ids that aren't looked at */
    size_t without_count;
    uint32_t *other;    /* they are put here, unless it is NULL */
    size_t most, count; /* when there are more than `most`, no more are looked for */
};

static bool is_left_out(const struct query *query, uint32_t triangle) {
    for (size_t i = 0; i < query->without_count; i++)
        if (query->without[i] == triangle) return true;
    return false;
}

static void look_at_leaf(const struct intersections *found, const struct node *leaf, struct query *query) {
    uint32_t begin = leaf->begin > query->least ? leaf->begin : query->least;
    for (uint32_t i = begin; i < leaf->begin + leaf->count && query->count <= query->most; i++) {
        uint32_t t = found->triangle[i];
        vec3 corner[3];
        if (!boxes_meet(&query->box, &found->box[t]) || is_left_out(query, t)) continue;
        corners_of(found->mesh, t, corner);
        if (!triangles_intersect(query->corner, corner)) continue;
        if (query->other) query->other[query->count] = t;
        query->count++;
    }
}

static void look(const struct intersections *found, struct query *query) {
    uint32_t stack[STACK];
    size_t depth = 0;
    if (found->n > 0) stack[depth++] = 0;
    while (depth > 0 && query->count <= query->most) {
        uint32_t at = stack[--depth];
        const struct node *node = &found->node[at];
        if (node->begin + node->count <= query->least || !boxes_meet(&query->box, &node->box)) continue;
        if (node->count > LEAF)
            stack[depth++] = node->right, stack[depth++] = at + 1;
        else
            look_at_leaf(found, node, query);
    }
}

size_t intersections_of(const struct intersections *found, const vec3 corner[3], const uint32_t *without, size_t n,
                        uint32_t *other, size_t most) {
    struct query query = {corner, box_of(corner), 0, without, n, other, most, 0};
    look(found, &query);
    return query.count;
}

size_t intersections_among(const struct intersections *found, const vec3 corner[3], const uint32_t *triangle,
                           size_t n) {
    struct box box = box_of(corner);
    size_t count = 0;
    for (size_t i = 0; i < n; i++) {
        vec3 other[3];
        if (!boxes_meet(&box, &found->box[triangle[i]])) continue;
        corners_of(found->mesh, triangle[i], other);
        count += triangles_intersect(corner, other);
    }
    return count;
}

/* What the triangle at a place intersects of those at later ones. */
static size_t look_beyond(const struct intersections *found, size_t place, uint32_t *other, size_t most) {
    uint32_t t = found->triangle[place];
    vec3 corner[3];
    corners_of(found->mesh, t, corner);
    struct query query = {corner, found->box[t], (uint32_t)place + 1, NULL, 0, other, most, 0};
    look(found, &query);
    return query.count;
}

struct counts {
    const struct intersections *found;
    uint32_t *of; /* of each place: how many at later ones intersect what is there */
};

static void count_range(void *ctx, size_t begin, size_t end) {
    const struct counts *counts = ctx;
    for (size_t i = begin; i < end; i++) counts->of[i] = (uint32_t)look_beyond(counts->found, i, NULL, SIZE_MAX);
}

/* Returns new, of each place. */
static uint32_t *count_all(const struct intersections *found, unsigned threads) {
    struct counts counts = {found, alloc_array(found->n, sizeof *counts.of)};
    if (counts.of) par_for(threads, found->n, GRAIN, count_range, &counts);
    return counts.of;
}

static int compare_pairs(const void *a, const void *b) {
    const uint32_t *x = a, *y = b;
    int first = (x[0] > y[0]) - (x[0] < y[0]);
    return first ? first : (x[1] > y[1]) - (x[1] < y[1]);
}

/* The pairs of the triangle at a place with the `count` at later ones. */
static bool list_of(const struct intersections *found, size_t place, uint32_t count, uint32_t (*pair)[2]) {
    uint32_t *other = alloc_array(count, sizeof *other), t = found->triangle[place];
    if (!other) return false;
    look_beyond(found, place, other, count);
    for (uint32_t i = 0; i < count; i++) {
        pair[i][0] = t < other[i] ? t : other[i];
        pair[i][1] = t < other[i] ? other[i] : t;
    }
    free(other);
    return true;
}

enum status intersections_list(const struct intersections *found, unsigned threads, uint32_t (**pair)[2],
                               size_t *count) {
    uint32_t *of = count_all(found, threads);
    size_t all = 0;
    if (!of) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < found->n; i++) all += of[i];
    uint32_t(*list)[2] = alloc_array(all, sizeof *list);
    bool ok = list != NULL;
    for (size_t i = 0, at = 0; ok && i < found->n; at += of[i], i++)
        if (of[i]) ok = list_of(found, i, of[i], &list[at]);
    free(of);
    if (!ok) {
        free(list);
        return STATUS_NO_MEMORY;
    }
    qsort(list, all, sizeof *list, compare_pairs);
    *pair = list, *count = all;
    return STATUS_OK;
}

/* Adds the pairs of a triangle that was touched: with one that was, too, each is added once, by the lower id. */
static enum status add_pairs_of(const struct intersections *found, uint32_t t, const uint8_t *touched,
                                uint32_t (**pair)[2], size_t *count) {
    vec3 corner[3];
    corners_of(found->mesh, t, corner);
    size_t n = intersections_of(found, corner, &t, 1, NULL, SIZE_MAX);
    if (n == 0) return STATUS_OK;
    uint32_t *other = alloc_array(n, sizeof *other);
    uint32_t(*list)[2] = other ? alloc_resize(*pair, *count + n, sizeof *list) : NULL;
    if (list) {
        *pair = list;
        intersections_of(found, corner, &t, 1, other, n);
        for (size_t i = 0; i < n; i++) {
            if (touched[other[i]] && other[i] < t) continue;
            list[*count][0] = t < other[i] ? t : other[i];
            list[(*count)++][1] = t < other[i] ? other[i] : t;
        }
    }
    free(other);
    return list ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status intersections_list_again(const struct intersections *found, const uint8_t *touched, uint32_t (**pair)[2],
                                     size_t *count) {
    enum status status = STATUS_OK;
    size_t kept = 0;
    for (size_t i = 0; i < *count; i++)
        if (!touched[(*pair)[i][0]] && !touched[(*pair)[i][1]]) memmove((*pair)[kept++], (*pair)[i], sizeof **pair);
    *count = kept;
    for (size_t t = 0; t < found->n && !status; t++)
        if (touched[t]) status = add_pairs_of(found, (uint32_t)t, touched, pair, count);
    if (*count) qsort(*pair, *count, sizeof **pair, compare_pairs);
    return status;
}

enum status mesh_count_intersections(const struct mesh *mesh, unsigned threads, size_t *pairs) {
    struct intersections *found = NULL;
    enum status status = intersections_new(mesh, threads, &found);
    if (status) return status;
    uint32_t *of = count_all(found, threads);
    size_t all = 0;
    for (size_t i = 0; of && i < mesh->triangle_count; i++) all += of[i];
    if (of) *pairs = all;
    intersections_free(found);
    free(of);
    return of ? STATUS_OK : STATUS_NO_MEMORY;
}
