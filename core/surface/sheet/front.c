/* A surface grows from its borders, the likeliest facet of the Delaunay tetrahedra first.
 *
 * Each facet has a radius, that of the smallest ball through its corners with no point inside: the distance of a corner
 * to the facet's dual, the edge between the centres of the cells on both sides.  Where points sample a surface its
 * facets have small ones.  The first triangle is the facet with the smallest radius.  From then on each border edge has
 * a candidate,
 *
 *            d                the facet at the edge with the smallest radius, of those that don't fold back onto the
 *          /   \              edge's own triangle and whose other edges are free or on the border, too;
 *        /  new  \
 *       a ------- b           and of all candidates the best is taken: those that bend little by their radius, then
 *        \       /            the others by how far they bend, and those much larger than their neighbour last.
 *          \   /
 *            c
 *
 * What a new triangle does to the border depends on d.  If no triangle has d, the border takes it in.  If it is the
 * next vertex on the border, an ear is cut off: the border gets shorter, and an end of the edge is inside.  If it is
 * elsewhere on a border, the border would meet itself there, which is put off until the facet between the new edge and
 * the border's next one is a candidate as well: then both are taken at once.
 *
 *        ----- p - d - q -----           with ears at q, p or both; the edge waits for a change at d otherwise
 *                 / \ .
 *       ------- a --- b -------
 *
 * When no candidate is left the next component starts, where a facet's three corners are in no triangle.
 *
 * Invariant: at each vertex the triangles are one fan, so the border passes through it once at most, and an edge of the
 * border is known by its start.  Nothing but the tetrahedra's numbers decides between equals.
 *
 * Source: D. Cohen-Steiner, F. Da, A greedy Delaunay-based surface reconstruction algorithm, The Visual Computer 20
 * (2004).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/front.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/cloud/cloud.h"
#include "core/surface/cocone/star.h"

enum { GRAIN = 2048, TICK_EVERY = 2048 };
static const double FOLDED = -0.86;   /* cosine between normals: below, a facet folds back */
static const double STRAIGHT = -0.86; /* cosine of a corner: below, a facet is all edge */
static const double FLAT = 0.8678;    /* cosine between normals (0.52 rad): above, the radius alone ranks */
static const double LARGER = 1.1, STEP = 0.1, MOST_STEPS = 1e6; /* squares of radii beside the neighbour's */

enum place { OUTSIDE, BORDER, INSIDE };

/* A border edge's candidate: a half facet, NONE where there is none; the least rank is taken first. */
struct candidate {
    uint32_t half;
    double rank;
};

/* An edge of the border, by its start. */
struct edge {
    uint32_t to, from; /* the next vertex on the border, and the one before */
    uint32_t face;     /* half facet of its triangle */
    uint32_t stamp;    /* of its entry in the heap that counts */
    uint32_t waiter;   /* first of those for a change at this vertex; NONE = no one waits */
    struct candidate candidate;
};

struct entry {
    double rank;
    uint32_t start, stamp;
};

/* An edge that waits for a change elsewhere, in a list. */
struct waiter {
    uint32_t start, next;
};

struct front {
    struct cocone_star star;
    float *radius_sq; /* of each half facet; infinite where there is no ball */
    uint8_t *place;   /* of each vertex */
    struct edge *edge;
    uint64_t *used; /* hash table: edges and how many triangles they have */
    size_t mask;
    struct entry *heap;
    size_t heap_count, heap_room;
    struct waiter *waiter;
    size_t waiter_count, waiter_room;
    uint32_t waiter_free; /* first of a list */
    enum status status;   /* of making room */
    double steps;         /* the most that a neighbour has been outgrown by so far */
    uint32_t (*triangle)[3];
    size_t count, room;
};

/* ------------------------------------------------------------------------------------------------ radii */

