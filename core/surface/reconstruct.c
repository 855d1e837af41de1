/* What all reconstructions have in common: points on one plane, holes that stay open, and what is counted.
 *
 *     tets -- dimension 3: the method's row --- boundary=keep: without what spans holes --- mesh
 *         \-- dimension 2: their planar triangles --/
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/reconstruct.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/mesh/halfedge.h"
#include "core/mesh/submesh.h"
#include "core/surface/cocone/holes.h"
#include "core/surface/cocone/surface.h"
#include "core/surface/sheet/sheet.h"

#define ROW(constant, name, reported, what, source) [RECONSTRUCTION_##constant] = {reported, reconstruct_##name},
static const struct method {
    const char *reported;
    enum status (*reconstruct)(const struct reconstruct_task *task, struct mesh *mesh, struct reconstruct_facts *facts);
} methods[RECONSTRUCTIONS] = {RECONSTRUCTION_ROWS(ROW)};
#undef ROW

static enum status reconstruct_plane(const struct reconstruct_task *task, struct mesh *mesh,
                                     struct reconstruct_facts *facts) {
    facts->form = "planar";
    return cocone_surface_planar(task->tets, task->input->points, task->input->support, mesh);
}

static enum status reconstruct_solid(const struct reconstruct_task *task, struct mesh *mesh,
                                     struct reconstruct_facts *facts) {
    assert(task->options->method < RECONSTRUCTIONS);
    const struct method *method = &methods[task->options->method];
    facts->form = method->reported;
    return method->reconstruct(task, mesh, facts);
}

/* Leaves out what spans holes: by the original points, or where those aren't known by the facets' tags. */
static enum status open_holes(const struct reconstruct_task *task, struct mesh *mesh, struct reconstruct_facts *facts) {
    const struct reconstruct_input *input = task->input;
    unsigned threads = task->options->threads;
    struct halfedge he = {0};
    uint8_t *hole = alloc_array(mesh->triangle_count, 1);
    enum status status = hole ? halfedge_init(&he, mesh, threads) : STATUS_NO_MEMORY;
    if (!status && input->dense) {
        status = cocone_holes_find(mesh, &he, input->dense, input->n, threads, hole);
        for (size_t t = 0; !status && t < mesh->triangle_count; t++)
            mesh->tag[t] = hole[t] ? MESH_HOLE_FILL : MESH_SUPPORTED;
    }
    for (size_t t = 0; !status && t < mesh->triangle_count; t++) {
        hole[t] = mesh->tag[t] == MESH_HOLE_FILL;
        facts->hole_fill += hole[t];
    }
    if (!status) status = submesh_without(mesh, &he, hole);
    halfedge_done(&he);
    free(hole);
    return status;
}

static void count_facts(const struct mesh *mesh, size_t points, uint8_t *seen, struct reconstruct_facts *facts) {
    memset(seen, 0, points);
    size_t found = 0;
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        found += !seen[mesh->source[v]];
        seen[mesh->source[v]] = 1;
    }
    facts->points_lost = points - found;
    facts->vertices_split = mesh->vertex_count - found;
    for (size_t t = 0; t < mesh->triangle_count; t++) facts->hole_fill += mesh->tag[t] == MESH_HOLE_FILL;
}

/* Hands a mesh over with its facts, unless it is empty. */
static enum status hand_over(struct mesh *made, size_t points, struct reconstruct_facts *found, struct mesh *mesh,
                             struct reconstruct_facts *facts) {
    if (made->triangle_count == 0) return STATUS_DEGENERATE;
    uint8_t *seen = alloc_array(points, 1);
    if (!seen) return STATUS_NO_MEMORY;
    count_facts(made, points, seen, found);
    free(seen);
    *mesh = *made;
    *made = (struct mesh){0};
    if (facts) *facts = *found;
    return STATUS_OK;
}

enum status reconstruct_surface(const struct tets *tets, const struct reconstruct_input *input,
                                const struct reconstruct_options *options, const struct progress *progress,
                                struct mesh *mesh, struct reconstruct_facts *facts) {
    struct reconstruct_task task = {tets, input, options, progress};
    struct reconstruct_facts found = {0};
    struct mesh made = {0};
    if (tets->dimension < 2) return STATUS_DEGENERATE;
    enum status status = (tets->dimension == 2 ? reconstruct_plane : reconstruct_solid)(&task, &made, &found);
    if (!status && options->boundary == BOUNDARY_KEEP && made.triangle_count > 0)
        status = open_holes(&task, &made, &found);
    if (!status) status = hand_over(&made, input->n, &found, mesh, facts);
    mesh_done(&made);
    return status;
}

enum status reconstruct_sheet(const struct tets *tets, const struct reconstruct_input *input,
                              const struct reconstruct_options *options, const struct progress *progress,
                              struct mesh *mesh, struct reconstruct_facts *facts, struct error *error) {
    bool field = options->surface == SURFACE_HEIGHTFIELD;
    struct reconstruct_facts found = {.form = field             ? "delaunay-2d"
                                              : options->viewed ? "delaunay-of-view"
                                                                : "advancing-front"};
    struct mesh made = {0};
    enum status status =
        field ? sheet_heightfield(input, options->up, options->landscape, options->threads, progress, &made, error)
        : options->viewed ? sheet_viewed(input, options->view, options->threads, progress, &made, error)
                          : sheet_open(tets, input, options->threads, progress, &made);
    if (!status) status = hand_over(&made, input->n, &found, mesh, facts);
    mesh_done(&made);
    return status;
}
