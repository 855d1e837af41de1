/* What each vertex costs when it is collapsed into its best neighbour, and what each edge gains when a vertex is put on
 * it, is measured in parallel with nothing changed.  Then the cheapest loss pays for the greatest gain, the next for
 * the next, skipping whatever touches triangles that changed, until a gain no longer pays.  In order, so the result
 * doesn't depend on threads; what the reallocations do to samples is done afterwards, in parallel, since no triangle is
 * in two of them.
 *
 * Both are measured before flips and moves help, so a pair may lose up to 30 % now (REALLOCATION_PAYS).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine_internal.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/cloud/cloud.h"
#include "core/refine/prefetch.h"

enum { GRAIN = 64, ESTIMATES = 4096, APPLIED_GRAIN = 16 };

#define REALLOCATION_PAYS 0.7 /* gain over loss, at least */
#define REALLOCATION_MOST 0.2 /* of the vertices */

/* How many vertices are measured for a collapse, and how many edges for a split, as shares of the number of vertices.
 * Where vertices may stand anywhere more of these are worth it, and so on a surface with a border. */
static const struct parts {
    double cheap, dear;
} parts_of[] = {[PLACEMENT_SUBSET] = {0.2, 0.3}, [PLACEMENT_OPTIMAL] = {0.4, 0.6}};

static const struct parts *parts_for(const struct fit *fit) {
    return &parts_of[fit->borders ? PLACEMENT_OPTIMAL : fit->placement];
}

static size_t part_of(const struct fit *fit, double part) {
    return (size_t)(part * (double)fit->mesh->vertex_count) + 1;
}

/* Vertices to collapse, or edges to split: all by a key that is quick to find (items of radix_sort), of which the best
 * become candidates, whose cost or gain is measured. */
struct candidate_list {
    struct fit *fit;
    uint64_t *item;                  /* in the order of memory, in which they are read faster */
    struct fit_candidate *candidate; /* of each item */
    uint64_t *order;                 /* of candidates */
};

#define NEVER UINT32_MAX /* key of what can be no candidate */

static void fetch_fan_links(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    fit_fetch_links(list->fit, list->fit->he.out[radix_value(list->item[i])] / 3);
}

static void fetch_fan(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    uint32_t ring[FIT_MAX_RING];
    size_t n = fit_ring(list->fit, radix_value(list->item[i]), ring);
    for (size_t k = 0; k < n; k++) {
        fit_fetch_triangle(list->fit, ring[k] / 3);
        fit_fetch_around(list->fit, ring[k] / 3);
    }
}

static void fetch_fan_disks(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    uint32_t ring[FIT_MAX_RING];
    size_t n = fit_ring(list->fit, radix_value(list->item[i]), ring);
    for (size_t k = 0; k < n; k++) fit_fetch_disks(list->fit, ring[k] / 3);
}

static bool measure_collapse(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    list->candidate[i] = fit_collapse_cheapest(list->fit, radix_value(list->item[i]));
    return true;
}

static void measure_collapses(void *ctx, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {{4, fetch_fan_links}, {2, fetch_fan}, {1, fetch_fan_disks}};
    for_each_prefetched(ahead, ctx, begin, end, measure_collapse);
}

/* The triangle on either side of an edge that is going to be measured; on a border there is one. */
static uint32_t candidate_side(const struct candidate_list *list, size_t i, int side) {
    uint32_t h = radix_value(list->item[i]), g = side ? list->fit->he.twin[h] : h;
    return (g == NONE ? h : g) / 3;
}

static void fetch_sides(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_triangle(list->fit, candidate_side(list, i, side));
}

static void fetch_around_sides(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_around(list->fit, candidate_side(list, i, side));
}

static void fetch_more_of_sides(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_more(list->fit, candidate_side(list, i, side));
}

static void fetch_disks_of_sides(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_disks(list->fit, candidate_side(list, i, side));
}

static bool measure_split(void *ctx, size_t i) {
    const struct candidate_list *list = ctx;
    list->candidate[i] = fit_split_best(list->fit, radix_value(list->item[i]));
    return true;
}

static void measure_splits(void *ctx, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {
        {8, fetch_sides}, {6, fetch_around_sides}, {4, fetch_more_of_sides}, {2, fetch_disks_of_sides}};
    for_each_prefetched(ahead, ctx, begin, end, measure_split);
}

struct measured {
    const struct fit_candidate *candidate;
    bool falling;
};

