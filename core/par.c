/* par_for hands out ranges through one atomic counter; a team is the threads that help with loops.
 *
 *     caller    opens a loop with so many places, counts the call, wakes who sleeps; runs ranges; closes the loop, and
 *               waits for those that have taken a place
 *     helper    waits for another call; takes a place if there is one left; runs ranges; leaves
 *
 * Whoever waits looks for a while before it sleeps: in a row of short loops the next one comes within microseconds,
 * where starting or waking a thread takes tens of them.  A helper that wakes too late finds no place, and nobody waits
 * for it.
 *
 * Which team its loops take is known to a thread alone (`current`), from par_team_new to par_team_free, and forgotten
 * while it runs a loop: a loop inside a loop's body has a team of its own, as all have where there is none.
 *
 * Invariant: a helper touches a loop only between taking a place and leaving, so that it may live on the stack.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/par.h"

#include <assert.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/alloc.h"

enum { MAX_THREADS = 256, LOOKS = 1000 };

struct loop {
    atomic_size_t next; /* first index that nobody has taken */
    size_t n, grain;
    void (*body)(void *ctx, size_t begin, size_t end);
    void *ctx;
};

struct par_team {
    pthread_mutex_t lock; /* whoever changes anything but `thread` holds it */
    pthread_cond_t called, left;
    atomic_uint calls;   /* so far */
    atomic_uint working; /* helpers that have a place */
    unsigned places;     /* that are left */
    struct loop *loop;
    bool over;
    unsigned helpers;
    pthread_t thread[MAX_THREADS];
};

static _Thread_local struct par_team *current;

unsigned par_processors(void) {
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof set, &set) != 0) return 1;
    int count = CPU_COUNT(&set);
    return count > 0 ? (unsigned)count : 1;
}

static void run(struct loop *loop) {
    for (;;) {
        size_t begin = atomic_fetch_add_explicit(&loop->next, loop->grain, memory_order_relaxed);
        if (begin >= loop->n) return;
        size_t end = loop->n - begin < loop->grain ? loop->n : begin + loop->grain;
        loop->body(loop->ctx, begin, end);
    }
}

/* ------------------------------------------------------------------------------------------------ teams */

static void look_again(void) {
#if defined(__x86_64__)
    __builtin_ia32_pause();
#endif
}

/* Holds the lock when it returns. */
static void wait_for_call(struct par_team *team, unsigned seen) {
    for (unsigned i = 0; i < LOOKS && atomic_load(&team->calls) == seen; i++) look_again();
    pthread_mutex_lock(&team->lock);
    while (atomic_load(&team->calls) == seen) pthread_cond_wait(&team->called, &team->lock);
}

static void *help(void *arg) {
    struct par_team *team = arg;
    bool over = false;
    for (unsigned seen = 0; !over;) {
        wait_for_call(team, seen);
        seen = atomic_load(&team->calls);
        over = team->over;
        struct loop *loop = team->places > 0 ? team->loop : NULL;
        if (loop) team->places--, atomic_fetch_add(&team->working, 1);
        pthread_mutex_unlock(&team->lock);
        if (!loop) continue;
        run(loop);
        pthread_mutex_lock(&team->lock);
        if (atomic_fetch_sub(&team->working, 1) == 1) pthread_cond_signal(&team->left);
        pthread_mutex_unlock(&team->lock);
    }
    return NULL;
}

static void call(struct par_team *team, struct loop *loop, unsigned places) {
    pthread_mutex_lock(&team->lock);
    team->loop = loop;
    team->places = places;
    team->over = !loop;
    atomic_fetch_add(&team->calls, 1);
    pthread_cond_broadcast(&team->called);
    pthread_mutex_unlock(&team->lock);
}

static void close_loop(struct par_team *team) {
    pthread_mutex_lock(&team->lock);
    team->places = 0;
    pthread_mutex_unlock(&team->lock);
    for (unsigned i = 0; i < LOOKS && atomic_load(&team->working) > 0; i++) look_again();
    pthread_mutex_lock(&team->lock);
    while (atomic_load(&team->working) > 0) pthread_cond_wait(&team->left, &team->lock);
    pthread_mutex_unlock(&team->lock);
}

static void run_with(struct par_team *team, struct loop *loop, unsigned helpers) {
    struct par_team *before = current;
    while (team->helpers < helpers && pthread_create(&team->thread[team->helpers], NULL, help, team) == 0)
        team->helpers++;
    current = NULL;
    call(team, loop, helpers);
    run(loop);
    close_loop(team);
    current = before;
}

static void end_team(struct par_team *team) {
    if (team->helpers) call(team, NULL, 0);
    for (unsigned i = 0; i < team->helpers; i++) pthread_join(team->thread[i], NULL);
}

static struct par_team nobody(void) {
    return (struct par_team){
        .lock = PTHREAD_MUTEX_INITIALIZER, .called = PTHREAD_COND_INITIALIZER, .left = PTHREAD_COND_INITIALIZER};
}

struct par_team *par_team_new(void) {
    assert(!current);
    struct par_team *team = alloc_array(1, sizeof *team);
    if (team) *team = nobody();
    return current = team;
}

void par_team_free(struct par_team *team) {
    if (!team) return;
    assert(current == team);
    current = NULL;
    end_team(team);
    free(team);
}

/* ------------------------------------------------------------------------------------------------ loops */

void par_for(unsigned threads, size_t n, size_t grain, void (*body)(void *ctx, size_t begin, size_t end), void *ctx) {
    assert(grain > 0);
    struct loop loop = {.n = n, .grain = grain, .body = body, .ctx = ctx};
    size_t ranges = n / grain + (n % grain != 0);
    if (threads == 0) threads = par_processors();
    if (threads > ranges) threads = (unsigned)ranges;
    if (threads > MAX_THREADS) threads = MAX_THREADS;
    if (threads <= 1) {
        run(&loop);
    } else if (current) {
        run_with(current, &loop, threads - 1);
    } else {
        struct par_team team = nobody();
        run_with(&team, &loop, threads - 1);
        end_team(&team);
    }
}
