/* The contract of catalogs that several hosts share: what one process holds the others see, and what it changes they
 * are told, with nothing in memory that they would have to know.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "server/base/away.h"
#include "server/catalog/postgres/pq.h"
#include "tests/unit/catalog_fixture.h"

static struct catalog *open_again(struct catalog_fixture *f) {
    struct catalog *other = NULL;
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_OK);
    return other;
}

static void a_key_is_held_everywhere(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    struct catalog_key_hold here = {0}, there = {0};
    assert_true(catalog_fixture_holds(f->catalog, "ann", "k", &here));
    assert_false(catalog_fixture_holds(other, "ann", "k", &there));
    catalog_release_key(f->catalog, &here);
    assert_true(catalog_fixture_holds(other, "ann", "k", &there));
    assert_false(catalog_fixture_holds(f->catalog, "ann", "k", &here));
    catalog_close(other); /* it ends, and what it held does */
    assert_true(catalog_fixture_holds(f->catalog, "ann", "k", &here));
    catalog_release_key(f->catalog, &here);
}

static void what_is_reserved_counts_everywhere(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    assert_int_equal(catalog_reserve(f->catalog, "ann", 60, 100, &f->error), STATUS_OK);
    assert_int_equal(catalog_reserve(other, "ann", 60, 100, &f->error), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_bytes");
    assert_int_equal(catalog_reserve(other, "ann", 40, 100, &f->error), STATUS_OK);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 100);
    catalog_release(f->catalog, "ann", 50);
    assert_int_equal(catalog_usage(other, "ann").reserved, 50);
    catalog_close(other);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 10);
}

static void a_secret_is_the_first_that_is_brought(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    char here[CATALOG_SECRET_BYTES], there[CATALOG_SECRET_BYTES];
    assert_int_equal(catalog_secret(other, "key", "aa", there, &f->error), STATUS_OK);
    assert_int_equal(catalog_secret(f->catalog, "key", "bb", here, &f->error), STATUS_OK);
    assert_string_equal(there, "aa");
    assert_string_equal(here, "aa");
    assert_int_equal(catalog_secret(f->catalog, "another", "bb", here, &f->error), STATUS_OK);
    assert_string_equal(here, "bb");
    catalog_close(other);
}

