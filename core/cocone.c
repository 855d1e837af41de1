/* Tight Cocone over flat arrays, step by step.
 *
 *     tets -> star -> label ----------------------------------------------> surface
 *             cells   tight:   frame, orient, cut (twice), judge, repair     manifold mesh
 *             around  literal: frame, candidates, umbrellas, mark, peel                |
 *                                                            boundary=keep: without what spans holes
 *
 * Whatever the labels, the surface between inner and outer cells is closed and oriented; the labelling decides how good
 * it is, and the last step makes it a manifold.
 *
 * Normals that were fitted to the original points are better than those of the poles, but for thin parts, where a
 * neighbourhood reaches through to the other side.  There are two labellings therefore, one with each, and the original
 * points judge between them where they differ.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cocone.h"

#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/cocone_facets.h"
#include "core/cocone_handles.h"
#include "core/cocone_holes.h"
#include "core/cocone_judge.h"
#include "core/cocone_label.h"
#include "core/cocone_peel.h"
#include "core/cocone_repair.h"
#include "core/cocone_star.h"
#include "core/cocone_surface.h"
#include "core/cocone_umbrella.h"
#include "core/halfedge.h"
#include "core/mesh_without.h"

#define MATTERS 0.02 /* so that nothing is changed for a hair's breadth */

struct run {
    const struct cocone_input *input;
    const struct cocone_options *options;
    const struct progress *progress;
    struct cocone_star star;
    uint8_t *inside; /* of each cell */
    struct cocone_facts facts;
};

static enum status tick(struct run *run, double fraction) {
    return progress_tick(run->progress, "cocone", fraction) ? STATUS_CANCELLED : STATUS_OK;
}

/* Takes of both labellings what lies nearer to the original points. */
static enum status judge(struct run *run, struct cocone_label label[COCONE_FRAMES]) {
    struct cocone_proposal proposal = {.inside = label[1].inside, .patience = 1, .matters = MATTERS};
    return cocone_judge(&run->star, run->input->dense, run->options->threads, &proposal, label[0].inside,
                        &run->facts.reconsidered);
}

static enum status mend(struct run *run, struct cocone_label *label) {
    const struct cocone_dense *dense = run->input->dense;
    unsigned threads = run->options->threads;
    struct cocone_handles_input input = {&run->star, &label->cost, dense, run->progress, threads};
    enum status status =
        cocone_repair(&run->star, &label->cost, run->progress, threads, label->inside, &run->facts.flips);
    if (!status && dense) status = cocone_handles_close(&input, label->inside, &run->facts.closed);
    return status;
}

/* With the normals given and with those of the poles; takes what is better of each. */
static enum status label_tight(struct run *run) {
    struct cocone_label label[COCONE_FRAMES] = {{0}};
    const struct cocone_input *input = run->input;
    int count = input->dense && input->normals ? 2 : 1;
    enum status status = cocone_label_make(&run->star, input, run->options->threads, run->progress, label, count);
    if (!status) status = tick(run, 0.6);
    if (!status && count == 2) status = judge(run, label);
    cocone_label_done(&label[1]);
    if (!status) status = tick(run, 0.7);
    if (!status) status = mend(run, &label[0]);
    run->facts.conflicts = label[0].conflicts;
    run->inside = label[0].inside;
    label[0].inside = NULL;
    cocone_label_done(&label[0]);
    return status;
}

static enum status label_literal(struct run *run) {
    struct cocone_frame frame = {0};
    struct cocone_facets facets = {0};
    uint8_t *good = alloc_zeroed(run->star.n, 1);
    run->inside = alloc_zeroed(run->star.tets->cell_count, 1);
    enum status status = good && run->inside ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = cocone_frame_build(&run->star, NULL, run->options->threads, &frame, 1);
    if (!status) status = cocone_facets_find(&run->star, &frame, &facets);
    if (!status) status = tick(run, 0.5);
    if (!status) status = cocone_umbrella_choose(&run->star, &facets, good);
    if (!status) status = cocone_peel(&run->star, &facets, good, run->inside);
    cocone_facets_done(&facets);
    cocone_frame_done(&frame);
    free(good);
    return status;
}

