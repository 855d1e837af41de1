/* Turns: an array of waiting jobs, sorted when somebody asks.
 *
 * Two sorts make the order.  The first, by principal and by the time that a job is due, numbers the jobs of each
 * principal 0, 1, 2, ...  The second goes by that number, then by who was served longest ago: the first round takes the
 * first job of each principal, the second round the second, and so on, which is what taking turns will come to if
 * nothing else arrives.
 *
 * Who was served when is remembered for as long as the process lives, a few bytes for each principal.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/fair_share.h"

#include <stdlib.h>
#include <string.h>

struct entry {
    struct turn turn;
    size_t principal; /* of turns.principal */
    int64_t due_ms;   /* created, less what its priority is worth */
    size_t round;     /* how many jobs of its principal come before it */
    uint64_t served;  /* when its principal was served last */
};

struct served {
    char name[JOB_PRINCIPAL_BYTES];
    uint64_t at; /* a count of turns; 0 = never */
};

struct fair_share {
    int64_t aging_ms;
    struct entry *entry;
    size_t count, room;
    bool sorted;
    struct served *principal;
    size_t principal_count;
    uint64_t clock;
};

struct fair_share *fair_share_new(int64_t aging_ms) {
    struct fair_share *fair_share = calloc(1, sizeof *fair_share);
    if (fair_share) fair_share->aging_ms = aging_ms;
    return fair_share;
}

void fair_share_free(struct fair_share *fair_share) {
    if (!fair_share) return;
    free(fair_share->entry);
    free(fair_share->principal);
    free(fair_share);
}

/* The index of a principal, which is made where it is new; SIZE_MAX when memory runs out. */
static size_t principal_of(struct fair_share *fair_share, const char *name) {
    for (size_t i = 0; i < fair_share->principal_count; i++)
        if (strcmp(fair_share->principal[i].name, name) == 0) return i;
    struct served *grown = reallocarray(fair_share->principal, fair_share->principal_count + 1, sizeof *grown);
    if (!grown) return SIZE_MAX;
    fair_share->principal = grown;
    struct served *fresh = &grown[fair_share->principal_count];
    *fresh = (struct served){.at = 0};
    memcpy(fresh->name, name, strlen(name) + 1);
    return fair_share->principal_count++;
}

static bool make_room(struct fair_share *fair_share) {
    if (fair_share->count < fair_share->room) return true;
    size_t room = fair_share->room ? 2 * fair_share->room : 64;
    struct entry *grown = reallocarray(fair_share->entry, room, sizeof *grown);
    if (!grown) return false;
    fair_share->entry = grown;
    fair_share->room = room;
    return true;
}

bool fair_share_add(struct fair_share *fair_share, const struct turn *turn) {
    size_t principal = principal_of(fair_share, turn->principal);
    if (principal == SIZE_MAX || !make_room(fair_share)) return false;
    fair_share->entry[fair_share->count++] = (struct entry){
        .turn = *turn, .principal = principal, .due_ms = turn->created_ms - turn->priority * fair_share->aging_ms};
    fair_share->sorted = false;
    return true;
}

static size_t find_job(const struct fair_share *fair_share, const char *id) {
    size_t i = 0;
    while (i < fair_share->count && strcmp(fair_share->entry[i].turn.id, id) != 0) i++;
    return i;
}

/* The others keep their order, but those of the same principal move up by a round. */
void fair_share_remove(struct fair_share *fair_share, const char *id) {
    size_t i = find_job(fair_share, id);
    if (i == fair_share->count) return;
    memmove(&fair_share->entry[i], &fair_share->entry[i + 1], (--fair_share->count - i) * sizeof fair_share->entry[0]);
    fair_share->sorted = false;
}

void fair_share_take(struct fair_share *fair_share, const char *id) {
    size_t i = find_job(fair_share, id);
    if (i < fair_share->count) fair_share->principal[fair_share->entry[i].principal].at = ++fair_share->clock;
    fair_share_remove(fair_share, id);
}

void fair_share_clear(struct fair_share *fair_share) { fair_share->count = 0; }

void fair_share_move_times(struct fair_share *fair_share, int64_t step_ms) {
    for (size_t i = 0; i < fair_share->count; i++) fair_share->entry[i].due_ms += step_ms;
}

/* ------------------------------------------------------------------------------------------------ order */

static int compare(uint64_t a, uint64_t b) { return (a > b) - (a < b); }

static int by_principal(const void *left, const void *right) {
    const struct entry *a = left, *b = right;
    int order = compare(a->principal, b->principal);
    if (!order) order = (a->due_ms > b->due_ms) - (a->due_ms < b->due_ms);
    return order ? order : strcmp(a->turn.id, b->turn.id);
}

static int by_turn(const void *left, const void *right) {
    const struct entry *a = left, *b = right;
    int order = compare(a->round, b->round);
    if (!order) order = compare(a->served, b->served);
    return order ? order : strcmp(a->turn.id, b->turn.id);
}

static void sort(struct fair_share *fair_share) {
    struct entry *entry = fair_share->entry;
    if (fair_share->sorted || !fair_share->count) return;
    qsort(entry, fair_share->count, sizeof *entry, by_principal);
    for (size_t i = 0; i < fair_share->count; i++) {
        bool same = i && entry[i].principal == entry[i - 1].principal;
        entry[i].round = same ? entry[i - 1].round + 1 : 0;
        entry[i].served = fair_share->principal[entry[i].principal].at;
    }
    qsort(entry, fair_share->count, sizeof *entry, by_turn);
    fair_share->sorted = true;
}

const struct turn *fair_share_first(struct fair_share *fair_share) {
    sort(fair_share);
    return fair_share->count ? &fair_share->entry[0].turn : NULL;
}

size_t fair_share_ahead(struct fair_share *fair_share, const char *id,
                        void (*visit)(void *ctx, const struct turn *turn), void *ctx) {
    sort(fair_share);
    size_t ahead = find_job(fair_share, id);
    if (ahead == fair_share->count) return 0;
    for (size_t i = 0; visit && i < ahead; i++) visit(ctx, &fair_share->entry[i].turn);
    return ahead;
}
