/* pidfd_open for valgrind 3.19, which doesn't know it: preloaded, syscall() answers with an eventfd that becomes
 * readable when the process has ended.  valgrind.py compiles it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <dlfcn.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdlib.h>
#include <sys/eventfd.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

struct watch {
    pid_t pid;
    int fd; /* its own, so that the caller may close the other one at any time */
};

static void *await(void *ctx) {
    struct watch *watch = ctx;
    siginfo_t info;
    waitid(P_PID, (id_t)watch->pid, &info, WEXITED | WNOWAIT);
    eventfd_write(watch->fd, 1);
    close(watch->fd);
    free(watch);
    return NULL;
}

static long open_watch(pid_t pid) {
    pthread_t thread;
    int fd = eventfd(0, EFD_CLOEXEC);
    struct watch *watch = malloc(sizeof *watch);
    if (fd < 0 || !watch) abort();
    *watch = (struct watch){pid, dup(fd)};
    if (pthread_create(&thread, NULL, await, watch) != 0) abort();
    pthread_detach(thread);
    return fd;
}

long syscall(long number, ...) {
    long a[6];
    va_list args;
    va_start(args, number);
    for (int i = 0; i < 6; i++) a[i] = va_arg(args, long);
    va_end(args);
    if (number == SYS_pidfd_open) return open_watch((pid_t)a[0]);
    long (*next)(long, ...) = (long (*)(long, ...))dlsym(RTLD_NEXT, "syscall");
    return next(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}
