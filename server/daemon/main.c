/* whittled: whittle as a network service.
 *
 *     whittled --listen 127.0.0.1:8080 --data /var/lib/whittled
 *
 * Opens what it needs from the bottom up, says where it listens, waits for signals, and closes in the opposite order.
 * The first SIGTERM or SIGINT drains: no new work, running jobs may end, those that don't are queued again.  The second
 * ends the process at once; the next start finds everything that was accepted.  SIGHUP reads settings, tokens and
 * certificate again.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <malloc.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "api/codecs/json_memory.h"
#include "api/links.h"
#include "core/base/clock.h"
#include "core/base/version.h"
#include "server/auth/tokens.h"
#include "server/base/log.h"
#include "server/base/notify.h"
#include "server/catalog/catalog.h"
#include "server/daemon/fault_point.h"
#include "server/daemon/fsck.h"
#include "server/daemon/healthcheck.h"
#include "server/daemon/reload.h"
#include "server/daemon/settings.h"
#include "server/daemon/signals.h"
#include "server/daemon/transfer.h"
#include "server/handlers/handlers.h"
#include "server/http/http.h"
#include "server/http/tls.h"
#include "server/jobs/config.h"
#include "server/jobs/descriptors.h"
#include "server/jobs/readiness.h"
#include "server/jobs/service.h"
#include "server/runner/supervisor.h"
#include "server/webhooks/webhooks.h"

enum { MIN_CONNECTIONS = 8 };
enum { EXIT_USAGE = 2, SWEEP_MS = 30000, SWEEP_MIN_MS = 50, DRAIN_LOOK_MS = 50, LARGE_BYTES = 1 << 20, ARENAS = 4 };

/* Whether enough connections fit below the limit of open files; says so where not all do. */
static enum status check_room(const struct config *config, struct error *error) {
    long long limit = (long long)descriptors_limit(), reserve = (long long)descriptors_reserve(config);
    long long needed = reserve + DESCRIPTORS_PER_CONNECTION * (long long)config->wanted_connections;
    if (config->max_connections < MIN_CONNECTIONS)
        return error_set(error, STATUS_BAD_PARAMETER, "max-connections",
                         "%lld open files (RLIMIT_NOFILE) are too few: %lld are kept for the service itself, and a "
                         "connection may take %d; raise the limit to %lld",
                         limit, reserve, DESCRIPTORS_PER_CONNECTION, needed);
    if (config->max_connections < config->wanted_connections)
        log_line(LOG_WARNING,
                 "max-connections is %lld instead of %lld: a connection may take %d of %lld open files "
                 "(RLIMIT_NOFILE), and %lld are kept for the service itself; raise the limit to %lld",
                 (long long)config->max_connections, (long long)config->wanted_connections, DESCRIPTORS_PER_CONNECTION,
                 limit, reserve, needed);
    return STATUS_OK;
}

/* What is large and rare, such as a long list of jobs, goes back to the system when it is freed: otherwise each thread
 * keeps the largest that it ever had. */
static void give_memory_back(void) {
    mallopt(M_MMAP_THRESHOLD, LARGE_BYTES);
    mallopt(M_ARENA_MAX, ARENAS);
}

/* As often as the shortest time that anything is kept or held for, SWEEP_MS at most, SWEEP_MIN_MS at least. */
static int64_t sweep_every_ms(const struct config *config) {
    const int64_t times[] = {config->retention_ms, config->upload_expiry_ms, config->idempotency_retention_ms,
                             config->lease_ms};
    int64_t every = SWEEP_MS;
    for (size_t i = 0; i < sizeof times / sizeof *times; i++)
        if (times[i] < every) every = times[i];
    return every < SWEEP_MIN_MS ? SWEEP_MIN_MS : every;
}

/* Sweeps now and then until a signal ends it. */
static void serve(struct service *service, struct reload *reload, struct signals *signals) {
    int64_t every = sweep_every_ms(service->config);
    for (;;) {
        unsigned requests = signals_wait(signals, (int)every);
        if (requests & SIGNALS_STOP) return;
        if (requests & SIGNALS_RELOAD)
            reload_now(reload);
        else
            service_sweep(service);
        log_catch_up();
    }
}

/* Until the running jobs have ended and no upload is on its way, or the time for that is over. */
static void drain(struct service *service, struct http *http) {
    struct pollfd ended = {.fd = supervisor_idle_fd(service->supervisor), .events = POLLIN};
    int64_t end = clock_ms() + service->config->drain_timeout_ms;
    atomic_store(&service->draining, true);
    log_line(LOG_INFO, "draining: no new work, running jobs and uploads have %lld s",
             (long long)(service->config->drain_timeout_ms / 1000));
    supervisor_stop(service->supervisor);
    for (bool late = false, idle = false; !idle || (!late && http_uploads(http));) {
        poll(&ended, idle ? 0 : 1, DRAIN_LOOK_MS);
        if (!late && clock_ms() >= end) {
            late = true;
            supervisor_requeue(service->supervisor);
        }
        idle = idle || ended.revents;
    }
}

