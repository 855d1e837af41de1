/* What a file could not hold.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/left_out.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

void left_out_add(struct left_out *left_out, const char *where, const char *format, ...) {
    char what[LEFT_OUT_TEXT_BYTES];
    va_list args;
    if (!left_out || left_out->count == LEFT_OUT_MOST) return;
    va_start(args, format);
    vsnprintf(what, sizeof what, format, args);
    va_end(args);
    for (size_t i = 0; i < left_out->count; i++)
        if (strcmp(left_out->loss[i].where, where) == 0 && strcmp(left_out->loss[i].what, what) == 0) return;
    snprintf(left_out->loss[left_out->count].where, LEFT_OUT_WHERE_BYTES, "%s", where);
    snprintf(left_out->loss[left_out->count].what, LEFT_OUT_TEXT_BYTES, "%s", what);
    left_out->count++;
}
