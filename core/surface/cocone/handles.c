/* Closing what is too narrow to be known of.
 *
 * Where two parts of a surface are nearer to each other than its points, a cell between them may end up with a wrong
 * label, and then there is a bridge from one to the other, or a tunnel through a thin wall.  Each has a loop of few
 * edges around it that is no boundary of a piece of surface (surface/handle_loops.h).  A disc spanned into the loop
 * lies inside, across a bridge, or outside, across a tunnel:
 *
 *        _____       _____          the loop goes around the bridge, and its disc is in the cells of the bridge:
 *       in    \_____/               relabelled, they cut it, while those of a disc across a tunnel close it
 *        _____(_____)_____
 *
 * The cells that the disc runs through are flipped and the repair mends what that does to the points around; of such
 * changes those count that take a handle away and lose nothing.  A shell too many, a piece that has come off or a
 * bubble in a wall, is joined to another one in the same way, by a cell that has vertices of both.  The original points
 * judge: a true tunnel has no points across its mouth, a true bridge has some all around, and so has a true gap on both
 * sides.  A bar that is hardly thicker than its points are apart is as near to them where it is cut, so of bodies of
 * such bars what is a tube for a way stays (surface/tubes.h).
 *
 *     mesh -> loops, shells -> discs, cells -> trials, apart from each other -> judge -> again until nothing changes
 *
 * Trials need no mesh: V - E + F (Euler) is counted around their cells.
 *
 * Invariant: a round whose surface hasn't fewer handles and shells than the one before is taken back.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/handles.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/cloud/cloud.h"
#include "core/surface/cocone/boundary.h"
#include "core/surface/cocone/cocone_internal.h"
#include "core/surface/cocone/judge.h"
#include "core/surface/cocone/surface.h"
#include "core/surface/handle_loops.h"
#include "core/surface/tubes.h"

enum {
    ROUNDS_MOST = 24,
    TRIALS_PER_ROUND = 2048,
    ATTEMPTS = 2,             /* for each loop */
    STEPS_PER_TRIANGLE = 400, /* of all searches for loops */
    ONE_HANDLE_LESS = 2,      /* what it changes V - E + F by */
    ONE_SHELL_LESS = -2
};

/* Of the pieces too many, and so many in any case: of 15 up to six have been joined, of 50 up to five. */
static const double JOINED_MOST = 0.25, JOINED_FEW = 8;

/* What a surface with a handle or a shell less may be farther from the points by. */
#define PATIENCE 1.25 /* times as far */
#define HAIR 0.02     /* of the size of the facets that differ */

static const double shift[] = {1e-3, 0.2}; /* of discs, to either side */

struct handles {
    const struct cocone_handles_input *input;
    const struct cocone_star *star;
    uint8_t *inside, *before, *other; /* as they are; before the last round; with all trials */
    uint32_t *group;                  /* of each cell of a trial: which */
    uint8_t *touched;                 /* of each vertex: a trial of this round has it */
    struct cocone_repair *repair;
    struct cocone_repair_trial *trial; /* of this round: TRIALS_PER_ROUND */
    size_t trials;
    uint64_t *tried; /* fingerprints of loops */
    size_t tried_count, tried_room;
    size_t steps; /* of the search for loops that are left */
};

/* Where a surface has too much. */
struct places {
    const struct mesh *mesh;
    struct loops loops;
    struct cocone_shell *shell; /* owned */
    size_t shells;
};

/* ------------------------------------------------------------------------------------------------ counting */

/* Shells beyond the first one, and handles, of a closed mesh: V - E + F = 2 (shells - handles). */
static enum status count_excess(const struct mesh *mesh, size_t *excess) {
    size_t shells = mesh->vertex_count;
    uint32_t *parent = disjoint_set_new(mesh->vertex_count);
    if (!parent) return STATUS_NO_MEMORY;
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 2; k++)
            shells -= disjoint_set_unite(parent, mesh->triangle[t][k], mesh->triangle[t][k + 1]);
    free(parent);
    long euler = (long)mesh->vertex_count - (long)(mesh->triangle_count / 2);
    *excess = (size_t)(2 * (long)shells - 1 - euler / 2);
    return STATUS_OK;
}

