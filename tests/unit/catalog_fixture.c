/* A catalog of a test's own.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/catalog_fixture.h"

#include <stdio.h>
#include <stdlib.h>

#include "tests/unit/folder.h"

struct backend {
    const char *name;
    void (*make_url)(struct catalog_fixture *f);
};

static void make_sqlite(struct catalog_fixture *f) {
    snprintf(f->path, sizeof f->path, "%s/catalog.db", f->folder);
    snprintf(f->url, sizeof f->url, "sqlite:%s", f->path);
}

static struct backend backends[] = {{"sqlite", make_sqlite}};

int catalog_fixture_run(struct CMUnitTest *tests, size_t count) {
    int failed = 0;
    for (size_t b = 0; b < sizeof backends / sizeof *backends; b++) {
        for (size_t i = 0; i < count; i++) tests[i].initial_state = &backends[b];
        failed += _cmocka_run_group_tests(backends[b].name, tests, count, NULL, NULL);
    }
    return failed;
}

/* A test that isn't run by catalog_fixture_run is of the first backend. */
int catalog_fixture_set_up(void **state) {
    struct catalog_fixture *f = calloc(1, sizeof *f);
    struct backend *backend = *state ? *state : &backends[0];
    if (!f) return -1;
    snprintf(f->folder, sizeof f->folder, "/tmp/test_catalog.XXXXXX");
    if (!mkdtemp(f->folder)) return -1;
    backend->make_url(f);
    *state = f;
    return catalog_open(f->url, &f->catalog, &f->error) == STATUS_OK ? 0 : -1;
}

int catalog_fixture_tear_down(void **state) {
    struct catalog_fixture *f = *state;
    catalog_close(f->catalog);
    folder_remove(f->folder);
    free(f);
    return 0;
}

void catalog_fixture_reopen(struct catalog_fixture *f) {
    catalog_close(f->catalog);
    assert_int_equal(catalog_open(f->url, &f->catalog, &f->error), STATUS_OK);
}

/* Ids in the order of n. */
const char *catalog_fixture_id(int n, char id[JOB_ID_BYTES]) {
    snprintf(id, JOB_ID_BYTES, "%08d-0000-7000-8000-000000000000", n);
    return id;
}

enum status catalog_fixture_submit_limited(struct catalog_fixture *f, int n, uint64_t max) {
    struct job job = {.created_ms = 1000 + n, .input_bytes = 12, .input_format = "xyz"};
    catalog_fixture_id(n, job.id);
    snprintf(job.cloud, sizeof job.cloud, "cloud%d", n % 2);
    snprintf(job.label, sizeof job.label, "%s", n % 2 ? "odd" : "even");
    snprintf(job.principal, sizeof job.principal, "%s", n % 3 ? "" : "third");
    params_defaults(&job.params);
    job.params.ratio = 0.25;
    return catalog_submit(f->catalog, &job, &(struct catalog_limits){.waiting = max}, &f->error);
}

void catalog_fixture_submit(struct catalog_fixture *f, int n) {
    assert_int_equal(catalog_fixture_submit_limited(f, n, 1000), STATUS_OK);
}

bool catalog_fixture_claim(struct catalog_fixture *f, struct job *job) {
    bool found;
    struct catalog_claim by = {"host", 60000, INT64_MAX};
    assert_int_equal(catalog_claim(f->catalog, &by, job, &found, &f->error), STATUS_OK);
    return found;
}

bool catalog_fixture_finish(struct catalog_fixture *f, enum job_event event, const struct job *job) {
    bool changed;
    assert_int_equal(catalog_finish(f->catalog, event, job, &changed, &f->error), STATUS_OK);
    return changed;
}

enum catalog_presence catalog_fixture_get(struct catalog_fixture *f, int n, struct job *job) {
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    char id[JOB_ID_BYTES];
    assert_int_equal(catalog_get(f->catalog, catalog_fixture_id(n, id), job, &presence, &tombstone, &f->error),
                     STATUS_OK);
    return presence;
}

void catalog_fixture_assert_depth(struct catalog_fixture *f, uint64_t waiting, uint64_t running) {
    uint64_t w, r;
    catalog_depth(f->catalog, &w, &r);
    assert_int_equal(w, waiting);
    assert_int_equal(r, running);
}
