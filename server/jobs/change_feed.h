/* Who waits for a job to change, and being told: the base of long polls, one-shots and event streams.
 *
 * A waiter is woken exactly once: by a change of its job, at its deadline, when its client hangs up, or when the
 * service stops.  A change between reading the job and waiting for the next isn't missed: the reader takes
 * events_now() first and gives it along; whoever comes with an old one is woken at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_CHANGE_FEED_H
#define WHITTLE_SERVER_JOBS_CHANGE_FEED_H

#include <stdint.h>

#include "core/base/status.h"
#include "server/catalog/job.h"

struct events;

enum events_why { EVENTS_CHANGED, EVENTS_DEADLINE, EVENTS_HANGUP, EVENTS_CLOSED };

struct events_waiter {
    char id[JOB_ID_BYTES];
    uint64_t seen;                                /* what events_now said before the job was read */
    int64_t deadline_ms;                          /* of events_clock_ms */
    int fd;                                       /* the client's socket, to see it hang up; -1 = none */
    void (*wake)(void *ctx, enum events_why why); /* from any thread; must not block */
    void *ctx;

    uint64_t ticket; /* from here on events' own */
    struct events_waiter *previous, *next;
};

enum status events_open(struct events **events, struct error *error) MUST_CHECK;

/* Wakes everybody with EVENTS_CLOSED, and whoever comes later at once.  To be called before events_free. */
void events_close(struct events *events);

/* Ends its thread; nobody waits any more.  Accepts NULL. */
void events_free(struct events *events);

/* Grows with every change of any job. */
uint64_t events_now(struct events *events);

/* Milliseconds of a clock that never jumps. */
int64_t events_clock_ms(void);

/* Waits; the waiter is borrowed until it is woken, which may be before this returns. */
void events_wait(struct events *events, struct events_waiter *waiter);

/* A job has changed. */
void events_publish(struct events *events, const char *id);

#endif
