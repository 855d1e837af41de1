/* What programs call the same.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_ATTRIBUTE_NAMES_H
#define WHITTLE_CORE_CLOUD_ATTRIBUTE_NAMES_H

#include <stdbool.h>

#include "core/cloud/cloud.h"

/* The usual name (red, nx, intensity, classification, gps_time ...) of what this one is a name of; NULL: it is none of
 * those.  Static.  O(length). */
const char *attribute_usual_name(const char *name);

/* Whether two names say the same: they have one usual name or, where they have none, are equal but for capitals and
 * CloudCompare's "scalar_" before them. */
bool attribute_is_same(const char *a, const char *b);

/* The scalar property of this name: as it is, or the first one by a name that says the same.  NULL: none. */
const struct property *attribute_find(const struct cloud *cloud, const char *name);

/* The two properties of texture coordinates, s and t or by other names that are usual for both; false where there are
 * none. */
bool attribute_find_texture(const struct cloud *cloud, const struct property *texture[2]);

#endif
