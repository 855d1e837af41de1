/* Ways of writing values of parameters beside the table's own: 10% for 0.1, 10k for 10000, blanks in conditions.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PARAMS_WRITTEN_H
#define WHITTLE_CORE_PARAMS_WRITTEN_H

#include "core/params.h"

enum { PARAMS_WRITTEN_BYTES = 512 };

/* The value as the table's reader takes it: a share (ratio, levels) in percent as a fraction, a whole number with k, M
 * or G or an exponent in digits, conditions without the blanks around their operators.  `text`, or `value` itself where
 * it is written in none of these ways. */
const char *params_written(const struct param *param, const char *value, char text[PARAMS_WRITTEN_BYTES]);

/* A whole number that is said with k, M or G for thousands and so on, or with an exponent, in digits; the same way. */
const char *params_written_count(const char *value, char text[PARAMS_WRITTEN_BYTES]);

#endif
