/* The base path: written once, before there are other threads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/links.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

static char base_path[LINKS_BASE_BYTES];

bool links_base_valid(const char *text) {
    static const char allowed[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.~";
    if (strlen(text) >= LINKS_BASE_BYTES) return false;
    while (*text == '/') {
        size_t length = strspn(++text, allowed);
        if (strspn(text, ".") == length) return false; /* nothing, "." and ".." */
        text += length;
    }
    return !*text;
}

void links_set_base(const char *base) {
    assert(links_base_valid(base));
    snprintf(base_path, sizeof base_path, "%s", base);
}

const char *links_base(void) { return base_path; }

const char *links_below_base(const char *path) {
    size_t length = strlen(base_path);
    bool below = strncmp(path, base_path, length) == 0 && path[length] == '/';
    return below ? path + length : path;
}
