/* Values of a cloud's properties by name, for tests.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_PROPERTY_H
#define WHITTLE_TESTS_PROPERTY_H

#include <string.h>

#include "core/cloud/cloud.h"

/* The property of point i; fails the test where the cloud has none of that name. */
static inline double property_value(const struct cloud *cloud, size_t i, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *p = &cloud->property[j];
        if (strcmp(p->name, name) == 0)
            return scalar_load(cloud->record + i * cloud->record_bytes + p->offset_bytes, p->type);
    }
    fail_msg("no property %s", name);
    return 0;
}

#endif
