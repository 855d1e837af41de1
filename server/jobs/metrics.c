/* The counters and their text.
 *
 * Names and units are Prometheus': seconds and bytes, `_total` for what only grows.  Labels take values from our own
 * tables alone, never from a request, so that nobody can make new series.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/jobs/metrics.h"

#include <dirent.h>
#include <inttypes.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "core/base/version.h"
#include "server/jobs/service.h"

typedef _Atomic uint64_t counter;

/* What is answered; everything else is counted as the last. */
static const int codes[] = {200, 201, 202, 204, 206, 303, 304, 400, 401, 403, 404, 405, 406, 409,
                            410, 412, 413, 415, 416, 422, 429, 431, 460, 500, 503, 504, 507, 0};
enum { CODES = sizeof codes / sizeof codes[0] };

static const int64_t bounds_ms[] = {5, 10, 25, 50, 100, 250, 500, 1000, 2500, 5000, 10000, 30000, 60000};
enum { BOUNDS = sizeof bounds_ms / sizeof bounds_ms[0] };

enum { ROUTES = OPERATION_COUNT + 1, NO_ROUTE = OPERATION_COUNT };

struct metrics {
    counter request[ROUTES][CODES];
    counter within[ROUTES][BOUNDS + 1], elapsed_ms[ROUTES]; /* the last of within: longer than all bounds */
    counter received, sent;
    counter problem[PROBLEM_COUNT];
    counter opened, closed, cut[METRICS_CUT_COUNT];
    counter submitted, run[JOB_EVENT_COUNT], cpu_us, wall_us;
    int64_t started_ms;
};

struct metrics *metrics_new(void) {
    struct metrics *metrics = calloc(1, sizeof *metrics);
    if (metrics) metrics->started_ms = job_now_ms();
    return metrics;
}

void metrics_free(struct metrics *metrics) { free(metrics); }

/* ------------------------------------------------------------------------------------------------ counting */

static void add(counter *value, uint64_t more) { atomic_fetch_add_explicit(value, more, memory_order_relaxed); }

static uint64_t get(const counter *value) { return atomic_load_explicit(value, memory_order_relaxed); }

void metrics_request(struct metrics *metrics, const struct route *route, int status, int64_t ms) {
    size_t r = route ? (size_t)route->operation : NO_ROUTE, code = 0, bound = 0;
    while (code + 1 < CODES && codes[code] != status) code++;
    while (bound < BOUNDS && ms > bounds_ms[bound]) bound++;
    add(&metrics->request[r][code], 1);
    add(&metrics->within[r][bound], 1);
    add(&metrics->elapsed_ms[r], (uint64_t)ms);
}

void metrics_received(struct metrics *metrics, uint64_t bytes) { add(&metrics->received, bytes); }
void metrics_sent(struct metrics *metrics, uint64_t bytes) { add(&metrics->sent, bytes); }
void metrics_problem(struct metrics *metrics, enum problem_kind kind) { add(&metrics->problem[kind], 1); }
void metrics_cut(struct metrics *metrics, enum metrics_cut why) { add(&metrics->cut[why], 1); }
void metrics_submitted(struct metrics *metrics) { add(&metrics->submitted, 1); }

void metrics_connection(struct metrics *metrics, bool opened) { add(opened ? &metrics->opened : &metrics->closed, 1); }

void metrics_run(struct metrics *metrics, enum job_event event, double cpu_s, double wall_s) {
    add(&metrics->run[event], 1);
    add(&metrics->cpu_us, (uint64_t)(cpu_s * 1e6));
    add(&metrics->wall_us, (uint64_t)(wall_s * 1e6));
}

/* ------------------------------------------------------------------------------------------------ text */

static void head(FILE *out, const char *name, const char *type, const char *help) {
    fprintf(out, "# HELP whittled_%s %s\n# TYPE whittled_%s %s\n", name, help, name, type);
}

static void one(FILE *out, const char *name, const char *type, const char *help, uint64_t value) {
    head(out, name, type, help);
    fprintf(out, "whittled_%s %" PRIu64 "\n", name, value);
}

static void seconds(FILE *out, const char *name, const char *help, uint64_t us) {
    head(out, name, "counter", help);
    fprintf(out, "whittled_%s %.6f\n", name, (double)us / 1e6);
}

