/* Preloaded into the service: notes which thread makes the calls that may take long, and which one signals processes,
 * as lines "call thread process" in the file WATCHED_CALLS.  recv stands for a thread that serves connections.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <dlfcn.h>
#include <fcntl.h>
#include <netdb.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static void note(const char *call, pid_t about) {
    static int fd = -1;
    char line[96];
    if (fd < 0) {
        const char *path = getenv("WATCHED_CALLS");
        fd = path ? open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600) : -1;
    }
    int n = snprintf(line, sizeof line, "%s %d %d\n", call, gettid(), about < 0 ? -about : about);
    if (fd >= 0 && write(fd, line, (size_t)n) != n) abort();
}

#define NEXT(type, name, ...) ((type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name))

int fsync(int fd) {
    note("fsync", 0);
    return NEXT(int, "fsync", int)(fd);
}

int fdatasync(int fd) {
    note("fdatasync", 0);
    return NEXT(int, "fdatasync", int)(fd);
}

int sqlite3_step(void *statement) {
    note("sqlite3_step", 0);
    return NEXT(int, "sqlite3_step", void *)(statement);
}

int sqlite3_exec(void *db, const char *text, void *row, void *ctx, char **error) {
    note("sqlite3_exec", 0);
    return NEXT(int, "sqlite3_exec", void *, const char *, void *, void *, char **)(db, text, row, ctx, error);
}

int rename(const char *from, const char *to) {
    note("rename", 0);
    return NEXT(int, "rename", const char *, const char *)(from, to);
}

int renameat(int from_fd, const char *from, int to_fd, const char *to) {
    note("renameat", 0);
    return NEXT(int, "renameat", int, const char *, int, const char *)(from_fd, from, to_fd, to);
}

int nanosleep(const struct timespec *length, struct timespec *left) {
    note("nanosleep", 0);
    return NEXT(int, "nanosleep", const struct timespec *, struct timespec *)(length, left);
}

int pthread_join(pthread_t thread, void **result) {
    note("pthread_join", 0);
    return NEXT(int, "pthread_join", pthread_t, void **)(thread, result);
}

int pthread_cond_wait(pthread_cond_t *changed, pthread_mutex_t *lock) {
    note("pthread_cond_wait", 0);
    return NEXT(int, "pthread_cond_wait", pthread_cond_t *, pthread_mutex_t *)(changed, lock);
}

int pthread_cond_clockwait(pthread_cond_t *changed, pthread_mutex_t *lock, clockid_t clock,
                           const struct timespec *end) {
    note("pthread_cond_clockwait", 0);
    return NEXT(int, "pthread_cond_clockwait", pthread_cond_t *, pthread_mutex_t *, clockid_t,
                const struct timespec *)(changed, lock, clock, end);
}

int getaddrinfo(const char *host, const char *port, const struct addrinfo *hints, struct addrinfo **found) {
    note("getaddrinfo", 0);
    return NEXT(int, "getaddrinfo", const char *, const char *, const struct addrinfo *,
                struct addrinfo **)(host, port, hints, found);
}

pid_t fork(void) {
    note("fork", 0);
    return NEXT(pid_t, "fork", void)();
}

pid_t waitpid(pid_t pid, int *status, int options) {
    note("waitpid", 0);
    return NEXT(pid_t, "waitpid", pid_t, int *, int)(pid, status, options);
}

/* Noted when it is over: from then on the id may be another's. */
pid_t wait4(pid_t pid, int *status, int options, struct rusage *usage) {
    pid_t ended = NEXT(pid_t, "wait4", pid_t, int *, int, struct rusage *)(pid, status, options, usage);
    note("wait4", ended);
    return ended;
}

int kill(pid_t pid, int number) {
    note("kill", pid);
    return NEXT(int, "kill", pid_t, int)(pid, number);
}

ssize_t recv(int fd, void *bytes, size_t count, int flags) {
    note("recv", 0);
    return NEXT(ssize_t, "recv", int, void *, size_t, int)(fd, bytes, count, flags);
}
