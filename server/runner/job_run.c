/* One run of one job.
 *
 *     start: folder for outputs, log, fork + exec
 *     watch: progress, the end, a command to end it, its time limit, its standing still -- whichever comes first
 *     judge: what the exit status, the signal and its last message mean for the job
 *     settle: keep or drop outputs, one transition in the catalog
 *
 * A process that dies without a word gets an obituary: how it ended, its last stage, its resources, and the last bytes
 * of its standard error.  SIGKILL and SIGTERM that didn't come from here are the host's fault (the kernel short of
 * memory, an operator): the job is tried again, until it has failed so JOB_MAX_FAILURES times.  So it is where the
 * process stood still: no word and no processor time for job-stall, which no stage of the work looks like.  SIGSEGV and
 * its like would only come again, so they fail the job at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/runner/job_run.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "api/codecs/report_read.h"
#include "api/problem.h"
#include "core/base/clock.h"
#include "core/base/fault.h"
#include "core/base/process_memory.h"
#include "core/io/codec/inflate.h"
#include "core/tiles/fit.h"
#include "server/base/digest.h"
#include "server/base/log.h"
#include "server/base/wall_clock.h"
#include "server/jobs/metrics.h"
#include "server/runner/footprint.h"
#include "server/runner/spawn.h"
#include "server/runner/task_files.h"
#include "server/shared/worker_protocol.h"
#include "server/storage/admission.h"

enum {
    PROGRESS_EVERY_MS = 250,
    KILL_AFTER_MS = 2000,
    LAST_WORDS_BYTES = 200,
    RECORD_AGAIN_MS = 1000,
    START_AGAIN_MS = 1000,
    START_PATIENCE_MS = 600000,
    SHARED_PATIENCE_MS = 5000, /* where another host may have what this one lacks */
    REPORT_MAX_BYTES = 1 << 20,
    FOOTPRINT_EVERY_MS = 500,
    HEAD_BYTES = INFLATE_HEAD_BYTES /* of a cloud, for what it says of its size */
};
enum { LOG_TAIL_BYTES = 8192, ATTEMPT_LINE_BYTES = 40 };

struct run {
    struct service *service;
    const struct confinement *confinement;
    struct job *job;
    struct job_run_control *control;
    struct spawned process;
    int log_fd;
    struct wire_reader reader;
    struct wire_message said;    /* the last progress, then `done` or `failed` */
    bool is_done, has_failed;    /* which of these it said */
    bool progress_due;           /* something to tell that was not told yet */
    int64_t told_ms;             /* when progress was told last */
    int64_t started_ms, kill_ms; /* of clock_ms; kill_ms: when TERM becomes KILL, 0 = no TERM was sent */
    int64_t moved_ms, cpu_ns;    /* when it was last known to go on; the processor time that it had then */
    bool timed_out, stalled;
    bool input_missing;              /* the store has answered that the job's cloud isn't there */
    bool input_damaged;              /* what it gives isn't the cloud */
    bool is_short;                   /* this host lacks what the job takes */
    char output[SCRATCH_PATH_BYTES]; /* the folder that it writes into */
    struct task_files files;         /* of a job in tiles */
    struct confine_limits limits;
    struct footprint most, found; /* found: what was too much, else zero */
    int64_t footprint_ms;         /* when that was looked at last */
    uint64_t peak_bytes;          /* memory that it was seen to have had at most; 0: it ended before anybody looked */
    int wait_status;
};

/* What became of it. */
struct verdict {
    bool is_lost; /* somebody else has the job: nothing of this run counts */
    enum job_event event;
    struct problem problem; /* where event is JOB_FAIL */
};

/* ------------------------------------------------------------------------------------------------ start */

static int64_t less(int64_t a, int64_t b) { return a < b ? a : b; }

/* Memory is limited to what was predicted, and to what a process takes beside: an eighth for what the prediction
 * doesn't know, its program and libraries, for each thread a stack and a heap of its own, of which the C library
 * reserves 64 MiB, and the input, which is mapped.  Measured: with one thread 20 MiB over the prediction at most, with
 * eight 73 MiB, and 64 MiB for each thread in addresses that nothing is written to. */
static void limit_memory(const struct job *job, uint64_t threads, int64_t most_bytes, struct confine_limits *limits) {
    const int64_t mebibyte = 1 << 20, count = (int64_t)threads, predicted = (int64_t)job->memory_bytes;
    limits->memory_bytes = most_bytes;
    if (!predicted || most_bytes >= CONFINE_ADDRESSABLE || predicted >= most_bytes) return;
    int64_t data = predicted + predicted / 8 + 32 * mebibyte + count * (CONFINE_STACK_BYTES + 4 * mebibyte);
    int64_t addresses = data + (count + 1) * 72 * mebibyte + (int64_t)job->input_bytes;
    if (data < most_bytes) limits->data_bytes = data;
    limits->memory_bytes = less(addresses, most_bytes);
}

/* What is made in tiles may take all of a task's memory; the input is mapped beside, and what it becomes where it is
 * compressed: a file. */