/* method="...",route="..." of a row of the counters. */
static void labels(size_t r, char *text, size_t bytes) {
    size_t count;
    const struct route *table = routes_table(&count);
    snprintf(text, bytes, "method=\"other\",route=\"none\"");
    for (size_t i = 0; i < count; i++)
        if ((size_t)table[i].operation == r)
            snprintf(text, bytes, "method=\"%s\",route=\"%s\"", table[i].method, table[i].pattern);
}

static void put_requests(FILE *out, const struct metrics *metrics) {
    char label[160], code[8];
    head(out, "http_requests_total", "counter", "Requests that are over; code 0: cut before an answer.");
    for (size_t r = 0; r < ROUTES; r++) {
        labels(r, label, sizeof label);
        for (size_t i = 0; i < CODES; i++) {
            snprintf(code, sizeof code, "%d", codes[i]);
            uint64_t value = get(&metrics->request[r][i]);
            if (value) fprintf(out, "whittled_http_requests_total{%s,code=\"%s\"} %" PRIu64 "\n", label, code, value);
        }
    }
}

static void put_histogram(FILE *out, const struct metrics *metrics, size_t r) {
    static const char name[] = "whittled_http_request_duration_seconds";
    char label[160];
    uint64_t sum = 0;
    labels(r, label, sizeof label);
    for (size_t i = 0; i < BOUNDS; i++) {
        sum += get(&metrics->within[r][i]);
        fprintf(out, "%s_bucket{%s,le=\"%g\"} %" PRIu64 "\n", name, label, (double)bounds_ms[i] / 1e3, sum);
    }
    sum += get(&metrics->within[r][BOUNDS]);
    fprintf(out, "%s_bucket{%s,le=\"+Inf\"} %" PRIu64 "\n%s_sum{%s} %.3f\n%s_count{%s} %" PRIu64 "\n", name, label, sum,
            name, label, (double)get(&metrics->elapsed_ms[r]) / 1e3, name, label, sum);
}

static void put_durations(FILE *out, const struct metrics *metrics) {
    head(out, "http_request_duration_seconds", "histogram", "From headers to the last byte of the answer.");
    for (size_t r = 0; r < ROUTES; r++) {
        uint64_t any = 0;
        for (size_t i = 0; i <= BOUNDS; i++) any += get(&metrics->within[r][i]);
        if (any) put_histogram(out, metrics, r);
    }
}

static void put_connections(FILE *out, const struct metrics *metrics) {
    static const char *const why[METRICS_CUT_COUNT] = {"headers", "idle", "slow", "half_closed"};
    uint64_t opened = get(&metrics->opened), closed = get(&metrics->closed);
    one(out, "http_request_body_bytes_total", "counter", "Bytes of bodies that came in.", get(&metrics->received));
    one(out, "http_response_body_bytes_total", "counter", "Bytes of bodies that went out.", get(&metrics->sent));
    one(out, "http_connections_total", "counter", "Connections that were taken.", opened);
    one(out, "http_connections", "gauge", "Connections that are open.", opened > closed ? opened - closed : 0);
    head(out, "http_connections_cut_total", "counter",
         "Connections that were cut off as too slow, by what was too slow.");
    for (size_t i = 0; i < METRICS_CUT_COUNT; i++)
        fprintf(out, "whittled_http_connections_cut_total{reason=\"%s\"} %" PRIu64 "\n", why[i], get(&metrics->cut[i]));
    head(out, "problems_total", "counter",
         "Problem documents that were sent; limits that were reached are among them.");
    for (int i = 0; i < PROBLEM_COUNT; i++)
        fprintf(out, "whittled_problems_total{problem=\"%s\"} %" PRIu64 "\n", problem_type((enum problem_kind)i)->slug,
                get(&metrics->problem[i]));
}

