/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/components.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"

enum status components_count(const struct mesh *mesh, size_t *count) {
    uint32_t *component = disjoint_set_new(mesh->vertex_count);
    uint8_t *counted = alloc_zeroed(mesh->vertex_count, 1); /* by its root */
    size_t found = 0;
    bool ok = component && counted;
    for (size_t t = 0; t < mesh->triangle_count && ok; t++) {
        const uint32_t *v = mesh->triangle[t];
        disjoint_set_unite(component, v[0], v[1]);
        disjoint_set_unite(component, v[1], v[2]);
    }
    for (size_t t = 0; t < mesh->triangle_count && ok; t++) {
        uint32_t root = disjoint_set_root(component, mesh->triangle[t][0]);
        found += !counted[root], counted[root] = 1;
    }
    if (ok) *count = found;
    free(component), free(counted);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}
