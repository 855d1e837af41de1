/* Outputs and logs: manifest, files, ranges.
 *
 * Outputs never change, so their tag is their hash and they may be cached for ever.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <ctype.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "api/job_json.h"
#include "server/digest.h"
#include "server/handlers.h"

static const struct {
    const char *suffix, *media_type;
} media_types[] = {
    {".ply", "model/ply"},
    {".xyz", "text/plain; charset=utf-8"},
    {".json", "application/json"},
    {"", "application/octet-stream"},
};

static const char *media_type_of(const char *name) {
    for (size_t i = 0;; i++) {
        size_t length = strlen(name), suffix = strlen(media_types[i].suffix);
        if (suffix <= length && strcmp(name + length - suffix, media_types[i].suffix) == 0)
            return media_types[i].media_type;
    }
}

/* ------------------------------------------------------------------------------------------------ files */

static void refuse_range(int fd, uint64_t bytes, struct response *response) {
    close(fd);
    response_refuse(response, PROBLEM_RANGE_NOT_SATISFIABLE, "the content has %llu bytes", (unsigned long long)bytes);
    response_header(response, "Content-Range", "bytes */%llu", (unsigned long long)bytes);
}

/* A range counts only where If-Range, if there is one, names this very content. */
static enum request_range range_of(const struct request *request, uint64_t bytes, const char *etag, uint64_t *first,
                                   uint64_t *last) {
    const char *if_range = request->header[HEADER_IF_RANGE];
    if (if_range && (!etag || strcmp(if_range, etag) != 0)) return RANGE_NONE;
    return request_range(request, bytes, first, last);
}

void handlers_send_file(const struct request *request, int fd, uint64_t bytes, const char *etag,
                        struct response *response) {
    uint64_t first = 0, last = 0;
    enum request_range range = range_of(request, bytes, etag, &first, &last);
    if (range == RANGE_UNSATISFIABLE) {
        refuse_range(fd, bytes, response);
        return;
    }
    response->kind = RESPONSE_FILE;
    response->fd = fd;
    response->file_bytes = bytes;
    response_header(response, "Accept-Ranges", "bytes");
    if (etag) response_header(response, "ETag", "%s", etag);
    if (range == RANGE_NONE) return;
    response->status = 206;
    response->file_offset = first;
    response->file_bytes = last - first + 1;
    response_header(response, "Content-Range", "bytes %llu-%llu/%llu", (unsigned long long)first,
                    (unsigned long long)last, (unsigned long long)bytes);
}

/* ------------------------------------------------------------------------------------------------ outputs */

/* The label's plain characters before the output's name: "horse-10-mesh.ply". */
static void file_name(const struct job *job, const char *name, char *text, size_t bytes) {
    size_t used = 0;
    for (const char *c = job->label; *c && used + 1 < bytes / 2; c++) {
        bool plain = isalnum((unsigned char)*c) && (unsigned char)*c < 0x80;
        if (plain || (used && text[used - 1] != '-')) text[used++] = plain ? *c : '-';
    }
    if (used && text[used - 1] != '-') text[used++] = '-';
    snprintf(text + used, bytes - used, "%s", name);
}

static const struct job_output *find_output(const struct job *job, const char *name) {
    for (size_t i = 0; i < job->output_count; i++)
        if (strcmp(job->output[i].name, name) == 0) return &job->output[i];
    return NULL;
}

static void describe_output(const struct job *job, const struct job_output *output, struct response *response) {
    char digest[DIGEST_BASE64_BYTES], name[128];
    digest_base64(output->sha256, digest);
    file_name(job, output->name, name, sizeof name);
    response_header(response, "Content-Type", "%s", media_type_of(output->name));
    response_header(response, "Repr-Digest", "sha-256=:%s:", digest);
    response_header(response, "Content-Disposition", "attachment; filename=\"%s\"", name);
    response_header(response, "Cache-Control", "private, max-age=31536000, immutable");
}

void handlers_send_output(struct service *service, const struct request *request, const struct job *job,
                          const char *name, struct response *response) {
    const struct job_output *output = find_output(job, name);
    char etag[DIGEST_HEX_BYTES + 2];
    if (!output) {
        response_refuse(response, PROBLEM_NO_SUCH_OUTPUT, "the job has no output %.80s", name);
        return;
    }
    snprintf(etag, sizeof etag, "\"%s\"", output->sha256);
    if (request_none_match(request, etag)) {
        response->status = 304;
        response_header(response, "ETag", "%s", etag);
        return;
    }
    int fd = store_output_open(service->store, job->id, output->name);
    if (fd < 0) {
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "the output can't be read");
        return;
    }
    handlers_send_file(request, fd, output->bytes, etag, response);
    if (response->kind == RESPONSE_FILE) describe_output(job, output, response);
}

/* Reads the job and answers unless it was successful. */
static bool read_successful(struct service *service, const struct request *request, struct job *job,
                            struct response *response) {
    struct problem problem;
    memset(job, 0, sizeof *job);
    if (!query_check(request->query, request->query_count, NULL, &problem)) {
        response_problem(response, &problem);
        return false;
    }
    if (!handlers_read_job(service, request, request->match.capture[0], job, response)) return false;
    if (job->state == JOB_SUCCESSFUL) return true;
    if (job_ended(job->state)) {
        response_refuse(response, PROBLEM_NO_SUCH_OUTPUT, "the job is %s and has no outputs",
                        job_state_name(job->state));
        return false;
    }
    response_refuse(response, PROBLEM_RESULT_NOT_READY, "the job is %s", job_state_name(job->state));
    response_header(response, "Retry-After", "1");
    return false;
}

void handlers_list_outputs(struct service *service, struct request *request, struct response *response) {
    struct job job;
    struct output_document documents[JOB_MAX_OUTPUTS];
    if (read_successful(service, request, &job, response)) {
        for (size_t i = 0; i < job.output_count; i++)
            documents[i] = (struct output_document){.name = job.output[i].name,
                                                    .media_type = media_type_of(job.output[i].name),
                                                    .sha256 = job.output[i].sha256,
                                                    .bytes = job.output[i].bytes};
        response_text(response, 200, "application/json", job_outputs_encode(job.id, documents, job.output_count));
    }
    job_done(&job);
}

void handlers_get_output(struct service *service, struct request *request, struct response *response) {
    struct job job;
    if (read_successful(service, request, &job, response))
        handlers_send_output(service, request, &job, request->match.capture[1], response);
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ log */

void handlers_get_log(struct service *service, struct request *request, struct response *response) {
    struct job job;
    struct stat facts;
    struct problem problem;
    if (!query_check(request->query, request->query_count, NULL, &problem)) {
        response_problem(response, &problem);
        return;
    }
    if (handlers_read_job(service, request, request->match.capture[0], &job, response)) {
        int fd = store_log_open(service->store, job.id, false);
        uint64_t bytes = fd >= 0 && fstat(fd, &facts) == 0 ? (uint64_t)facts.st_size : 0;
        if (fd >= 0)
            handlers_send_file(request, fd, bytes, NULL, response);
        else
            response_text(response, 200, "text/plain; charset=utf-8", strdup("")); /* it has not begun */
        if (response->kind == RESPONSE_FILE) response_header(response, "Content-Type", "text/plain; charset=utf-8");
        response_header(response, "Cache-Control", "no-cache");
    }
    job_done(&job);
}
