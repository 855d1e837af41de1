/* Clouds: upload once, describe, list, delete, give back.
 *
 * What a document says of a cloud's properties is read from the header whenever it is asked for; points and a bounding
 * box that no header tells are known once a job has read the cloud.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "api/codecs/cloud_json.h"
#include "api/links.h"
#include "api/query.h"
#include "core/io/formats/las_fields.h"
#include "core/io/formats/ply_header.h"
#include "server/base/wall_clock.h"
#include "server/catalog/catalog.h"
#include "server/handlers/handlers.h"
#include "server/handlers/keys.h"
#include "server/handlers/outputs.h"

/* ------------------------------------------------------------------------------------------------ documents */

/* What the header of a PLY, LAS or LAZ file tells; `list` names what the other fields hold. */
struct told {
    struct ply_header ply;
    struct las_summary las;
    struct las_field field[LAS_FIELDS];
    struct cloud_property *list;
    size_t count;
};

static const char *const types[SCALAR_TYPE_COUNT] = {"char", "uchar", "short", "ushort",
                                                     "int",  "uint",  "float", "double"};

static void describe_ply(struct told *told) {
    const struct ply_element *vertex = &told->ply.element[told->ply.vertex];
    told->list = calloc(vertex->property_count, sizeof *told->list);
    if (!told->list) return;
    told->count = vertex->property_count;
    for (size_t i = 0; i < told->count; i++) {
        const struct property *property = &told->ply.property[vertex->first + i];
        told->list[i] = (struct cloud_property){property->name, types[property->type],
                                                property->is_list ? types[property->count_type] : NULL};
    }
}

/* Places and integers of 64 bits are read as double.  Extra bytes, which records behind the header describe, aren't
 * told. */
static void describe_las(struct told *told) {
    size_t fields = las_format_fields(told->las.format, told->field);
    told->list = calloc(3 + fields, sizeof *told->list);
    if (!told->list) return;
    told->count = 3 + fields;
    for (size_t axis = 0; axis < 3; axis++)
        told->list[axis] = (struct cloud_property){(const char *const[]){"x", "y", "z"}[axis], "double", NULL};
    for (size_t i = 0; i < fields; i++) {
        unsigned type = told->field[i].type < SCALAR_TYPE_COUNT ? told->field[i].type : SCALAR_FLOAT64;
        told->list[3 + i] = (struct cloud_property){told->field[i].name, types[type], NULL};
    }
}

static bool is_las(const struct catalog_cloud *record) {
    return strcmp(record->format, "las") == 0 || strcmp(record->format, "laz") == 0;
}

static void read_header(struct service *service, const struct catalog_cloud *record, struct told *told) {
    memset(told, 0, sizeof *told);
    bool is_ply = strncmp(record->format, "ply/", 4) == 0;
    if (!is_ply && !is_las(record)) return;
    const size_t longest = is_ply ? PLY_HEADER_MAX_BYTES : LAS_HEADER_BYTES;
    const uint64_t most = record->bytes < longest ? record->bytes : longest;
    const struct store_range range = {0, most - 1, record->bytes};
    int fd = most ? store_cloud_open_range(service->store, record->sha256, &range) : -1;
    char *head = malloc(longest);
    ssize_t n = fd >= 0 && head ? pread(fd, head, most, 0) : -1;
    struct error error = {0};
    if (n > 0 && is_ply && ply_header_parse(head, (size_t)n, &told->ply, &error) == STATUS_OK) describe_ply(told);
    if (n > 0 && !is_ply && las_summary_of(head, (size_t)n, &told->las)) describe_las(told);
    free(head);
    if (fd >= 0) close(fd);
}

static void told_done(struct told *told) {
    free(told->list);
    ply_header_done(&told->ply);
}

static struct cloud_document document_of(const struct catalog_cloud *record, const struct told *told) {
    return (struct cloud_document){.sha256 = record->sha256,
                                   .format = record->format,
                                   .bytes = record->bytes,
                                   .points = record->points,
                                   .created_ms = record->created_ms,
                                   .expires_ms = record->expires_ms,
                                   .jobs = record->jobs,
                                   .property = told->list,
                                   .property_count = told->count,
                                   .report = record->report,
                                   .header_points = told->las.points,
                                   .header_min = told->las.has_box ? told->las.min : NULL,
                                   .header_max = told->las.has_box ? told->las.max : NULL};
}

static void answer_cloud(struct service *service, const struct catalog_cloud *record, int status,
                         struct response *response) {
    struct told told;
    read_header(service, record, &told);
    struct cloud_document document = document_of(record, &told);
    response_text(response, status, "application/json", cloud_encode(&document));
    response_header(response, "Cache-Control", "no-cache");
    told_done(&told);
}

/* ------------------------------------------------------------------------------------------------ find */

/* Whose clouds the request may see: NULL = everybody's. */
static const char *owner_of(const struct request *request) {
    return request->principal.scopes & ROUTES_ADMIN ? NULL : request->principal.name;
}

