/* Parameters as JSON: derived from the table row by row, so a new row needs nothing here.
 *
 * JSON values are turned into the text that a query would hold and read by the table's own reader: there is one place
 * that decides what is allowed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/params_json.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/links.h"
#include "api/query.h"

enum { VALUE_BYTES = PARAMS_JSON_TEXT_BYTES, MAX_MEMBERS = 64 };

static json_t *flags_json(const char *text) {
    json_t *list = json_array();
    for (const char *item = text; *item;) {
        size_t length = strcspn(item, ",");
        json_array_append_new(list, json_stringn(item, length));
        item += length + (item[length] == ',');
    }
    return list;
}

static json_t *params_levels_json(const char *text) {
    json_t *list = json_array();
    for (char *end; *text; text = *end == ',' ? end + 1 : end)
        json_array_append_new(list, json_real(strtod(text, &end)));
    return list;
}

/* A value as params_format and default_text write it. */
static json_t *value_json(const struct param *param, const char *text) {
    switch (param->type) {
    case PARAM_NUMBER: return json_real(strtod(text, NULL));
    case PARAM_INTEGER: return json_integer(strtoll(text, NULL, 10));
    case PARAM_FLAGS:
    case PARAM_CONDITIONS:
    case PARAM_WEIGHTS:
    case PARAM_NAMES:
    case PARAM_COLUMNS: return flags_json(text);
    case PARAM_NUMBERS:
    case PARAM_LEVELS: return params_levels_json(text);
    case PARAM_CHOICE: break;
    }
    return json_string(text);
}

json_t *params_to_json(const struct params *params) {
    size_t count;
    const struct param *table = params_table(&count);
    json_t *json = json_object();
    for (size_t i = 0; i < count; i++) {
        char text[VALUE_BYTES];
        params_format(params, &table[i], text, sizeof text);
        if (text[0]) json_object_set_new(json, table[i].name, value_json(&table[i], text));
    }
    return json;
}

static bool is_list(const struct param *param) {
    return param->type != PARAM_NUMBER && param->type != PARAM_INTEGER && param->type != PARAM_CHOICE;
}

/* As JSON Schema has it, 5.0 is an integer. */
static bool is_whole(const json_t *value) {
    return json_is_integer(value) || (json_is_real(value) && rint(json_real_value(value)) == json_real_value(value));
}

/* Whether a value is of the JSON type that the schema says. */
static bool is_of_type(const struct param *param, const json_t *value) {
    size_t i;
    json_t *item;
    bool ok = json_is_array(value);
    switch (param->type) {
    case PARAM_NUMBER: return json_is_number(value);
    case PARAM_INTEGER: return is_whole(value);
    case PARAM_CHOICE: return json_is_string(value);
    case PARAM_FLAGS:
    case PARAM_CONDITIONS:
    case PARAM_WEIGHTS:
    case PARAM_NAMES:
    case PARAM_COLUMNS:
        json_array_foreach(value, i, item) ok = ok && json_is_string(item) && !strchr(json_string_value(item), ',');
        return ok;
    case PARAM_NUMBERS:
    case PARAM_LEVELS: json_array_foreach(value, i, item) ok = ok && json_is_number(item); return ok;
    }
    return false;
}

static void scalar_to_text(const json_t *value, char *text, size_t bytes) {
    if (json_is_integer(value))
        snprintf(text, bytes, "%lld", (long long)json_integer_value(value));
    else if (json_is_real(value))
        snprintf(text, bytes, "%.17g", json_real_value(value));
    else
        snprintf(text, bytes, "%s", json_is_string(value) ? json_string_value(value) : "?");
}

/* JSON text of a wrong type, which no parameter takes. */
static void dump_to_text(const json_t *value, char text[VALUE_BYTES]) {
    char *dump = json_dumps(value, JSON_COMPACT | JSON_ENCODE_ANY);
    snprintf(text, VALUE_BYTES, "%s", dump ? dump : "?");
    free(dump);
}

void params_json_text(const char *name, const json_t *value, char text[PARAMS_JSON_TEXT_BYTES]) {
    const struct param *param = params_find(name);
    size_t i, used = 0;
    json_t *item;
    text[0] = 0;
    if (!param || !is_of_type(param, value)) {
        dump_to_text(value, text);
        return;
    }
    if (!json_is_array(value)) {
        scalar_to_text(value, text, VALUE_BYTES);
        return;
    }
    json_array_foreach(value, i, item) {
        if (i && used + 1 < VALUE_BYTES) text[used++] = ',';
        scalar_to_text(item, text + used, VALUE_BYTES - used);
        used += strlen(text + used);
    }
}

