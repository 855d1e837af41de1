/* Problem documents: the table of kinds, and their JSON.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/problem.h"

#include <jansson.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/links.h"
#include "core/io/sniff.h"

static const struct problem_type types[PROBLEM_COUNT] = {
#define PROBLEM(kind, slug, status, title, help) {slug, status, title, help},
#include "api/problems.def"
};

/* Which kind a status from the core is. */
static const enum problem_kind kinds[STATUS_COUNT] = {
    [STATUS_OK] = PROBLEM_INTERNAL_ERROR,
    [STATUS_NO_MEMORY] = PROBLEM_OUT_OF_MEMORY,
    [STATUS_IO] = PROBLEM_INTERNAL_ERROR,
    [STATUS_UNSUPPORTED] = PROBLEM_UNSUPPORTED_FORMAT,
    [STATUS_MALFORMED] = PROBLEM_MALFORMED_CLOUD,
    [STATUS_DEGENERATE] = PROBLEM_DEGENERATE_CLOUD,
    [STATUS_BAD_PARAMETER] = PROBLEM_INVALID_PARAMETER,
    [STATUS_LIMIT] = PROBLEM_TOO_MANY_POINTS,
    [STATUS_CANCELLED] = PROBLEM_JOB_DISMISSED,
    [STATUS_ENGINE] = PROBLEM_ENGINE_ERROR,
    [STATUS_NO_SPACE] = PROBLEM_STORAGE_FULL,
};

const struct problem_type *problem_type(enum problem_kind kind) { return &types[kind]; }

const struct problem_type *problem_type_of_slug(const char *slug) {
    for (size_t i = 0; i < PROBLEM_COUNT; i++)
        if (strcmp(types[i].slug, slug) == 0) return &types[i];
    return NULL;
}

void problem_set(struct problem *problem, enum problem_kind kind, const char *format, ...) {
    memset(problem, 0, sizeof *problem);
    problem->kind = kind;
    va_list args;
    va_start(args, format);
    vsnprintf(problem->detail, sizeof problem->detail, format, args);
    va_end(args);
}

static void add_member(struct problem *problem, const char *name, enum problem_member_type type, int64_t number,
                       const char *text) {
    if (problem->member_count == PROBLEM_MAX_MEMBERS) return;
    struct problem_member *member = &problem->member[problem->member_count++];
    snprintf(member->name, sizeof member->name, "%s", name);
    snprintf(member->text, sizeof member->text, "%s", text);
    member->type = type;
    member->number = number;
}

void problem_add_number(struct problem *problem, const char *name, int64_t number) {
    add_member(problem, name, PROBLEM_NUMBER, number, "");
}
void problem_add_text(struct problem *problem, const char *name, const char *text) {
    add_member(problem, name, PROBLEM_TEXT, 0, text);
}
void problem_add_list(struct problem *problem, const char *name, const char *comma_separated) {
    add_member(problem, name, PROBLEM_LIST, 0, comma_separated);
}

void problem_add_error(struct problem *problem, const char *parameter, const char *value, const char *allowed,
                       const char *suggestion) {
    if (problem->error_count == PROBLEM_MAX_ERRORS) return;
    struct problem_error *error = &problem->error[problem->error_count++];
    snprintf(error->parameter, sizeof error->parameter, "%s", parameter);
    snprintf(error->value, sizeof error->value, "%s", value ? value : "");
    snprintf(error->allowed, sizeof error->allowed, "%s", allowed ? allowed : "");
    snprintf(error->suggestion, sizeof error->suggestion, "%s", suggestion ? suggestion : "");
}

void problem_from_error(struct problem *problem, const struct error *error) {
    enum problem_kind kind = (unsigned)error->code < STATUS_COUNT ? kinds[error->code] : PROBLEM_ENGINE_ERROR;
    bool is_named = kind == PROBLEM_INVALID_PARAMETER && error->where[0];
    problem_set(problem, kind, "%s%s%s", is_named ? error->where : "", is_named ? ": " : "", error->text);
    if (kind == PROBLEM_INVALID_PARAMETER) {
        problem_add_error(problem, error->where, NULL, error->text, NULL);
        return;
    }
    if (error->line) problem_add_number(problem, "line", (int64_t)error->line);
    if (error->byte_offset != UINT64_MAX) problem_add_number(problem, "byte_offset", (int64_t)error->byte_offset);
    if (error->where[0])
        problem_add_text(problem, kind == PROBLEM_MALFORMED_CLOUD ? "property" : "where", error->where);
    if (kind == PROBLEM_UNSUPPORTED_FORMAT) problem_add_list(problem, "supported", cloud_sniff_formats());
}

