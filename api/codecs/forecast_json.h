/* What whittle --dry-run --json tells.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_FORECAST_JSON_H
#define WHITTLE_API_CODECS_FORECAST_JSON_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include "core/base/status.h"
#include "core/params.h"

/* What a run would come to.  NAN: only the run finds out. */
struct forecast {
    const char *format;
    uint64_t points, triangles;
    size_t goals;
    double kept[PARAMS_MAX_LEVELS]; /* of each of the goals */
    uint64_t memory_bytes, memory_most_bytes;
    bool in_tiles;
    uint64_t disk_bytes; /* of the tiles' files, at most; else 0 */
    double seconds;
    size_t outputs;
    const char *const *output; /* names of files; NULL: standard output alone */
};

/* Writes it indented, with a newline at the end.  STATUS_IO, STATUS_NO_MEMORY. */
enum status forecast_json_write(FILE *to, const struct forecast *forecast) MUST_CHECK;

#endif
