/* Errors of a server (a database, a blob store) that doesn't answer now, and may do so later: whoever asked for it is
 * told to come again.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_AWAY_H
#define WHITTLE_SERVER_BASE_AWAY_H

#include <stdbool.h>
#include <string.h>

#include "core/base/status.h"

/* What error->where is, with STATUS_IO. */
#define AWAY "away"

static inline bool error_is_away(const struct error *error) {
    return error->code == STATUS_IO && strcmp(error->where, AWAY) == 0;
}

#endif
