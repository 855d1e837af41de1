/* The document of a batch.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/batch_json.h"

#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/job_json.h"
#include "api/links.h"

/* How many of the jobs have this status. */
static size_t count_status(const struct batch_document *batch, const char *status) {
    size_t count = 0;
    for (size_t i = 0; i < batch->job_count; i++) count += strcmp(batch->job[i].status, status) == 0;
    return count;
}

const char *batch_status(const struct batch_document *batch) {
    size_t waits = count_status(batch, "accepted");
    if (waits && waits == batch->job_count && waits == batch->size) return "accepted";
    if (waits || count_status(batch, "running")) return "running";
    if (count_status(batch, "failed")) return "failed";
    return count_status(batch, "dismissed") ? "dismissed" : "successful";
}

static json_t *text_json(const char *text) { return text && *text ? json_string(text) : json_null(); }

static json_t *counts_json(const struct batch_document *batch) {
    static const char *const names[] = {"accepted", "running", "successful", "failed", "dismissed"};
    json_t *counts = json_pack("{s:I}", "total", (json_int_t)batch->size);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        json_object_set_new(counts, names[i], json_integer((json_int_t)count_status(batch, names[i])));
    json_object_set_new(counts, "deleted", json_integer((json_int_t)(batch->size - batch->job_count)));
    return counts;
}

static json_t *jobs_json(const struct batch_document *batch) {
    json_t *list = json_array();
    for (size_t i = 0; i < batch->job_count; i++) {
        const struct batch_document_job *job = &batch->job[i];
        json_array_append_new(list, json_pack("{s:s, s:s, s:I, s:o, s:o}", "id", job->id, "status", job->status,
                                              "progress", (json_int_t)(job->fraction * 100), "cloud",
                                              json_sprintf("%s/v1/clouds/%s", links_base(), job->cloud), "href",
                                              json_sprintf("%s/v1/jobs/%s", links_base(), job->id)));
    }
    return list;
}

static json_t *batch_links_json(const struct batch_document *batch) {
    const char *base = links_base(), *id = batch->id;
    return json_pack("[{s:s, s:o}, {s:s, s:o}, {s:s, s:o}]", "rel", "self", "href",
                     json_sprintf("%s/v1/batches/%s", base, id), "rel", "events", "href",
                     json_sprintf("%s/v1/batches/%s/events", base, id), "rel", "jobs", "href",
                     json_sprintf("%s/v1/jobs?batch=%s", base, id));
}

/* When the last job ended; 0 while one hasn't. */
static int64_t finished_of(const struct batch_document *batch) {
    int64_t last = 0;
    for (size_t i = 0; i < batch->job_count; i++) {
        if (!batch->job[i].finished_ms) return 0;
        if (batch->job[i].finished_ms > last) last = batch->job[i].finished_ms;
    }
    return last;
}

char *batch_encode(const struct batch_document *batch) {
    char created[JOB_JSON_TIME_BYTES], finished[JOB_JSON_TIME_BYTES] = "";
    double done = (double)(batch->size - batch->job_count);
    int64_t finished_ms = finished_of(batch);
    for (size_t i = 0; i < batch->job_count; i++) done += batch->job[i].finished_ms ? 1 : batch->job[i].fraction;
    if (finished_ms) job_json_time(finished_ms, finished);
    json_t *json = json_pack("{s:s, s:s, s:I, s:s, s:o, s:o, s:o, s:o, s:o}", "id", batch->id, "status",
                             batch_status(batch), "progress", (json_int_t)(100 * done / (double)batch->size), "created",
                             job_json_time(batch->created_ms, created), "finished", text_json(finished), "label",
                             text_json(batch->label), "principal", text_json(batch->principal), "counts",
                             counts_json(batch), "links", batch_links_json(batch));
    if (json && batch->with_jobs) json_object_set_new(json, "jobs", jobs_json(batch));
    char *text = json ? json_dumps(json, JSON_COMPACT) : NULL;
    json_decref(json);
    return text;
}

char *batch_list_encode(char *const *texts, size_t count) {
    char *text = NULL;
    size_t bytes;
    FILE *out = open_memstream(&text, &bytes);
    if (out) fputs("{\"batches\":[", out);
    bool ok = out != NULL;
    for (size_t i = 0; ok && i < count; i++) {
        ok = texts[i] != NULL;
        if (ok) fprintf(out, "%s%s", i ? "," : "", texts[i]);
    }
    if (out) fputs("]}", out);
    if (out && fclose(out) == 0 && ok) return text;
    free(text);
    return NULL;
}
