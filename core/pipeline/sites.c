/* The points that a mesh has its vertices at.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/pipeline/pipeline_run.h"

/* The points that stand for themselves, and the index of each among them. */
static void number_sites(const struct run *run, struct sites *sites, uint32_t *index) {
    const vec3 *normal = pipeline_normals_told(run);
    uint32_t i = 0;
    for (uint32_t p = 0; p < run->points.count; p++) {
        if (sites->of_point[p] != p) continue;
        sites->id[i] = p;
        sites->point[i] = run->points.point[p];
        sites->normal[i] = normal[p];
        sites->support[i] = 0;
        index[p] = i++;
    }
}

/* support = max over the points that a site stands for of the distance to it + the spacing there. */
static void find_support(const struct run *run, const uint32_t *index, struct sites *sites) {
    for (size_t x = 0; x < run->points.count; x++) {
        uint32_t i = sites->of_point[x] = index[sites->of_point[x]];
        double reach = vec3_distance(run->points.point[x], sites->point[i]) + (double)run->neighbours.spacing[x];
        sites->support[i] = fmax(sites->support[i], reach);
    }
}

enum status pipeline_sites_of(const struct run *run, size_t k, struct sites *sites) {
    *sites = (struct sites){.count = k};
    uint32_t *index = alloc_array(run->points.count, sizeof *index);
    sites->id = alloc_array(k, sizeof *sites->id);
    sites->point = alloc_array(k, sizeof *sites->point);
    sites->normal = alloc_array(k, sizeof *sites->normal);
    sites->support = alloc_array(k, sizeof *sites->support);
    sites->of_point = alloc_array(run->points.count, sizeof *sites->of_point);
    bool ok = index && sites->id && sites->point && sites->normal && sites->support && sites->of_point;
    if (ok) {
        contraction_representatives(&run->contraction, k, sites->of_point);
        number_sites(run, sites, index);
        find_support(run, index, sites);
    }
    free(index);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

void pipeline_sites_done(struct sites *sites) {
    free(sites->id), free(sites->point), free(sites->normal), free(sites->support), free(sites->of_point);
    *sites = (struct sites){0};
}
