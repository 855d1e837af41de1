/* Padding: what editors, transfers and devices put after the data of a binary file, and nobody misses.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_PADDING_H
#define WHITTLE_CORE_IO_PADDING_H

#include <stdbool.h>
#include <stddef.h>

/* The most that is expected of a file of known length: more is rather data that its header doesn't know of. */
enum { PADDING_MOST_BYTES = 65536, PADDING_NOTE_BYTES = 64 };

/* Whether all of n bytes are zeros, blanks, line ends or marks of an end (0x1A). */
bool padding_is(const void *bytes, size_t n);

/* How many of n bytes of text come before a mark of the end with nothing but padding after it; n: there is none. */
size_t padding_text_bytes(const char *text, size_t n);

/* How the report calls n bytes of it. */
void padding_note(char note[PADDING_NOTE_BYTES], size_t n);

#endif
