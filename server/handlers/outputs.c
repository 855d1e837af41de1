/* Outputs and logs: manifest, files, ranges.
 *
 * Outputs never change, so their tag is their hash and they may be cached for ever.  The points of a cloud come in the
 * order of their rank, so every coarser cloud is a prefix: it is copied out into a file without a name, which is gone
 * when it is sent, and has the tag and the digest of the job that would have made it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "api/codecs/job_json.h"
#include "api/codecs/report_read.h"
#include "core/io/prefix.h"
#include "core/tileset/archive_find.h"
#include "server/base/digest.h"
#include "server/handlers/handlers.h"
#include "server/handlers/outputs.h"

static const struct {
    const char *suffix, *media_type;
} media_types[] = {
    {".ply", "model/ply"},
    {".xyz", "text/plain; charset=utf-8"},
    {".json", "application/json"},
    {".obj", "model/obj"},
    {".stl", "model/stl"},
    {".glb", "model/gltf-binary"},
    {".png", "image/png"},
    {".3tz", "application/vnd.maxar.archive.3tz+zip"},
    {"", "application/octet-stream"},
};

const char *handlers_media_type(const char *name) {
    for (size_t i = 0;; i++) {
        size_t length = strlen(name), suffix = strlen(media_types[i].suffix);
        if (suffix <= length && strcmp(name + length - suffix, media_types[i].suffix) == 0)
            return media_types[i].media_type;
    }
}

/* ------------------------------------------------------------------------------------------------ files */

static void refuse_range(int fd, uint64_t bytes, struct response *response) {
    if (fd >= 0) close(fd);
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
static void output_file_name(const struct job *job, const char *name, char *text, size_t bytes) {
    size_t used = 0;
    for (const char *c = job->label; *c && used + 1 < bytes / 2; c++) {
        bool plain = isalnum((unsigned char)*c) && (unsigned char)*c < 0x80;
        if (plain || (used && text[used - 1] != '-')) text[used++] = plain ? *c : '-';
    }
    if (used && text[used - 1] != '-') text[used++] = '-';
    snprintf(text + used, bytes - used, "%s", name);
}

const struct job_output *handlers_find_output(const struct job *job, const char *name) {
    for (size_t i = 0; i < job->output_count; i++)
        if (strcmp(job->output[i].name, name) == 0) return &job->output[i];
    return NULL;
}

static const char for_ever[] = "private, max-age=31536000, immutable";

static void describe_output(const struct job *job, const struct job_output *output, struct response *response) {
    char digest[DIGEST_BASE64_BYTES], name[128];
    digest_base64(output->sha256, digest);
    output_file_name(job, output->name, name, sizeof name);
    response_header(response, "Content-Type", "%s", handlers_media_type(output->name));
    response_header(response, "Repr-Digest", "sha-256=:%s:", digest);
    response_header(response, "Content-Disposition", "attachment; filename=\"%s\"", name);
    response_header(response, "Cache-Control", "%s", for_ever);
}

/* What can't be opened for reading, as errno says: its store is away, or this host lacks something that it may have
 * later, and others now. */
static void refuse_unreadable(struct response *response, const char *what) {
    static const int lacks[] = {ENOSPC, EDQUOT, EFBIG, ENOMEM, EMFILE, ENFILE};
    int reason = errno;
    bool is_short = false;
    for (size_t i = 0; i < sizeof lacks / sizeof *lacks; i++) is_short = is_short || reason == lacks[i];
    if (reason == EHOSTUNREACH)
        response_refuse(response, PROBLEM_NOT_READY, "the store of outputs and clouds doesn't answer");
    else if (is_short)
        response_refuse(response, PROBLEM_NOT_READY, "this host can't take %s out of the store now: %s", what,
                        strerror(reason));
    else
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "%s can't be read", what);
}

void handlers_send_content(const struct request *request, const struct job *job, const struct job_output *output,
                           int fd, struct response *response) {
    char etag[DIGEST_HEX_BYTES + 2];
    snprintf(etag, sizeof etag, "\"%s\"", output->sha256);
    if (fd < 0) {
        refuse_unreadable(response, "the output");
    } else if (request_none_match(request, etag)) {
        close(fd);
        response_unchanged(response, etag, for_ever, output->bytes);
    } else {
        handlers_send_file(request, fd, output->bytes, etag, response);
        if (response->kind == RESPONSE_FILE) describe_output(job, output, response);
    }
}

