/* A blob store of a test's own, and a folder to put from; of each backend in turn.
 *
 * S3's is a prefix of its own in the bucket that WHITTLE_BLOBS names (tests/tools/with_s3.sh starts one); where it
 * names none, that backend is skipped.
 *
 * To run the contract over another backend: a row in the table of blobs_fixture.c.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_UNIT_BLOBS_FIXTURE_H
#define WHITTLE_TESTS_UNIT_BLOBS_FIXTURE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "server/blobs/blobs.h"

struct blobs_fixture {
    char folder[64], url[BLOBS_URL_BYTES];
    int scratch_fd; /* where files are before they are put */
    struct blobs *blobs;
    struct error error;
};

/* Runs the tests once for each backend; returns how many failed. */
int blobs_fixture_run(struct CMUnitTest *tests, size_t count);

/* For cmocka: *state is the fixture. */
int blobs_fixture_set_up(void **state);
int blobs_fixture_tear_down(void **state);
#define BLOBS_TEST(name) cmocka_unit_test_setup_teardown(name, blobs_fixture_set_up, blobs_fixture_tear_down)

/* Closes the store, and opens it again. */
void blobs_fixture_reopen(struct blobs_fixture *f);

/* Puts texts as blobs of a folder, each with its own hash; names and texts end with NULL. */
enum status blobs_fixture_put(struct blobs_fixture *f, const char *folder, const char *const *names_and_texts);

/* Whether the blob is there, and then asserts that this is its content. */
bool blobs_fixture_has(struct blobs_fixture *f, const char *name, const char *text);

/* The names of a folder, each with a comma behind it. */
const char *blobs_fixture_list(struct blobs_fixture *f, const char *folder, char text[512]);

#endif