static void put_jobs(FILE *out, const struct metrics *metrics, struct service *service) {
    static const struct {
        enum job_event event;
        const char *outcome;
    } runs[] = {{JOB_DONE, "successful"}, {JOB_FAIL, "failed"}, {JOB_DISMISS, "dismissed"}, {JOB_REQUEUE, "requeued"}};
    const struct config *config = service->config;
    uint64_t waiting, running;
    catalog_depth(service->catalog, &waiting, &running);
    head(out, "jobs", "gauge", "Jobs that have not ended, by state.");
    fprintf(out, "whittled_jobs{state=\"accepted\"} %" PRIu64 "\nwhittled_jobs{state=\"running\"} %" PRIu64 "\n",
            waiting, running);
    one(out, "queue_limit", "gauge", "Jobs that may wait.", (uint64_t)config->max_queue);
    one(out, "workers", "gauge", "Jobs that may run at the same time.", (uint64_t)config->workers);
    one(out, "jobs_submitted_total", "counter", "Jobs that were accepted.", get(&metrics->submitted));
    head(out, "job_runs_total", "counter", "Runs of jobs that have ended, by what became of the job.");
    for (size_t i = 0; i < sizeof runs / sizeof *runs; i++)
        fprintf(out, "whittled_job_runs_total{outcome=\"%s\"} %" PRIu64 "\n", runs[i].outcome,
                get(&metrics->run[runs[i].event]));
    seconds(out, "worker_cpu_seconds_total", "Processor time of runs that have ended.", get(&metrics->cpu_us));
    seconds(out, "worker_wall_seconds_total", "Time of runs that have ended.", get(&metrics->wall_us));
}

static uint64_t count_descriptors(void) {
    DIR *folder = opendir("/proc/self/fd");
    uint64_t count = 0;
    while (folder && readdir(folder)) count++;
    if (folder) closedir(folder);
    return count > 3 ? count - 3 : 0; /* ".", ".." and the folder's own */
}

static uint64_t resident_bytes(void) {
    unsigned long long size = 0, resident = 0;
    FILE *file = fopen("/proc/self/statm", "re");
    if (file && fscanf(file, "%llu %llu", &size, &resident) != 2) resident = 0;
    if (file) fclose(file);
    return resident * (uint64_t)sysconf(_SC_PAGESIZE);
}

static void put_confinement(FILE *out, const struct service *service) {
    head(out, "confinement", "gauge", "What confines jobs: 0 where it doesn't hold; of Landlock the version.");
    for (size_t i = 0; i < SERVICE_MEASURES && service->confinement[i].name; i++)
        fprintf(out, "whittled_confinement{measure=\"%s\"} %" PRId64 "\n", service->confinement[i].name,
                service->confinement[i].value);
}

static void put_process(FILE *out, const struct metrics *metrics, struct service *service) {
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    one(out, "disk_free_bytes", "gauge", "Bytes that may still be written to the data folder.",
        scratch_free_bytes(store_scratch(service->store)));
    one(out, "disk_reserve_bytes", "gauge", "Uploads are refused when less would be left.",
        (uint64_t)service->config->min_free_bytes);
    one(out, "lost_found_files", "gauge", "Clouds, jobs and uploads in lost+found of the data folder.",
        store_lost(service->store));
    one(out, "draining", "gauge", "1 while the service is about to stop.", atomic_load(&service->draining));
    seconds(out, "process_cpu_seconds_total", "Processor time of the service itself.",
            (uint64_t)(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) * 1000000 +
                (uint64_t)(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec));
    one(out, "process_resident_memory_bytes", "gauge", "Memory of the service itself.", resident_bytes());
    one(out, "process_open_fds", "gauge", "Descriptors that the service has open.", count_descriptors());
    head(out, "process_start_time_seconds", "gauge", "When the service has started, since 1970.");
    fprintf(out, "whittled_process_start_time_seconds %.3f\n", (double)metrics->started_ms / 1e3);
    head(out, "build_info", "gauge", "Always 1; its label says what runs.");
    fprintf(out, "whittled_build_info{version=\"%s\"} 1\n", whittle_version());
}

char *metrics_text(struct metrics *metrics, struct service *service) {
    char *text = NULL;
    size_t bytes;
    FILE *out = open_memstream(&text, &bytes);
    if (!out) return NULL;
    put_requests(out, metrics);
    put_durations(out, metrics);
    put_connections(out, metrics);
    put_jobs(out, metrics, service);
    put_confinement(out, service);
    put_process(out, metrics, service);
    if (fclose(out) == 0) return text;
    free(text);
    return NULL;
}