/* Sends a program to the store itself, which tells the content by its own tag: so not who has named one of ours, and
 * no page of a browser, whose rules for other origins the store doesn't know. */
static bool redirect(struct service *service, const struct request *request, const struct job *job,
                     const struct job_output *output, struct response *response) {
    enum { LINK_S = 300 };
    char *url = malloc(BLOBS_LINK_BYTES), name[128], disposition[160];
    bool is_plain = strcmp(request->method, "GET") == 0 && !request->header[HEADER_IF_MATCH] &&
                    !request->header[HEADER_IF_RANGE] && !request->header[HEADER_SEC_FETCH_SITE];
    output_file_name(job, output->name, name, sizeof name);
    snprintf(disposition, sizeof disposition, "attachment; filename=\"%s\"", name);
    struct store_link link = {LINK_S, handlers_media_type(output->name), disposition, url};
    bool is_linked = !service->config->blob_redirect || !is_plain || !url ? false
                     : job->id[0] ? store_output_link(service->store, job->id, job->attempt, output->name, &link)
                                  : store_cloud_link(service->store, output->sha256, &link);
    if (!is_linked) {
        free(url);
        return false;
    }
    response_text(response, 302, "text/plain; charset=utf-8", strdup(""));
    response->location = url;
    response_header(response, "Cache-Control", "no-store");
    return true;
}

/* What lies in the store: an output of the job, or a cloud (job->id ""), called as the output says.  Of what lies
 * elsewhere no more is fetched than is sent; for HEAD, a byte. */
static void send_stored(struct service *service, const struct request *request, const struct job *job,
                        const struct job_output *output, struct response *response) {
    char etag[DIGEST_HEX_BYTES + 2];
    struct store_range range = {.of = output->bytes};
    snprintf(etag, sizeof etag, "\"%s\"", output->sha256);
    if (request_none_match(request, etag)) {
        response_unchanged(response, etag, for_ever, output->bytes);
        return;
    }
    if (redirect(service, request, job, output, response)) return;
    enum request_range kind = range_of(request, output->bytes, etag, &range.first, &range.last);
    if (kind == RANGE_UNSATISFIABLE) {
        refuse_range(-1, output->bytes, response);
        return;
    }
    if (request->head) range.first = range.last = 0;
    bool is_part = output->bytes && (kind != RANGE_NONE || request->head);
    const struct store_range *part = is_part ? &range : NULL;
    int fd = job->id[0] ? store_output_open_range(service->store, job->id, job->attempt, output, part)
                        : store_cloud_open_range(service->store, output->sha256, part);
    handlers_send_content(request, job, output, fd, response);
}

void handlers_send_cloud(struct service *service, const struct request *request, const struct job_output *output,
                         struct response *response) {
    struct job nameless = {0};
    send_stored(service, request, &nameless, output, response);
}

void handlers_send_output(struct service *service, const struct request *request, const struct job *job,
                          const char *name, struct response *response) {
    const struct job_output *output = handlers_find_output(job, name);
    if (output)
        send_stored(service, request, job, output, response);
    else
        response_refuse(response, PROBLEM_NO_SUCH_OUTPUT, "the job has no output %.80s", name);
}

/* ------------------------------------------------------------------------------------------------ coarser levels */

static const char *const level_names[] = {"points", "ratio", NULL};

static bool refuse_level(struct response *response, const char *name, const char *value, const char *allowed) {
    struct problem problem;
    problem_set(&problem, PROBLEM_INVALID_PARAMETER, "%s: takes %s", name, allowed);
    problem_add_error(&problem, name, value, allowed, NULL);
    response_problem(response, &problem);
    return false;
}

/* Reads points=N or ratio=r; both as in a job.  *asked is what was given, NULL = nothing: the whole output. */
static bool read_level(const struct request *request, const struct query_pair **asked, struct params *params,
                       struct response *response) {
    struct problem problem;
    bool ok = query_check(request->query, request->query_count, level_names, &problem);
    params_defaults(params);
    *asked = NULL;
    for (size_t i = 0; ok && i < request->query_count; i++) {
        query_decode_pair(&request->query[i], params, &problem);
        ok = problem.error_count == 0;
        *asked = &request->query[i];
    }
    if (ok && request->query_count > 1) {
        problem_set(&problem, PROBLEM_CONFLICTING_PARAMETERS, "points: conflicts with ratio; give one of them");
        problem_add_error(&problem, "points", NULL, "conflicts with ratio; give one of them", NULL);
        ok = false;
    }
    if (!ok) response_problem(response, &problem);
    return ok;
}

