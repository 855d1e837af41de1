/* A report as JSON: report.json, and the `report` of a job document.
 *
 * Lengths are in the input's units; x_rel = x / diagonal.  error.mean_rel and error.rms_rel are the largest over the
 * directions measured, error.max_rel is Hausdorff's distance.  What was not measured is null or left out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_REPORT_JSON_H
#define WHITTLE_API_REPORT_JSON_H

#include "core/report.h"

/* Returns new text (indented, ended by a newline), or NULL when memory runs out. */
char *report_encode(const struct report *report);

/* The few figures that a reply's header carries, read back from a report's text.  Absent ones are NAN or 0. */
struct report_headline {
    unsigned long long points_in, points_out, triangles;
    double mean_rel, rms_rel, max_rel; /* of the mesh; of the tangent planes where there is no mesh */
    double total_ms;
};
void report_read_headline(const char *json, struct report_headline *headline);

/* The stages and their times, in order: calls found(ctx, name, ms) for each. */
void report_read_timings(const char *json, void (*found)(void *ctx, const char *name, double ms), void *ctx);

#endif
