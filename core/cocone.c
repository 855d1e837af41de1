/* Tight Cocone over flat arrays, step by step.
 *
 *     tets -> star -> frame -> label -----------------------------------> surface
 *             cells   poles,   tight:   orient, cut, judge, repair        manifold mesh
 *             around  normals  literal: candidates, umbrellas, mark, peel
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
#include "core/cocone_cut.h"
#include "core/cocone_facets.h"
#include "core/cocone_frame.h"
#include "core/cocone_judge.h"
#include "core/cocone_orient.h"
#include "core/cocone_peel.h"
#include "core/cocone_repair.h"
#include "core/cocone_star.h"
#include "core/cocone_surface.h"
#include "core/cocone_umbrella.h"

enum { ROUNDS = 3 }; /* of cuts */

struct run {
    const struct cocone_input *input;
    const struct cocone_options *options;
    const struct progress *progress;
    struct cocone_star star;
    struct cocone_frame frame;
    uint8_t *inside; /* of each cell */
    struct cocone_facts facts;
};

static enum status tick(struct run *run, double fraction) {
    return progress_tick(run->progress, "cocone", fraction) ? STATUS_CANCELLED : STATUS_OK;
}

/* Votes depend on which way the normals point, and a vote that is overruled says that its normal points the wrong way.
 */
static enum status label_by_cuts(struct run *run, struct cocone_lies *lies, struct cocone_cost *cost, uint8_t *inside) {
    enum status status = STATUS_OK;
    const double *support = run->input->support;
    size_t turned = 1;
    for (int round = 0; round < ROUNDS && turned > 0 && !status; round++) {
        cocone_cut_done(cost);
        status = cocone_cut_costs(&run->star, &run->frame, lies, support, run->options->threads, cost);
        if (!status) status = cocone_cut_label(&run->star, cost, run->progress, inside);
        if (!status) turned = cocone_orient_by_labels(&run->star, inside, &run->frame, lies);
    }
    return status;
}

/* A labelling with the normals of the frame. */
static enum status label_once(struct run *run, struct cocone_cost *cost, uint8_t *inside, size_t *conflicts) {
    struct cocone_lies lies = {0};
    enum status status = cocone_orient_measure(&run->star, &run->frame, run->options->threads, &lies);
    if (!status) status = cocone_orient(&run->star, &run->frame, &lies, conflicts);
    if (!status) status = label_by_cuts(run, &lies, cost, inside);
    cocone_orient_done(&lies);
    return status;
}

/* Labels once more, with normals from the poles, and takes what is better of that. */
static enum status reconsider(struct run *run) {
    struct cocone_cost cost = {0};
    size_t conflicts;
    uint8_t *other = alloc_zeroed(run->star.tets->cell_count, 1);
    if (!other) return STATUS_NO_MEMORY;
    cocone_frame_done(&run->frame);
    enum status status = cocone_frame_build(&run->star, NULL, run->options->threads, &run->frame);
    if (!status) status = label_once(run, &cost, other, &conflicts);
    cocone_cut_done(&cost);
    if (!status)
        status = cocone_judge(&run->star, run->input->dense, run->options->threads, other, run->inside,
                              &run->facts.reconsidered);
    free(other);
    return status;
}

static enum status label_tight(struct run *run) {
    struct cocone_cost cost = {0};
    enum status status = label_once(run, &cost, run->inside, &run->facts.conflicts);
    if (!status) status = tick(run, 0.5);
    if (!status && run->input->dense && run->input->normals) status = reconsider(run);
    if (!status) status = tick(run, 0.7);
    if (!status) status = cocone_repair(&run->star, &cost, run->progress, run->options->threads, run->inside,
                               &run->facts.flips);
    cocone_cut_done(&cost);
    return status;
}

static enum status label_literal(struct run *run) {
    struct cocone_facets facets = {0};
    uint8_t *good = alloc_zeroed(run->star.n, 1);
    enum status status = good ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = cocone_facets_find(&run->star, &run->frame, &facets);
    if (!status) status = tick(run, 0.5);
    if (!status) status = cocone_umbrella_choose(&run->star, &facets, good);
    if (!status) status = cocone_peel(&run->star, &facets, good, run->inside);
    cocone_facets_done(&facets);
    free(good);
    return status;
}

/* How each form labels the cells; the literal one has its normals from the poles. */
static const struct form {
    const char *name;
    bool dense_normals;
    enum status (*label)(struct run *run);
} forms[] = {
    [COCONE_TIGHT] = {"tight-cocone", true, label_tight},
    [COCONE_LITERAL] = {"literal", false, label_literal},
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
    const vec3 *normals = form->dense_normals ? input->normals : NULL;
    run->facts.form = form->name;
    run->inside = alloc_zeroed(tets->cell_count, 1);
    if (!run->inside) return STATUS_NO_MEMORY;
    enum status status = cocone_star_build(tets, input->points, input->n, &run->star);
    if (!status) status = cocone_frame_build(&run->star, normals, run->options->threads, &run->frame);
    if (!status) status = tick(run, 0.2);
    if (!status) status = form->label(run);
    if (!status) status = tick(run, 0.9);
    bool keep = run->options->boundary == BOUNDARY_KEEP;
    if (!status) status = cocone_surface_extract(&run->star, input->support, keep, run->inside, mesh);
    return status;
}

static enum status reconstruct_plane(struct run *run, const struct tets *tets, struct mesh *mesh) {
    run->facts.form = "planar";
    return cocone_surface_planar(tets, run->input->points, run->input->support, run->options->boundary == BOUNDARY_KEEP,
                                 mesh);
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
    if (!status && made.triangle_count == 0) status = STATUS_DEGENERATE;
    if (!status) {
        count_facts(&run, &made, seen);
        *mesh = made;
        made = (struct mesh){0};
        if (facts) *facts = run.facts;
    }
    mesh_done(&made);
    free(seen), free(run.inside);
    cocone_frame_done(&run.frame);
    cocone_star_done(&run.star);
    return status;
}
