/* Cuts off connections that are too slow: no headers in time, silence between requests, bodies that trickle, and bodies
 * whose rest can't come any more because the client has closed its half of the connection.
 *
 * libmicrohttpd's own timeout starts again with every byte, so it is no defence against a client that sends one byte a
 * minute.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_WATCHDOG_H
#define WHITTLE_SERVER_HTTP_WATCHDOG_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "server/daemon/metrics.h"

struct watchdog;
struct watched; /* one connection */

/* A body may be slower than min_bytes_per_s (0 = no rate) for grace_ms, at its beginning or later.  While three
 * quarters of so many connections are there, none of the times is longer than WATCHDOG_PRESSED_MS: who sends nothing
 * leaves his place to others. */
struct watchdog_limits {
    int64_t header_ms, idle_ms, min_bytes_per_s, grace_ms;
    int64_t connections;
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

/* Watches a socket from its first to its last moment; NULL when memory runs out, which the others accept. */
struct watched *watchdog_add(struct watchdog *watchdog, int fd);
void watchdog_remove(struct watchdog *watchdog, struct watched *watched);

/* From any thread. */
void watchdog_enter(struct watched *watched, enum watchdog_phase phase);
void watchdog_count(struct watched *watched, size_t bytes);

#endif
