/* The signals' thread: it reads signalfd, adds what each signal asks for to a set, and makes a descriptor readable for
 * whoever waits.
 *
 * It calls nothing that could wait for another thread, so that the second SIGTERM is always heard.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/daemon/signals.h"

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <unistd.h>

struct signals {
    int from_kernel, told, ending; /* signalfd; eventfds for signals_wait and for the thread's end */
    _Atomic unsigned requests;
    pthread_t thread;
};

static void raise_event(int fd) {
    const uint64_t one = 1;
    ssize_t n = write(fd, &one, sizeof one);
    (void)n; /* fails only where it is readable anyway */
}

__attribute__((noreturn)) static void end_at_once(void) {
    static const char words[] = "second signal: ending at once\n";
    ssize_t n = write(STDERR_FILENO, words, sizeof words - 1);
    (void)n;
    _exit(128 + SIGTERM);
}

static void *listen_to_signals(void *ctx) {
    struct signals *signals = ctx;
    struct pollfd fds[] = {{.fd = signals->from_kernel, .events = POLLIN}, {.fd = signals->ending, .events = POLLIN}};
    bool stops = false;
    for (;;) {
        struct signalfd_siginfo info;
        if (poll(fds, 2, -1) < 0 || fds[1].revents) {
            if (fds[1].revents) return NULL;
            continue;
        }
        if (read(signals->from_kernel, &info, sizeof info) != sizeof info) continue;
        bool reload = info.ssi_signo == SIGHUP;
        if (!reload && stops) end_at_once();
        stops = stops || !reload;
        atomic_fetch_or(&signals->requests, reload ? SIGNALS_RELOAD : SIGNALS_STOP);
        raise_event(signals->told);
    }
}

static void free_signals(struct signals *signals) {
    const int fds[] = {signals->from_kernel, signals->told, signals->ending};
    for (size_t i = 0; i < sizeof fds / sizeof *fds; i++)
        if (fds[i] >= 0) close(fds[i]);
    free(signals);
}

enum status signals_open(struct signals **signals, struct error *error) {
    struct signals *opened = calloc(1, sizeof *opened);
    sigset_t set;
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "signals", "no memory");
    sigemptyset(&set);
    sigaddset(&set, SIGTERM);
    sigaddset(&set, SIGINT);
    sigaddset(&set, SIGHUP);
    pthread_sigmask(SIG_BLOCK, &set, NULL);
    signal(SIGPIPE, SIG_IGN);
    opened->from_kernel = signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK);
    opened->told = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    opened->ending = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (opened->from_kernel >= 0 && opened->told >= 0 && opened->ending >= 0 &&
        pthread_create(&opened->thread, NULL, listen_to_signals, opened) == 0) {
        *signals = opened;
        return STATUS_OK;
    }
    error_set(error, STATUS_IO, "signals", "can't listen to signals: %s", strerror(errno));
    free_signals(opened);
    return STATUS_IO;
}

void signals_close(struct signals *signals) {
    if (!signals) return;
    raise_event(signals->ending);
    pthread_join(signals->thread, NULL);
    free_signals(signals);
}

unsigned signals_wait(struct signals *signals, int timeout_ms) {
    struct pollfd told = {.fd = signals->told, .events = POLLIN};
    uint64_t count;
    if (poll(&told, 1, timeout_ms) != 1 || read(signals->told, &count, sizeof count) != sizeof count) return 0;
    return atomic_exchange(&signals->requests, 0);
}
