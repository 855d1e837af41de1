/* Waiters: a list under one lock, and one thread that watches deadlines and hung-up sockets.
 *
 * A hang-up is a client's shutdown or close, seen by an epoll set of our own: libmicrohttpd doesn't look at suspended
 * connections.  A client that only shuts down its sending half is answered at once with what there is.
 *
 * Invariant: a waiter is in the list exactly while it may be woken; who takes it off, under the lock, wakes it, after
 * the lock.  Its socket is in the epoll set exactly while it is in the list, so a socket is never watched when
 * libmicrohttpd closes it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/jobs/change_feed.h"

#include <errno.h>
#include <limits.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

enum { EPOLL_BATCH = 64 };

struct events {
    pthread_mutex_t lock;
    struct events_waiter *first;
    uint64_t changes, tickets;
    int64_t next_look_ms; /* when the thread looks at deadlines again */
    bool closed, ending;
    int epoll_fd, wake_fd; /* the bell makes the thread look around: a nearer deadline, or the end */
    pthread_t thread;
};

int64_t events_clock_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static void ring(struct events *events) {
    ssize_t n = write(events->wake_fd, &(uint64_t){1}, sizeof(uint64_t));
    (void)n; /* full means that it rings already */
}

/* ------------------------------------------------------------------------------------------------ the list */

static void link_waiter(struct events *events, struct events_waiter *waiter) {
    waiter->ticket = ++events->tickets;
    waiter->previous = NULL;
    waiter->next = events->first;
    if (events->first) events->first->previous = waiter;
    events->first = waiter;
    struct epoll_event watch = {.events = EPOLLRDHUP | EPOLLONESHOT, .data.u64 = waiter->ticket};
    if (waiter->fd >= 0 && epoll_ctl(events->epoll_fd, EPOLL_CTL_ADD, waiter->fd, &watch) != 0) waiter->fd = -1;
}

static void unlink_waiter(struct events *events, struct events_waiter *waiter) {
    if (waiter->fd >= 0) epoll_ctl(events->epoll_fd, EPOLL_CTL_DEL, waiter->fd, NULL);
    if (waiter->previous) waiter->previous->next = waiter->next;
    if (waiter->next) waiter->next->previous = waiter->previous;
    if (events->first == waiter) events->first = waiter->next;
}

/* What is to be woken is collected in a list of its own, through `next`. */
static void collect(struct events *events, struct events_waiter *waiter, struct events_waiter **list) {
    unlink_waiter(events, waiter);
    waiter->next = *list;
    *list = waiter;
}

static void wake_all(struct events_waiter *list, enum events_why why) {
    while (list) {
        struct events_waiter *next = list->next; /* the waiter may be gone after it is woken */
        list->wake(list->ctx, why);
        list = next;
    }
}

/* ------------------------------------------------------------------------------------------------ the thread */

static void wake_late(struct events *events) {
    struct events_waiter *late = NULL;
    int64_t now = events_clock_ms();
    pthread_mutex_lock(&events->lock);
    events->next_look_ms = INT64_MAX;
    for (struct events_waiter *w = events->first, *next; w; w = next) {
        next = w->next;
        if (w->deadline_ms <= now)
            collect(events, w, &late);
        else if (w->deadline_ms < events->next_look_ms)
            events->next_look_ms = w->deadline_ms;
    }
    pthread_mutex_unlock(&events->lock);
    wake_all(late, EVENTS_DEADLINE);
}

static void wake_hung_up(struct events *events, uint64_t ticket) {
    struct events_waiter *gone = NULL;
    pthread_mutex_lock(&events->lock);
    for (struct events_waiter *w = events->first; w && !gone; w = w->next)
        if (w->ticket == ticket) {
            collect(events, w, &gone);
            break;
        }
    pthread_mutex_unlock(&events->lock);
    wake_all(gone, EVENTS_HANGUP);
}

