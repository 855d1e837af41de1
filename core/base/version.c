/* The build passes the version, from git or from a release's file, to this file alone: a new commit compiles one file.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/version.h"

#ifndef WHITTLE_VERSION
#define WHITTLE_VERSION "unknown"
#endif

const char *whittle_version(void) { return WHITTLE_VERSION; }
