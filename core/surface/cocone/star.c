/* Stars by counting: corners are sorted by their vertex in two passes over the cells.
 *
 * Invariant: two cells of a triangulation never have all four vertices in common, so the mirror of a facet is found by
 * its vertices, also where two infinite cells share more than one facet.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/star.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"

enum { MAX_CELLS = 1 << 30, GRAIN = 4096 };

const uint8_t cocone_star_facet[4][3] = {{1, 3, 2}, {0, 2, 3}, {0, 3, 1}, {0, 1, 2}};

/* By the cells beside the other one, or where this is beside it twice, by the vertex that the two don't share. */
static unsigned find_mirror(const struct tets *tets, uint32_t cell, unsigned i) {
    uint32_t other = tets->neighbour[cell][i];
    unsigned found = 0, times = 0;
    for (unsigned j = 0; j < 4; j++)
        if (tets->neighbour[other][j] == cell) found = j, times++;
    for (unsigned j = 0; j < 4 && times > 1; j++) {
        bool shared = false;
        for (unsigned k = 0; k < 4; k++) shared |= k != i && tets->vertex[cell][k] == tets->vertex[other][j];
        if (!shared) return j;
    }
    return found;
}

static void mirror_range(void *ctx, size_t begin, size_t end) {
    const struct cocone_star *star = ctx;
    for (uint32_t c = (uint32_t)begin; c < end; c++)
        for (unsigned i = 0; i < 4; i++) star->mirror[c][i] = (uint8_t)find_mirror(star->tets, c, i);
}

static void list_corners(struct cocone_star *star) {
    const struct tets *tets = star->tets;
    for (uint32_t c = 0; c < tets->cell_count; c++)
        for (unsigned i = 0; i < 4; i++)
            if (tets->vertex[c][i] != NONE) star->begin[tets->vertex[c][i] + 1]++;
    for (size_t v = 0; v < star->n; v++) star->begin[v + 1] += star->begin[v];
    /* Filled from the back, begin[v + 1] moves down to where v's corners begin: one place late, put right after. */
    for (uint32_t c = (uint32_t)tets->cell_count; c-- > 0;)
        for (unsigned i = 4; i-- > 0;)
            if (tets->vertex[c][i] != NONE)
                star->corner[--star->begin[tets->vertex[c][i] + 1]] = cocone_star_pack(c, i);
    for (size_t v = 0; v < star->n; v++) star->begin[v] = star->begin[v + 1];
    star->begin[star->n] = (uint32_t)(4 * tets->finite_count + 3 * (tets->cell_count - tets->finite_count));
}

enum status cocone_star_build(const struct tets *tets, const vec3 *point, size_t n, unsigned threads,
                              struct cocone_star *out) {
    if (tets->cell_count >= MAX_CELLS) return STATUS_LIMIT;
    struct cocone_star star = {.tets = tets, .point = point, .n = n};
    star.mirror = alloc_array(tets->cell_count, sizeof *star.mirror);
    star.begin = alloc_zeroed(n + 1, sizeof *star.begin);
    star.corner = alloc_array(4 * tets->cell_count, sizeof *star.corner);
    if (!star.mirror || !star.begin || !star.corner) {
        cocone_star_done(&star);
        return STATUS_NO_MEMORY;
    }
    list_corners(&star);
    par_for(threads, tets->cell_count, GRAIN, mirror_range, &star);
    *out = star;
    return STATUS_OK;
}

void cocone_star_done(struct cocone_star *star) {
    free(star->mirror);
    free(star->begin);
    free(star->corner);
    *star = (struct cocone_star){0};
}

vec3 cocone_star_hull_normal(const struct cocone_star *star, uint32_t cell) {
    unsigned i = 0;
    while (i < 3 && star->tets->vertex[cell][i] != NONE) i++;
    uint32_t v[3];
    cocone_star_vertices(star, cocone_star_pack(cell, i), v);
    return vec3_unit(vec3_triangle_normal(star->point[v[0]], star->point[v[1]], star->point[v[2]]));
}