/* How a list comes in JSON. */
static void describe_list(const struct param *param, char text[PROBLEM_ALLOWED_BYTES]) {
    static const char *const examples[] = {[PARAM_LEVELS] = "numbers, such as [0.2, 0.1]",
                                           [PARAM_NUMBERS] = "numbers, such as [0, 0, 1]",
                                           [PARAM_COLUMNS] = "texts, such as [\"-\", \"x\", \"y\", \"z\"]",
                                           [PARAM_CONDITIONS] = "texts, such as [\"intensity>100\", \"class==2|6\"]",
                                           [PARAM_WEIGHTS] = "texts, such as [\"rgb:0.2\", \"intensity:0.1\"]",
                                           [PARAM_NAMES] = "texts, such as [\"intensity\", \"class\"]"};
    if (param->type == PARAM_FLAGS)
        snprintf(text, PROBLEM_ALLOWED_BYTES, "an array of texts, such as [\"%s\", \"%s\"]", param->choices[0],
                 param->choices[1]);
    else
        snprintf(text, PROBLEM_ALLOWED_BYTES, "an array of %s", examples[param->type]);
}

/* A list that came as something else than an array of its items, which in a query are separated by commas. */
static void add_no_list(struct problem *problem, const struct param *param, const char *name, const char *value) {
    char allowed[PROBLEM_ALLOWED_BYTES];
    describe_list(param, allowed);
    if (!problem->error_count)
        problem_set(problem, PROBLEM_INVALID_PARAMETER, "%s: %.80s is not allowed; in JSON it takes %s", name, value,
                    allowed);
    problem_add_error(problem, name, value, allowed, NULL);
}

bool params_from_json(const json_t *json, struct params *params, struct problem *problem) {
    struct query_pair pairs[MAX_MEMBERS];
    char values[MAX_MEMBERS][VALUE_BYTES];
    const struct param *wrong[MAX_MEMBERS];
    const char *wrong_name[MAX_MEMBERS];
    size_t count = 0, wrong_count = 0;
    const char *name;
    json_t *value;
    if (!json_is_object(json) || json_object_size(json) > MAX_MEMBERS) {
        problem_set(problem, PROBLEM_INVALID_PARAMETER, "params: %s",
                    json_is_object(json) ? "too many members" : "not an object");
        return false;
    }
    json_object_foreach((json_t *)(uintptr_t)json, name, value) {
        const struct param *param = params_find(name);
        if (param && is_list(param) && !is_of_type(param, value)) {
            wrong[wrong_count] = param;
            wrong_name[wrong_count++] = name;
            continue;
        }
        params_json_text(name, value, values[count]);
        pairs[count] = (struct query_pair){name, values[count]};
        count++;
    }
    struct params found;
    bool ok = query_decode_params(pairs, count, NULL, &found, problem);
    for (size_t i = 0; i < wrong_count; i++) {
        char text[VALUE_BYTES];
        params_json_text(wrong_name[i], json_object_get(json, wrong_name[i]), text);
        add_no_list(problem, wrong[i], wrong_name[i], text);
    }
    if (!ok || wrong_count) return false;
    *params = found;
    return true;
}

/* ------------------------------------------------------------------------------------------------ schema */

static json_t *choices_json(const char *const *choices) {
    json_t *list = json_array();
    for (; *choices; choices++) json_array_append_new(list, json_string(*choices));
    return list;
}

static json_t *bound_json(const struct param *param, double value) {
    return param->type == PARAM_INTEGER ? json_integer((json_int_t)value) : json_real(value);
}

static void add_range(json_t *schema, const struct param *param) {
    json_object_set_new(schema, param->exclusive_min ? "exclusiveMinimum" : "minimum", bound_json(param, param->min));
    json_object_set_new(schema, "maximum", bound_json(param, param->max));
}

static void add_items(json_t *schema, json_t *items) {
    json_object_set_new(schema, "items", items);
    json_object_set_new(schema, "minItems", json_integer(1));
    json_object_set_new(schema, "uniqueItems", json_true());
}

