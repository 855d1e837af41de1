/* Lists of columns.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/text/column_list.h"

#include <string.h>

bool column_list_next(const char **at, struct column_entry *entry) {
    if (!**at) return false;
    size_t n = strcspn(*at, ",");
    const char *colon = memchr(*at, ':', n);
    *entry = (struct column_entry){.name = *at, .name_bytes = colon ? (size_t)(colon - *at) : n};
    if (colon) {
        entry->column = colon + 1;
        entry->column_bytes = n - entry->name_bytes - 1;
    }
    *at += n + ((*at)[n] == ',');
    return true;
}

static bool is_name(const struct column_entry *entry, const char *name) {
    return entry->name_bytes == strlen(name) && memcmp(entry->name, name, entry->name_bytes) == 0;
}

static bool is_printable(const struct column_entry *entry) {
    for (size_t i = 0; i < entry->name_bytes; i++)
        if (entry->name[i] < 33 || entry->name[i] > 126) return false;
    for (size_t i = 0; i < entry->column_bytes; i++)
        if ((unsigned char)entry->column[i] < 32 || entry->column[i] == 127) return false;
    return true;
}

static bool is_there_before(const char *text, const struct column_entry *entry) {
    struct column_entry other;
    while (column_list_next(&text, &other) && other.name != entry->name)
        if (other.name_bytes == entry->name_bytes && memcmp(other.name, entry->name, entry->name_bytes) == 0)
            return true;
    return false;
}

bool column_list_is_valid(const char *text) {
    struct column_entry entry;
    size_t n = strlen(text);
    unsigned axes = 0;
    if (n == 0 || n >= COLUMN_LIST_BYTES || text[n - 1] == ',') return false;
    bool pairs = memchr(text, ':', strcspn(text, ",")) != NULL;
    for (const char *at = text; column_list_next(&at, &entry);) {
        bool left_out = is_name(&entry, "-");
        if (pairs != (entry.column != NULL) || (pairs && (left_out || !entry.column_bytes))) return false;
        if (!entry.name_bytes || entry.name_bytes >= COLUMN_NAME_BYTES || !is_printable(&entry)) return false;
        if (!left_out && is_there_before(text, &entry)) return false;
        for (unsigned axis = 0; axis < 3; axis++)
            if (is_name(&entry, (const char[2]){"xyz"[axis]})) axes |= 1u << axis;
    }
    return axes == 7;
}
