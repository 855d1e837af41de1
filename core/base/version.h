/* The version of this tree, as git describes it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_VERSION_H
#define WHITTLE_CORE_BASE_VERSION_H

/* Static text, never NULL. */
__attribute__((visibility("default"))) const char *whittle_version(void);

#endif
