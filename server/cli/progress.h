/* How whittle tells how far it is: a bar on a terminal, lines on an inherited descriptor, or nothing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_PROGRESS_H
#define WHITTLE_SERVER_CLI_PROGRESS_H

#include <signal.h>
#include <stdbool.h>

#include "core/base/status.h"

struct command_progress {
    int fd;          /* lines of server/shared/worker_protocol.h; -1: none */
    bool bar;        /* standard error is a terminal */
    double from, to; /* the part of the whole job that ticks' 0 .. 1 stand for */
    double last_ms;  /* when something was told last */
    char last_stage[32];
    volatile sig_atomic_t *stopping; /* nonzero: every tick asks to stop; borrowed */
};

void command_progress_init(struct command_progress *progress, int fd, volatile sig_atomic_t *stopping);

/* From now on a tick's 0 .. 1 stands for from .. to of the whole job. */
void command_progress_span(struct command_progress *progress, double from, double to);

/* For struct progress: ctx is the struct command_progress. */
int command_progress_tick(void *ctx, const char *stage, double fraction);

/* Takes the bar away, and tells `done` or `failed` on the descriptor. */
void command_progress_end(struct command_progress *progress, enum status status, const struct error *error);

#endif