/* ------------------------------------------------------------------------------------------------ JSON */

/* Text from outside may be no UTF-8, which JSON can't hold: each byte that isn't ASCII becomes '?' then. */
static json_t *text_json(const char *text) {
    json_t *json = json_string(text);
    if (json) return json;
    char ascii[PROBLEM_DETAIL_BYTES];
    snprintf(ascii, sizeof ascii, "%s", text);
    for (char *p = ascii; *p; p++)
        if (*p & 0x80) *p = '?';
    return json_string(ascii);
}

static json_t *list_json(const char *comma_separated) {
    json_t *list = json_array();
    for (const char *item = comma_separated; list && *item;) {
        size_t length = strcspn(item, ",");
        json_array_append_new(list, json_stringn(item, length));
        item += length + (item[length] == ',');
    }
    return list;
}

static json_t *member_json(const struct problem_member *member) {
    switch (member->type) {
    case PROBLEM_NUMBER: return json_integer(member->number);
    case PROBLEM_LIST: return list_json(member->text);
    case PROBLEM_TEXT: break;
    }
    return text_json(member->text);
}

static json_t *error_json(const struct problem_error *error) {
    const struct {
        const char *name, *text;
    } part[] = {{"parameter", error->parameter},
                {"value", error->value},
                {"allowed", error->allowed},
                {"did_you_mean", error->suggestion}};
    json_t *json = json_object();
    for (size_t i = 0; i < sizeof part / sizeof *part; i++)
        if (part[i].text[0]) json_object_set_new(json, part[i].name, text_json(part[i].text));
    return json;
}

char *problem_encode(const struct problem *problem) {
    const struct problem_type *type = &types[problem->kind];
    json_t *json = json_object(), *errors = json_array();
    json_object_set_new(json, "type", json_sprintf("%s/problems/%s", links_base(), type->slug));
    json_object_set_new(json, "title", json_string(type->title));
    json_object_set_new(json, "status", json_integer(type->http_status));
    json_object_set_new(json, "detail", text_json(problem->detail));
    for (size_t i = 0; i < problem->member_count; i++)
        json_object_set_new(json, problem->member[i].name, member_json(&problem->member[i]));
    for (size_t i = 0; i < problem->error_count; i++) json_array_append_new(errors, error_json(&problem->error[i]));
    if (problem->error_count) json_object_set(json, "errors", errors);
    char *text = json_dumps(json, JSON_COMPACT);
    json_decref(errors);
    json_decref(json);
    return text;
}

/* Whatever stood before the path is replaced by the base path. */
static void relocate(json_t *json, const char *member, const char *path) {
    const char *link = json_string_value(json_object_get(json, member)), *found = link ? strstr(link, path) : NULL;
    if (found) json_object_set_new(json, member, json_sprintf("%s%s", links_base(), found));
}

char *problem_relocate(const char *text) {
    json_t *json = json_loads(text, 0, NULL);
    relocate(json, "type", "/problems/");
    relocate(json, "log", "/v1/jobs/");
    char *relocated = json ? json_dumps(json, JSON_COMPACT) : NULL;
    json_decref(json);
    return relocated;
}

int problem_status_of(const char *text) {
    json_t *json = text ? json_loads(text, 0, NULL) : NULL;
    json_int_t status = json_integer_value(json_object_get(json, "status"));
    json_decref(json);
    return status >= 400 && status <= 599 ? (int)status : 500;
}

char *problem_page(const struct problem_type *type) {
    char *page;
    int n = asprintf(&page,
                     "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n"
                     "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
                     "<meta name=\"color-scheme\" content=\"light dark\">\n<title>%s</title>\n"
                     "<style>body{font:16px/1.5 system-ui,sans-serif;max-width:46rem;margin:2rem auto;padding:0 1rem}"
                     "</style>\n"
                     "<h1>%s</h1>\n<p><code>%s</code>, HTTP status %d</p>\n<p>%s</p>\n"
                     "<p><a href=\"%s/\">whittled</a></p>\n</html>\n",
                     type->title, type->title, type->slug, type->http_status, type->help, links_base());
    return n < 0 ? NULL : page;
}