static void limit_task_memory(const struct job *job, uint64_t threads, int64_t most_bytes,
                              struct confine_limits *limits) {
    const int64_t mebibyte = 1 << 20, count = (int64_t)threads, predicted = (int64_t)job->memory_bytes;
    limits->memory_bytes = most_bytes;
    if (most_bytes >= CONFINE_ADDRESSABLE) return;
    limits->data_bytes = predicted + 32 * mebibyte + count * (CONFINE_STACK_BYTES + 4 * mebibyte);
    limits->memory_bytes = limits->data_bytes + (count + 1) * 72 * mebibyte + (int64_t)job->input_bytes;
    if (!task_is_tile(job)) limits->memory_bytes += limits->file_bytes;
}

/* The cloud, where it is read: a tile's points are its own. */
static int open_input(struct run *run) {
    if (task_is_tile(run->job)) return open("/dev/null", O_RDONLY | O_CLOEXEC);
    int input_fd = store_cloud_open(run->service->store, run->job->cloud);
    run->input_missing = input_fd < 0 && errno == ENOENT;
    run->input_damaged = input_fd < 0 && errno == EIO;
    return input_fd;
}

/* Whether the log ends within the attempt: it begins there, and nothing says what became of it. */
static bool ends_within(const char *log, int attempt) {
    char begins[ATTEMPT_LINE_BYTES], became[ATTEMPT_LINE_BYTES];
    snprintf(begins, sizeof begins, "attempt %d begins\n", attempt);
    snprintf(became, sizeof became, "attempt %d: ", attempt);
    return strstr(log, begins) && !strstr(log, became);
}

/* Says of an attempt that was running when its service ended what the service no longer could. */
static void tell_last_attempt(const struct run *run) {
    char tail[LOG_TAIL_BYTES + 1];
    int attempt = run->job->attempt - 1, fd = store_log_open(run->service->store, run->job->id, false);
    off_t end = fd < 0 ? 0 : lseek(fd, 0, SEEK_END);
    ssize_t n = end > 0 ? pread(fd, tail, LOG_TAIL_BYTES, end > LOG_TAIL_BYTES ? end - LOG_TAIL_BYTES : 0) : 0;
    if (fd >= 0) close(fd);
    tail[n > 0 ? n : 0] = '\0';
    if (ends_within(tail, attempt))
        dprintf(run->log_fd, "attempt %d: queued again: the service ended during it\n", attempt);
}

static enum status start(struct run *run, struct error *error) {
    const struct config *config = run->service->config;
    uint64_t threads = service_threads(run->service, &run->job->params);
    fault_at("claimed");
    enum status status =
        scratch_run_begin(store_scratch(run->service->store), run->job->id, run->job->attempt, run->output, error);
    if (status != STATUS_OK) return status;
    run->log_fd = store_log_open(run->service->store, run->job->id, true);
    if (run->log_fd < 0) return error_set(error, STATUS_IO, "worker", "can't open the job's log: %s", strerror(errno));
    if (run->job->attempt > 1) tell_last_attempt(run);
    dprintf(run->log_fd, "attempt %d begins\n", run->job->attempt);
    int input_fd = open_input(run);
    if (input_fd < 0) return error_set(error, STATUS_IO, "worker", "can't open the job's input: %s", strerror(errno));
    run->limits = (struct confine_limits){.cpu_ms = config->job_cpu_ms, .file_bytes = config->job_file_bytes};
    uint64_t write_bytes = (uint64_t)config->job_write_bytes;
    if (run->job->tiles) {
        limit_task_memory(run->job, threads, config->job_memory_bytes, &run->limits);
        run->most = footprint_most_of_task(&run->job->params, threads, write_bytes);
        status = task_files_open(&run->files, run->service->store, run->job, error);
        run->limits.files = (int64_t)run->files.count;
    } else {
        limit_memory(run->job, threads, config->job_memory_bytes, &run->limits);
        run->most = footprint_most(&run->job->params, threads, write_bytes);
    }
    run->limits.threads = (int64_t)run->most.threads;
    struct spawn_request request = {.confinement = run->confinement,
                                    .input_fd = input_fd,
                                    .output = run->output,
                                    .params = &run->job->params,
                                    .threads = threads,
                                    .memory_bytes = run->job->memory_bytes,
                                    .log_fd = run->log_fd,
                                    .task = run->job->tiles ? run->files.task : NULL,
                                    .files = run->files.names,
                                    .file_fd = run->files.fd,
                                    .file_count = run->files.count,
                                    .limits = run->limits};
    if (status == STATUS_OK) status = spawn_worker(&request, &run->process, error);
    close(input_fd);
    task_files_close(&run->files);
    run->started_ms = run->moved_ms = clock_ms();
    return status;
}

/* Shows the supervisor that this thread goes on. */
static void show(const struct run *run) { atomic_store(&run->control->seen_ms, clock_ms()); }

/* Makes the bell ring no more; what it rang for stands in the command. */
static void hush(const struct run *run) {
    uint64_t rings;
    ssize_t got = read(run->control->wake_fd, &rings, sizeof rings);
    (void)got;
}

/* Waits, at most until somebody commands something.  The bell may still ring for the job before. */
static void wait_for_command(const struct run *run, int wait_ms) {
    struct pollfd bell = {.fd = run->control->wake_fd, .events = POLLIN};
    if (poll(&bell, 1, wait_ms) > 0) hush(run);
}

/* Starts it, and again for as long as the machine lacks what that takes: descriptors, processes, memory, disk.  Nothing
 * of the job has run yet, so it stays the same attempt.  Where hosts share the work another one may lack nothing. */
