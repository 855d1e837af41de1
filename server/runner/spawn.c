/* Starting whittle: everything that needs memory or locks is done before fork, in the child only system calls.
 *
 * The child has no descriptor but 0 (its input), 1 and 2 (its log), 3 (what it says), those of a task's files, and a
 * process group of its own; runner/confine.c does the rest.
 *
 * Where jobs have process ids of their own, the first process among them is their init, whose signals have special
 * rules: so that is not whittle but a keeper, which does nothing but end when the service closes its pipe, or ends.
 * Both are forked by a third process, which enters the namespaces and ends at once, as children of the service:
 *
 *     service --fork--> (enters namespaces, forks both, ends)
 *        |                 |  clone(CLONE_PARENT)
 *        |--- keeper <-----|   process 1: all that there is in the namespace ends with it
 *        `--- whittle <----'   process 2
 *
 * It may be killed at any moment, as the kernel does that is short of memory; so its children's ids are written by the
 * kernel, into memory that it shares with the service, before they run.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/runner/spawn.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <linux/sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/base/fault.h"

enum { MAX_ARGUMENTS = 128, VALUE_BYTES = PARAMS_TEXT_BYTES, PROGRESS_FD = 3, CANNOT_CONFINE = 126, CANNOT_EXEC = 127 };

struct child {
    const struct spawn_request *request;
    char *argv[MAX_ARGUMENTS];
    int input_fd, log_fd, progress_fd;
    int *file_fd; /* over where they are to be; owned */
    pid_t parent;
};

/* ------------------------------------------------------------------------------------------------ arguments */

static bool add(struct child *child, size_t *count, const char *text) {
    if (*count + 1 >= MAX_ARGUMENTS) return false;
    child->argv[*count] = strdup(text);
    if (!child->argv[*count]) return false;
    child->argv[++*count] = NULL;
    return true;
}

static bool add_parameter(struct child *child, size_t *count, const struct params *params, const struct param *row) {
    char value[VALUE_BYTES], name[VALUE_BYTES];
    params_format(params, row, value, sizeof value);
    snprintf(name, sizeof name, "--%s", row->name);
    return !value[0] || (add(child, count, name) && add(child, count, value));
}

static bool make_arguments(struct child *child, const struct spawn_request *request) {
    size_t count = 0, rows;
    const struct param *table = params_table(&rows);
    struct params params = *request->params;
    params.threads = request->threads;
    bool ok = add(child, &count, "whittle");
    if (ok && request->task)
        ok = add(child, &count, "tiles") && add(child, &count, "work") && add(child, &count, request->task) &&
             add(child, &count, request->files);
    ok = ok && add(child, &count, "-");
    for (size_t i = 0; ok && i < rows; i++) ok = add_parameter(child, &count, &params, &table[i]);
    if (ok && request->memory_bytes) {
        char bytes[24];
        snprintf(bytes, sizeof bytes, "%" PRIu64, request->memory_bytes);
        ok = add(child, &count, "--memory") && add(child, &count, bytes);
    }
    return ok && add(child, &count, "-o") && add(child, &count, ".") && add(child, &count, "--progress-fd") &&
           add(child, &count, "3") && add(child, &count, "--quiet");
}

/* ------------------------------------------------------------------------------------------------ the child */

/* The descriptors given are all over those that they become, so that none is overwritten before it is copied. */
static void place_descriptors(const struct child *child) {
    dup2(child->input_fd, STDIN_FILENO);
    dup2(child->log_fd, STDOUT_FILENO);
    dup2(child->log_fd, STDERR_FILENO);
    dup2(child->progress_fd, PROGRESS_FD);
    for (size_t i = 0; i < child->request->file_count; i++) dup2(child->file_fd[i], SPAWN_FIRST_FILE + (int)i);
    syscall(SYS_close_range, SPAWN_FIRST_FILE + child->request->file_count, ~0U, 0);
}

__attribute__((noreturn)) static void become_worker(const struct child *child) {
    const struct spawn_request *request = child->request;
    sigset_t none;
    setpgid(0, 0);
    place_descriptors(child);
    sigemptyset(&none);
    signal(SIGPIPE, SIG_DFL);
    sigprocmask(SIG_SETMASK, &none, NULL);
    if (!confine_this_process(request->confinement, &request->limits, request->output)) _exit(CANNOT_CONFINE);
    if (getppid() != child->parent) _exit(CANNOT_CONFINE); /* it has ended meanwhile */
    confine_execute(request->confinement, child->argv);
    _exit(CANNOT_EXEC);
}

/* ------------------------------------------------------------------------------------------------ the parent */

static int above(const struct spawn_request *request, int fd) {
    return fcntl(fd, F_DUPFD_CLOEXEC, SPAWN_FIRST_FILE + (int)request->file_count);
}

/* false: not all could be had. */
static bool lift_files(struct child *child) {
    size_t count = child->request->file_count;
    child->file_fd = count ? malloc(count * sizeof *child->file_fd) : NULL;
    bool ok = child->file_fd || !count;
    for (size_t i = 0; ok && i < count; i++) child->file_fd[i] = -1;
    for (size_t i = 0; ok && i < count; i++)
        ok = (child->file_fd[i] = above(child->request, child->request->file_fd[i])) >= 0;
    return ok;
}

static void close_if_open(int fd) {
    if (fd >= 0) close(fd);
}

struct pair {
    pid_t keeper, worker; /* -1: could not be forked, or wasn't */
};

