/* A queue of a test's own, in a folder of its own, with jobs that differ by a number.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_UNIT_QUEUE_FIXTURE_H
#define WHITTLE_TESTS_UNIT_QUEUE_FIXTURE_H

#include "server/queue.h"

struct queue_fixture {
    char folder[64], path[96];
    struct queue *queue;
    struct error error;
};

/* For cmocka: *state is the fixture. */
int queue_fixture_set_up(void **state);
int queue_fixture_tear_down(void **state);
#define QUEUE_TEST(name) cmocka_unit_test_setup_teardown(name, queue_fixture_set_up, queue_fixture_tear_down)

/* Closes the queue, and opens it again. */
void queue_fixture_reopen(struct queue_fixture *f);

/* The id of job n: ids are in the order of n.  Returns id. */
const char *queue_fixture_id(int n, char id[JOB_ID_BYTES]);

/* Submits job n where at most max may wait; the other one must succeed. */
enum status queue_fixture_submit_limited(struct queue_fixture *f, int n, uint64_t max);
void queue_fixture_submit(struct queue_fixture *f, int n);

/* The queue's functions of these names, which must succeed. */
bool queue_fixture_claim(struct queue_fixture *f, struct job *job);
bool queue_fixture_finish(struct queue_fixture *f, enum job_event event, const struct job *job);
enum queue_presence queue_fixture_get(struct queue_fixture *f, int n, struct job *job);

/* So many wait and run. */
void queue_fixture_assert_depth(struct queue_fixture *f, uint64_t waiting, uint64_t running);

#endif