static double facet_radius_sq(vec3 a, vec3 b, vec3 c) {
    vec3 ab = vec3_sub(b, a), ac = vec3_sub(c, a);
    double area_sq = vec3_length_sq(vec3_cross(ab, ac));
    return vec3_length_sq(ab) * vec3_length_sq(ac) * vec3_length_sq(vec3_sub(c, b)) / (4 * area_sq);
}

/* How far the dual's end in a cell lies from a on the side that the normal points to. */
static double height_of(const struct cocone_star *star, uint32_t cell, uint32_t a, vec3 normal, double endless) {
    if (!cocone_star_is_finite(star, cell)) return endless;
    return vec3_dot(vec3_sub(star->tets->circumcentre[cell], star->point[a]), normal);
}

static double radius_sq_of(const struct cocone_star *star, uint32_t half) {
    uint32_t v[3], cell = cocone_star_cell(half), other = cocone_star_cell(cocone_star_twin(star, half));
    cocone_star_vertices(star, half, v);
    vec3 a = star->point[v[0]], b = star->point[v[1]], c = star->point[v[2]];
    vec3 normal = vec3_triangle_normal(a, b, c); /* into the cell */
    double above = height_of(star, cell, v[0], normal, INFINITY);
    double below = height_of(star, other, v[0], normal, -INFINITY);
    if (above < 0) return vec3_distance_sq(star->tets->circumcentre[cell], a);
    if (below > 0) return vec3_distance_sq(star->tets->circumcentre[other], a);
    return facet_radius_sq(a, b, c);
}

static void radius_range(void *ctx, size_t begin, size_t end) {
    struct front *f = ctx;
    for (uint32_t half = 4 * (uint32_t)begin; half < 4 * end; half++) {
        uint32_t twin = cocone_star_twin(&f->star, half), v[3];
        if (twin < half) continue;
        cocone_star_vertices(&f->star, half, v);
        double r = v[0] == NONE || v[1] == NONE || v[2] == NONE ? INFINITY : radius_sq_of(&f->star, half);
        f->radius_sq[half] = f->radius_sq[twin] = r >= 0 ? (float)r : INFINITY; /* not NAN */
    }
}

/* ------------------------------------------------------------------------------------------------ edges in use */

static uint64_t edge_key(uint32_t a, uint32_t b) { return ((uint64_t)(a < b ? a : b) << 30 | (a < b ? b : a)) << 2; }

static size_t slot_of(const struct front *f, uint64_t key) {
    size_t i = (size_t)hash64(key) & f->mask;
    while (f->used[i] && (f->used[i] & ~UINT64_C(3)) != key) i = (i + 1) & f->mask;
    return i;
}

/* How many triangles have the edge. */
static unsigned uses_of(const struct front *f, uint32_t a, uint32_t b) {
    return f->used[slot_of(f, edge_key(a, b))] & 3;
}

static void use(struct front *f, uint32_t a, uint32_t b) {
    uint64_t key = edge_key(a, b);
    size_t i = slot_of(f, key);
    f->used[i] = (f->used[i] ? f->used[i] : key) + 1;
}

/* ------------------------------------------------------------------------------------------------ candidates */

static uint32_t apex_of(const struct front *f, uint32_t half, uint32_t a, uint32_t b) {
    uint32_t v[3];
    cocone_star_vertices(&f->star, half, v);
    return v[0] != a && v[0] != b ? v[0] : v[1] != a && v[1] != b ? v[1] : v[2];
}

static double cosine(vec3 a, vec3 b) {
    double length = sqrt(vec3_length_sq(a) * vec3_length_sq(b));
    return length > 0 ? vec3_dot(a, b) / length : 0;
}

/* Steps by which a radius is over what the neighbour's allows. */
static double steps_over(double radius_sq, double neighbour_sq) {
    double ratio = radius_sq / neighbour_sq;
    if (!(ratio > LARGER)) return 0;
    return fmin(ceil((ratio - LARGER) / STEP), MOST_STEPS);
}