/* The init of a job's processes.  It holds a copy of the service's memory, which is closed to them. */
__attribute__((noreturn)) static void keep(int life_fd) {
    char byte;
    prctl(PR_SET_DUMPABLE, 0);
    dup2(life_fd, STDIN_FILENO);
    syscall(SYS_close_range, STDIN_FILENO + 1, ~0U, 0);
    while (read(STDIN_FILENO, &byte, 1) < 0 && errno == EINTR) continue;
    _exit(0);
}

/* fork, of a child of our parent's; *pid is the child's id before that begins, however we end. */
static bool fork_sibling(pid_t *pid) {
    return syscall(SYS_clone, CLONE_PARENT | CLONE_PARENT_SETTID | SIGCHLD, 0, pid, 0, 0) == 0;
}

__attribute__((noreturn)) static void fork_pair(const struct child *child, int life_fd, struct pair *pair) {
    if (!confine_enter_namespaces(child->request->confinement)) _exit(CANNOT_CONFINE);
    if (fork_sibling(&pair->keeper)) keep(life_fd);
    fault_at("keeper-forked");
    if (pair->keeper > 0 && fork_sibling(&pair->worker)) become_worker(child);
    fault_at("worker-forked");
    _exit(0);
}

static pid_t wait_for(pid_t pid) {
    pid_t ended;
    while ((ended = waitpid(pid, NULL, 0)) < 0 && errno == EINTR) continue;
    return ended;
}

static void end_keeper(struct spawned *spawned) {
    close_if_open(spawned->keeper_fd);
    if (spawned->keeper > 0) wait_for(spawned->keeper);
    spawned->keeper_fd = -1;
    spawned->keeper = -1;
}

static struct pair *new_pair(void) {
    struct pair *pair = mmap(NULL, sizeof *pair, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (pair == MAP_FAILED) return NULL;
    *pair = (struct pair){-1, -1};
    return pair;
}

/* Both, by the third process; -1 with errno when they can't be had. */
static pid_t fork_with_keeper(struct child *child, struct spawned *spawned) {
    int life[2] = {-1, -1}, reason = 0;
    pid_t worker = -1;
    struct pair *pair = new_pair();
    child->parent = 0; /* is in no namespace of theirs */
    if (!pair || pipe2(life, O_CLOEXEC) != 0) {
        reason = errno;
    } else {
        pid_t pid = fork();
        if (pid == 0) fork_pair(child, life[0], pair);
        reason = pid < 0 ? errno : EAGAIN;
        if (pid > 0) wait_for(pid);
        spawned->keeper = pair->keeper;
        worker = pair->worker;
    }
    spawned->keeper_fd = life[1];
    close_if_open(life[0]);
    if (worker < 0) end_keeper(spawned);
    if (pair) munmap(pair, sizeof *pair);
    errno = reason;
    return worker;
}

static enum status fork_child(struct child *child, struct spawned *spawned, struct error *error) {
    bool kept = confine_has_own_pids(child->request->confinement);
    spawned->keeper = spawned->keeper_fd = -1;
    pid_t pid = kept ? fork_with_keeper(child, spawned) : fork();
    if (pid < 0) return error_set(error, STATUS_IO, "worker", "can't fork: %s", strerror(errno));
    if (pid == 0) become_worker(child);
    setpgid(pid, pid); /* whichever of the two comes first */
    spawned->pid = pid;
    spawned->pid_fd = (int)syscall(SYS_pidfd_open, pid, 0);
    if (spawned->pid_fd >= 0) return STATUS_OK;
    error_set(error, STATUS_IO, "worker", "can't watch the process: %s", strerror(errno));
    kill(-pid, SIGKILL);
    waitpid(pid, NULL, 0);
    end_keeper(spawned);
    return STATUS_IO;
}

void spawn_done(struct spawned *spawned) {
    close(spawned->pid_fd);
    close(spawned->progress_fd);
    end_keeper(spawned);
}

enum status spawn_worker(const struct spawn_request *request, struct spawned *spawned, struct error *error) {
    int ends[2] = {-1, -1};
    struct child child = {.request = request, .input_fd = -1, .log_fd = -1, .progress_fd = -1, .parent = getpid()};
    enum status status = STATUS_IO;
    child.input_fd = above(request, request->input_fd);
    child.log_fd = above(request, request->log_fd);
    if (pipe2(ends, O_CLOEXEC) == 0) child.progress_fd = above(request, ends[1]);
    if (child.input_fd < 0 || child.log_fd < 0 || child.progress_fd < 0)
        error_set(error, status, "worker", "no descriptors: %s", strerror(errno));
    else if (!lift_files(&child))
        error_set(error, status, "worker", "no descriptors for %zu files: %s", request->file_count, strerror(errno));
    else if (!make_arguments(&child, request))
        status = error_set(error, STATUS_NO_MEMORY, "worker", "no memory");
    else
        status = fork_child(&child, spawned, error);
    const int mine[] = {child.input_fd, child.log_fd, child.progress_fd, ends[1]};
    for (size_t i = 0; i < sizeof mine / sizeof *mine; i++) close_if_open(mine[i]);
    for (size_t i = 0; child.file_fd && i < request->file_count; i++) close_if_open(child.file_fd[i]);
    free(child.file_fd);
    for (size_t i = 0; child.argv[i]; i++) free(child.argv[i]);
    if (status == STATUS_OK) {
        fcntl(ends[0], F_SETFL, O_NONBLOCK);
        spawned->progress_fd = ends[0];
    } else {
        close_if_open(ends[0]);
    }
    return status;
}
