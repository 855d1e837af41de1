/* What follows all that a file counts: padding, which editors, transfers and devices put there, or anything else.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_PADDING_H
#define WHITTLE_CORE_IO_PADDING_H

#include <stdbool.h>
#include <stddef.h>

/* The most that is looked at, so that of a file of known length no more has to be read. */
enum { PADDING_MOST_BYTES = 65536, PADDING_NOTE_BYTES = 64 };

/* How many of n bytes of text come before a mark of the end with nothing but padding after it; n: there is none. */
size_t padding_text_bytes(const char *text, size_t n);

/* How the report calls the n bytes, at least one, that follow the data: padding where all of them are zeros, blanks,
 * line ends or marks of an end (0x1A). */
void padding_note(char note[PADDING_NOTE_BYTES], const void *bytes, size_t n);

#endif
