/* Closing what is too narrow to be known of.
 *
 * Where two parts of a surface are nearer to each other than its points, a cell between them may end up with a wrong
 * label, and then there is a bridge from one to the other, or a tunnel through a thin wall.  Each has a loop of few
 * edges around it that is no boundary of a piece of surface (loops.h).  A disc spanned into the loop lies inside,
 * across a bridge, or outside, across a tunnel:
 *
 *        _____       _____          the loop goes around the bridge, and its disc is in the cells of the bridge:
 *       in    \_____/               relabelled, they cut it, while those of a disc across a tunnel close it
 *        _____(_____)_____
 *
 * The cells that the disc runs through are flipped and the repair mends what that does to the points around; of such
 * changes those count that take a handle away and lose nothing.  The original points judge them: a true tunnel has
 * no points across its mouth, a true bridge has some all around.
 *
 *     mesh -> loops -> discs -> trials, apart from each other -> judge -> again until nothing changes
 *
 * With as many points, a handle less is four triangles less (Euler), so trials need no mesh to be counted.
 *
 * Invariant: a round whose surface hasn't fewer handles and shells than the one before is taken back.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cocone_handles.h"

#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/cloud.h"
#include "core/cocone_disc.h"
#include "core/cocone_judge.h"
#include "core/cocone_repair.h"
#include "core/cocone_surface.h"
#include "core/loops.h"

enum {
    ROUNDS_MOST = 24,
    LOOPS_PER_ROUND = 256,
    ATTEMPTS = 2,             /* for each loop */
    STEPS_PER_TRIANGLE = 200, /* of the search for loops */
    FACETS_OF_HANDLE = 4
};

#define PATIENCE 1.25 /* how many times as far from the points a surface with a handle less may be */

static const double shift[] = {1e-3, 0.2}; /* of discs, to either side */

struct handles {
    const struct cocone_handles_input *input;
    const struct cocone_star *star;
    uint8_t *inside, *before, *other; /* as they are; before the last round; with all trials */
    uint32_t *group;                  /* of each cell of a trial: which */
    uint8_t *touched;                 /* of each vertex: a trial of this round has it */
    struct cocone_repair *repair;
    struct cocone_repair_trial *trial; /* of this round: LOOPS_PER_ROUND */
    size_t trials;
    uint64_t *tried; /* fingerprints of loops */
    size_t tried_count, tried_room;
};

/* ------------------------------------------------------------------------------------------------ counting */

static uint32_t root_of(uint32_t *parent, uint32_t v) {
    for (; parent[v] != v; v = parent[v]) parent[v] = parent[parent[v]];
    return v;
}

/* Unites the shells that v0 and v1 are of; how many shells that is less. */
static size_t unite(uint32_t *parent, uint32_t v0, uint32_t v1) {
    uint32_t a = root_of(parent, v0), b = root_of(parent, v1);
    parent[a] = b;
    return a != b;
}

static uint32_t *new_forest(size_t n) {
    uint32_t *parent = alloc_array(n, sizeof *parent);
    for (uint32_t v = 0; parent && v < n; v++) parent[v] = v;
    return parent;
}

/* Shells beyond the first one, and handles, of a closed mesh: V - E + F = 2 (shells - handles). */
static enum status count_excess(const struct mesh *mesh, size_t *excess) {
    size_t shells = mesh->vertex_count;
    uint32_t *parent = new_forest(mesh->vertex_count);
    if (!parent) return STATUS_NO_MEMORY;
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 2; k++) shells -= unite(parent, mesh->triangle[t][k], mesh->triangle[t][k + 1]);
    free(parent);
    long euler = (long)mesh->vertex_count - (long)(mesh->triangle_count / 2);
    *excess = (size_t)(2 * (long)shells - 1 - euler / 2);
    return STATUS_OK;
}

/* Whether the surface is one sphere through all points.  With a point lost, or two vertices at one, it isn't found to
 * be. */
