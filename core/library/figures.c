/* The figures of a report by their names, and its warnings.
 *
 * Names are those of the report's JSON document; lengths are in the units of the input.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stddef.h>
#include <string.h>

#include "core/library/handles.h"

enum kind { COUNT, NUMBER, FLAG };

/* Where a figure lies: in struct report, or in the report of a level. */
struct figure {
    const char *name;
    enum kind kind;
    bool of_level;
    size_t offset;
    size_t measured; /* offset of the count or flag without which there is no figure; of the same struct */
    enum kind measured_kind;
};

#define ALWAYS SIZE_MAX
#define OF_REPORT(name, kind, member)                                                                                  \
    { name, kind, false, offsetof(struct report, member), ALWAYS, FLAG }
#define OF_LEVEL(name, kind, member)                                                                                   \
    { name, kind, true, offsetof(struct report_level, member), ALWAYS, FLAG }
#define OF_LEVEL_IF(name, kind, member, flag)                                                                          \
    { name, kind, true, offsetof(struct report_level, member), offsetof(struct report_level, flag), FLAG }
#define OF_MESH(name, kind, member) OF_LEVEL_IF(name, kind, member, has_mesh)
#define DISTANCE(name, stats, member)                                                                                  \
    {                                                                                                                  \
        name, NUMBER, true, offsetof(struct report_level, stats.member), offsetof(struct report_level, stats.count),   \
            COUNT                                                                                                      \
    }
#define DISTANCES(name, stats)                                                                                         \
    DISTANCE(name ".mean", stats, mean), DISTANCE(name ".rms", stats, rms), DISTANCE(name ".max", stats, max)

static const struct figure figures[] = {
    OF_REPORT("points_in", COUNT, points_in),
    OF_REPORT("input.points_distinct", COUNT, points_distinct),
    OF_REPORT("input.points_outliers", COUNT, points_outliers),
    OF_REPORT("input.points_cropped", COUNT, points_cropped),
    OF_REPORT("input.points_filtered", COUNT, points_filtered),
    OF_REPORT("input.noise", NUMBER, noise),
    OF_REPORT("input.noise_level", NUMBER, noise_level),
    OF_REPORT("input.diagonal", NUMBER, diagonal),
    OF_REPORT("timings_ms.total", NUMBER, total_ms),
    OF_REPORT("peak_rss_bytes", COUNT, peak_rss_bytes),
    OF_LEVEL("ratio", NUMBER, ratio),
    OF_LEVEL("points_out", COUNT, points_out),
    OF_LEVEL("cloud.contraction_error", NUMBER, contraction_error),
    DISTANCES("cloud.tangent_error", tangent),
    OF_MESH("mesh.vertices", COUNT, vertices),
    OF_MESH("mesh.triangles", COUNT, triangles),
    OF_MESH("mesh.components", COUNT, components),
    OF_MESH("mesh.handles", COUNT, handles),
    OF_MESH("mesh.borders", COUNT, borders),
    OF_MESH("mesh.self_intersections", COUNT, self_intersections),
    OF_MESH("mesh.border_length", NUMBER, border_length),
    OF_MESH("mesh.holes_closed", COUNT, holes_closed),
    OF_MESH("mesh.hole_fill_triangles", COUNT, hole_fill_triangles),
    OF_MESH("mesh.points_lost", COUNT, points_lost),
    OF_MESH("mesh.vertices_split", COUNT, vertices_split),
    OF_MESH("mesh.reconstructed_from", COUNT, reconstructed_from),
    OF_MESH("mesh.watertight", FLAG, watertight),
    OF_MESH("mesh.manifold", FLAG, manifold),
    OF_MESH("mesh.oriented", FLAG, oriented),
    OF_MESH("mesh.area", NUMBER, area),
    OF_LEVEL_IF("mesh.volume", NUMBER, volume, watertight),
    OF_MESH("mesh.unsupported_area_share", NUMBER, unsupported),
    DISTANCES("error.symmetric", symmetric),
    DISTANCES("error.input_to_mesh", input_to_mesh),
    DISTANCES("error.mesh_to_input", mesh_to_input),
    DISTANCES("error.surface_to_mesh", surface_to_mesh),
    DISTANCES("error.dropped", dropped),
};
enum { FIGURES = sizeof figures / sizeof figures[0] };

static double value_at(const void *base, size_t offset, enum kind kind) {
    const unsigned char *at = (const unsigned char *)base + offset;
    uint64_t count;
    double number;
    bool flag;
    switch (kind) {
    case COUNT: memcpy(&count, at, sizeof count); return (double)count;
    case NUMBER: memcpy(&number, at, sizeof number); return number;
    case FLAG: memcpy(&flag, at, sizeof flag); return flag;
    }
    return 0;
}

int whittle_result_number(const struct whittle_result *result, size_t level, const char *name, double *value) {
    const struct report *report = &result->made.report;
    if (level >= report->level_count) return 0;
    for (size_t i = 0; i < FIGURES; i++) {
        const struct figure *f = &figures[i];
        if (strcmp(f->name, name) != 0) continue;
        const void *base = f->of_level ? (const void *)&report->level[level] : (const void *)report;
        if (f->measured != ALWAYS && value_at(base, f->measured, f->measured_kind) == 0) return 0;
        *value = value_at(base, f->offset, f->kind);
        return 1;
    }
    return 0;
}

const char *whittle_result_number_name(size_t i) { return i < FIGURES ? figures[i].name : NULL; }

int whittle_result_warning(const struct whittle_result *result, size_t level, size_t i, char *text, size_t text_bytes) {
    const struct report *report = &result->made.report;
    return level < report->level_count && report_warning(report, &report->level[level], i, text, text_bytes);
}

const char *whittle_result_left_out(const struct whittle_result *result, size_t i) {
    const struct left_out *left_out = &result->made.report.left_out;
    return i < left_out->count ? left_out->loss[i].what : NULL;
}