static void add_type(json_t *schema, const struct param *param) {
    static const char *const names[] = {
        [PARAM_NUMBER] = "number", [PARAM_INTEGER] = "integer", [PARAM_CHOICE] = "string", [PARAM_FLAGS] = "array",
        [PARAM_LEVELS] = "array",  [PARAM_COLUMNS] = "array",   [PARAM_NUMBERS] = "array", [PARAM_CONDITIONS] = "array",
        [PARAM_WEIGHTS] = "array", [PARAM_NAMES] = "array"};
    json_object_set_new(schema, "type", json_string(names[param->type]));
    switch (param->type) {
    case PARAM_NUMBER:
    case PARAM_INTEGER: add_range(schema, param); break;
    case PARAM_CHOICE: json_object_set_new(schema, "enum", choices_json(param->choices)); break;
    case PARAM_FLAGS:
        add_items(schema, json_pack("{s:s, s:o}", "type", "string", "enum", choices_json(param->choices)));
        break;
    case PARAM_LEVELS:
        add_items(schema, json_pack("{s:s, s:o, s:o}", "type", "number", "exclusiveMinimum",
                                    bound_json(param, param->min), "maximum", bound_json(param, param->max)));
        json_object_set_new(schema, "maxItems", json_integer(PARAMS_MAX_LEVELS));
        break;
    case PARAM_COLUMNS:
        json_object_set_new(schema, "items", json_pack("{s:s, s:i}", "type", "string", "minLength", 1));
        json_object_set_new(schema, "minItems", json_integer(3));
        break;
    case PARAM_NUMBERS:
        json_object_set_new(schema, "items", json_pack("{s:s}", "type", "number"));
        json_object_set_new(schema, "minItems", json_integer((json_int_t)param->min));
        json_object_set_new(schema, "maxItems", json_integer((json_int_t)param->max));
        break;
    case PARAM_CONDITIONS:
    case PARAM_WEIGHTS:
        json_object_set_new(schema, "items", json_pack("{s:s, s:i}", "type", "string", "minLength", 3));
        json_object_set_new(schema, "minItems", json_integer(1));
        break;
    case PARAM_NAMES:
        json_object_set_new(schema, "items", json_pack("{s:s, s:i}", "type", "string", "minLength", 1));
        json_object_set_new(schema, "minItems", json_integer(1));
        break;
    }
}

static json_t *param_schema(const struct param *param) {
    json_t *schema = json_object();
    add_type(schema, param);
    if (param->default_text[0]) json_object_set_new(schema, "default", value_json(param, param->default_text));
    json_object_set_new(schema, "description", json_string(param->help));
    if (params_is_deprecated(param)) json_object_set_new(schema, "deprecated", json_true());
    if (param->unit[0]) json_object_set_new(schema, "x-unit", json_string(param->unit));
    json_object_set_new(schema, "x-affects-result", json_boolean(param->affects_result));
    return schema;
}

/* Without a default, which would conflict with what is given by the present name. */
static json_t *alias_schema(const struct param_alias *alias) {
    json_t *schema = json_object();
    const struct param *param = params_find(alias->of);
    add_type(schema, param);
    json_object_set_new(schema, "description", json_sprintf("Deprecated name of %s", alias->of));
    json_object_set_new(schema, "deprecated", json_true());
    json_object_set_new(schema, "x-affects-result", json_boolean(param->affects_result));
    return schema;
}

char *params_schema(void) {
    size_t count, alias_count;
    const struct param *table = params_table(&count);
    const struct param_alias *aliases = params_aliases(&alias_count);
    json_t *properties = json_object();
    for (size_t i = 0; i < count; i++) json_object_set_new(properties, table[i].name, param_schema(&table[i]));
    for (size_t i = 0; i < alias_count; i++)
        json_object_set_new(properties, aliases[i].name, alias_schema(&aliases[i]));
    json_t *schema =
        json_pack("{s:s, s:o, s:s, s:s, s:o, s:b}", "$schema", "https://json-schema.org/draft/2020-12/schema", "$id",
                  json_sprintf("%s/v1/parameters", links_base()), "title", "Parameters of a job", "type", "object",
                  "properties", properties, "additionalProperties", 0);
    char *text = schema ? json_dumps(schema, JSON_INDENT(2) | JSON_REAL_PRECISION(15)) : NULL;
    json_decref(schema);
    return text;
}
