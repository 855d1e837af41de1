/* Weights of attributes: the value of the parameter `weights`.
 *
 *     list = pair { "," pair }
 *     pair = property ":" number        rgb for red, green and blue together; over 0, at most 100; none there twice
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TEXT_WEIGHT_LIST_H
#define WHITTLE_CORE_TEXT_WEIGHT_LIST_H

#include <stdbool.h>
#include <stddef.h>

enum { WEIGHT_LIST_BYTES = 256 /* with its NUL */, WEIGHT_NAME_BYTES = 64 };

struct weight_entry {
    char name[WEIGHT_NAME_BYTES];
    double weight;
};

/* Reads the pair at *at, which is moved behind it and its comma.  False where there is none, or it is none. */
bool weight_list_next(const char **at, struct weight_entry *entry);

/* Whether the text is such a list and fits into WEIGHT_LIST_BYTES. */
bool weight_list_is_valid(const char *text);

#endif
