/* A service whose jobs end at once.
 *
 * It takes the places of supervisor and service manager; what the service takes for its supervisor is the
 * instant_service.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/instant_service.h"

#include <arpa/inet.h>
#include <assert.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/base/notify.h"
#include "server/handlers/handlers.h"
#include "server/jobs/readiness.h"
#include "server/runner/supervisor.h"

void instant_service_write(const char *folder, const char *name, const char *text) {
    char path[SCRATCH_PATH_BYTES + 16];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    int fd = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    ssize_t written = write(fd, text, strlen(text));
    assert(fd >= 0 && written == (ssize_t)strlen(text));
    close(fd);
}

/* ------------------------------------------------------------------------------------------------ its places */

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

static void end_jobs(struct service *service) {
    static const char report[] = "{\"points_in\":9,\"points_out\":3,\"timings_ms\":{\"read\":1.5,\"total\":2}}";
    char path[SCRATCH_PATH_BYTES];
    struct error error = {0};
    struct job job = {0};
    bool found = true, changed;
    struct catalog_claim by = {service->host, 60000, INT64_MAX};
    while (catalog_claim(service->catalog, &by, &job, &found, &error) == STATUS_OK && found) {
        enum status status = scratch_run_begin(store_scratch(service->store), job.id, job.attempt, path, &error);
        assert(status == STATUS_OK);
        instant_service_write(path, "cloud.ply", "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n");
        instant_service_write(path, "report.json", report);
        status = store_outputs_keep(service->store, job.id, job.attempt, NULL, job.output, &job.output_count, &error);
        assert(status == STATUS_OK);
        job.report = strdup(report);
        status = catalog_finish(service->catalog, JOB_DONE, &job, &changed, &error);
        assert(status == STATUS_OK);
        job_done(&job);
    }
}

void supervisor_notify(struct supervisor *supervisor) {
    struct instant_service *instant = (struct instant_service *)(void *)supervisor;
    if (instant->before) instant->before();
    end_jobs(&instant->service);
    if (instant->after) instant->after();
}

/* ------------------------------------------------------------------------------------------------ open, close */

static const struct service_runner runner = {supervisor_notify, supervisor_cancel, supervisor_answers};

enum status instant_service_open(struct instant_service *instant, const struct config *config, struct error *error) {
    struct http_addresses addresses;
    enum status status = service_open(&instant->service, config, error);
    if (status != STATUS_OK) return status;
    instant->service.runner = &runner;
    instant->service.supervisor = (struct supervisor *)(void *)instant;
    service_tell(&instant->service, instant->service.supervisor);
    status = readiness_open(&instant->service, INT32_MAX, &instant->service.readiness, error); /* looks once */
    if (status == STATUS_OK) status = http_open(&instant->service, &handlers_all, &instant->http, &addresses, error);
    if (status != STATUS_OK) {
        change_feed_close(instant->service.feed);
        readiness_close(instant->service.readiness);
        service_close(&instant->service);
        return status;
    }
    const char *port = strrchr(addresses.main, ':');
    assert(port);
    instant->address = (struct sockaddr_in){.sin_family = AF_INET,
                                            .sin_port = htons((uint16_t)strtoul(port + 1, NULL, 10)),
                                            .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    return STATUS_OK;
}

void instant_service_close(struct instant_service *instant) {
    change_feed_close(instant->service.feed);
    http_close(instant->http);
    readiness_close(instant->service.readiness);
    service_close(&instant->service);
}

int instant_service_connect(const struct instant_service *instant) {
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    int result = connect(fd, (const struct sockaddr *)&instant->address, sizeof instant->address);
    assert(fd >= 0 && result == 0);
    return fd;
}
