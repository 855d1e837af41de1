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

struct turns {
    int64_t aging_ms;
    struct entry *entry;
    size_t count, room;
    bool sorted;
    struct served *principal;
    size_t principal_count;
    uint64_t clock;
};

struct turns *turns_new(int64_t aging_ms) {
    struct turns *turns = calloc(1, sizeof *turns);
    if (turns) turns->aging_ms = aging_ms;
    return turns;
}

void turns_free(struct turns *turns) {
    if (!turns) return;
    free(turns->entry);
    free(turns->principal);
    free(turns);
}

/* The index of a principal, which is made where it is new; SIZE_MAX when memory runs out. */
static size_t principal_of(struct turns *turns, const char *name) {
    for (size_t i = 0; i < turns->principal_count; i++)
        if (strcmp(turns->principal[i].name, name) == 0) return i;
    struct served *grown = reallocarray(turns->principal, turns->principal_count + 1, sizeof *grown);
    if (!grown) return SIZE_MAX;
    turns->principal = grown;
    struct served *fresh = &grown[turns->principal_count];
    *fresh = (struct served){.at = 0};
    memcpy(fresh->name, name, strlen(name) + 1);
    return turns->principal_count++;
}

static bool make_room(struct turns *turns) {
    if (turns->count < turns->room) return true;
    size_t room = turns->room ? 2 * turns->room : 64;
    struct entry *grown = reallocarray(turns->entry, room, sizeof *grown);
    if (!grown) return false;
    turns->entry = grown;
    turns->room = room;
    return true;
}

bool turns_add(struct turns *turns, const struct turn *turn) {
    size_t principal = principal_of(turns, turn->principal);
    if (principal == SIZE_MAX || !make_room(turns)) return false;
    turns->entry[turns->count++] = (struct entry){
        .turn = *turn, .principal = principal, .due_ms = turn->created_ms - turn->priority * turns->aging_ms};
    turns->sorted = false;
    return true;
}

static size_t find(const struct turns *turns, const char *id) {
    size_t i = 0;
    while (i < turns->count && strcmp(turns->entry[i].turn.id, id) != 0) i++;
    return i;
}

/* The others keep their order, but those of the same principal move up by a round. */
void turns_remove(struct turns *turns, const char *id) {
    size_t i = find(turns, id);
    if (i == turns->count) return;
    memmove(&turns->entry[i], &turns->entry[i + 1], (--turns->count - i) * sizeof turns->entry[0]);
    turns->sorted = false;
}

void turns_take(struct turns *turns, const char *id) {
    size_t i = find(turns, id);
    if (i < turns->count) turns->principal[turns->entry[i].principal].at = ++turns->clock;
    turns_remove(turns, id);
}

void turns_clear(struct turns *turns) { turns->count = 0; }

void turns_move_times(struct turns *turns, int64_t step_ms) {
    for (size_t i = 0; i < turns->count; i++) turns->entry[i].due_ms += step_ms;
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

static void sort(struct turns *turns) {
    struct entry *entry = turns->entry;
    if (turns->sorted || !turns->count) return;
    qsort(entry, turns->count, sizeof *entry, by_principal);
    for (size_t i = 0; i < turns->count; i++) {
        bool same = i && entry[i].principal == entry[i - 1].principal;
        entry[i].round = same ? entry[i - 1].round + 1 : 0;
        entry[i].served = turns->principal[entry[i].principal].at;
    }
    qsort(entry, turns->count, sizeof *entry, by_turn);
    turns->sorted = true;
}

const struct turn *turns_first(struct turns *turns) {
    sort(turns);
    return turns->count ? &turns->entry[0].turn : NULL;
}

size_t turns_ahead(struct turns *turns, const char *id, void (*visit)(void *ctx, const struct turn *turn), void *ctx) {
    sort(turns);
    size_t ahead = find(turns, id);
    if (ahead == turns->count) return 0;
    for (size_t i = 0; visit && i < ahead; i++) visit(ctx, &turns->entry[i].turn);
    return ahead;
}
