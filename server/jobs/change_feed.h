/* Who waits for a job to change, and being told: the base of long polls, one-shots and event streams.
 *
 * A waiter is woken exactly once: by a change of its job, at its deadline, when its client hangs up, or when the
 * service stops.  A change between reading the job and waiting for the next isn't missed: the reader takes
 * change_feed_now() first and gives it along; whoever comes with an old one is woken at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_CHANGE_FEED_H
#define WHITTLE_SERVER_JOBS_CHANGE_FEED_H

#include <stdint.h>

#include "core/base/status.h"
#include "server/catalog/job.h"

struct change_feed;

enum change_feed_why { CHANGE_FEED_CHANGED, CHANGE_FEED_DEADLINE, CHANGE_FEED_HANGUP, CHANGE_FEED_CLOSED };

struct change_feed_waiter {
    char id[JOB_ID_BYTES];
    uint64_t seen;                                     /* what change_feed_now said before the job was read */
    int64_t deadline_ms;                               /* of clock_ms */
    int fd;                                            /* the client's socket, to see it hang up; -1 = none */
    void (*wake)(void *ctx, enum change_feed_why why); /* from any thread; must not block */
    void *ctx;

    uint64_t ticket; /* from here on the feed's own */
    struct change_feed_waiter *previous, *next;
};

enum status change_feed_open(struct change_feed **feed, struct error *error) MUST_CHECK;

/* Wakes everybody with CHANGE_FEED_CLOSED, and whoever comes later at once.  To be called before change_feed_free. */
void change_feed_close(struct change_feed *feed);

/* Ends its thread; nobody waits any more.  Accepts NULL. */
void change_feed_free(struct change_feed *feed);

/* Grows with every change of any job. */
uint64_t change_feed_now(struct change_feed *feed);

/* Waits; the waiter is borrowed until it is woken, which may be before this returns. */
void change_feed_wait(struct change_feed *feed, struct change_feed_waiter *waiter);

/* A job has changed. */
void change_feed_publish(struct change_feed *feed, const char *id);

#endif
