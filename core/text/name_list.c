/* Names of properties.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/text/name_list.h"

#include <string.h>

bool name_list_next(const char **at, char name[NAME_LIST_NAME_BYTES]) {
    size_t n = strcspn(*at, ",");
    if (n == 0 || n >= NAME_LIST_NAME_BYTES || ((*at)[n] && !(*at)[n + 1])) return false;
    for (size_t i = 0; i < n; i++)
        if ((*at)[i] < 33 || (*at)[i] > 126) return false;
    memcpy(name, *at, n);
    name[n] = 0;
    *at += n + ((*at)[n] == ',');
    return true;
}

bool name_list_is_valid(const char *text) {
    char name[NAME_LIST_NAME_BYTES], other[NAME_LIST_NAME_BYTES];
    const char *at = text;
    size_t n = strlen(text);
    if (n == 0 || n >= NAME_LIST_BYTES) return false;
    while (*at) {
        const char *own = at, *before = text;
        if (!name_list_next(&at, name) || (strcmp(name, "none") == 0 && n != 4)) return false;
        while (before < own && name_list_next(&before, other))
            if (strcmp(other, name) == 0) return false;
    }
    return true;
}
