/* The delivery of webhooks: one thread, one POST at a time, driven by the outbox.
 *
 * The thread looks into the outbox a few times a second; what is due is sent, and its row goes only after an answer.  A
 * receiver that doesn't answer holds the others up for TIMEOUT_MS at most, and then has to wait for its turn again.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <time.h>
#include <unistd.h>

#include "api/job_json.h"
#include "server/digest.h"
#include "server/handlers.h"
#include "server/log.h"
#include "server/outbox.h"
#include "server/post.h"
#include "server/webhooks.h"

enum { LOOK_MS = 250, TIMEOUT_MS = 10000, MAX_PAUSE_MS = 3600 * 1000, SECRET_BYTES = 64, MIN_SECRET_BYTES = 24 };
enum { GONE = 410 };

struct webhooks {
    struct service *service;
    unsigned char secret[SECRET_BYTES];
    size_t secret_bytes;
    _Atomic bool stop;
    pthread_mutex_t lock;
    pthread_cond_t stopped;
    pthread_t thread;
};

/* ------------------------------------------------------------------------------------------------ secret */

static enum status read_secret(struct webhooks *webhooks, const char *path, struct error *error) {
    static const char prefix[] = "whsec_";
    char text[256] = "";
    FILE *file = path[0] ? fopen(path, "re") : NULL;
    if (!file)
        return error_set(error, STATUS_BAD_PARAMETER, "webhook-secret-file", "can't read '%.200s': %s", path,
                         path[0] ? strerror(errno) : "webhooks need one");
    bool has_line = fgets(text, sizeof text, file) != NULL;
    fclose(file);
    text[strcspn(text, "\r\n")] = 0;
    webhooks->secret_bytes = sizeof webhooks->secret;
    bool ok = has_line && strncmp(text, prefix, sizeof prefix - 1) == 0 &&
              digest_base64_read(text + sizeof prefix - 1, webhooks->secret, &webhooks->secret_bytes) &&
              webhooks->secret_bytes >= MIN_SECRET_BYTES;
    explicit_bzero(text, sizeof text);
    if (ok) return STATUS_OK;
    return error_set(error, STATUS_BAD_PARAMETER, "webhook-secret-file",
                     "it holds no secret: whsec_ and the base64 of 24 to 64 random bytes");
}

/* ------------------------------------------------------------------------------------------------ one delivery */

/* The payload; returns new, NULL when memory runs out. */
static char *payload_of(struct webhooks *webhooks, const struct job *job) {
    struct job_document document = handlers_document(webhooks->service, job);
    char at[JOB_TIME_BYTES], *data = job_encode(&document), *payload = NULL;
    if (data && asprintf(&payload, "{\"type\":\"job.ended\",\"timestamp\":\"%s\",\"data\":%s}",
                         job_time_text(job->finished_ms, at), data) < 0)
        payload = NULL;
    free(data);
    return payload;
}

/* "webhook-signature: v1,..." over id, time and payload. */
static bool sign(const struct webhooks *webhooks, const char *id, int64_t now_s, const char *payload, char *header,
                 size_t bytes) {
    char hex[DIGEST_HEX_BYTES], base64[DIGEST_BASE64_BYTES], *text = NULL;
    int n = asprintf(&text, "%s.%lld.%s", id, (long long)now_s, payload);
    if (n < 0) return false;
    digest_hmac(webhooks->secret, webhooks->secret_bytes, text, (size_t)n, hex);
    free(text);
    digest_base64(hex, base64);
    snprintf(header, bytes, "webhook-signature: v1,%s", base64);
    return true;
}

static enum status send_payload(struct webhooks *webhooks, const struct outbox_row *row, const char *payload,
                                int *answer, struct error *error) {
    char id[64], at[64], signature[128];
    int64_t now_s = job_now_ms() / 1000;
    if (!sign(webhooks, row->job, now_s, payload, signature, sizeof signature))
        return error_set(error, STATUS_NO_MEMORY, "webhook", "no memory");
    snprintf(id, sizeof id, "webhook-id: %s", row->job);
    snprintf(at, sizeof at, "webhook-timestamp: %lld", (long long)now_s);
    struct post post = {
        .url = row->url,
        .body = payload,
        .body_bytes = strlen(payload),
        .header = {"Content-Type: application/json", "User-Agent: whittled", "Expect:", id, at, signature},
        .allow = webhooks->service->config->webhook_allow,
        .timeout_ms = TIMEOUT_MS,
        .stop = &webhooks->stop};
    return post_send(&post, answer, error);
}

/* Twice as long each time, and half to one and a half of that. */
static int64_t pause_ms(const struct webhooks *webhooks, int attempts) {
    uint32_t random = 0;
    ssize_t n = getrandom(&random, sizeof random, 0); /* 4 bytes are never cut short */
    (void)n;
    double pause =
        (double)webhooks->service->config->webhook_retry_ms * (double)(1u << (attempts < 20 ? attempts : 20));
    if (pause > MAX_PAUSE_MS) pause = MAX_PAUSE_MS;
    return (int64_t)(pause * (0.5 + random / 4294967296.0)) + 1;
}

