/* Each range of cells notes which of their facets are listed, and how many; once it is known where its part of the list
 * begins it writes that.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/boundary.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"

enum { GRAIN = 4096 };

struct listing {
    const struct cocone_star *star;
    const uint8_t *inside, *near;
    uint8_t *facets; /* of each finite cell: a bit for each facet that is listed */
    size_t *begin;   /* of each range of cells: first its facets' number, then where they begin */
    uint32_t *half;
};

static bool is_listed(const struct listing *l, uint32_t half) {
    uint32_t v[3];
    if (!cocone_boundary_has(l->star, l->inside, half)) return false;
    if (!l->near) return true;
    cocone_star_vertices(l->star, half, v);
    return l->near[v[0]] || l->near[v[1]] || l->near[v[2]];
}

static void note_range(void *ctx, size_t begin, size_t end) {
    const struct listing *l = ctx;
    size_t count = 0;
    for (uint32_t c = (uint32_t)begin; c < end; c++) {
        unsigned facets = 0;
        for (unsigned i = 0; i < 4 && l->inside[c]; i++) facets |= (unsigned)is_listed(l, cocone_star_pack(c, i)) << i;
        l->facets[c] = (uint8_t)facets;
        count += (size_t)__builtin_popcount(facets);
    }
    l->begin[begin / GRAIN] = count;
}

static void write_range(void *ctx, size_t begin, size_t end) {
    const struct listing *l = ctx;
    uint32_t *half = &l->half[l->begin[begin / GRAIN]];
    for (uint32_t c = (uint32_t)begin; c < end; c++)
        for (unsigned i = 0; l->facets[c] >> i; i++)
            if (l->facets[c] >> i & 1) *half++ = cocone_star_pack(c, i);
}

static size_t place_ranges(struct listing *l, size_t ranges) {
    size_t before = 0;
    for (size_t r = 0; r < ranges; r++) {
        size_t count = l->begin[r];
        l->begin[r] = before;
        before += count;
    }
    return before;
}

enum status cocone_boundary_list(const struct cocone_star *star, const uint8_t *inside, const uint8_t *near,
                                 unsigned threads, uint32_t **half, size_t *count) {
    struct listing l = {.star = star, .inside = inside, .near = near};
    size_t cells = star->tets->finite_count, found = 0;
    l.facets = alloc_array(cells, 1);
    l.begin = alloc_array(cells / GRAIN + 1, sizeof *l.begin);
    if (l.facets && l.begin) {
        par_for(threads, cells, GRAIN, note_range, &l);
        found = place_ranges(&l, (cells + GRAIN - 1) / GRAIN);
        l.half = alloc_array(found, sizeof *l.half);
    }
    if (l.half) par_for(threads, cells, GRAIN, write_range, &l);
    free(l.facets), free(l.begin);
    if (!l.half) return STATUS_NO_MEMORY;
    *half = l.half, *count = found;
    return STATUS_OK;
}
