/* A stack of what is open; each value is added as it begins, and learns where it ends when it does.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/json_text.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/text/number.h"

enum { DEEPEST = 64, FIRST_VALUES = 256 };
static const size_t LONGEST = (size_t)1 << 31;

struct parser {
    struct json_text json;
    size_t capacity, n, at;
};

static bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }

static void jtext_skip_blanks(struct parser *p) {
    while (p->at < p->n && is_blank(p->json.text[p->at])) p->at++;
}

static char json_peek(const struct parser *p) { return p->at < p->n ? p->json.text[p->at] : '\0'; }

static enum status json_add(struct parser *p, enum json_kind kind, uint32_t *index) {
    struct json_text *json = &p->json;
    if (json->count == p->capacity) {
        size_t capacity = p->capacity ? 2 * p->capacity : FIRST_VALUES;
        struct json_value *value = alloc_resize(json->value, capacity, sizeof *value);
        if (!value) return STATUS_NO_MEMORY;
        json->value = value, p->capacity = capacity;
    }
    *index = (uint32_t)json->count;
    json->value[json->count++] = (struct json_value){(uint32_t)p->at, 0, *index + 1, kind};
    return STATUS_OK;
}

static enum status jtext_take_string(struct parser *p) {
    uint32_t i;
    if (json_peek(p) != '"') return STATUS_MALFORMED;
    p->at++;
    enum status status = json_add(p, JSON_STRING, &i);
    if (status) return status;
    for (; p->at < p->n && p->json.text[p->at] != '"'; p->at++) {
        if ((unsigned char)p->json.text[p->at] < ' ') return STATUS_MALFORMED;
        if (p->json.text[p->at] == '\\') p->at++;
    }
    if (p->at >= p->n) return STATUS_MALFORMED;
    p->json.value[i].length = (uint32_t)(p->at - p->json.value[i].start);
    p->at++;
    return STATUS_OK;
}

static enum status jtext_take_number(struct parser *p) {
    const char *from = p->json.text + p->at;
    double ignored;
    uint32_t i;
    char first = json_peek(p);
    if (first != '-' && (first < '0' || first > '9')) return STATUS_MALFORMED;
    const char *after = number_parse_f64(from, p->json.text + p->n, &ignored);
    if (!after) return STATUS_MALFORMED;
    enum status status = json_add(p, JSON_NUMBER, &i);
    if (status) return status;
    p->json.value[i].length = (uint32_t)(after - from);
    p->at += (size_t)(after - from);
    return STATUS_OK;
}

static enum status jtext_take_literal(struct parser *p) {
    static const char *const words[] = {"true", "false", "null"};
    uint32_t i;
    for (size_t k = 0; k < sizeof words / sizeof *words; k++) {
        size_t length = strlen(words[k]);
        if (p->n - p->at < length || memcmp(p->json.text + p->at, words[k], length) != 0) continue;
        enum status status = json_add(p, JSON_WORD, &i);
        if (status) return status;
        p->json.value[i].length = (uint32_t)length;
        p->at += length;
        return STATUS_OK;
    }
    return STATUS_MALFORMED;
}

/* A name and its colon. */
static enum status jtext_take_name(struct parser *p) {
    jtext_skip_blanks(p);
    enum status status = jtext_take_string(p);
    if (status) return status;
    jtext_skip_blanks(p);
    if (json_peek(p) != ':') return STATUS_MALFORMED;
    p->at++;
    return STATUS_OK;
}

/* What opens is put on the stack; *opened says whether anything did. */
static enum status json_take_value(struct parser *p, uint32_t *stack, size_t *depth, bool *opened) {
    jtext_skip_blanks(p);
    char c = json_peek(p);
    *opened = c == '{' || c == '[';
    if (c == '"') return jtext_take_string(p);
    if (c == 't' || c == 'f' || c == 'n') return jtext_take_literal(p);
    if (!*opened) return jtext_take_number(p);
    if (*depth == DEEPEST) return STATUS_MALFORMED;
    enum status status = json_add(p, c == '{' ? JSON_OBJECT : JSON_ARRAY, &stack[*depth]);
    if (!status) ++*depth, p->at++;
    return status;
}

