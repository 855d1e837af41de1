/* Normals as properties of a cloud.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_NORMALS_H
#define WHITTLE_CORE_CLOUD_NORMALS_H

#include "core/cloud/cloud.h"

/* Gives the points these normals (cloud->count of them, borrowed) as nx, ny and nz: in the place of scalars of these
 * names where all three are there as numbers with a point, else as float behind the other properties; a list or a lone
 * property of such a name gets another one.  O(n).  STATUS_NO_MEMORY leaves the cloud as it was; STATUS_LIMIT, where it
 * has no room for three more properties. */
enum status cloud_set_normals(struct cloud *cloud, const float (*normal)[3], struct error *error) MUST_CHECK;

#endif