static int by_size(const void *a, const void *b) {
    uint32_t first = *(const uint32_t *)a, second = *(const uint32_t *)b;
    return (first < second) - (first > second);
}

/* Whether too many pieces are left, even if the largest of those that may have to be joined are. */
static enum status find_too_many(const struct mesh *mesh, const struct reconstruct_pieces *pieces, bool *too_many) {
    size_t n = mesh->vertex_count, count = 0, left = 0;
    uint32_t *parent = disjoint_set_new(n), *size = alloc_zeroed(n, sizeof *size);
    bool room = parent && size;
    for (size_t t = 0; room && t < mesh->triangle_count; t++)
        for (int k = 0; k < 2; k++) disjoint_set_unite(parent, mesh->triangle[t][k], mesh->triangle[t][k + 1]);
    for (uint32_t v = 0; room && v < n; v++) size[disjoint_set_root(parent, v)]++;
    for (size_t v = 0; room && v < n; v++)
        if (size[v]) size[count++] = size[v];
    if (room && count > pieces->most) {
        size_t joined = (size_t)fmax(JOINED_FEW, JOINED_MOST * (double)(count - pieces->most));
        qsort(size, count, sizeof *size, by_size);
        for (size_t i = pieces->most + joined; i < count; i++) left += size[i];
    }
    *too_many = (double)left > pieces->left_out * (double)n;
    free(parent), free(size);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

/* Whether the vertices of some facets are all connected. */
static enum status are_one_shell(const struct cocone_star *star, const uint32_t *half, size_t count, bool *one) {
    size_t shells = star->n;
    uint32_t *parent = disjoint_set_new(star->n);
    if (!parent) return STATUS_NO_MEMORY;
    for (size_t t = 0; t < count; t++) {
        uint32_t v[3];
        cocone_star_vertices(star, half[t], v);
        for (int k = 0; k < 2; k++) shells -= disjoint_set_unite(parent, v[k], v[k + 1]);
    }
    free(parent);
    *one = shells == 1;
    return STATUS_OK;
}

/* Whether the surface is one sphere through all points.  With a point lost, or two vertices at one, it isn't found to
 * be. */
static enum status is_sphere(const struct handles *h, bool *sphere) {
    uint32_t *half = NULL;
    size_t count = 0;
    enum status status = cocone_boundary_list(h->star, h->inside, NULL, h->input->threads, &half, &count);
    *sphere = false;
    if (!status && count + 4 == 2 * h->star->n) status = are_one_shell(h->star, half, count, sphere);
    free(half);
    return status;
}

/* ------------------------------------------------------------------------------------------------ trials */

/* How often what has this fingerprint was tried before; it counts as tried once more from then on. */
static enum status count_attempts(struct handles *h, uint64_t fingerprint, int *attempts) {
    *attempts = 0;
    for (size_t i = 0; i < h->tried_count; i++) *attempts += h->tried[i] == fingerprint;
    if (h->tried_count == h->tried_room) {
        size_t room = 2 * h->tried_room + TRIALS_PER_ROUND;
        uint64_t *grown = alloc_resize(h->tried, room, sizeof *grown);
        if (!grown) return STATUS_NO_MEMORY;
        h->tried = grown, h->tried_room = room;
    }
    if (*attempts < ATTEMPTS) h->tried[h->tried_count++] = fingerprint;
    return STATUS_OK;
}

/* Doesn't depend on where the loop begins. */
static uint64_t fingerprint_of(const uint32_t *point, size_t count) {
    uint64_t sum = 0;
    for (size_t k = 0; k < count; k++) sum += cocone_shells_fingerprint(point[k]);
    return sum;
}

/* Of trials that are sound or empty. */
static bool is_better_trial(const struct cocone_repair_trial *a, const struct cocone_repair_trial *b) {
    if (a->count == 0 || b->count == 0) return b->count == 0;
    return a->cost != b->cost ? a->cost < b->cost : a->count < b->count;
}

/* The trial of some seeds; its count is 0 where it loses something, or where V - E + F doesn't change as it should. */
static void try_cells(struct handles *h, const uint32_t *cell, size_t count, int euler,
                      struct cocone_repair_trial *trial) {
    trial->count = 0;
    if (count > 0) cocone_repair_try(h->repair, cell, count, trial);
    if (trial->count == 0) return;
    bool right = euler > 0 ? trial->euler >= euler : trial->euler == euler;
    if (!right || trial->defects > 0 || trial->lost > 0) trial->count = 0;
}

static void try_disc(struct handles *h, const struct cocone_disc *disc, struct cocone_repair_trial *trial) {
    uint32_t cell[COCONE_REPAIR_TRIAL_CELLS];
    size_t count = cocone_disc_cells(h->star, h->inside, disc, cell, COCONE_REPAIR_TRIAL_CELLS);
    try_cells(h, cell, count, ONE_HANDLE_LESS, trial);
}

/* Tries to join a shell to another one at each of its places. */
static void try_shell(struct handles *h, const struct cocone_shell *shell, struct cocone_repair_trial *best) {
    best->count = 0;
    for (size_t i = 0; i < shell->count; i++) {
        struct cocone_repair_trial trial;
        try_cells(h, &shell->cell[i], 1, ONE_SHELL_LESS, &trial);
        if (is_better_trial(&trial, best)) *best = trial;
    }
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
    int first = is_better_trial(&side[1], &side[0]);
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

/* Adds what was counted as an attempt last, unless it is empty.  If it is in the way of another one, its time is yet to
 * come. */
static void add_trial(struct handles *h, const struct cocone_repair_trial *trial) {
    if (trial->count == 0) return;
    if (!is_apart(h, trial)) {
        h->tried_count--;
        return;
    }
    for (size_t k = 0; k < trial->count; k++) {
        h->other[trial->cell[k]] ^= 1;
        h->group[trial->cell[k]] = (uint32_t)h->trials;
    }
    touch(h, trial, 1);
    h->trial[h->trials++] = *trial;
}

static enum status propose_loop(struct handles *h, const struct mesh *mesh, const struct loop *loop) {
    uint32_t point[LOOPS_MOST_EDGES];
    struct cocone_repair_trial trial;
    int attempts;
    for (size_t k = 0; k < loop->count; k++) {
        point[k] = mesh->source[loop->vertex[k]];
        if (h->touched[point[k]]) return STATUS_OK;
    }
    enum status status = count_attempts(h, fingerprint_of(point, loop->count), &attempts);
    if (status || attempts == ATTEMPTS) return status;
    try_loop(h, point, loop->count, attempts, &trial);
    add_trial(h, &trial);
    return STATUS_OK;
}

static enum status propose_shell(struct handles *h, const struct cocone_shell *shell) {
    struct cocone_repair_trial trial;
    int attempts;
    enum status status = count_attempts(h, shell->fingerprint, &attempts);
    if (status || attempts > 0) return status;
    try_shell(h, shell, &trial);
    add_trial(h, &trial);
    return STATUS_OK;
}

/* Tries what wasn't tried before, as far as it is apart from each other. */
static enum status propose(struct handles *h, const struct places *places) {
    enum status status = STATUS_OK;
    size_t loops = places->loops.count;
    for (size_t i = 0; i < loops + places->shells && h->trials < TRIALS_PER_ROUND && !status; i++) {
        if (!cocone_repair_may_try(h->repair)) break;
        if (progress_tick(h->input->progress, "cocone", 0.8)) return STATUS_CANCELLED;
        status = i < loops ? propose_loop(h, places->mesh, &places->loops.loop[i])
                           : propose_shell(h, &places->shell[i - loops]);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ rounds */

/* Has the trials judged, and takes the good ones. */
static enum status decide(struct handles *h, size_t *taken) {
    struct cocone_proposal proposal = {h->other, h->group, (uint32_t)h->trials, PATIENCE, -HAIR};
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

/* Places of one mesh, as long as there are new ones, until something is closed or joined. */
static enum status try_places(struct handles *h, const struct places *places, size_t *taken) {
    enum status status = STATUS_OK;
    bool more = true;
    while (more && *taken == 0 && !status) {
        status = propose(h, places);
        more = h->trials > 0;
        if (!status && more) status = decide(h, taken);
    }
    return status;
}

/* Short loops first: where there are many, they are found and closed in no time, and of the long ones few are left. */
static enum status close_some(struct handles *h, const struct mesh *mesh, size_t *taken) {
    struct places places = {.mesh = mesh};
    long tubes;
    *taken = 0;
    enum status status = cocone_shells_list(h->star, mesh, &places.shell, &places.shells);
    for (uint32_t edges = LOOPS_MOST_EDGES / 2; edges <= LOOPS_MOST_EDGES && *taken == 0 && !status; edges *= 2) {
        status = loops_find(mesh, edges, &h->steps, &places.loops);
        if (!status && h->input->bars && places.loops.count > 0) status = tubes_leave(mesh, &places.loops, &tubes);
        if (!status) status = try_places(h, &places, taken);
        loops_done(&places.loops);
    }
    free(places.shell);
    return status;
}

/* A mesh of the labels as they are; the labels themselves stay. */
static enum status mesh_of_labels(const struct handles *h, struct mesh *mesh) {
    uint8_t *copy = alloc_array(h->star->tets->cell_count, 1);
    if (!copy) return STATUS_NO_MEMORY;
    memcpy(copy, h->inside, h->star->tets->cell_count);
    enum status status = cocone_surface_extract(h->star, NULL, h->input->threads, copy, mesh);
    free(copy);
    return status;
}

static enum status close_all(struct handles *h, size_t *closed, bool *too_many) {
    enum status status = STATUS_OK;
    size_t least = SIZE_MAX, taken = 1;
    for (int round = 0; round < ROUNDS_MOST && taken > 0 && least > 0 && !status; round++) {
        struct mesh mesh = {0};
        size_t excess = 0;
        status = mesh_of_labels(h, &mesh);
        if (!status) status = count_excess(&mesh, &excess);
        if (!status && round == 0 && h->input->pieces.most) status = find_too_many(&mesh, &h->input->pieces, too_many);
        if (*too_many) {
            taken = 0;
        } else if (!status && excess >= least) {
            memcpy(h->inside, h->before, h->star->tets->cell_count);
            taken = 0;
        } else if (!status) {
            if (round == 0) h->steps = STEPS_PER_TRIANGLE * mesh.triangle_count;
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
    h->trial = alloc_array(TRIALS_PER_ROUND, sizeof *h->trial);
    if (!h->before || !h->other || !h->group || !h->touched || !h->trial) return STATUS_NO_MEMORY;
    memcpy(h->other, h->inside, star->tets->cell_count);
    return cocone_repair_new(star, h->input->cost, h->inside, &h->repair);
}

enum status cocone_handles_close(const struct cocone_handles_input *input, uint8_t *inside, size_t *closed,
                                 bool *too_many) {
    struct handles h = {.input = input, .star = input->star, .inside = inside};
    bool sphere;
    size_t count = 0;
    *too_many = false;
    enum status status = is_sphere(&h, &sphere);
    if (!status && !sphere) {
        status = handles_init(&h);
        if (!status) status = close_all(&h, &count, too_many);
        free(h.before), free(h.other), free(h.group);
        free(h.touched), free(h.trial), free(h.tried);
        cocone_repair_free(h.repair);
    }
    if (!status) *closed = count;
    return status;
}
