/* Fuzzes the whole request: bytes go over a connection to the service as it runs, but for jobs, whose outputs are made
 * up on the spot.
 *
 * Whatever comes, what is answered is HTTP, and the service finds nothing wrong with itself.  The client adds the end
 * of a head, so that few requests are waited for, and vanishes where one is all the same.  NO_ID in a path becomes the
 * id of a job or an upload that is there. Requests with an Authorization header meet a service that wants a token.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/auth/tokens.h"
#include "server/base/log.h"
#include "tests/unit/folder.h"
#include "tests/unit/instant_service.h"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#define NO_ID "00000000-0000-7000-8000-000000000000"
#define END "\r\n\r\n"
enum {
    ID_LENGTH = sizeof NO_ID - 1,
    END_LENGTH = sizeof END - 1,
    PATIENCE_MS = 50,
    START_MS = 8000,
    ANSWER_BYTES = 1 << 16,
    INPUTS_PER_SERVICE = 500
};

static char folder[] = "/dev/shm/fuzz_http.XXXXXX", tokens_path[64];
static struct config config;
static struct instant_service instant;
static struct tokens *tokens;
static struct {
    const char *path;
    char id[ID_LENGTH];
} known[] = {{"/v1/jobs/", NO_ID}, {"/v1/uploads/", NO_ID}};
enum { KNOWN = sizeof known / sizeof *known };

static void require(int condition) {
    if (!condition) abort();
}

/* ------------------------------------------------------------------------------------------------ around the service
 */

/* What the service can't do is a finding: the linker puts these in the place of the log's own. */
void __wrap_log_vline(enum log_level level, const char *format, va_list args) __attribute__((format(printf, 2, 0)));
void __wrap_log_line(enum log_level level, const char *format, ...) __attribute__((format(printf, 2, 3)));

void __wrap_log_vline(enum log_level level, const char *format, va_list args) {
    char line[1024];
    require(vsnprintf(line, sizeof line, format, args) >= 0);
    if (level == LOG_ERROR) fprintf(stderr, "%s\n", line);
    require(level != LOG_ERROR);
}

void __wrap_log_line(enum log_level level, const char *format, ...) {
    va_list args;
    va_start(args, format);
    __wrap_log_vline(level, format, args);
    va_end(args);
}

/* ------------------------------------------------------------------------------------------------ the client */

/* Sends everything and reads to the end, the beginning into answer; cuts the connection where nothing comes for a
 * while. */
static void exchange(const char *bytes, size_t size, int patience_ms, char answer[ANSWER_BYTES + 1]) {
    static char rest[ANSWER_BYTES];
    int fd = instant_service_connect(&instant);
    size_t sent = 0, got = 0;
    struct pollfd ready = {.fd = fd, .events = POLLIN | POLLOUT};
    for (ssize_t n = 1; n > 0 && poll(&ready, 1, patience_ms) == 1;) {
        if (ready.revents & POLLOUT) {
            n = send(fd, bytes + sent, size - sent, MSG_NOSIGNAL | MSG_DONTWAIT);
            sent = n > 0 ? sent + (size_t)n : size; /* the service may close as soon as it likes */
            if (sent == size) ready.events = POLLIN;
            if (sent == size) shutdown(fd, SHUT_WR);
            n = 1;
        } else {
            bool room = got < ANSWER_BYTES;
            n = recv(fd, room ? answer + got : rest, room ? ANSWER_BYTES - got : sizeof rest, 0);
            if (room && n > 0) got += (size_t)n;
        }
    }
    answer[got] = 0;
    setsockopt(fd, SOL_SOCKET, SO_LINGER, &(struct linger){.l_onoff = 1}, sizeof(struct linger));
    close(fd);
}

/* Keeps the ids of what was made. */
static void learn(const char *answer) {
    for (size_t i = 0; i < KNOWN; i++) {
        const char *found = strstr(answer, known[i].path);
        if (found && job_id_valid(strndupa(found + strlen(known[i].path), ID_LENGTH)))
            memcpy(known[i].id, found + strlen(known[i].path), ID_LENGTH);
    }
}

