/* Statuses and errors of the library: those of core/, value by value.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>

#include "core/library/handles.h"

_Static_assert((int)WHITTLE_NO_SPACE == (int)STATUS_NO_SPACE && (int)WHITTLE_NO_SPACE + 1 == STATUS_COUNT,
               "whittle.h has each status");
_Static_assert((int)WHITTLE_FLOAT64 == (int)SCALAR_FLOAT64 && SCALAR_TYPE_COUNT == 8, "whittle.h has each type");
_Static_assert(sizeof(((struct whittle_error *)0)->where) == ERROR_WHERE_BYTES &&
                   sizeof(((struct whittle_error *)0)->text) == ERROR_TEXT_BYTES,
               "texts of errors have the same room");

const char *whittle_status_name(enum whittle_status status) { return status_name((enum status)status); }

enum whittle_status library_status(enum status status, const struct error *error, struct whittle_error *out) {
    if (!status || !out) return (enum whittle_status)status;
    *out = (struct whittle_error){.code = (enum whittle_status)status, .line = error->line, .byte_offset = UINT64_MAX};
    if (error->code) out->byte_offset = error->byte_offset;
    snprintf(out->where, sizeof out->where, "%s", error->where);
    snprintf(out->text, sizeof out->text, "%s", error->text[0] ? error->text : status_name(status));
    return out->code;
}

static int call_tick(void *context, const char *stage, double fraction) {
    const struct whittle_progress *progress = context;
    return progress->tick(progress->context, stage, fraction);
}

const struct progress *library_progress(const struct whittle_progress *progress, struct progress *inner) {
    *inner = (struct progress){0};
    if (progress && progress->tick) *inner = (struct progress){call_tick, (void *)(uintptr_t)progress};
    return inner;
}
