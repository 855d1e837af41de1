/* Labels by cuts, two at a time.
 *
 *     frames -> lies -> orient -> costs -> cut <-+        frames, lies and costs: cells and points share the work of
 *                                           |    |        all labellings and are shared out among the threads
 *                                           +- turn       orient, cut, turn: each labelling by itself, on one thread
 *
 * Of half of the original points or more, which poles tell enough of, the two orientations are compared, and each takes
 * of the other what the cells say to be better (groups.c).
 *
 * Votes depend on which way the normals point, and a vote that is overruled says that its normal points the wrong way.
 * So normals are turned where the labels overrule them, and the cut goes on from there: few are, and nothing else has
 * to be found again.
 *
 * Invariant: while labellings are made side by side nothing is allocated, and only the thread that called asks whether
 * to go on; the other one finds its answer in `stop`.
 *
 * Where spanning gaps is to cost little, normals that point the wrong way make webs across them.  So labels are first
 * found at the usual price, which overrules such normals; then those that were turned stay so unless the cells say
 * otherwise, and the cut goes on from there at the lower price.
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
    double gaps;                 /* what spanning them costs in the end, see struct reconstruct_input */
    struct cocone_groups groups; /* of what was turned */
    uint32_t *list;              /* room for all points */
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

static void turn_listed(struct making *m, size_t count) {
    cocone_cut_change(m->cut, m->list, count, -1);
    for (size_t i = 0; i < count; i++) {
        cocone_orient_turn(m->star, m->frame, m->lies, m->list[i]);
        m->groups.marked[m->list[i]] ^= 1;
    }
    cocone_cut_change(m->cut, m->list, count, 1);
}

static enum status cut_in_rounds(struct making *m) {
    enum status status = cocone_cut_label(m->cut, m->progress, m->label->inside);
    for (int round = 1; round < ROUNDS && !status; round++) {
        size_t overruled = cocone_orient_doubt(m->star, m->label->inside, m->lies, m->list);
        if (!overruled) break;
        turn_listed(m, overruled);
        status = cocone_cut_label(m->cut, m->progress, m->label->inside);
    }
    return status;
}

static enum status label_one(struct making *m) {
    enum status status = cut_in_rounds(m);
    if (status || m->gaps == 1) return status;
    turn_listed(m, cocone_groups_against(m->star, m->lies, &m->groups, m->list));
    cocone_cut_span_gaps(m->cut, m->gaps);
    return cut_in_rounds(m);
}

static void label_range(void *ctx, size_t begin, size_t end) {
    for (struct making *m = (struct making *)ctx + begin; m < (struct making *)ctx + end; m++) m->status = label_one(m);
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
        status = cocone_groups_new(making[k].star->n, &making[k].groups);
        making[k].list = alloc_array(making[k].star->n, sizeof *making->list);
        making[k].label->inside = alloc_array(making[k].star->tets->cell_count, 1);
        if (!making[k].list || !making[k].label->inside) status = STATUS_NO_MEMORY;
        if (!status) status = cocone_cut_new(&making[k].voters, &making[k].label->cost, &making[k].cut);
    }
    if (!status) par_for(threads, (size_t)count, 1, label_range, making);
    for (int k = 0; k < count; k++) {
        if (!status) status = making[k].status;
        cocone_cut_free(making[k].cut);
        cocone_groups_done(&making[k].groups);
        free(making[k].list);
    }
    return status;
}

/* Of two orientations each takes from the other one what its own cells say to be better. */
static enum status reconcile(const struct cocone_star *star, struct cocone_frame frame[], struct cocone_lies lies[]) {
    struct cocone_groups groups = {0};
    uint32_t *list = alloc_array(star->n, sizeof *list);
    enum status status = cocone_groups_new(star->n, &groups);
    if (!list) status = STATUS_NO_MEMORY;
    for (uint32_t v = 0; v < star->n && !status; v++)
        groups.marked[v] = star->begin[v] < star->begin[v + 1] && vec3_dot(frame[0].normal[v], frame[1].normal[v]) < 0;
    for (int k = 0; k < COCONE_FRAMES && !status; k++) {
        size_t count = cocone_groups_against(star, &lies[k], &groups, list);
        for (size_t i = 0; i < count; i++) cocone_orient_turn(star, &frame[k], &lies[k], list[i]);
    }
    cocone_groups_done(&groups);
    free(list);
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
    struct cocone_voters voters = {star, input->support, frame, lies, &creases, 1};
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
                                    .voters = {star, input->support, &frame[k], &lies[k], &creases, 1},
                                    .gaps = input->gaps > 0 ? input->gaps : 1};
    enum status status = cocone_frame_build(star, input->normals, threads, frame, count);
    for (int k = 0; k < count && !status && input->oriented; k++) turn_as(&frame[k], input->normals, star->n);
    if (!status) status = cocone_orient_measure(star, frame, count, threads, lies);
    if (!status) status = orient_all(making, count, threads);
    bool many = input->dense && 2 * input->n >= input->dense->n;
    if (!status && count == COCONE_FRAMES && many && !input->oriented) status = reconcile(star, frame, lies);
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
