/* What happens on a body's way in, to tokens, settings and resumable uploads when memory runs out at each place in
 * turn: a refusal, nothing leaked, nothing left behind; and the same work succeeds the next time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "server/auth/tokens.h"
#include "server/catalog/catalog.h"
#include "server/http/body.h"
#include "server/jobs/config.h"
#include "server/storage/store.h"
#include "server/storage/upload.h"
#include "server/storage/uploads.h"
#include "tests/unit/faults.h"
#include "tests/unit/folder.h"

static bool knows(struct uploads *uploads, const char *id, struct catalog_upload *info) {
    struct error error = {0};
    bool found = false;
    assert_int_equal(uploads_find(uploads, id, info, &found, &error), STATUS_OK);
    return found;
}

static const char cloud_text[] = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n";

struct fixture {
    char folder[64], url[96];
    struct store *store;
    struct catalog *catalog;
    struct error error;
};

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    folder_make_in_memory(f->folder, sizeof f->folder);
    snprintf(f->url, sizeof f->url, "sqlite:%s/whittled.db", f->folder);
    *state = f;
    return store_open(f->folder, "", &f->store, &f->error) != STATUS_OK ||
           catalog_open(f->url, &f->catalog, &f->error) != STATUS_OK;
}

static int tear_down(void **state) {
    struct fixture *f = *state;
    faults_stop();
    catalog_close(f->catalog);
    store_close(f->store);
    folder_remove(f->folder);
    free(f);
    return 0;
}

/* Lets the n-th allocation of the work fail, n = 1, 2, ..., also with all that follow it, until the work gets through
 * untouched; right after each failure it has to succeed.  How often it failed. */
static int fail_in_turn(struct fixture *f, bool (*work)(struct fixture *f)) {
    int failures = 0;
    for (long nth = 1;; nth++)
        for (int lasts = 0; lasts < 2; lasts++) {
            faults_in_memory(nth, lasts);
            bool ok = work(f), happened = faults_stop();
            assert_true(ok || happened);
            failures += !ok;
            assert_int_equal(folder_entries(f->folder, "tmp"), 0);
            if (!happened) return failures;
            assert_true(work(f));
        }
}

/* ------------------------------------------------------------------------------------------------ bodies */

/* In pieces, so that every buffer has to grow. */
static bool push(struct body *body, const char *bytes, size_t count, struct problem *problem) {
    for (size_t i = 0; i < count; i += 7)
        if (!body_write(body, bytes + i, count - i < 7 ? count - i : 7, problem)) return false;
    return body_end(body, problem);
}

static bool take(struct fixture *f, const struct body_plan *wanted, const char *bytes, size_t count) {
    struct problem problem = {0};
    struct body_plan plan = *wanted;
    plan.store = f->store;
    plan.max_bytes = 10000;
    plan.max_expansion = 250;
    plan.content_length = count;
    plan.admission = (struct admission){.max_points = 100};
    struct body *body = body_new(&plan, &problem);
    bool ok = body && push(body, bytes, count, &problem);
    if (!ok) assert_true(problem.detail[0]);
    body_free(body);
    return ok;
}

static bool take_cloud(struct fixture *f) {
    struct body_plan plan = {.takes = BODY_CLOUD, .type = "application/octet-stream"};
    return take(f, &plan, cloud_text, sizeof cloud_text - 1);
}

static bool take_packed(struct fixture *f) {
    static const unsigned char packed[] = {31,  139, 8,  0,   0,  0,  0,  0,   2, 3, 51, 80,  48,  80,  48, 224, 50, 4,
                                           147, 6,   10, 134, 96, 18, 72, 115, 1, 0, 34, 197, 203, 214, 24, 0,   0,  0};
    struct body_plan plan = {.takes = BODY_CLOUD, .type = "application/octet-stream", .coding = "gzip"};
    return take(f, &plan, (const char *)packed, sizeof packed);
}

static bool take_form(struct fixture *f) {
    static const char form[] = "--x\r\nContent-Disposition: form-data; name=\"params\"\r\n\r\n{\"ratio\":0.5}\r\n"
                               "--x\r\nContent-Disposition: form-data; name=\"file\"; filename=\"a\"\r\n\r\n"
                               "0 0 0\n1 0 0\n0 1 0\n0 0 1\n\r\n--x--\r\n";
    struct body_plan plan = {.takes = BODY_FORM, .type = "multipart/form-data; boundary=x"};
    return take(f, &plan, form, sizeof form - 1);
}

static bool take_document(struct fixture *f) {
    static const char document[] =
        "{\"input\":\"/v1/clouds/00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff\","
        "\"params\":{\"ratio\":0.5,\"outputs\":[\"cloud\",\"mesh\"]}}";
    struct body_plan plan = {.takes = BODY_JSON, .type = "application/json"};
    return take(f, &plan, document, sizeof document - 1);
}

