/* The route table: which method on which path is which operation.
 *
 * HEAD is allowed wherever GET is and finds GET's operation.  A path is matched as it arrives, percent-decoded once; it
 * is never joined to a file's path.  A trailing slash is another path, and no route has one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_ROUTES_H
#define WHITTLE_API_ROUTES_H

#include <stddef.h>

enum operation {
#define ROUTE(operation, name, method, path, id, scope) OPERATION_##operation,
#include "api/routes.def"
    OPERATION_COUNT
};

/* What a principal needs for an operation; a set of the last three is what a principal has. */
enum routes_scope { ROUTES_PUBLIC = 0, ROUTES_SUBMIT = 1, ROUTES_READ = 2, ROUTES_ADMIN = 4 };
#define ROUTES_ALL_SCOPES 7

struct route {
    const char *method;
    const char *pattern; /* {name} stands for one non-empty part of the path */
    const char *operation_id;
    enum operation operation;
    enum routes_scope scope;
};

enum { ROUTES_MAX_CAPTURES = 2, ROUTES_CAPTURE_BYTES = 128, ROUTES_ALLOW_BYTES = 64 };

struct route_match {
    const struct route *route;                               /* NULL: no such path, or not with this method */
    char capture[ROUTES_MAX_CAPTURES][ROUTES_CAPTURE_BYTES]; /* in the order of the pattern; "" = none */
    char allow[ROUTES_ALLOW_BYTES];                          /* the path's methods, "GET, HEAD"; "" = no such path */
};

/* The table; *count rows. */
const struct route *routes_table(size_t *count);

/* Finds the route of a request.  O(routes x length of path). */
void routes_match(const char *method, const char *path, struct route_match *match);

#endif
