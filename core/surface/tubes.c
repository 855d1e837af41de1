/* The vertices two edges from a loop, on either side of it, are as far from the line through the middles of both as the
 * loop's are where it goes around a tube; where it goes around a bridge they are on the sheets:
 *
 *          | : o : |              ____: o :____
 *       ---|-:-o-:-|---     ---- o____| o |____o ---- twice and more as far
 *          | : o : |                  : o :
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/tubes.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"

enum { MOST = 128, SEEN = 1 }; /* vertices of a ring, which has 24 on a flat sheet around the longest loop */

struct ring {
    uint32_t vertex[MOST];
    uint32_t count; /* MOST: there may be more */
};

static void ring_add(struct ring *ring, uint32_t v, uint8_t *mark) {
    if (mark[v] || ring->count == MOST) return;
    mark[v] = SEEN;
    ring->vertex[ring->count++] = v;
}

static uint32_t edge_from(const struct halfedge *he, uint32_t from, uint32_t to) {
    uint32_t start = he->out[from], h = start;
    do {
        if (halfedge_to(he, h) == to) return h;
        h = halfedge_around(he, h);
    } while (h != start);
    return NONE;
}

/* Of the vertices around one of the loop's those between the edge to `first` and that to `last`, counter-clockwise. */
static bool add_between(const struct halfedge *he, uint32_t v, uint32_t first, uint32_t last, uint8_t *mark,
                        struct ring *ring) {
    uint32_t h = edge_from(he, v, first);
    if (h == NONE) return false;
    for (h = halfedge_around(he, h); halfedge_to(he, h) != last; h = halfedge_around(he, h)) {
        if (halfedge_to(he, h) == first) return false;
        ring_add(ring, halfedge_to(he, h), mark);
    }
    return true;
}

static void add_next(const struct halfedge *he, const struct ring *ring, uint8_t *mark, struct ring *next) {
    for (uint32_t i = 0; i < ring->count; i++) {
        uint32_t start = he->out[ring->vertex[i]], h = start;
        do {
            ring_add(next, halfedge_to(he, h), mark);
            h = halfedge_around(he, h);
        } while (h != start);
    }
}

static void ring_forget(const struct ring *ring, uint8_t *mark) {
    for (uint32_t i = 0; i < ring->count; i++) mark[ring->vertex[i]] = 0;
}

/* The vertices two edges from the loop, on its left or on its right; none where that isn't a ring. */
static void find_second(const struct halfedge *he, const struct loop *loop, bool left, uint8_t *mark,
                        struct ring *second) {
    struct ring first = {.count = 0};
    uint32_t n = loop->count;
    bool is_path = true;
    second->count = 0;
    for (uint32_t i = 0; i < n; i++) mark[loop->vertex[i]] = SEEN;
    for (uint32_t i = 0; i < n && is_path; i++) {
        uint32_t after = loop->vertex[(i + 1) % n], before = loop->vertex[(i + n - 1) % n];
        is_path = add_between(he, loop->vertex[i], left ? after : before, left ? before : after, mark, &first);
    }
    add_next(he, &first, mark, second);
    for (uint32_t i = 0; i < n; i++) mark[loop->vertex[i]] = 0;
    ring_forget(&first, mark), ring_forget(second, mark);
    if (!is_path || first.count == MOST || second->count == MOST) second->count = 0;
}

static vec3 middle_of(const struct mesh *mesh, const uint32_t *vertex, uint32_t n) {
    vec3 sum = {0};
    for (uint32_t i = 0; i < n; i++) sum = vec3_add(sum, vec3_scale(mesh->vertex[vertex[i]], 1.0 / n));
    return sum;
}

/* Mean distance of vertices from a line through a point along a unit vector. */
static double distance_from(const struct mesh *mesh, const uint32_t *vertex, uint32_t n, vec3 at, vec3 along) {
    double sum = 0;
    for (uint32_t i = 0; i < n; i++) {
        vec3 e = vec3_sub(mesh->vertex[vertex[i]], at);
        sum += vec3_length(vec3_sub(e, vec3_scale(along, vec3_dot(e, along)))) / n;
    }
    return sum;
}

/* Whether it is about as narrow on both sides.  mark: one for each vertex, 0, and 0 again afterwards. */
static bool is_around_tube(const struct mesh *mesh, const struct halfedge *he, const struct loop *loop, uint8_t *mark) {
    static const double WIDER = 1.9;
    struct ring left, right;
    find_second(he, loop, true, mark, &left);
    find_second(he, loop, false, mark, &right);
    if (left.count < 3 || right.count < 3) return false;
    vec3 from = middle_of(mesh, left.vertex, left.count), to = middle_of(mesh, right.vertex, right.count);
    vec3 along = vec3_unit(vec3_sub(to, from));
    double most = WIDER * distance_from(mesh, loop->vertex, loop->count, from, along);
    return distance_from(mesh, left.vertex, left.count, from, along) < most &&
           distance_from(mesh, right.vertex, right.count, from, along) < most;
}

/* ------------------------------------------------------------------------------------------------ sums */

/* A basis of classes of loops, each with a highest bit of its own. */
struct classes {
    uint64_t basis[64];
    long count;
};

/* What is left of a class without those of the basis; 0: it is a sum of them. */
static uint64_t class_without(const struct classes *classes, uint64_t homology) {
    for (int bit = 63; bit >= 0; bit--)
        if (homology >> bit & 1 && classes->basis[bit]) homology ^= classes->basis[bit];
    return homology;
}

static void class_add(struct classes *classes, uint64_t homology) {
    uint64_t rest = class_without(classes, homology);
    int bit = 63;
    while (rest && !(rest >> bit & 1)) bit--;
    if (rest) classes->basis[bit] = rest, classes->count++;
}

enum status tubes_leave(const struct mesh *mesh, struct loops *loops, long *tubes) {
    struct halfedge he = {0};
    struct classes classes = {.count = 0};
    size_t left = 0;
    uint8_t *mark = alloc_zeroed(mesh->vertex_count, 1);
    enum status status = mark ? halfedge_init(&he, mesh, 1) : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < loops->count; i++) {
        const struct loop loop = loops->loop[i];
        if (is_around_tube(mesh, &he, &loop, mark))
            class_add(&classes, loop.homology);
        else if (class_without(&classes, loop.homology))
            loops->loop[left++] = loop;
    }
    if (!status) *tubes = classes.count, loops->count = left;
    halfedge_done(&he);
    free(mark);
    return status;
}
