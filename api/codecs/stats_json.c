/* Figures go out with as many digits as the caller's dump asks for; here is only what JSON can't say by itself.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/stats_json.h"

#include <math.h>

json_t *stats_json_number(double value) { return isfinite(value) ? json_real(value) : json_null(); }

json_t *stats_json_count(uint64_t value) { return json_integer((json_int_t)value); }

json_t *stats_json(const struct distance_stats *stats, double diagonal) {
    return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "samples", stats_json_count(stats->count), "mean",
                     stats_json_number(stats->mean), "rms", stats_json_number(stats->rms), "max",
                     stats_json_number(stats->max), "mean_rel", stats_json_number(stats->mean / diagonal), "rms_rel",
                     stats_json_number(stats->rms / diagonal), "max_rel", stats_json_number(stats->max / diagonal));
}
