/* The picture of a result, as a file and on a terminal.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_PREVIEW_H
#define WHITTLE_SERVER_CLI_PREVIEW_H

#include <stdio.h>

#include "core/picture/picture.h"
#include "core/pipeline/pipeline.h"
#include "server/cli/options.h"

/* Which axis of the cloud is upwards: as the parameters say, else as the file says, else as its points stand.  O(n). */
enum view_up preview_up(const struct params *params, const struct cloud *cloud);

/* Draws the finest level of a result that was made with OUTPUT_PREVIEW.  *picture is the caller's, for picture_done.
 * STATUS_NO_MEMORY. */
enum status preview_make(const struct params *params, const struct cloud *cloud, const struct pipeline_result *result,
                         struct picture *picture, struct error *error) MUST_CHECK;

/* Shows it on a terminal, by the way that was asked for, or one that the environment says the terminal knows; false
 * where it knows none, or memory ran out: then nothing was written. */
bool preview_show(const struct picture *picture, enum preview_way way, FILE *to);

#endif
