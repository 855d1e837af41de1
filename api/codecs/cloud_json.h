/* The document of a cloud, and lists of them.
 *
 * The structs are views: they borrow everything.  Times are milliseconds since 1970 UTC.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_CLOUD_JSON_H
#define WHITTLE_API_CODECS_CLOUD_JSON_H

#include <stddef.h>
#include <stdint.h>

#include "api/problem.h"
#include "core/params.h"

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
    size_t property_count;  /* 0 = not known (null) */
    const char *report;     /* of a job that has read it: points and bounding box are taken from there; NULL = none */
    uint64_t header_points; /* that a header promises where no job has counted them; 0 = none */
    const double *header_min, *header_max; /* the box that it tells, 3 numbers each; NULL = none */
};

/* What a job on a cloud would be: all of it known before it runs. */
struct plan_document {
    struct cloud_document cloud;
    const struct params *params;   /* resolved */
    uint64_t memory_bytes;         /* predicted peak; 0 = not known */
    uint64_t memory_limit_bytes;   /* what a job may take here */
    double seconds;                /* of its run, waiting not included; NAN = not known */
    const struct problem *problem; /* why it would be refused; NULL = it wouldn't */
};

/* Each returns new text, NULL when memory runs out. */
char *plan_encode(const struct plan_document *plan);
char *cloud_encode(const struct cloud_document *cloud);

/* {"clouds":[...]}: the documents in the order given; returns new. */
char *cloud_list_encode(const struct cloud_document *clouds, size_t count);

#endif
