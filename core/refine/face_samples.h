/* Samples of a surface that is known.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_FACE_SAMPLES_H
#define WHITTLE_CORE_REFINE_FACE_SAMPLES_H

#include "core/refine/samples.h"

/* As samples_init, of input->faces: the middles of equal parts of each triangle, more of one that is larger than most;
 * parts 0: the points alone.  A point on no face counts for nothing.  O(n + faces).  STATUS_NO_MEMORY. */
enum status face_samples_init(struct samples *samples, const struct refine_input *input, unsigned parts,
                              unsigned threads) MUST_CHECK;

#endif
