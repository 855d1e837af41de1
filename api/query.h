/* Parameters from a query string.  Nothing is ignored: an unknown or a repeated name is refused, with the nearest name
 * that exists, and all faults of a query are reported at once.  A parameter that is a list may be repeated:
 * outputs=cloud&outputs=mesh is outputs=cloud,mesh.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_QUERY_H
#define WHITTLE_API_QUERY_H

#include <stdbool.h>
#include <stddef.h>

#include "api/problem.h"
#include "core/params.h"

/* One name=value, percent-decoded.  value is NULL where there was no '='. */
struct query_pair {
    const char *name, *value;
};

/* Reads parameters, defaults where a name is absent, and resolves them.  extra: further names (NULL-terminated, may be
 * NULL) that the operation takes and reads itself.  false: *problem says why, *params is untouched. */
bool query_decode_params(const struct query_pair *pairs, size_t count, const char *const *extra, struct params *params,
                         struct problem *problem);

/* Sets the parameter that the pair names, which there is; a value that isn't allowed is added to the problem. */
void query_decode_pair(const struct query_pair *pair, struct params *params, struct problem *problem);

/* For operations without parameters: only the names in extra may occur, each once. */
bool query_check(const struct query_pair *pairs, size_t count, const char *const *extra, struct problem *problem);

/* The value of a name ("" where it has none), or NULL when it is absent. */
const char *query_find(const struct query_pair *pairs, size_t count, const char *name);

/* Whether a value is text that JSON can hold, UTF-8. */
bool query_is_text(const char *value);

#endif
