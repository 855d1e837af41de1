/* The document of a batch: jobs that came together.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_BATCH_JSON_H
#define WHITTLE_API_CODECS_BATCH_JSON_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A view: all texts are borrowed. */
struct batch_document {
    const char *id, *label, *principal; /* the last two: NULL or "" = null */
    int64_t created_ms;
    size_t size, job_count; /* jobs that it was made of, and those that are there still */
    const struct batch_document_job {
        const char *id, *status, *cloud; /* cloud: sha256 */
        double fraction;
        int64_t finished_ms;
    } * job;
    bool with_jobs; /* each is named */
};

/* What becomes of the jobs together: "accepted" while none has begun, "running" until all have ended; then "failed" if
 * one has failed, "dismissed" if one was, else "successful". */
const char *batch_status(const struct batch_document *batch);

/* Returns new text, NULL when memory runs out. */
char *batch_encode(const struct batch_document *batch);

/* {"batches":[...]} of their texts, in the order given; returns new. */
char *batch_list_encode(char *const *texts, size_t count);

#endif
