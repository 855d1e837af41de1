/* What a command line that means something else is told to use.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CLI_ADVICE_H
#define WHITTLE_SERVER_CLI_ADVICE_H

#include <stdbool.h>

#include "core/base/status.h"
#include "core/params.h"

/* The option that an unknown one, as it was written, is the name of in other programs; NULL: none that is known.
 * Static. */
const char *advice_option(const char *argument);

/* The sentence for an unknown option that no option of whittle stands for; NULL: none.  Static. */
const char *advice_way(const char *argument);

/* Adds to the error of a value that a parameter doesn't take what was probably meant.  next is the argument after it,
 * NULL where there is none. */
void advice_on_value(const struct param *param, const char *value, const char *next, struct error *error);

/* Whether a name can't be meant as one: an address, or a parameter without its dashes; the error says what to use. A
 * file that is there is a name, whatever it is called. */
bool advice_on_name(const char *name, struct error *error);

#endif