static double rank_of(double bend, double radius_sq, double neighbour_sq) {
    if (bend > FLAT) return -(1 + 1 / radius_sq);
    return 2 * steps_over(radius_sq, neighbour_sq) - bend;
}

/* Whether an edge may get the triangle (b, a, d) on its other side. */
static bool is_free(const struct front *f, uint32_t a, uint32_t b, uint32_t d) {
    return d != NONE && f->place[d] != INSIDE && uses_of(f, a, d) < 2 && uses_of(f, b, d) < 2;
}

/* The best facet at the edge from a to b, whose triangle is `face`. */
static struct candidate find_candidate(const struct front *f, uint32_t a, uint32_t b, uint32_t face) {
    const vec3 *p = f->star.point;
    vec3 ab = vec3_sub(p[b], p[a]);
    vec3 normal = vec3_cross(ab, vec3_sub(p[apex_of(f, face, a, b)], p[a]));
    struct candidate best = {NONE, INFINITY};
    double smallest = INFINITY, bend = 0;
    bool straight = false;
    uint32_t end = cocone_star_twin(&f->star, face), half = cocone_star_turn(&f->star, face, a, b);
    for (; half != end; half = cocone_star_turn(&f->star, cocone_star_twin(&f->star, half), a, b)) {
        double radius_sq = (double)f->radius_sq[half];
        uint32_t d = apex_of(f, half, a, b);
        if (!(radius_sq < smallest) || !is_free(f, a, b, d)) continue;
        vec3 ad = vec3_sub(p[d], p[a]), bd = vec3_sub(p[d], p[b]);
        double cos_bend = cosine(normal, vec3_cross(ad, ab));
        if (cos_bend <= FOLDED) continue;
        straight = cosine(ab, ad) < STRAIGHT || -cosine(ab, bd) < STRAIGHT;
        best.half = half, smallest = radius_sq, bend = cos_bend;
    }
    if (best.half == NONE || straight) return (struct candidate){NONE, INFINITY};
    best.rank = rank_of(bend, smallest, (double)f->radius_sq[face]);
    return best;
}

/* ------------------------------------------------------------------------------------------------ the queue */

static bool is_less(struct entry x, struct entry y) {
    return x.rank != y.rank ? x.rank < y.rank : x.start != y.start ? x.start < y.start : x.stamp < y.stamp;
}

/* An array with room for one more than count, or NULL. */
static void *with_room(void *array, size_t count, size_t *room, size_t size) {
    if (count < *room) return array;
    void *grown = alloc_resize(array, 2 * *room + 64, size);
    if (grown) *room = 2 * *room + 64;
    return grown;
}

static void heap_push(struct front *f, struct entry entry) {
    struct entry *heap = with_room(f->heap, f->heap_count, &f->heap_room, sizeof *heap);
    if (!heap) {
        f->status = STATUS_NO_MEMORY;
        return;
    }
    f->heap = heap;
    size_t i = f->heap_count++;
    for (; i > 0 && is_less(entry, f->heap[(i - 1) / 2]); i = (i - 1) / 2) f->heap[i] = f->heap[(i - 1) / 2];
    f->heap[i] = entry;
}

static struct entry heap_pop(struct front *f) {
    struct entry top = f->heap[0], last = f->heap[--f->heap_count];
    size_t i = 0;
    for (size_t child; (child = 2 * i + 1) < f->heap_count; i = child) {
        child += child + 1 < f->heap_count && is_less(f->heap[child + 1], f->heap[child]);
        if (!is_less(f->heap[child], last)) break;
        f->heap[i] = f->heap[child];
    }
    f->heap[i] = last;
    return top;
}

/* Looks for the edge's candidate again. */
static void queue_edge(struct front *f, uint32_t start) {
    struct edge *e = &f->edge[start];
    e->stamp++;
    e->candidate = find_candidate(f, start, e->to, e->face);
    if (e->candidate.half != NONE) heap_push(f, (struct entry){e->candidate.rank, start, e->stamp});
}

