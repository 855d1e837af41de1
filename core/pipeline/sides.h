/* The sides of normals that are known already: for whoever has a cloud's normals from elsewhere (core/tiles/).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PIPELINE_SIDES_H
#define WHITTLE_CORE_PIPELINE_SIDES_H

#include "core/cloud/cloud.h"
#include "core/params.h"
#include "core/report.h"

/* Turns unit normals (of each point of the cloud, borrowed, of either sign) as the step `sides` of the pipeline does:
 * by the cloud's own normals, what it was seen from, or its shape; fills report->normals.  *turned is the caller's; it
 * stays NULL where the cloud has normals that fit.  STATUS_NO_MEMORY. */
enum status sides_of_normals(const struct cloud *cloud, const struct params *params, unsigned threads,
                             const vec3 *normal, float (**turned)[3], struct report *report,
                             struct error *error) MUST_CHECK;

#endif
