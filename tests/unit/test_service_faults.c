/* What whole requests meet when memory runs out at each place in turn, on the connection's thread or on another: an
 * answer that says so or a connection that is cut, never a hang and never a lie; and the same request succeeds next.
 *
 * Requests go over a connection to the service as it runs, but for jobs, which end as soon as they are submitted.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <poll.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cmocka.h>

#include "tests/unit/faults.h"
#include "tests/unit/folder.h"
#include "tests/unit/instant_service.h"

enum { ANSWER_BYTES = 1 << 20, REQUEST_BYTES = 2048, PATIENCE_MS = 120000, MOST_FAULTS = 100000 };

struct fixture {
    char folder[64];
    struct config config;
    struct instant_service instant;
    char answer[ANSWER_BYTES];
};

static enum status open_all(struct fixture *f) {
    struct error error = {0};
    return instant_service_open(&f->instant, &f->config, &error);
}

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    char *flags[] = {"whittled",
                     "--listen",
                     "127.0.0.1:0",
                     "--worker",
                     "/proc/self/exe",
                     "--admin-listen",
                     "off",
                     "--data",
                     f->folder,
                     "--min-free",
                     "0",
                     "--wait-max",
                     "1ms",
                     "--max-uploads",
                     "100000",
                     NULL};
    struct error error = {0};
    signal(SIGPIPE, SIG_IGN);
    folder_make_in_memory(f->folder, sizeof f->folder);
    *state = f;
    f->instant.before = faults_pause;
    f->instant.after = faults_go_on;
    bool read = config_read(&f->config, sizeof flags / sizeof *flags - 1, flags, NULL, &error) == CONFIG_RUN;
    if (!read) print_error("%s\n", error.text);
    return !read;
}

/* ------------------------------------------------------------------------------------------------ requests */

/* Sends a request that asks for the connection's end, and takes what comes until then. */
static void exchange(struct fixture *f, const char *request) {
    int fd = instant_service_connect(&f->instant);
    assert_int_equal(send(fd, request, strlen(request), MSG_NOSIGNAL), strlen(request));
    struct pollfd ready = {.fd = fd, .events = POLLIN};
    size_t got = 0;
    ssize_t n = 1;
    while (n > 0 && got < sizeof f->answer - 1) {
        if (poll(&ready, 1, PATIENCE_MS) != 1) fail_msg("no answer to %s", request);
        n = recv(fd, f->answer + got, sizeof f->answer - 1 - got, 0);
        if (n > 0) got += (size_t)n;
    }
    f->answer[got] = 0;
    close(fd);
}

/* The status of the answer; 0: the connection was cut before there was one. */
static int status_of(const struct fixture *f) {
    int status = 0;
    if (f->answer[0]) assert_int_equal(sscanf(f->answer, "HTTP/1.1 %d ", &status), 1);
    return status;
}

/* Replaces @ by the path that the answer's Location has; without an answer before, by nothing. */
static void put_location(const struct fixture *f, const char *request, char whole[REQUEST_BYTES]) {
    const char *found = strstr(f->answer, "\nLocation: "), *at = strchr(request, '@');
    int length = found ? (int)strcspn(found + 11, "\r") : 0;
    if (at)
        snprintf(whole, REQUEST_BYTES, "%.*s%.*s%s", (int)(at - request), request, length, found ? found + 11 : "",
                 at + 1);
    else
        snprintf(whole, REQUEST_BYTES, "%s", request);
}

#define HEAD " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
#define BODY "Content-Length: 18\r\n\r\n0 0 0\n1 0 0\n0 1 0\n"
#define TUS "Tus-Resumable: 1.0.0\r\n"
#define CLOUD "POST /v1/clouds" HEAD BODY
#define OTHER "POST /v1/clouds" HEAD "Content-Length: 18\r\n\r\n0 0 7\n1 0 0\n0 1 0\n"
#define JOB "POST /v1/jobs?ratio=0.5" HEAD BODY
#define UPLOAD "POST /v1/uploads" HEAD TUS "Upload-Length: 18\r\n\r\n"
#define FORM                                                                                                           \
    "--b\r\nContent-Disposition: form-data; name=\"ratio\"\r\n\r\n0.5\r\n"                                             \
    "--b\r\nContent-Disposition: form-data; name=\"file\"; filename=\"a\"\r\n\r\n0 0 0\n1 0 0\n0 1 0\n\r\n--b--\r\n"

