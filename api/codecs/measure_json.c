/* What was measured is packed in one go; what wasn't is NULL, which json_pack leaves out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/measure_json.h"

#include <jansson.h>
#include <stdbool.h>

#include "api/codecs/stats_json.h"

static json_t *side_json(const struct measurement *m, int i) {
    return json_pack("{s:o, s:o}", "points", stats_json_count(m->points[i]), "triangles",
                     stats_json_count(m->triangles[i]));
}

/* NULL, which json_pack's s:o* leaves out, where nothing was measured. */
static json_t *distances(const struct distance_stats *stats, double diagonal) {
    return stats->count ? stats_json(stats, diagonal) : NULL;
}

void measure_json_sides(const struct measurement *m, const struct distance_stats *side[2]) {
    bool points = m->triangles[1] == 0;
    const struct distance_stats *from_b = m->metro_diagonal > 0 || points ? &m->forward : &m->surface;
    bool both = from_b->count > 0 && m->backward.count > 0;
    side[0] = both ? from_b : NULL;
    side[1] = both ? &m->backward : NULL;
}

static json_t *mean_of_sides(const struct measurement *m, double unit) {
    const struct distance_stats *side[2];
    measure_json_sides(m, side);
    return side[0] ? stats_json_number((side[0]->mean + side[1]->mean) / 2 / unit) : NULL;
}

static json_t *measurement_json(const struct measurement *m) {
    double d = m->diagonal;
    bool metro = m->metro_diagonal > 0;
    return json_pack("{s:s, s:o, s:o*, s:o, s:o, s:o*, s:o*, s:o*, s:o*, s:o*, s:o, s:o, s:o*}", "method", m->method,
                     "diagonal", stats_json_number(d), "metro_diagonal",
                     metro ? stats_json_number(m->metro_diagonal) : NULL, "a", side_json(m, 0), "b", side_json(m, 1),
                     "forward", distances(&m->forward, d), "surface", distances(&m->surface, d), "backward",
                     distances(&m->backward, d), "mean", mean_of_sides(m, 1), "mean_rel", mean_of_sides(m, d),
                     "hausdorff", stats_json_number(m->hausdorff), "hausdorff_rel", stats_json_number(m->hausdorff / d),
                     "hausdorff_metro_rel", metro ? stats_json_number(m->hausdorff / m->metro_diagonal) : NULL);
}

enum status measure_json_write(FILE *to, const struct measurement *measurement) {
    json_t *json = measurement_json(measurement);
    if (!json) return STATUS_NO_MEMORY;
    int rc = json_dumpf(json, to, JSON_INDENT(2) | JSON_REAL_PRECISION(17));
    json_decref(json);
    return rc != 0 || fputc('\n', to) == EOF || fflush(to) != 0 ? STATUS_IO : STATUS_OK;
}
