/* Conditions.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/text/condition_list.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/text/number.h"

static const char operator_letters[] = "=!<>";

/* The longer ones first, since they begin as the others do. */
static const struct {
    const char *text;
    enum condition_relation relation;
} operators[] = {{"==", IS_EQUAL}, {"!=", IS_UNEQUAL}, {"<=", IS_AT_MOST}, {">=", IS_AT_LEAST},
                 {"=", IS_EQUAL},  {"<", IS_BELOW},    {">", IS_ABOVE}};

static bool take_name(const char **at, struct condition *condition) {
    size_t n = 0;
    while ((*at)[n] > 32 && (*at)[n] < 127 && (*at)[n] != ',' && !strchr(operator_letters, (*at)[n])) n++;
    if (n == 0 || n >= CONDITION_NAME_BYTES) return false;
    memcpy(condition->name, *at, n);
    condition->name[n] = 0;
    *at += n;
    return true;
}

static bool take_operator(const char **at, struct condition *condition) {
    for (size_t i = 0; i < sizeof operators / sizeof *operators; i++) {
        size_t n = strlen(operators[i].text);
        if (strncmp(*at, operators[i].text, n) != 0) continue;
        condition->relation = operators[i].relation;
        *at += n;
        return true;
    }
    return false;
}

/* Digits, sign, point and exponent alone. */
static bool take_number(const char **at, double *number) {
    char text[CONDITION_LIST_BYTES], *end;
    size_t n = strspn(*at, "+-.0123456789eE");
    if (n == 0 || n >= sizeof text) return false;
    memcpy(text, *at, n);
    text[n] = 0;
    *number = number_read(text, &end);
    *at += n;
    return !*end && isfinite(*number);
}

bool condition_list_next(const char **at, struct condition *condition) {
    *condition = (struct condition){0};
    if (!take_name(at, condition) || !take_operator(at, condition)) return false;
    do {
        if (condition->count == CONDITION_MAX_NUMBERS) return false;
        if (!take_number(at, &condition->number[condition->count++])) return false;
    } while (**at == '|' && (*at)++);
    bool single = condition->relation != IS_EQUAL && condition->relation != IS_UNEQUAL;
    if ((single && condition->count > 1) || (**at && **at != ',') || (**at == ',' && !(*at)[1])) return false;
    *at += **at == ',';
    return true;
}

bool condition_list_is_valid(const char *text) {
    struct condition condition;
    size_t n = strlen(text);
    if (n == 0 || n >= CONDITION_LIST_BYTES) return false;
    while (*text)
        if (!condition_list_next(&text, &condition)) return false;
    return true;
}

bool condition_holds(const struct condition *condition, double value) {
    bool among = false;
    for (size_t i = 0; i < condition->count; i++) among |= value == condition->number[i];
    switch (condition->relation) {
    case IS_EQUAL: return among;
    case IS_UNEQUAL: return !among;
    case IS_BELOW: return value < condition->number[0];
    case IS_AT_MOST: return value <= condition->number[0];
    case IS_ABOVE: return value > condition->number[0];
    case IS_AT_LEAST: return value >= condition->number[0];
    }
    return false;
}
