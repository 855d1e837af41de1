/* A cloud with some of its properties.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_LEAVE_PROPERTIES_H
#define WHITTLE_CORE_CLOUD_LEAVE_PROPERTIES_H

#include "core/cloud/cloud.h"

/* Whether the cloud has each property that the list (core/text/name_list.h; "" = all) names, also by a name that says
 * the same (core/cloud/attribute_names.h), or for "rgb" and "normals" any of those: STATUS_BAD_PARAMETER at
 * "properties", with the names that there are. */
enum status cloud_has_properties(const struct cloud *cloud, const char *list, struct error *error) MUST_CHECK;

/* Leaves x, y, z and those that the list names, in their order and in place, with all that belongs to them.  What says
 * of each point where it was scanned from goes with CLOUD_SCAN.  Errors as above, STATUS_NO_MEMORY: the cloud is as it
 * was then.  O(points). */
enum status cloud_leave_properties(struct cloud *cloud, const char *list, struct error *error) MUST_CHECK;

#endif
