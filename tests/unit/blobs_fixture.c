/* A blob store of a test's own.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/blobs_fixture.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/base/digest.h"
#include "tests/unit/folder.h"

struct backend {
    const char *name;
    void (*make_url)(struct blobs_fixture *f);
    const char *needs; /* a variable of the environment; NULL = none */
};

/* In the file system that the files come from; and in another one, where there is one. */
static void make_file(struct blobs_fixture *f) { snprintf(f->url, sizeof f->url, "file:%s/store", f->folder); }

static void make_file_apart(struct blobs_fixture *f) {
    snprintf(f->url, sizeof f->url, "file:/dev/shm/%s", strrchr(f->folder, '/') + 1);
}

/* s3://bucket/prefix?endpoint=... with a longer prefix. */
static void make_s3(struct blobs_fixture *f) {
    const char *store = getenv("WHITTLE_BLOBS");
    size_t prefix = strcspn(store, "?");
    snprintf(f->url, sizeof f->url, "%.*s%s%s", (int)prefix, store, strrchr(f->folder, '/'), store + prefix);
}

/* The bucket as a host's name: BUCKET.localhost is this machine, as libcurl has it. */
static void make_s3_by_host(struct blobs_fixture *f) {
    static const char address[] = "//127.0.0.1";
    char url[sizeof f->url];
    make_s3(f);
    snprintf(url, sizeof url, "%s", f->url);
    char *host = strstr(url, address);
    assert_non_null(host);
    snprintf(f->url, sizeof f->url, "%.*s//localhost%s&style=host", (int)(host - url), url, host + strlen(address));
}

static struct backend backends[] = {{"file", make_file, NULL},
                                    {"file, apart", make_file_apart, NULL},
                                    {"s3", make_s3, "WHITTLE_BLOBS"},
                                    {"s3, by host", make_s3_by_host, "WHITTLE_BLOBS"}};

int blobs_fixture_run(struct CMUnitTest *tests, size_t count) {
    int failed = 0;
    for (size_t b = 0; b < sizeof backends / sizeof *backends; b++) {
        if (backends[b].needs && !getenv(backends[b].needs)) {
            printf("skipped: %s: %s names no store\n", backends[b].name, backends[b].needs);
            continue;
        }
        for (size_t i = 0; i < count; i++) tests[i].initial_state = &backends[b];
        failed += _cmocka_run_group_tests(backends[b].name, tests, count, NULL, NULL);
    }
    return failed;
}

int blobs_fixture_set_up(void **state) {
    struct blobs_fixture *f = calloc(1, sizeof *f);
    struct backend *backend = *state;
    char path[96];
    if (!f) return -1;
    snprintf(f->folder, sizeof f->folder, "/tmp/test_blobs.XXXXXX");
    if (!mkdtemp(f->folder)) return -1;
    snprintf(path, sizeof path, "%s/scratch", f->folder);
    if (mkdir(path, 0700) != 0) return -1;
    f->scratch_fd = open(path, O_RDONLY | O_DIRECTORY);
    backend->make_url(f);
    *state = f;
    if (blobs_open(f->url, f->folder, &f->blobs, &f->error) == STATUS_OK) return 0;
    fprintf(stderr, "%s: %s\n", backend->name, f->error.text);
    return -1;
}

int blobs_fixture_tear_down(void **state) {
    struct blobs_fixture *f = *state;
    blobs_close(f->blobs);
    close(f->scratch_fd);
    folder_remove(f->folder);
    if (strncmp(f->url, "file:", 5) == 0) folder_remove(f->url + 5);
    free(f);
    return 0;
}

void blobs_fixture_reopen(struct blobs_fixture *f) {
    blobs_close(f->blobs);
    assert_int_equal(blobs_open(f->url, f->folder, &f->blobs, &f->error), STATUS_OK);
}

enum status blobs_fixture_put(struct blobs_fixture *f, const char *folder, const char *const *names_and_texts) {
    struct blobs_source sources[16] = {0};
    char hashes[16][DIGEST_HEX_BYTES];
    size_t count = 0;
    for (; *names_and_texts; names_and_texts += 2, count++) {
        const char *name = names_and_texts[0], *text = names_and_texts[1];
        int fd = openat(f->scratch_fd, name, O_WRONLY | O_CREAT | O_TRUNC, 0600);
        assert_true(fd >= 0);
        assert_int_equal(write(fd, text, strlen(text)), strlen(text));
        close(fd);
        assert_true(digest_text(text, hashes[count]));
        sources[count] = (struct blobs_source){name, f->scratch_fd, name, hashes[count]};
    }
    return blobs_put(f->blobs, folder, sources, count, &f->error);
}

bool blobs_fixture_has(struct blobs_fixture *f, const char *name, const char *text) {
    char found[256] = "";
    int fd = blobs_read(f->blobs, name, NULL);
    assert_int_equal(fd >= 0, blobs_exist(f->blobs, name));
    if (fd < 0) return false;
    assert_int_equal(pread(fd, found, sizeof found - 1, 0), strlen(text));
    assert_string_equal(found, text);
    close(fd);
    return true;
}

static void add_name(void *ctx, const char *name) {
    char *text = ctx;
    size_t length = strlen(text);
    snprintf(text + length, 512 - length, "%s,", name);
}

const char *blobs_fixture_list(struct blobs_fixture *f, const char *folder, char text[512]) {
    text[0] = 0;
    assert_int_equal(blobs_list(f->blobs, folder, add_name, text, &f->error), STATUS_OK);
    return text;
}
