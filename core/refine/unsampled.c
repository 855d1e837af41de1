/* Scanners don't see into folds: such areas have few samples, on the rim alone, which say little of how triangles
 * should lie across, and a long one may end up far from where any reasonable surface would be.  So each sample that is
 * missing there counts in favour of the shorter diagonal, which Delaunay triangles would have.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine_internal.h"

#define SAMPLED 4.0  /* times the samples that there are: what has more area than these should have is unsampled */
#define SHORTER 0.01 /* distance by which a missing sample is nearer to the shorter diagonal, of the difference */

double fit_unsampled_unit_area(const struct fit *fit, double total_weight) {
    const struct mesh *mesh = fit->mesh;
    double area = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) area += vec3_length(mesh_triangle_normal(mesh, t)) / 2;
    return total_weight > 0 ? area / total_weight : INFINITY;
}

double fit_unsampled_gain(const struct fit *fit, const struct fit_region *region, double weight, uint32_t h,
                          const struct surface *made) {
    if (region->reached < region->n) return 0;
    double area = surface_area(made, 0) + surface_area(made, 1);
    double missing = area / fit->unit_area - SAMPLED * weight;
    if (!(missing > 0)) return 0;
    uint32_t g = fit->he.twin[h];
    double before = vec3_distance(fit_corner(fit, h), fit_corner(fit, g));
    double after = vec3_distance(fit_corner(fit, halfedge_prev(h)), fit_corner(fit, halfedge_prev(g)));
    return SHORTER * missing * (before - after);
}