/* As many points as a job with this goal would keep of the same cloud. */
static uint64_t level_points(const struct job *job, const struct params *params) {
    struct report_headline facts;
    if (params->points) return params->points;
    report_read_headline(job->report, &facts);
    uint64_t wanted = (uint64_t)floor(params->ratio * (double)facts.points_in);
    if (facts.points_distinct && wanted > facts.points_distinct) wanted = facts.points_distinct;
    return wanted ? wanted : 1;
}

/* Makes a nameless file of the first points, and hashes it into *level.  -1: the response says why. */
static int make_level(struct service *service, const struct job *job, uint64_t points, struct job_output *level,
                      const struct query_pair *asked, struct response *response) {
    struct error error = {0};
    uint64_t held = 0;
    char allowed[80];
    int from = store_output_open_range(service->store, job->id, job->attempt, level, NULL),
        to = from < 0 ? -1 : scratch_nameless_open(store_scratch(service->store));
    if (to < 0) {
        refuse_unreadable(response, "the output");
        folders_close(from);
        return -1;
    }
    enum status status = cloud_prefix_copy(from, to, points, &held, &error);
    if (status == STATUS_OK && digest_file(to, level->sha256, &level->bytes) != 0)
        status = error_set(&error, STATUS_IO, "level", "can't read what was written");
    close(from);
    if (status == STATUS_OK) return to;
    close(to);
    snprintf(allowed, sizeof allowed, "1 to %llu points, those of this output", (unsigned long long)held);
    if (status == STATUS_LIMIT)
        refuse_level(response, asked->name, asked->value, allowed);
    else
        response_error(response, &error);
    return -1;
}

/* "cloud.ply" of 100 points is saved as "cloud-100.ply". */
static void name_level(struct job_output *level, uint64_t points) {
    char type[8];
    char *dot = strrchr(level->name, '.');
    snprintf(type, sizeof type, "%s", dot);
    snprintf(dot, sizeof level->name - (size_t)(dot - level->name), "-%llu%s", (unsigned long long)points, type);
}

static void send_level(struct service *service, const struct request *request, const struct job *job,
                       const struct params *params, const struct query_pair *asked, struct response *response) {
    const struct job_output *output = handlers_find_output(job, request->match.capture[1]);
    if (!output) {
        response_refuse(response, PROBLEM_NO_SUCH_OUTPUT, "the job has no output %.80s", request->match.capture[1]);
        return;
    }
    const char *type = strrchr(output->name, '.');
    bool is_las = type && (strcmp(type, ".las") == 0 || strcmp(type, ".laz") == 0);
    if (strncmp(output->name, "cloud", 5) != 0 || is_las) {
        refuse_level(response, asked->name, asked->value, "an output whose name begins with cloud, but LAS and LAZ");
        return;
    }
    struct job_output level = *output;
    uint64_t points = level_points(job, params);
    int fd = make_level(service, job, points, &level, asked, response);
    if (fd < 0) return;
    name_level(&level, points);
    handlers_send_content(request, job, &level, fd, response);
}

