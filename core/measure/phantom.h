/* Surface that is not there.
 *
 * A mesh has surface far from all points where a solid stood on a table, rightly, and where it bridges a gap or fills a
 * pocket.  How far it is from the points doesn't tell the one from the other.  But two meshes of the same points agree
 * on the first, and seldom make the same mistake: phantom is what is far from the points and from the other mesh.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MEASURE_PHANTOM_H
#define WHITTLE_CORE_MEASURE_PHANTOM_H

#include "core/measure/metro.h"

/* Whether a mesh has certainly more phantom than another of the same points, that is, more of the places that are
 * sampled evenly over each (20 000, or options->samples where that is less and not 0) are farther than the points'
 * spacing from what the nearest of these tells of the surface, and from the other mesh: more by twice the standard
 * error.  The reference has points, with normals, spacing and an index.  50 ms.  STATUS_NO_MEMORY. */
enum status phantom_is_more(const struct mesh *mesh, const struct mesh *other, const struct metro_reference *reference,
                            const struct metro_options *options, bool *is_more) MUST_CHECK;

/* How far a mesh's own places are from the nearer of two things: what the nearest point tells of the surface, and the
 * other mesh.  Where both meshes go without points, as over the flat end of a solid, that says nothing against either;
 * a spike that one of them has counts by its length squared in the root mean square.  Places and cost as above. */
struct phantom_depth {
    double mean, rms;
};

enum status phantom_depth(const struct mesh *mesh, const struct mesh *other, const struct metro_reference *reference,
                          const struct metro_options *options, struct phantom_depth *depth) MUST_CHECK;

#endif