bool handlers_read_cloud(struct service *service, const struct request *request, const char *id,
                         struct catalog_cloud *record, struct response *response) {
    struct error error = {0};
    bool found = false;
    memset(record, 0, sizeof *record);
    if (catalog_cloud_id_valid(id) &&
        catalog_get_cloud(service->catalog, id, owner_of(request), record, &found, &error) != STATUS_OK) {
        response_error(response, &error);
        return false;
    }
    if (!found) response_refuse(response, PROBLEM_NO_SUCH_CLOUD, "there is no cloud %.64s", id);
    return found;
}

/* ------------------------------------------------------------------------------------------------ create */

static bool admit_new_cloud(struct service *service, struct request *request, struct response *response) {
    return handlers_takes_no_query(request, response) &&
           handlers_admit_body(service, request, BODY_CLOUD | BODY_FORM, NULL, NULL, response);
}

/* Keeps the uploaded cloud, and under which key it came.  false: the response says why not. */
static bool keep_cloud(struct service *service, struct request *request, const struct upload_facts *facts,
                       const struct job_key *key, bool *known, struct response *response) {
    struct error error = {0};
    enum status status =
        service_keep_cloud(service, body_upload(request->body), facts, request->principal.name, known, &error);
    body_drop_upload(request->body);
    if (status == STATUS_OK && key->key) {
        wall_clock_hold();
        status = catalog_put_key(service->catalog, request->principal.name, key, facts->sha256, job_now_ms(), &error);
        wall_clock_release();
    }
    if (status == STATUS_LIMIT)
        handlers_refuse_bytes(service, catalog_usage(service->catalog, request->principal.name).bytes, facts->bytes,
                              response);
    else if (status != STATUS_OK)
        response_error(response, &error);
    return status == STATUS_OK;
}

/* Whether there is a response: what the same request was answered before under its key, or why it is refused. */
static bool answered_before(struct service *service, const struct request *request, const struct upload_facts *facts,
                            struct job_key *key, struct response *response) {
    struct catalog_reply before = {0};
    bool found = false;
    *key = (struct job_key){.key = NULL};
    if (!request->claim.held) return false;
    if (!handlers_fingerprint(request, NULL, facts->sha256, key)) {
        response_refuse(response, PROBLEM_INTERNAL_ERROR, "no memory");
        return true;
    }
    if (!handlers_find_reply(service, request, key, &before, &found, response)) return true;
    bool replayed = found && before.reply;
    if (found) key->key = NULL; /* there is a row for it */
    if (replayed) {
        handlers_replay(&before, response);
        response_header(response, "Location", "%s/v1/clouds/%s", links_base(), before.made);
    }
    if (found) catalog_reply_done(&before);
    return replayed;
}

/* 201 for what is new to this principal, 200 for what it has already, which is kept from now on. */
static void create_cloud(struct service *service, struct request *request, struct response *response) {
    struct upload_facts facts;
    struct catalog_cloud record;
    struct job_key key;
    bool known = false;
    if (!handlers_end_body(request, response) || !handlers_takes_no_query(request, response) ||
        !handlers_end_upload(request, &facts, response) || answered_before(service, request, &facts, &key, response) ||
        !handlers_is_within_share(service, request, facts.bytes, false, response) || /* its length may be new */
        !keep_cloud(service, request, &facts, &key, &known, response))
        return;
    if (handlers_read_cloud(service, request, facts.sha256, &record, response)) {
        answer_cloud(service, &record, known ? 200 : 201, response);
        handlers_keep_reply(service, request, response);
        response_header(response, "Location", "%s/v1/clouds/%s", links_base(), record.sha256);
        catalog_cloud_done(&record);
    }
}

const struct handler handlers_create_cloud = {.admit = admit_new_cloud, .run = create_cloud};

/* ------------------------------------------------------------------------------------------------ read, delete */

static void get_cloud(struct service *service, struct request *request, struct response *response) {
    struct catalog_cloud record;
    if (!handlers_takes_no_query(request, response)) return;
    if (handlers_read_cloud(service, request, request->match.capture[0], &record, response))
        answer_cloud(service, &record, 200, response);
    catalog_cloud_done(&record);
}

const struct handler handlers_get_cloud = {.run = get_cloud};

/* What a job with the query's parameters would take and keep; no job is made. */
static void get_plan(struct service *service, struct request *request, struct response *response) {
    struct catalog_cloud record;
    struct job job = {0};
    struct problem problem;
    if (!query_decode_params(request->query, request->query_count, NULL, &job.params, &problem)) {
        response_problem(response, &problem);
        return;
    }
    if (handlers_read_cloud(service, request, request->match.capture[0], &record, response)) {
        struct told told;
        read_header(service, &record, &told);
        bool fits = handlers_foresee(service, request, &record, &job, &problem);
        struct job_cost cost = estimate_cost(&job);
        struct plan_document document = {.cloud = document_of(&record, &told),
                                         .params = &job.params,
                                         .memory_bytes = job.memory_bytes,
                                         .memory_limit_bytes = (uint64_t)service->config->job_memory_bytes,
                                         .seconds = estimate_seconds(service->estimate, &cost),
                                         .problem = fits ? NULL : &problem};
        response_text(response, 200, "application/json", plan_encode(&document));
        response_header(response, "Cache-Control", "no-cache");
        told_done(&told);
    }
    catalog_cloud_done(&record);
}