/* ------------------------------------------------------------------------------------------------ the border */

static void start_edge(struct front *f, uint32_t a, uint32_t b, uint32_t face) {
    f->edge[a].to = b, f->edge[b].from = a;
    f->edge[a].face = face;
    f->place[a] = f->place[b] = BORDER;
}

static void leave_border(struct front *f, uint32_t v) {
    f->place[v] = INSIDE;
    f->edge[v].stamp++;
}

/* The edge from start waits for a change at v. */
static void wait_for(struct front *f, uint32_t start, uint32_t v) {
    uint32_t w = f->waiter_free;
    if (w == NONE) {
        struct waiter *waiter = with_room(f->waiter, f->waiter_count, &f->waiter_room, sizeof *waiter);
        if (!waiter) {
            f->status = STATUS_NO_MEMORY;
            return;
        }
        f->waiter = waiter;
        w = (uint32_t)f->waiter_count++;
    } else {
        f->waiter_free = f->waiter[w].next;
    }
    f->waiter[w] = (struct waiter){start, f->edge[v].waiter};
    f->edge[v].waiter = w;
}

/* Edges that wait for v look again. */
static void wake(struct front *f, uint32_t v) {
    uint32_t w = f->edge[v].waiter;
    f->edge[v].waiter = NONE;
    while (w != NONE) {
        uint32_t next = f->waiter[w].next, start = f->waiter[w].start;
        f->waiter[w].next = f->waiter_free;
        f->waiter_free = w;
        if (f->place[start] == BORDER) queue_edge(f, start);
        w = next;
    }
}

static void add_triangle(struct front *f, uint32_t a, uint32_t b, uint32_t c) {
    void *triangle = with_room(f->triangle, f->count, &f->room, sizeof *f->triangle);
    if (!triangle) {
        f->status = STATUS_NO_MEMORY;
        return;
    }
    f->triangle = triangle;
    uint32_t *t = f->triangle[f->count++];
    t[0] = a, t[1] = b, t[2] = c;
    use(f, a, b), use(f, b, c), use(f, c, a);
}

/* Where the border comes back along the edge that it has just got, both are inside. */
static bool close_edge(struct front *f, uint32_t a) {
    uint32_t b = f->edge[a].to;
    if (f->edge[b].to != a) return false;
    leave_border(f, a), leave_border(f, b);
    return true;
}

/* The triangle (b, a, d) with d outside, or beside the edge on the border. */
static void extend(struct front *f, uint32_t a, uint32_t b, uint32_t d, uint32_t half) {
    bool at_a = f->place[d] == BORDER && f->edge[a].from == d, at_b = f->place[d] == BORDER && f->edge[b].to == d;
    add_triangle(f, b, a, d);
    if (at_a && at_b) {
        leave_border(f, a), leave_border(f, b), leave_border(f, d);
    } else if (at_a) {
        leave_border(f, a);
        start_edge(f, d, b, half);
        queue_edge(f, d);
    } else if (at_b) {
        leave_border(f, b);
        start_edge(f, a, d, half);
        queue_edge(f, a);
    } else {
        start_edge(f, a, d, half);
        start_edge(f, d, b, half);
        queue_edge(f, a);
        queue_edge(f, d);
    }
    wake(f, a), wake(f, b), wake(f, d);
}

/* Whether the candidate of a new edge between `far` and d, which is on a border, is an ear there: its apex is d's
 * neighbour x on that border, it ranks no later than the new triangle, and goes well with the triangle at the edge
 * between d and x. */
