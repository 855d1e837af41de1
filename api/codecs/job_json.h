/* The job document, and the other documents that list or describe: all JSON that the service answers with.
 *
 * The structs are views: they borrow everything.  Times are milliseconds since 1970 UTC, 0 = not yet (null).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_JOB_JSON_H
#define WHITTLE_API_CODECS_JOB_JSON_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/params.h"

struct job_document {
    const char *id, *status, *stage, *message, *label, *principal; /* principal: who submitted it, "" = null */
    double fraction;                                               /* 0 to 1; written as whole percent */
    uint64_t tiles, tiles_done; /* 0 = it is made in one piece, or not planned yet (null) */
    int64_t created_ms, started_ms, finished_ms, updated_ms, expires_ms;
    uint64_t ahead; /* jobs before it in the queue */
    int priority;
    double time_left_s; /* NAN = not known (null) */
    int attempt;
    const char *batch; /* its id; NULL or "" = null */
    const char *cloud; /* sha256 of the input */
    uint64_t input_points, input_bytes;
    const char *input_format;
    const struct params *params; /* resolved, as they were sent */
    uint64_t threads;            /* that it runs with, where the report doesn't say */
    double cpu_s, wall_s;
    uint64_t peak_rss_bytes;
    const char *report, *problem; /* JSON text; NULL or "" = null */
    bool has_outputs;
};

/* A time as text, "2026-01-31T12:00:00.123Z"; returns text. */
enum { JOB_JSON_TIME_BYTES = 40 };
const char *job_json_time(int64_t ms, char text[JOB_JSON_TIME_BYTES]);

/* Returns new text, NULL when memory runs out. */
char *job_encode(const struct job_document *job);

/* {"jobs":[...]}: the documents in the order given; returns new. */
char *job_list_encode(const struct job_document *jobs, size_t count);

struct output_document {
    const char *name, *media_type, *sha256;
    uint64_t bytes;
};

/* The manifest of a job's outputs; returns new. */
char *job_outputs_encode(const char *id, const struct output_document *outputs, size_t count);

/* A link that opens something until a time; returns new. */
char *job_link_encode(const char *href, int64_t expires_ms);

/* What goes into one server-sent event of kind progress or status; one line; returns new. */
char *job_event_encode(const struct job_document *job);

/* Names with numbers: next(ctx, i, &name, &value) is called for i = 0, 1, ... until false. */
struct job_info_list {
    bool (*next)(void *ctx, size_t i, const char **name, int64_t *value);
    void *ctx;
};

/* {"version":…,"formats":…,"limits":{…},"confinement":{…}} */
char *job_info_encode(const char *version, struct job_info_list limits, struct job_info_list confinement);

#endif