static enum status start_when_possible(struct run *run, struct error *error) {
    int64_t until = run->started_ms + (run->service->is_shared ? SHARED_PATIENCE_MS : START_PATIENCE_MS);
    for (;;) {
        show(run);
        enum status status = start(run, error);
        bool wanted = atomic_load(&run->control->command) == JOB_RUN_GO_ON;
        if (status == STATUS_OK || run->input_missing || !wanted) return status;
        run->is_short = run->service->is_shared && !run->input_damaged && clock_ms() >= until;
        if (clock_ms() >= until) return status;
        log_line(LOG_WARNING, "job=%s can't be started yet: %s", run->job->id, error->text);
        if (run->log_fd >= 0) close(run->log_fd);
        run->log_fd = -1;
        wait_for_command(run, START_AGAIN_MS);
    }
}

/* ------------------------------------------------------------------------------------------------ watch */

/* Once it has ended it can't be asked any more. */
static void look_at_memory(struct run *run) {
    uint64_t peak_bytes = process_peak_bytes(run->process.pid);
    if (peak_bytes > run->peak_bytes) run->peak_bytes = peak_bytes;
}

static void hear(void *ctx, const struct wire_message *message) {
    struct run *run = ctx;
    run->moved_ms = clock_ms();
    if (run->is_done || run->has_failed) return; /* nothing counts after the end */
    run->is_done = message->kind == WIRE_DONE;
    run->has_failed = message->kind == WIRE_FAILED;
    if (run->is_done || run->has_failed) look_at_memory(run);
    run->progress_due = message->kind == WIRE_PROGRESS;
    run->said.kind = message->kind;
    if (message->kind == WIRE_FAILED) run->said.error = message->error;
    if (message->kind != WIRE_PROGRESS) return;
    struct job *job = run->job;
    snprintf(job->stage, sizeof job->stage, "%s", message->stage);
    snprintf(job->message, sizeof job->message, "%s", message->text);
    job->fraction = task_fraction(job, message->fraction);
}

/* Reads what there is; false at the end of the stream. */
static bool read_progress(struct run *run) {
    char bytes[4096];
    ssize_t n;
    while ((n = read(run->process.progress_fd, bytes, sizeof bytes)) > 0)
        wire_read(&run->reader, bytes, (size_t)n, hear, run);
    return n < 0 && (errno == EAGAIN || errno == EINTR);
}

static void tell_progress(struct run *run, int64_t now) {
    struct error error = {0};
    const struct job *job = run->job;
    run->progress_due = false;
    run->told_ms = now;
    bool held = true;
    if (catalog_progress(run->service->catalog, job, &held, &error) != STATUS_OK)
        log_line(LOG_ERROR, "job=%s progress isn't kept: %s", job->id, error.text);
    if (!held) atomic_store(&run->control->command, JOB_RUN_LOST);
}

static void terminate(struct run *run, int64_t now) {
    if (run->kill_ms) return;
    kill(-run->process.pid, SIGTERM);
    run->kill_ms = now + KILL_AFTER_MS;
}

/* Processor time of the process, all its threads; -1: not known. */
static int64_t cpu_ns_of(pid_t pid) {
    clockid_t clock;
    struct timespec used;
    if (clock_getcpuclockid(pid, &clock) != 0 || clock_gettime(clock, &used) != 0) return -1;
    return (int64_t)used.tv_sec * 1000000000 + used.tv_nsec;
}

/* Ends it where it stands still; returns when to look again. */
static int64_t look_for_stall(struct run *run, int64_t now) {
    int64_t stall_ms = run->service->config->job_stall_ms;
    if (!stall_ms || run->kill_ms) return INT64_MAX;
    if (now - run->moved_ms >= stall_ms) {
        int64_t cpu_ns = cpu_ns_of(run->process.pid);
        run->stalled = cpu_ns >= 0 && cpu_ns == run->cpu_ns;
        run->cpu_ns = cpu_ns;
        run->moved_ms = now;
        if (run->stalled) terminate(run, now);
    }
    return run->moved_ms + stall_ms;
}

/* Ends it at once where it has taken more than a job may; returns when to look again. */
static int64_t look_for_excess(struct run *run, int64_t now) {
    if (now - run->footprint_ms < FOOTPRINT_EVERY_MS) return run->footprint_ms + FOOTPRINT_EVERY_MS;
    const struct footprint *most = &run->most;
    struct footprint found = footprint_of(run->process.pid, run->output, most->files);
    run->footprint_ms = now;
    look_at_memory(run);
    if (found.threads > most->threads || found.files > most->files || found.written_bytes > most->written_bytes) {
        run->found = found;
        run->kill_ms = now;
    }
    return now + FOOTPRINT_EVERY_MS;
}

