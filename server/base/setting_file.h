/* Files that settings name: configuration, tokens, certificate, key, secret.
 *
 * They are read while the service runs, so reading must never wait: what isn't a regular file (a FIFO would wait for
 * its writer, a device for ever) is refused.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_SETTING_FILE_H
#define WHITTLE_SERVER_BASE_SETTING_FILE_H

#include <stddef.h>
#include <stdio.h>

#include "core/base/status.h"

enum { SETTING_FILE_MAX_BYTES = 1 << 20 };

/* Opens it for reading, without waiting.  STATUS_IO: it can't be read; STATUS_BAD_PARAMETER: it is no regular file; the
 * error's place is the setting's name. */
enum status setting_file_open(const char *setting, const char *path, FILE **file, struct error *error) MUST_CHECK;

/* Reads all of it; *text is the caller's to free, and ends in NUL.  STATUS_BAD_PARAMETER where it is longer than
 * SETTING_FILE_MAX_BYTES. */
enum status setting_file_read(const char *setting, const char *path, char **text, size_t *bytes,
                              struct error *error) MUST_CHECK;

#endif
