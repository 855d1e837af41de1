/* JSON (RFC 8259) as a flat table of its values, for readers of formats that have some.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_JSON_TEXT_H
#define WHITTLE_CORE_IO_FORMATS_JSON_TEXT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum json_kind { JSON_OBJECT, JSON_ARRAY, JSON_STRING, JSON_NUMBER, JSON_WORD /* true, false, null */ };

/* A value; what is in it follows it, of objects a name (a string) before each value. */
struct json_value {
    uint32_t start, length; /* in the text; of strings without quotes, escapes as they are */
    uint32_t after;         /* index of the next value that isn't in this one */
    enum json_kind kind;
};

struct json_text {
    const char *text; /* borrowed */
    struct json_value *value;
    size_t count; /* value[0] is the whole; owned */
};

#define JSON_NOTHING UINT32_MAX

/* Values are nested at most 64 deep and at most 2^31 bytes long.  *at = where something is wrong.  STATUS_MALFORMED,
 * STATUS_NO_MEMORY: nothing to free.  O(n). */
enum status jtext_parse(const char *text, size_t n, struct json_text *json, size_t *at) MUST_CHECK;
void jtext_done(struct json_text *json);

/* The value of that name in an object, JSON_NOTHING where there is none or `object` is none.  O(members). */
uint32_t jtext_member(const struct json_text *json, uint32_t object, const char *name);

/* The first and the next of what an array or an object holds: JSON_NOTHING at the end.  In an object names and values
 * take turns. */
uint32_t jtext_first(const struct json_text *json, uint32_t parent);
uint32_t jtext_next(const struct json_text *json, uint32_t parent, uint32_t value);

/* false: it is no number, or for the second no whole one from 0 to 2^53. */
bool jtext_f64(const struct json_text *json, uint32_t value, double *number);
bool jtext_whole(const struct json_text *json, uint32_t value, uint64_t *number);

bool jtext_is(const struct json_text *json, uint32_t value, const char *string);
bool jtext_begins(const struct json_text *json, uint32_t value, const char *string);

#endif
