/* Prints the tables of the contract as JSON, for tests and for `make contract`: {"routes": [{method, path, operation,
 * scope}], "problems": [{slug, status, title}]}.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <jansson.h>
#include <stdio.h>

#include "api/problem.h"
#include "api/routes.h"

static const char *scope_name(enum routes_scope scope) {
    switch (scope) {
    case ROUTES_PUBLIC: return "public";
    case ROUTES_SUBMIT: return "submit";
    case ROUTES_READ: return "read";
    case ROUTES_ADMIN: break;
    }
    return "admin";
}

static json_t *routes_json(void) {
    size_t count;
    const struct route *table = routes_table(&count);
    json_t *rows = json_array();
    for (size_t i = 0; i < count; i++)
        json_array_append_new(rows,
                              json_pack("{s:s, s:s, s:s, s:s}", "method", table[i].method, "path", table[i].pattern,
                                        "operation", table[i].operation_id, "scope", scope_name(table[i].scope)));
    return rows;
}

static json_t *problems_json(void) {
    json_t *rows = json_array();
    for (size_t kind = 0; kind < PROBLEM_COUNT; kind++) {
        const struct problem_type *type = problem_type((enum problem_kind)kind);
        json_array_append_new(
            rows, json_pack("{s:s, s:i, s:s}", "slug", type->slug, "status", type->http_status, "title", type->title));
    }
    return rows;
}

int main(void) {
    json_t *tables = json_pack("{s:o, s:o}", "routes", routes_json(), "problems", problems_json());
    int failed = json_dumpf(tables, stdout, JSON_INDENT(1)) || putchar('\n') == EOF || fflush(stdout);
    json_decref(tables);
    return failed ? 1 : 0;
}
