/* Whether memory ran out inside of the JSON library.
 *
 * jansson's reader goes on where it can't keep a byte of a string, so that what it reads then isn't what was sent, and
 * its writer takes text that it can't copy for text that is no UTF-8.  Who must not blame the client for that asks
 * here.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_JSON_MEMORY_H
#define WHITTLE_API_CODECS_JSON_MEMORY_H

#include <stdbool.h>

/* Makes the library's allocations seen; before its first use, with one thread. */
void json_memory_watch(void);

/* Forgets what was before, in this thread; whether an allocation has failed in it since. */
void json_memory_reset(void);
bool json_memory_failed(void);

#endif