static const struct {
    const char *before, *request; /* before: what has to be there; its Location stands for @ */
    int status;
} cases[] = {
    {NULL, CLOUD, 201},
    {NULL, JOB, 201},
    {NULL, "POST /v1/jobs?label=a&priority=3" HEAD "Idempotency-Key: \"k\"\r\n" BODY, 201},
    {NULL,
     "POST /v1/jobs" HEAD
     "Content-Type: multipart/form-data; boundary=b\r\nTransfer-Encoding: chunked\r\n\r\n97\r\n" FORM "\r\n0\r\n\r\n",
     201},
    {NULL, "POST /v1/simplify?ratio=0.5" HEAD BODY, 200},
    {CLOUD, "POST /v1/jobs" HEAD "Content-Type: application/json\r\nContent-Length: 87\r\n\r\n{\"input\":\"@\"}", 201},
    {JOB, "GET @" HEAD "Prefer: wait=1\r\n\r\n", 200},
    {JOB, "GET @/events" HEAD "\r\n", 200},
    {JOB, "GET @/outputs" HEAD "\r\n", 200},
    {JOB, "GET @/outputs/cloud.ply" HEAD "Range: bytes=2-5\r\n\r\n", 206},
    {JOB, "GET @/outputs/report.json" HEAD "\r\n", 200},
    {JOB, "POST @/outputs/cloud.ply/link" HEAD "Content-Length: 0\r\n\r\n", 200},
    {JOB, "DELETE @" HEAD "\r\n", 200},
    {JOB, "GET /v1/jobs?limit=2&status=successful" HEAD "\r\n", 200},
    {OTHER, "GET @" HEAD "\r\n", 200},
    {OTHER, "GET @/data" HEAD "\r\n", 200},
    {CLOUD, "GET /v1/clouds" HEAD "\r\n", 200},
    {OTHER, "DELETE @" HEAD "\r\n", 200},
    {NULL, UPLOAD, 201},
    {UPLOAD, "HEAD @" HEAD TUS "\r\n", 200},
    {UPLOAD, "PATCH @" HEAD TUS "Upload-Offset: 0\r\nContent-Type: application/offset+octet-stream\r\n" BODY, 204},
    {UPLOAD, "DELETE @" HEAD TUS "\r\n", 204},
    {NULL, "GET /v1/info" HEAD "\r\n", 200},
    {NULL, "GET /v1/parameters" HEAD "\r\n", 200},
    {NULL, "GET /openapi.json" HEAD "\r\n", 200},
    {NULL, "GET /docs" HEAD "\r\n", 200},
    {NULL, "GET /metrics" HEAD "\r\n", 200},
    {NULL, "GET /readyz" HEAD "\r\n", 200},
    {NULL, "GET /v1/jobs?lable=a" HEAD "\r\n", 400},
    {NULL, "GET /nowhere" HEAD "\r\n", 404},
};

static void ask(struct fixture *f, size_t i, long nth, bool lasts, bool *happened) {
    char request[REQUEST_BYTES];
    f->answer[0] = 0;
    if (cases[i].before) {
        exchange(f, cases[i].before);
        assert_in_range(status_of(f), 200, 201);
    }
    put_location(f, cases[i].request, request);
    if (nth) faults_in_memory(nth, lasts);
    exchange(f, request);
    *happened = faults_stop();
}

/* What comes a second time is 200 where it was 201. */
static bool is_right(int status, size_t i) {
    return status == cases[i].status || (status == 200 && cases[i].status == 201);
}

static void each_request_without_memory_is_told_so_or_cut(void **state) {
    struct fixture *f = *state;
    bool happened = true;
    long failures = 0;
    assert_int_equal(open_all(f), STATUS_OK);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        happened = true;
        for (long nth = 1; happened && nth < MOST_FAULTS; nth += 1 + nth / 8) /* SQLite makes thousands */
            for (int lasts = 0; lasts < 2; lasts++) {
                ask(f, i, nth, lasts, &happened);
                int status = status_of(f);
                bool refused = status == 0 || status >= 500;
                if (!is_right(status, i) && !(happened && refused))
                    fail_msg("%s: fault %ld: %s", cases[i].request, nth, f->answer);
                failures += refused;
            }
        ask(f, i, 0, false, &happened);
        if (!is_right(status_of(f), i)) fail_msg("%s: %s", cases[i].request, f->answer);
    }
    assert_true(failures > 100);
    instant_service_close(&f->instant);
}

static void opening_without_memory_fails_and_leaves_nothing(void **state) {
    struct fixture *f = *state;
    bool happened = true;
    int failures = 0;
    for (long nth = 1; happened; nth += 1 + nth / 8) {
        faults_in_memory(nth, false);
        enum status status = open_all(f);
        happened = faults_stop();
        failures += status != STATUS_OK;
        if (status == STATUS_OK) instant_service_close(&f->instant);
    }
    assert_true(failures > 10);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, faults_tear_down)

int main(void) {
    const struct CMUnitTest tests[] = {
        TEST(opening_without_memory_fails_and_leaves_nothing),
        TEST(each_request_without_memory_is_told_so_or_cut),
    };
    return cmocka_run_group_tests(tests, faults_set_up, NULL);
}
