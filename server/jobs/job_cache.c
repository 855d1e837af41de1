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

struct documents {
    pthread_mutex_t lock;
    uint64_t forgotten; /* how many jobs were */
    struct slot slot[SLOTS];
};

struct documents *documents_new(void) {
    struct documents *documents = calloc(1, sizeof *documents);
    if (documents) pthread_mutex_init(&documents->lock, NULL);
    return documents;
}

void documents_free(struct documents *documents) {
    if (!documents) return;
    for (size_t i = 0; i < SLOTS; i++) free(documents->slot[i].text);
    pthread_mutex_destroy(&documents->lock);
    free(documents);
}

/* An id ends in random digits: any mix of its bytes spreads them. */
static struct slot *slot_of(struct documents *documents, const char *id) {
    uint32_t mix = 2166136261u;
    for (; *id; id++) mix = (mix ^ (unsigned char)*id) * 16777619u;
    return &documents->slot[mix % SLOTS];
}

uint64_t documents_now(struct documents *documents) {
    pthread_mutex_lock(&documents->lock);
    uint64_t now = documents->forgotten;
    pthread_mutex_unlock(&documents->lock);
    return now;
}

void documents_keep(struct documents *documents, uint64_t since, const struct job *job, const char *text) {
    char *kept = strlen(text) <= LONGEST_BYTES ? strdup(text) : NULL;
    if (!kept) return;
    pthread_mutex_lock(&documents->lock);
    if (documents->forgotten == since) {
        struct slot *slot = slot_of(documents, job->id);
        char *former = slot->text;
        *slot = (struct slot){.sequence = job->sequence, .text = kept};
        memcpy(slot->id, job->id, sizeof slot->id);
        memcpy(slot->principal, job->principal, sizeof slot->principal);
        kept = former;
    }
    pthread_mutex_unlock(&documents->lock);
    free(kept);
}

char *documents_find(struct documents *documents, const char *id, char principal[JOB_PRINCIPAL_BYTES],
                     uint64_t *sequence) {
    char *found = NULL;
    pthread_mutex_lock(&documents->lock);
    const struct slot *slot = slot_of(documents, id);
    if (slot->text && strcmp(slot->id, id) == 0) found = strdup(slot->text);
    if (found) {
        *sequence = slot->sequence;
        memcpy(principal, slot->principal, sizeof slot->principal);
    }
    pthread_mutex_unlock(&documents->lock);
    return found;
}

static void empty(struct slot *slot) {
    free(slot->text);
    *slot = (struct slot){0};
}

void documents_forget(struct documents *documents, const char *id) {
    pthread_mutex_lock(&documents->lock);
    documents->forgotten++;
    struct slot *slot = id ? slot_of(documents, id) : NULL;
    if (slot && slot->text && strcmp(slot->id, id) == 0) empty(slot);
    for (size_t i = 0; !id && i < SLOTS; i++) empty(&documents->slot[i]);
    pthread_mutex_unlock(&documents->lock);
}
