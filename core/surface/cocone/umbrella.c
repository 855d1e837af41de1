/* Pruning and the walk.
 *
 * 1 Candidates around a point hold an umbrella if a closed cycle without a sharp edge is left after facets with a loose
 *   or sharp edge at the point are taken away, one after the other.
 * 2 Prune: at an edge between two such points all candidates go when they are but one, or all sharp to each other.
 * 3 Walk: candidates may lie in several layers; one that starts from a facet on one side and always takes the first
 *   candidate around the next edge meets a single one of them.  The others it passes are deleted.
 * 4 A point is good when what is left around it is one closed cycle.
 *
 * Source: T. K. Dey, S. Goswami, Tight Cocone (2003); N. Amenta, S. Choi, T. K. Dey, N. Leekha, A simple algorithm for
 * homeomorphic surface reconstruction (2002), for the pruning and walking.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

#define SHARP_COSINE (-0.5)  /* of 120 degrees */
#define SMOOTH_COSINE 0.7    /* two candidates alone at an edge this flat stay */
#define FOLDED_COSINE (-0.9) /* no good point at such an edge */

struct choice {
    const struct cocone_star *star;
    struct cocone_facets *facets;
    uint8_t *umbrella; /* of each point: candidates around it hold one */
    uint8_t *fixed;    /* of each facet: may not be pruned */
    uint8_t *kept;     /* of each facet: the walk has been there */
    uint8_t *tagged;   /* of each point: the walk has been there */
    uint32_t *stack;   /* of facets to prune at, or of half facets to walk from */
    uint8_t *stacked;  /* of each facet */
    size_t depth;
};

/* The edges of a facet as pairs of places in its vertices. */
static const uint8_t edge_of[3][2] = {{0, 1}, {1, 2}, {2, 0}};

/* What is at an edge: how many candidates alive, and the largest cosine between two of them. */
struct edge_view {
    int count;
    double best; /* -2 where there are no two */
};

static struct edge_view look_at_edge(const struct choice *choice, uint32_t a, uint32_t b) {
    const struct cocone_facets *facets = choice->facets;
    struct edge_view view = {0, -2};
    for (uint32_t i = facets->begin[a]; i < facets->begin[a + 1]; i++) {
        uint32_t f = facets->around[i];
        if (!facets->alive[f] || !cocone_facets_has(facets, f, b)) continue;
        view.count++;
        for (uint32_t j = facets->begin[a]; j < i; j++) {
            uint32_t g = facets->around[j];
            if (!facets->alive[g] || !cocone_facets_has(facets, g, b)) continue;
            view.best = fmax(view.best, cocone_facets_cosine(choice->star, facets, f, g, a, b));
        }
    }
    return view;
}

/* ------------------------------------------------------------------------------------------------ umbrellas */

/* Whether a facet of the list continues f across the edge (p, u) without a sharp angle. */
static bool continues(const struct choice *choice, const uint32_t *list, size_t count, uint32_t f, uint32_t p,
                      uint32_t u) {
    for (size_t i = 0; i < count; i++)
        if (list[i] != f && cocone_facets_has(choice->facets, list[i], u) &&
            cocone_facets_cosine(choice->star, choice->facets, f, list[i], p, u) >= SHARP_COSINE)
            return true;
    return false;
}

static bool is_held(const struct choice *choice, const uint32_t *list, size_t count, uint32_t f, uint32_t p) {
    for (int k = 0; k < 3; k++) {
        uint32_t u = choice->facets->vertex[f][k];
        if (u != p && !continues(choice, list, count, f, p, u)) return false;
    }
    return true;
}

/* list: room for the facets around p. */
static bool has_umbrella(const struct choice *choice, uint32_t p, uint32_t *list) {
    const struct cocone_facets *facets = choice->facets;
    size_t count = 0;
    for (uint32_t i = facets->begin[p]; i < facets->begin[p + 1]; i++)
        if (facets->alive[facets->around[i]]) list[count++] = facets->around[i];
    for (bool changed = true; changed && count > 0;) {
        changed = false;
        for (size_t i = 0; i < count;) {
            if (is_held(choice, list, count, list[i], p)) {
                i++;
                continue;
            }
            list[i] = list[--count];
            changed = true;
        }
    }
    return count > 0;
}

