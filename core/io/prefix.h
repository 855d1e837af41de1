/* The first n points of a cloud file that whittle wrote, as the file that it would have written of these n alone.
 *
 * The points of an output stand in the order of their rank, so a prefix is the coarser cloud: nothing is computed, the
 * header's count changes and the rest is copied.  Serves PLY (ascii, binary, with lists), binary PCD and XYZ text.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_PREFIX_H
#define WHITTLE_CORE_IO_PREFIX_H

#include <stdint.h>

#include "core/base/status.h"

/* Copies the first n > 0 points of the file at `from`, read from where it stands, to `to`.  Which format it is, its
 * first bytes tell.  STATUS_LIMIT: the file holds *held points only, fewer than n (what `to` holds then is of no use);
 * STATUS_MALFORMED: no file of ours; STATUS_IO, STATUS_NO_MEMORY.  *held is set on STATUS_LIMIT alone.  O(bytes of the
 * prefix). */
enum status cloud_prefix_copy(int from, int to, uint64_t n, uint64_t *held, struct error *error) MUST_CHECK;

#endif
