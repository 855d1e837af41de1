/* The documents of ended jobs, in a table of fixed size.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/jobs/job_cache.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>

enum { SLOTS = 1024, LONGEST_BYTES = 16 * 1024 };

struct slot {
    char id[JOB_ID_BYTES], principal[JOB_PRINCIPAL_BYTES];
    uint64_t sequence;
    char *text; /* owned; NULL = nothing is here */
};

struct job_cache {
    pthread_mutex_t lock;
    uint64_t forgotten; /* how many jobs were */
    struct slot slot[SLOTS];
};

struct job_cache *job_cache_new(void) {
    struct job_cache *cache = calloc(1, sizeof *cache);
    if (cache) pthread_mutex_init(&cache->lock, NULL);
    return cache;
}

void job_cache_free(struct job_cache *cache) {
    if (!cache) return;
    for (size_t i = 0; i < SLOTS; i++) free(cache->slot[i].text);
    pthread_mutex_destroy(&cache->lock);
    free(cache);
}

/* An id ends in random digits: any mix of its bytes spreads them. */
static struct slot *slot_of(struct job_cache *cache, const char *id) {
    uint32_t mix = 2166136261u;
    for (; *id; id++) mix = (mix ^ (unsigned char)*id) * 16777619u;
    return &cache->slot[mix % SLOTS];
}

uint64_t job_cache_now(struct job_cache *cache) {
    pthread_mutex_lock(&cache->lock);
    uint64_t now = cache->forgotten;
    pthread_mutex_unlock(&cache->lock);
    return now;
}

void job_cache_keep(struct job_cache *cache, uint64_t since, const struct job *job, const char *text) {
    char *kept = strlen(text) <= LONGEST_BYTES ? strdup(text) : NULL;
    if (!kept) return;
    pthread_mutex_lock(&cache->lock);
    if (cache->forgotten == since) {
        struct slot *slot = slot_of(cache, job->id);
        char *former = slot->text;
        *slot = (struct slot){.sequence = job->sequence, .text = kept};
        memcpy(slot->id, job->id, sizeof slot->id);
        memcpy(slot->principal, job->principal, sizeof slot->principal);
        kept = former;
    }
    pthread_mutex_unlock(&cache->lock);
    free(kept);
}

char *job_cache_find(struct job_cache *cache, const char *id, char principal[JOB_PRINCIPAL_BYTES], uint64_t *sequence) {
    char *found = NULL;
    pthread_mutex_lock(&cache->lock);
    const struct slot *slot = slot_of(cache, id);
    if (slot->text && strcmp(slot->id, id) == 0) found = strdup(slot->text);
    if (found) {
        *sequence = slot->sequence;
        memcpy(principal, slot->principal, sizeof slot->principal);
    }
    pthread_mutex_unlock(&cache->lock);
    return found;
}

static void empty(struct slot *slot) {
    free(slot->text);
    *slot = (struct slot){0};
}

void job_cache_forget(struct job_cache *cache, const char *id) {
    pthread_mutex_lock(&cache->lock);
    cache->forgotten++;
    struct slot *slot = id ? slot_of(cache, id) : NULL;
    if (slot && slot->text && strcmp(slot->id, id) == 0) empty(slot);
    for (size_t i = 0; !id && i < SLOTS; i++) empty(&cache->slot[i]);
    pthread_mutex_unlock(&cache->lock);
}
