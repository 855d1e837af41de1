/* The watchdog: a list of sockets, and a thread that looks at it every quarter of a second.
 *
 * A late connection is shut down, not closed: its descriptor is libmicrohttpd's, which sees the end and closes it.  A
 * client whose body is too slow is told so before (408), but for TLS, whose session is libmicrohttpd's thread's.
 * Invariant: a socket is in the list only while it is open.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/clock.h"
#include "server/http/http_internal.h"
#include "server/http/response.h"

#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>

#include "server/base/deadline.h"
#include "server/jobs/change_feed.h"

enum { LOOK_EVERY_MS = 250, HALF_CLOSED_LOOKS = 3, END_LOOK_MS = 100, END_LOOKS = 10 };

struct watched {
    int fd;
    _Atomic int phase;
    _Atomic int64_t since_ms;
    _Atomic uint64_t bytes;
    uint64_t bytes_before; /* from here on the thread's own */
    int64_t window_ms;     /* since when the body's rate is measured, and how many of its bytes were there then */
    uint64_t window_bytes;
    unsigned quiet_looks;
    bool cut;
    struct watched *previous, *next;
};

struct watchdog {
    struct watchdog_limits limits;
    struct metrics *metrics;
    pthread_mutex_t lock;
    pthread_cond_t ending_changed, emptied;
    bool ending;
    struct watched *first;
    int64_t count;
    pthread_t thread;
};

/* Whether the client has closed its half, the kernel holds nothing more of it, and nothing has come for a few looks:
 * the few are for bytes that libmicrohttpd has taken but not yet handed over. */
static bool is_half_closed(struct watched *watched) {
    struct pollfd ended = {.fd = watched->fd, .events = POLLRDHUP};
    int left = 0;
    uint64_t bytes = atomic_load(&watched->bytes);
    bool quiet = poll(&ended, 1, 0) == 1 && (ended.revents & (POLLRDHUP | POLLHUP)) &&
                 ioctl(watched->fd, FIONREAD, &left) == 0 && left == 0 && bytes == watched->bytes_before;
    watched->quiet_looks = quiet ? watched->quiet_looks + 1 : 0;
    watched->bytes_before = bytes;
    return watched->quiet_looks >= HALF_CLOSED_LOOKS;
}

/* Whether the kernel holds bytes of the client that we haven't taken: then it isn't the client that is slow. */
static bool has_unread(const struct watched *watched) {
    int left = 0;
    return ioctl(watched->fd, FIONREAD, &left) == 0 && left > 0;
}

/* Whether a body has been below the rate for the grace, one such window after the other. */
static bool is_slow(const struct watchdog_limits *limits, struct watched *watched, int64_t now) {
    int64_t since = atomic_load(&watched->since_ms);
    uint64_t bytes = atomic_load(&watched->bytes);
    if (watched->window_ms < since || watched->window_bytes > bytes) {
        watched->window_ms = since;
        watched->window_bytes = 0;
    }
    int64_t age = now - watched->window_ms;
    if (age <= limits->grace_ms) return false;
    bool slow = (double)(bytes - watched->window_bytes) * 1e3 < (double)limits->min_bytes_per_s * (double)age;
    if (slow) return true;
    watched->window_ms = now;
    watched->window_bytes = bytes;
    return false;
}

/* Whether it is to be cut, and why. */
static bool is_late(const struct watchdog_limits *limits, struct watched *watched, int64_t now, enum metrics_cut *why) {
    int64_t age = now - atomic_load(&watched->since_ms);
    bool late = false;
    switch ((enum watchdog_phase)atomic_load(&watched->phase)) {
    case WATCHDOG_HEADERS:
        *why = METRICS_CUT_HEADERS;
        late = age > limits->header_ms;
        break;
    case WATCHDOG_IDLE:
        *why = METRICS_CUT_IDLE;
        late = age > limits->idle_ms;
        break;
    case WATCHDOG_BODY:
        *why = METRICS_CUT_SLOW;
        late = is_slow(limits, watched, now) && !has_unread(watched);
        break;
    case WATCHDOG_BUSY: return false;
    }
    if (late || !is_half_closed(watched)) return late;
    *why = METRICS_CUT_HALF_CLOSED;
    return true;
}

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }

/* The limits as they are now; under the lock. */
static struct watchdog_limits limits_now(const struct watchdog *watchdog) {
    struct watchdog_limits limits = watchdog->limits;
    bool pressed = 4 * watchdog->count >= 3 * limits.connections;
    if (!pressed) return limits;
    limits.header_ms = least(limits.header_ms, WATCHDOG_PRESSED_MS);
    limits.idle_ms = least(limits.idle_ms, WATCHDOG_PRESSED_MS);
    limits.grace_ms = least(limits.grace_ms, WATCHDOG_PRESSED_MS);
    return limits;
}

