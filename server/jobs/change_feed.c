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
#include <unistd.h>

#include "core/base/clock.h"

enum { EPOLL_BATCH = 64 };

struct change_feed {
    pthread_mutex_t lock;
    struct change_feed_waiter *first;
    uint64_t changes, tickets;
    int64_t next_look_ms; /* when the thread looks at deadlines again */
    bool closed, ending;
    int epoll_fd, wake_fd; /* the bell makes the thread look around: a nearer deadline, or the end */
    pthread_t thread;
};

static void ring(struct change_feed *feed) {
    ssize_t n = write(feed->wake_fd, &(uint64_t){1}, sizeof(uint64_t));
    (void)n; /* full means that it rings already */
}

/* ------------------------------------------------------------------------------------------------ the list */

static void link_waiter(struct change_feed *feed, struct change_feed_waiter *waiter) {
    waiter->ticket = ++feed->tickets;
    waiter->previous = NULL;
    waiter->next = feed->first;
    if (feed->first) feed->first->previous = waiter;
    feed->first = waiter;
    struct epoll_event watch = {.events = EPOLLRDHUP | EPOLLONESHOT, .data.u64 = waiter->ticket};
    if (waiter->fd >= 0 && epoll_ctl(feed->epoll_fd, EPOLL_CTL_ADD, waiter->fd, &watch) != 0) waiter->fd = -1;
}

static void unlink_waiter(struct change_feed *feed, struct change_feed_waiter *waiter) {
    if (waiter->fd >= 0) epoll_ctl(feed->epoll_fd, EPOLL_CTL_DEL, waiter->fd, NULL);
    if (waiter->previous) waiter->previous->next = waiter->next;
    if (waiter->next) waiter->next->previous = waiter->previous;
    if (feed->first == waiter) feed->first = waiter->next;
}

/* What is to be woken is collected in a list of its own, through `next`. */
static void collect(struct change_feed *feed, struct change_feed_waiter *waiter, struct change_feed_waiter **list) {
    unlink_waiter(feed, waiter);
    waiter->next = *list;
    *list = waiter;
}

static void wake_all(struct change_feed_waiter *list, enum change_feed_why why) {
    while (list) {
        struct change_feed_waiter *next = list->next; /* the waiter may be gone after it is woken */
        list->wake(list->ctx, why);
        list = next;
    }
}

/* ------------------------------------------------------------------------------------------------ the thread */

static void wake_late(struct change_feed *feed) {
    struct change_feed_waiter *late = NULL;
    int64_t now = clock_ms();
    pthread_mutex_lock(&feed->lock);
    feed->next_look_ms = INT64_MAX;
    for (struct change_feed_waiter *w = feed->first, *next; w; w = next) {
        next = w->next;
        if (w->deadline_ms <= now)
            collect(feed, w, &late);
        else if (w->deadline_ms < feed->next_look_ms)
            feed->next_look_ms = w->deadline_ms;
    }
    pthread_mutex_unlock(&feed->lock);
    wake_all(late, CHANGE_FEED_DEADLINE);
}

static void wake_hung_up(struct change_feed *feed, uint64_t ticket) {
    struct change_feed_waiter *gone = NULL;
    pthread_mutex_lock(&feed->lock);
    for (struct change_feed_waiter *w = feed->first; w && !gone; w = w->next)
        if (w->ticket == ticket) {
            collect(feed, w, &gone);
            break;
        }
    pthread_mutex_unlock(&feed->lock);
    wake_all(gone, CHANGE_FEED_HANGUP);
}

static int wait_ms(struct change_feed *feed, bool *ending) {
    pthread_mutex_lock(&feed->lock);
    int64_t next = feed->next_look_ms;
    *ending = feed->ending;
    pthread_mutex_unlock(&feed->lock);
    if (next == INT64_MAX) return -1;
    int64_t wait = next - clock_ms();
    return wait < 0 ? 0 : wait > INT_MAX ? INT_MAX : (int)wait;
}

