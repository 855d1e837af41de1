/* The contract of catalogs: rows as they are, for moving them from one catalog to another.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/unit/catalog_fixture.h"

enum { MANY = 5 };

static size_t read_rows(struct catalog_fixture *f, enum catalog_table_name table, const char *of, uint64_t skip,
                        struct catalog_row *rows, size_t max) {
    size_t count;
    assert_int_equal(catalog_read_rows(f->catalog, table, of, skip, rows, max, &count, &f->error), STATUS_OK);
    return count;
}

static uint64_t add_rows(struct catalog_fixture *f, const struct catalog_row *rows, size_t count) {
    uint64_t added = 0;
    assert_int_equal(catalog_add_rows(f->catalog, rows, count, &added, &f->error), STATUS_OK);
    return added;
}

static void done_rows(struct catalog_row *rows, size_t count) {
    for (size_t i = 0; i < count; i++) catalog_row_done(&rows[i]);
}

/* Job 1, ended well, with two outputs, a report and a time. */
static void finish_one(struct catalog_fixture *f, struct job *job) {
    catalog_fixture_submit(f, 1);
    assert_true(catalog_fixture_claim(f, job));
    job->cpu_s = 1.5;
    job->report = strdup("{\"a\":1}");
    job->output_count = 2;
    job->output[0] = (struct job_output){"cloud.ply", 10, "aa"};
    job->output[1] = (struct job_output){"mesh.ply", 20, "bb"};
    assert_true(catalog_fixture_finish(f, JOB_DONE, job));
}

static void a_job_is_the_same_after_it_was_moved(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_row rows[4];
    struct job before, moved;
    struct job job;
    char id[JOB_ID_BYTES];
    bool changed;
    finish_one(f, &job);
    job_done(&job);
    catalog_fixture_id(1, id);
    assert_int_equal(catalog_fixture_get(f, 1, &before), CATALOG_PRESENT);
    struct catalog_usage had = catalog_usage(f->catalog, before.principal);
    size_t jobs = read_rows(f, CATALOG_TABLE_JOBS, NULL, 0, rows, 2);
    assert_int_equal(jobs, 1);
    assert_string_equal(rows[0].cell[CATALOG_JOB_ID].text, id);
    assert_int_equal(rows[0].cell[CATALOG_JOB_STATE].integer, JOB_SUCCESSFUL);
    assert_int_equal(read_rows(f, CATALOG_TABLE_OUTPUTS, id, 0, rows + 1, 3), 2);

    assert_int_equal(catalog_delete(f->catalog, id, "moved", &changed, &f->error), STATUS_OK);
    assert_int_equal(catalog_fixture_get(f, 1, &moved), CATALOG_GONE);
    assert_int_equal(add_rows(f, rows, 3), 3);
    assert_int_equal(add_rows(f, rows, 3), 0);
    catalog_fixture_reopen(f);
    assert_int_equal(catalog_fixture_get(f, 1, &moved), CATALOG_PRESENT);
    assert_int_equal(moved.state, before.state);
    assert_int_equal(moved.attempt, before.attempt);
    assert_int_equal(moved.finished_ms, before.finished_ms);
    assert_int_equal(moved.expires_ms, before.expires_ms);
    assert_string_equal(moved.report, before.report);
    assert_true(moved.cpu_s == before.cpu_s);
    assert_int_equal(moved.output_count, 2);
    assert_string_equal(moved.output[1].sha256, "bb");
    assert_int_equal(catalog_usage(f->catalog, before.principal).bytes, had.bytes);
    job_done(&before);
    job_done(&moved);
    done_rows(rows, 3);
}

/* It has no lease then: whoever serves the catalog queues it again. */
static void a_job_that_ran_is_lost_after_it_was_moved(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_row row;
    struct job job, lost[2];
    size_t count;
    catalog_fixture_submit(f, 1);
    assert_true(catalog_fixture_claim(f, &job));
    assert_int_equal(read_rows(f, CATALOG_TABLE_JOBS, NULL, 0, &row, 1), 1);
    job_done(&job);
    row.cell[CATALOG_JOB_ID].text[35] = '9'; /* another one's id */
    assert_int_equal(add_rows(f, &row, 1), 1);
    assert_int_equal(catalog_list_lost(f->catalog, NULL, lost, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(lost[0].id, row.cell[CATALOG_JOB_ID].text);
    job_done(&lost[0]);
    catalog_row_done(&row);
}

static void pages_follow_each_other(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_row rows[MANY];
    char id[JOB_ID_BYTES];
    for (int i = 1; i <= MANY; i++) catalog_fixture_submit(f, i);
    for (int i = 0; i < MANY; i += 2) {
        size_t count = read_rows(f, CATALOG_TABLE_JOBS, NULL, (uint64_t)i, rows, 2);
        assert_int_equal(count, i + 1 < MANY ? 2 : 1);
        assert_string_equal(rows[0].cell[CATALOG_JOB_ID].text, catalog_fixture_id(i + 1, id));
        done_rows(rows, count);
    }
    assert_int_equal(read_rows(f, CATALOG_TABLE_JOBS, NULL, MANY, rows, 2), 0);
    assert_int_equal(read_rows(f, CATALOG_TABLE_OUTPUTS, "none", 0, rows, 2), 0);
}

static void every_table_can_be_read(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_row row;
    for (enum catalog_table_name table = 0; table < CATALOG_TABLE_COUNT; table++) {
        assert_true(catalog_table_columns(&catalog_tables[table]) > 3);
        assert_int_equal(read_rows(f, table, NULL, 0, &row, 1), 0);
    }
    bool served = true;
    assert_int_equal(catalog_is_served(f->catalog, &served, &f->error), STATUS_OK);
    assert_false(served);
}

int main(void) {
    struct CMUnitTest tests[] = {
        CATALOG_TEST(a_job_is_the_same_after_it_was_moved),
        CATALOG_TEST(a_job_that_ran_is_lost_after_it_was_moved),
        CATALOG_TEST(pages_follow_each_other),
        CATALOG_TEST(every_table_can_be_read),
    };
    return catalog_fixture_run(tests, sizeof tests / sizeof *tests);
}
