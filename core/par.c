/* par_for hands out ranges through one atomic counter: no queue, no pool, nothing to shut down.
 *
 * Starting a thread costs some ten microseconds, so callers choose a grain whose work is worth more than that.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/par.h"

#include <assert.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>

enum { MAX_THREADS = 256 };

struct loop {
    atomic_size_t next; /* first index that nobody has taken */
    size_t n, grain;
    void (*body)(void *ctx, size_t begin, size_t end);
    void *ctx;
};

unsigned par_processors(void) {
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof set, &set) != 0) return 1;
    int count = CPU_COUNT(&set);
    return count > 0 ? (unsigned)count : 1;
}

static void *run(void *arg) {
    struct loop *loop = arg;
    for (;;) {
        size_t begin = atomic_fetch_add_explicit(&loop->next, loop->grain, memory_order_relaxed);
        if (begin >= loop->n) return NULL;
        size_t end = loop->n - begin < loop->grain ? loop->n : begin + loop->grain;
        loop->body(loop->ctx, begin, end);
    }
}

void par_for(unsigned threads, size_t n, size_t grain, void (*body)(void *ctx, size_t begin, size_t end), void *ctx) {
    assert(grain > 0);
    struct loop loop = {.n = n, .grain = grain, .body = body, .ctx = ctx};
    size_t ranges = n / grain + (n % grain != 0);
    if (threads == 0) threads = par_processors();
    if (threads > ranges) threads = (unsigned)ranges;
    if (threads > MAX_THREADS) threads = MAX_THREADS;
    pthread_t thread[MAX_THREADS];
    unsigned started = 0;
    while (started + 1 < threads && pthread_create(&thread[started], NULL, run, &loop) == 0) started++;
    run(&loop);
    for (unsigned i = 0; i < started; i++) pthread_join(thread[i], NULL);
}