/* After a value: what ends, ends; a comma, and the name after it, is taken. */
static enum status json_close(struct parser *p, const uint32_t *stack, size_t *depth, bool just_opened) {
    while (*depth > 0) {
        struct json_value *open = &p->json.value[stack[*depth - 1]];
        bool object = open->kind == JSON_OBJECT;
        jtext_skip_blanks(p);
        char c = json_peek(p);
        if (c == (object ? '}' : ']')) {
            p->at++;
            open->length = (uint32_t)(p->at - open->start);
            open->after = (uint32_t)p->json.count;
            --*depth, just_opened = false;
            continue;
        }
        if (!just_opened && c != ',') return STATUS_MALFORMED;
        if (!just_opened) p->at++;
        return object ? jtext_take_name(p) : STATUS_OK;
    }
    return STATUS_OK;
}

enum status jtext_parse(const char *text, size_t n, struct json_text *json, size_t *at) {
    struct parser p = {.json.text = text, .n = n};
    uint32_t stack[DEEPEST];
    size_t depth = 0;
    enum status status = n < LONGEST ? STATUS_OK : STATUS_MALFORMED;
    do {
        bool opened = false;
        if (!status) status = json_take_value(&p, stack, &depth, &opened);
        if (!status) status = json_close(&p, stack, &depth, opened);
    } while (!status && depth > 0);
    jtext_skip_blanks(&p);
    if (!status && p.at < n) status = STATUS_MALFORMED;
    *at = p.at;
    if (status)
        free(p.json.value);
    else
        *json = p.json;
    return status;
}

void jtext_done(struct json_text *json) {
    free(json->value);
    *json = (struct json_text){0};
}

uint32_t jtext_first(const struct json_text *json, uint32_t parent) {
    if (parent == JSON_NOTHING || json->value[parent].kind > JSON_ARRAY) return JSON_NOTHING;
    return parent + 1 < json->value[parent].after ? parent + 1 : JSON_NOTHING;
}

uint32_t jtext_next(const struct json_text *json, uint32_t parent, uint32_t value) {
    uint32_t next = json->value[value].after;
    return next < json->value[parent].after ? next : JSON_NOTHING;
}

bool jtext_is(const struct json_text *json, uint32_t value, const char *string) {
    return jtext_begins(json, value, string) && json->value[value].length == strlen(string);
}

bool jtext_begins(const struct json_text *json, uint32_t value, const char *string) {
    size_t n = strlen(string);
    if (value == JSON_NOTHING || json->value[value].kind != JSON_STRING) return false;
    return json->value[value].length >= n && memcmp(json->text + json->value[value].start, string, n) == 0;
}

uint32_t jtext_member(const struct json_text *json, uint32_t object, const char *name) {
    if (object == JSON_NOTHING || json->value[object].kind != JSON_OBJECT) return JSON_NOTHING;
    for (uint32_t key = jtext_first(json, object); key != JSON_NOTHING; key = jtext_next(json, object, key + 1))
        if (jtext_is(json, key, name)) return key + 1;
    return JSON_NOTHING;
}

bool jtext_f64(const struct json_text *json, uint32_t value, double *number) {
    if (value == JSON_NOTHING || json->value[value].kind != JSON_NUMBER) return false;
    const char *from = json->text + json->value[value].start;
    return number_parse_f64(from, from + json->value[value].length, number) != NULL;
}

bool jtext_whole(const struct json_text *json, uint32_t value, uint64_t *number) {
    double found;
    if (!jtext_f64(json, value, &found) || !(found >= 0 && found <= 0x1p53) || found != (double)(uint64_t)found)
        return false;
    *number = (uint64_t)found;
    return true;
}
