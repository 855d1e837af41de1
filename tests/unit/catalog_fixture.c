/* A catalog of a test's own.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/catalog_fixture.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/catalog/postgres/pq.h"

#include "tests/unit/folder.h"

struct backend {
    const char *name;
    bool (*make_url)(struct catalog_fixture *f);
    void (*remove)(struct catalog_fixture *f); /* NULL = it goes with the folder */
    const char *needs;                         /* a variable of the environment; NULL = none */
};

static bool make_sqlite(struct catalog_fixture *f) {
    snprintf(f->path, sizeof f->path, "%s/catalog.db", f->folder);
    snprintf(f->url, sizeof f->url, "sqlite:%s", f->path);
    return true;
}

/* Asks the server itself: CREATE DATABASE name, DROP DATABASE name. */
static bool ask_server(struct catalog_fixture *f, const char *what, const char *more) {
    const char *server = getenv("WHITTLE_CATALOG");
    char text[128];
    struct pq *pq = NULL;
    struct pq_link *link;
    snprintf(text, sizeof text, "%s %s%s", what, f->path, more);
    bool done = pq_open(server, &pq, &f->error) == STATUS_OK && pq_take(pq, &link, &f->error) == STATUS_OK;
    if (done) {
        done = pq_execute(link, text, &f->error) == STATUS_OK;
        pq_done(link);
    }
    pq_close(pq);
    return done;
}

/* postgresql://whittle@/postgres?host=... with the name of another database. */
static bool make_postgres(struct catalog_fixture *f) {
    const char *server = getenv("WHITTLE_CATALOG"), *slash = strrchr(server, '@');
    const char *query = strchr(server, '?');
    slash = strchr(slash ? slash : server + strlen("postgresql://"), '/');
    snprintf(f->path, sizeof f->path, "t%d_%s", (int)getpid(), strrchr(f->folder, '.') + 1);
    for (char *c = f->path; *c; c++) *c = (char)tolower(*c);
    snprintf(f->url, sizeof f->url, "%.*s%s%s", (int)(slash + 1 - server), server, f->path, query ? query : "");
    return ask_server(f, "CREATE DATABASE", "") && catalog_migrate(f->url, &f->error) == STATUS_OK;
}

static void remove_postgres(struct catalog_fixture *f) { ask_server(f, "DROP DATABASE", " WITH (FORCE)"); }

static struct backend backends[] = {{"sqlite", make_sqlite, NULL, NULL},
                                    {"postgresql", make_postgres, remove_postgres, "WHITTLE_CATALOG"}};

static int run(struct CMUnitTest *tests, size_t count, size_t first) {
    int failed = 0;
    for (size_t b = first; b < sizeof backends / sizeof *backends; b++) {
        if (backends[b].needs && !getenv(backends[b].needs)) {
            printf("skipped: %s: %s names no server\n", backends[b].name, backends[b].needs);
            continue;
        }
        for (size_t i = 0; i < count; i++) tests[i].initial_state = &backends[b];
        failed += _cmocka_run_group_tests(backends[b].name, tests, count, NULL, NULL);
    }
    return failed;
}

int catalog_fixture_run(struct CMUnitTest *tests, size_t count) { return run(tests, count, 0); }

int catalog_fixture_run_shared(struct CMUnitTest *tests, size_t count) { return run(tests, count, 1); }

bool catalog_fixture_set_version(struct catalog_fixture *f, const char *version) {
    char text[128];
    struct pq *pq = NULL;
    struct pq_link *link;
    snprintf(text, sizeof text, "UPDATE schema_steps SET count = %s", version);
    bool done = pq_open(f->url, &pq, &f->error) == STATUS_OK && pq_take(pq, &link, &f->error) == STATUS_OK;
    if (done) {
        done = pq_execute(link, text, &f->error) == STATUS_OK;
        pq_done(link);
    }
    pq_close(pq);
    return done;
}

/* A test that isn't run by catalog_fixture_run is of the first backend. */
int catalog_fixture_set_up(void **state) {
    struct catalog_fixture *f = calloc(1, sizeof *f);
    struct backend *backend = *state ? *state : &backends[0];
    if (!f) return -1;
    snprintf(f->folder, sizeof f->folder, "/tmp/test_catalog.XXXXXX");
    if (!mkdtemp(f->folder)) return -1;
    f->remove = backend->remove;
    *state = f;
    if (backend->make_url(f) && catalog_open(f->url, &f->catalog, &f->error) == STATUS_OK) return 0;
    fprintf(stderr, "%s: %s\n", backend->name, f->error.text);
    return -1;
}

int catalog_fixture_tear_down(void **state) {
    struct catalog_fixture *f = *state;
    catalog_close(f->catalog);
    if (f->remove) f->remove(f);
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
    enum status status = catalog_submit(f->catalog, &job, &(struct catalog_limits){.waiting = max}, &f->error);
    if (status == STATUS_IO) print_message("%s\n", f->error.text);
    return status;
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

struct removing {
    bool is_certain;
    int *removals;
};

static bool count_removal(void *ctx, const char *cloud) {
    const struct removing *removing = ctx;
    (void)cloud;
    ++*removing->removals;
    return removing->is_certain;
}

bool catalog_fixture_removes(struct catalog *catalog, const char *cloud, int64_t now_ms, bool is_certain,
                             int *removals) {
    struct removing removing = {is_certain, removals};
    const struct catalog_removal removal = {
        .now_ms = now_ms, .may_be_late = true, .remove = count_removal, .ctx = &removing};
    struct error error;
    bool removed;
    assert_int_equal(catalog_remove_cloud(catalog, cloud, &removal, &removed, &error), STATUS_OK);
    return removed;
}

void catalog_fixture_assert_depth(struct catalog_fixture *f, uint64_t waiting, uint64_t running) {
    uint64_t w, r;
    catalog_depth(f->catalog, &w, &r);
    assert_int_equal(w, waiting);
    assert_int_equal(r, running);
}

bool catalog_fixture_holds(struct catalog *catalog, const char *principal, const char *key,
                           struct catalog_key_hold *hold) {
    struct error error;
    *hold = (struct catalog_key_hold){.held = false};
    assert_int_equal(catalog_hold_key(catalog, principal, key, hold, &error), STATUS_OK);
    return hold->held;
}
