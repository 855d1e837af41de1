/* Tight Cocone: a watertight surface through points, from their Delaunay tetrahedralisation.  Two rows of
 * core/surface/reconstruct.h.
 *
 * T. K. Dey, S. Goswami, Tight Cocone: a water-tight surface reconstructor (2003).  reconstruct_literal is the paper's
 * method rule by rule.  reconstruct_tight, the default, keeps the cocone and the labels of cells, but finds the labels
 * by one cut over all votes and repairs what is left: it needs no point to have a good umbrella, which few have after
 * simplification.
 *
 *     tets -> star -> label ----------------------------------------------> surface
 *             cells   tight:   frame, orient, cut (twice), judge, repair     manifold mesh
 *             around  literal: frame, candidates, umbrellas, mark, peel
 *
 * Whatever the labels, the surface between inner and outer cells is closed and oriented; the labelling decides how good
 * it is, and the last step makes it a manifold.
 *
 * Normals that were fitted to the original points are better than those of the poles, but for thin parts, where a
 * neighbourhood reaches through to the other side.  There are two labellings therefore, one with each, and the original
 * points judge between them where they differ.
 *
 * Whether there is a solid at all is asked of the first labelling (struct reconstruct_probe), and where that leaves a
 * doubt after each step: what follows takes most of the time, and changes less and less of the area that no points are
 * at.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/surface/cocone/cocone_internal.h"
#include "core/surface/cocone/handles.h"
#include "core/surface/cocone/judge.h"
#include "core/surface/cocone/star.h"
#include "core/surface/cocone/surface.h"
#include "core/surface/reconstruct.h"

#define MATTERS 0.02 /* so that nothing is changed for a hair's breadth */

struct run {
    const struct reconstruct_input *input;
    const struct progress *progress;
    unsigned threads;
    struct cocone_star star;
    uint8_t *inside;                       /* of each cell */
    struct mesh rough;                     /* is enough; without triangles: there is none, or it isn't */
    const struct reconstruct_probe *probe; /* NULL: nobody asks, or not any more */
    struct reconstruct_facts *facts;
};

static enum status tick(struct run *run, double fraction) {
    return progress_tick(run->progress, "cocone", fraction) ? STATUS_CANCELLED : STATUS_OK;
}

/* Takes of both labellings what lies nearer to the original points. */
static enum status judge(struct run *run, struct cocone_label label[COCONE_FRAMES]) {
    struct cocone_proposal proposal = {.inside = label[1].inside, .patience = 1, .matters = MATTERS};
    return cocone_judge(&run->star, run->input->dense, run->threads, &proposal, label[0].inside,
                        &run->facts->reconsidered);
}

/* The surface of a labelling, as it is, where that is enough. */
static enum status ask_probe(struct run *run, const uint8_t *label, enum reconstruct_stage stage) {
    size_t cells = run->star.tets->cell_count;
    const struct reconstruct_probe *probe = run->probe;
    if (!probe) return STATUS_OK;
    uint8_t *inside = alloc_array(cells, 1);
    enum reconstruct_answer answer = ANSWER_GO_ON;
    enum status status = inside ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) memcpy(inside, label, cells);
    if (!status) status = cocone_surface_extract(&run->star, run->input->support, run->threads, inside, &run->rough);
    if (!status && run->rough.triangle_count > 0) status = probe->is_enough(probe->ctx, &run->rough, stage, &answer);
    free(inside);
    if (answer != ANSWER_ASK_AGAIN) run->probe = NULL;
    if (status || answer != ANSWER_ENOUGH) mesh_done(&run->rough);
    return status;
}

static bool is_enough(const struct run *run) { return run->rough.triangle_count > 0; }

static enum status repair_labelling(struct run *run, struct cocone_label *label) {
    const struct reconstruct_dense *dense = run->input->dense;
    unsigned threads = run->threads;
    struct cocone_handles_input input = {&run->star,         &label->cost,     dense,  run->progress,
                                         run->input->pieces, run->input->bars, threads};
    enum status status =
        cocone_repair(&run->star, &label->cost, run->progress, threads, label->inside, &run->facts->flips);
    if (!status) status = ask_probe(run, label->inside, STAGE_REPAIRED);
    if (!status && dense && !is_enough(run))
        status = cocone_handles_close(&input, label->inside, &run->facts->closed, &run->facts->too_many_pieces);
    return status;
}

/* With the normals given and with those of the poles; takes what is better of each. */
static enum status label_tight(struct run *run) {
    struct cocone_label label[COCONE_FRAMES] = {{0}};
    const struct reconstruct_input *input = run->input;
    int count = input->dense && input->normals ? 2 : 1;
    enum status status = cocone_label_make(&run->star, input, run->threads, run->progress, label, count);
    if (!status) status = tick(run, 0.6);
    if (!status) status = ask_probe(run, label[0].inside, STAGE_LABELLED);
    if (!status && count == 2 && !is_enough(run)) {
        status = judge(run, label);
        if (!status) status = ask_probe(run, label[0].inside, STAGE_JUDGED);
    }
    cocone_label_done(&label[1]);
    if (!status) status = tick(run, 0.7);
    if (!status && !is_enough(run)) status = repair_labelling(run, &label[0]);
    run->facts->conflicts = label[0].conflicts;
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
    if (!status) status = cocone_frame_build(&run->star, NULL, run->threads, &frame, 1);
    if (!status) status = cocone_facets_find(&run->star, &frame, &facets);
    if (!status) status = tick(run, 0.5);
    if (!status) status = cocone_umbrella_choose(&run->star, &facets, good);
    if (!status) status = cocone_peel(&run->star, &facets, good, run->inside);
    cocone_facets_done(&facets);
    cocone_frame_done(&frame);
    free(good);
    return status;
}

static enum status reconstruct_labelled(const struct reconstruct_task *task, enum status (*label)(struct run *run),
                                        struct mesh *mesh, struct reconstruct_facts *facts) {
    const struct reconstruct_input *input = task->input;
    struct run run = {.input = input,
                      .progress = task->progress,
                      .threads = task->options->threads,
                      .probe = task->options->probe,
                      .facts = facts};
    enum status status = cocone_star_build(task->tets, input->points, input->n, run.threads, &run.star);
    if (!status) status = tick(&run, 0.2);
    if (!status) status = label(&run);
    if (!status) status = tick(&run, 0.9);
    if (!status && is_enough(&run))
        *mesh = run.rough, run.rough = (struct mesh){0};
    else if (!status)
        status = cocone_surface_extract(&run.star, input->support, run.threads, run.inside, mesh);
    mesh_done(&run.rough);
    free(run.inside);
    cocone_star_done(&run.star);
    return status;
}

enum status reconstruct_tight(const struct reconstruct_task *task, struct mesh *mesh, struct reconstruct_facts *facts) {
    return reconstruct_labelled(task, label_tight, mesh, facts);
}

enum status reconstruct_literal(const struct reconstruct_task *task, struct mesh *mesh,
                                struct reconstruct_facts *facts) {
    return reconstruct_labelled(task, label_literal, mesh, facts);
}
