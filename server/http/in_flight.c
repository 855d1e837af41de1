/* Counters under one lock.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/http_internal.h"

#include <time.h>

#include "server/base/deadline.h"

void tally_init(struct tally *tally) {
    *tally = (struct tally){0};
    pthread_mutex_init(&tally->lock, NULL);
    pthread_cond_init(&tally->fewer, NULL);
}

void tally_done(struct tally *tally) {
    pthread_cond_destroy(&tally->fewer);
    pthread_mutex_destroy(&tally->lock);
}

static void add(struct tally *tally, unsigned *counter) {
    pthread_mutex_lock(&tally->lock);
    ++*counter;
    pthread_mutex_unlock(&tally->lock);
}

static void count_in(struct tally *tally, unsigned *counter) {
    pthread_mutex_lock(&tally->lock);
    --*counter;
    pthread_cond_broadcast(&tally->fewer);
    pthread_mutex_unlock(&tally->lock);
}

void tally_begin(struct tally *tally) { add(tally, &tally->exchanges); }

void tally_end(struct tally *tally) { count_in(tally, &tally->exchanges); }

bool tally_park(struct tally *tally) {
    pthread_mutex_lock(&tally->lock);
    bool stopping = tally->stopping;
    if (!stopping) tally->parked++;
    pthread_mutex_unlock(&tally->lock);
    return !stopping;
}

void tally_unpark(struct tally *tally) { count_in(tally, &tally->parked); }

void tally_upload(struct tally *tally, bool begins) { (begins ? add : count_in)(tally, &tally->uploads); }

unsigned tally_uploads(struct tally *tally) {
    pthread_mutex_lock(&tally->lock);
    unsigned uploads = tally->uploads;
    pthread_mutex_unlock(&tally->lock);
    return uploads;
}

void tally_stop(struct tally *tally, int patience_s) {
    struct timespec until = deadline_in_ms(patience_s * 1000LL);
    pthread_mutex_lock(&tally->lock);
    tally->stopping = true;
    while (tally->parked) pthread_cond_wait(&tally->fewer, &tally->lock);
    while (tally->exchanges && deadline_wait(&until, &tally->fewer, &tally->lock)) continue;
    pthread_mutex_unlock(&tally->lock);
}
