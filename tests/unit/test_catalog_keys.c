/* The contract of catalogs: keys under way, one request at a time for each principal and key.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "tests/unit/catalog_fixture.h"

static void a_key_is_its_principals_own(void **state) {
    struct catalog *keys = ((struct catalog_fixture *)*state)->catalog;
    struct catalog_key_hold first = {0}, again = {0}, other = {0}, another = {0};
    assert_true(catalog_fixture_holds(keys, "alice", "k", &first));
    assert_false(catalog_fixture_holds(keys, "alice", "k", &again));
    assert_false(again.held);
    assert_true(catalog_fixture_holds(keys, "bob", "k", &other));
    assert_true(catalog_fixture_holds(keys, "alice", "l", &another));
    catalog_release_key(keys, &again); /* which has none */
    catalog_release_key(keys, &first);
    assert_true(catalog_fixture_holds(keys, "alice", "k", &again));
    assert_false(catalog_fixture_holds(keys, "bob", "k", &first));
    assert_false(catalog_fixture_holds(keys, "alice", "l", &first));
    catalog_release_key(keys, &other);
    catalog_release_key(keys, &another);
    catalog_release_key(keys, &again);
    assert_true(catalog_fixture_holds(keys, "bob", "k", &first));
    catalog_release_key(keys, &first);
}

int main(void) {
    struct CMUnitTest tests[] = {CATALOG_TEST(a_key_is_its_principals_own)};
    return catalog_fixture_run(tests, sizeof tests / sizeof *tests);
}
