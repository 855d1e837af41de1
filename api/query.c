/* Parameters from a query string.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/query.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "api/codecs/json_memory.h"

enum { QUERY_LIST_BYTES = 4096 };

static bool in_list(const char *name, const char *const *list) {
    for (; list && *list; list++)
        if (strcmp(*list, name) == 0) return true;
    return false;
}

/* Values of such a parameter stand behind commas, so that giving it again is giving more of them. */
static bool is_list(const struct param *param) {
    return param && (param->type == PARAM_FLAGS || param->type == PARAM_LEVELS || param->type == PARAM_NUMBERS ||
                     param->type == PARAM_CONDITIONS || param->type == PARAM_COLUMNS);
}

static bool seen_before(const struct query_pair *pairs, size_t i) {
    for (size_t j = 0; j < i; j++)
        if (strcmp(pairs[j].name, pairs[i].name) == 0) return true;
    return false;
}

/* Adds a fault to the problem; the first one gives it its kind. */
static void add_fault(struct problem *problem, enum problem_kind kind, const char *detail,
                      const struct problem_error *fault) {
    const char *name = fault->parameter[0] ? fault->parameter : "a parameter without a name";
    if (problem->error_count == 0) problem_set(problem, kind, "%s: %s", name, detail);
    problem_add_error(problem, fault->parameter, fault->value, fault->allowed, fault->suggestion);
}

static struct problem_error fault_of(const struct query_pair *pair) {
    struct problem_error fault = {0};
    snprintf(fault.parameter, sizeof fault.parameter, "%s", pair->name);
    snprintf(fault.value, sizeof fault.value, "%s", pair->value ? pair->value : "");
    return fault;
}

/* suggestion: NULL where nothing is near. */
static void add_unknown(struct problem *problem, const struct query_pair *pair, const char *suggestion) {
    struct problem_error fault = fault_of(pair);
    char detail[128] = "unknown parameter";
    if (suggestion) snprintf(detail, sizeof detail, "unknown parameter; did you mean %s?", suggestion);
    snprintf(fault.suggestion, sizeof fault.suggestion, "%s", suggestion ? suggestion : "");
    add_fault(problem, PROBLEM_UNKNOWN_PARAMETER, detail, &fault);
}

static void add_repeated(struct problem *problem, const struct query_pair *pair) {
    struct problem_error fault = fault_of(pair);
    snprintf(fault.allowed, sizeof fault.allowed, "once");
    add_fault(problem, PROBLEM_UNKNOWN_PARAMETER, "given more than once", &fault);
}

/* All values of pair i's name from i on, with commas between; false: there is no room for them. */
static bool join_values(const struct query_pair *pairs, size_t count, size_t i, char text[QUERY_LIST_BYTES]) {
    size_t used = 0;
    for (size_t j = i; j < count; j++) {
        if (strcmp(pairs[j].name, pairs[i].name) != 0) continue;
        int n = snprintf(text + used, QUERY_LIST_BYTES - used, "%s%s", j > i ? "," : "",
                         pairs[j].value ? pairs[j].value : "");
        if (n < 0 || (size_t)n >= QUERY_LIST_BYTES - used) return false;
        used += (size_t)n;
    }
    return true;
}

void query_decode_pair(const struct query_pair *pair, struct params *params, struct problem *problem) {
    struct error error = {0};
    if (params_set(params, pair->name, pair->value ? pair->value : "", &error) == STATUS_OK) return;
    struct problem_error fault = fault_of(pair);
    params_allowed(params_find(pair->name), fault.allowed, sizeof fault.allowed);
    add_fault(problem, PROBLEM_INVALID_PARAMETER, error.text, &fault);
}

/* The first pair of a list's name stands for all of them. */
static void decode_list(const struct query_pair *pairs, size_t count, size_t i, struct params *params,
                        struct problem *problem) {
    char text[QUERY_LIST_BYTES];
    struct query_pair whole = {pairs[i].name, text};
    bool repeated = false;
    for (size_t j = i + 1; j < count && !repeated; j++) repeated = strcmp(pairs[j].name, pairs[i].name) == 0;
    if (!repeated)
        query_decode_pair(&pairs[i], params, problem);
    else if (join_values(pairs, count, i, text))
        query_decode_pair(&whole, params, problem);
    else
        add_repeated(problem, &pairs[i]);
}

bool query_decode_params(const struct query_pair *pairs, size_t count, const char *const *extra, struct params *params,
                         struct problem *problem) {
    struct params found;
    struct error error = {0};
    params_defaults(&found);
    problem->error_count = 0;
    for (size_t i = 0; i < count; i++) {
        const struct param *param = params_find(pairs[i].name);
        if (is_list(param) && seen_before(pairs, i)) continue;
        if (!param && !in_list(pairs[i].name, extra))
            add_unknown(problem, &pairs[i], params_suggest(pairs[i].name, extra));
        else if (seen_before(pairs, i))
            add_repeated(problem, &pairs[i]);
        else if (is_list(param))
            decode_list(pairs, count, i, &found, problem);
        else if (param)
            query_decode_pair(&pairs[i], &found, problem);
    }
    if (problem->error_count) return false;
    struct params written = found;
    written.outputs |= OUTPUT_REPORT; /* of every job, which may not be one file too many */
    if (params_resolve(&written, &error) != STATUS_OK || params_resolve(&found, &error) != STATUS_OK) {
        problem_set(problem, PROBLEM_CONFLICTING_PARAMETERS, "%s: %s", error.where, error.text);
        problem_add_error(problem, error.where, query_find(pairs, count, error.where), error.text, NULL);
        return false;
    }
    *params = found;
    return true;
}

bool query_check(const struct query_pair *pairs, size_t count, const char *const *extra, struct problem *problem) {
    problem->error_count = 0;
    for (size_t i = 0; i < count; i++) {
        const char *near = params_suggest(pairs[i].name, extra);
        if (!in_list(pairs[i].name, extra))
            add_unknown(problem, &pairs[i], near && in_list(near, extra) ? near : NULL);
        else if (seen_before(pairs, i))
            add_repeated(problem, &pairs[i]);
    }
    return problem->error_count == 0;
}

const char *query_find(const struct query_pair *pairs, size_t count, const char *name) {
    for (size_t i = 0; i < count; i++)
        if (strcmp(pairs[i].name, name) == 0) return pairs[i].value ? pairs[i].value : "";
    return NULL;
}

bool query_is_text(const char *value) {
    json_memory_reset();
    json_t *json = json_string(value);
    bool is_text = json || json_memory_failed(); /* what can't be told is nobody's fault */
    json_decref(json);
    return is_text;
}