/* Does what is due, and returns how long nothing else will be, in milliseconds. */
static int look_around(struct run *run) {
    int64_t now = clock_ms(), end = run->started_ms + run->service->config->job_wall_ms;
    int64_t next = less(end, less(look_for_stall(run, now), look_for_excess(run, now)));
    if (run->progress_due && now - run->told_ms >= PROGRESS_EVERY_MS) tell_progress(run, now);
    int command = atomic_load(&run->control->command);
    if (command != JOB_RUN_GO_ON) terminate(run, now);
    if (command == JOB_RUN_LOST && run->kill_ms > now) run->kill_ms = now;
    if (now >= end && !run->kill_ms) {
        run->timed_out = true;
        terminate(run, now);
    }
    if (run->kill_ms) {
        next = run->kill_ms;
        if (now >= run->kill_ms) {
            kill(-run->process.pid, SIGKILL);
            next = now + KILL_AFTER_MS;
        }
    }
    if (run->progress_due && run->told_ms + PROGRESS_EVERY_MS < next) next = run->told_ms + PROGRESS_EVERY_MS;
    return next <= now ? 0 : next - now > 60000 ? 60000 : (int)(next - now);
}

static void watch(struct run *run) {
    struct pollfd fds[] = {{.fd = run->process.pid_fd, .events = POLLIN},
                           {.fd = run->process.progress_fd, .events = POLLIN},
                           {.fd = run->control->wake_fd, .events = POLLIN}};
    while (!fds[0].revents) {
        show(run);
        int n = poll(fds, 3, look_around(run));
        if (n < 0) continue;
        if (fds[1].revents && !read_progress(run)) fds[1].fd = -1;
        if (fds[2].revents) hush(run);
    }
    read_progress(run);
    run->footprint_ms = 0;
    look_for_excess(run, clock_ms()); /* what it took at last */
}

/* wait4's figure goes on from what this process had when it forked: where that isn't less than the most that this one
 * has ever had, what was seen is nearer. */
static uint64_t peak_bytes_of(const struct run *run, const struct rusage *usage) {
    uint64_t bytes = (uint64_t)usage->ru_maxrss * 1024;
    return bytes > process_peak_bytes(0) || !run->peak_bytes ? bytes : run->peak_bytes;
}

