/* Names of properties: the value of the parameter `properties`.
 *
 *     list = "none" | name { "," name }          none there twice
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TEXT_NAME_LIST_H
#define WHITTLE_CORE_TEXT_NAME_LIST_H

#include <stdbool.h>
#include <stddef.h>

enum { NAME_LIST_BYTES = 512 /* with its NUL */, NAME_LIST_NAME_BYTES = 64 };

/* Reads the name at *at, which is moved behind it and its comma.  False where there is none, or it is none. */
bool name_list_next(const char **at, char name[NAME_LIST_NAME_BYTES]);

/* Whether the text is such a list and fits into NAME_LIST_BYTES. */
bool name_list_is_valid(const char *text);

#endif
