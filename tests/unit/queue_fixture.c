/* A queue of a test's own.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/queue_fixture.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "tests/unit/folder.h"

int queue_fixture_set_up(void **state) {
    struct queue_fixture *f = calloc(1, sizeof *f);
    snprintf(f->folder, sizeof f->folder, "/tmp/test_queue.XXXXXX");
    if (!f || !mkdtemp(f->folder)) return -1;
    snprintf(f->path, sizeof f->path, "%s/queue.db", f->folder);
    *state = f;
    return queue_open(f->path, &f->queue, &f->error) == STATUS_OK ? 0 : -1;
}

int queue_fixture_tear_down(void **state) {
    struct queue_fixture *f = *state;
    queue_close(f->queue);
    folder_remove(f->folder);
    free(f);
    return 0;
}

void queue_fixture_reopen(struct queue_fixture *f) {
    queue_close(f->queue);
    assert_int_equal(queue_open(f->path, &f->queue, &f->error), STATUS_OK);
}

/* Ids in the order of n. */
const char *queue_fixture_id(int n, char id[JOB_ID_BYTES]) {
    snprintf(id, JOB_ID_BYTES, "%08d-0000-7000-8000-000000000000", n);
    return id;
}

enum status queue_fixture_submit_limited(struct queue_fixture *f, int n, uint64_t max) {
    struct job job = {.created_ms = 1000 + n, .input_bytes = 12, .input_format = "xyz"};
    queue_fixture_id(n, job.id);
    snprintf(job.cloud, sizeof job.cloud, "cloud%d", n % 2);
    snprintf(job.label, sizeof job.label, "%s", n % 2 ? "odd" : "even");
    snprintf(job.principal, sizeof job.principal, "%s", n % 3 ? "" : "third");
    params_defaults(&job.params);
    job.params.ratio = 0.25;
    return queue_submit(f->queue, &job, &(struct queue_limits){.waiting = max}, &f->error);
}

void queue_fixture_submit(struct queue_fixture *f, int n) {
    assert_int_equal(queue_fixture_submit_limited(f, n, 1000), STATUS_OK);
}

bool queue_fixture_claim(struct queue_fixture *f, struct job *job) {
    bool found;
    assert_int_equal(queue_claim(f->queue, INT64_MAX, job, &found, &f->error), STATUS_OK);
    return found;
}

bool queue_fixture_finish(struct queue_fixture *f, enum job_event event, const struct job *job) {
    bool changed;
    assert_int_equal(queue_finish(f->queue, event, job, &changed, &f->error), STATUS_OK);
    return changed;
}

enum queue_presence queue_fixture_get(struct queue_fixture *f, int n, struct job *job) {
    enum queue_presence presence;
    struct queue_tombstone tombstone;
    char id[JOB_ID_BYTES];
    assert_int_equal(queue_get(f->queue, queue_fixture_id(n, id), job, &presence, &tombstone, &f->error), STATUS_OK);
    return presence;
}

void queue_fixture_assert_depth(struct queue_fixture *f, uint64_t waiting, uint64_t running) {
    uint64_t w, r;
    queue_depth(f->queue, &w, &r);
    assert_int_equal(w, waiting);
    assert_int_equal(r, running);
}
