/* Packed in one go, as measure_json.c does: NULL is left out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/info_json.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

#include "api/codecs/stats_json.h"

static json_t *corner(const double p[3]) {
    return json_pack("[o, o, o]", stats_json_number(p[0]), stats_json_number(p[1]), stats_json_number(p[2]));
}

static json_t *attributes_json(const struct cloud_info *info) {
    json_t *array = json_array();
    for (size_t i = 0; array && i < info->attribute_count; i++) {
        const struct cloud_info_attribute *attribute = &info->attribute[i];
        json_array_append_new(array, json_pack("{s:s, s:s, s:o*}", "name", attribute->name, "type", attribute->type,
                                               "list", attribute->is_list ? json_true() : NULL));
    }
    return array;
}

static json_t *lines_json(const char *lines) {
    json_t *array = json_array();
    for (const char *at = lines ? lines : ""; array && *at;) {
        size_t n = strcspn(at, "\n");
        json_array_append_new(array, json_stringn(at, n));
        at += n + (at[n] == '\n');
    }
    return array;
}

static json_t *info_surface_json(const struct report_surface *surface) {
    if (!surface->kind[0]) return NULL;
    return json_pack("{s:s, s:s, s:b}", "kind", surface->kind, "reason", surface->reason, "sure", surface->sure);
}

static json_t *info_json(const struct cloud_info *info) {
    bool noise = !isnan(info->noise), spacing = info->spacing > 0, system = info->coordinate_system[0];
    return json_pack(
        "{s:s, s:o, s:o, s:o, s:{s:o, s:o}, s:o, s:o, s:o*, s:o*, s:o*, s:o*, s:o*, s:o}", "format", info->format,
        "points", stats_json_count(info->points), "points_distinct", stats_json_count(info->distinct), "triangles",
        stats_json_count(info->triangles), "box", "min", corner(info->box_min), "max", corner(info->box_max),
        "diagonal", stats_json_number(info->diagonal), "attributes", attributes_json(info), "coordinate_system",
        system ? json_string(info->coordinate_system) : NULL, "spacing",
        spacing ? stats_json_number(info->spacing) : NULL, "noise", noise ? stats_json_number(info->noise) : NULL,
        "noise_rel", noise ? stats_json_number(info->noise / info->diagonal) : NULL, "surface",
        info_surface_json(info->surface), "left_out", lines_json(info->left_out));
}

enum status info_json_write(FILE *to, const struct cloud_info *info) {
    json_t *json = info_json(info);
    if (!json) return STATUS_NO_MEMORY;
    int rc = json_dumpf(json, to, JSON_INDENT(2) | JSON_REAL_PRECISION(17));
    json_decref(json);
    return rc != 0 || fputc('\n', to) == EOF || fflush(to) != 0 ? STATUS_IO : STATUS_OK;
}
