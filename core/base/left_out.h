/* What a file could not hold of what there was: for the report.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_LEFT_OUT_H
#define WHITTLE_CORE_BASE_LEFT_OUT_H

#include <stddef.h>

enum { LEFT_OUT_MOST = 24, LEFT_OUT_WHERE_BYTES = 24, LEFT_OUT_TEXT_BYTES = 160 };

/* How what isn't a loss begins: what was done otherwise than may be thought; what a user should know before using a
 * result. */
#define LEFT_OUT_NOTE "note: "
#define LEFT_OUT_WARNING "warning: "

struct left_out {
    size_t count;
    struct {
        char where[LEFT_OUT_WHERE_BYTES]; /* the input, or an output's name */
        char what[LEFT_OUT_TEXT_BYTES];   /* for people */
    } loss[LEFT_OUT_MOST];
};

/* Adds one, unless it is there already or there are LEFT_OUT_MOST.  Text that doesn't fit is cut.  left_out may be
 * NULL. */
void left_out_add(struct left_out *left_out, const char *where, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

#endif
