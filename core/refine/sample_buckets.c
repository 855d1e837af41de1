/* A list that is filled again takes the blocks that it had, so the common store is seldom asked; it is locked then.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/sample_buckets.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

enum status sample_buckets_init(struct sample_buckets *lists, size_t count, size_t n, size_t busy) {
    size_t blocks = n / SAMPLE_BLOCK + count + (busy < count ? busy : count);
    struct sample_buckets new = {.spare = NONE};
    new.first = alloc_array(count, sizeof *new.first);
    new.block = alloc_array(blocks, sizeof *new.block);
    if (!new.first || !new.block || pthread_mutex_init(&new.lock, NULL)) {
        free(new.first), free(new.block);
        return STATUS_NO_MEMORY;
    }
    memset(new.first, 0xff, count * sizeof *new.first);
    *lists = new;
    return STATUS_OK;
}

void sample_buckets_done(struct sample_buckets *lists) {
    if (lists->first) pthread_mutex_destroy(&lists->lock);
    free(lists->first), free(lists->block);
    *lists = (struct sample_buckets){0};
}

void *sample_buckets_room(const struct sample_buckets *lists) {
    assert(lists->fresh == 0);
    return lists->block;
}

uint32_t sample_buckets_reserve(struct sample_buckets *lists, size_t count) {
    if (count == 0) return NONE;
    pthread_mutex_lock(&lists->lock);
    uint32_t first = lists->fresh;
    lists->fresh += (uint32_t)count;
    pthread_mutex_unlock(&lists->lock);
    for (uint32_t i = first; i < first + count - 1; i++) lists->block[i].next = i + 1;
    lists->block[first + count - 1].next = NONE;
    return first;
}

uint32_t sample_buckets_take(struct sample_buckets *lists, uint32_t list) {
    uint32_t chain = lists->first[list];
    lists->first[list] = NONE;
    return chain;
}

void sample_buckets_give(struct sample_buckets *lists, uint32_t chain) {
    if (chain == NONE) return;
    uint32_t last = chain;
    while (lists->block[last].next != NONE) last = lists->block[last].next;
    pthread_mutex_lock(&lists->lock);
    lists->block[last].next = lists->spare;
    lists->spare = chain;
    pthread_mutex_unlock(&lists->lock);
}

static uint32_t common_block(struct sample_buckets *lists) {
    pthread_mutex_lock(&lists->lock);
    uint32_t id = lists->spare;
    if (id == NONE)
        id = lists->fresh++;
    else
        lists->spare = lists->block[id].next;
    pthread_mutex_unlock(&lists->lock);
    return id;
}

static uint32_t new_block(struct sample_buckets *lists, uint32_t *spare, vec3 origin) {
    uint32_t id = *spare;
    if (id == NONE)
        id = common_block(lists);
    else
        *spare = lists->block[id].next;
    lists->block[id] = (struct sample_block){.origin = origin};
    return id;
}

void sample_buckets_add(struct sample_buckets *lists, uint32_t list, uint32_t id, const struct sample *sample,
                        uint32_t *spare) {
    uint32_t first = lists->first[list];
    if (first == NONE || lists->block[first].count == SAMPLE_BLOCK) {
        uint32_t new = new_block(lists, spare, sample->place);
        lists->block[new].next = first;
        lists->first[list] = first = new;
    }
    struct sample_block *block = &lists->block[first];
    vec3 p = vec3_sub(sample->place, block->origin);
    uint32_t i = block->count++;
    block->x[i] = (float)p.x, block->y[i] = (float)p.y, block->z[i] = (float)p.z;
    block->weight[i] = sample->weight;
    block->sample[i] = id;
}
