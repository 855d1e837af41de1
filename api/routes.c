/* The route table, and matching against it.
 *
 * A few dozen rows don't need a tree.  They stand in api/routes.def.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/routes.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>

static const struct route table[] = {
#define ROUTE(operation, name, method, path, id, scope) {method, path, id, OPERATION_##operation, ROUTES_##scope},
#include "api/routes.def"
};
enum { ROWS = OPERATION_COUNT };

const struct route *routes_table(size_t *count) {
    *count = ROWS;
    return table;
}

/* Matches one part of the path against one part of the pattern; a capture is stored. */
static bool match_part(const char *pattern, size_t pattern_length, const char *path, size_t path_length,
                       char *capture) {
    if (pattern[0] != '{') return pattern_length == path_length && memcmp(pattern, path, path_length) == 0;
    if (path_length == 0 || path_length >= ROUTES_CAPTURE_BYTES) return false;
    memcpy(capture, path, path_length);
    capture[path_length] = 0;
    return true;
}

static bool match_path(const char *pattern, const char *path, struct route_match *match) {
    size_t captures = 0;
    memset(match->capture, 0, sizeof match->capture);
    while (*pattern == '/' && *path == '/') {
        size_t pattern_length = strcspn(++pattern, "/"), path_length = strcspn(++path, "/");
        if (!match_part(pattern, pattern_length, path, path_length, match->capture[captures])) return false;
        captures += pattern[0] == '{';
        pattern += pattern_length;
        path += path_length;
    }
    return !*pattern && !*path;
}

static bool allows(const struct route *route, const char *method) {
    return strcmp(route->method, method) == 0 || (strcmp(method, "HEAD") == 0 && strcmp(route->method, "GET") == 0);
}

static void add_allowed(char *allow, const struct route *route) {
    size_t used = strlen(allow);
    snprintf(allow + used, ROUTES_ALLOW_BYTES - used, "%s%s%s", used ? ", " : "", route->method,
             strcmp(route->method, "GET") == 0 ? ", HEAD" : "");
}

void routes_match(const char *method, const char *path, struct route_match *match) {
    struct route_match found = {0};
    memset(match, 0, sizeof *match);
    for (size_t i = 0; i < ROWS; i++) {
        if (!match_path(table[i].pattern, path, &found)) continue;
        add_allowed(match->allow, &table[i]);
        if (match->route || !allows(&table[i], method)) continue;
        match->route = &table[i];
        memcpy(match->capture, found.capture, sizeof match->capture);
    }
}