static int compare_exact(const void *a, const void *b, void *ctx) {
    const struct measured *by = ctx;
    const struct fit_candidate *x = &by->candidate[radix_value(*(const uint64_t *)a)];
    const struct fit_candidate *y = &by->candidate[radix_value(*(const uint64_t *)b)];
    int order = x->value != y->value ? (x->value > y->value) - (x->value < y->value)
                                     : (x->halfedge > y->halfedge) - (x->halfedge < y->halfedge);
    return by->falling ? -order : order;
}

/* Puts items that lie in order by their keys in that of their candidates: float isn't as exact as they are.  On a plane
 * there may be many equal ones. */
static void order_equals(const struct fit_candidate *candidate, uint64_t *order, size_t n, bool falling) {
    struct measured by = {candidate, falling};
    for (size_t begin = 0, end; begin < n; begin = end) {
        for (end = begin + 1; end < n && radix_key(order[end]) == radix_key(order[begin]);) end++;
        if (end - begin > 1) qsort_r(&order[begin], end - begin, sizeof *order, compare_exact, &by);
    }
}

/* The candidates that stand, by their values. */
struct ranking {
    const struct fit_candidate *candidate;
    const uint64_t *order;
    size_t n;
};

static const struct fit_candidate *candidate_at(const struct ranking *ranking, size_t i) {
    return &ranking->candidate[radix_value(ranking->order[i])];
}

static struct ranking rank_candidates(const struct candidate_list *list, size_t count, bool falling) {
    uint64_t *order = list->order;
    size_t n = 0;
    for (size_t i = 0; i < count; i++) {
        if (list->candidate[i].halfedge == NONE) continue;
        uint32_t key = radix_key_of_signed(list->candidate[i].value);
        order[n++] = radix_item(falling ? ~key : key, (uint32_t)i);
    }
    order = radix_sort(order, order + n, n, 1);
    order_equals(list->candidate, order, n, falling);
    return (struct ranking){list->candidate, order, n};
}

static void estimate_collapses(void *ctx, size_t begin, size_t end) {
    const struct candidate_list *list = ctx;
    for (size_t v = begin; v < end; v++) {
        double estimate = fit_collapse_estimate(list->fit, (uint32_t)v);
        list->item[v] = radix_item(estimate < INFINITY ? radix_key_of(estimate) : NEVER, (uint32_t)v);
    }
}

/* Whether an edge with one triangle is a border's, along which the surface can grow. */
static bool is_border(const struct fit *fit, uint32_t h) {
    return fit_is_on_border(fit, halfedge_from(&fit->he, h)) && fit_is_on_border(fit, halfedge_to(&fit->he, h));
}

/* An edge by its triangles' cost, the dearest first. */
static void estimate_splits(void *ctx, size_t begin, size_t end) {
    const struct candidate_list *list = ctx;
    const struct fit *fit = list->fit;
    for (size_t h = begin; h < end; h++) {
        uint32_t twin = fit->he.twin[h], g = twin == NONE ? (uint32_t)h : twin;
        uint32_t key = radix_key_of(fit->cost[h / 3] + fit->cost[g / 3]);
        bool is_candidate = twin == NONE ? is_border(fit, (uint32_t)h) : g > h;
        list->item[h] = radix_item(NEVER - is_candidate * key, (uint32_t)h);
    }
}

/* Keeps the lowest of n items, `most` of them, as far as they can be candidates; their number. */
static size_t shortlist(uint64_t *item, size_t n, size_t most) {
    size_t count = radix_keep_lowest(item, item + n, n, most), kept = 0;
    for (size_t i = 0; i < count; i++)
        if (radix_key(item[i]) != NEVER) item[kept++] = item[i];
    return kept;
}

/* The vertices whose estimate is lowest, measured, cheapest first. */
static struct ranking find_collapses(struct candidate_list *list) {
    struct fit *fit = list->fit;
    size_t n = fit->mesh->vertex_count;
    par_for(fit->threads, n, ESTIMATES, estimate_collapses, list);
    size_t count = shortlist(list->item, n, part_of(fit, parts_for(fit)->cheap));
    par_for(fit->threads, count, GRAIN, measure_collapses, list);
    return rank_candidates(list, count, false);
}