static int wait_ms(struct events *events, bool *ending) {
    pthread_mutex_lock(&events->lock);
    int64_t next = events->next_look_ms;
    *ending = events->ending;
    pthread_mutex_unlock(&events->lock);
    if (next == INT64_MAX) return -1;
    int64_t wait = next - events_clock_ms();
    return wait < 0 ? 0 : wait > INT_MAX ? INT_MAX : (int)wait;
}

static void *watch(void *ctx) {
    struct events *events = ctx;
    struct epoll_event batch[EPOLL_BATCH];
    bool ending;
    for (;;) {
        int timeout = wait_ms(events, &ending);
        if (ending) return NULL;
        int n = epoll_wait(events->epoll_fd, batch, EPOLL_BATCH, timeout);
        for (int i = 0; i < n; i++) {
            uint64_t count;
            ssize_t got = batch[i].data.u64 ? 0 : read(events->wake_fd, &count, sizeof count);
            (void)got;
            if (batch[i].data.u64) wake_hung_up(events, batch[i].data.u64);
        }
        wake_late(events);
    }
}

/* ------------------------------------------------------------------------------------------------ public */

enum status events_open(struct events **events, struct error *error) {
    struct events *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "events", "no memory");
    pthread_mutex_init(&opened->lock, NULL);
    opened->next_look_ms = INT64_MAX;
    opened->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    opened->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    struct epoll_event bell = {.events = EPOLLIN, .data.u64 = 0};
    if (opened->epoll_fd >= 0 && opened->wake_fd >= 0 &&
        epoll_ctl(opened->epoll_fd, EPOLL_CTL_ADD, opened->wake_fd, &bell) == 0 &&
        pthread_create(&opened->thread, NULL, watch, opened) == 0) {
        *events = opened;
        return STATUS_OK;
    }
    error_set(error, STATUS_IO, "events", "can't start: %s", strerror(errno));
    if (opened->epoll_fd >= 0) close(opened->epoll_fd);
    if (opened->wake_fd >= 0) close(opened->wake_fd);
    pthread_mutex_destroy(&opened->lock);
    free(opened);
    return STATUS_IO;
}

void events_close(struct events *events) {
    struct events_waiter *all = NULL;
    pthread_mutex_lock(&events->lock);
    events->closed = true;
    while (events->first) collect(events, events->first, &all);
    pthread_mutex_unlock(&events->lock);
    wake_all(all, EVENTS_CLOSED);
}

void events_free(struct events *events) {
    if (!events) return;
    pthread_mutex_lock(&events->lock);
    events->ending = true;
    pthread_mutex_unlock(&events->lock);
    ring(events);
    pthread_join(events->thread, NULL);
    close(events->epoll_fd);
    close(events->wake_fd);
    pthread_mutex_destroy(&events->lock);
    free(events);
}

uint64_t events_now(struct events *events) {
    pthread_mutex_lock(&events->lock);
    uint64_t now = events->changes;
    pthread_mutex_unlock(&events->lock);
    return now;
}

void events_wait(struct events *events, struct events_waiter *waiter) {
    pthread_mutex_lock(&events->lock);
    bool closed = events->closed, changed = waiter->seen != events->changes;
    bool nearer = !closed && !changed && waiter->deadline_ms < events->next_look_ms;
    if (nearer) events->next_look_ms = waiter->deadline_ms;
    if (!closed && !changed) link_waiter(events, waiter);
    pthread_mutex_unlock(&events->lock);
    if (nearer) ring(events);
    if (closed || changed) waiter->wake(waiter->ctx, closed ? EVENTS_CLOSED : EVENTS_CHANGED);
}

void events_publish(struct events *events, const char *id) {
    struct events_waiter *told = NULL;
    pthread_mutex_lock(&events->lock);
    events->changes++;
    for (struct events_waiter *w = events->first, *next; w; w = next) {
        next = w->next;
        if (strcmp(w->id, id) == 0) collect(events, w, &told);
    }
    pthread_mutex_unlock(&events->lock);
    wake_all(told, EVENTS_CHANGED);
}
