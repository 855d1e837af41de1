/* What whittle --dry-run tells.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_DRY_RUN_H
#define WHITTLE_SERVER_CLI_DRY_RUN_H

#include <stdio.h>

#include "core/cloud/cloud.h"
#include "server/cli/input.h"
#include "server/cli/options.h"

/* Tells of the cloud, which was read from these inputs, how many points would be kept, which files would be
 * written, and how much memory that takes at most.  How long it takes isn't known to the command: only the service
 * remembers jobs. */
void dry_run_print(const struct worker_options *options, const struct cloud *cloud, const struct worker_inputs *inputs,
                   FILE *to);

#endif