static void fix_smooth(struct choice *choice) {
    const struct cocone_facets *facets = choice->facets;
    for (uint32_t f = 0; f < facets->count; f++) {
        choice->fixed[f] = 0;
        for (int k = 0; k < 3; k++) {
            struct edge_view view =
                look_at_edge(choice, facets->vertex[f][edge_of[k][0]], facets->vertex[f][edge_of[k][1]]);
            choice->fixed[f] |= view.count == 2 && view.best >= SMOOTH_COSINE;
        }
    }
}

/* ------------------------------------------------------------------------------------------------ prune */

static void stack_facet(struct choice *choice, uint32_t f) {
    if (choice->stacked[f] || !choice->facets->alive[f]) return;
    choice->stacked[f] = 1;
    choice->stack[choice->depth++] = f;
}

/* Deletes a facet; those at its edges will be looked at again. */
static void delete_facet(struct choice *choice, uint32_t f) {
    struct cocone_facets *facets = choice->facets;
    facets->alive[f] = 0;
    for (int k = 0; k < 3; k++) {
        uint32_t a = facets->vertex[f][edge_of[k][0]], b = facets->vertex[f][edge_of[k][1]];
        for (uint32_t i = facets->begin[a]; i < facets->begin[a + 1]; i++)
            if (cocone_facets_has(facets, facets->around[i], b)) stack_facet(choice, facets->around[i]);
    }
}

static void prune_edge(struct choice *choice, uint32_t a, uint32_t b) {
    const struct cocone_facets *facets = choice->facets;
    if (!choice->umbrella[a] || !choice->umbrella[b]) return;
    struct edge_view view = look_at_edge(choice, a, b);
    if (view.count == 0 || (view.count > 1 && view.best >= SHARP_COSINE)) return;
    for (uint32_t i = facets->begin[a]; i < facets->begin[a + 1]; i++) {
        uint32_t f = facets->around[i];
        if (facets->alive[f] && !choice->fixed[f] && cocone_facets_has(facets, f, b)) delete_facet(choice, f);
    }
}

static void prune(struct choice *choice) {
    const struct cocone_facets *facets = choice->facets;
    choice->depth = 0;
    for (uint32_t f = (uint32_t)facets->count; f-- > 0;) stack_facet(choice, f);
    while (choice->depth > 0) {
        uint32_t f = choice->stack[--choice->depth];
        choice->stacked[f] = 0;
        for (int k = 0; k < 3 && facets->alive[f]; k++)
            prune_edge(choice, facets->vertex[f][edge_of[k][0]], facets->vertex[f][edge_of[k][1]]);
    }
}

/* ------------------------------------------------------------------------------------------------ walk */

static bool is_alive_half(const struct choice *choice, uint32_t half) {
    uint32_t f = choice->facets->of_half[half];
    return f != NONE && choice->facets->alive[f];
}

static void keep(struct choice *choice, uint32_t half) {
    uint32_t f = choice->facets->of_half[half];
    if (choice->kept[f]) return;
    choice->kept[f] = 1;
    for (int k = 0; k < 3; k++) choice->tagged[choice->facets->vertex[f][k]] = 1;
    choice->stack[choice->depth++] = half;
}

/* Turns around the edge, into the cell of the half facet first: keeps the first candidate, deletes the others. */
static void walk_over_edge(struct choice *choice, uint32_t half, uint32_t a, uint32_t b) {
    const struct cocone_star *star = choice->star;
    bool met = false;
    uint32_t at = cocone_star_turn(star, half, a, b);
    while (choice->facets->of_half[at] == NONE || choice->facets->of_half[at] != choice->facets->of_half[half]) {
        if (is_alive_half(choice, at)) {
            uint32_t f = choice->facets->of_half[at];
            if (!met)
                keep(choice, at);
            else if (!choice->kept[f])
                choice->facets->alive[f] = 0;
            met = true;
        }
        at = cocone_star_turn(star, cocone_star_twin(star, at), a, b);
    }
}

static void walk_from(struct choice *choice, uint32_t half) {
    choice->depth = 0;
    keep(choice, half);
    while (choice->depth > 0) {
        uint32_t at = choice->stack[--choice->depth];
        const uint32_t *v = choice->facets->vertex[choice->facets->of_half[at]];
        for (int k = 0; k < 3; k++) {
            uint32_t a = v[edge_of[k][0]], b = v[edge_of[k][1]];
            if (choice->umbrella[a] || choice->umbrella[b]) walk_over_edge(choice, at, a, b);
        }
    }
}

static bool is_full_cell(const struct choice *choice, uint32_t cell) {
    for (unsigned i = 0; i < 4; i++)
        if (!is_alive_half(choice, cocone_star_pack(cell, i))) return false;
    return true;
}

