/* What the service reads from a report.json: the figures that a reply's headers carry.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_REPORT_READ_H
#define WHITTLE_API_CODECS_REPORT_READ_H

/* Absent numbers are NAN, absent counts 0. */
struct report_headline {
    unsigned long long points_in, points_distinct, points_out, triangles;
    double mean_rel, rms_rel, max_rel; /* of the points to the mesh; to the tangent planes where there is no mesh */
    double symmetric_mean, symmetric_max, symmetric_mean_rel, symmetric_max_rel; /* both ways; without a mesh NAN */
};

/* Reads a report's text (NULL is allowed). */
void report_read_headline(const char *json, struct report_headline *headline);

/* The stages and their times, in order, `total` last: calls found(ctx, name, ms) for each. */
void report_read_timings(const char *json, void (*found)(void *ctx, const char *name, double ms), void *ctx);

/* The report as it is stored with its job: parsed, and written compactly.  Returns new, or NULL when it is no JSON. */
char *report_read_compact(const char *json);

#endif
