/* What whittled and the service manager that started it tell each other: systemd's documented protocols.
 *
 * All of it does nothing where no manager asked for it, so the same program runs by hand, in a container or as a unit.
 * Its code is base/notify.c.
 *
 * Sources: sd_notify(3), sd_watchdog_enabled(3), sd_listen_fds(3); systemd promises to keep these protocols.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_NOTIFY_H
#define WHITTLE_SERVER_BASE_NOTIFY_H

#include <stdbool.h>

#include "core/base/status.h"

/* Sends one message ("READY=1\nSTATUS=..."; at most 2 KB) as a datagram to the socket that NOTIFY_SOCKET names.  A
 * failure is logged: the service goes on without its manager. */
void notify_send(const char *message);

struct notify_watch;

/* Where WATCHDOG_USEC asks for it (and WATCHDOG_PID, if there, is this process), starts a thread that calls answers
 * four times in that period and sends WATCHDOG=1 whenever it returned true.  So a check that fails, or that never
 * comes back, lets the manager end and restart the service.  Two failures in a row are logged once.
 * *watch is NULL where nobody asked.  STATUS_NO_MEMORY: the thread can't be started. */
enum status notify_watch(bool (*answers)(void *ctx), void *ctx, struct notify_watch **watch,
                         struct error *error) MUST_CHECK;

/* Waits for a check under way, then for the thread's end.  Accepts NULL. */
void notify_unwatch(struct notify_watch *watch);

#define NOTIFY_MAIN_SOCKET "http"

/* The descriptor called name (FileDescriptorName= of the socket unit) among those that the manager handed over with
 * LISTEN_PID, LISTEN_FDS and LISTEN_FDNAMES.  A single one without a name of its own ("whittled.socket", "unknown", or
 * no names at all) is NOTIFY_MAIN_SOCKET.  Closed on exec from then on.  -1: none. */
int notify_inherited(const char *name);

#endif
