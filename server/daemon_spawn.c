/* Starting whittle: everything that needs memory or locks is done before fork, in the child only system calls.
 *
 * The child has no descriptor but 0 (its input), 1 and 2 (its log), 3 (what it says), and a process group of its own;
 * daemon_confine.c does the rest.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/daemon_spawn.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MAX_ARGUMENTS = 96, VALUE_BYTES = 512, PROGRESS_FD = 3, CANNOT_CONFINE = 126, CANNOT_EXEC = 127 };

struct child {
    const struct spawn_request *request;
    char *argv[MAX_ARGUMENTS];
    int input_fd, log_fd, progress_fd;
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
    bool ok = add(child, &count, "whittle") && add(child, &count, "-");
    for (size_t i = 0; ok && i < rows; i++) ok = add_parameter(child, &count, &params, &table[i]);
    return ok && add(child, &count, "-o") && add(child, &count, request->output) &&
           add(child, &count, "--progress-fd") && add(child, &count, "3") && add(child, &count, "--quiet");
}

static void free_arguments(struct child *child) {
    for (size_t i = 0; child->argv[i]; i++) free(child->argv[i]);
}

/* ------------------------------------------------------------------------------------------------ the child */

static void reset_signals(void) {
    sigset_t none;
    sigemptyset(&none);
    signal(SIGPIPE, SIG_DFL);
    sigprocmask(SIG_SETMASK, &none, NULL);
}

/* The descriptors given are all over PROGRESS_FD, so that none is overwritten before it is copied. */
static void place_descriptors(const struct child *child) {
    dup2(child->input_fd, STDIN_FILENO);
    dup2(child->log_fd, STDOUT_FILENO);
    dup2(child->log_fd, STDERR_FILENO);
    dup2(child->progress_fd, PROGRESS_FD);
    syscall(SYS_close_range, PROGRESS_FD + 1, ~0U, 0);
}

__attribute__((noreturn)) static void become_worker(const struct child *child) {
    const struct spawn_request *request = child->request;
    setpgid(0, 0);
    place_descriptors(child);
    reset_signals();
    if (!confine_this_process(request->confinement, &request->limits, request->output)) _exit(CANNOT_CONFINE);
    if (getppid() != child->parent) _exit(CANNOT_CONFINE);
    confine_execute(request->confinement, child->argv);
    _exit(CANNOT_EXEC);
}

/* ------------------------------------------------------------------------------------------------ the parent */

static int above_progress_fd(int fd) { return fcntl(fd, F_DUPFD_CLOEXEC, PROGRESS_FD + 1); }

static void close_if_open(int fd) {
    if (fd >= 0) close(fd);
}

static enum status fork_child(const struct child *child, struct spawned *spawned, struct error *error) {
    pid_t pid = fork();
    if (pid < 0) return error_set(error, STATUS_IO, "worker", "can't fork: %s", strerror(errno));
    if (pid == 0) become_worker(child);
    setpgid(pid, pid); /* whichever of the two comes first */
    spawned->pid = pid;
    spawned->pid_fd = (int)syscall(SYS_pidfd_open, pid, 0);
    if (spawned->pid_fd >= 0) return STATUS_OK;
    kill(-pid, SIGKILL);
    waitpid(pid, NULL, 0);
    return error_set(error, STATUS_IO, "worker", "can't watch the process: %s", strerror(errno));
}

enum status spawn_worker(const struct spawn_request *request, struct spawned *spawned, struct error *error) {
    int ends[2] = {-1, -1};
    struct child child = {.request = request, .input_fd = -1, .log_fd = -1, .progress_fd = -1, .parent = getpid()};
    enum status status = STATUS_IO;
    child.input_fd = above_progress_fd(request->input_fd);
    child.log_fd = above_progress_fd(request->log_fd);
    if (pipe2(ends, O_CLOEXEC) == 0) child.progress_fd = above_progress_fd(ends[1]);
    if (child.input_fd < 0 || child.log_fd < 0 || child.progress_fd < 0)
        error_set(error, status, "worker", "no descriptors: %s", strerror(errno));
    else if (!make_arguments(&child, request))
        status = error_set(error, STATUS_NO_MEMORY, "worker", "no memory");
    else
        status = fork_child(&child, spawned, error);
    const int mine[] = {child.input_fd, child.log_fd, child.progress_fd, ends[1]};
    for (size_t i = 0; i < sizeof mine / sizeof *mine; i++) close_if_open(mine[i]);
    free_arguments(&child);
    if (status == STATUS_OK) {
        fcntl(ends[0], F_SETFL, O_NONBLOCK);
        spawned->progress_fd = ends[0];
    } else {
        close_if_open(ends[0]);
    }
    return status;
}
