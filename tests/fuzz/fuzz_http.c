/* Fuzzes the whole request: bytes go over a connection to the service as it runs, but for jobs, whose outputs are made
 * up on the spot.
 *
 * Whatever comes, what is answered is HTTP, and the service finds nothing wrong with itself.  The client adds the end
 * of a head, so that few requests are waited for, and vanishes where one is all the same.  NO_ID in a path becomes the
 * id of a job or an upload that is there. Requests with an Authorization header meet a service that wants a token.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <arpa/inet.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/http.h"
#include "server/log.h"
#include "server/notify.h"
#include "server/service.h"
#include "server/supervisor.h"
#include "server/tokens.h"
#include "tests/unit/folder.h"

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
static struct service service;
static struct tokens *tokens;
static struct http *http;
static struct sockaddr_in address;
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

/* What the service can't do is a finding. */
void log_vline(enum log_level level, const char *format, va_list args) {
    char line[1024];
    require(vsnprintf(line, sizeof line, format, args) >= 0);
    if (level == LOG_ERROR) fprintf(stderr, "%s\n", line);
    require(level != LOG_ERROR);
}

void log_line(enum log_level level, const char *format, ...) {
    va_list args;
    va_start(args, format);
    log_vline(level, format, args);
    va_end(args);
}

int notify_inherited(const char *name) {
    (void)name;
    return -1;
}

bool supervisor_answers(struct supervisor *supervisor) { return supervisor != NULL; }

bool supervisor_cancel(struct supervisor *supervisor, const char *id) {
    (void)supervisor;
    (void)id;
    return false;
}

static void write_file(const char *path, const char *name, const char *text) {
    char whole[STORE_PATH_BYTES + 16];
    snprintf(whole, sizeof whole, "%s/%s", path, name);
    int fd = open(whole, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    require(fd >= 0 && write(fd, text, strlen(text)) == (ssize_t)strlen(text));
    close(fd);
}

/* Every job ends at once, well. */
void supervisor_notify(struct supervisor *supervisor) {
    static const char report[] = "{\"points_in\":9,\"points_out\":3,\"timings_ms\":{\"read\":1.5,\"total\":2}}";
    char path[STORE_PATH_BYTES];
    struct error error = {0};
    struct job job = {0};
    bool found = true, changed;
    (void)supervisor;
    while (queue_claim(service.queue, INT64_MAX, &job, &found, &error) == STATUS_OK && found) {
        require(store_outputs_begin(service.store, job.id, path, &error) == STATUS_OK);
        write_file(path, "cloud.ply", "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n");
        write_file(path, "report.json", report);
        require(store_outputs_keep(service.store, job.id, job.output, &job.output_count, &error) == STATUS_OK);
        job.report = strdup(report);
        require(queue_finish(service.queue, JOB_DONE, &job, &changed, &error) == STATUS_OK);
        job_done(&job);
    }
}

/* ------------------------------------------------------------------------------------------------ the client */

static int connect_to_service(void) {
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    require(fd >= 0 && connect(fd, (const struct sockaddr *)&address, sizeof address) == 0);
    return fd;
}

/* Sends everything and reads to the end, the beginning into answer; cuts the connection where nothing comes for a
 * while. */
static void exchange(const char *bytes, size_t size, int patience_ms, char answer[ANSWER_BYTES + 1]) {
    static char rest[ANSWER_BYTES];
    int fd = connect_to_service();
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
    struct http_addresses addresses;
    struct error error = {0};
    require(service_open(&service, &config, &error) == STATUS_OK);
    service.supervisor = (struct supervisor *)(void *)&service; /* never looked into */
    require(http_open(&service, &http, &addresses, &error) == STATUS_OK);
    const char *port = strrchr(addresses.main, ':');
    require(port != NULL);
    address = (struct sockaddr_in){.sin_family = AF_INET,
                                   .sin_port = htons((uint16_t)strtoul(port + 1, NULL, 10)),
                                   .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    send_first("POST /v1/clouds HTTP/1.1\r\nHost: a\r\nContent-Length: 18\r\n\r\n0 0 0\n1 0 0\n0 1 0\n");
    send_first("POST /v1/jobs HTTP/1.1\r\nHost: a\r\nContent-Length: 18\r\n\r\n0 0 0\n1 0 0\n0 1 0\n");
    send_first("POST /v1/uploads HTTP/1.1\r\nHost: a\r\nTus-Resumable: 1.0.0\r\nUpload-Length: 18\r\n\r\n");
}

/* Without its database the next start finds every file to be nobody's. */
static void close_service(void) {
    static const char *const endings[] = {"", "-wal", "-shm"};
    char path[STORE_PATH_BYTES], whole[STORE_PATH_BYTES + 8];
    store_database_path(service.store, path);
    service.tokens = NULL;
    events_close(service.events);
    http_close(http);
    service_close(&service);
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
    write_file(folder, "tokens", "a:submit,read:e3b98a4da31a127d4bde6e43033f66ba274cab0eb7eb1c70ec41402bf6273dd8\n");
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
    service.tokens = memmem(request, size, "Authorization", 13) ? tokens : NULL;
    exchange(request, size + END_LENGTH, PATIENCE_MS, answer);
    bool right = !answer[0] || (strncmp(answer, "HTTP/1.1 ", 9) == 0 && strncmp(answer + 9, "500", 3) != 0);
    if (!right) fprintf(stderr, "%s\n", answer);
    require(right);
    learn(answer);
    free(request);
    return 0;
}
