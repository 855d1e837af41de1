/* What a file could not hold of what there was: for the report.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_WARNINGS_H
#define WHITTLE_CORE_BASE_WARNINGS_H

#include <stddef.h>

enum { LOSSES_MOST = 24, LOSS_WHERE_BYTES = 24, LOSS_TEXT_BYTES = 160 };

struct losses {
    size_t count;
    struct {
        char where[LOSS_WHERE_BYTES]; /* the input, or an output's name */
        char what[LOSS_TEXT_BYTES];   /* for people */
    } loss[LOSSES_MOST];
};

/* Adds one, unless it is there already or there are LOSSES_MOST.  Text that doesn't fit is cut.  losses may be NULL. */
void losses_add(struct losses *losses, const char *where, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

#endif
