/* Labels by cuts, two at a time.
 *
 *     frames -> lies -> orient -> costs -> cut <-+        frames, lies and costs: cells and points share the work of
 *                                           |    |        all labellings and are shared out among the threads
 *                                           +- turn       orient, cut, turn: each labelling by itself, on one thread
 *
 * Votes depend on which way the normals point, and a vote that is overruled says that its normal points the wrong way.
 * So normals are turned where the labels overrule them, and the cut goes on from there: few are, and nothing else has
 * to be found again.
 *
 * Invariant: while labellings are made side by side nothing is allocated, and only the thread that called asks whether
 * to go on; the other one finds its answer in `stop`.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"

enum { ROUNDS = 3 }; /* of cuts */

/* A labelling in the making. */
struct making {
    const struct cocone_star *star;
    const struct progress *progress;
    const double *sided; /* support, where the normals have sides; else NULL */
    struct cocone_frame *frame;
    struct cocone_lies *lies;
    struct cocone_label *label;
    struct cocone_gathering *gathering;
    struct cocone_voters voters;
    struct cocone_cut *cut;
    uint32_t *doubt; /* room for all points */
    enum status status;
};

/* Asks for all threads. */
struct relay {
    const struct progress *progress;
    pthread_t caller;
    atomic_bool stop;
};

static int relay_tick(void *ctx, const char *stage, double fraction) {
    struct relay *relay = ctx;
    if (pthread_equal(pthread_self(), relay->caller) && progress_tick(relay->progress, stage, fraction))
        atomic_store(&relay->stop, true);
    return atomic_load(&relay->stop);
}

/* ------------------------------------------------------------------------------------------------ one labelling */

static void orient_range(void *ctx, size_t begin, size_t end) {
    for (struct making *m = (struct making *)ctx + begin; m < (struct making *)ctx + end; m++)
        m->label->conflicts = cocone_orient(m->star, m->sided, m->frame, m->lies, m->gathering);
}

/* Turns the normals that the labels overrule; how many. */
static size_t turn(struct making *m) {
    size_t count = cocone_orient_doubt(m->star, m->label->inside, m->lies, m->doubt);
    cocone_cut_change(m->cut, m->doubt, count, -1);
    for (size_t i = 0; i < count; i++) cocone_orient_turn(m->star, m->frame, m->lies, m->doubt[i]);
    cocone_cut_change(m->cut, m->doubt, count, 1);
    return count;
}

static enum status cut_in_rounds(struct making *m) {
    enum status status = cocone_cut_label(m->cut, m->progress, m->label->inside);
    for (int round = 1; round < ROUNDS && !status && turn(m) > 0; round++)
        status = cocone_cut_label(m->cut, m->progress, m->label->inside);
    return status;
}

static void cut_range(void *ctx, size_t begin, size_t end) {
    for (struct making *m = (struct making *)ctx + begin; m < (struct making *)ctx + end; m++)
        m->status = cut_in_rounds(m);
}

/* ------------------------------------------------------------------------------------------------ all of them */

static enum status orient_all(struct making making[], int count, unsigned threads) {
    enum status status = STATUS_OK;
    for (int k = 0; k < count && !status; k++) status = cocone_gathering_new(making[k].star, &making[k].gathering);
    if (!status) par_for(threads, (size_t)count, 1, orient_range, making);
    for (int k = 0; k < count; k++) cocone_gathering_free(making[k].gathering);
    return status;
}

static enum status cut_all(struct making making[], int count, unsigned threads) {
    enum status status = STATUS_OK;
    for (int k = 0; k < count && !status; k++) {
        making[k].doubt = alloc_array(making[k].star->n, sizeof *making->doubt);
        making[k].label->inside = alloc_array(making[k].star->tets->cell_count, 1);
        if (!making[k].doubt || !making[k].label->inside) status = STATUS_NO_MEMORY;
        if (!status) status = cocone_cut_new(&making[k].voters, &making[k].label->cost, &making[k].cut);
    }
    if (!status) par_for(threads, (size_t)count, 1, cut_range, making);
    for (int k = 0; k < count; k++) {
        if (!status) status = making[k].status;
        cocone_cut_free(making[k].cut);
        free(making[k].doubt);
    }
    return status;
}

static void turn_as(struct cocone_frame *frame, const vec3 *normal, size_t n) {
    for (uint32_t v = 0; v < n; v++)
        if (vec3_dot(frame->normal[v], normal[v]) < 0) cocone_frame_turn(frame, v);
}

enum status cocone_label_make(const struct cocone_star *star, const struct reconstruct_input *input, unsigned threads,
                              const struct progress *progress, struct cocone_label label[], int count) {
    struct cocone_frame frame[COCONE_FRAMES] = {{0}};
    struct cocone_lies lies[COCONE_FRAMES] = {{0}};
    struct cocone_cost cost[COCONE_FRAMES] = {{0}};
    struct creases creases = {.of = NULL};
    struct cocone_voters voters = {star, input->support, frame, lies, &creases, input->gaps};
    struct relay relay = {progress, pthread_self(), false};
    struct progress relayed = {relay_tick, &relay};
    struct making making[COCONE_FRAMES];
    for (int k = 0; k < count; k++)
        making[k] = (struct making){.star = star,
                                    .progress = &relayed,
                                    .sided = input->oriented ? input->support : NULL,
                                    .frame = &frame[k],
                                    .lies = &lies[k],
                                    .label = &label[k],
                                    .voters = {star, input->support, &frame[k], &lies[k], &creases, input->gaps}};
    enum status status = cocone_frame_build(star, input->normals, threads, frame, count);
    for (int k = 0; k < count && !status && input->oriented; k++) turn_as(&frame[k], input->normals, star->n);
    if (!status) status = cocone_orient_measure(star, frame, count, threads, lies);
    if (!status) status = orient_all(making, count, threads);
    if (!status) status = cocone_creases_find(input, &creases);
    if (!status) status = cocone_cut_costs(&voters, count, threads, cost);
    for (int k = 0; k < count; k++) label[k].cost = cost[k];
    if (!status) status = cut_all(making, count, threads);
    for (int k = 0; k < count; k++) cocone_frame_done(&frame[k]), cocone_orient_done(&lies[k]);
    free(creases.of);
    return status;
}

void cocone_label_done(struct cocone_label *label) {
    free(label->inside);
    cocone_cost_done(&label->cost);
    *label = (struct cocone_label){0};
}