static void put_ids(char *text, size_t size) {
    for (size_t i = 0; i < KNOWN; i++) {
        size_t length = strlen(known[i].path);
        for (char *at = text; (at = memmem(at, size - (size_t)(at - text), known[i].path, length)); at += length)
            if ((size_t)(text + size - at) >= length + ID_LENGTH && memcmp(at + length, NO_ID, ID_LENGTH) == 0)
                memcpy(at + length, known[i].id, ID_LENGTH);
    }
}

/* ------------------------------------------------------------------------------------------------ the service */

static void send_first(const char *request) {
    static char answer[ANSWER_BYTES + 1];
    exchange(request, strlen(request), START_MS, answer);
    require(strncmp(answer, "HTTP/1.1 201", 12) == 0);
    learn(answer);
}

/* With nothing in it but a cloud, a job, and an upload that waits for more. */
static void open_service(void) {
    struct error error = {0};
    require(instant_service_open(&instant, &config, &error) == STATUS_OK);
    send_first("POST /v1/clouds HTTP/1.1\r\nHost: localhost\r\nContent-Length: 18\r\n\r\n0 0 0\n1 0 0\n0 1 0\n");
    send_first("POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 18\r\n\r\n0 0 0\n1 0 0\n0 1 0\n");
    send_first("POST /v1/uploads HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Length: 18\r\n\r\n");
}

/* Without its database the next start finds every file to be nobody's. */
static void close_service(void) {
    static const char *const endings[] = {"", "-wal", "-shm"};
    char path[SCRATCH_PATH_BYTES], whole[SCRATCH_PATH_BYTES + 8];
    snprintf(path, sizeof path, "%s/whittled.db", folder);
    instant.service.tokens = NULL;
    instant_service_close(&instant);
    for (size_t i = 0; i < sizeof endings / sizeof *endings; i++) {
        snprintf(whole, sizeof whole, "%s%s", path, endings[i]);
        unlink(whole);
    }
}

static void leave(void) { folder_remove(folder); }

int LLVMFuzzerInitialize(int *argc, char ***argv) {
    char *flags[] = {"whittled",
                     "--listen",
                     "127.0.0.1:0",
                     "--admin-listen",
                     "off",
                     "--data",
                     folder,
                     "--min-free",
                     "0",
                     "--allowed-hosts",
                     "*",
                     "--webhooks",
                     "--sync-max",
                     "1ms",
                     "--wait-max",
                     "1ms",
                     "--max-body-bytes",
                     "64K",
                     "--max-uploads",
                     "20",
                     "--refuse-drain-bytes",
                     "64K",
                     NULL};
    struct error error = {0};
    (void)argc;
    (void)argv;
    signal(SIGPIPE, SIG_IGN);
    require(mkdtemp(folder) != NULL);
    atexit(leave);
    require(config_read(&config, sizeof flags / sizeof *flags - 1, flags, NULL, &error) == CONFIG_RUN);
    /* The token is "t". */
    instant_service_write(folder, "tokens",
                          "a:submit,read:e3b98a4da31a127d4bde6e43033f66ba274cab0eb7eb1c70ec41402bf6273dd8\n");
    snprintf(tokens_path, sizeof tokens_path, "%s/tokens", folder);
    require(tokens_open(tokens_path, &tokens, &error) == STATUS_OK);
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static char answer[ANSWER_BYTES + 1];
    static unsigned inputs;
    if (!size) return 0;
    if (inputs++ % INPUTS_PER_SERVICE == 0) {
        if (inputs > 1) close_service();
        open_service();
    }
    char *request = malloc(size + END_LENGTH);
    require(request != NULL);
    memcpy(request, data, size);
    memcpy(request + size, END, END_LENGTH);
    put_ids(request, size);
    instant.service.tokens = memmem(request, size, "Authorization", 13) ? tokens : NULL;
    exchange(request, size + END_LENGTH, PATIENCE_MS, answer);
    bool right = !answer[0] || (strncmp(answer, "HTTP/1.1 ", 9) == 0 && strncmp(answer + 9, "500", 3) != 0);
    if (!right) fprintf(stderr, "%s\n", answer);
    require(right);
    learn(answer);
    free(request);
    return 0;
}
