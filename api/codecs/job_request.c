/* What a request for a job says besides its query.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/job_request.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "api/codecs/json_memory.h"
#include "api/codecs/params_json.h"
#include "api/links.h"
#include "core/params.h"

static const char input_path[] = "/v1/clouds/";

/* The members that may stand beside `params`, of whichever operation. */
static const struct {
    const char *name;
    json_type type;
} members[] = {{"input", JSON_STRING}, {"params", JSON_OBJECT}, {"label", JSON_STRING},   {"join", JSON_ARRAY},
               {"clouds", JSON_ARRAY}, {"output", JSON_STRING}, {"webhook", JSON_STRING}, {"priority", JSON_INTEGER}};
enum { MEMBERS = sizeof members / sizeof members[0] };

static const char *type_name(json_type type) {
    return type == JSON_OBJECT    ? "an object"
           : type == JSON_ARRAY   ? "a list"
           : type == JSON_INTEGER ? "a whole number"
                                  : "a string";
}

bool job_request_add(struct job_request *request, const char *name, const char *value, size_t value_bytes,
                     struct problem *problem) {
    struct job_request_field *field = &request->field[request->count % JOB_REQUEST_MAX_FIELDS];
    const char *wrong = request->count == JOB_REQUEST_MAX_FIELDS ? "there are too many fields"
                        : strlen(name) >= sizeof field->name     ? "the name is too long"
                        : value_bytes >= sizeof field->value     ? "takes up to 511 bytes"
                        : memchr(value, 0, value_bytes)          ? "holds NUL"
                                                                 : NULL;
    if (wrong) {
        problem_set(problem, PROBLEM_INVALID_PARAMETER, "%.63s: %s", name, wrong);
        problem_add_error(problem, name, NULL, wrong, NULL);
        return false;
    }
    snprintf(field->name, sizeof field->name, "%s", name);
    memcpy(field->value, value, value_bytes);
    field->value[value_bytes] = 0;
    request->count++;
    return true;
}

/* ------------------------------------------------------------------------------------------------ faults */

/* Adds a fault; the first one is the problem's. */
static void add_fault(struct problem *problem, enum problem_kind kind, const char *path, const char *allowed,
                      const char *suggestion) {
    if (problem->error_count == 0) {
        const char *hint = suggestion ? "; did you mean " : "";
        problem_set(problem, kind, "%s: %s%s%s", path, kind == PROBLEM_UNKNOWN_PARAMETER ? "unknown member" : allowed,
                    hint, suggestion ? suggestion : "");
    }
    problem_add_error(problem, path, NULL, allowed, suggestion);
}

/* The same faults, each with the path of its parameter. */
static void by_path(struct problem *problem) {
    char text[sizeof problem->detail];
    for (size_t i = 0; i < problem->error_count; i++) {
        struct problem_error *error = &problem->error[i];
        snprintf(text, sizeof text, "params.%s", error->parameter);
        snprintf(error->parameter, sizeof error->parameter, "%.63s", text);
    }
    snprintf(text, sizeof text, "params.%.500s", problem->detail);
    memcpy(problem->detail, text, sizeof text);
}

/* ------------------------------------------------------------------------------------------------ params */

/* Every fault is told now, as far as params alone can tell; what they become together with a query is seen later. */
static bool read_params(struct job_request *request, const json_t *json, struct problem *problem) {
    struct params ignored;
    const char *name;
    json_t *value;
    if (!params_from_json(json, &ignored, problem)) {
        if (problem->error_count) by_path(problem);
        return false;
    }
    json_object_foreach((json_t *)(uintptr_t)json, name, value) {
        char text[PARAMS_JSON_TEXT_BYTES];
        params_json_text(name, value, text);
        if (!job_request_add(request, name, text, strlen(text), problem)) return false;
    }
    return true;
}

/* ------------------------------------------------------------------------------------------------ documents */

