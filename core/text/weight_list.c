/* Weights of attributes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/text/weight_list.h"

#include <string.h>

#include "core/text/number.h"

static const double MOST = 100;

bool weight_list_next(const char **at, struct weight_entry *entry) {
    char number[40], *end;
    size_t n = strcspn(*at, ":,"), digits;
    if (n == 0 || n >= sizeof entry->name || (*at)[n] != ':') return false;
    for (size_t i = 0; i < n; i++)
        if ((*at)[i] < 33 || (*at)[i] > 126) return false;
    memcpy(entry->name, *at, n);
    entry->name[n] = 0;
    const char *text = *at + n + 1;
    digits = strspn(text, "+-.0123456789eE");
    if (digits == 0 || digits >= sizeof number || (text[digits] && text[digits] != ',')) return false;
    memcpy(number, text, digits);
    number[digits] = 0;
    entry->weight = number_read(number, &end);
    if (*end || !(entry->weight > 0) || entry->weight > MOST || (text[digits] && !text[digits + 1])) return false;
    *at = text + digits + (text[digits] == ',');
    return true;
}

bool weight_list_is_valid(const char *text) {
    struct weight_entry entry, other;
    const char *at = text;
    size_t n = strlen(text);
    if (n == 0 || n >= WEIGHT_LIST_BYTES) return false;
    while (*at) {
        const char *own = at, *before = text;
        if (!weight_list_next(&at, &entry)) return false;
        while (before < own && weight_list_next(&before, &other))
            if (strcmp(other.name, entry.name) == 0) return false;
    }
    return true;
}
