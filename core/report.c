/* A stage that runs several times, once for each level, has one row with its times added.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/report.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

void report_add_stage(struct report *report, const char *name, double wall_ms) {
    size_t i = 0;
    while (i < report->stage_count && strcmp(report->stage[i].name, name) != 0) i++;
    if (i == REPORT_MAX_STAGES) return;
    if (i == report->stage_count) {
        snprintf(report->stage[i].name, sizeof report->stage[i].name, "%s", name);
        report->stage_count++;
    }
    report->stage[i].wall_ms += wall_ms;
}

/* Mean and root mean square of both directions alike. */
void report_set_symmetric(struct report_level *level) {
    const struct distance_stats *there = level->surface_to_mesh.count ? &level->surface_to_mesh : &level->input_to_mesh;
    const struct distance_stats *back = &level->mesh_to_input;
    level->symmetric =
        (struct distance_stats){.count = there->count + back->count,
                                .mean = (there->mean + back->mean) / 2,
                                .rms = sqrt((there->rms * there->rms + back->rms * back->rms) / 2),
                                .max = fmax(level->surface_to_mesh.max, fmax(level->input_to_mesh.max, back->max))};
}

/* A closed mesh over what wasn't scanned. */
static bool warns_of_lid(const struct report *report, const struct report_level *level, char *text, size_t text_bytes) {
    bool given = strcmp(report->surface.kind, "given") == 0; /* nothing but the input's faces spans anything */
    if (given || !level->has_mesh || !level->watertight || level->unsupported <= REPORT_UNSUPPORTED_MOST) return false;
    snprintf(
        text, text_bytes,
        "the mesh is watertight, but no input point supports %.0f %% of its area (warned of from %.0f %%): it spans "
        "what was not scanned%s; boundary=keep leaves that open",
        100 * level->unsupported, 100 * REPORT_UNSUPPORTED_MOST,
        strcmp(report->denoised, "full") == 0 ? ", or noise was more than smoothing takes off" : "");
    return true;
}

/* Sheets between wires, or between places that are farther apart than a surface of theirs would be. */
static bool warns_of_webs(const struct report *report, const struct report_level *level, char *text,
                          size_t text_bytes) {
    bool given = strcmp(report->surface.kind, "given") == 0;
    if (given || !level->has_mesh || level->watertight || level->unsupported <= REPORT_WEBS_MOST) return false;
    snprintf(
        text, text_bytes,
        "no input point supports %.0f %% of the mesh's area (warned of from %.0f %%): the points may be of curves, "
        "between which there is no surface, or too few of them are kept",
        100 * level->unsupported, 100 * REPORT_WEBS_MOST);
    return true;
}

static bool warns_of_kind(const struct report *report, const struct report_level *level, char *text,
                          size_t text_bytes) {
    const struct report_surface *surface = &report->surface;
    if (!level->has_mesh || !surface->kind[0] || surface->sure) return false;
    snprintf(text, text_bytes, "it is not sure what surface the points are of; surface=%s was taken, as %s",
             surface->kind, surface->reason);
    return true;
}

/* A mesh of noise, which could have been smoothed.  The share is of what differs among near neighbours: where all of
 * these lie within the noise it is more. */
static bool warns_of_noise(const struct report *report, const struct report_level *level, char *text,
                           size_t text_bytes) {
    bool given = strcmp(report->surface.kind, "given") == 0;
    if (given || !level->has_mesh || report->noise_share <= REPORT_LARGE_NOISE) return false;
    snprintf(text, text_bytes,
             "noise is at least %.2g of the distance between points (warned of from %g): the mesh follows it; "
             "denoise=auto smooths such points",
             report->noise_share, REPORT_LARGE_NOISE);
    return true;
}

/* Points that aren't where they were measured. */
static bool warns_of_smoothing(const struct report *report, char *text, size_t text_bytes) {
    if (report->noisy_share <= 0 || strcmp(report->denoised, "full") != 0) return false;
    snprintf(text, text_bytes,
             "noise is larger than half the distance between points at %.0f %% of the places, and a mesh of them would "
             "be crumpled: points were smoothed as by denoise=full; denoise=none leaves them",
             100 * report->noisy_share);
    return true;
}