static void every_allocation_for_a_body_fails_in_turn(void **state) {
    assert_true(fail_in_turn(*state, take_cloud) >= 2);
    assert_true(fail_in_turn(*state, take_packed) >= 2);
    assert_true(fail_in_turn(*state, take_form) >= 4);
    assert_true(fail_in_turn(*state, take_document) >= 4);
}

/* ------------------------------------------------------------------------------------------------ tokens, settings */

static bool read_tokens(struct fixture *f) {
    struct tokens *tokens = NULL;
    struct principal principal;
    char path[96];
    snprintf(path, sizeof path, "%s/tokens", f->folder);
    bool ok = tokens_open(path, &tokens, &f->error) == STATUS_OK;
    if (ok) {
        bool again = tokens_reload(tokens, &f->error) == STATUS_OK; /* else what was there stays */
        assert_int_equal(tokens_count(tokens), 40);
        assert_true(!tokens_find(tokens, "nobody's", &principal));
        ok = again;
    }
    tokens_close(tokens);
    return ok;
}

static void every_allocation_for_tokens_fails_in_turn(void **state) {
    struct fixture *f = *state;
    char path[96];
    snprintf(path, sizeof path, "%s/tokens", f->folder);
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    for (int i = 0; i < 40; i++) fprintf(file, "user%d:read:%064d\n", i, i);
    fclose(file);
    assert_true(fail_in_turn(f, read_tokens) >= 3);
}

static void ignore(const char *name, bool live) { (void)name, (void)live; }

static bool read_settings(struct fixture *f) {
    static char program[] = "whittled", flag[] = "--max-queue=7";
    char *argv[] = {program, flag, NULL};
    static struct config now, next;
    return config_read(&now, 2, argv, NULL, &f->error) == CONFIG_RUN &&
           config_reload(&now, 2, argv, NULL, &next, ignore, &f->error) == STATUS_OK && next.max_queue == 7;
}

static void every_allocation_for_settings_fails_in_turn(void **state) {
    assert_true(fail_in_turn(*state, read_settings) >= 1);
}

/* ------------------------------------------------------------------------------------------------ resumable uploads */

static bool write_piece(struct uploads_writer *writer, const char *bytes, struct catalog_upload *info,
                        struct problem *problem) {
    bool ok =
        writer && uploads_write(writer, bytes, strlen(bytes), problem) && uploads_end(writer, INT64_MAX, info, problem);
    uploads_writer_free(writer);
    return ok;
}

static bool upload_in_pieces(struct uploads *uploads, struct catalog_upload *info, struct error *error) {
    static const struct uploads_check plain = {0}, checked = {.whole = true, .base64 = "never"};
    struct problem problem = {0};
    struct uploads_writer *writer =
        uploads_create(uploads, info, &plain, &(struct uploads_limits){10, 10, 0}, &problem);
    if (!write_piece(writer, "0 0 ", info, &problem)) return false;
    writer = uploads_resume(uploads, info->id, 4, UINT64_MAX, &checked, 0, &problem);
    assert_false(write_piece(writer, "x", info, &problem)); /* its hash is another */
    writer = uploads_resume(uploads, info->id, 4, UINT64_MAX, &plain, 0, &problem);
    if (!write_piece(writer, "0\n", info, &problem)) return false;
    return uploads_complete(uploads, info->id, "00", error) == STATUS_OK;
}

static bool resume(struct fixture *f) {
    struct uploads *uploads = NULL;
    struct catalog_upload info = {.length = 6}, found;
    bool ok = uploads_open(f->catalog, f->store, false, &uploads, &f->error) == STATUS_OK;
    if (!ok) return false;
    ok = upload_in_pieces(uploads, &info, &f->error);
    faults_pause();
    if (info.id[0]) assert_int_equal(uploads_delete(uploads, info.id, &f->error), STATUS_OK);
    assert_false(knows(uploads, info.id, &found));
    assert_int_equal(catalog_usage(f->catalog, "").reserved, 0);
    uploads_close(uploads);
    faults_go_on();
    assert_int_equal(folder_entries(f->folder, "uploads"), 0);
    return ok;
}

static void every_allocation_for_a_resumable_upload_fails_in_turn(void **state) {
    assert_true(fail_in_turn(*state, resume) > 10);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void) {
    const struct CMUnitTest tests[] = {
        TEST(every_allocation_for_a_body_fails_in_turn),
        TEST(every_allocation_for_tokens_fails_in_turn),
        TEST(every_allocation_for_settings_fails_in_turn),
        TEST(every_allocation_for_a_resumable_upload_fails_in_turn),
    };
    return cmocka_run_group_tests(tests, faults_set_up, NULL);
}