static bool may_start(const struct choice *choice, uint32_t f) {
    const uint32_t *v = choice->facets->vertex[f];
    uint32_t half = choice->facets->half[f], twin = cocone_star_twin(choice->star, half);
    return choice->umbrella[v[0]] && choice->umbrella[v[1]] && choice->umbrella[v[2]] &&
           !is_full_cell(choice, cocone_star_cell(half)) && !is_full_cell(choice, cocone_star_cell(twin));
}

static bool touches_walk(const struct choice *choice, uint32_t f) {
    const uint32_t *v = choice->facets->vertex[f];
    return choice->tagged[v[0]] || choice->tagged[v[1]] || choice->tagged[v[2]];
}

/* Facets that no walk kept go where they touch one. */
static void walk_fans(struct choice *choice) {
    struct cocone_facets *facets = choice->facets;
    for (uint32_t f = 0; f < facets->count; f++) {
        if (!facets->alive[f] || choice->kept[f]) continue;
        if (touches_walk(choice, f))
            facets->alive[f] = 0;
        else if (may_start(choice, f))
            walk_from(choice, facets->half[f]);
    }
    for (uint32_t f = 0; f < facets->count; f++)
        if (!choice->kept[f] && touches_walk(choice, f)) facets->alive[f] = 0;
}

/* ------------------------------------------------------------------------------------------------ good points */

/* The facet alive at the edge (p, u) that isn't f; NONE where there isn't exactly one. */
static uint32_t only_other(const struct cocone_facets *facets, uint32_t p, uint32_t u, uint32_t f) {
    uint32_t other = NONE;
    for (uint32_t i = facets->begin[p]; i < facets->begin[p + 1]; i++) {
        uint32_t g = facets->around[i];
        if (!facets->alive[g] || g == f || !cocone_facets_has(facets, g, u)) continue;
        if (other != NONE) return NONE;
        other = g;
    }
    return other;
}

static size_t count_alive(const struct cocone_facets *facets, uint32_t p, uint32_t *first) {
    size_t count = 0;
    for (uint32_t i = facets->begin[p + 1]; i-- > facets->begin[p];)
        if (facets->alive[facets->around[i]]) count++, *first = facets->around[i];
    return count;
}

/* Goes round p from facet to facet; good when that comes back to the first after all of them, over no fold. */
static bool is_good(const struct choice *choice, uint32_t p) {
    const struct cocone_facets *facets = choice->facets;
    uint32_t first = NONE;
    size_t count = count_alive(facets, p, &first);
    if (count < 3) return false;
    double least = facets->flat[p] ? FOLDED_COSINE : 0;
    uint32_t f = first, u = facets->vertex[f][0] == p ? facets->vertex[f][1] : facets->vertex[f][0];
    for (size_t i = 1; i <= count; i++) {
        uint32_t g = only_other(facets, p, u, f);
        if (g == NONE || cocone_facets_cosine(choice->star, facets, f, g, p, u) <= least) return false;
        if (g == first) return i == count;
        u = cocone_facets_apex(facets, g, p, u);
        f = g;
    }
    return false;
}

enum status cocone_umbrella_choose(const struct cocone_star *star, struct cocone_facets *facets, uint8_t *good) {
    struct choice choice = {.star = star, .facets = facets};
    enum status status = STATUS_NO_MEMORY;
    choice.umbrella = alloc_zeroed(star->n, 1);
    choice.fixed = alloc_zeroed(facets->count, 1);
    choice.kept = alloc_zeroed(facets->count, 1);
    choice.tagged = alloc_zeroed(star->n, 1);
    choice.stacked = alloc_zeroed(facets->count, 1);
    choice.stack = alloc_array(facets->count, sizeof *choice.stack);
    if (!choice.umbrella || !choice.fixed || !choice.kept || !choice.tagged || !choice.stacked || !choice.stack)
        goto out;
    for (uint32_t v = 0; v < choice.star->n; v++) choice.umbrella[v] = has_umbrella(&choice, v, choice.stack);
    fix_smooth(&choice);
    prune(&choice);
    walk_fans(&choice);
    for (uint32_t v = 0; v < star->n; v++) good[v] = is_good(&choice, v);
    status = STATUS_OK;
out:
    free(choice.umbrella), free(choice.fixed), free(choice.kept);
    free(choice.tagged), free(choice.stacked), free(choice.stack);
    return status;
}
