/* Bytes that nobody can guess.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_RANDOM_H
#define WHITTLE_SERVER_BASE_RANDOM_H

#include <stddef.h>

/* Of 16 bytes as hexadecimal digits, with a NUL: names, tokens. */
enum { RANDOM_NAME_BYTES = 33, RANDOM_MOST_BYTES = 256 };
void random_name(char name[RANDOM_NAME_BYTES]);

/* At most RANDOM_MOST_BYTES, which the kernel never cuts short. */
void random_fill(void *bytes, size_t n);

#endif
