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
#include <errno.h>
#include <malloc.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include "api/json_memory.h"
#include "api/links.h"
#include "core/version.h"
#include "server/check.h"
#include "server/config.h"
#include "server/daemon_fault.h"
#include "server/healthcheck.h"
#include "server/http.h"
#include "server/log.h"
#include "server/notify.h"
#include "server/reload.h"
#include "server/service.h"
#include "server/supervisor.h"
#include "server/webhooks.h"

enum { EXIT_USAGE = 2, SWEEP_MS = 30000, SWEEP_MIN_MS = 50, DRAIN_LOOK_MS = 50, LARGE_BYTES = 1 << 20, ARENAS = 4 };

/* The signals become readable; none interrupts anything.  Threads started later inherit the mask. */
static int open_signals(void) {
    sigset_t set;
    sigemptyset(&set);
    sigaddset(&set, SIGTERM);
    sigaddset(&set, SIGINT);
    sigaddset(&set, SIGHUP);
    sigprocmask(SIG_BLOCK, &set, NULL);
    signal(SIGPIPE, SIG_IGN);
    return signalfd(-1, &set, SFD_CLOEXEC);
}

/* As many descriptors as we may have: each connection takes one, each upload another. */
static void raise_file_limit(void) {
    struct rlimit files;
    if (getrlimit(RLIMIT_NOFILE, &files) != 0) return;
    files.rlim_cur = files.rlim_max;
    setrlimit(RLIMIT_NOFILE, &files);
}

/* The signal that has come. */
static int read_signal(int signals) {
    struct signalfd_siginfo info;
    return read(signals, &info, sizeof info) == sizeof info ? (int)info.ssi_signo : SIGTERM;
}

/* What is large and rare, such as a long list of jobs, goes back to the system when it is freed: otherwise each thread
 * keeps the largest that it ever had. */
static void give_memory_back(void) {
    mallopt(M_MMAP_THRESHOLD, LARGE_BYTES);
    mallopt(M_ARENA_MAX, ARENAS);
}

/* As often as the shortest time that anything is kept for, SWEEP_MS at most, SWEEP_MIN_MS at least. */
static int64_t sweep_every_ms(const struct config *config) {
    const int64_t times[] = {config->retention_ms, config->upload_expiry_ms, config->idempotency_retention_ms};
    int64_t every = SWEEP_MS;
    for (size_t i = 0; i < sizeof times / sizeof *times; i++)
        if (times[i] < every) every = times[i];
    return every < SWEEP_MIN_MS ? SWEEP_MIN_MS : every;
}

/* Sweeps now and then until a signal ends it; SIGHUP doesn't. */
static void serve(struct service *service, struct reload *reload, int signals) {
    struct pollfd fds = {.fd = signals, .events = POLLIN};
    int64_t every = sweep_every_ms(service->config);
    for (;;) {
        if (poll(&fds, 1, (int)every) <= 0)
            service_sweep(service);
        else if (read_signal(signals) != SIGHUP)
            return;
        else
            reload_now(reload);
    }
}

static void end_at_once(int signal) {
    static const char words[] = "second signal: ending at once\n";
    ssize_t n = write(STDERR_FILENO, words, sizeof words - 1);
    (void)n, (void)signal;
    _exit(128 + SIGTERM);
}

/* From now on a signal ends the process, whatever the others wait for and however long. */
static void let_signals_end(void) {
    struct sigaction action = {.sa_handler = end_at_once};
    sigset_t set;
    sigemptyset(&set);
    sigaddset(&set, SIGTERM);
    sigaddset(&set, SIGINT);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    sigprocmask(SIG_UNBLOCK, &set, NULL);
}

/* Until the running jobs have ended and no upload is on its way, or the time for that is over. */
static void drain(struct service *service, struct http *http, int signals) {
    struct pollfd fds[] = {{.fd = signals, .events = POLLIN},
                           {.fd = supervisor_idle_fd(service->supervisor), .events = POLLIN}};
    int64_t end = events_clock_ms() + service->config->drain_timeout_ms;
    atomic_store(&service->draining, true);
    log_line(LOG_INFO, "draining: no new work, running jobs and uploads have %lld s",
             (long long)(service->config->drain_timeout_ms / 1000));
    let_signals_end();
    supervisor_stop(service->supervisor);
    for (bool late = false, idle = false; !idle || (!late && http_uploads(http));) {
        poll(fds, idle ? 1 : 2, DRAIN_LOOK_MS);
        if (!late && events_clock_ms() >= end) {
            late = true;
            supervisor_requeue(service->supervisor);
        }
        idle = idle || fds[1].revents;
        if (fds[0].revents) read_signal(signals); /* SIGHUP, which changes nothing any more */
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

static int run(const struct config *config, int signals, int argc, char **argv) {
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
    enum status status = supervisor_open(&service, &service.supervisor, &error);
    if (status == STATUS_OK) status = webhooks_open(&service, &webhooks, &error);
    if (status == STATUS_OK) status = http_open(&service, &http, &addresses, &error);
    if (status == STATUS_OK) status = notify_watch(answers, &service, &watch, &error);
    if (status == STATUS_OK) {
        printf("listening on %s\n", address);
        if (addresses.admin[0]) printf("health and metrics on %s\n", addresses.admin);
        fflush(stdout);
        log_line(LOG_INFO, "whittled %s listening on %s, data in %s, %lld workers", whittle_version(), address,
                 config->data, (long long)config->workers);
        tell_ready(address);
        serve(&service, reload, signals);
        notify_send("STOPPING=1\nSTATUS=draining");
        drain(&service, http, signals);
    } else if (service.supervisor) {
        supervisor_stop(service.supervisor);
    }
    events_close(service.events);
    http_close(http);
    notify_unwatch(watch);
    supervisor_close(service.supervisor);
    webhooks_close(webhooks);
    service_close(&service);
    reload_close(reload);
    log_line(LOG_INFO, "ended");
    return status == STATUS_OK ? EXIT_SUCCESS : fail(&error);
}

int main(int argc, char **argv) {
    struct config config;
    struct error error = {0};
    if (argc > 1 && strcmp(argv[1], "healthcheck") == 0) return healthcheck_main(argc - 1, argv + 1);
    if (argc > 1 && strcmp(argv[1], "check") == 0) return check_main(argc - 1, argv + 1);
    switch (config_read(&config, argc, argv, environ, &error)) {
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
    raise_file_limit();
    give_memory_back();
    int signals = open_signals();
    if (signals < 0) {
        fprintf(stderr, "whittled: signals: %s\n", strerror(errno));
        return EXIT_FAILURE;
    }
    return run(&config, signals, argc, argv);
}