static void *watch(void *ctx) {
    struct change_feed *feed = ctx;
    struct epoll_event batch[EPOLL_BATCH];
    bool ending;
    for (;;) {
        int timeout = wait_ms(feed, &ending);
        if (ending) return NULL;
        int n = epoll_wait(feed->epoll_fd, batch, EPOLL_BATCH, timeout);
        for (int i = 0; i < n; i++) {
            uint64_t count;
            ssize_t got = batch[i].data.u64 ? 0 : read(feed->wake_fd, &count, sizeof count);
            (void)got;
            if (batch[i].data.u64) wake_hung_up(feed, batch[i].data.u64);
        }
        wake_late(feed);
    }
}

/* ------------------------------------------------------------------------------------------------ public */

enum status change_feed_open(struct change_feed **feed, struct error *error) {
    struct change_feed *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "change feed", "no memory");
    pthread_mutex_init(&opened->lock, NULL);
    opened->next_look_ms = INT64_MAX;
    opened->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    opened->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    struct epoll_event bell = {.events = EPOLLIN, .data.u64 = 0};
    if (opened->epoll_fd >= 0 && opened->wake_fd >= 0 &&
        epoll_ctl(opened->epoll_fd, EPOLL_CTL_ADD, opened->wake_fd, &bell) == 0 &&
        pthread_create(&opened->thread, NULL, watch, opened) == 0) {
        *feed = opened;
        return STATUS_OK;
    }
    error_set(error, STATUS_IO, "change feed", "can't start: %s", strerror(errno));
    if (opened->epoll_fd >= 0) close(opened->epoll_fd);
    if (opened->wake_fd >= 0) close(opened->wake_fd);
    pthread_mutex_destroy(&opened->lock);
    free(opened);
    return STATUS_IO;
}

void change_feed_close(struct change_feed *feed) {
    struct change_feed_waiter *all = NULL;
    pthread_mutex_lock(&feed->lock);
    feed->closed = true;
    while (feed->first) collect(feed, feed->first, &all);
    pthread_mutex_unlock(&feed->lock);
    wake_all(all, CHANGE_FEED_CLOSED);
}

void change_feed_free(struct change_feed *feed) {
    if (!feed) return;
    pthread_mutex_lock(&feed->lock);
    feed->ending = true;
    pthread_mutex_unlock(&feed->lock);
    ring(feed);
    pthread_join(feed->thread, NULL);
    close(feed->epoll_fd);
    close(feed->wake_fd);
    pthread_mutex_destroy(&feed->lock);
    free(feed);
}

uint64_t change_feed_now(struct change_feed *feed) {
    pthread_mutex_lock(&feed->lock);
    uint64_t now = feed->changes;
    pthread_mutex_unlock(&feed->lock);
    return now;
}

void change_feed_wait(struct change_feed *feed, struct change_feed_waiter *waiter) {
    pthread_mutex_lock(&feed->lock);
    bool closed = feed->closed, changed = waiter->seen != feed->changes;
    bool nearer = !closed && !changed && waiter->deadline_ms < feed->next_look_ms;
    if (nearer) feed->next_look_ms = waiter->deadline_ms;
    if (!closed && !changed) link_waiter(feed, waiter);
    pthread_mutex_unlock(&feed->lock);
    if (nearer) ring(feed);
    if (closed || changed) waiter->wake(waiter->ctx, closed ? CHANGE_FEED_CLOSED : CHANGE_FEED_CHANGED);
}

void change_feed_publish(struct change_feed *feed, const char *id) {
    struct change_feed_waiter *told = NULL;
    pthread_mutex_lock(&feed->lock);
    feed->changes++;
    for (struct change_feed_waiter *w = feed->first, *next; w; w = next) {
        next = w->next;
        if (strcmp(w->id, id) == 0) collect(feed, w, &told);
    }
    pthread_mutex_unlock(&feed->lock);
    wake_all(told, CHANGE_FEED_CHANGED);
}