static json_t *parse(const char *text, size_t bytes, const char *what, struct problem *problem) {
    json_error_t error;
    json_memory_reset();
    json_t *json = json_loadb(text, bytes, JSON_REJECT_DUPLICATES, &error);
    bool no_memory = json_memory_failed();
    if (json && json_is_object(json) && !no_memory) return json;
    if (no_memory) {
        problem_set(problem, PROBLEM_INTERNAL_ERROR, "no memory");
    } else if (json) {
        problem_set(problem, PROBLEM_MALFORMED_REQUEST, "%s is JSON, but not an object", what);
    } else {
        problem_set(problem, PROBLEM_MALFORMED_REQUEST, "%s is no JSON: line %d, column %d: %s", what, error.line,
                    error.column, error.text);
        if (error.line > 0) problem_add_number(problem, "line", error.line);
        problem_add_number(problem, "byte_offset", error.position);
    }
    json_decref(json);
    return NULL;
}

/* Whether the operation takes several clouds, each for itself. */
static bool takes_clouds(const char *const *names) {
    while (names && *names && strcmp(*names, "clouds") != 0) names++;
    return names && *names;
}

static bool is_taken(const char *name, const char *const *names, const char *input) {
    if (takes_clouds(names) && (strcmp(name, "input") == 0 || strcmp(name, "join") == 0)) return false;
    for (; names && *names; names++)
        if (strcmp(name, *names) == 0) return true;
    return (!input && strcmp(name, "input") == 0) || strcmp(name, "params") == 0 || strcmp(name, "join") == 0;
}

/* Where a member that isn't known may have been meant to be. */
static void add_unknown(const char *name, const char *const *names, struct problem *problem) {
    char path[80];
    const char *near = params_suggest(name, names);
    static const char *const own[] = {"input", "join", "params", NULL};
    const char *first = params_suggest(name, own);
    for (size_t i = 0; first && own[i]; i++)
        if (strcmp(first, own[i]) == 0 && is_taken(first, names, NULL)) near = first;
    bool is_param = near && params_find(near);
    snprintf(path, sizeof path, "%s%s", is_param ? "params." : "", near ? near : "");
    add_fault(problem, PROBLEM_UNKNOWN_PARAMETER, name, NULL, near ? path : NULL);
}

/* Checks one member's name and type. */
static void check_member(const char *name, const json_t *value, const char *const *names, const char *input,
                         struct problem *problem) {
    size_t i = 0;
    while (i < MEMBERS && strcmp(members[i].name, name) != 0) i++;
    if (i < MEMBERS && input && strcmp(name, "input") == 0)
        add_fault(problem, PROBLEM_INVALID_PARAMETER, name, "not here: the path names the cloud", NULL);
    else if (i == MEMBERS || !is_taken(name, names, input))
        add_unknown(name, names, problem);
    else if (json_typeof(value) != members[i].type)
        add_fault(problem, PROBLEM_INVALID_PARAMETER, name, type_name(members[i].type), NULL);
}

/* The id in the path of a cloud; NULL: it isn't one, or isn't text. */
static const char *cloud_of(const json_t *value) {
    const char *given = json_string_value(value), *text = given ? links_below_base(given) : NULL;
    size_t prefix = sizeof input_path - 1;
    return text && strncmp(text, input_path, prefix) == 0 && strlen(text + prefix) == 64 ? text + prefix : NULL;
}

static void read_input(struct job_request *request, const json_t *value, struct problem *problem) {
    const char *id = cloud_of(value);
    if (!value)
        add_fault(problem, PROBLEM_INVALID_PARAMETER, "input", "must be there", NULL);
    else if (id)
        snprintf(request->input, sizeof request->input, "%s", id);
    else if (json_is_string(value)) /* else that was told */
        add_fault(problem, PROBLEM_INVALID_PARAMETER, "input", "the path of a cloud, /v1/clouds/ and its id", NULL);
}

