/* The delivery of webhooks: a few threads, one POST at a time each, driven by the outbox.
 *
 *     due rows, the oldest first --choose--> a thread's turn --POST--> answered: the row goes
 *                                                                  else: it is due again later, or given up
 *
 * One free thread at a time looks into the outbox; when it has chosen a row, it claims it, so that no other host sends
 * it too, and the next one looks while it sends.  Should this host end meanwhile, the claim does, and the row is due
 * again: a receiver may hear of a job twice, by the same webhook-id.  A row is chosen only while its host has fewer
 * than PER_HOST under way and its principal fewer than PER_PRINCIPAL, and of these one whose principal has the fewest:
 * so a receiver that doesn't answer, for TIMEOUT_MS each time, holds up neither other hosts nor other principals.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "api/codecs/job_json.h"
#include "server/base/deadline.h"
#include "server/base/digest.h"
#include "server/base/log.h"
#include "server/base/random.h"
#include "server/base/setting_file.h"
#include "server/base/wall_clock.h"
#include "server/catalog/catalog.h"
#include "server/jobs/service.h"
#include "server/webhooks/http_client.h"
#include "server/webhooks/webhooks.h"

enum {
    LOOK_MS = 250,
    TIMEOUT_MS = 10000,
    CLAIM_MS = 60000,
    MAX_PAUSE_MS = 3600 * 1000,
    SECRET_BYTES = 64,
    MIN_SECRET_BYTES = 24
};
enum { GONE = 410, DELIVERIES = 16, PER_HOST = 2, PER_PRINCIPAL = 4, HOST_BYTES = 280 };

/* A thread, and what it delivers. */
struct delivery {
    struct webhooks *webhooks;
    pthread_t thread;
    bool busy; /* this and what follows: under the lock, but for the thread's own reading */
    struct catalog_webhook row;
    char host[HOST_BYTES];
};

struct webhooks {
    struct service *service;
    unsigned char secret[SECRET_BYTES];
    size_t secret_bytes;
    _Atomic bool stop;
    pthread_mutex_t turn; /* who holds it looks into the outbox; taken before the lock */
    pthread_mutex_t lock;
    pthread_cond_t changed; /* a delivery has ended, or all are to */
    unsigned delivery_count;
    struct delivery delivery[DELIVERIES];
};

/* ------------------------------------------------------------------------------------------------ secret */

static enum status read_secret(struct webhooks *webhooks, const char *path, struct error *error) {
    static const char prefix[] = "whsec_";
    char text[256] = "";
    FILE *file;
    if (!path[0])
        return error_set(error, STATUS_BAD_PARAMETER, "webhook-secret-file", "webhooks need a secret: name its file");
    if (setting_file_open("webhook-secret-file", path, &file, error) != STATUS_OK) {
        error->code = STATUS_BAD_PARAMETER; /* of the settings, whatever is wrong with the file */
        return error->code;
    }
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
                     "the file holds no secret: whsec_ and the base64 of 24 to 64 random bytes");
}

/* ------------------------------------------------------------------------------------------------ one delivery */