/* How each form labels the cells. */
static const struct form {
    const char *name;
    enum status (*label)(struct run *run);
} forms[] = {
    [COCONE_TIGHT] = {"tight-cocone", label_tight},
    [COCONE_LITERAL] = {"literal", label_literal},
};

static void count_facts(struct run *run, const struct mesh *mesh, uint8_t *seen) {
    memset(seen, 0, run->input->n);
    size_t found = 0;
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        found += !seen[mesh->source[v]];
        seen[mesh->source[v]] = 1;
    }
    run->facts.points_lost = run->input->n - found;
    run->facts.vertices_split = mesh->vertex_count - found;
    for (size_t t = 0; t < mesh->triangle_count; t++) run->facts.hole_fill += mesh->tag[t] == MESH_HOLE_FILL;
}

static enum status reconstruct_solid(struct run *run, const struct tets *tets, struct mesh *mesh) {
    const struct cocone_input *input = run->input;
    const struct form *form = &forms[run->options->form];
    run->facts.form = form->name;
    enum status status = cocone_star_build(tets, input->points, input->n, run->options->threads, &run->star);
    if (!status) status = tick(run, 0.2);
    if (!status) status = form->label(run);
    if (!status) status = tick(run, 0.9);
    if (!status) status = cocone_surface_extract(&run->star, input->support, run->options->threads, run->inside, mesh);
    return status;
}

static enum status reconstruct_plane(struct run *run, const struct tets *tets, struct mesh *mesh) {
    run->facts.form = "planar";
    return cocone_surface_planar(tets, run->input->points, run->input->support, mesh);
}

/* Leaves out what spans holes: by the original points, or where those aren't known by the facets' tags. */
static enum status open_holes(struct run *run, struct mesh *mesh) {
    const struct cocone_input *input = run->input;
    struct halfedge he = {0};
    uint8_t *hole = alloc_array(mesh->triangle_count, 1);
    enum status status = hole ? halfedge_init(&he, mesh, run->options->threads) : STATUS_NO_MEMORY;
    if (!status && input->dense) {
        status = cocone_holes_find(mesh, &he, input->dense, input->n, run->options->threads, hole);
        for (size_t t = 0; !status && t < mesh->triangle_count; t++)
            mesh->tag[t] = hole[t] ? MESH_HOLE_FILL : MESH_SUPPORTED;
    }
    for (size_t t = 0; !status && t < mesh->triangle_count; t++) {
        hole[t] = mesh->tag[t] == MESH_HOLE_FILL;
        run->facts.hole_fill += hole[t];
    }
    if (!status) status = mesh_without(mesh, &he, hole);
    halfedge_done(&he);
    free(hole);
    return status;
}

enum status cocone_reconstruct(const struct tets *tets, const struct cocone_input *input,
                               const struct cocone_options *options, const struct progress *progress, struct mesh *mesh,
                               struct cocone_facts *facts) {
    struct run run = {.input = input, .options = options, .progress = progress};
    struct mesh made = {0};
    uint8_t *seen = alloc_array(input->n, 1);
    enum status status = seen ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status && tets->dimension < 2) status = STATUS_DEGENERATE;
    if (!status) status = (tets->dimension == 2 ? reconstruct_plane : reconstruct_solid)(&run, tets, &made);
    if (!status && options->boundary == BOUNDARY_KEEP && made.triangle_count > 0) status = open_holes(&run, &made);
    if (!status && made.triangle_count == 0) status = STATUS_DEGENERATE;
    if (!status) {
        count_facts(&run, &made, seen);
        *mesh = made;
        made = (struct mesh){0};
        if (facts) *facts = run.facts;
    }
    mesh_done(&made);
    free(seen), free(run.inside);
    cocone_star_done(&run.star);
    return status;
}
