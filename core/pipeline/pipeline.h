/* The whole of whittle, from a cloud to results.  core/pipeline/pipeline.c reads as the flow in the README does.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PIPELINE_PIPELINE_H
#define WHITTLE_CORE_PIPELINE_PIPELINE_H

#include <stdbool.h>

#include "core/base/progress.h"
#include "core/cloud/cloud.h"
#include "core/measure/metro.h"
#include "core/mesh/mesh.h"
#include "core/params.h"
#include "core/report.h"

struct pipeline_level {
    size_t kept_count;
    struct mesh mesh; /* in the input's coordinates, source = ids into the cloud; empty unless asked for */
};

struct pipeline_result {
    uint32_t *kept; /* ids into the cloud of the points that are kept: the simplified cloud of a level is its first
                       kept_count; the most important first where a cloud is asked for, else in any order; NULL where
                       the mesh of the cloud's own faces is all that is; owned */
    vec3 *moved; /* of every point of the cloud: where denoising puts it, rounded to its coordinates' type; NULL where
                    it moves none; owned */
    size_t level_count;
    struct pipeline_level level[PARAMS_MAX_LEVELS]; /* the finest first */
    float (*normal)[3]; /* of every point, where they are asked for and the cloud has none that fit; else NULL; owned */
    float *dso; /* of every point, in 1 / length, where OUTPUT_DSO is asked for; else NULL; outliers show the largest;
                   owned */
    float *distance; /* of every point to the finest mesh, where OUTPUT_ERROR or OUTPUT_PREVIEW is asked for; without a
                        mesh to the tangent plane at the nearest kept point, where outliers show the largest; owned */
    float (*facing)[3]; /* the normal of every point, where OUTPUT_PREVIEW is asked for: of unit length, either side; of
                           outliers zero; owned */
    bool *dropped;      /* of every point: whether denoising dropped it; NULL where it dropped none; owned */
    struct report report;
};

/* Runs the stages that params (resolved) ask for.  The cloud is borrowed and not changed.  On success *result is the
 * caller's, to be given to pipeline_result_done.  Statuses: all of the list but STATUS_IO. */
enum status pipeline_run(const struct cloud *cloud, const struct params *params, const struct progress *progress,
                         struct pipeline_result *result, struct error *error) MUST_CHECK;

/* What pipeline_run would say of the input (but for `tangent`) and of the surface (report.surface) with the same cloud
 * and params, one level of a mesh of them, without what isn't needed to tell what the surface is.  The same statuses;
 * *report is set on success, and without a surface where there is no mesh (STATUS_DEGENERATE). */
enum status pipeline_find_surface(const struct cloud *cloud, const struct params *params, struct report *report,
                                  struct error *error) MUST_CHECK;

/* Measures a mesh (at least one triangle; only its vertices and triangles are looked at) against the points of a cloud
 * in both directions, as pipeline_run does its own: with the same options, seed among them, the figures are those of
 * the report, but for what the file with the mesh has rounded, where no point was dropped or moved.  In the cloud's
 * units; errors->surface isn't measured.  Statuses of metro_measure, and STATUS_MALFORMED: coordinates too large. */
enum status pipeline_measure_mesh(const struct cloud *cloud, const struct mesh *mesh,
                                  const struct metro_options *options, struct metro_errors *errors,
                                  struct error *error) MUST_CHECK;

/* Frees what the result owns and zeroes it.  Accepts a zeroed result. */
void pipeline_result_done(struct pipeline_result *result);

#endif
