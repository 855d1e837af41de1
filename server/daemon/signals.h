/* The signals that end the service or make it read its settings again, with a thread of their own: whatever the others
 * wait for, a second SIGTERM or SIGINT ends the process at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_SIGNALS_H
#define WHITTLE_SERVER_DAEMON_SIGNALS_H

#include "core/base/status.h"

struct signals;

/* What signals ask for: a set. */
enum signals_request { SIGNALS_RELOAD = 1, SIGNALS_STOP = 2 };

/* Blocks the signals for this thread and those that it starts, and starts theirs: so before any other thread. */
enum status signals_open(struct signals **signals, struct error *error) MUST_CHECK;

/* Ends the thread; the signals stay blocked.  Accepts NULL. */
void signals_close(struct signals *signals);

/* Waits for a signal for so long; what has been asked for since the last call, 0 = nothing. */
unsigned signals_wait(struct signals *signals, int timeout_ms);

#endif
