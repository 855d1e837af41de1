/* Planes through a point that explain where its neighbours are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/sheets.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/sym3.h"
#include "core/spatial/directions.h"

#define SMOOTH 0.15     /* root mean square of the sines between a plane and what lies on it */
#define TURN 0.8        /* cosine between sheets, at most */
#define SURROUNDED 2.6  /* widest angle between neighbours around a point within a sheet */
#define UNEXPLAINED 0.1 /* of the neighbours, that are on no sheet */

enum { GRAIN = 1024, MOST = DIRECTIONS_MOST, LEAST = 6 };

struct search {
    const vec3 *point, *normal;
    const struct neighbourhood *neighbours;
    struct creases *creases;
};

static unsigned count_bits(uint32_t bits) { return (unsigned)__builtin_popcount(bits); }

static vec3 fit_plane(const struct directions *d, uint32_t on) {
    sym3 moment = {0};
    double value[3];
    vec3 axis[3];
    for (unsigned i = 0; i < d->n; i++)
        if (on >> i & 1) moment = sym3_add(moment, sym3_outer(d->to[i]));
    sym3_eigen(moment, value, axis);
    return axis[0];
}

/* Whether the directions on a plane leave no wide angle between them. */
static bool is_all_around(const struct directions *d, uint32_t on, vec3 normal) {
    double angle[MOST];
    unsigned n = 0;
    vec3 u, v;
    vec3_basis(normal, &u, &v);
    for (unsigned i = 0; i < d->n; i++) {
        if (!(on >> i & 1)) continue;
        double a = atan2(vec3_dot(d->to[i], v), vec3_dot(d->to[i], u));
        unsigned at = n++;
        for (; at > 0 && angle[at - 1] > a; at--) angle[at] = angle[at - 1];
        angle[at] = a;
    }
    for (unsigned i = 0; i < n; i++) {
        double next = i + 1 < n ? angle[i + 1] : angle[0] + 2 * M_PI;
        if (next - angle[i] > SURROUNDED) return false;
    }
    return n > 0;
}

/* Whether what is on the plane of one sheet alone is at one side of the other's, but for what is farther off than the
 * other itself: no sheet goes on behind another. */
static bool ends_at(const struct directions *d, uint32_t own, uint32_t others, vec3 other) {
    unsigned sides[2] = {0, 0}, first[2] = {MOST, MOST}, first_other = MOST;
    for (unsigned i = d->n; i-- > 0;) {
        int side = vec3_dot(d->to[i], other) < 0;
        if (own >> i & 1 & ~(others >> i)) sides[side]++, first[side] = i;
        if (others >> i & 1 & ~(own >> i)) first_other = i;
    }
    return first[sides[0] >= sides[1]] > first_other;
}

static bool meet(const struct directions *d, const struct sheets *sheets, const uint32_t *on) {
    for (unsigned k = 0; k < sheets->count; k++)
        for (unsigned m = 0; m < sheets->count; m++)
            if (k != m && !ends_at(d, on[k], on[m], sheets_normal(sheets, m))) return false;
    return sheets->count > 1;
}

/* Whether the neighbours of p are elsewhere than about its plane; their directions are set then. */
static bool is_rough(const struct search *search, size_t p, struct directions *d) {
    const struct neighbourhood *neighbours = search->neighbours;
    double sines = 0;
    d->n = neighbours->count[p] < MOST ? neighbours->count[p] : MOST;
    for (unsigned i = 0; i < d->n; i++) {
        d->to[i] = vec3_unit(vec3_sub(search->point[neighbours->id[p * neighbours->stride + i]], search->point[p]));
        double sine = vec3_dot(d->to[i], search->normal[p]);
        sines += sine * sine;
    }
    return d->n >= LEAST && sines >= SMOOTH * SMOOTH * d->n;
}

