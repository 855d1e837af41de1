/* Ways of writing values of parameters beside the table's own.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/params_written.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/text/number.h"

const char *params_written_count(const char *value, char text[PARAMS_WRITTEN_BYTES]) {
    static const char units[] = "kMG";
    char *end;
    if (!isdigit((unsigned char)value[0]) || strchr("xX", value[1])) return value;
    double count = number_read(value, &end);
    if (*end == 'K') count *= 1e3, end++;
    for (size_t i = 0; *end && units[i]; i++)
        if (*end == units[i]) {
            count *= pow(1000, (double)i + 1), end++;
            break;
        }
    if (*end || end == value || count != floor(count) || count > 0x1p53) return value;
    snprintf(text, PARAMS_WRITTEN_BYTES, "%.0f", count);
    return text;
}

/* Conditions without the blanks around their operators, commas and bars, in `text`. */
static const char *without_blanks(const char *value, char text[PARAMS_WRITTEN_BYTES]) {
    static const char between[] = "=!<>,|";
    size_t used = 0;
    if (strlen(value) >= PARAMS_WRITTEN_BYTES) return value;
    for (const char *at = value; *at;) {
        size_t blanks = strspn(at, " \t");
        bool bare = used == 0 || !at[blanks] || strchr(between, at[blanks]) || strchr(between, text[used - 1]);
        if (blanks && !bare) text[used++] = ' ';
        at += blanks;
        if (*at) text[used++] = *at++;
    }
    text[used] = 0;
    return text;
}

/* A share of something, as ratio and levels are: where it is said in percent, the same as a fraction, in `text`. */
static const char *as_fraction(const struct param *param, const char *value, char text[PARAMS_WRITTEN_BYTES]) {
    size_t used = 0;
    if (param->max != 1 || (param->type != PARAM_NUMBER && param->type != PARAM_LEVELS)) return value;
    for (const char *c = value; *c; c++) {
        bool is_end = *c == '%' && (!c[1] || c[1] == ',');
        int written = snprintf(text + used, PARAMS_WRITTEN_BYTES - used, is_end ? "e-2" : "%c", *c);
        used += (size_t)written; /* the decimal exponent makes the number that 0.07 is of 7%, to the last bit */
        if (used >= PARAMS_WRITTEN_BYTES) return value;
    }
    return used ? text : value;
}

const char *params_written(const struct param *param, const char *value, char text[PARAMS_WRITTEN_BYTES]) {
    if (param->type == PARAM_INTEGER) return params_written_count(value, text);
    if (param->type == PARAM_CONDITIONS) return without_blanks(value, text);
    return strchr(value, '%') ? as_fraction(param, value, text) : value;
}