static bool is_ear(const struct front *f, struct candidate ear, uint32_t far, uint32_t d, uint32_t x, double rank) {
    if (ear.half == NONE || ear.rank > rank || apex_of(f, ear.half, far, d) != x) return false;
    uint32_t beside = f->edge[f->edge[d].to == x ? d : x].face;
    vec3 at = f->star.point[d], away = vec3_sub(f->star.point[far], at), along = vec3_sub(f->star.point[x], at);
    vec3 in = vec3_sub(f->star.point[apex_of(f, beside, d, x)], at);
    if (cosine(vec3_cross(away, along), vec3_cross(along, in)) > FLAT) return true;
    return steps_over((double)f->radius_sq[ear.half], (double)f->radius_sq[beside]) <= f->steps;
}

/* The triangle (b, a, d) with d elsewhere on a border, with the ears that keep the border from meeting itself; false,
 * and nothing is changed, where there are none. */
static bool connect(struct front *f, uint32_t a, uint32_t b, uint32_t d, struct candidate new) {
    uint32_t p = f->edge[d].from, q = f->edge[d].to, half = new.half;
    struct candidate ear_q = find_candidate(f, a, d, half), ear_p = find_candidate(f, d, b, half);
    bool at_q = is_ear(f, ear_q, a, d, q, new.rank), at_p = is_ear(f, ear_p, b, d, p, new.rank);
    if (!at_q && !at_p) return false;
    add_triangle(f, b, a, d);
    if (at_q) {
        add_triangle(f, d, a, q);
        start_edge(f, a, q, ear_q.half);
        start_edge(f, d, b, half);
    } else {
        start_edge(f, a, d, half);
    }
    /* The second ear may have lost its edge to the first. */
    if (at_p && (!at_q || is_free(f, d, b, p))) {
        add_triangle(f, d, p, b);
        start_edge(f, p, b, ear_p.half);
        if (at_q) leave_border(f, d);
    } else {
        at_p = false;
    }
    uint32_t start[3] = {a, at_p ? p : NONE, at_p ? NONE : d};
    for (int i = 0; i < 3; i++)
        if (start[i] != NONE && f->place[start[i]] == BORDER && !close_edge(f, start[i])) queue_edge(f, start[i]);
    wake(f, a), wake(f, b), wake(f, d), wake(f, p), wake(f, q);
    return true;
}

/* Takes the candidate of the edge from a, unless what has happened since says otherwise. */
static void take(struct front *f, uint32_t a) {
    struct edge *e = &f->edge[a];
    struct candidate new = e->candidate;
    uint32_t b = e->to, d = apex_of(f, new.half, a, b);
    if (!is_free(f, a, b, d)) {
        queue_edge(f, a);
        return;
    }
    if (new.rank > 0) f->steps = fmax(f->steps, floor((new.rank + 1) / 2));
    if (f->place[d] == OUTSIDE || e->from == d || f->edge[b].to == d) {
        extend(f, a, b, d, new.half);
    } else if (!connect(f, a, b, d, new)) {
        wait_for(f, a, d);
    }
}

/* ------------------------------------------------------------------------------------------------ components */

static bool has_all_outside(const struct front *f, uint32_t half, uint32_t v[3]) {
    if (isinf(f->radius_sq[half])) return false;
    cocone_star_vertices(&f->star, half, v);
    return f->place[v[0]] == OUTSIDE && f->place[v[1]] == OUTSIDE && f->place[v[2]] == OUTSIDE;
}

static enum status grow_component(struct front *f, uint32_t half, size_t expected, const struct progress *progress) {
    uint32_t v[3];
    cocone_star_vertices(&f->star, half, v);
    add_triangle(f, v[0], v[1], v[2]);
    for (int k = 0; k < 3; k++) start_edge(f, v[k], v[(k + 1) % 3], half);
    f->steps = 0;
    for (int k = 0; k < 3; k++) queue_edge(f, v[k]);
    for (size_t taken = 1; f->heap_count > 0 && !f->status; taken++) {
        struct entry entry = heap_pop(f);
        if (taken % TICK_EVERY == 0 && progress_tick(progress, "front", fmin(1, (double)f->count / (double)expected)))
            f->status = STATUS_CANCELLED;
        else if (f->place[entry.start] == BORDER && entry.stamp == f->edge[entry.start].stamp)
            take(f, entry.start);
    }
    return f->status;
}

