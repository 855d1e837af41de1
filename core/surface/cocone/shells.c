/* Shells are the components of the mesh; a point that several have counts for the one that has it first.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/cloud/cloud.h"

struct shells {
    const struct cocone_star *star;
    uint32_t *of_point; /* n: which shell has it; NONE = no one */
    struct cocone_shell *shell;
    size_t count, largest;
};

/* Numbers the shells in the order of their first vertices. */
static enum status find_shells(struct shells *s, const struct mesh *mesh) {
    uint32_t *parent = disjoint_set_new(mesh->vertex_count);
    uint32_t *number = alloc_array(mesh->vertex_count, sizeof *number); /* of each root: its shell */
    s->of_point = alloc_array(s->star->n, sizeof *s->of_point);
    s->shell = alloc_zeroed(mesh->vertex_count, sizeof *s->shell);
    bool ok = parent && number && s->of_point && s->shell;
    for (size_t t = 0; ok && t < mesh->triangle_count; t++)
        for (int k = 0; k < 2; k++) disjoint_set_unite(parent, mesh->triangle[t][k], mesh->triangle[t][k + 1]);
    if (ok) memset(s->of_point, 0xff, s->star->n * sizeof *s->of_point);
    for (uint32_t v = 0; ok && v < mesh->vertex_count; v++) {
        uint32_t root = disjoint_set_root(parent, v), point = mesh->source[v];
        if (root == v) number[v] = (uint32_t)s->count++;
        uint32_t shell = number[root];
        s->shell[shell].vertices++;
        s->shell[shell].fingerprint += cocone_shells_fingerprint(point);
        if (s->of_point[point] == NONE) s->of_point[point] = shell;
    }
    free(parent), free(number);
    for (size_t i = 1; ok && i < s->count; i++)
        if (s->shell[i].vertices > s->shell[s->largest].vertices) s->largest = i;
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

static double size_sq_of(const struct shells *s, const uint32_t v[4]) {
    double size_sq = 0;
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < i; k++)
            size_sq = fmax(size_sq, vec3_distance_sq(s->star->point[v[i]], s->star->point[v[k]]));
    return size_sq;
}

/* Keeps the smallest. */
static void add_cell(struct cocone_shell *shell, uint32_t cell, double size_sq) {
    size_t k = shell->count < COCONE_SHELLS_CELLS ? shell->count++ : COCONE_SHELLS_CELLS;
    for (; k > 0 && size_sq < shell->size_sq[k - 1]; k--) {
        if (k == COCONE_SHELLS_CELLS) continue;
        shell->cell[k] = shell->cell[k - 1], shell->size_sq[k] = shell->size_sq[k - 1];
    }
    if (k < COCONE_SHELLS_CELLS) shell->cell[k] = cell, shell->size_sq[k] = size_sq;
}

static void add_cells(struct shells *s) {
    const struct tets *tets = s->star->tets;
    for (uint32_t c = 0; c < tets->finite_count; c++) {
        const uint32_t *v = tets->vertex[c];
        uint32_t own[4];
        bool same = true;
        for (int i = 0; i < 4; i++) own[i] = s->of_point[v[i]], same = same && own[i] == own[0];
        if (same) continue;
        for (int i = 0; i < 4; i++) {
            bool again = own[i] == NONE || own[i] == s->largest;
            for (int k = 0; k < i; k++) again = again || own[k] == own[i];
            if (!again) add_cell(&s->shell[own[i]], c, size_sq_of(s, v));
        }
    }
}

enum status cocone_shells_list(const struct cocone_star *star, const struct mesh *mesh, struct cocone_shell **shell,
                               size_t *count) {
    struct shells s = {.star = star};
    enum status status = find_shells(&s, mesh);
    if (!status) {
        if (s.count > 1) add_cells(&s);
        s.count -= s.count > 0;
        s.shell[s.largest] = s.shell[s.count];
        *shell = s.shell, *count = s.count;
        s.shell = NULL;
    }
    free(s.of_point), free(s.shell);
    return status;
}
