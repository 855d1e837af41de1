/* Words and lines on a picture.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PICTURE_LETTERING_H
#define WHITTLE_CORE_PICTURE_LETTERING_H

#include <stddef.h>

#include "core/picture/picture.h"

/* How wide a text of figures of this height is, in pixels. */
double lettering_width(const char *text, double height);

/* Writes text with its baseline at y, from x on, in figures of this height.  Digits, lower-case letters and the signs
 * of numbers have a form; anything else is a gap.  What is outside of the picture is left out. */
void lettering_write(struct picture *picture, double x, double y, double height, const unsigned char colour[3],
                     const char *text);

/* A line of this width between two places, with round ends. */
void lettering_line(struct picture *picture, double ax, double ay, double bx, double by, double width,
                    const unsigned char colour[3]);

#endif