/* Half facets whose corners are all outside, by their radius.  After the first component few are left. */
static enum status list_seeds(const struct front *f, unsigned threads, uint64_t **sorted, size_t *count) {
    size_t n = 0, halves = 4 * f->star.tets->cell_count;
    uint32_t v[3];
    for (uint32_t half = 0; half < halves; half++)
        n += half < cocone_star_twin(&f->star, half) && has_all_outside(f, half, v);
    uint64_t *item = alloc_array(n, 2 * sizeof *item);
    if (!item) return STATUS_NO_MEMORY;
    *count = 0;
    for (uint32_t half = 0; half < halves; half++)
        if (half < cocone_star_twin(&f->star, half) && has_all_outside(f, half, v))
            item[(*count)++] = radix_item(radix_key_of((double)f->radius_sq[half]), half);
    uint64_t *found = radix_sort(item, item + n, n, threads);
    if (found != item) memcpy(item, found, n * sizeof *item);
    *sorted = item;
    return STATUS_OK;
}

static uint32_t smallest_facet(const struct front *f) {
    uint32_t best = NONE, v[3];
    for (uint32_t half = 0; half < 4 * f->star.tets->cell_count; half++)
        if (has_all_outside(f, half, v) && (best == NONE || f->radius_sq[half] < f->radius_sq[best])) best = half;
    return best;
}

static enum status grow_all(struct front *f, unsigned threads, const struct progress *progress) {
    size_t expected = 2 * f->star.n + 1, count = 0;
    uint64_t *seed = NULL;
    uint32_t v[3], first = smallest_facet(f);
    if (first == NONE) return STATUS_OK;
    enum status status = grow_component(f, first, expected, progress);
    if (!status) status = list_seeds(f, threads, &seed, &count);
    for (size_t i = 0; i < count && !status; i++)
        if (has_all_outside(f, radix_value(seed[i]), v))
            status = grow_component(f, radix_value(seed[i]), expected, progress);
    free(seed);
    return status;
}

/* There are at most three edges for each vertex, and as many again at borders. */
static enum status front_init(struct front *f, const struct tets *tets, const vec3 *point, size_t n, unsigned threads) {
    enum status status = cocone_star_build(tets, point, n, threads, &f->star);
    if (status) return status;
    size_t slots = 64;
    while (slots < 8 * n) slots *= 2;
    f->mask = slots - 1;
    f->used = alloc_zeroed(slots, sizeof *f->used);
    f->radius_sq = alloc_array(4 * tets->cell_count, sizeof *f->radius_sq);
    f->place = alloc_zeroed(n, 1);
    f->edge = alloc_array(n, sizeof *f->edge);
    if (!f->used || !f->radius_sq || !f->place || !f->edge) return STATUS_NO_MEMORY;
    for (size_t v = 0; v < n; v++) f->edge[v] = (struct edge){.to = NONE, .from = NONE, .waiter = NONE};
    par_for(threads, tets->cell_count, GRAIN, radius_range, f);
    return STATUS_OK;
}

enum status sheet_front(const struct tets *tets, const vec3 *point, size_t n, unsigned threads,
                        const struct progress *progress, uint32_t (**triangle)[3], size_t *count) {
    struct front f = {.waiter_free = NONE};
    enum status status = front_init(&f, tets, point, n, threads);
    if (!status) status = grow_all(&f, threads, progress);
    if (!status) {
        *triangle = f.triangle, *count = f.count;
        f.triangle = NULL;
    }
    cocone_star_done(&f.star);
    free(f.radius_sq), free(f.place), free(f.edge), free(f.used), free(f.heap), free(f.waiter), free(f.triangle);
    return status;
}
