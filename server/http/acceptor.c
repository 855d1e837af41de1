/* Takes connections from a listening socket, on a thread of its own, and hands them over.
 *
 * libmicrohttpd could do that, but 0.9.75 can't be told to take no more while it works: its thread and the one that
 * tells it both remove the socket from a set, and whoever comes second ends the process (DECISIONS.md).
 *
 * What there is no room for waits in the kernel's queue, and is taken when another connection has left.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/http_internal.h"

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/base/deadline.h"
#include "server/base/log.h"

/* Without a descriptor or memory it is tried again after so long: what is lacking may be anybody's. */
enum { RETRY_MS = 100 };

struct acceptor {
    int fd;
    unsigned most;
    bool (*take)(void *ctx, int fd, const struct sockaddr *address, socklen_t bytes);
    void *ctx;
    int bell; /* rung when a connection leaves and the thread may be waiting for that, and at the end */
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t all_started; /* all below: under the lock */
    unsigned held, starting;    /* connections; those of them that were handed over and haven't begun */
    bool wants_room;            /* the next that leaves rings */
    bool ending;
};

static void ring(struct acceptor *acceptor) {
    uint64_t one = 1;
    (void)!write(acceptor->bell, &one, sizeof one);
}

/* Whether another connection may be taken. */
static bool has_room(struct acceptor *acceptor) {
    pthread_mutex_lock(&acceptor->lock);
    bool room = acceptor->held < acceptor->most;
    acceptor->wants_room = !room;
    pthread_mutex_unlock(&acceptor->lock);
    return room;
}

static void deliver(struct acceptor *acceptor, int fd, const struct sockaddr *address, socklen_t bytes) {
    pthread_mutex_lock(&acceptor->lock);
    acceptor->held++;
    acceptor->starting++;
    pthread_mutex_unlock(&acceptor->lock);
    if (acceptor->take(acceptor->ctx, fd, address, bytes)) return;
    acceptor_started(acceptor);
    acceptor_left(acceptor);
}

/* Whether accept failed for the client's sake: it has gone, or its network has. */
static bool is_of_client(int error) {
    static const int of_client[] = {EINTR,     ECONNABORTED, EPROTO,       ENOPROTOOPT, ENETDOWN,
                                    EHOSTDOWN, ENONET,       EHOSTUNREACH, EOPNOTSUPP,  ENETUNREACH};
    for (size_t i = 0; i < sizeof of_client / sizeof *of_client; i++)
        if (error == of_client[i]) return true;
    return false;
}

/* Takes what is there and has room; false: something is lacking. */
static bool take_all(struct acceptor *acceptor) {
    while (has_room(acceptor)) {
        struct sockaddr_storage address = {0};
        socklen_t bytes = sizeof address;
        int fd = accept4(acceptor->fd, (struct sockaddr *)&address, &bytes, SOCK_CLOEXEC | SOCK_NONBLOCK);
        if (fd >= 0) {
            deliver(acceptor, fd, (const struct sockaddr *)&address, bytes);
        } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
            return true;
        } else if (!is_of_client(errno)) {
            log_line_seldom(LOG_WARNING, "can't take a connection: %s", strerror(errno));
            return false;
        }
    }
    return true;
}

static bool is_ending(struct acceptor *acceptor) {
    pthread_mutex_lock(&acceptor->lock);
    bool ending = acceptor->ending;
    pthread_mutex_unlock(&acceptor->lock);
    return ending;
}

/* Waits for the bell and, if there is room, for clients; a timeout in ms, or -1. */
static void wait_for_any(struct acceptor *acceptor, bool room, int timeout_ms) {
    struct pollfd waited[] = {{.fd = acceptor->bell, .events = POLLIN}, {.fd = acceptor->fd, .events = POLLIN}};
    uint64_t rung;
    if (poll(waited, room ? 2 : 1, timeout_ms) > 0 && (waited[0].revents & POLLIN))
        (void)!read(acceptor->bell, &rung, sizeof rung);
}

static void *run_acceptor(void *ctx) {
    struct acceptor *acceptor = ctx;
    while (!is_ending(acceptor)) {
        if (take_all(acceptor))
            wait_for_any(acceptor, has_room(acceptor), -1);
        else
            wait_for_any(acceptor, false, RETRY_MS);
    }
    return NULL;
}

enum status acceptor_open(int fd, unsigned most,
                          bool (*take)(void *ctx, int fd, const struct sockaddr *address, socklen_t bytes), void *ctx,
                          struct acceptor **acceptor) {
    struct acceptor *opened = calloc(1, sizeof *opened);
    if (!opened) return STATUS_NO_MEMORY;
    *opened = (struct acceptor){.fd = fd, .most = most, .take = take, .ctx = ctx};
    opened->bell = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->all_started, NULL);
    *acceptor = opened; /* before the thread, whose connections ask for it */
    if (opened->bell >= 0 && pthread_create(&opened->thread, NULL, run_acceptor, opened) == 0) return STATUS_OK;
    *acceptor = NULL;
    if (opened->bell >= 0) close(opened->bell);
    pthread_cond_destroy(&opened->all_started);
    pthread_mutex_destroy(&opened->lock);
    free(opened);
    return STATUS_NO_MEMORY;
}

void acceptor_started(struct acceptor *acceptor) {
    pthread_mutex_lock(&acceptor->lock);
    if (--acceptor->starting == 0) pthread_cond_signal(&acceptor->all_started);
    pthread_mutex_unlock(&acceptor->lock);
}

void acceptor_left(struct acceptor *acceptor) {
    pthread_mutex_lock(&acceptor->lock);
    acceptor->held--;
    bool wanted = acceptor->wants_room;
    acceptor->wants_room = false;
    pthread_mutex_unlock(&acceptor->lock);
    if (wanted) ring(acceptor);
}

void acceptor_stop(struct acceptor *acceptor, int patience_s) {
    if (!acceptor) return;
    struct timespec until = deadline_in_ms(patience_s * 1000LL);
    pthread_mutex_lock(&acceptor->lock);
    acceptor->ending = true;
    pthread_mutex_unlock(&acceptor->lock);
    ring(acceptor);
    pthread_join(acceptor->thread, NULL);
    pthread_mutex_lock(&acceptor->lock);
    while (acceptor->starting && deadline_wait(&until, &acceptor->all_started, &acceptor->lock)) continue;
    pthread_mutex_unlock(&acceptor->lock);
}

void acceptor_free(struct acceptor *acceptor) {
    if (!acceptor) return;
    close(acceptor->bell);
    pthread_cond_destroy(&acceptor->all_started);
    pthread_mutex_destroy(&acceptor->lock);
    free(acceptor);
}
