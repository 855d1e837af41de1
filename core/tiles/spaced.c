/* Those that are left come first; all that has gone ranks below them.  Of what has gone only points that are far enough
 * from all that is kept by then matter, which each tile's positions tell without a look at their ranks.  Where memory
 * hasn't room for all of these, the most important half of what it can hold is settled first, and the tiles are read
 * again: then far fewer are far enough.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tiles/spaced.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/base/par.h"
#include "core/simplify/spacing.h"
#include "core/tiles/fit.h"

enum { PIECE = 1 << 16, GRAIN = 1 << 10 };

/* A point that has gone, and is far enough from what is kept. */
struct candidate {
    uint64_t key; /* UINT64_MAX: not known */
    vec3 position;
    uint32_t id;
};

struct spacing_out {
    const struct ranks *ranks;
    unsigned threads;
    struct spaced *made;
    size_t most;
    vec3 *kept; /* positions, `most` at most; owned, as all that follows */
    struct spacing_grid grid;
    struct candidate *candidate;
    size_t count, room;
    uint64_t after, until; /* keys that are looked for: over the first, up to the second */
    struct candidate *of_tile;
    size_t of_tile_count, of_tile_room;
    uint32_t *slot;
    size_t slots;
};

static enum status spaced_no_memory(const struct spacing_out *s) {
    return error_set(s->ranks->error, STATUS_NO_MEMORY, "tiles", "not enough memory to keep points apart");
}

static void keep_point(struct spacing_out *s, vec3 p) {
    s->kept[s->made->count] = p;
    spacing_grid_insert(&s->grid, (uint32_t)s->made->count++);
}

static enum status too_many(const struct spacing_out *s) {
    const struct params *params = &s->ranks->scratch->head.params;
    return error_set(s->ranks->error, STATUS_NO_MEMORY, "spacing",
                     "more than %zu points are %g apart, and %" PRIu64
                     " MiB have room to finish so many; take a wider spacing, a ratio beside it, or more memory",
                     s->most, params->spacing, params->memory_bytes >> 20);
}

