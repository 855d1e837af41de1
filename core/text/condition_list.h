/* Conditions on the properties of a point: the value of the parameter `where`.
 *
 *     list      = condition { "," condition }            all hold
 *     condition = property operator number { "|" number }
 *     operator  = "==" | "=" | "!=" | "<" | "<=" | ">" | ">="
 *
 * Of several numbers == takes any, != none; the other operators take one.  A property's name has up to 63 printable
 * bytes that aren't blanks, commas, or of an operator.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TEXT_CONDITION_LIST_H
#define WHITTLE_CORE_TEXT_CONDITION_LIST_H

#include <stdbool.h>
#include <stddef.h>

enum {
    CONDITION_LIST_BYTES = 256 /* with its NUL */,
    CONDITION_NAME_BYTES = 64,
    CONDITION_MAX_NUMBERS = 32,
    CONDITIONS_MOST = 64 /* in a list that fits */
};

enum condition_relation { IS_EQUAL, IS_UNEQUAL, IS_BELOW, IS_AT_MOST, IS_ABOVE, IS_AT_LEAST };

struct condition {
    char name[CONDITION_NAME_BYTES];
    enum condition_relation relation;
    size_t count; /* of numbers, at least one */
    double number[CONDITION_MAX_NUMBERS];
};

/* Reads the condition at *at, which is moved behind it and its comma.  False where there is none, or it is none. */
bool condition_list_next(const char **at, struct condition *condition);

/* Whether the text is such a list and fits into CONDITION_LIST_BYTES. */
bool condition_list_is_valid(const char *text);

/* Whether it holds for a value; nothing but != holds for NaN. */
bool condition_holds(const struct condition *condition, double value);

#endif
