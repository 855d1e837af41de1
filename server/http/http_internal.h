/* What http.c is made of, and nobody else takes: what a head decides, limits on connections, the socket.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_HTTP_INTERNAL_H
#define WHITTLE_SERVER_HTTP_HTTP_INTERNAL_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>

#include "core/base/status.h"
#include "server/http/handler.h"
#include "server/http/request.h"
#include "server/jobs/config.h"
#include "server/jobs/metrics.h"
#include "server/jobs/service.h"

/* ------------------------------------------------------------------------------------------------ cross_site.c */

/* What web pages may do with the service: the checks are explained on top of the file. */

/* Whether the request, which has been matched, names one of our hosts; false: the response (421) is there. */
bool cross_site_admit_host(const struct config *config, const struct request *request, struct response *response);

/* Whether no foreign page sends the request; false: the response (403) is there. */
bool cross_site_admit_origin(const struct config *config, const struct request *request, struct response *response);

/* Answers a browser that asks what a page of --cors-origins may send to a path of ours; false: nothing is asked. */
bool cross_site_preflight(const struct config *config, const struct request *request, struct response *response);

/* Lets a page of --cors-origins read the response. */
void cross_site_share(const struct config *config, const struct request *request, struct response *response);

/* ------------------------------------------------------------------------------------------------ precheck.c */

/* What a request's head decides, before its body: whether it can be understood, which operation it is, and whether that
 * wants the body. */

/* The path of a target in absolute form, "http://host/path"; else the target itself.  Borrows. */
const char *head_path(const char *target);

/* Whether a target in absolute form is of the host that the Host header names (NULL: there is none). */
bool head_is_of(const char *target, const char *host);

/* Whether the head, of so many bytes, is within limits and says one thing; version as in "HTTP/1.1".  false: the
 * response says why not, and where the next request begins is uncertain. */
bool head_check(const struct config *config, const struct request *request, const char *version, uint64_t bytes,
                struct response *response);

/* Finds the operation (admin: of those that the admin listener serves), and asks it whether it wants the body.  NULL:
 * the response says why not. */
const struct handler *head_admit(struct service *service, const struct handlers *handlers, struct request *request,
                                 bool admin, struct response *response);

/* ------------------------------------------------------------------------------------------------ in_flight.c */

/* How many exchanges there are, how many of them are parked, how many bring a body; and waiting for their end.  All
 * functions may be called from any thread. */

struct tally {
    pthread_mutex_t lock;
    pthread_cond_t fewer;
    unsigned parked, exchanges, uploads;
    bool stopping;
};

void tally_init(struct tally *tally);
void tally_done(struct tally *tally);

/* An exchange begins, or ends. */
void tally_begin(struct tally *tally);
void tally_end(struct tally *tally);

/* An exchange is about to be suspended; false: nothing may be any more.  Or it is resumed. */
bool tally_park(struct tally *tally);
void tally_unpark(struct tally *tally);

/* A body begins to come, or has come. */
void tally_upload(struct tally *tally, bool begins);
unsigned tally_uploads(struct tally *tally);

/* Lets nothing park any more; waits until nothing is parked and, for so long at most, until all exchanges have ended.
 */
void tally_stop(struct tally *tally, int patience_s);

/* ------------------------------------------------------------------------------------------------ watchdog.c */

/* Cuts off connections that are too slow: no headers in time, silence between requests, bodies that trickle, and bodies
 * whose rest can't come any more because the client has closed its half of the connection.
 *
 * libmicrohttpd's own timeout starts again with every byte, so it is no defence against a client that sends one byte a
 * minute. */

struct watchdog;
struct watched; /* one connection */

/* A body may be slower than min_bytes_per_s (0 = no rate) for grace_ms, at its beginning or later.  While three
 * quarters of so many connections are there, none of the times is longer than WATCHDOG_PRESSED_MS: who sends nothing
 * leaves his place to others. */