const struct handler handlers_get_plan = {.run = get_plan};

/* The beginning of its hash, and what files of its format end in: "pcd/binary" is .pcd. */
static void cloud_file_name(const struct catalog_cloud *record, char *name, size_t bytes) {
    static const char *const endings[][2] = {{"gzip", "gz"}, {"zstd", "zst"}};
    char ending[JOB_FORMAT_BYTES];
    snprintf(ending, sizeof ending, "%.*s", (int)strcspn(record->format, "/"), record->format);
    for (size_t i = 0; i < sizeof endings / sizeof *endings; i++)
        if (strcmp(ending, endings[i][0]) == 0) snprintf(ending, sizeof ending, "%s", endings[i][1]);
    snprintf(name, bytes, "%.12s.%s", record->sha256, ending);
}

static void get_cloud_data(struct service *service, struct request *request, struct response *response) {
    struct catalog_cloud record;
    if (!handlers_takes_no_query(request, response)) return;
    if (handlers_read_cloud(service, request, request->match.capture[0], &record, response)) {
        struct job_output output = {.bytes = record.bytes};
        cloud_file_name(&record, output.name, sizeof output.name);
        memcpy(output.sha256, record.sha256, sizeof output.sha256);
        handlers_send_cloud(service, request, &output, response);
    }
    catalog_cloud_done(&record);
}

const struct handler handlers_get_cloud_data = {.run = get_cloud_data};

static void delete_cloud(struct service *service, struct request *request, struct response *response) {
    struct catalog_cloud record;
    struct error error = {0};
    uint64_t jobs = 0;
    if (!handlers_takes_no_query(request, response)) return;
    if (handlers_read_cloud(service, request, request->match.capture[0], &record, response)) {
        if (!handlers_admit_match(request, NULL, response)) {
            catalog_cloud_done(&record);
            return;
        }
        answer_cloud(service, &record, 200, response);
        enum status status = service_delete_cloud(service, record.sha256, owner_of(request), &jobs, &error);
        if (status != STATUS_OK || jobs) response_done(response);
        if (status != STATUS_OK) {
            response_error(response, &error);
        } else if (jobs) {
            struct problem problem;
            problem_set(&problem, PROBLEM_CLOUD_IN_USE, "%llu jobs refer to the cloud", (unsigned long long)jobs);
            problem_add_number(&problem, "jobs", (int64_t)jobs);
            response_problem(response, &problem);
        }
    }
    catalog_cloud_done(&record);
}

const struct handler handlers_delete_cloud = {.run = delete_cloud};

/* ------------------------------------------------------------------------------------------------ list */

static const char *const list_names[] = {"limit", "after", NULL};

static void answer_list(struct service *service, const struct catalog_cloud *records, size_t count,
                        struct response *response) {
    struct cloud_document *documents = calloc(count + 1, sizeof *documents);
    struct told *told = calloc(count + 1, sizeof *told);
    for (size_t i = 0; documents && told && i < count; i++) {
        read_header(service, &records[i], &told[i]);
        documents[i] = document_of(&records[i], &told[i]);
    }
    char *text = documents && told ? cloud_list_encode(documents, count) : NULL;
    response_text(response, 200, "application/json", text);
    response_header(response, "Cache-Control", "no-cache");
    for (size_t i = 0; told && i < count; i++) told_done(&told[i]);
    free(told);
    free(documents);
}

/* One more than asked for is read, to know whether there is a next page. */
static void list_clouds(struct service *service, struct request *request, struct response *response) {
    struct error error = {0};
    struct handlers_page page;
    size_t count = 0;
    if (!handlers_read_page(request, list_names, catalog_cloud_id_valid, "the id of a cloud", &page, response)) return;
    struct catalog_cloud *records = calloc(page.limit + 1, sizeof *records);
    enum status status = records ? STATUS_OK : error_set(&error, STATUS_NO_MEMORY, "clouds", "no memory");
    if (status == STATUS_OK)
        status = catalog_list_clouds(service->catalog, owner_of(request), page.after, records, page.limit + 1, &count,
                                     &error);
    if (status == STATUS_OK)
        answer_list(service, records, count < page.limit ? count : page.limit, response);
    else
        response_error(response, &error);
    if (count > page.limit)
        response_header(response, "Link", "<%s/v1/clouds?limit=%zu&after=%s>; rel=\"next\"", links_base(), page.limit,
                        records[page.limit - 1].sha256);
    for (size_t i = 0; i < count; i++) catalog_cloud_done(&records[i]);
    free(records);
}

const struct handler handlers_list_clouds = {.run = list_clouds};
