/* A catalog of a test's own, in a folder of its own, with jobs that differ by a number; of each backend in turn.
 *
 * PostgreSQL's is a database of its own on the server that WHITTLE_CATALOG names (tests/tools/with_postgres.sh starts
 * one); where it names none, that backend is skipped.
 *
 * To run the contract over another backend: a row in the table of catalog_fixture.c.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_UNIT_CATALOG_FIXTURE_H
#define WHITTLE_TESTS_UNIT_CATALOG_FIXTURE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "server/catalog/catalog.h"

struct catalog_fixture {
    char folder[64], path[96], url[256];
    struct catalog *catalog;
    void (*remove)(struct catalog_fixture *f); /* what the folder doesn't hold of it */
    struct error error;
};

/* Runs the tests once for each backend, or for each that several hosts share; returns how many failed. */
int catalog_fixture_run(struct CMUnitTest *tests, size_t count);
int catalog_fixture_run_shared(struct CMUnitTest *tests, size_t count);

/* For cmocka: *state is the fixture. */
int catalog_fixture_set_up(void **state);
int catalog_fixture_tear_down(void **state);
#define CATALOG_TEST(name) cmocka_unit_test_setup_teardown(name, catalog_fixture_set_up, catalog_fixture_tear_down)

/* Writes another version of the schema, an expression of SQL, where several hosts share the catalog. */
bool catalog_fixture_set_version(struct catalog_fixture *f, const char *version);

/* Closes the catalog, and opens it again. */
void catalog_fixture_reopen(struct catalog_fixture *f);

/* The id of job n: ids are in the order of n.  Returns id. */
const char *catalog_fixture_id(int n, char id[JOB_ID_BYTES]);

/* Submits job n where at most max may wait; the other one must succeed. */
enum status catalog_fixture_submit_limited(struct catalog_fixture *f, int n, uint64_t max);
void catalog_fixture_submit(struct catalog_fixture *f, int n);

/* The catalog's functions of these names, which must succeed. */
bool catalog_fixture_claim(struct catalog_fixture *f, struct job *job);
bool catalog_fixture_finish(struct catalog_fixture *f, enum job_event event, const struct job *job);
enum catalog_presence catalog_fixture_get(struct catalog_fixture *f, int n, struct job *job);

/* Whether the key could be taken hold of. */
bool catalog_fixture_holds(struct catalog *catalog, const char *principal, const char *key,
                           struct catalog_key_hold *hold);

/* Whether the cloud was removed at now_ms from a store that may do so late, and that says so for certain or not.  Adds
 * to *removals. */
bool catalog_fixture_removes(struct catalog *catalog, const char *cloud, int64_t now_ms, bool is_certain,
                             int *removals);

/* So many wait and run. */
void catalog_fixture_assert_depth(struct catalog_fixture *f, uint64_t waiting, uint64_t running);

#endif