/* The payload; returns new, NULL when memory runs out. */
static char *payload_of(struct webhooks *webhooks, const struct job *job) {
    struct job_document document = service_document(webhooks->service, job);
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

static enum status send_payload(struct webhooks *webhooks, const struct catalog_webhook *row, const char *payload,
                                int *answer, struct error *error) {
    char id[64], at[64], signature[128];
    int64_t now_s = (int64_t)time(NULL); /* the receiver compares it with its own */
    if (!sign(webhooks, row->job, now_s, payload, signature, sizeof signature))
        return error_set(error, STATUS_NO_MEMORY, "webhook", "no memory");
    snprintf(id, sizeof id, "webhook-id: %s", row->job);
    snprintf(at, sizeof at, "webhook-timestamp: %lld", (long long)now_s);
    struct http_client_post post = {
        .url = row->url,
        .body = payload,
        .body_bytes = strlen(payload),
        .header = {"Content-Type: application/json", "User-Agent: whittled", "Expect:", id, at, signature},
        .allow = webhooks->service->config->webhook_allow,
        .timeout_ms = TIMEOUT_MS,
        .stop = &webhooks->stop};
    return http_client_post(&post, answer, error);
}

/* Twice as long each time, and half to one and a half of that. */
static int64_t pause_ms(const struct webhooks *webhooks, int attempts) {
    uint32_t random = 0;
    random_fill(&random, sizeof random);
    double pause =
        (double)webhooks->service->config->webhook_retry_ms * (double)(1u << (attempts < 20 ? attempts : 20));
    if (pause > MAX_PAUSE_MS) pause = MAX_PAUSE_MS;
    return (int64_t)(pause * (0.5 + random / 4294967296.0)) + 1;
}

/* A job's log tells it, too; a batch has none. */
static void tell(struct webhooks *webhooks, const char *job, bool is_batch, const char *what, const char *why) {
    log_line(LOG_INFO, "%s=%s webhook %s: %s", is_batch ? "batch" : "job", job, what, why);
    if (is_batch) return;
    int fd = store_log_open(webhooks->service->store, job, true);
    if (fd < 0) return;
    dprintf(fd, "webhook %s: %s\n", what, why);
    close(fd);
    struct error error = {0};
    if (webhooks->service->is_shared &&
        store_log_share(webhooks->service->store, job, webhooks->service->host, &error) != STATUS_OK)
        log_line(LOG_ERROR, "job=%s its log can't be shared: %s", job, error.text);
}

/* What becomes of the row after an attempt. */
static enum status settle(struct webhooks *webhooks, const struct catalog_webhook *row, bool is_batch, int answer,
                          const char *why, struct error *error) {
    bool delivered = answer >= 200 && answer < 300;
    bool given_up = answer == GONE || row->attempts + 1 >= WEBHOOKS_MAX_ATTEMPTS;
    if (atomic_load(&webhooks->stop) && !delivered) { /* the next start, or another host, tries again */
        log_line(LOG_INFO, "job=%s webhook interrupted: the service stops", row->job);
        return catalog_return_webhooks(webhooks->service->catalog, webhooks->service->host, row->job, job_now_ms(),
                                       error);
    }
    tell(webhooks, row->job, is_batch, delivered ? "delivered" : given_up ? "given up" : "failed", why);
    if (delivered || given_up) return catalog_end_webhook(webhooks->service->catalog, row->job, error);
    wall_clock_hold();
    enum status status = catalog_postpone_webhook(webhooks->service->catalog, row->job,
                                                  job_now_ms() + pause_ms(webhooks, row->attempts), error);
    wall_clock_release();
    return status;
}

/* The same of a batch, where it is one and is there still: *payload, new, else NULL. */
static enum status batch_payload(struct webhooks *webhooks, const char *id, bool *found, char **payload,
                                 struct error *error) {
    struct catalog_batch batch;
    int64_t ended_ms = 0;
    char at[JOB_TIME_BYTES];
    *payload = NULL;
    enum status status = catalog_get_batch(webhooks->service->catalog, id, &batch, found, error);
    if (status == STATUS_OK && *found) {
        char *data = service_batch_text(&batch, true);
        for (size_t i = 0; i < batch.job_count; i++)
            if (batch.job[i].finished_ms > ended_ms) ended_ms = batch.job[i].finished_ms;
        if (data && asprintf(payload, "{\"type\":\"batch.ended\",\"timestamp\":\"%s\",\"data\":%s}",
                             job_time_text(ended_ms, at), data) < 0)
            *payload = NULL;
        free(data);
    }
    catalog_batch_done(&batch);
    return status;
}

static enum status deliver(struct webhooks *webhooks, const struct catalog_webhook *row, struct error *error) {
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    char why[320];
    int answer = 0;
    enum status status = catalog_get(webhooks->service->catalog, row->job, &job, &presence, &tombstone, error);
    if (status != STATUS_OK) return status;
    char *payload = presence == CATALOG_PRESENT ? payload_of(webhooks, &job) : NULL;
    bool found = presence == CATALOG_PRESENT;
    job_done(&job);
    if (presence == CATALOG_ABSENT) status = batch_payload(webhooks, row->job, &found, &payload, error);
    if (status != STATUS_OK) return status;
    if (!found) return catalog_end_webhook(webhooks->service->catalog, row->job, error);
    struct error fault = {0};
    if (!payload)
        snprintf(why, sizeof why, "no memory");
    else if (send_payload(webhooks, row, payload, &answer, &fault) == STATUS_OK)
        snprintf(why, sizeof why, "answered %d", answer);
    else
        snprintf(why, sizeof why, "%.300s", fault.text);
    free(payload);
    return settle(webhooks, row, presence == CATALOG_ABSENT, answer, why, error);
}

/* ------------------------------------------------------------------------------------------------ choosing */

struct choice {
    struct webhooks *webhooks;
    struct delivery *delivery; /* what is chosen goes here */
    bool found;
    unsigned load; /* of its principal */
};

/* Whether the row is better than what was found so far; for catalog_each_webhook_due: returns whether to go on. */
static bool consider(void *ctx, const struct catalog_webhook *row) {
    struct choice *choice = ctx;
    struct webhooks *webhooks = choice->webhooks;
    char host[HOST_BYTES] = "";
    unsigned load = 0, at_host = 0;
    bool under_way = false;
    for (unsigned i = 0; i < webhooks->delivery_count; i++) {
        const struct delivery *other = &webhooks->delivery[i];
        load += other->busy && strcmp(other->row.principal, row->principal) == 0;
        under_way = under_way || (other->busy && strcmp(other->row.job, row->job) == 0);
    }
    if (under_way || load >= PER_PRINCIPAL || (choice->found && load >= choice->load)) return true;
    http_client_url_host(row->url, host, sizeof host);
    for (unsigned i = 0; i < webhooks->delivery_count; i++)
        at_host += webhooks->delivery[i].busy && strcmp(webhooks->delivery[i].host, host) == 0;
    if (at_host >= PER_HOST) return true;
    choice->found = true;
    choice->load = load;
    choice->delivery->row = *row;
    memcpy(choice->delivery->host, host, sizeof host);
    return load > 0;
}

/* Until there may be something to do, or the end; under the lock. */
static void pause_a_little(struct webhooks *webhooks) {
    struct timespec until = deadline_in_ms(LOOK_MS);
    if (!atomic_load(&webhooks->stop)) (void)deadline_wait(&until, &webhooks->changed, &webhooks->lock);
}

/* false: another host has it. */
static bool claim_row(struct webhooks *webhooks, const struct catalog_webhook *row) {
    struct error error = {0};
    bool claimed = false;
    wall_clock_hold();
    enum status status = catalog_claim_webhook(webhooks->service->catalog, row, webhooks->service->host,
                                               job_now_ms() + CLAIM_MS, &claimed, &error);
    wall_clock_release();
    if (status != STATUS_OK) log_line_seldom(LOG_ERROR, "webhooks: %s", error.text);
    return claimed;
}

/* Waits for a row that is due and may go now; false: the service stops. */
static bool choose(struct webhooks *webhooks, struct delivery *delivery) {
    struct choice choice = {.webhooks = webhooks, .delivery = delivery};
    pthread_mutex_lock(&webhooks->turn);
    pthread_mutex_lock(&webhooks->lock);
    while (!choice.found && !atomic_load(&webhooks->stop)) {
        struct error error = {0};
        enum status status =
            catalog_each_webhook_due(webhooks->service->catalog, job_now_ms(), consider, &choice, &error);
        if (status != STATUS_OK) log_line_seldom(LOG_ERROR, "webhooks: %s", error.text);
        if (choice.found && status == STATUS_OK) choice.found = claim_row(webhooks, &delivery->row);
        if (!choice.found) pause_a_little(webhooks);
    }
    delivery->busy = choice.found;
    pthread_mutex_unlock(&webhooks->lock);
    pthread_mutex_unlock(&webhooks->turn);
    return choice.found;
}

/* ------------------------------------------------------------------------------------------------ the threads */

/* What can't be recorded stays due: it rests for a while before it is chosen again. */
static void *work(void *ctx) {
    struct delivery *delivery = ctx;
    struct webhooks *webhooks = delivery->webhooks;
    while (choose(webhooks, delivery)) {
        struct error error = {0};
        enum status status = deliver(webhooks, &delivery->row, &error);
        if (status != STATUS_OK) log_line_seldom(LOG_ERROR, "webhooks: %s", error.text);
        pthread_mutex_lock(&webhooks->lock);
        if (status != STATUS_OK) pause_a_little(webhooks);
        delivery->busy = false;
        pthread_cond_broadcast(&webhooks->changed);
        pthread_mutex_unlock(&webhooks->lock);
    }
    return NULL;
}

/* As many threads as can be had, one at least. */
static enum status start_threads(struct webhooks *webhooks, struct error *error) {
    pthread_mutex_lock(&webhooks->lock);
    for (unsigned i = 0; i < DELIVERIES; i++) {
        struct delivery *delivery = &webhooks->delivery[i];
        delivery->webhooks = webhooks;
        if (pthread_create(&delivery->thread, NULL, work, delivery) != 0) break;
        webhooks->delivery_count++;
    }
    pthread_mutex_unlock(&webhooks->lock);
    return webhooks->delivery_count ? STATUS_OK : error_set(error, STATUS_IO, "webhooks", "can't start their threads");
}

static void destroy(struct webhooks *webhooks) {
    pthread_cond_destroy(&webhooks->changed);
    pthread_mutex_destroy(&webhooks->lock);
    pthread_mutex_destroy(&webhooks->turn);
    explicit_bzero(webhooks->secret, sizeof webhooks->secret);
    free(webhooks);
}

enum status webhooks_open(struct service *service, struct webhooks **webhooks, struct error *error) {
    if (!service->config->webhooks) return STATUS_OK;
    struct webhooks *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "webhooks", "no memory");
    opened->service = service;
    pthread_mutex_init(&opened->turn, NULL);
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->changed, NULL);
    enum status status = read_secret(opened, service->config->webhook_secret_file, error);
    if (status == STATUS_OK)
        status = catalog_return_webhooks(service->catalog, service->host, NULL, job_now_ms(), error);
    if (status == STATUS_OK) status = http_client_open(error);
    if (status == STATUS_OK && (status = start_threads(opened, error)) != STATUS_OK) http_client_close();
    if (status == STATUS_OK)
        *webhooks = opened;
    else
        destroy(opened);
    return status;
}

void webhooks_close(struct webhooks *webhooks) {
    if (!webhooks) return;
    pthread_mutex_lock(&webhooks->lock);
    atomic_store(&webhooks->stop, true);
    pthread_cond_broadcast(&webhooks->changed);
    pthread_mutex_unlock(&webhooks->lock);
    for (unsigned i = 0; i < webhooks->delivery_count; i++) pthread_join(webhooks->delivery[i].thread, NULL);
    http_client_close();
    destroy(webhooks);
}
