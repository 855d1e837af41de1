/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/forecast_json.h"

#include <jansson.h>
#include <math.h>

#include "api/codecs/stats_json.h"

static json_t *forecast_goals_json(const struct forecast *f) {
    json_t *list = json_array();
    int bad = 0;
    for (size_t i = 0; i < f->goals; i++)
        bad |= json_array_append_new(list, isnan(f->kept[i]) ? json_null() : stats_json_count((uint64_t)f->kept[i]));
    if (!bad) return list;
    json_decref(list);
    return NULL;
}

static json_t *output_json(const struct forecast *f) {
    json_t *list = json_array();
    int bad = 0;
    for (size_t i = 0; i < f->outputs; i++) bad |= json_array_append_new(list, json_string_nocheck(f->output[i]));
    if (!bad) return list;
    json_decref(list);
    return NULL;
}

enum status forecast_json_write(FILE *to, const struct forecast *f) {
    json_t *json =
        json_pack("{s:{s:s, s:o, s:o}, s:o, s:o, s:o, s:b, s:o, s:o, s:o}", "input", "format", f->format, "points",
                  stats_json_count(f->points), "triangles", stats_json_count(f->triangles), "points_out",
                  forecast_goals_json(f), "memory_bytes", stats_json_count(f->memory_bytes), "memory_most_bytes",
                  stats_json_count(f->memory_most_bytes), "in_tiles", f->in_tiles, "disk_bytes",
                  stats_json_count(f->disk_bytes), "seconds", stats_json_number(f->seconds), "outputs", output_json(f));
    if (!json) return STATUS_NO_MEMORY;
    int rc = json_dumpf(json, to, JSON_INDENT(2) | JSON_REAL_PRECISION(17));
    json_decref(json);
    return rc != 0 || fputc('\n', to) == EOF || fflush(to) != 0 ? STATUS_IO : STATUS_OK;
}
