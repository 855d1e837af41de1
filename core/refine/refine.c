/* The schedule: up to FIRST_ROUNDS rounds of flips, then sweeps of reallocations, moves and flips; where vertices move
 * freely, with more samples from sweep `before_closer` on; at last what crosses is parted.
 *
 * Everything works on a copy of the mesh, which takes its place at the end.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine.h"

#include "core/refine/fit.h"
#include "core/refine/refine_internal.h"

/* By placement.  Vertices that move freely gain from more sweeps, and from a closer look at the surface between the
 * points, which isn't needed before triangles and vertices are about where they should be.  A surface with a border
 * gains from more sweeps as well: what lies beyond the border is reached from sweep to sweep; but not at points that
 * were smoothed, as the last sweeps would fit the noise that is left.  A mesh that was collapsed to the best places
 * takes fewer, and one of the surface itself, not of a reconstruction, fewer still and no closer look: the surface's
 * own triangles tell it. before_closer = all: there is no closer look. */
static const struct sweeps {
    size_t all, with_reallocations, before_closer;
} sweeps_of[] = {[PLACEMENT_SUBSET] = {5, 3, 5}, [PLACEMENT_OPTIMAL] = {9, 6, 4}}, settled_sweeps = {5, 3, 2},
  exact_sweeps = {5, 2, 5}, smoothed_sweeps = {5, 3, 5},
  open_sweeps_of[] = {[PLACEMENT_SUBSET] = {7, 6, 7}, [PLACEMENT_OPTIMAL] = {9, 6, 4}};

enum { FIRST_ROUNDS = 12, ROUNDS = 2 };

enum { REASSIGNED = 3 }; /* sweeps after which samples beyond a border may be another triangle's */

enum { CALM = 2 }; /* the last sweeps with reallocations, which fold the surface nowhere for a split's sake */

#define LARGEST ((size_t)1 << 28) /* points or triangles */

static enum status sweep(struct fit *fit, bool with_reallocations, struct refine_facts *facts) {
    enum status status = STATUS_OK;
    if (with_reallocations) status = fit_reallocate(fit, &facts->reallocations);
    if (!status && with_reallocations) status = fit_flip(fit, ROUNDS, &facts->flips);
    if (!status) status = fit_move(fit, &facts->moves);
    if (!status) status = fit_flip(fit, ROUNDS, &facts->flips);
    return status;
}

static enum status run_schedule(struct fit *fit, enum refine_form form, const struct progress *progress,
                                struct refine_facts *facts) {
    struct sweeps sweeps = (fit->borders ? open_sweeps_of : sweeps_of)[fit->placement];
    if (fit->input->settled && !fit->borders && fit->placement == PLACEMENT_OPTIMAL)
        sweeps = fit->input->exact ? exact_sweeps : settled_sweeps;
    if (fit->input->smoothed && fit->borders && fit->placement == PLACEMENT_SUBSET) sweeps = smoothed_sweeps;
    if (form != REFINE_FULL) sweeps = (struct sweeps){0};
    bool has_creases = fit->fold < 0 && !fit->has_up; /* the points have creases, along which the surface may fold */
    if (progress_tick(progress, "refine", 0.1)) return STATUS_CANCELLED;
    enum status status = fit_flip(fit, FIRST_ROUNDS, &facts->flips);
    for (size_t i = 0; i < sweeps.all && !status; i++) {
        if (progress_tick(progress, "refine", 0.2 + 0.8 * (double)i / (double)sweeps.all)) return STATUS_CANCELLED;
        if (i == sweeps.before_closer && fit_may_look_closer(fit))
            status = fit_look_closer(fit);
        else if (fit->borders && i > 0 && i % REASSIGNED == 0 && i + 1 < sweeps.all)
            status = fit_reassign(fit);
        fit->leaps = has_creases && i + CALM < sweeps.with_reallocations;
        if (!status) status = sweep(fit, i < sweeps.with_reallocations, facts);
    }
    if (!status) status = fit_uncross(fit, form == REFINE_FULL, &facts->uncrossed);
    return status;
}

bool refine_uses_local_delaunay(size_t points, size_t triangles) {
    return (double)points < FIT_ENOUGH * (double)triangles;
}

enum status refine_mesh(struct mesh *mesh, const struct refine_input *input, const struct refine_options *options,
                        const struct progress *progress, struct refine_facts *facts) {
    struct fit fit = {0};
    struct mesh refined = {0};
    struct refine_facts made = {0};
    if (input->n >= LARGEST || mesh->triangle_count >= LARGEST) return STATUS_LIMIT;
    if (progress_tick(progress, "refine", 0)) return STATUS_CANCELLED;
    enum status status = mesh_copy(&refined, mesh);
    if (!status) status = fit_init(&fit, &refined, input, options);
    if (!status) {
        if (facts) made.mean_before = fit_mean(&fit);
        if (options->form != REFINE_NONE) status = run_schedule(&fit, options->form, progress, &made);
        if (facts && !status) made.mean_after = fit_mean(&fit);
    }
    fit_done(&fit);
    if (!status) {
        struct mesh before = *mesh;
        *mesh = refined;
        refined = before;
        if (facts) *facts = made;
    }
    mesh_done(&refined);
    return status;
}