static enum status keep_left(struct spacing_out *s, const vec3 *position, bool all_wanted) {
    size_t n = s->ranks->left_count;
    s->made->first_not_kept = n;
    for (size_t i = 0; i < n; i++) {
        bool stays = spacing_grid_near(&s->grid, position[i]) == NONE;
        bool is_full = s->made->count == s->most;
        if ((!stays || is_full) && i < s->made->first_not_kept) s->made->first_not_kept = i;
        if (!stays) continue;
        if (is_full && all_wanted) return too_many(s);
        if (is_full) break;
        s->made->place[s->made->left++] = (uint32_t)i;
        keep_point(s, position[i]);
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ candidates */

struct looking {
    const struct spacing_grid *grid;
    const vec3 *point;
    uint8_t *is_far;
};

static void look_range(void *ctx, size_t begin, size_t end) {
    const struct looking *looking = ctx;
    for (size_t i = begin; i < end; i++)
        looking->is_far[i] = spacing_grid_near(looking->grid, looking->point[i]) == NONE;
}

static enum status add_of_tile(struct spacing_out *s, vec3 p, uint32_t id) {
    if (s->of_tile_count == s->of_tile_room) {
        size_t room = s->of_tile_room ? s->of_tile_room + s->of_tile_room / 2 : PIECE;
        struct candidate *more = alloc_resize(s->of_tile, room, sizeof *more);
        if (!more) return STATUS_NO_MEMORY;
        s->of_tile = more;
        s->of_tile_room = room;
    }
    s->of_tile[s->of_tile_count++] = (struct candidate){UINT64_MAX, p, id};
    return STATUS_OK;
}

/* The tile's points that are far enough, without their keys. */
static enum status find_of_tile(struct spacing_out *s, size_t tile) {
    const struct ranks *ranks = s->ranks;
    const struct scratch_coding *coding = &ranks->scratch->head.coding;
    size_t each = scratch_record_bytes(coding);
    uint64_t points = ranks->scratch->tile[tile].points;
    struct scratch_check check = {ranks->scratch, ranks->scratch->tile[tile].first, 0, 0};
    char path[SCRATCH_PATH_BYTES];
    int fd = scratch_open_file(ranks->folder, "points", tile, path);
    unsigned char *piece = alloc_array(PIECE, each);
    vec3 *point = alloc_array(PIECE, sizeof *point);
    uint32_t *id = alloc_array(PIECE, sizeof *id);
    uint8_t *is_far = alloc_array(PIECE, sizeof *is_far);
    enum status status = piece && point && id && is_far ? STATUS_OK : STATUS_NO_MEMORY;
    s->of_tile_count = 0;
    for (uint64_t first = 0; !status && first < points; first += PIECE) {
        size_t n = points - first < PIECE ? (size_t)(points - first) : PIECE;
        struct looking looking = {&s->grid, point, is_far};
        bool is_short = scratch_ends_before(fd, (first + n) * each);
        if (!is_short) status = scratch_read(fd, piece, n * each, first * each, path, ranks->error);
        if (!status && (is_short || !scratch_check_next(&check, piece, n)))
            status = scratch_damaged(ranks->folder, "points", tile, ranks->error);
        for (size_t i = 0; !status && i < n; i++) point[i] = scratch_decode(coding, piece + i * each, &id[i]);
        if (!status) par_for(s->threads, n, GRAIN, look_range, &looking);
        for (size_t i = 0; !status && i < n; i++)
            if (is_far[i]) status = add_of_tile(s, point[i], id[i]);
    }
    if (fd >= 0) close(fd);
    free(piece), free(point), free(id), free(is_far);
    return status == STATUS_NO_MEMORY ? spaced_no_memory(s) : status;
}

static uint32_t *find_slot(const struct spacing_out *s, uint32_t id) {
    size_t at = (size_t)hash64(id) & (s->slots - 1);
    while (s->slot[at] != NONE && s->of_tile[s->slot[at]].id != id) at = (at + 1) & (s->slots - 1);
    return &s->slot[at];
}

static void note_rank(void *ctx, struct gone_item item) {
    struct spacing_out *s = ctx;
    uint32_t at = *find_slot(s, item.id);
    if (at != NONE) s->of_tile[at].key = whole_key(item.key, item.id);
}

/* Repetitions of a point have no key. */
static enum status find_keys(struct spacing_out *s, size_t tile) {
    if (!s->of_tile_count) return STATUS_OK;
    for (s->slots = 1; s->slots < 2 * s->of_tile_count;) s->slots *= 2;
    s->slot = alloc_array(s->slots, sizeof *s->slot);
    if (!s->slot) return spaced_no_memory(s);
    memset(s->slot, -1, s->slots * sizeof *s->slot);
    for (size_t i = 0; i < s->of_tile_count; i++) *find_slot(s, s->of_tile[i].id) = (uint32_t)i;
    enum status status = ranks_read_gone(s->ranks, tile, note_rank, s);
    free(s->slot);
    s->slot = NULL;
    return status;
}

static int compare_keys(const void *a, const void *b) {
    const struct candidate *x = a, *y = b;
    return (x->key > y->key) - (x->key < y->key);
}

static void sort_candidates(struct spacing_out *s) {
    if (s->count) qsort(s->candidate, s->count, sizeof *s->candidate, compare_keys);
}

static void take_of_tile(struct spacing_out *s) {
    for (size_t i = 0; i < s->of_tile_count; i++) {
        const struct candidate *c = &s->of_tile[i];
        if (c->key == UINT64_MAX || c->key <= s->after || c->key > s->until) continue;
        if (s->count == s->room) {
            sort_candidates(s);
            s->count /= 2;
            s->until = s->candidate[s->count - 1].key;
            if (c->key > s->until) continue;
        }
        s->candidate[s->count++] = *c;
    }
}

static enum status find_candidates(struct spacing_out *s) {
    size_t tiles = s->ranks->scratch->head.tiles;
    enum status status = STATUS_OK;
    s->count = 0;
    s->until = UINT64_MAX - 1;
    for (size_t t = 0; !status && t < tiles; t++) {
        if (progress_tick(s->ranks->progress, "space", 0.5 + 0.2 * (double)t / (double)tiles)) return STATUS_CANCELLED;
        status = find_of_tile(s, t);
        if (!status) status = find_keys(s, t);
        if (!status) take_of_tile(s);
    }
    free(s->of_tile);
    s->of_tile = NULL;
    s->of_tile_room = 0;
    return status;
}

/* The most important ones first. */
static enum status keep_candidates(struct spacing_out *s, size_t enough) {
    sort_candidates(s);
    for (size_t i = 0; i < s->count && s->made->count < enough; i++) {
        const struct candidate *c = &s->candidate[i];
        if (spacing_grid_near(&s->grid, c->position) != NONE) continue;
        if (s->made->count == s->most && enough == SIZE_MAX) return too_many(s);
        if (s->made->count == s->most) return STATUS_OK;
        s->made->id[s->made->count - s->made->left] = c->id;
        keep_point(s, c->position);
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status keep_gone(struct spacing_out *s, size_t enough) {
    enum status status = STATUS_OK;
    bool goes_on = true;
    while (!status && goes_on && s->made->count < enough && (s->made->count < s->most || enough == SIZE_MAX)) {
        status = find_candidates(s);
        goes_on = s->until < UINT64_MAX - 1;
        if (!status) status = keep_candidates(s, enough);
        s->after = s->until;
    }
    s->made->is_all = !goes_on && s->made->count < enough && s->made->count < s->most;
    return status;
}

enum status spaced_keep(const struct ranks *ranks, const vec3 *position, size_t enough, size_t most, size_t room,
                        unsigned threads, struct spaced *spaced) {
    const struct scratch_head *head = &ranks->scratch->head;
    struct spaced made = {0};
    struct spacing_out s = {.ranks = ranks, .threads = threads, .made = &made, .most = most, .room = room};
    s.kept = alloc_array(most, sizeof *s.kept);
    s.candidate = alloc_array(room, sizeof *s.candidate);
    made.place = alloc_array(most, sizeof *made.place);
    made.id = alloc_array(most, sizeof *made.id);
    enum status status = s.kept && s.candidate && made.place && made.id ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status)
        status =
            spacing_grid_init(&s.grid, s.kept, most, head->whole.box_min, head->whole.box_max, head->params.spacing);
    if (status) status = spaced_no_memory(&s);
    if (!status) status = keep_left(&s, position, enough == SIZE_MAX);
    if (!status) status = keep_gone(&s, enough);
    spacing_grid_done(&s.grid);
    free(s.kept), free(s.candidate), free(s.of_tile);
    if (status)
        spaced_done(&made);
    else
        *spaced = made;
    return status;
}

void spaced_done(struct spaced *spaced) {
    free(spaced->place), free(spaced->id);
    *spaced = (struct spaced){0};
}
