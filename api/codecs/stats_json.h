/* Figures as JSON: what the documents about distances share.
 *
 * All return a new reference, or NULL when memory runs out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_STATS_JSON_H
#define WHITTLE_API_CODECS_STATS_JSON_H

#include <jansson.h>
#include <stdint.h>

#include "core/report.h"

/* Numbers that JSON can't hold (infinity, NaN: a cloud of one point has no diagonal to be relative to) are null. */
json_t *stats_json_number(double value);

json_t *stats_json_count(uint64_t value);

/* {"samples", "mean", "rms", "max", "mean_rel", "rms_rel", "max_rel"}: lengths in the file's units and, _rel, as
 * fractions of the diagonal. */
json_t *stats_json(const struct distance_stats *stats, double diagonal);

#endif