/* Tells a client that it is too slow, past libmicrohttpd, which writes nothing while a body comes. */
static void tell_slow(const struct watchdog_limits *limits, int fd) {
    struct response response;
    size_t bytes = 0;
    response_init(&response);
    response_refuse(&response, PROBLEM_TOO_SLOW, "less than %lld bytes a second came for %.3g s",
                    (long long)limits->min_bytes_per_s, (double)limits->grace_ms / 1e3);
    response_header(&response, "Connection", "close");
    char *text = response_bytes(&response, "Request Timeout", &bytes);
    if (text) (void)!send(fd, text, bytes, MSG_NOSIGNAL | MSG_DONTWAIT);
    free(text);
    response_done(&response);
}

static void look_at(struct watchdog *watchdog, const struct watchdog_limits *limits, struct watched *watched,
                    int64_t now) {
    enum metrics_cut why;
    if (watched->cut || !is_late(limits, watched, now, &why)) return;
    watched->cut = true;
    metrics_cut(watchdog->metrics, why);
    if (why == METRICS_CUT_SLOW && !limits->secure) tell_slow(limits, watched->fd);
    shutdown(watched->fd, SHUT_RDWR);
}

static void *look(void *ctx) {
    struct watchdog *watchdog = ctx;
    pthread_mutex_lock(&watchdog->lock);
    while (!watchdog->ending) {
        int64_t now = clock_ms();
        struct watchdog_limits limits = limits_now(watchdog);
        for (struct watched *w = watchdog->first; w; w = w->next) look_at(watchdog, &limits, w, now);
        struct timespec until = deadline_in_ms(LOOK_EVERY_MS);
        (void)deadline_wait(&until, &watchdog->ending_changed, &watchdog->lock);
    }
    pthread_mutex_unlock(&watchdog->lock);
    return NULL;
}

enum status watchdog_open(struct watchdog_limits limits, struct metrics *metrics, struct watchdog **watchdog) {
    struct watchdog *opened = calloc(1, sizeof *opened);
    if (!opened) return STATUS_NO_MEMORY;
    opened->limits = limits;
    opened->metrics = metrics;
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->ending_changed, NULL);
    pthread_cond_init(&opened->emptied, NULL);
    if (pthread_create(&opened->thread, NULL, look, opened) != 0) {
        free(opened);
        return STATUS_NO_MEMORY;
    }
    *watchdog = opened;
    return STATUS_OK;
}

void watchdog_close(struct watchdog *watchdog) {
    if (!watchdog) return;
    pthread_mutex_lock(&watchdog->lock);
    watchdog->ending = true;
    pthread_cond_signal(&watchdog->ending_changed);
    pthread_mutex_unlock(&watchdog->lock);
    pthread_join(watchdog->thread, NULL);
    pthread_cond_destroy(&watchdog->ending_changed);
    pthread_cond_destroy(&watchdog->emptied);
    pthread_mutex_destroy(&watchdog->lock);
    free(watchdog);
}

void watchdog_end_all(struct watchdog *watchdog) {
    if (!watchdog) return;
    pthread_mutex_lock(&watchdog->lock);
    for (int i = 0; i < END_LOOKS && watchdog->first; i++) {
        for (struct watched *w = watchdog->first; w; w = w->next) shutdown(w->fd, SHUT_RDWR);
        struct timespec until = deadline_in_ms(END_LOOK_MS);
        (void)deadline_wait(&until, &watchdog->emptied, &watchdog->lock);
    }
    pthread_mutex_unlock(&watchdog->lock);
}

struct watched *watchdog_add(struct watchdog *watchdog, int fd) {
    struct watched *watched = calloc(1, sizeof *watched);
    if (!watched) return NULL;
    watched->fd = fd;
    watchdog_enter(watched, WATCHDOG_HEADERS);
    pthread_mutex_lock(&watchdog->lock);
    watched->next = watchdog->first;
    if (watched->next) watched->next->previous = watched;
    watchdog->first = watched;
    watchdog->count++;
    pthread_mutex_unlock(&watchdog->lock);
    return watched;
}

void watchdog_remove(struct watchdog *watchdog, struct watched *watched) {
    if (!watched) return;
    pthread_mutex_lock(&watchdog->lock);
    if (watched->previous) watched->previous->next = watched->next;
    if (watched->next) watched->next->previous = watched->previous;
    if (watchdog->first == watched) watchdog->first = watched->next;
    if (--watchdog->count == 0) pthread_cond_signal(&watchdog->emptied);
    pthread_mutex_unlock(&watchdog->lock);
    free(watched);
}

void watchdog_enter(struct watched *watched, enum watchdog_phase phase) {
    if (!watched) return;
    atomic_store(&watched->since_ms, clock_ms());
    atomic_store(&watched->bytes, 0);
    atomic_store(&watched->phase, phase);
}

/* By one thread at a time, so that no addition has to be atomic. */
void watchdog_count(struct watched *watched, size_t bytes) {
    if (!watched) return;
    uint64_t before = atomic_load_explicit(&watched->bytes, memory_order_relaxed);
    atomic_store_explicit(&watched->bytes, before + bytes, memory_order_relaxed);
}
