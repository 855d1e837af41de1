/* Problem documents (RFC 9457), application/problem+json: how every refusal and every failed job says what is wrong.
 *
 * One table gives each kind its slug, HTTP status, title and explanation; `type` is /problems/<slug>, a page made from
 * the same row.  A struct problem is plain memory on the caller's stack; texts that don't fit are cut.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_PROBLEM_H
#define WHITTLE_API_PROBLEM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum problem_kind {
#define PROBLEM(kind, slug, status, title, help) PROBLEM_##kind,
#include "api/problems.def"
    PROBLEM_COUNT
};

/* One row of the table. */
struct problem_type {
    const char *slug;
    int http_status;
    const char *title; /* short, the same for all of the kind */
    const char *help;  /* what a client can do about it */
};

enum { PROBLEM_MAX_MEMBERS = 12, PROBLEM_MAX_ERRORS = 16, PROBLEM_DETAIL_BYTES = 1024, PROBLEM_TEXT_BYTES = 256 };
enum { PROBLEM_ALLOWED_BYTES = 512 };

enum problem_member_type { PROBLEM_NUMBER, PROBLEM_TEXT, PROBLEM_LIST };

struct problem_member {
    char name[32];
    enum problem_member_type type;
    int64_t number;
    char text[PROBLEM_TEXT_BYTES]; /* a list's items are separated by commas */
};

struct problem_error {
    char parameter[64], value[64], allowed[PROBLEM_ALLOWED_BYTES], suggestion[64]; /* "" = left out */
};

struct problem {
    enum problem_kind kind;
    char detail[PROBLEM_DETAIL_BYTES];
    size_t member_count;
    struct problem_member member[PROBLEM_MAX_MEMBERS];
    size_t error_count;
    struct problem_error error[PROBLEM_MAX_ERRORS];
};

/* The row of a kind; of a slug (NULL where there is none). */
const struct problem_type *problem_type(enum problem_kind kind);
const struct problem_type *problem_type_of_slug(const char *slug);

/* Starts a problem: kind, and a printf-formatted sentence about this occurrence. */
void problem_set(struct problem *problem, enum problem_kind kind, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Extension members; dropped past PROBLEM_MAX_MEMBERS. */
void problem_add_number(struct problem *problem, const char *name, int64_t number);
void problem_add_text(struct problem *problem, const char *name, const char *text);
void problem_add_list(struct problem *problem, const char *name, const char *comma_separated);

/* One entry of `errors`; value, allowed and suggestion may be NULL.  Dropped past PROBLEM_MAX_ERRORS. */
void problem_add_error(struct problem *problem, const char *parameter, const char *value, const char *allowed,
                       const char *suggestion);

/* What a stage, a reader or a worker said, as a problem: kind by its status, text as detail, position as members. */
void problem_from_error(struct problem *problem, const struct error *error);

/* Returns new JSON text, or NULL when memory runs out. */
char *problem_encode(const struct problem *problem);

/* An encoded problem that was kept, with its links (type, log) below today's base path; returns new, NULL when memory
 * runs out or it is no JSON. */
char *problem_relocate(const char *json);

/* The `status` member of an encoded problem; 500 when it has none.  NULL is allowed. */
int problem_status_of(const char *json);

/* The explanation of a kind as an HTML page; returns new, NULL when memory runs out. */
char *problem_page(const struct problem_type *type);

#endif