/* Points that weren't asked to be left out. */
static bool warns_of_dropping(const struct report *report, const struct report_level *level, char *text,
                              size_t text_bytes) {
    char far[64] = "";
    if (!report->strays_sought || report->points_outliers == 0 || strcmp(report->denoised, "full") == 0) return false;
    if (level->dropped.count) snprintf(far, sizeof far, ", are up to %.4g from the mesh", level->dropped.max);
    snprintf(text, text_bytes,
             "%" PRIu64 " of %" PRIu64 " points (%.2g %%) are strays or belong to a less exact second layer of the "
             "surface, and a mesh of them would be rough: they were dropped as by denoise=auto%s, and are in no other "
             "error%s; denoise=none keeps them",
             report->points_outliers, report->points_in,
             100 * (double)report->points_outliers / (double)report->points_in, far,
             report->deviation.bound > 0 ? " nor bounded" : "");
    return true;
}

/* A bounded mesh that spans what has no points, as a height field does beside a straight edge. */
static bool warns_of_span(const struct report *report, const struct report_level *level, char *text,
                          size_t text_bytes) {
    double bound = report->deviation.bound, far = level->mesh_to_input.max;
    if (!(bound > 0) || level->mesh_to_input.count == 0 || far <= bound) return false;
    snprintf(text, text_bytes,
             "the mesh is up to %.4g from the points, where there are none, %.3g times what is allowed: max_deviation "
             "bounds how far the points are from the mesh, not how far the mesh is from them",
             far, far / bound);
    return true;
}

/* Degrees of longitude and latitude under metres of height: distances, and what is near, mean nothing.  A degree has
 * 111 km, so a landscape looks thousands of times as high as wide; what is scanned otherwise is no needle. */
static bool warns_of_degrees(const struct report *report, char *text, size_t text_bytes) {
    const double *low = report->box_min, *high = report->box_max;
    bool on_earth = low[0] >= -180 && high[0] <= 180 && low[1] >= -90 && high[1] <= 90;
    double wide = fmax(high[0] - low[0], high[1] - low[1]), height = high[2] - low[2];
    if (!on_earth || !(wide > 0) || height <= REPORT_NEEDLE * wide) return false;
    snprintf(
        text, text_bytes,
        "the cloud is %.0f times as high as wide: if x and y are degrees and z is metres, distances are wrong; put "
        "it into a coordinate system of metres first",
        height / wide);
    return true;
}

/* Coordinates of a surveyor's grid, which float32 can't hold. */
static bool warns_of_rounding(const struct report *report, char *text, size_t text_bytes) {
    if (report->rounding_share < REPORT_COARSE_STEPS) return false;
    snprintf(text, text_bytes,
             "coordinates are so large that float32 holds them in steps of %.3g, %.2g of the distance between points "
             "(warned of from %g): if they were rounded to these, take them as double, or less an offset, from where "
             "they come from",
             report->rounding_step, report->rounding_share, REPORT_COARSE_STEPS);
    return true;
}

bool report_warning(const struct report *report, const struct report_level *level, size_t n, char *text,
                    size_t text_bytes) {
    if (warns_of_degrees(report, text, text_bytes) && n-- == 0) return true;
    if (warns_of_rounding(report, text, text_bytes) && n-- == 0) return true;
    if (warns_of_span(report, level, text, text_bytes) && n-- == 0) return true;
    if (warns_of_lid(report, level, text, text_bytes) && n-- == 0) return true;
    if (warns_of_webs(report, level, text, text_bytes) && n-- == 0) return true;
    if (warns_of_kind(report, level, text, text_bytes) && n-- == 0) return true;
    if (warns_of_smoothing(report, text, text_bytes) && n-- == 0) return true;
    if (warns_of_dropping(report, level, text, text_bytes) && n-- == 0) return true;
    return warns_of_noise(report, level, text, text_bytes) && n == 0;
}
