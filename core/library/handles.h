/* What the handles of whittle.h are, and the ways between its types and those of core/.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_LIBRARY_HANDLES_H
#define WHITTLE_CORE_LIBRARY_HANDLES_H

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/params.h"
#include "core/pipeline/pipeline.h"
#include "core/whittle.h"

struct whittle_cloud {
    struct cloud cloud;
};

struct whittle_options {
    struct params params; /* as they were set: not resolved */
};

struct whittle_result {
    const struct whittle_cloud *input; /* borrowed */
    struct pipeline_result made;
};

/* The same value; fills out, which may be NULL, where status isn't STATUS_OK. */
enum whittle_status library_status(enum status status, const struct error *error, struct whittle_error *out);

/* Fills *inner so that it calls progress, which may be NULL; both are borrowed.  Returns inner. */
const struct progress *library_progress(const struct whittle_progress *progress, struct progress *inner);

#endif
