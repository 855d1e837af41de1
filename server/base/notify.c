/* The service manager's protocols, spoken by hand.
 *
 * libsystemd would do it, but brings lz4, lzma, zstd, gcrypt and libcap into a process that faces the network, for
 * three protocols of one environment variable each: a datagram to a socket, a period, a range of descriptors that
 * starts at 3.
 *
 * The watchdog is fed from a thread of its own, not from the main loop: that one sweeps, and deleting a large job is no
 * reason to be ended.  What the thread calls is a question to those who do the work, so it hangs when they hang.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "server/base/deadline.h"
#include "server/base/log.h"
#include "server/base/notify.h"

enum { FIRST_FD = 3, MAX_INHERITED = 64, CHECKS_IN_PERIOD = 4 };

/* A number from the environment; fallback where there is none. */
static long long number_of(const char *name, long long fallback) {
    const char *text = getenv(name);
    char *end;
    if (!text || text[0] < '0' || text[0] > '9') return fallback;
    errno = 0;
    long long value = strtoll(text, &end, 10);
    return errno || *end ? fallback : value;
}

/* ------------------------------------------------------------------------------------------------ messages */

/* A leading @ stands for the NUL of an abstract name. */
static bool address_of(const char *name, struct sockaddr_un *address, socklen_t *length) {
    size_t bytes = strlen(name);
    if ((name[0] != '/' && name[0] != '@') || bytes >= sizeof address->sun_path) return false;
    *address = (struct sockaddr_un){.sun_family = AF_UNIX};
    memcpy(address->sun_path, name, bytes);
    if (name[0] == '@') address->sun_path[0] = 0;
    *length = (socklen_t)(offsetof(struct sockaddr_un, sun_path) + bytes);
    return true;
}

void notify_send(const char *message) {
    const char *name = getenv("NOTIFY_SOCKET");
    struct sockaddr_un address;
    socklen_t length;
    if (!name || !name[0]) return;
    errno = EINVAL;
    int fd = address_of(name, &address, &length) ? socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0) : -1;
    size_t bytes = strlen(message);
    if (fd < 0 || sendto(fd, message, bytes, MSG_NOSIGNAL, (struct sockaddr *)&address, length) != (ssize_t)bytes)
        log_line(LOG_WARNING, "the service manager at %.108s can't be told: %s", name, strerror(errno));
    if (fd >= 0) close(fd);
}

/* ------------------------------------------------------------------------------------------------ watchdog */

struct notify_watch {
    bool (*answers)(void *ctx);
    void *ctx;
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t ending;
    bool ended;
    int64_t pause_ms;
};

/* Waits for the pause to pass; false when the watch ends. */
static bool pause_for(struct notify_watch *watch) {
    struct timespec until = deadline_in_ms(watch->pause_ms);
    pthread_mutex_lock(&watch->lock);
    while (!watch->ended && deadline_wait(&until, &watch->ending, &watch->lock)) continue;
    bool go_on = !watch->ended;
    pthread_mutex_unlock(&watch->lock);
    return go_on;
}

static void *feed(void *ctx) {
    struct notify_watch *watch = ctx;
    unsigned failures = 0;
    do {
        if (watch->answers(watch->ctx)) {
            failures = 0;
            notify_send("WATCHDOG=1");
        } else if (++failures == 2) {
            log_line(LOG_ERROR, "the service doesn't answer: its watchdog isn't fed");
        }
    } while (pause_for(watch));
    return NULL;
}

enum status notify_watch(bool (*answers)(void *ctx), void *ctx, struct notify_watch **watch, struct error *error) {
    long long period_us = number_of("WATCHDOG_USEC", 0);
    *watch = NULL;
    if (period_us <= 0 || number_of("WATCHDOG_PID", getpid()) != getpid()) return STATUS_OK;
    struct notify_watch *made = calloc(1, sizeof *made);
    if (!made) return error_set(error, STATUS_NO_MEMORY, "watchdog", "no memory");
    made->answers = answers;
    made->ctx = ctx;
    made->pause_ms = period_us / CHECKS_IN_PERIOD / 1000;
    pthread_mutex_init(&made->lock, NULL);
    pthread_cond_init(&made->ending, NULL);
    if (pthread_create(&made->thread, NULL, feed, made) == 0) {
        *watch = made;
        return STATUS_OK;
    }
    pthread_cond_destroy(&made->ending);
    pthread_mutex_destroy(&made->lock);
    free(made);
    return error_set(error, STATUS_NO_MEMORY, "watchdog", "can't start its thread");
}

void notify_unwatch(struct notify_watch *watch) {
    if (!watch) return;
    pthread_mutex_lock(&watch->lock);
    watch->ended = true;
    pthread_cond_signal(&watch->ending);
    pthread_mutex_unlock(&watch->lock);
    pthread_join(watch->thread, NULL);
    pthread_cond_destroy(&watch->ending);
    pthread_mutex_destroy(&watch->lock);
    free(watch);
}

/* ------------------------------------------------------------------------------------------------ descriptors */

/* The index of name in a:b:c; -1 where it isn't there. */
static int index_of(const char *names, const char *name) {
    for (int i = 0;; i++) {
        size_t length = strcspn(names, ":");
        if (length == strlen(name) && memcmp(names, name, length) == 0) return i;
        if (!names[length]) return -1;
        names += length + 1;
    }
}

static bool has_no_name(const char *names) {
    static const char *const defaults[] = {"", "unknown", "whittled.socket"};
    for (size_t i = 0; i < sizeof defaults / sizeof *defaults; i++)
        if (!names || strcmp(names, defaults[i]) == 0) return true;
    return false;
}

int notify_inherited(const char *name) {
    const char *names = getenv("LISTEN_FDNAMES");
    long long count = number_of("LISTEN_FDS", 0);
    if (count < 1 || count > MAX_INHERITED || number_of("LISTEN_PID", 0) != getpid()) return -1;
    int i = names ? index_of(names, name) : -1;
    if (i < 0 && count == 1 && strcmp(name, NOTIFY_MAIN_SOCKET) == 0 && has_no_name(names)) i = 0;
    if (i < 0 || i >= count) return -1;
    int fd = FIRST_FD + i;
    return fcntl(fd, F_SETFD, FD_CLOEXEC) == 0 ? fd : -1;
}