static void add_sheet(struct sheets *sheets, vec3 normal, vec3 side) {
    if (vec3_dot(normal, side) < 0) normal = vec3_scale(normal, -1);
    float *to = sheets->normal[sheets->count++];
    to[0] = (float)normal.x, to[1] = (float)normal.y, to[2] = (float)normal.z;
}

/* Sheet by sheet, until all neighbours are on one.  Where that fails, a first one all around the point is alone. */
static struct sheets explain(const struct directions *d, vec3 side) {
    struct sheets sheets = {.count = 0};
    uint32_t left = ((uint32_t)1 << d->n) - 1, on[SHEETS_MOST];
    bool alone = false;
    while (sheets.count < SHEETS_MOST) {
        vec3 plane;
        if (!directions_find_plane(d, left, &plane, &on[sheets.count])) break;
        plane = fit_plane(d, on[sheets.count]);
        on[sheets.count] = directions_near_plane(d, plane);
        if (sheets.count > 0 && sheets_agreement(&sheets, plane) > TURN) break;
        if (sheets.count == 0) alone = is_all_around(d, on[0], plane);
        left &= ~on[sheets.count];
        add_sheet(&sheets, plane, side);
        if (count_bits(left) > UNEXPLAINED * d->n) continue;
        if (meet(d, &sheets, on)) return sheets;
        break;
    }
    sheets.count = alone;
    return sheets;
}

static void mark_range(void *ctx, size_t begin, size_t end) {
    const struct search *search = ctx;
    struct directions d;
    for (size_t p = begin; p < end; p++) search->creases->of[p] = is_rough(search, p, &d) ? 0 : NONE;
}

static void explain_range(void *ctx, size_t begin, size_t end) {
    const struct search *search = ctx;
    struct directions d;
    for (size_t p = begin; p < end; p++) {
        uint32_t *of = &search->creases->of[p];
        if (*of == NONE || !is_rough(search, p, &d)) continue;
        directions_set(&d);
        search->creases->at[*of] = explain(&d, search->normal[p]);
        if (search->creases->at[*of].count == 0) *of = NONE;
    }
}

static bool is_on_several(const struct creases *creases, uint32_t p) {
    const struct sheets *sheets = creases_at(creases, p);
    return sheets && sheets->count > 1;
}

static bool is_on_line(const struct search *search, size_t p) {
    const struct neighbourhood *neighbours = search->neighbours;
    unsigned like_it = 0;
    if (!is_on_several(search->creases, (uint32_t)p)) return false;
    for (unsigned i = 0; i < neighbours->count[p]; i++)
        like_it += is_on_several(search->creases, neighbours->id[p * neighbours->stride + i]);
    return like_it >= 2;
}

enum status creases_find(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbours,
                         unsigned threads, struct creases *creases) {
    struct creases new = {.of = alloc_array(neighbours->n, sizeof *new.of)};
    struct search search = {point, normal, neighbours, &new};
    uint32_t count = 0;
    if (!new.of) return STATUS_NO_MEMORY;
    if (neighbours->noisy)
        memset(new.of, 0xff, neighbours->n * sizeof *new.of);
    else
        par_for(threads, neighbours->n, GRAIN, mark_range, &search);
    for (size_t p = 0; p < neighbours->n; p++)
        if (new.of[p] != NONE) new.of[p] = count++;
    new.at = alloc_array(count, sizeof *new.at);
    if (!new.at) {
        creases_done(&new);
        return STATUS_NO_MEMORY;
    }
    if (count > 0) par_for(threads, neighbours->n, GRAIN, explain_range, &search);
    for (size_t p = 0; p < neighbours->n; p++) {
        new.several += is_on_several(&new, (uint32_t)p);
        new.on_lines += is_on_line(&search, p);
    }
    *creases = new;
    return STATUS_OK;
}

void creases_done(struct creases *creases) {
    free(creases->of), free(creases->at);
    *creases = (struct creases){.of = NULL};
}
