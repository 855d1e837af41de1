/* A list that says what the columns of a text file are: the value of the parameter `columns`.
 *
 *     list  = names | pairs
 *     names = name { "," name }            of the first columns, in their order; "-" leaves a column out
 *     pairs = pair { "," pair }            columns that aren't mentioned keep their names
 *     pair  = name ":" column              a column's name in the file, or its number from 1
 *
 * x, y and z are among the names, and none is there twice.  A name has up to 63 printable bytes, none of them a blank;
 * a column may have any but commas.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TEXT_COLUMN_LIST_H
#define WHITTLE_CORE_TEXT_COLUMN_LIST_H

#include <stdbool.h>
#include <stddef.h>

enum { COLUMN_LIST_BYTES = 256 /* with its NUL */, COLUMN_NAME_BYTES = 64 };

struct column_entry {
    const char *name; /* in the list; no NUL follows */
    size_t name_bytes;
    const char *column; /* of a pair; NULL: the entry's place says which */
    size_t column_bytes;
};

/* The entry at *at of a list, which is moved behind it; false at the end. */
bool column_list_next(const char **at, struct column_entry *entry);

/* Whether the text is such a list and fits into COLUMN_LIST_BYTES. */
bool column_list_is_valid(const char *text);

#endif