/* Between a cloud's upload and its job's row nobody else removes it, and of a host that has gone it is found. */
static void a_cloud_that_is_expected_stays(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    char names[2][JOB_HASH_BYTES];
    int removals = 0;
    size_t count;
    assert_int_equal(catalog_expect_cloud(f->catalog, "cloud1", 1000, &f->error), STATUS_OK);
    assert_false(catalog_fixture_removes(other, "cloud1", 999, true, &removals));
    assert_int_equal(catalog_list_unused_clouds(other, 999, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    catalog_fixture_submit(f, 1); /* on cloud1 */
    assert_false(catalog_fixture_removes(other, "cloud1", 2000, true, &removals));
    assert_int_equal(catalog_expect_cloud(f->catalog, "cloud0", 1000, &f->error), STATUS_OK);
    assert_int_equal(catalog_list_unused_clouds(other, 1000, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], "cloud0");
    assert_int_equal(removals, 0);
    assert_true(catalog_fixture_removes(other, "cloud0", 1000, true, &removals));
    assert_int_equal(removals, 1);
    assert_int_equal(catalog_list_unused_clouds(other, 9000, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    catalog_close(other);
}

static bool is_away(enum status status, const struct error *error) {
    return status == STATUS_IO && error_is_away(error);
}

/* Nobody may put it again until it was removed for certain, when what was asked for before can't happen any more. */
static void a_cloud_whose_removal_may_come_late_is_waited_for(void **state) {
    enum { BEGUN = 5000, OVER = BEGUN + CATALOG_REMOVAL_GRACE_MS };
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    char names[2][JOB_HASH_BYTES];
    int removals = 0;
    size_t count;
    assert_true(catalog_fixture_removes(f->catalog, "cloud1", BEGUN, false, &removals));
    assert_true(is_away(catalog_expect_cloud(other, "cloud1", BEGUN, &f->error), &f->error));
    assert_false(catalog_fixture_removes(other, "cloud1", OVER - 1, true, &removals));
    assert_int_equal(catalog_list_unused_clouds(other, OVER - 1, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_list_unused_clouds(other, OVER, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_true(catalog_fixture_removes(other, "cloud1", OVER, true, &removals));
    assert_int_equal(removals, 2);
    assert_false(catalog_fixture_removes(other, "cloud1", OVER + 1, true, &removals));
    struct catalog_cloud record = {.sha256 = "cloud1", .principal = "ann", .bytes = 1};
    assert_true(is_away(catalog_put_cloud(f->catalog, &record, 0, &f->error), &f->error)); /* it is gone */
    assert_int_equal(catalog_expect_cloud(f->catalog, "cloud1", OVER, &f->error), STATUS_OK);
    assert_int_equal(catalog_put_cloud(f->catalog, &record, 0, &f->error), STATUS_OK);
    catalog_fixture_submit(f, 1);
    catalog_close(other);
}

/* Who stores it may take longer than it is expected, and end with the last byte: what is there then is named by no row
 * but by that of the removal. */
static void a_cloud_that_came_behind_its_removal_goes(void **state) {
    enum { REMOVED = 5000, LATER = REMOVED + 24 * 3600 * 1000 };
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    char names[2][JOB_HASH_BYTES];
    int removals = 0;
    size_t count;
    assert_int_equal(catalog_expect_cloud(f->catalog, "cloud1", 1000, &f->error), STATUS_OK);
    assert_true(catalog_fixture_removes(other, "cloud1", REMOVED, true, &removals));
    assert_int_equal(catalog_list_unused_clouds(other, LATER - 1, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_list_unused_clouds(other, LATER, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_true(catalog_fixture_removes(other, "cloud1", LATER, true, &removals));
    assert_int_equal(removals, 2);
    assert_int_equal(catalog_list_unused_clouds(other, 3 * (int64_t)LATER, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0); /* it is forgotten */
    catalog_close(other);
}

struct remover {
    struct catalog *catalog;
    bool removed;
    atomic_bool is_over;
};

static void *remove_cloud1(void *ctx) {
    struct remover *remover = ctx;
    int removals = 0;
    remover->removed = catalog_fixture_removes(remover->catalog, "cloud1", INT64_MAX, true, &removals);
    remover->is_over = true;
    return NULL;
}

/* Whoever comes so late with a row that it isn't known any more who was about to refer to the cloud, and is about to
 * commit it. */
static void a_cloud_whose_row_is_being_added_stays(void **state) {
    struct catalog_fixture *f = *state;
    struct remover remover = {.catalog = f->catalog};
    struct pq *pq;
    struct pq_link *late, *looking;
    int64_t added = 0, waiting = 0;
    pthread_t thread;
    assert_int_equal(pq_open(f->url, &pq, &f->error), STATUS_OK);
    assert_int_equal(pq_begin(pq, &late, &f->error), STATUS_OK);
    assert_int_equal(pq_number(late,
                               "INSERT INTO clouds (sha256, principal, created, expires, bytes, points, format) "
                               "VALUES ('cloud1', 'ann', 1, 0, 1, 1, 'xyz') RETURNING 1",
                               NULL, 0, &added, &f->error),
                     STATUS_OK);
    pthread_create(&thread, NULL, remove_cloud1, &remover);
    while (!remover.is_over && !waiting) {
        assert_int_equal(pq_take(pq, &looking, &f->error), STATUS_OK);
        assert_int_equal(pq_number(looking,
                                   "SELECT count(*) FROM pg_locks JOIN pg_stat_activity USING (pid) "
                                   "WHERE NOT granted AND datname = current_database()",
                                   NULL, 0, &waiting, &f->error),
                         STATUS_OK);
        pq_done(looking);
    }
    assert_int_equal(pq_end(late, STATUS_OK, NULL, &f->error), STATUS_OK);
    pthread_join(thread, NULL);
    assert_false(remover.removed);
    pq_close(pq);
}

/* "third" has 3 and 6. */
static void turns_are_taken_across_hosts(void **state) {
    static const int order[] = {1, 3, 2, 6, 4};
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f), *const hosts[] = {f->catalog, other};
    char id[JOB_ID_BYTES];
    for (int n = 6; n > 0; n -= n == 6 ? 2 : 1) catalog_fixture_submit(f, n);
    for (int i = 0; i < 5; i++) {
        struct catalog_claim by = {i % 2 ? "b" : "a", 60000, INT64_MAX};
        struct job job;
        bool found;
        assert_int_equal(catalog_claim(hosts[i % 2], &by, &job, &found, &f->error), STATUS_OK);
        assert_true(found);
        assert_string_equal(job.id, catalog_fixture_id(order[i], id));
        job_done(&job);
    }
    catalog_close(other);
}

/* What a host is told of another one's changes, to be waited for. */
struct told {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    int times[CATALOG_DELETED + 1];
};

static void hear(void *ctx, enum catalog_change change, const char *id) {
    struct told *told = ctx;
    (void)id;
    pthread_mutex_lock(&told->lock);
    told->times[change]++;
    pthread_cond_broadcast(&told->changed);
    pthread_mutex_unlock(&told->lock);
}

static void wait_for(struct told *told, enum catalog_change change) {
    struct timespec end;
    clock_gettime(CLOCK_REALTIME, &end);
    end.tv_sec += 120;
    pthread_mutex_lock(&told->lock);
    while (!told->times[change])
        if (pthread_cond_timedwait(&told->changed, &told->lock, &end) != 0) fail_msg("change %d isn't told", change);
    told->times[change] = 0;
    pthread_mutex_unlock(&told->lock);
}

static void others_are_told(void **state) {
    struct catalog_fixture *f = *state;
    struct told told = {PTHREAD_MUTEX_INITIALIZER, PTHREAD_COND_INITIALIZER, {0}};
    struct catalog *other = open_again(f);
    struct job job;
    bool held, changed;
    catalog_watch(other, hear, &told);
    catalog_fixture_submit(f, 1);
    wait_for(&told, CATALOG_WAITS);
    assert_true(catalog_fixture_claim(f, &job));
    wait_for(&told, CATALOG_CHANGED);
    snprintf(job.stage, sizeof job.stage, "refine");
    assert_int_equal(catalog_progress(f->catalog, &job, &held, &f->error), STATUS_OK);
    wait_for(&told, CATALOG_CHANGED);
    assert_int_equal(catalog_cancel(f->catalog, job.id, &f->error), STATUS_OK);
    wait_for(&told, CATALOG_CANCELLED);
    assert_true(catalog_fixture_finish(f, JOB_DISMISS, &job));
    wait_for(&told, CATALOG_CHANGED);
    assert_int_equal(catalog_delete(f->catalog, job.id, "deleted", &changed, &f->error), STATUS_OK);
    wait_for(&told, CATALOG_DELETED);
    catalog_close(other);
    job_done(&job);
}

/* Which of these jobs a host was told of. */
enum { MANY = 600 };
struct told_of {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    char id[MANY][JOB_ID_BYTES];
    bool is_told[MANY];
    int count;
};

static void hear_of(void *ctx, enum catalog_change change, const char *id) {
    struct told_of *told = ctx;
    (void)change;
    pthread_mutex_lock(&told->lock);
    for (int n = 0; n < MANY; n++) {
        if (strcmp(told->id[n], id) != 0 || told->is_told[n]) continue;
        told->is_told[n] = true;
        told->count++;
    }
    pthread_cond_broadcast(&told->changed);
    pthread_mutex_unlock(&told->lock);
}

/* As a host that was cut off finds them, of whose changes no note comes: more than a page of one moment. */
static void many_changes_of_one_moment_are_told(void **state) {
    static struct told_of told = {.lock = PTHREAD_MUTEX_INITIALIZER, .changed = PTHREAD_COND_INITIALIZER};
    struct catalog_fixture *f = *state;
    struct pq *pq = NULL;
    struct pq_link *link;
    for (int n = 0; n < MANY; n++) {
        catalog_fixture_submit(f, n);
        catalog_fixture_id(n, told.id[n]);
    }
    assert_int_equal(pq_open(f->url, &pq, &f->error), STATUS_OK);
    assert_int_equal(pq_take(pq, &link, &f->error), STATUS_OK);
    assert_int_equal(pq_execute(link, "UPDATE jobs SET updated = updated - 3600000", &f->error), STATUS_OK);
    struct catalog *other = open_again(f);
    catalog_watch(other, hear_of, &told);
    assert_int_equal(pq_execute(link, "UPDATE jobs SET updated = (SELECT whittle_now())", &f->error), STATUS_OK);
    struct timespec end;
    clock_gettime(CLOCK_REALTIME, &end);
    end.tv_sec += 120;
    pthread_mutex_lock(&told.lock);
    while (told.count < MANY)
        if (pthread_cond_timedwait(&told.changed, &told.lock, &end) != 0)
            fail_msg("told of %d of %d", told.count, MANY);
    pthread_mutex_unlock(&told.lock);
    catalog_close(other);
    pq_done(link);
    pq_close(pq);
}

static void a_newer_schema_is_refused_and_an_older_one_upgraded(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = NULL;
    assert_int_equal(catalog_migrate(f->url, &f->error), STATUS_OK);          /* again: nothing happens */
    assert_true(catalog_fixture_set_version(f, "count + 1, oldest = count")); /* the next version's, which knows us */
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_OK);
    catalog_close(other);
    assert_int_equal(catalog_migrate(f->url, &f->error), STATUS_OK);
    assert_true(catalog_fixture_set_version(f, "count + 1, oldest = count"));
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_UNSUPPORTED);
    assert_non_null(strstr(f->error.text, "newer"));
    assert_int_equal(catalog_migrate(f->url, &f->error), STATUS_UNSUPPORTED);
    assert_true(catalog_fixture_set_version(f, "0"));
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_UNSUPPORTED);
    assert_non_null(strstr(f->error.text, "whittled migrate"));
}

/* A host that was stopped amid a transaction has everybody's turn locked. */
static void who_stands_still_in_a_transaction_holds_nobody_up(void **state) {
    enum { TRIES = 20 };
    struct catalog_fixture *f = *state;
    struct catalog_claim by = {"host", 60000, INT64_MAX};
    struct pq *pq = NULL;
    struct pq_link *link;
    struct job job;
    int64_t one = 0;
    bool found = false, unknown = false;
    catalog_fixture_submit(f, 1);
    assert_int_equal(pq_open(f->url, &pq, &f->error), STATUS_OK);
    assert_int_equal(pq_begin(pq, &link, &f->error), STATUS_OK);
    assert_int_equal(
        pq_number(link, "SELECT 1 FROM (SELECT pg_advisory_xact_lock(7741162)) AS claims", NULL, 0, &one, &f->error),
        STATUS_OK);
    assert_int_equal(one, 1);
    for (int i = 0; !found && i < TRIES; i++)
        if (catalog_claim(f->catalog, &by, &job, &found, &f->error) != STATUS_OK) found = false;
    assert_true(found);
    job_done(&job);
    assert_int_equal(pq_end(link, STATUS_OK, &unknown, &f->error), STATUS_IO); /* its connection was closed */
    assert_true(unknown);
    pq_close(pq);
}

static struct catalog_piece piece_of(uint64_t offset, uint64_t bytes, const char *name) {
    struct catalog_piece piece = {.offset = offset, .bytes = bytes};
    snprintf(piece.name, sizeof piece.name, "%s", name);
    return piece;
}

static bool is_added(struct catalog *catalog, const char *id, const char *token, uint64_t offset, uint64_t bytes) {
    struct catalog_piece piece = piece_of(offset, bytes, token);
    struct error error;
    bool held;
    assert_int_equal(catalog_add_piece(catalog, id, token, &piece, INT64_MAX, &held, &error), STATUS_OK);
    return held;
}

static bool is_seized(struct catalog *catalog, const char *id, const char *token, uint64_t offset, uint64_t length,
                      struct catalog_upload *row) {
    struct error error;
    bool seized;
    assert_int_equal(catalog_seize_upload(catalog, id, token, offset, length, 0, row, &seized, &error), STATUS_OK);
    return seized;
}

/* What was reserved for a piece is the upload's with its row: at no time it counts twice, and where there is no row it
 * stays reserved. */
static void a_piece_takes_what_was_reserved_for_it(void **state) {
    struct catalog_fixture *f = *state;
    const struct catalog_upload_limits limits = {.all = 9, .of_principal = 9, .principal_bytes = 100};
    struct catalog_upload row = {.id = "upload1", .principal = "ann", .length = UINT64_MAX, .expires_ms = INT64_MAX};
    struct catalog_piece piece = piece_of(0, 60, "p");
    bool held;
    assert_int_equal(catalog_open_upload(f->catalog, &row, "one", &limits, &f->error), STATUS_OK);
    assert_int_equal(catalog_reserve(f->catalog, "ann", 90, 100, &f->error), STATUS_OK);
    piece.reserved = 60;
    assert_int_equal(catalog_add_piece(f->catalog, row.id, "two", &piece, INT64_MAX, &held, &f->error), STATUS_OK);
    assert_false(held);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 90);
    assert_int_equal(catalog_add_piece(f->catalog, row.id, "one", &piece, INT64_MAX, &held, &f->error), STATUS_OK);
    assert_true(held);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 90);
    piece = piece_of(60, 0, "q");
    piece.reserved = 30;
    assert_int_equal(catalog_add_piece(f->catalog, row.id, "one", &piece, INT64_MAX, &held, &f->error), STATUS_OK);
    assert_true(held);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 60);
}

/* The newest one alone, and at the offset where the upload ends alone. */
static void an_upload_has_one_writer(void **state) {
    static const struct catalog_upload_limits limits = {.all = 2, .of_principal = 2, .principal_bytes = 100};
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    struct catalog_upload upload = {.principal = "ann", .expires_ms = INT64_MAX, .length = UINT64_MAX}, row;
    struct catalog_piece pieces[3];
    bool found;
    size_t count;
    catalog_fixture_id(1, upload.id);
    assert_int_equal(catalog_open_upload(f->catalog, &upload, "one", &limits, &f->error), STATUS_OK);
    assert_true(is_added(f->catalog, upload.id, "one", 0, 10));
    assert_int_equal(catalog_usage(other, "ann").reserved, 10);
    assert_false(is_seized(other, upload.id, "two", 9, UINT64_MAX, &row));
    assert_int_equal(row.offset, 10);
    assert_false(is_seized(other, upload.id, "two", 10, 9, &row)); /* shorter than what has come */
    assert_true(is_added(f->catalog, upload.id, "one", 10, 1));
    assert_true(is_seized(other, upload.id, "two", UINT64_MAX, 30, &row));
    assert_int_equal(row.offset, 11);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 30);
    assert_false(is_added(f->catalog, upload.id, "one", 11, 5));
    assert_false(is_added(other, upload.id, "two", 10, 5));
    assert_true(is_added(other, upload.id, "two", 11, 19));
    assert_false(is_seized(f->catalog, upload.id, "three", 30, 31, &row));
    assert_int_equal(catalog_list_pieces(f->catalog, upload.id, 0, pieces, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 3);
    assert_int_equal(pieces[2].offset, 11);
    assert_int_equal(pieces[2].bytes, 19);
    assert_string_equal(pieces[2].name, "two");
    assert_int_equal(catalog_complete_upload(other, upload.id, "cloud", &f->error), STATUS_OK);
    assert_false(is_seized(f->catalog, upload.id, "three", 30, UINT64_MAX, &row));
    assert_string_equal(row.cloud, "cloud");
    assert_int_equal(catalog_list_pieces(f->catalog, upload.id, 0, pieces, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 0);
    bool deleted;
    assert_int_equal(catalog_delete_upload(f->catalog, upload.id, INT64_MAX, &deleted, &f->error), STATUS_OK);
    assert_true(deleted);
    assert_int_equal(catalog_find_upload(other, upload.id, &row, &found, &f->error), STATUS_OK);
    assert_false(found);
    catalog_close(other);
}

/* Between the look for what has expired and its end somebody goes on with it. */
static void an_upload_whose_end_was_put_off_stays(void **state) {
    static const struct catalog_upload_limits limits = {.all = 2, .of_principal = 2, .principal_bytes = 100};
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    struct catalog_upload upload = {.principal = "ann", .expires_ms = 100, .length = UINT64_MAX, .concat = "partial"};
    struct catalog_upload row;
    struct catalog_piece pieces[2];
    char ids[2][JOB_ID_BYTES];
    bool found, deleted;
    size_t count;
    catalog_fixture_id(1, upload.id);
    assert_int_equal(catalog_open_upload(f->catalog, &upload, "one", &limits, &f->error), STATUS_OK);
    assert_int_equal(catalog_expired_uploads(other, 200, ids, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_true(is_added(f->catalog, upload.id, "one", 0, 10)); /* which puts its end off */
    assert_int_equal(catalog_delete_upload(other, ids[0], 200, &deleted, &f->error), STATUS_OK);
    assert_false(deleted);
    assert_int_equal(catalog_find_upload(other, upload.id, &row, &found, &f->error), STATUS_OK);
    assert_true(found);
    assert_string_equal(row.concat, "partial");
    assert_int_equal(catalog_list_pieces(other, upload.id, 0, pieces, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_int_equal(catalog_delete_upload(other, upload.id, INT64_MAX, &deleted, &f->error), STATUS_OK);
    assert_true(deleted);
    assert_int_equal(catalog_list_pieces(other, upload.id, 0, pieces, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_delete_upload(other, upload.id, 200, &deleted, &f->error), STATUS_OK);
    assert_true(deleted); /* it isn't there */
    catalog_close(other);
}

static void uploads_are_limited_for_all_hosts(void **state) {
    static const struct catalog_upload_limits limits = {.all = 3, .of_principal = 2, .principal_bytes = 100};
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f), *const hosts[] = {f->catalog, other};
    static const struct {
        const char *principal, *where; /* NULL = it is added */
        uint64_t length;
    } steps[] = {{"ann", NULL, 60}, {"ann", "principal_bytes", 41}, {"ann", NULL, 40}, {"ann", "principal_uploads", 0},
                 {"bob", NULL, 1},  {"cid", "max_uploads", 1}};
    for (int i = 0; i < 6; i++) {
        struct catalog_upload upload = {.expires_ms = i, .length = steps[i].length};
        snprintf(upload.principal, sizeof upload.principal, "%s", steps[i].principal);
        catalog_fixture_id(i, upload.id);
        enum status status = catalog_open_upload(hosts[i % 2], &upload, "token", &limits, &f->error);
        assert_int_equal(status, steps[i].where ? STATUS_LIMIT : STATUS_OK);
        if (steps[i].where) assert_string_equal(f->error.where, steps[i].where);
    }
    char ids[3][JOB_ID_BYTES], id[JOB_ID_BYTES];
    size_t count;
    assert_int_equal(catalog_expired_uploads(other, 2, ids, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 2);
    assert_string_equal(ids[1], catalog_fixture_id(2, id));
    catalog_close(other);
}

/* A mark is claimed by one host, and is due again unless it is taken away. */
static void marks_are_due_after_a_time(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    char names[3][CATALOG_MARK_BYTES];
    size_t count;
    assert_int_equal(catalog_mark(f->catalog, "jobs/a", 1000, &f->error), STATUS_OK);
    assert_int_equal(catalog_mark(f->catalog, "jobs/b", 1000, &f->error), STATUS_OK);
    assert_int_equal(catalog_mark(other, "jobs/b", 3000, &f->error), STATUS_OK);
    assert_int_equal(catalog_claim_marks(other, 999, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_claim_marks(other, 1000, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], "jobs/a");
    assert_int_equal(catalog_claim_marks(f->catalog, 2999, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_unmark(f->catalog, "jobs/a", &f->error), STATUS_OK);
    assert_int_equal(catalog_claim_marks(f->catalog, INT64_MAX, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], "jobs/b");
    catalog_close(other);
}

int main(void) {
    struct CMUnitTest tests[] = {
        CATALOG_TEST(a_key_is_held_everywhere),
        CATALOG_TEST(what_is_reserved_counts_everywhere),
        CATALOG_TEST(a_secret_is_the_first_that_is_brought),
        CATALOG_TEST(a_cloud_that_is_expected_stays),
        CATALOG_TEST(a_cloud_whose_removal_may_come_late_is_waited_for),
        CATALOG_TEST(a_cloud_that_came_behind_its_removal_goes),
        CATALOG_TEST(a_cloud_whose_row_is_being_added_stays),
        CATALOG_TEST(turns_are_taken_across_hosts),
        CATALOG_TEST(others_are_told),
        CATALOG_TEST(many_changes_of_one_moment_are_told),
        CATALOG_TEST(a_piece_takes_what_was_reserved_for_it),
        CATALOG_TEST(an_upload_has_one_writer),
        CATALOG_TEST(an_upload_whose_end_was_put_off_stays),
        CATALOG_TEST(uploads_are_limited_for_all_hosts),
        CATALOG_TEST(marks_are_due_after_a_time),
        CATALOG_TEST(a_newer_schema_is_refused_and_an_older_one_upgraded),
        CATALOG_TEST(who_stands_still_in_a_transaction_holds_nobody_up),
    };
    return catalog_fixture_run_shared(tests, sizeof tests / sizeof *tests);
}
