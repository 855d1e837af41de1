/* What `whittle measure` found out, as JSON.
 *
 *     {"method": "uniform", "diagonal": 1.23,
 *      "a": {"points": 4848, "triangles": 9692}, "b": {"points": 48485, "triangles": 96966},
 *      "forward":  {"samples": 48485, "mean": ..., "rms": ..., "max": ..., "mean_rel": ..., "rms_rel": ..., "max_rel":
 * ...}, "surface":  {...}, "backward": {...}, "mean": ..., "mean_rel": ..., "hausdorff": ..., "hausdorff_rel": ...}
 *
 * What wasn't measured is absent.  Numbers have 17 digits, so they come back as the same double.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_MEASURE_JSON_H
#define WHITTLE_API_CODECS_MEASURE_JSON_H

#include <stdint.h>
#include <stdio.h>

#include "core/base/status.h"
#include "core/report.h"

/* A is the simplified one, B the one that it is compared with.  Lengths are in the files' units. */
struct measurement {
    const char *method;               /* "uniform" or "metro" */
    uint64_t points[2], triangles[2]; /* of A and of B */
    double diagonal;                  /* of the bounding box of B: what _rel is relative to */
    double metro_diagonal;            /* what the program Metro divides by; 0 = not asked for */
    struct distance_stats forward;    /* B to A: its points (uniform) or samples of its surface (metro) */
    struct distance_stats surface;    /* B to A: samples of its surface (uniform) */
    struct distance_stats backward;   /* A to B: samples of its surface, or its points where it has no faces */
    double hausdorff;                 /* largest of the maxima */
};

/* The two rows that compare the two sides: surface with surface, points with points, or each with the other; NULL in
 * both where not both directions were measured. */
void measure_json_sides(const struct measurement *m, const struct distance_stats *side[2]);

/* Writes it indented, with a newline at the end.  STATUS_IO, STATUS_NO_MEMORY. */
enum status measure_json_write(FILE *to, const struct measurement *measurement) MUST_CHECK;

#endif