static void tell(struct webhooks *webhooks, const char *job, const char *what, const char *why) {
    log_line(LOG_INFO, "job=%s webhook %s: %s", job, what, why);
    int fd = store_log_open(webhooks->service->store, job, true);
    if (fd < 0) return;
    dprintf(fd, "webhook %s: %s\n", what, why);
    close(fd);
}

/* What becomes of the row after an attempt. */
static enum status settle(struct webhooks *webhooks, const struct outbox_row *row, int answer, const char *why,
                          struct error *error) {
    struct sql *writer = queue_writer(webhooks->service->queue);
    bool delivered = answer >= 200 && answer < 300;
    bool given_up = answer == GONE || row->attempts + 1 >= WEBHOOKS_MAX_ATTEMPTS;
    if (atomic_load(&webhooks->stop) && !delivered) return STATUS_OK; /* the next start tries again */
    tell(webhooks, row->job, delivered ? "delivered" : given_up ? "given up" : "failed", why);
    if (delivered || given_up) return outbox_end(writer, row->job, error);
    return outbox_postpone(writer, row->job, job_now_ms() + pause_ms(webhooks, row->attempts), error);
}

static enum status deliver(struct webhooks *webhooks, const struct outbox_row *row, struct error *error) {
    struct job job;
    enum queue_presence presence;
    struct queue_tombstone tombstone;
    char why[320];
    int answer = 0;
    enum status status = queue_get(webhooks->service->queue, row->job, &job, &presence, &tombstone, error);
    if (status != STATUS_OK) return status;
    char *payload = presence == QUEUE_PRESENT ? payload_of(webhooks, &job) : NULL;
    bool gone = presence != QUEUE_PRESENT;
    job_done(&job);
    if (gone) return outbox_end(queue_writer(webhooks->service->queue), row->job, error);
    struct error fault = {0};
    if (!payload)
        snprintf(why, sizeof why, "no memory");
    else if (send_payload(webhooks, row, payload, &answer, &fault) == STATUS_OK)
        snprintf(why, sizeof why, "answered %d", answer);
    else
        snprintf(why, sizeof why, "%.300s", fault.text);
    free(payload);
    return settle(webhooks, row, answer, why, error);
}

/* ------------------------------------------------------------------------------------------------ the thread */

/* Until there may be something to do, or the end. */
static void pause_a_little(struct webhooks *webhooks) {
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_nsec += LOOK_MS * 1000000L;
    until.tv_sec += until.tv_nsec / 1000000000L;
    until.tv_nsec %= 1000000000L;
    pthread_mutex_lock(&webhooks->lock);
    if (!atomic_load(&webhooks->stop))
        pthread_cond_clockwait(&webhooks->stopped, &webhooks->lock, CLOCK_MONOTONIC, &until);
    pthread_mutex_unlock(&webhooks->lock);
}

static void *work(void *ctx) {
    struct webhooks *webhooks = ctx;
    struct outbox_row row;
    int64_t next_ms;
    while (!atomic_load(&webhooks->stop)) {
        struct error error = {0};
        bool found = false;
        enum status status =
            outbox_next(queue_reader(webhooks->service->queue), job_now_ms(), &row, &found, &next_ms, &error);
        if (status == STATUS_OK && found) status = deliver(webhooks, &row, &error);
        if (status != STATUS_OK) log_line(LOG_ERROR, "webhooks: %s", error.text);
        if (status != STATUS_OK || !found) pause_a_little(webhooks);
    }
    return NULL;
}

enum status webhooks_open(struct service *service, struct webhooks **webhooks, struct error *error) {
    if (!service->config->webhooks) return STATUS_OK;
    struct webhooks *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "webhooks", "no memory");
    opened->service = service;
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->stopped, NULL);
    enum status status = read_secret(opened, service->config->webhook_secret_file, error);
    if (status == STATUS_OK) status = post_open(error);
    if (status == STATUS_OK && pthread_create(&opened->thread, NULL, work, opened) != 0) {
        post_close();
        status = error_set(error, STATUS_IO, "webhooks", "can't start their thread");
    }
    if (status == STATUS_OK)
        *webhooks = opened;
    else
        free(opened);
    return status;
}

void webhooks_close(struct webhooks *webhooks) {
    if (!webhooks) return;
    pthread_mutex_lock(&webhooks->lock);
    atomic_store(&webhooks->stop, true);
    pthread_cond_signal(&webhooks->stopped);
    pthread_mutex_unlock(&webhooks->lock);
    pthread_join(webhooks->thread, NULL);
    post_close();
    pthread_cond_destroy(&webhooks->stopped);
    pthread_mutex_destroy(&webhooks->lock);
    explicit_bzero(webhooks->secret, sizeof webhooks->secret);
    free(webhooks);
}
