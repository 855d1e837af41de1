/* Lists of samples, one for each triangle, kept so that they are read without a wait.
 *
 * A list is a chain of blocks of up to eight samples, with their places in float around the block's origin: a block is
 * three cache lines that are loaded as vectors.  Which block of memory a list gets depends on the threads; what is in
 * it, and in which order, doesn't.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_SAMPLE_BUCKETS_H
#define WHITTLE_CORE_REFINE_SAMPLE_BUCKETS_H

#include <pthread.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/prefetch.h"
#include "core/refine/samples.h"

enum { SAMPLE_BLOCK = 8 };

struct sample_block {
    float x[SAMPLE_BLOCK], y[SAMPLE_BLOCK], z[SAMPLE_BLOCK]; /* relative to origin */
    float weight[SAMPLE_BLOCK];
    uint32_t sample[SAMPLE_BLOCK]; /* ids; whatever is behind the last one has no meaning, but is finite */
    vec3 origin;
    uint32_t count; /* 1 .. SAMPLE_BLOCK */
    uint32_t next;  /* block of the same list, or NONE */
};

struct sample_buckets {
    uint32_t *first; /* of each list: a block, or NONE.  Only this block may be less than full */
    struct sample_block *block;
    uint32_t fresh;       /* blocks from here on were never used */
    uint32_t spare;       /* chain of blocks that were used and are free again */
    pthread_mutex_t lock; /* of fresh and spare */
};

/* `count` empty lists that have room for n samples, as long as no more than `busy` of the lists are being emptied and
 * filled again, each of them out of its own blocks first.  STATUS_NO_MEMORY. */
enum status sample_buckets_init(struct sample_buckets *lists, size_t count, size_t n, size_t busy) MUST_CHECK;
void sample_buckets_done(struct sample_buckets *lists);

/* The room of `count` blocks at least, for whatever else, as long as all lists are empty: fresh memory costs more than
 * most of what is done in it. */
void *sample_buckets_room(const struct sample_buckets *lists);

/* A chain of `count` blocks that were never used, to fill lists out of. */
uint32_t sample_buckets_reserve(struct sample_buckets *lists, size_t count);

/* Empties a list; returns its first block (or NONE), which is the caller's to give back. */
uint32_t sample_buckets_take(struct sample_buckets *lists, uint32_t list);

/* A block, which may be NONE, will be read soon. */
static inline void sample_buckets_fetch(const struct sample_buckets *lists, uint32_t id) {
    if (id == NONE) return;
    const struct sample_block *block = &lists->block[id];
    prefetch(block->x), prefetch(block->z), prefetch(block->sample);
}

/* Gives a chain of blocks back. */
void sample_buckets_give(struct sample_buckets *lists, uint32_t chain);

/* Adds a sample to a list, in a block of *spare where one is needed, else in one of the common store. */
void sample_buckets_add(struct sample_buckets *lists, uint32_t list, uint32_t id, const struct sample *sample,
                        uint32_t *spare);

#endif