struct watchdog_limits {
    int64_t header_ms, idle_ms, min_bytes_per_s, grace_ms;
    int64_t connections;
    bool secure; /* TLS: nothing can be told */
};

enum { WATCHDOG_PRESSED_MS = 2000 };

enum watchdog_phase {
    WATCHDOG_HEADERS, /* connected, nothing complete yet */
    WATCHDOG_BODY,    /* headers are here, the body isn't */
    WATCHDOG_BUSY,    /* it is our turn */
    WATCHDOG_IDLE     /* between two requests */
};

/* metrics is borrowed. */
enum status watchdog_open(struct watchdog_limits limits, struct metrics *metrics,
                          struct watchdog **watchdog) MUST_CHECK;

/* After the last connection was removed.  Accepts NULL. */
void watchdog_close(struct watchdog *watchdog);

/* Shuts all connections down, and waits a second at most until libmicrohttpd has closed them; NULL: does nothing. */
void watchdog_end_all(struct watchdog *watchdog);

/* Watches a socket from its first to its last moment; NULL when memory runs out, which the others accept. */
struct watched *watchdog_add(struct watchdog *watchdog, int fd);
void watchdog_remove(struct watchdog *watchdog, struct watched *watched);

/* From any thread. */
void watchdog_enter(struct watched *watched, enum watchdog_phase phase);
void watchdog_count(struct watched *watched, size_t bytes);

/* ------------------------------------------------------------------------------------------------ acceptor.c */

/* Takes connections from a listening socket and hands them over, so many at a time; the others wait in the kernel's
 * queue. */

struct acceptor;

/* Begins to take connections of a socket that doesn't block, and is borrowed.  take is called on the acceptor's thread:
 * it owns the connection's descriptor from then on; true: acceptor_started and acceptor_left will be called for it,
 * false: it is closed.  *acceptor is set before the first call.  STATUS_NO_MEMORY without a thread or descriptor. */
enum status acceptor_open(int fd, unsigned most,
                          bool (*take)(void *ctx, int fd, const struct sockaddr *address, socklen_t bytes), void *ctx,
                          struct acceptor **acceptor) MUST_CHECK;

/* A connection that was handed over has begun; it has ended, and another may take its place.  From any thread. */
void acceptor_started(struct acceptor *acceptor);
void acceptor_left(struct acceptor *acceptor);

/* Takes no more; waits until all that were handed over have begun, for so long at most.  Accepts NULL. */
void acceptor_stop(struct acceptor *acceptor, int patience_s);

/* After acceptor_stop and the last connection's end.  Accepts NULL. */
void acceptor_free(struct acceptor *acceptor);

/* ------------------------------------------------------------------------------------------------ listen.c */

/* The socket that the service listens on. */

/* Opens a listening socket on "HOST:PORT" ("[::1]:8080" for IPv6; port 0 takes a free one).  STATUS_BAD_PARAMETER when
 * the address is malformed or unknown, or not loopback and open is false; STATUS_IO when it is taken.  setting is where
 * an error says that it is.  *fd is the caller's. */
enum status listen_open(const char *setting, const char *address, bool open, int *fd, struct error *error) MUST_CHECK;

/* The same as far as it goes without a socket. */
enum status listen_check(const char *setting, const char *address, bool open, struct error *error) MUST_CHECK;

/* Takes over a listening socket that was inherited, instead of opening one.  STATUS_BAD_PARAMETER when it isn't a
 * listening TCP socket, or not on loopback and open is false.  *fd is the caller's, and is inherited itself. */
enum status listen_adopt(int inherited, bool open, int *fd, struct error *error) MUST_CHECK;

/* "HOST:PORT" of a listening socket. */
enum { LISTEN_NAME_BYTES = 128 };
void listen_name(int fd, char name[LISTEN_NAME_BYTES]);

/* The host of a client's address, without its port. */
void listen_peer(const struct sockaddr *address, char host[LISTEN_NAME_BYTES]);

#endif