static enum status is_sphere(const struct handles *h, bool *sphere) {
    const struct tets *tets = h->star->tets;
    size_t facets = 0, shells = h->star->n;
    uint32_t *parent = new_forest(h->star->n);
    if (!parent) return STATUS_NO_MEMORY;
    for (uint32_t half = 0; half < 4 * tets->finite_count; half++) {
        uint32_t cell = cocone_star_cell(half), v[3];
        if (!h->inside[cell] || h->inside[tets->neighbour[cell][cocone_star_index(half)]]) continue;
        cocone_star_vertices(h->star, half, v);
        facets++;
        for (int k = 0; k < 2; k++) shells -= unite(parent, v[k], v[k + 1]);
    }
    free(parent);
    *sphere = shells == 1 && facets + 4 == 2 * h->star->n;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ trials */

/* How often the loop was tried before; it counts as tried once more from then on.  Loops are told apart by a sum of
 * cubes, which doesn't depend on where they begin. */
static enum status count_attempts(struct handles *h, const uint32_t *point, size_t count, int *attempts) {
    uint64_t fingerprint = 0;
    *attempts = 0;
    for (uint64_t k = 0; k < count; k++) fingerprint += (point[k] + 1ull) * (point[k] + 1ull) * (point[k] + 1ull);
    for (size_t i = 0; i < h->tried_count; i++) *attempts += h->tried[i] == fingerprint;
    if (h->tried_count == h->tried_room) {
        size_t room = 2 * h->tried_room + LOOPS_PER_ROUND;
        uint64_t *grown = alloc_resize(h->tried, room, sizeof *grown);
        if (!grown) return STATUS_NO_MEMORY;
        h->tried = grown, h->tried_room = room;
    }
    if (*attempts < ATTEMPTS) h->tried[h->tried_count++] = fingerprint;
    return STATUS_OK;
}

/* A change that takes handles away and loses nothing. */
static bool is_sound(const struct cocone_repair_trial *trial) {
    return trial->count > 0 && trial->defects <= 0 && trial->facets <= -FACETS_OF_HANDLE;
}

/* Of trials that are sound or empty. */
static bool is_better(const struct cocone_repair_trial *a, const struct cocone_repair_trial *b) {
    if (a->count == 0 || b->count == 0) return b->count == 0;
    return a->cost != b->cost ? a->cost < b->cost : a->count < b->count;
}

/* The trial of one disc; its count is 0 where it isn't sound. */
static void try_disc(struct handles *h, const struct cocone_disc *disc, struct cocone_repair_trial *trial) {
    uint32_t cell[COCONE_REPAIR_TRIAL_CELLS];
    size_t count = cocone_disc_cells(h->star, h->inside, disc, cell, COCONE_REPAIR_TRIAL_CELLS);
    trial->count = 0;
    if (count > 0) cocone_repair_try(h->repair, cell, count, trial);
    if (!is_sound(trial)) trial->count = 0;
}

/* Tries the discs nearest to the loop that have a sound trial, on either side of it: at the first attempt the better
 * side, at the second one the other.  trial->count is 0 where there is none. */
static void try_loop(struct handles *h, const uint32_t *point, size_t count, int attempt,
                     struct cocone_repair_trial *trial) {
    struct cocone_repair_trial side[2];
    side[0].count = side[1].count = 0;
    for (size_t i = 0; i < sizeof shift / sizeof *shift && side[0].count + side[1].count == 0; i++) {
        try_disc(h, &(struct cocone_disc){point, count, -shift[i]}, &side[0]);
        try_disc(h, &(struct cocone_disc){point, count, shift[i]}, &side[1]);
    }
    int first = is_better(&side[1], &side[0]);
    *trial = side[attempt == 0 ? first : !first];
}

static bool is_apart(const struct handles *h, const struct cocone_repair_trial *trial) {
    bool apart = true;
    for (size_t k = 0; k < trial->count; k++)
        for (int i = 0; i < 4; i++) apart = apart && !h->touched[h->star->tets->vertex[trial->cell[k]][i]];
    return apart;
}

static void touch(struct handles *h, const struct cocone_repair_trial *trial, uint8_t touched) {
    for (size_t k = 0; k < trial->count; k++)
        for (int i = 0; i < 4; i++) h->touched[h->star->tets->vertex[trial->cell[k]][i]] = touched;
}

static void add_trial(struct handles *h, const struct cocone_repair_trial *trial) {
    for (size_t k = 0; k < trial->count; k++) {
        h->other[trial->cell[k]] ^= 1;
        h->group[trial->cell[k]] = (uint32_t)h->trials;
    }
    touch(h, trial, 1);
    h->trial[h->trials++] = *trial;
}

static bool is_free(const struct handles *h, const uint32_t *point, size_t count) {
    bool free = true;
    for (size_t k = 0; k < count; k++) free = free && !h->touched[point[k]];
    return free;
}

/* Tries loops that weren't tried before, those apart from each other. */
static enum status propose(struct handles *h, const struct mesh *mesh, const struct loops *loops) {
    enum status status = STATUS_OK;
    for (size_t i = 0; i < loops->count && h->trials < LOOPS_PER_ROUND && !status; i++) {
        uint32_t point[LOOPS_MOST_EDGES];
        const struct loop *loop = &loops->loop[i];
        struct cocone_repair_trial trial;
        int attempts = 0;
        for (size_t k = 0; k < loop->count; k++) point[k] = mesh->source[loop->vertex[k]];
        if (!is_free(h, point, loop->count)) continue;
        if (progress_tick(h->input->progress, "cocone", 0.8)) status = STATUS_CANCELLED;
        if (!status) status = count_attempts(h, point, loop->count, &attempts);
        if (status || attempts == ATTEMPTS) continue;
        try_loop(h, point, loop->count, attempts, &trial);
        if (trial.count > 0 && is_apart(h, &trial)) add_trial(h, &trial);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ rounds */

/* Has the trials judged, and takes the good ones. */
static enum status decide(struct handles *h, size_t *taken) {
    struct cocone_proposal proposal = {h->other, h->group, (uint32_t)h->trials, PATIENCE, 0};
    const struct cocone_handles_input *input = h->input;
    size_t cells;
    *taken = 0;
    memcpy(h->before, h->inside, h->star->tets->cell_count);
    enum status status = cocone_judge(h->star, input->dense, input->threads, &proposal, h->inside, &cells);
    for (size_t i = 0; i < h->trials && !status; i++) {
        uint32_t cell = h->trial[i].cell[0];
        bool take = h->inside[cell] != h->before[cell];
        *taken += take;
        if (take) cocone_repair_forget(h->repair, &h->trial[i]);
        for (size_t k = 0; k < h->trial[i].count; k++) h->other[h->trial[i].cell[k]] = h->inside[h->trial[i].cell[k]];
        touch(h, &h->trial[i], 0);
    }
    h->trials = 0;
    return status;
}

/* Loops of one mesh, as long as there are new ones, until some are closed. */
static enum status close_some(struct handles *h, const struct mesh *mesh, size_t *taken) {
    struct loops loops = {0};
    enum status status = loops_find(mesh, STEPS_PER_TRIANGLE * mesh->triangle_count, &loops);
    bool more = true;
    *taken = 0;
    while (more && *taken == 0 && !status) {
        status = propose(h, mesh, &loops);
        more = h->trials > 0;
        if (!status && more) status = decide(h, taken);
    }
    loops_done(&loops);
    return status;
}

/* A mesh of the labels as they are; the labels themselves stay. */
static enum status make_mesh(const struct handles *h, struct mesh *mesh) {
    uint8_t *copy = alloc_array(h->star->tets->cell_count, 1);
    if (!copy) return STATUS_NO_MEMORY;
    memcpy(copy, h->inside, h->star->tets->cell_count);
    enum status status = cocone_surface_extract(h->star, NULL, false, h->input->threads, copy, mesh);
    free(copy);
    return status;
}

static enum status close_all(struct handles *h, size_t *closed) {
    enum status status = STATUS_OK;
    size_t least = SIZE_MAX, taken = 1;
    for (int round = 0; round < ROUNDS_MOST && taken > 0 && least > 0 && !status; round++) {
        struct mesh mesh = {0};
        size_t excess = 0;
        status = make_mesh(h, &mesh);
        if (!status) status = count_excess(&mesh, &excess);
        if (!status && excess >= least) {
            memcpy(h->inside, h->before, h->star->tets->cell_count);
            taken = 0;
        } else if (!status) {
            if (round > 0) *closed += least - excess;
            least = excess;
            status = close_some(h, &mesh, &taken);
        }
        mesh_done(&mesh);
    }
    return status;
}

static enum status handles_init(struct handles *h) {
    const struct cocone_star *star = h->star;
    h->before = alloc_array(star->tets->cell_count, 1);
    h->other = alloc_array(star->tets->cell_count, 1);
    h->group = alloc_array(star->tets->cell_count, sizeof *h->group);
    h->touched = alloc_zeroed(star->n, 1);
    h->trial = alloc_array(LOOPS_PER_ROUND, sizeof *h->trial);
    if (!h->before || !h->other || !h->group || !h->touched || !h->trial) return STATUS_NO_MEMORY;
    memcpy(h->other, h->inside, star->tets->cell_count);
    return cocone_repair_new(star, h->input->cost, h->inside, &h->repair);
}

static void handles_done(struct handles *h) {
    free(h->before), free(h->other), free(h->group);
    free(h->touched), free(h->trial), free(h->tried);
    cocone_repair_free(h->repair);
}

enum status cocone_handles_close(const struct cocone_handles_input *input, uint8_t *inside, size_t *closed) {
    struct handles h = {.input = input, .star = input->star, .inside = inside};
    bool sphere;
    size_t count = 0;
    enum status status = is_sphere(&h, &sphere);
    if (!status && !sphere) {
        status = handles_init(&h);
        if (!status) status = close_all(&h, &count);
        handles_done(&h);
    }
    if (!status) *closed = count;
    return status;
}