/* Ends what is left of its group, and takes its figures. */
static void reap(struct run *run) {
    struct rusage usage = {0};
    kill(-run->process.pid, SIGKILL);
    while (wait4(run->process.pid, &run->wait_status, 0, &usage) < 0 && errno == EINTR) continue;
    struct job *job = run->job;
    job->wall_s = (double)(clock_ms() - run->started_ms) / 1e3;
    job->task_cpu_s = (double)(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
                      (double)(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) / 1e6;
    uint64_t peak_bytes = peak_bytes_of(run, &usage);
    if (job->tiles) { /* with what its tasks took before */
        job->cpu_s += job->task_cpu_s;
        job->wall_s = (double)(job_now_ms() - job->started_ms) / 1e3;
        if (peak_bytes < job->peak_rss_bytes) peak_bytes = job->peak_rss_bytes;
    } else {
        job->cpu_s = job->task_cpu_s;
    }
    job->peak_rss_bytes = peak_bytes;
    spawn_done(&run->process);
}

/* ------------------------------------------------------------------------------------------------ judge */

/* The end of the job's log. */
static void last_words(const struct run *run, char *words, size_t bytes) {
    struct stat facts;
    words[0] = 0;
    int fd = store_log_open(run->service->store, run->job->id, false);
    if (fd < 0) return;
    off_t from = fstat(fd, &facts) == 0 && facts.st_size >= (off_t)bytes ? facts.st_size - (off_t)bytes + 1 : 0;
    ssize_t n = pread(fd, words, bytes - 1, from);
    words[n > 0 ? n : 0] = 0;
    for (char *c = words; *c; c++)
        if ((unsigned char)*c < 0x20) *c = ' ';
    close(fd);
}

static void write_obituary(const struct run *run, enum problem_kind kind, struct problem *problem) {
    const struct job *job = run->job;
    char words[LAST_WORDS_BYTES], how[64];
    bool by_signal = WIFSIGNALED(run->wait_status);
    int number = by_signal ? WTERMSIG(run->wait_status) : WEXITSTATUS(run->wait_status);
    snprintf(how, sizeof how, "%s %d%s%s", by_signal ? "signal" : "exit status", number, by_signal ? ", " : "",
             by_signal ? strsignal(number) : "");
    if (by_signal && number == SIGSYS) snprintf(how, sizeof how, "a system call that a job may not make");
    problem_set(problem, kind, "the process of attempt %d ended with %s%s%s", job->attempt, how,
                job->stage[0] ? " in stage " : "", job->stage);
    problem_add_number(problem, by_signal ? "signal" : "exit_status", number);
    problem_add_text(problem, "stage", job->stage);
    problem_add_number(problem, "attempt", job->attempt);
    problem_add_number(problem, "peak_rss_bytes", (int64_t)job->peak_rss_bytes);
    problem_add_number(problem, "cpu_ms", (int64_t)(job->cpu_s * 1e3));
    last_words(run, words, sizeof words);
    if (words[0]) problem_add_text(problem, "last_words", words);
}

/* The first bytes of the job's cloud; returns new, NULL without memory or cloud. */
static unsigned char *read_head(const struct run *run, size_t *n) {
    unsigned char *head = calloc(1, HEAD_BYTES);
    const uint64_t bytes = run->job->input_bytes;
    const struct store_range range = {0, (bytes < HEAD_BYTES ? bytes : HEAD_BYTES) - 1, bytes};
    int fd = bytes ? store_cloud_open_range(run->service->store, run->job->cloud, &range) : -1;
    ssize_t got = fd >= 0 && head ? pread(fd, head, HEAD_BYTES, 0) : 0;
    *n = got > 0 ? (size_t)got : 0;
    if (fd >= 0) close(fd);
    return head;
}

/* What would fit instead. */
static void advise(const struct run *run, char *advice, size_t bytes) {
    const struct job *job = run->job;
    struct admission admission = service_admission(run->service->config, &job->params);
    size_t n;
    unsigned char *head = read_head(run, &n);
    admission_advise(&admission, head, n, job->input_bytes, advice, bytes);
    free(head);
}

/* Whether tetrahedra or triangles took more memory than was predicted, and the job may have more: it waits for that. */
static bool wants_more_memory(const struct run *run) {
    const struct error *said = &run->said.error;
    struct job *job = run->job;
    bool unforeseen = strcmp(said->where, "delaunay") == 0 || strcmp(said->where, "faces") == 0;
    if (said->code != STATUS_NO_MEMORY || !unforeseen || !job->memory_bytes) return false;
    struct admission admission = service_admission(run->service->config, &job->params);
    size_t n;
    unsigned char *head = read_head(run, &n);
    uint64_t most = admission_most(&admission, head, n, job->input_bytes);
    free(head);
    if (most <= job->memory_bytes) return false;
    job->memory_bytes = most;
    return true;
}

/* What was expected, what it took, what it may take, and what would do. */
static void explain_memory(const struct run *run, struct problem *problem) {
    const struct job *job = run->job;
    char advice[160], predicted[64] = "", said[160];
    const unsigned long long megabyte = 1 << 20;
    bool by_prediction = run->limits.data_bytes > 0;
    unsigned long long limit = (unsigned long long)(by_prediction ? run->limits.data_bytes : run->limits.memory_bytes);
    advise(run, advice, sizeof advice);
    if (job->memory_bytes) {
        problem_add_number(problem, "predicted_bytes", (int64_t)job->memory_bytes);
        snprintf(predicted, sizeof predicted,
                 by_prediction ? "the %llu MiB predicted did not suffice, " : "%llu MiB were predicted, ",
                 (unsigned long long)job->memory_bytes / megabyte);
    }
    problem_add_number(problem, "used_bytes", (int64_t)job->peak_rss_bytes);
    problem_add_number(problem, "limit", (int64_t)limit);
    problem_add_text(problem, "hint", advice);
    snprintf(said, sizeof said, "%.159s", problem->detail);
    snprintf(problem->detail, sizeof problem->detail, "%s: %s%llu MiB used, %llu MiB of %s allowed; %s", said,
             predicted, (unsigned long long)job->peak_rss_bytes / megabyte, limit / megabyte,
             by_prediction ? "data" : "address space", advice);
}

/* The processor-time limit shows as SIGXCPU, or as SIGKILL where that was ignored. */
static bool out_of_time(const struct run *run) {
    bool by_signal = WIFSIGNALED(run->wait_status);
    bool out_of_cpu = run->job->cpu_s * 1e3 >= (double)run->service->config->job_cpu_ms;
    return run->timed_out || (by_signal && WTERMSIG(run->wait_status) == SIGXCPU) || (by_signal && out_of_cpu);
}

/* Which limit it was, and what would help. */
static void explain_time(const struct run *run, struct problem *problem) {
    const struct config *config = run->service->config;
    const struct job *job = run->job;
    const char *setting = run->timed_out ? "job-wall" : "job-cpu";
    int64_t limit_ms = run->timed_out ? config->job_wall_ms : config->job_cpu_ms;
    problem_add_text(problem, "setting", setting);
    problem_add_number(problem, "limit_ms", limit_ms);
    snprintf(problem->detail, sizeof problem->detail,
             "the job was ended in stage %.31s, after %.1f s, at %.0f %%: over the limit of %.1f s (setting %s); fewer "
             "points, or no mesh, or refine=flips take less",
             job->stage[0] ? job->stage : "start", run->timed_out ? job->wall_s : job->cpu_s, job->fraction * 100,
             (double)limit_ms / 1000, setting);
}

static void explain_stall(const struct run *run, struct problem *problem) {
    const struct job *job = run->job;
    int64_t limit_ms = run->service->config->job_stall_ms;
    problem_add_text(problem, "setting", "job-stall");
    problem_add_number(problem, "limit_ms", limit_ms);
    snprintf(problem->detail, sizeof problem->detail,
             "the process of attempt %d was ended in stage %.31s: it stood still, with no word and no processor time "
             "for %.1f s (setting job-stall)",
             job->attempt, job->stage[0] ? job->stage : "start", (double)limit_ms / 1000);
}

/* What there was too much of. */
static void explain_excess(const struct run *run, struct problem *problem) {
    const struct footprint *found = &run->found, *most = &run->most;
    unsigned long long is = found->threads, allowed = most->threads;
    const char *what = "threads", *setting = "";
    if (found->files > most->files) is = found->files, allowed = most->files, what = "files";
    if (found->written_bytes > most->written_bytes) {
        is = found->written_bytes, allowed = most->written_bytes, what = "bytes written";
        setting = " (setting job-write-bytes)";
        problem_add_text(problem, "setting", "job-write-bytes");
    }
    problem_add_number(problem, "limit", (int64_t)allowed);
    snprintf(problem->detail, sizeof problem->detail,
             "the process of attempt %d was ended%s%.31s: %llu %s, a job may have %llu%s", run->job->attempt,
             run->job->stage[0] ? " in stage " : "", run->job->stage, is, what, allowed, setting);
}

/* Whether it ended by somebody's hand rather than by its own. */
static bool by_the_host(const struct run *run) {
    static const int signals[] = {SIGKILL, SIGTERM, SIGINT, SIGHUP, SIGQUIT};
    if (run->has_failed && run->said.error.code == STATUS_CANCELLED) return true;
    for (size_t i = 0; i < sizeof signals / sizeof *signals; i++)
        if (WIFSIGNALED(run->wait_status) && WTERMSIG(run->wait_status) == signals[i]) return true;
    return false;
}

/* What becomes of a job whose process couldn't be started. */
static void judge_unstarted(const struct run *run, const struct error *error, struct verdict *verdict) {
    int command = atomic_load(&run->control->command);
    verdict->is_lost = command == JOB_RUN_LOST;
    bool again = command == JOB_RUN_REQUEUE || run->is_short || ++run->job->failures < JOB_MAX_FAILURES;
    verdict->event = command == JOB_RUN_DISMISS ? JOB_DISMISS : again ? JOB_REQUEUE : JOB_FAIL;
    problem_set(&verdict->problem, PROBLEM_INTERNAL_ERROR, "the job's process can't be started: %s", error->text);
}

/* Whether its disk was too full, and others' may not be. */
static bool is_short_of_disk(const struct run *run) {
    return run->service->is_shared && run->has_failed && run->said.error.code == STATUS_NO_SPACE;
}

/* Whether a task was planned by another version of whittle.  While hosts of both are there one of the other version may
 * have it; where none comes, the job begins anew. */
static bool is_of_another_version(struct run *run) {
    struct job *job = run->job;
    if (!job->tiles || !run->has_failed || strcmp(run->said.error.where, "version") != 0) return false;
    run->is_short = run->service->is_shared;
    if (!run->is_short || ++job->failures >= JOB_MAX_FAILURES) {
        job->task = JOB_TASK_NONE;
        job->failures = 0;
    }
    return true;
}

/* Whether what other tasks have made isn't what they made any more: the disk has lost some of it, so all is made anew,
 * but not on and on. */
static bool is_damaged(struct run *run) {
    struct job *job = run->job;
    if (!job->tiles || !run->has_failed || strcmp(run->said.error.where, TILES_DAMAGED) != 0) return false;
    if (job->attempt > 2 * (job->tiles + 2)) return false; /* more than two rounds of tasks take */
    job->task = JOB_TASK_NONE;
    job->failures = 0;
    return true;
}

static void judge(struct run *run, struct verdict *verdict) {
    int command = atomic_load(&run->control->command);
    bool exited_well = WIFEXITED(run->wait_status) && WEXITSTATUS(run->wait_status) == 0;
    bool no_memory = WIFEXITED(run->wait_status) && WEXITSTATUS(run->wait_status) == WIRE_EXIT_MEMORY;
    verdict->event = JOB_FAIL;
    verdict->is_lost = command == JOB_RUN_LOST;
    if (command == JOB_RUN_DISMISS || command == JOB_RUN_LOST) {
        verdict->event = JOB_DISMISS;
    } else if (run->is_done && exited_well) {
        verdict->event = JOB_DONE;
    } else if (run->found.files || run->found.threads) {
        write_obituary(run, PROBLEM_WORKER_CRASHED, &verdict->problem);
        explain_excess(run, &verdict->problem);
    } else if (command == JOB_RUN_REQUEUE) {
        verdict->event = JOB_REQUEUE;
    } else if (out_of_time(run)) {
        write_obituary(run, PROBLEM_TIME_LIMIT, &verdict->problem);
        explain_time(run, &verdict->problem);
    } else if (by_the_host(run)) {
        write_obituary(run, PROBLEM_WORKER_CRASHED, &verdict->problem);
        if (run->stalled) explain_stall(run, &verdict->problem);
        if (++run->job->failures < JOB_MAX_FAILURES) verdict->event = JOB_REQUEUE;
    } else if (run->has_failed && wants_more_memory(run)) {
        verdict->event = JOB_REQUEUE;
        problem_from_error(&verdict->problem, &run->said.error);
    } else if (is_short_of_disk(run) && ++run->job->failures < JOB_MAX_FAILURES) {
        verdict->event = JOB_REQUEUE;
        run->is_short = true;
        problem_from_error(&verdict->problem, &run->said.error);
    } else if (is_of_another_version(run) || is_damaged(run)) {
        verdict->event = JOB_REQUEUE;
        problem_from_error(&verdict->problem, &run->said.error);
    } else if (run->has_failed) {
        problem_from_error(&verdict->problem, &run->said.error);
    } else {
        write_obituary(run, no_memory ? PROBLEM_OUT_OF_MEMORY : PROBLEM_WORKER_CRASHED, &verdict->problem);
    }
    if (verdict->event == JOB_FAIL && verdict->problem.kind == PROBLEM_OUT_OF_MEMORY)
        explain_memory(run, &verdict->problem);
}

/* ------------------------------------------------------------------------------------------------ settle */

/* The report that the job wrote, compact, before it is put into the store; NULL where it can't be read. */
static char *read_report(const struct run *run) {
    char path[SCRATCH_PATH_BYTES + 16];
    snprintf(path, sizeof path, "%s/report.json", run->output);
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    char *text = fd >= 0 ? calloc(1, REPORT_MAX_BYTES) : NULL, *report = NULL;
    if (text && pread(fd, text, REPORT_MAX_BYTES - 1, 0) > 0) report = report_read_compact(text);
    free(text);
    if (fd >= 0) close(fd);
    return report;
}

/* The folder that it wrote into. */
static void drop_run(const struct run *run) {
    struct scratch *scratch = store_scratch(run->service->store);
    (run->job->tiles ? scratch_run_drop_alone : scratch_run_drop)(scratch, run->job->id, run->job->attempt);
}

static void drop_outputs(struct run *run) {
    store_outputs_delete(run->service->store, run->job->id, run->job->attempt);
    run->job->output_count = 0;
}

/* Hashing takes its time; who dismisses the job then doesn't wait for the end of it.  For struct digest_will. */
static bool run_is_wanted(void *ctx) {
    const struct run *run = ctx;
    show(run);
    int command = atomic_load(&run->control->command);
    return command != JOB_RUN_DISMISS && command != JOB_RUN_LOST;
}

/* Whether the outputs, which the store didn't take, wait for it: the job's lease is renewed meanwhile. */
static bool waits_for_store(const struct run *run, enum status status) {
    bool may_come = service_store_is_apart(run->service) && (status == STATUS_IO || status == STATUS_NO_SPACE);
    return may_come && atomic_load(&run->control->command) == JOB_RUN_GO_ON && !atomic_load(&run->service->draining);
}

/* Puts them into the store, and again for as long as it doesn't answer. */
static enum status put_outputs_when_possible(struct run *run, struct error *error) {
    struct job *job = run->job;
    const struct digest_will will = {run_is_wanted, run};
    int64_t until = clock_ms() + START_PATIENCE_MS;
    for (;;) {
        enum status status = task_makes_outputs(job)
                                 ? store_outputs_keep(run->service->store, job->id, job->attempt, &will, job->output,
                                                      &job->output_count, error)
                                 : store_tiles_keep(run->service->store, job->id, job->attempt, &will, error);
        if (status == STATUS_OK || !waits_for_store(run, status) || clock_ms() >= until) return status;
        log_line_seldom(LOG_WARNING, "job=%s its outputs wait for the store: %s", job->id, error->text);
        wait_for_command(run, RECORD_AGAIN_MS);
    }
}

/* Makes the outputs visible; on failure, or when the job is dismissed meanwhile, the verdict changes. */
static void keep_outputs(struct run *run, struct verdict *verdict) {
    struct error error = {0};
    struct job *job = run->job;
    enum status status = task_makes_outputs(job)
                             ? footprint_check(run->output, &job->params, &error)
                             : footprint_check_task(run->output, job->task, task_tells_gone(job), &job->tiles, &error);
    bool is_sound = status == STATUS_OK;
    if (is_sound) {
        char *report =
            task_makes_outputs(job) ? read_report(run) : NULL; /* keeping the outputs takes them out of this folder */
        status = put_outputs_when_possible(run, &error);
        free(status == STATUS_OK ? job->report : report);
        if (status == STATUS_OK) job->report = report;
    }
    if (!run_is_wanted(run)) verdict->event = JOB_DISMISS;
    if (status != STATUS_OK || verdict->event == JOB_DISMISS) drop_outputs(run);
    if (status == STATUS_OK || verdict->event == JOB_DISMISS) return;
    log_line(LOG_ERROR, "job=%s outputs can't be kept: %s", job->id, error.text);
    bool comes_again = service_store_is_apart(run->service) && is_sound && status != STATUS_MALFORMED;
    verdict->event = comes_again && ++job->failures < JOB_MAX_FAILURES ? JOB_REQUEUE : JOB_FAIL;
    problem_from_error(&verdict->problem, &error);
}

static void log_verdict(const struct run *run, const struct verdict *verdict) {
    static const char *const became[JOB_EVENT_COUNT] = {
        [JOB_DONE] = "successful", [JOB_FAIL] = "failed", [JOB_DISMISS] = "dismissed", [JOB_REQUEUE] = "queued again"};
    const struct job *job = run->job;
    bool has_detail = verdict->problem.detail[0] != 0, goes_on = verdict->event == JOB_DONE && !task_makes_outputs(job);
    const char *now = goes_on ? "running, a task is done" : became[verdict->event];
    log_line(verdict->event == JOB_FAIL ? LOG_WARNING : LOG_INFO,
             "job=%s running -> %s attempt=%d cpu=%.2fs wall=%.2fs rss=%llu%s%s", job->id, now, job->attempt,
             job->cpu_s, job->wall_s, (unsigned long long)job->peak_rss_bytes, has_detail ? ": " : "",
             verdict->problem.detail);
    if (run->log_fd >= 0)
        dprintf(run->log_fd, "attempt %d: %s%s%s\n", job->attempt, now, has_detail ? ": " : "",
                verdict->problem.detail);
}

static enum status write_end(const struct run *run, const struct verdict *verdict, bool *held, struct error *error) {
    wall_clock_hold();
    run->job->expires_ms = job_now_ms() + run->service->config->retention_ms;
    enum status status = catalog_finish(run->service->catalog, verdict->event, run->job, held, error);
    wall_clock_release();
    return status;
}

/* Whether the row says what a try would have written whose answer didn't come.  While nobody can tell it is taken to
 * say so: outputs of a job that has succeeded must stay, and others are garbage at most. */
static bool was_recorded(const struct run *run, const struct verdict *verdict) {
    struct job now;
    struct error error = {0};
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    enum job_state next = JOB_RUNNING;
    if (catalog_get(run->service->catalog, run->job->id, &now, &presence, &tombstone, &error) != STATUS_OK) {
        log_line(LOG_WARNING, "job=%s can't be looked up, so its outputs stay: %s", run->job->id, error.text);
        return true;
    }
    bool is_so = presence == CATALOG_PRESENT && now.attempt == run->job->attempt &&
                 job_transition(JOB_RUNNING, verdict->event, &next) && now.state == next;
    job_done(&now);
    return is_so;
}

/* Records the end.  A database that refuses is asked again: until it does, the job can't be anything else, and taking
 * more work would lead nowhere.  A drain ends the wait; the next start finds the job running, and recovers it.  false:
 * the job isn't this run's any more. */
static bool record(const struct run *run, const struct verdict *verdict) {
    struct error error = {0};
    bool held = true, again = false;
    for (; write_end(run, verdict, &held, &error) != STATUS_OK; again = true) {
        log_line(LOG_ERROR, "job=%s its end can't be recorded: %s", run->job->id, error.text);
        if (atomic_load(&run->service->draining)) return true;
        show(run);
        poll(NULL, 0, RECORD_AGAIN_MS);
    }
    return held || (again && was_recorded(run, verdict));
}

/* What tasks have made goes with the end of their job. */
static void drop_tiles(const struct run *run) {
    if (!store_tiles_delete(run->service->store, run->job->id))
        log_line(LOG_WARNING, "job=%s what its tasks have made is there still", run->job->id);
}

/* Of a task that was late: its job may have ended meanwhile, and then nobody else removes what it has put. */
static void drop_tiles_of_ended(const struct run *run) {
    struct job now;
    struct error error = {0};
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    if (!run->job->tiles ||
        catalog_get(run->service->catalog, run->job->id, &now, &presence, &tombstone, &error) != STATUS_OK)
        return;
    if (presence != CATALOG_PRESENT || job_ended(now.state)) drop_tiles(run);
    job_done(&now);
}

/* Whoever has the job now has outputs of its own: those of this attempt are nobody's. */
static void let_go(struct run *run) {
    log_line(LOG_WARNING,
             "job=%s attempt=%d is lost: its lease has ended, so the job waits again or another host has it, "
             "or it has ended",
             run->job->id, run->job->attempt);
    drop_run(run);
    drop_outputs(run);
    drop_tiles_of_ended(run);
}

/* Before the end is recorded, after which anybody may delete the job: nothing of it is put later. */
static void share_log(const struct run *run) {
    struct error error = {0};
    if (!run->service->is_shared) return;
    if (store_log_share(run->service->store, run->job->id, run->service->host, &error) != STATUS_OK)
        log_line(LOG_ERROR, "job=%s its log can't be shared: %s", run->job->id, error.text);
}

static void settle(struct run *run, struct verdict *verdict) {
    struct job *job = run->job;
    if (verdict->is_lost) {
        let_go(run);
        return;
    }
    if (verdict->event == JOB_DONE) keep_outputs(run, verdict);
    fault_at("outputs-kept");
    drop_run(run);
    show(run);
    log_verdict(run, verdict);
    metrics_run(run->service->metrics, verdict->event, job->cpu_s, job->wall_s);
    if (verdict->event == JOB_FAIL) {
        char link[64];
        snprintf(link, sizeof link, "/v1/jobs/%s/log", job->id);
        problem_add_text(&verdict->problem, "log", link);
        free(job->problem);
        job->problem = problem_encode(&verdict->problem);
    }
    struct job_cost cost = estimate_cost(job);
    if (verdict->event == JOB_DONE && !job->tiles)
        estimate_learn(run->service->estimate, &cost, job->wall_s, job_now_ms());
    share_log(run);
    enum job_state next;
    bool is_held = record(run, verdict);
    if (!is_held) let_go(run);
    if (is_held && job->tiles && job_step_of(job, verdict->event, &next) == JOB_STEP_END) drop_tiles(run);
    fault_at("job-recorded");
}

bool job_run(struct service *service, const struct confinement *confinement, struct job *job,
             struct job_run_control *control) {
    struct run run = {.service = service,
                      .confinement = confinement,
                      .job = job,
                      .control = control,
                      .log_fd = -1,
                      .started_ms = clock_ms()};
    struct verdict verdict = {0};
    struct error error = {0};
    if (start_when_possible(&run, &error) == STATUS_OK) {
        log_line(LOG_INFO, "job=%s accepted -> running attempt=%d pid=%d", job->id, job->attempt, (int)run.process.pid);
        fault_at("started");
        watch(&run);
        reap(&run);
        judge(&run, &verdict);
    } else {
        judge_unstarted(&run, &error, &verdict);
    }
    settle(&run, &verdict);
    if (run.log_fd >= 0) close(run.log_fd);
    return !run.is_short;
}
