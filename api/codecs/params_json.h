/* Parameters as JSON, and the table of parameters as a JSON Schema.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_PARAMS_JSON_H
#define WHITTLE_API_CODECS_PARAMS_JSON_H

#include <jansson.h>
#include <stdbool.h>

#include "api/problem.h"
#include "core/params.h"

/* Every parameter that has a value: numbers as numbers, choices as strings, flags as arrays of strings.  Returns new,
 * NULL when memory runs out. */
json_t *params_to_json(const struct params *params);

/* The other way round: defaults where a member is absent, then resolved.  Members of a wrong type or value, and unknown
 * ones, are all in problem->errors.  false: *params is untouched. */
bool params_from_json(const json_t *json, struct params *params, struct problem *problem);

/* The text that a query would hold for the value of the parameter of this name; of a value of a wrong type a text that
 * the parameter doesn't take. */
enum { PARAMS_JSON_TEXT_BYTES = PARAMS_TEXT_BYTES };
void params_json_text(const char *name, const json_t *value, char text[PARAMS_JSON_TEXT_BYTES]);

/* The table as JSON Schema 2020-12 (unit, default, range, choices and help for each); returns new text. */
char *params_schema(void);

#endif