/* The edges whose triangles cost most, measured, most rewarding first. */
static struct ranking find_splits(struct candidate_list *list) {
    struct fit *fit = list->fit;
    size_t n = 3 * fit->mesh->triangle_count;
    par_for(fit->threads, n, ESTIMATES, estimate_splits, list);
    size_t count = shortlist(list->item, n, part_of(fit, parts_for(fit)->dear));
    par_for(fit->threads, count, GRAIN, measure_splits, list);
    return rank_candidates(list, count, true);
}

static size_t most_applied(const struct fit *fit) { return part_of(fit, REALLOCATION_MOST); }

static bool has_changed_around(const struct fit *fit, uint32_t h, const uint8_t *changed) {
    uint32_t across = fit->he.twin[h];
    return changed[h / 3] || (across != NONE && changed[across / 3]);
}

/* Whether the vertex may still go as it was measured. */
static bool collapse_holds(const struct fit *fit, const struct fit_candidate *collapse, const uint8_t *changed) {
    uint32_t ring[FIT_MAX_RING];
    size_t n = fit_ring(fit, collapse->vertex, ring);
    for (size_t i = 0; i < n; i++)
        if (has_changed_around(fit, halfedge_next(ring[i]), changed)) return false;
    return n > 0 && halfedge_may_collapse(&fit->he, collapse->halfedge, collapse->vertex);
}

static bool has_changed_beside(const struct fit *fit, uint32_t h, const uint8_t *changed) {
    return has_changed_around(fit, halfedge_next(h), changed) || has_changed_around(fit, halfedge_prev(h), changed);
}

static void mark(struct fit *fit, uint8_t *changed, const uint32_t *triangle, size_t n) {
    for (size_t i = 0; i < n; i++) {
        changed[triangle[i]] = fit->touched[triangle[i]] = 1;
        for (int k = 0; k < 3; k++) fit->stale[fit->mesh->triangle[triangle[i]][k]] = 1;
    }
}

/* A reallocation that was made: the star that the vertex left, the two triangles of it that were left over, the two of
 * the edge that it was put on, and the two that it took for that.  Where there is but one, at a border, the other is
 * NONE.
 */
struct applied {
    size_t begin, n; /* of the star, in reallocation.star */
    uint32_t spare[2], edge[2], taken[2];
};

struct reallocation {
    struct fit *fit;
    uint8_t *changed; /* room */
    uint32_t *star;   /* triangle_count: the triangles of all stars that vertices left */
    struct applied *applied;
    uint32_t *free; /* room: triangles that are none, the one that was freed last at the end */
    size_t stars, applied_count, frees;
};

/* An applied pair's triangles that there are; their number. */
static size_t those_there(const uint32_t pair[2]) { return pair[1] == NONE ? 1 : 2; }

/* The vertex goes. */
static void take_out(struct reallocation *reallocation, const struct fit_candidate *collapse) {
    struct fit *fit = reallocation->fit;
    uint32_t ring[FIT_MAX_RING], *star = reallocation->star + reallocation->stars;
    size_t n = fit_ring(fit, collapse->vertex, ring);
    for (size_t i = 0; i < n; i++) star[i] = ring[i] / 3;
    struct applied *applied = &reallocation->applied[reallocation->applied_count];
    *applied = (struct applied){.begin = reallocation->stars, .n = n};
    reallocation->stars += n;
    struct halfedge_spare spare = halfedge_collapse(&fit->he, collapse->halfedge, collapse->vertex);
    mark(fit, reallocation->changed, star, n);
    if (fit->mesh->source) fit_leave(fit, fit->mesh->source[collapse->vertex]);
    memcpy(applied->spare, spare.triangle, sizeof applied->spare);
    for (size_t k = those_there(applied->spare); k-- > 0;)
        reallocation->free[reallocation->frees++] = applied->spare[k];
}

static uint32_t take_triangle(struct reallocation *reallocation) {
    if (reallocation->frees > 0) return reallocation->free[--reallocation->frees];
    uint32_t t = (uint32_t)reallocation->fit->mesh->triangle_count++;
    reallocation->fit->he.triangle_count++;
    reallocation->fit->cost[t] = 0;
    return t;
}

