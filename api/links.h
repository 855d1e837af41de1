/* Links to what the service has: paths from its host's root, below the base path, if it has one.
 *
 * Behind a proxy the service may lie at https://host/whittle/.  Its base path is "/whittle" then: every link begins
 * with it, in documents, events and headers alike, and requests are understood with it and without it, so that a proxy
 * may pass the path on as it is or take the prefix away.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_LINKS_H
#define WHITTLE_API_LINKS_H

#include <stdbool.h>

enum { LINKS_BASE_BYTES = 64 };

/* Whether text may be a base path: "", or parts of letters, digits and -_.~ that each begin with a slash. */
bool links_base_valid(const char *text);

/* Sets the base path, which is valid; until then it is "".  To be called before links are made, by no two threads. */
void links_set_base(const char *base);

/* The base path. */
const char *links_base(void);

/* What follows the base path; the path itself where it isn't below it. */
const char *links_below_base(const char *path);

#endif
