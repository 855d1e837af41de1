/* Stages tick as often as they like; what goes out is a line in INTERVAL_MS and the first of every stage, so that short
 * stages show too.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/progress.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/base/clock.h"
#include "server/shared/worker_protocol.h"

enum { BAR_CELLS = 40 };
static const double INTERVAL_MS = 50;

void command_progress_init(struct command_progress *progress, int fd, volatile sig_atomic_t *stopping) {
    *progress = (struct command_progress){.fd = fd, .to = 1, .bar = isatty(STDERR_FILENO), .stopping = stopping};
}

void command_progress_span(struct command_progress *progress, double from, double to) {
    progress->from = from;
    progress->to = to;
}

/* A reader that is gone is no reason to stop: the daemon that started us may be starting again. */
static void send_line(int fd, const struct wire_message *message) {
    char line[WIRE_LINE_BYTES];
    size_t length = wire_encode(message, line), sent = 0;
    while (sent < length) {
        ssize_t n = write(fd, line + sent, length - sent);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) return;
        sent += (size_t)n;
    }
}

static void draw_bar(const char *stage, double fraction) {
    int filled = (int)(fraction * BAR_CELLS + 0.5);
    fprintf(stderr, "\r%-12s [", stage);
    for (int i = 0; i < BAR_CELLS; i++) fputc(i < filled ? '#' : ' ', stderr);
    fprintf(stderr, "] %3.0f %%", fraction * 100);
    fflush(stderr);
}

int command_progress_tick(void *ctx, const char *stage, double fraction) {
    struct command_progress *progress = ctx;
    double time_ms = clock_exact_ms();
    bool new_stage = strcmp(stage, progress->last_stage) != 0;
    if (*progress->stopping) return 1;
    if (!new_stage && time_ms - progress->last_ms < INTERVAL_MS) return 0;
    fraction = progress->from + (progress->to - progress->from) * fraction;
    progress->last_ms = time_ms;
    snprintf(progress->last_stage, sizeof progress->last_stage, "%s", stage);
    if (progress->bar) draw_bar(stage, fraction);
    if (progress->fd >= 0) {
        struct wire_message message = {.kind = WIRE_PROGRESS, .fraction = fraction};
        snprintf(message.stage, sizeof message.stage, "%s", stage);
        send_line(progress->fd, &message);
    }
    return 0;
}

void command_progress_end(struct command_progress *progress, enum status status, const struct error *error) {
    if (progress->bar) fprintf(stderr, "\r\033[K");
    if (progress->fd < 0) return;
    struct wire_message message = {.kind = status ? WIRE_FAILED : WIRE_DONE};
    if (status) message.error = *error, message.error.code = status;
    send_line(progress->fd, &message);
}