/* And is put in on the edge.  Room for a triangle more than there are was seen to. */
static void put_in(struct reallocation *reallocation, const struct fit_candidate *candidate, uint32_t vertex) {
    struct fit *fit = reallocation->fit;
    struct applied *applied = &reallocation->applied[reallocation->applied_count++];
    uint32_t h = candidate->halfedge, g = fit->he.twin[h];
    applied->edge[0] = h / 3, applied->edge[1] = g == NONE ? NONE : g / 3;
    size_t n = those_there(applied->edge);
    applied->taken[1] = NONE;
    for (size_t k = 0; k < n; k++) applied->taken[k] = take_triangle(reallocation);
    fit->mesh->vertex[vertex] = candidate->place;
    if (fit->mesh->source) fit->mesh->source[vertex] = candidate->source;
    fit_take(fit, candidate->source);
    for (size_t k = 0; k < n && fit->mesh->tag; k++)
        fit->mesh->tag[applied->taken[k]] = fit->mesh->tag[applied->edge[k]];
    fit->partition.of[vertex] = fit->partition.of[halfedge_from(&fit->he, h)];
    halfedge_split(&fit->he, h, (struct halfedge_spare){vertex, {applied->taken[0], applied->taken[1]}});
    mark(fit, reallocation->changed, applied->edge, n);
    mark(fit, reallocation->changed, applied->taken, n);
}

/* The triangles on both sides of the edges that are tried next. */
struct fetched {
    const struct fit *fit;
    const struct ranking *ranking;
};

static void fetch_candidate(void *ctx, size_t i) {
    const struct fetched *fetched = ctx;
    fit_fetch_links(fetched->fit, candidate_at(fetched->ranking, i)->halfedge / 3);
}

static void fetch_candidate_twins(void *ctx, size_t i) {
    const struct fetched *fetched = ctx;
    uint32_t h = candidate_at(fetched->ranking, i)->halfedge;
    for (uint32_t g = h - h % 3, end = g + 3; g < end; g++)
        if (fetched->fit->he.twin[g] != NONE) fit_fetch_links(fetched->fit, fetched->fit->he.twin[g] / 3);
}

/* A collapse at a border frees one triangle, and a split amid the surface takes two. */
static bool has_room(const struct reallocation *reallocation) {
    return reallocation->fit->room > reallocation->fit->mesh->triangle_count || reallocation->fit->borders == 0;
}

/* A collapse is made only when the split that it pays for is known to hold, also after it. */
static void apply_all(struct reallocation *reallocation, const struct ranking *loss, const struct ranking *gain) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {{8, fetch_candidate}, {4, fetch_candidate_twins}};
    struct fit *fit = reallocation->fit;
    struct fetched losses = {fit, loss}, gains = {fit, gain};
    size_t i = 0, most = most_applied(fit);
    for (size_t j = 0; j < gain->n && reallocation->applied_count < most && has_room(reallocation); j++) {
        const struct fit_candidate *split = candidate_at(gain, j);
        prefetch_ahead(ahead, &gains, j, gain->n);
        uint32_t h = split->halfedge, g = fit->he.twin[h] == NONE ? h : fit->he.twin[h];
        uint8_t *changed = reallocation->changed;
        if (has_changed_beside(fit, h, changed) || has_changed_beside(fit, g, changed)) continue;
        changed[h / 3] = changed[g / 3] = 1;
        for (; i < loss->n; i++) {
            prefetch_ahead(ahead, &losses, i, loss->n);
            if (collapse_holds(fit, candidate_at(loss, i), changed)) break;
        }
        if (i == loss->n || split->value < REALLOCATION_PAYS * candidate_at(loss, i)->value) break;
        const struct fit_candidate *collapse = candidate_at(loss, i++);
        take_out(reallocation, collapse);
        put_in(reallocation, split, collapse->vertex);
    }
}

/* How many triangles an applied pair shares samples of: the star, then those beside the edge; and which is number k. */
static size_t applied_triangles(const struct applied *applied) { return applied->n + those_there(applied->edge); }

static uint32_t applied_triangle(const struct reallocation *reallocation, const struct applied *applied, size_t k) {
    return k < applied->n ? reallocation->star[applied->begin + k] : applied->edge[k - applied->n];
}

static void fetch_applied_triangles(void *ctx, size_t i) {
    const struct reallocation *reallocation = ctx;
    const struct applied *applied = &reallocation->applied[i];
    for (size_t k = 0; k < applied_triangles(applied); k++)
        fit_fetch_triangle(reallocation->fit, applied_triangle(reallocation, applied, k));
}

static void fetch_applied_surroundings(void *ctx, size_t i) {
    const struct reallocation *reallocation = ctx;
    const struct applied *applied = &reallocation->applied[i];
    for (size_t k = 0; k < applied_triangles(applied); k++)
        fit_fetch_around(reallocation->fit, applied_triangle(reallocation, applied, k));
}

