/* Progress and cancel, as one callback.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_PROGRESS_H
#define WHITTLE_CORE_BASE_PROGRESS_H

#include <stddef.h>

/* tick is called from the thread that called the stage, often (each few milliseconds of work), with the stage's name
 * and how much of it is done, 0 to 1.  A nonzero answer means stop: the stage returns STATUS_CANCELLED soon after.
 * A NULL struct or a NULL tick asks nobody. */
struct progress {
    int (*tick)(void *ctx, const char *stage, double fraction);
    void *ctx;
};

static inline int progress_tick(const struct progress *progress, const char *stage, double fraction) {
    return progress && progress->tick ? progress->tick(progress->ctx, stage, fraction) : 0;
}

#endif
