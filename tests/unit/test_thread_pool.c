/* Work on other threads: all of it is done, and what is slow leaves threads for what isn't.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/thread_pool.h"

#include <semaphore.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

enum { THREADS = 4, MANY = 100 };

static sem_t gate, fast_ran;
static atomic_int ran;

static void wait_at_gate(void *ctx) {
    (void)ctx;
    sem_wait(&gate);
    ran++;
}

static void run_at_once(void *ctx) {
    (void)ctx;
    ran++;
    sem_post(&fast_ran);
}

static int set_up(void **state) {
    (void)state;
    ran = 0;
    return sem_init(&gate, 0, 0) || sem_init(&fast_ran, 0, 0);
}

static void what_is_fast_does_not_wait_for_what_is_slow(void **state) {
    static struct thread_pool_task slow[MANY], fast[MANY];
    struct thread_pool *pool;
    (void)state;
    assert_int_equal(thread_pool_open(THREADS, &pool), STATUS_OK);
    for (int i = 0; i < MANY; i++) {
        slow[i] = (struct thread_pool_task){.run = wait_at_gate, .slow = true};
        fast[i] = (struct thread_pool_task){.run = run_at_once};
        thread_pool_post(pool, &slow[i]);
        thread_pool_post(pool, &fast[i]);
    }
    for (int i = 0; i < MANY; i++) sem_wait(&fast_ran);
    assert_int_equal(ran, MANY);
    for (int i = 0; i < MANY; i++) sem_post(&gate);
    thread_pool_close(pool);
    assert_int_equal(ran, 2 * MANY);
}

static void closing_runs_what_was_posted(void **state) {
    static struct thread_pool_task task[MANY];
    (void)state;
    for (unsigned threads = 1; threads <= THREADS; threads++) {
        struct thread_pool *pool;
        ran = 0;
        assert_int_equal(thread_pool_open(threads, &pool), STATUS_OK);
        for (int i = 0; i < MANY; i++) {
            task[i] = (struct thread_pool_task){.run = run_at_once, .slow = i % 3 == 0};
            thread_pool_post(pool, &task[i]);
        }
        thread_pool_close(pool);
        assert_int_equal(ran, MANY);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup(what_is_fast_does_not_wait_for_what_is_slow, set_up),
        cmocka_unit_test_setup(closing_runs_what_was_posted, set_up),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