static void fetch_applied_samples(void *ctx, size_t i) {
    const struct reallocation *reallocation = ctx;
    const struct applied *applied = &reallocation->applied[i];
    for (size_t k = 0; k < applied_triangles(applied); k++)
        fit_fetch_samples(reallocation->fit, applied_triangle(reallocation, applied, k));
}

static bool share_one_merge(void *ctx, size_t i) {
    const struct reallocation *reallocation = ctx;
    const struct applied *applied = &reallocation->applied[i];
    const uint32_t *star = reallocation->star + applied->begin, *spare = applied->spare;
    uint32_t left[FIT_MAX_RING];
    size_t n = 0;
    for (size_t k = 0; k < applied->n; k++)
        if (star[k] != spare[0] && star[k] != spare[1]) left[n++] = star[k];
    fit_share(reallocation->fit, star, applied->n, left, n);
    return true;
}

static void share_merged(void *ctx, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {
        {3, fetch_applied_triangles}, {2, fetch_applied_surroundings}, {1, fetch_applied_samples}};
    for_each_prefetched(ahead, ctx, begin, end, share_one_merge);
}

static void share_split(void *ctx, size_t begin, size_t end) {
    const struct reallocation *reallocation = ctx;
    for (size_t i = begin; i < end; i++) {
        const struct applied *applied = &reallocation->applied[i];
        size_t n = those_there(applied->edge);
        uint32_t after[4];
        memcpy(after, applied->edge, n * sizeof *after);
        memcpy(after + n, applied->taken, n * sizeof *after);
        fit_share(reallocation->fit, applied->edge, n, after, 2 * n);
    }
}

static int compare_ids(const void *a, const void *b) {
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x < y) - (x > y);
}

/* Triangles that one vertex left may be another's: so all are left before any is taken.  Then the last triangles take
 * the places of those that are none, from the last on. */
static void share_applied(struct reallocation *reallocation) {
    par_for(reallocation->fit->threads, reallocation->applied_count, APPLIED_GRAIN, share_merged, reallocation);
    par_for(reallocation->fit->threads, reallocation->applied_count, APPLIED_GRAIN, share_split, reallocation);
    qsort(reallocation->free, reallocation->frees, sizeof *reallocation->free, compare_ids);
    for (size_t i = 0; i < reallocation->frees; i++) fit_drop_triangle(reallocation->fit, reallocation->free[i]);
}

static enum status apply_candidates(struct fit *fit, const struct ranking *loss, const struct ranking *gain,
                                    size_t *reallocations) {
    struct reallocation reallocation = {.fit = fit};
    reallocation.changed = alloc_zeroed(fit->room, 1);
    reallocation.star = alloc_array(fit->mesh->triangle_count, sizeof *reallocation.star);
    reallocation.applied = alloc_array(most_applied(fit), sizeof *reallocation.applied);
    reallocation.free = alloc_array(fit->room, sizeof *reallocation.free);
    bool enough = reallocation.changed && reallocation.star && reallocation.applied && reallocation.free;
    if (enough) {
        apply_all(&reallocation, loss, gain);
        share_applied(&reallocation);
        *reallocations += reallocation.applied_count;
    }
    free(reallocation.changed), free(reallocation.star), free(reallocation.applied), free(reallocation.free);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status fit_reallocate(struct fit *fit, size_t *reallocations) {
    const struct parts *parts = parts_for(fit);
    size_t vertices = fit->mesh->vertex_count, halfedges = 3 * fit->mesh->triangle_count;
    size_t collapses = part_of(fit, parts->cheap), splits = part_of(fit, parts->dear);
    struct candidate_list out = {.fit = fit}, in = {.fit = fit};
    out.item = in.item = alloc_array(2 * (vertices > halfedges ? vertices : halfedges), sizeof *out.item);
    out.candidate = alloc_array(collapses + splits, sizeof *out.candidate);
    out.order = alloc_array(2 * (collapses + splits), sizeof *out.order);
    enum status status = STATUS_NO_MEMORY;
    if (out.item && out.candidate && out.order) {
        in.candidate = out.candidate + collapses, in.order = out.order + 2 * collapses;
        struct ranking loss = find_collapses(&out), gain = find_splits(&in);
        status = apply_candidates(fit, &loss, &gain, reallocations);
    }
    free(out.item), free(out.candidate), free(out.order);
    return status;
}