bool handlers_read_successful(struct service *service, const struct request *request, struct job *job,
                              struct response *response) {
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

static void list_outputs(struct service *service, struct request *request, struct response *response) {
    struct job job = {0};
    struct output_document documents[JOB_MAX_OUTPUTS];
    if (!handlers_takes_no_query(request, response)) return;
    if (handlers_read_successful(service, request, &job, response)) {
        for (size_t i = 0; i < job.output_count; i++)
            documents[i] = (struct output_document){.name = job.output[i].name,
                                                    .media_type = handlers_media_type(job.output[i].name),
                                                    .sha256 = job.output[i].sha256,
                                                    .bytes = job.output[i].bytes};
        response_text(response, 200, "application/json", job_outputs_encode(job.id, documents, job.output_count));
    }
    job_done(&job);
}

const struct handler handlers_list_outputs = {.run = list_outputs};

static void get_output(struct service *service, struct request *request, struct response *response) {
    struct job job;
    struct params level;
    const struct query_pair *asked;
    if (!read_level(request, &asked, &level, response)) return;
    if (handlers_read_successful(service, request, &job, response)) {
        if (asked)
            send_level(service, request, &job, &level, asked, response);
        else
            handlers_send_output(service, request, &job, request->match.capture[1], response);
    }
    job_done(&job);
}

const struct handler handlers_get_output = {.run = get_output};

/* ------------------------------------------------------------------------------------------------ tiles */

static const char TILESET[] = "tileset.3tz";

/* An output, some bytes of which are read at a time. */
struct reading {
    struct service *service;
    const struct job *job;
    const struct job_output *output;
};

static bool read_output(void *ctx, uint64_t at, void *to, size_t n) {
    const struct reading *r = ctx;
    const struct store_range range = {at, at + n - 1, r->output->bytes};
    if (!n) return true;
    int fd = store_output_open_range(r->service->store, r->job->id, r->job->attempt, r->output, &range);
    if (fd < 0) return false;
    bool whole = pread(fd, to, n, (off_t)at) == (ssize_t)n;
    close(fd);
    return whole;
}

/* The bytes of the archive that are this member: they lie in it as they are. */
static void send_member(struct service *service, const struct request *request, const struct job *job,
                        const struct job_output *output, const char *name, struct response *response) {
    struct reading reading = {service, job, output};
    uint64_t first = 0, count = 0;
    char etag[DIGEST_HEX_BYTES + 128];
    enum archive_found found = archive_find(read_output, &reading, output->bytes, name, &first, &count);
    snprintf(etag, sizeof etag, "\"%s-%s\"", output->sha256, strrchr(name, '/') ? strrchr(name, '/') + 1 : name);
    if (found == ARCHIVE_NOT_THERE) {
        response_refuse(response, PROBLEM_NO_SUCH_OUTPUT, "the tileset has no %.80s", name);
    } else if (found == ARCHIVE_FOUND && request_none_match(request, etag)) {
        response_unchanged(response, etag, for_ever, count);
    } else {
        const struct store_range range = {first, first + count - 1, output->bytes};
        int fd = found == ARCHIVE_FOUND && count
                     ? store_output_open_range(service->store, job->id, job->attempt, output, &range)
                     : -1;
        if (fd < 0) {
            refuse_unreadable(response, "the tileset");
            return;
        }
        response->kind = RESPONSE_FILE;
        response->fd = fd;
        response->file_offset = first;
        response->file_bytes = count;
        response_header(response, "ETag", "%s", etag);
        response_header(response, "Content-Type", "%s", handlers_media_type(name));
        response_header(response, "Cache-Control", "%s", for_ever);
    }
}

static void send_tileset(struct service *service, const struct request *request, const char *folder,
                         struct response *response) {
    struct job job = {0};
    char name[96];
    if (!handlers_takes_no_query(request, response)) return;
    snprintf(name, sizeof name, "%s%.64s", folder, request->match.capture[1]);
    if (handlers_read_successful(service, request, &job, response)) {
        const struct job_output *output = handlers_find_output(&job, TILESET);
        if (output)
            send_member(service, request, &job, output, name, response);
        else
            response_refuse(response, PROBLEM_NO_SUCH_OUTPUT, "the job has no output %s", TILESET);
    }
    job_done(&job);
}

static void get_tileset(struct service *service, struct request *request, struct response *response) {
    send_tileset(service, request, "", response);
}

static void get_tile(struct service *service, struct request *request, struct response *response) {
    send_tileset(service, request, "tiles/", response);
}

const struct handler handlers_get_tileset = {.run = get_tileset};
const struct handler handlers_get_tile = {.run = get_tile};

/* ------------------------------------------------------------------------------------------------ log */

static void get_log(struct service *service, struct request *request, struct response *response) {
    struct job job;
    struct stat facts;
    if (!handlers_takes_no_query(request, response)) return;
    if (handlers_read_job(service, request, request->match.capture[0], &job, response)) {
        int fd = service->is_shared ? store_log_gather(service->store, job.id)
                                    : store_log_open(service->store, job.id, false);
        uint64_t bytes = fd >= 0 && fstat(fd, &facts) == 0 ? (uint64_t)facts.st_size : 0;
        if (fd >= 0)
            handlers_send_file(request, fd, bytes, NULL, response);
        else if (service->is_shared && errno != ENOENT)
            refuse_unreadable(response, "the log");
        else
            response_text(response, 200, "text/plain; charset=utf-8", strdup("")); /* it has not begun */
        if (response->kind == RESPONSE_FILE) response_header(response, "Content-Type", "text/plain; charset=utf-8");
        response_header(response, "Cache-Control", "no-cache");
    }
    job_done(&job);
}

const struct handler handlers_get_log = {.run = get_log};
