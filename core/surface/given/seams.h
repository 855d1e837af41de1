/* Seams: edges of a surface across which its points have other attributes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_GIVEN_SEAMS_H
#define WHITTLE_CORE_SURFACE_GIVEN_SEAMS_H

#include "core/surface/given/faces.h"

/* Points of a file that are at one place are one point of the surface, with several records.  Those that differ in
 * texture coordinates or normals stay apart (faces->record, the lowest of equal ones); but not in normals, or not at
 * all, where over a quarter of the edges would be seams, as where each triangle has normals, or a picture, of its own.
 * Fills faces->record (comes as the cloud's ids; freed and NULL where there are no seams), on_seam, and of the facts
 * used, knotted, borders, seams and seams_dropped.  O(triangles).  STATUS_NO_MEMORY. */
enum status seams_find(const struct cloud *cloud, const struct ordered_points *points, unsigned threads,
                       struct faces *faces, struct faces_facts *facts) MUST_CHECK;

#endif