static int fail(const struct error *error) {
    log_line(LOG_ERROR, "%s: %s", error->where, error->text);
    return error->code == STATUS_BAD_PARAMETER ? EXIT_USAGE : EXIT_FAILURE;
}

static bool answers(void *service) { return service_answers(service); }

static void tell_ready(const char *address) {
    char message[HTTP_ADDRESS_BYTES + 64];
    snprintf(message, sizeof message, "READY=1\nSTATUS=listening on %s", address);
    notify_send(message);
}

static int run(const struct config *config, struct signals *signals, int argc, char **argv) {
    struct service service;
    struct http *http = NULL;
    struct webhooks *webhooks = NULL;
    struct notify_watch *watch = NULL;
    struct reload *reload = reload_open(&service, argc, argv);
    struct error error = {0};
    struct http_addresses addresses;
    const char *address = addresses.main;
    if (!reload) return EXIT_FAILURE;
    if (service_open(&service, config, &error) != STATUS_OK) {
        reload_close(reload);
        return fail(&error);
    }
    enum status status = settings_open_doors(config, &service.tokens, &service.tls, &error);
    if (status == STATUS_OK) status = supervisor_open(&service, &service.supervisor, &error);
    if (status == STATUS_OK) service_tell(&service, service.supervisor);
    if (status == STATUS_OK) status = webhooks_open(&service, &webhooks, &error);
    if (status == STATUS_OK) status = readiness_open(&service, READINESS_PERIOD_MS, &service.readiness, &error);
    if (status == STATUS_OK) status = http_open(&service, &handlers_all, &http, &addresses, &error);
    if (status == STATUS_OK) status = notify_watch(answers, &service, &watch, &error);
    if (status == STATUS_OK) {
        if (!address[0]) address = "no address";
        printf("listening on %s\n", address);
        if (addresses.admin[0]) printf("health and metrics on %s\n", addresses.admin);
        fflush(stdout);
        log_line(LOG_INFO, "whittled %s listening on %s, data in %s, %lld workers", whittle_version(), address,
                 config->data, (long long)config->workers);
        tell_ready(address);
        serve(&service, reload, signals);
        notify_send("STOPPING=1\nSTATUS=draining");
        drain(&service, http);
    } else if (service.supervisor) {
        supervisor_stop(service.supervisor);
    }
    change_feed_close(service.feed);
    http_close(http);
    notify_unwatch(watch);
    readiness_close(service.readiness);
    service_tell(&service, NULL);
    supervisor_close(service.supervisor);
    webhooks_close(webhooks);
    tokens_close(service.tokens);
    tls_close(service.tls);
    service_close(&service);
    reload_close(reload);
    log_line(LOG_INFO, "ended");
    return status == STATUS_OK ? EXIT_SUCCESS : fail(&error);
}

/* `whittled migrate`: makes the tables of the catalog that the settings name, or brings them up to date. */
static int migrate_main(int argc, char **argv) {
    struct config config;
    struct error error = {0};
    char url[CATALOG_URL_BYTES];
    enum config_request request = settings_read(&config, argc, argv, &error);
    if (request == CONFIG_TOLD) return EXIT_SUCCESS;
    enum status status = request == CONFIG_RUN ? STATUS_OK : error.code;
    if (status == STATUS_OK) {
        catalog_url(config.catalog, config.data, url);
        status = catalog_migrate(url, &error);
    }
    if (status != STATUS_OK) fprintf(stderr, "whittled: %s: %s\n", error.where, error.text);
    return status == STATUS_OK ? EXIT_SUCCESS : request == CONFIG_RUN ? EXIT_FAILURE : EXIT_USAGE;
}

int main(int argc, char **argv) {
    struct config config;
    struct error error = {0};
    if (argc > 1 && strcmp(argv[1], "healthcheck") == 0) return healthcheck_main(argc - 1, argv + 1);
    if (argc > 1 && strcmp(argv[1], "check") == 0) return check_main(argc - 1, argv + 1);
    if (argc > 1 && strcmp(argv[1], "migrate") == 0) return migrate_main(argc - 1, argv + 1);
    if (argc > 1 && (strcmp(argv[1], "export") == 0 || strcmp(argv[1], "import") == 0))
        return transfer_main(argc - 1, argv + 1);
    descriptors_raise_limit();
    switch (settings_read(&config, argc, argv, &error)) {
    case CONFIG_CHECK:
    case CONFIG_TOLD: return EXIT_SUCCESS;
    case CONFIG_REFUSED: fprintf(stderr, "whittled: %s: %s\n", error.where, error.text); return EXIT_USAGE;
    case CONFIG_RUN: break;
    }
    if (fault_arm(config.fault, &error) != STATUS_OK) {
        fprintf(stderr, "whittled: %s: %s\n", error.where, error.text);
        return EXIT_USAGE;
    }
    links_set_base(config.base_path);
    json_memory_watch();
    give_memory_back();
    struct signals *signals = NULL;
    if (check_room(&config, &error) != STATUS_OK) return fail(&error);
    if (signals_open(&signals, &error) != STATUS_OK) return fail(&error);
    int ended = run(&config, signals, argc, argv);
    signals_close(signals);
    return ended;
}
