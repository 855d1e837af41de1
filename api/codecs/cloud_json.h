/* The document of a cloud, and lists of them.
 *
 * The structs are views: they borrow everything.  Times are milliseconds since 1970 UTC.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_CLOUD_JSON_H
#define WHITTLE_API_CODECS_CLOUD_JSON_H

#include <stddef.h>
#include <stdint.h>

struct cloud_property {
    const char *name;
    const char *type;       /* of the value, or of a list's items: "float", "uchar", ... */
    const char *count_type; /* of a list's length; NULL: it is no list */
};

struct cloud_document {
    const char *sha256, *format;
    uint64_t bytes, points;         /* points 0 = not known, unless the report says */
    int64_t created_ms, expires_ms; /* expires 0 = null: with its last job */
    uint64_t jobs;                  /* that refer to it */
    const struct cloud_property *property;
    size_t property_count; /* 0 = not known (null) */
    const char *report;    /* of a job that has read it: points and bounding box are taken from there; NULL = none */
};

/* Returns new text, NULL when memory runs out. */
char *cloud_encode(const struct cloud_document *cloud);

/* {"clouds":[...]}: the documents in the order given; returns new. */
char *cloud_list_encode(const struct cloud_document *clouds, size_t count);

#endif
