/* Writing a picture as PNG.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PICTURE_PNG_WRITE_H
#define WHITTLE_CORE_PICTURE_PNG_WRITE_H

#include "core/picture/picture.h"

/* 8 bits of sRGB, no other chunks than those that all programs know.  fd stays open and isn't synced.  STATUS_IO (with
 * the reason), STATUS_NO_MEMORY. */
enum status picture_write_png(int fd, const struct picture *picture, struct error *error) MUST_CHECK;

#endif
