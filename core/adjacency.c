/* Lists live in one pool.  A list only shrinks in place; a merged point's new list goes to the end of the pool, and
 * when the pool is full the live lists are moved together into a fresh one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/adjacency.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"

enum { DEGREE_LIMIT = UINT8_MAX };

static bool lists(const struct neighbourhood *hood, uint32_t p, uint32_t q) {
    const uint32_t *id = &hood->id[(size_t)p * hood->stride];
    for (unsigned i = 0; i < hood->count[p]; i++)
        if (id[i] == q) return true;
    return false;
}

static void insert_sorted(struct link *list, uint8_t *degree, uint32_t id) {
    unsigned i = *degree;
    for (; i > 0 && list[i - 1].id > id; i--) list[i] = list[i - 1];
    list[i] = (struct link){id, NAN};
    (*degree)++;
}

/* room[p] = how many entries p needs: its own neighbours, and those that name it but aren't among them. */
static void count_room(const struct neighbourhood *hood, uint32_t *room) {
    for (size_t p = 0; p < hood->n; p++) room[p] = hood->count[p];
    for (size_t p = 0; p < hood->n; p++)
        for (unsigned i = 0; i < hood->count[p]; i++) {
            uint32_t q = hood->id[p * hood->stride + i];
            if (!lists(hood, q, (uint32_t)p)) room[q]++;
        }
}

/* Who names a crowd's centre from outside its own list is left out once the list is full: that only happens around
 * outliers' favourite points. */
static void fill(const struct neighbourhood *hood, struct adjacency *out) {
    for (size_t p = 0; p < hood->n; p++)
        for (unsigned i = 0; i < hood->count[p]; i++)
            insert_sorted(&out->list[out->start[p]], &out->degree[p], hood->id[p * hood->stride + i]);
    for (size_t p = 0; p < hood->n; p++)
        for (unsigned i = 0; i < hood->count[p]; i++) {
            uint32_t q = hood->id[p * hood->stride + i];
            if (out->degree[q] < DEGREE_LIMIT && !lists(hood, q, (uint32_t)p))
                insert_sorted(&out->list[out->start[q]], &out->degree[q], (uint32_t)p);
        }
}

enum status adjacency_from(const struct neighbourhood *hood, struct adjacency *out) {
    struct adjacency made = {.n = hood->n};
    uint32_t *room = alloc_array(hood->n, sizeof *room);
    made.start = alloc_array(hood->n, sizeof *made.start);
    made.degree = alloc_zeroed(hood->n, sizeof *made.degree);
    if (!room || !made.start || !made.degree) goto no_memory;
    count_room(hood, room);
    for (size_t p = 0; p < hood->n; p++) {
        made.start[p] = made.used;
        made.used += room[p] < DEGREE_LIMIT ? room[p] : DEGREE_LIMIT;
    }
    made.capacity = made.used + made.used / 4 + ADJACENCY_MAX;
    made.list = alloc_array(made.capacity, sizeof *made.list);
    if (!made.list) goto no_memory;
    fill(hood, &made);
    free(room);
    *out = made;
    return STATUS_OK;
no_memory:
    free(room);
    adjacency_done(&made);
    return STATUS_NO_MEMORY;
}

static size_t live_entries(const struct adjacency *adjacency, const uint32_t *live, size_t live_count) {
    size_t entries = 0;
    for (size_t i = 0; i < live_count; i++) entries += adjacency->degree[live[i]];
    return entries;
}

enum status adjacency_reserve(struct adjacency *adjacency, const uint32_t *live, size_t live_count, size_t entries) {
    if (adjacency->capacity - adjacency->used >= entries) return STATUS_OK;
    size_t needed = live_entries(adjacency, live, live_count) + entries;
    size_t capacity = needed + needed / 4;
    struct link *list = alloc_array(capacity, sizeof *list);
    if (!list) return STATUS_NO_MEMORY;
    size_t used = 0;
    for (size_t i = 0; i < live_count; i++) {
        uint32_t p = live[i];
        memcpy(&list[used], &adjacency->list[adjacency->start[p]], adjacency->degree[p] * sizeof *list);
        adjacency->start[p] = used;
        used += adjacency->degree[p];
    }
    free(adjacency->list);
    adjacency->list = list;
    adjacency->used = used;
    adjacency->capacity = capacity;
    return STATUS_OK;
}

void adjacency_done(struct adjacency *adjacency) {
    if (!adjacency) return;
    free(adjacency->start);
    free(adjacency->degree);
    free(adjacency->list);
    *adjacency = (struct adjacency){0};
}
