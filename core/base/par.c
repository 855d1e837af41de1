/* par_for hands out ranges through one atomic counter; a team is the threads that help with loops.
 *
 *     caller    opens a loop with so many places and tells the team; runs ranges; closes the loop, and waits for those
 *               that have taken a place
 *     helper    waits for news; takes a place in an open loop if there is one left; runs ranges; leaves
 *
 * Whoever waits looks for a while before it sleeps: in a row of short loops the next one comes within microseconds,
 * where starting or waking a thread takes tens of them.  A helper that wakes too late finds no place, and nobody waits
 * for it.
 *
 * Which team its loops take is known to a thread alone (`current`), from par_team_new to par_team_free, and forgotten
 * while it runs a loop: a loop inside a loop's body has a team of its own, as all have where there is none.
 *
 * Work beside other work is a loop of one index that is open while the caller does something else, and its thread does
 * know the team: so several loops may be open at once, of either side, and helpers go to any of them.  A caller that is
 * done first takes part in the others', too, until both sides are done.
 *
 * Invariant: a helper touches a loop only between taking a place and leaving, so that it may live on the stack.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/par.h"

#include <assert.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"

enum { MAX_THREADS = 256, LOOKS = 4000 };

struct loop {
    atomic_size_t next; /* first index that nobody has taken */
    size_t n, grain;
    void (*body)(void *ctx, size_t begin, size_t end);
    void *ctx;
    bool beside;      /* its body is work beside the caller's: loops inside are for all of the team */
    unsigned places;  /* that are left; with all below under the team's lock */
    unsigned working; /* helpers that have a place */
    struct loop *next_open;
};

struct par_team {
    pthread_mutex_t lock; /* whoever changes anything below holds it */
    pthread_cond_t told;
    atomic_uint news;  /* how often loops were opened, or left by their last helper */
    struct loop *open; /* the latest first */
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

/* All who wait look again.  Under the lock. */
static void tell(struct par_team *team) {
    atomic_fetch_add(&team->news, 1);
    pthread_cond_broadcast(&team->told);
}

/* Gives the lock up meanwhile. */
static void wait_for_news(struct par_team *team) {
    unsigned seen = atomic_load(&team->news);
    pthread_mutex_unlock(&team->lock);
    for (unsigned i = 0; i < LOOKS && atomic_load(&team->news) == seen; i++) look_again();
    pthread_mutex_lock(&team->lock);
    while (atomic_load(&team->news) == seen) pthread_cond_wait(&team->told, &team->lock);
}

/* Gives the lock up meanwhile. */
static void take_part(struct par_team *team, struct loop *loop) {
    struct par_team *before = current;
    loop->places--, loop->working++;
    pthread_mutex_unlock(&team->lock);
    current = loop->beside ? team : NULL;
    run(loop);
    current = before;
    pthread_mutex_lock(&team->lock);
    if (--loop->working == 0) tell(team);
}

static struct loop *loop_with_place(const struct par_team *team) {
    struct loop *loop = team->open;
    while (loop && loop->places == 0) loop = loop->next_open;
    return loop;
}

/* Takes part in what is open, or waits for it. */
static void serve(struct par_team *team) {
    struct loop *loop = loop_with_place(team);
    if (loop)
        take_part(team, loop);
    else
        wait_for_news(team);
}

static void *help(void *arg) {
    struct par_team *team = arg;
    pthread_mutex_lock(&team->lock);
    while (!team->over) serve(team);
    pthread_mutex_unlock(&team->lock);
    return NULL;
}

static void open_loop(struct par_team *team, struct loop *loop, unsigned helpers) {
    pthread_mutex_lock(&team->lock);
    while (team->helpers < helpers && pthread_create(&team->thread[team->helpers], NULL, help, team) == 0)
        team->helpers++;
    loop->places = loop->beside ? 1 : helpers;
    loop->next_open = team->open;
    team->open = loop;
    tell(team);
    pthread_mutex_unlock(&team->lock);
}

static void close_loop(struct par_team *team, struct loop *loop) {
    pthread_mutex_lock(&team->lock);
    struct loop **link = &team->open;
    while (*link != loop) link = &(*link)->next_open;
    *link = loop->next_open;
    while (loop->working > 0)
        if (loop->beside)
            serve(team);
        else
            wait_for_news(team);
    pthread_mutex_unlock(&team->lock);
}

static void end_team(struct par_team *team) {
    pthread_mutex_lock(&team->lock);
    team->over = true;
    tell(team);
    pthread_mutex_unlock(&team->lock);
    for (unsigned i = 0; i < team->helpers; i++) pthread_join(team->thread[i], NULL);
}

static struct par_team nobody(void) {
    return (struct par_team){.lock = PTHREAD_MUTEX_INITIALIZER, .told = PTHREAD_COND_INITIALIZER};
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

static void run_with(struct par_team *team, struct loop *loop, unsigned helpers) {
    struct par_team *before = current;
    open_loop(team, loop, helpers);
    current = NULL;
    run(loop);
    current = before;
    close_loop(team, loop);
}

static unsigned all_or(unsigned threads) {
    if (threads == 0) threads = par_processors();
    return threads < MAX_THREADS ? threads : MAX_THREADS;
}

void par_for(unsigned threads, size_t n, size_t grain, void (*body)(void *ctx, size_t begin, size_t end), void *ctx) {
    assert(grain > 0);
    struct loop loop = {.n = n, .grain = grain, .body = body, .ctx = ctx};
    size_t ranges = n / grain + (n % grain != 0);
    threads = all_or(threads);
    if (threads > ranges) threads = (unsigned)ranges;
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

/* ------------------------------------------------------------------------------------------------ side by side */

struct other {
    void (*work)(void *ctx);
    void *ctx;
};

static void do_other(void *ctx, size_t begin, size_t end) {
    const struct other *other = ctx;
    for (; begin < end; begin++) other->work(other->ctx);
}

void par_beside(unsigned threads, void (*mine)(void *ctx), void (*others)(void *ctx), void *ctx) {
    struct other other = {others, ctx};
    struct loop loop = {.n = 1, .grain = 1, .body = do_other, .ctx = &other, .beside = true};
    threads = all_or(threads);
    bool team = current && threads > 1;
    if (team) open_loop(current, &loop, threads - 1);
    mine(ctx);
    run(&loop);
    if (team) close_loop(current, &loop);
}