static void read_joined(struct job_request *request, const json_t *list, struct problem *problem) {
    size_t count = json_is_array(list) ? json_array_size(list) : 0;
    if (count > JOB_REQUEST_MAX_JOINED) {
        add_fault(problem, PROBLEM_INVALID_PARAMETER, "join", "up to 255 clouds", NULL);
        return;
    }
    for (size_t i = 0; i < count; i++) {
        const char *id = cloud_of(json_array_get(list, i));
        char path[32];
        snprintf(path, sizeof path, "join[%zu]", i);
        if (id)
            snprintf(request->join[request->joined++], sizeof request->join[0], "%s", id);
        else
            add_fault(problem, PROBLEM_INVALID_PARAMETER, path, "the path of a cloud, /v1/clouds/ and its id", NULL);
    }
}

/* Reads the member `name`, a list: the first of them is the input, the others are behind it. */
static void read_clouds(struct job_request *request, const char *name, const json_t *list, struct problem *problem) {
    size_t count = json_is_array(list) ? json_array_size(list) : 0;
    if (!list)
        add_fault(problem, PROBLEM_INVALID_PARAMETER, name, "must be there", NULL);
    else if (json_is_array(list) && (count < 1 || count > JOB_REQUEST_MAX_JOINED + 1))
        add_fault(problem, PROBLEM_INVALID_PARAMETER, name, "1 to 256 clouds", NULL);
    else
        for (size_t i = 0; i < count; i++) {
            const char *id = cloud_of(json_array_get(list, i));
            char path[32];
            snprintf(path, sizeof path, "%s[%zu]", name, i);
            if (!id)
                add_fault(problem, PROBLEM_INVALID_PARAMETER, path, "the path of a cloud, /v1/clouds/ and its id",
                          NULL);
            else
                snprintf(i ? request->join[request->joined++] : request->input, sizeof request->input, "%s", id);
        }
}

/* Which cloud it is of, and which others are one with it. */
static void read_which(struct job_request *request, const json_t *json, const char *const *names, const char *input,
                       struct problem *problem) {
    const json_t *named = json_object_get(json, "input"), *join = json_object_get(json, "join");
    if (takes_clouds(names)) {
        read_clouds(request, "clouds", json_object_get(json, "clouds"), problem);
    } else if (!input && !named && join) {
        read_clouds(request, "join", join, problem);
    } else {
        if (input)
            snprintf(request->input, sizeof request->input, "%s", input);
        else
            read_input(request, named, problem);
        read_joined(request, join, problem);
    }
}

static bool add_member(struct job_request *request, const char *name, const json_t *value, struct problem *problem) {
    char text[32];
    if (strcmp(name, "input") == 0 || strcmp(name, "params") == 0 || strcmp(name, "join") == 0 ||
        strcmp(name, "clouds") == 0)
        return true;
    snprintf(text, sizeof text, "%lld", (long long)json_integer_value(value));
    const char *string = json_is_string(value) ? json_string_value(value) : text;
    return job_request_add(request, name, string, strlen(string), problem);
}

static bool read_document(struct job_request *request, json_t *json, const char *const *names, const char *input,
                          struct problem *problem) {
    const char *name;
    json_t *value, *params = json_object_get(json, "params");
    memset(problem, 0, sizeof *problem);
    json_object_foreach(json, name, value) check_member(name, value, names, input, problem);
    read_which(request, json, names, input, problem);
    if (problem->error_count) return false;
    if (params && !read_params(request, params, problem)) return false;
    json_object_foreach(json, name, value) if (!add_member(request, name, value, problem)) return false;
    return true;
}

bool job_request_read(struct job_request *request, const char *text, size_t bytes, const char *const *names,
                      const char *input, struct problem *problem) {
    json_t *json = parse(text, bytes, "the body", problem);
    bool ok = json && read_document(request, json, names, input, problem);
    json_decref(json);
    return ok;
}

bool job_request_read_params(struct job_request *request, const char *text, size_t bytes, struct problem *problem) {
    json_t *json = parse(text, bytes, "params", problem);
    bool ok = json && read_params(request, json, problem);
    json_decref(json);
    return ok;
}
