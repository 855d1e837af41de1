/* What a file could not hold.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/warnings.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

void losses_add(struct losses *losses, const char *where, const char *format, ...) {
    char what[LOSS_TEXT_BYTES];
    va_list args;
    if (!losses || losses->count == LOSSES_MOST) return;
    va_start(args, format);
    vsnprintf(what, sizeof what, format, args);
    va_end(args);
    for (size_t i = 0; i < losses->count; i++)
        if (strcmp(losses->loss[i].where, where) == 0 && strcmp(losses->loss[i].what, what) == 0) return;
    snprintf(losses->loss[losses->count].where, LOSS_WHERE_BYTES, "%s", where);
    snprintf(losses->loss[losses->count].what, LOSS_TEXT_BYTES, "%s", what);
    losses->count++;
}
