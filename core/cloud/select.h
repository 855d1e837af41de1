/* The part of a cloud that is asked for: within a box or a polygon, with properties that meet conditions.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_SELECT_H
#define WHITTLE_CORE_CLOUD_SELECT_H

#include "core/cloud/cloud.h"
#include "core/params.h"

/* How many points weren't in the box or polygon, and of the others how many met not all conditions. */
struct selection {
    uint64_t cropped, filtered;
};

static inline bool select_is_asked(const struct params *params) { return params->crop.count || params->where[0]; }

/* STATUS_BAD_PARAMETER at a parameter that names a property which isn't there: tells those that are. */
enum status select_refuse(const struct cloud *cloud, const char *parameter, const char *name, struct error *error);

/* Whether the cloud has each property that params->where and params->weights name; nothing but its properties is looked
 * at.  STATUS_BAD_PARAMETER as select_refuse.  O(names * properties). */
enum status select_check_names(const struct cloud *cloud, const struct params *params, struct error *error) MUST_CHECK;

/* As select_points, of a part of a cloud, of which none may be left. */
enum status select_part(const struct cloud *cloud, const struct params *params, uint8_t *kept,
                        struct selection *selection, struct error *error) MUST_CHECK;

/* kept[i] = 1 for each of the cloud->count points that params->crop and params->where leave, else 0.  A box has its
 * faces, whichever two of its corners are given; a polygon, of which a line that leaves it is counted by even and odd,
 * has about half of its edges.  STATUS_BAD_PARAMETER (error->where names the parameter) where there is no such
 * property, which tells those that there are, or no point is left.  O(points * (corners + conditions)). */
enum status select_points(const struct cloud *cloud, const struct params *params, uint8_t *kept,
                          struct selection *selection, struct error *error) MUST_CHECK;

/* Leaves these points alone, in place.  Also STATUS_NO_MEMORY. */
enum status select_in_place(struct cloud *cloud, const struct params *params, struct selection *selection,
                            struct error *error) MUST_CHECK;

#endif
