/* A request's body on its way in.
 *
 * Each stage hands on to the next one in the same call, so nothing but the format's first bytes, a text or a field is
 * in memory, and what a stage refuses ends the request at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/body.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "api/job_request.h"
#include "core/inflate.h"
#include "server/digest.h"
#include "server/multipart.h"

enum { TEXT_BYTES = 64 * 1024, ZSTD_WINDOW_BYTES = 8 * 1024 * 1024 /* RFC 9659 */ };

enum field { FIELD_FILE, FIELD_PARAMS, FIELD_VALUE };

struct body {
    struct body_plan plan;
    enum body_kind kind;
    struct upload *upload;
    struct inflate *inflate; /* NULL: no content coding */
    struct digest *digest;   /* NULL: no header asks for it, or the upload has it */
    struct multipart *form;
    struct problem *problem; /* while bytes are inflated: where a refusal goes */
    bool refused;            /* it has gone there */
    uint64_t bytes;          /* that came in */

    enum field field; /* of the form: the present one */
    char name[MULTIPART_NAME_BYTES];
    bool has_params;
    size_t text_bytes;
    char text[TEXT_BYTES]; /* the document, or the present field's value */
    struct job_request request;
};

/* ------------------------------------------------------------------------------------------------ media types */

/* curl's default, browsers' and honest types; what a cloud is, its first bytes tell. */
static bool is_cloud_type(const char *type) {
    static const char *const accepted[] = {"application/octet-stream",
                                           "application/x-www-form-urlencoded",
                                           "application/ply",
                                           "application/x-ply",
                                           "application/vnd.las",
                                           "application/sla",
                                           "application/vnd.ms-pki.stl",
                                           "application/object",
                                           "application/gzip",
                                           "application/x-gzip",
                                           "application/zstd",
                                           "binary/octet-stream",
                                           "text/",
                                           "model/"};
    if (!type || !*type) return true;
    for (size_t i = 0; i < sizeof accepted / sizeof *accepted; i++)
        if (strncasecmp(type, accepted[i], strlen(accepted[i])) == 0) return true;
    return false;
}

static bool is_type(const char *type, const char *name) {
    size_t length = strlen(name);
    return type && strncasecmp(type, name, length) == 0 && strchr("; \t", type[length]);
}

static bool refuse_type(const struct body_plan *plan, struct problem *problem) {
    char supported[PROBLEM_TEXT_BYTES];
    bool piece = plan->takes & BODY_PIECE;
    snprintf(supported, sizeof supported, "%s",
             piece ? "application/offset+octet-stream" : "application/octet-stream,text/plain,model/ply");
    size_t used = strlen(supported);
    snprintf(supported + used, sizeof supported - used, "%s%s", plan->takes & BODY_FORM ? ",multipart/form-data" : "",
             plan->takes & BODY_JSON ? ",application/json" : "");
    problem_set(problem, PROBLEM_UNSUPPORTED_FORMAT, "Content-Type %.80s is not taken here",
                plan->type ? plan->type : "(none)");
    problem_add_list(problem, "supported", supported);
    return false;
}

static bool choose_kind(struct body *body, struct problem *problem) {
    const struct body_plan *plan = &body->plan;
    if (plan->takes & BODY_PIECE && is_type(plan->type, "application/offset+octet-stream"))
        body->kind = BODY_PIECE;
    else if (plan->takes & BODY_PIECE)
        return refuse_type(plan, problem);
    else if ((plan->takes & BODY_FORM) && is_type(plan->type, "multipart/form-data"))
        body->kind = BODY_FORM;
    else if ((plan->takes & BODY_JSON) && is_type(plan->type, "application/json"))
        body->kind = BODY_JSON;
    else if ((plan->takes & BODY_CLOUD) && is_cloud_type(plan->type))
        body->kind = BODY_CLOUD;
    else
        return refuse_type(plan, problem);
    return true;
}

/* ------------------------------------------------------------------------------------------------ text, fields */

static bool add_text(struct body *body, const void *bytes, size_t count, size_t most, struct problem *problem) {
    if (count > most - body->text_bytes) {
        problem_set(problem, PROBLEM_BODY_TOO_LARGE, "%.63s%sis longer than %zu bytes", body->name,
                    body->name[0] ? " " : "the document ", most);
        problem_add_number(problem, "limit", (int64_t)most);
        return false;
    }
    memcpy(body->text + body->text_bytes, bytes, count);
    body->text_bytes += count;
    return true;
}

static bool refuse_field(const char *name, const char *why, const char *suggestion, struct problem *problem) {
    problem_set(problem, PROBLEM_UNKNOWN_PARAMETER, "%s: %s", name, why);
    problem_add_error(problem, name, NULL, NULL, suggestion);
    return false;
}

static bool start_upload(struct body *body, uint64_t expected_bytes, struct problem *problem) {
    struct admission admission = body->plan.admission;
    if (body->kind == BODY_FORM) admission.has_params = false; /* some may still come */
    body->upload =
        upload_new(body->plan.store, body->plan.threads, expected_bytes, body->plan.max_bytes, &admission, problem);
    return body->upload != NULL;
}

static bool begin_field(void *ctx, const struct multipart_part *part, struct problem *problem) {
    struct body *body = ctx;
    body->text_bytes = 0;
    memcpy(body->name, part->name, sizeof body->name);
    if (strcmp(part->name, "file") == 0) {
        body->field = FIELD_FILE;
        if (body->upload) return refuse_field("file", "given more than once", NULL, problem);
        if (is_cloud_type(part->type)) return start_upload(body, UINT64_MAX, problem);
        struct body_plan plan = {.type = part->type};
        return refuse_type(&plan, problem);
    }
    if (part->is_file && strcmp(part->name, "params") != 0)
        return refuse_field(part->name, "the part that holds the cloud is called file", "file", problem);
    body->field = strcmp(part->name, "params") == 0 ? FIELD_PARAMS : FIELD_VALUE;
    bool twice = body->field == FIELD_PARAMS && body->has_params;
    if (body->field == FIELD_PARAMS) body->has_params = true;
    return !twice || refuse_field("params", "given more than once", NULL, problem);
}

static bool take_field(void *ctx, const void *bytes, size_t count, struct problem *problem) {
    struct body *body = ctx;
    if (body->field == FIELD_FILE) return upload_write(body->upload, bytes, count, problem);
    return add_text(body, bytes, count, body->field == FIELD_PARAMS ? TEXT_BYTES : JOB_REQUEST_VALUE_BYTES - 1,
                    problem);
}

static bool end_field(void *ctx, struct problem *problem) {
    struct body *body = ctx;
    switch (body->field) {
    case FIELD_PARAMS: return job_request_read_params(&body->request, body->text, body->text_bytes, problem);
    case FIELD_VALUE: return job_request_add(&body->request, body->name, body->text, body->text_bytes, problem);
    case FIELD_FILE: break;
    }
    return true;
}

/* ------------------------------------------------------------------------------------------------ stages */

/* The last stage: bytes without coding. */
static bool take_plain(struct body *body, const void *bytes, size_t count, struct problem *problem) {
    switch (body->kind) {
    case BODY_CLOUD: return upload_write(body->upload, bytes, count, problem);
    case BODY_FORM: return multipart_push(body->form, bytes, count, problem);
    case BODY_PIECE: return uploads_write(body->plan.writer, bytes, count, problem);
    case BODY_JSON: break;
    }
    return add_text(body, bytes, count, TEXT_BYTES, problem);
}

static enum status take_inflated(void *ctx, const void *bytes, size_t count) {
    struct body *body = ctx;
    body->refused = !take_plain(body, bytes, count, body->problem);
    return body->refused ? STATUS_CANCELLED : STATUS_OK;
}

/* What ended inflating, as a problem, unless a later stage has said it already. */
static bool refuse_inflated(struct body *body, const struct error *error, struct problem *problem) {
    if (body->refused) return false;
    if (error->code == STATUS_MALFORMED) {
        problem_set(problem, PROBLEM_MALFORMED_REQUEST, "the body is not what Content-Encoding says: %s", error->text);
        if (error->byte_offset != UINT64_MAX) problem_add_number(problem, "byte_offset", (int64_t)error->byte_offset);
    } else if (error->code == STATUS_LIMIT) {
        problem_set(problem, PROBLEM_BODY_TOO_LARGE, "the body becomes too large without its coding: %s", error->text);
        problem_add_number(problem, "limit", (int64_t)body->plan.max_bytes);
        problem_add_number(problem, "limit_expansion", (int64_t)body->plan.max_expansion);
    } else {
        problem_from_error(problem, error);
    }
    return false;
}

static bool start_inflating(struct body *body, struct problem *problem) {
    static const struct {
        const char *name;
        enum inflate_kind kind;
    } codings[] = {{"gzip", INFLATE_GZIP}, {"x-gzip", INFLATE_GZIP}, {"zstd", INFLATE_ZSTD}};
    struct inflate_limits limits = {body->plan.max_bytes, body->plan.max_expansion, ZSTD_WINDOW_BYTES};
    const char *coding = body->plan.coding;
    struct error error = {0};
    if (!coding || !*coding || strcasecmp(coding, "identity") == 0) return true;
    for (size_t i = body->kind == BODY_PIECE ? 3 : 0; i < sizeof codings / sizeof *codings; i++) {
        if (strcasecmp(coding, codings[i].name) != 0) continue;
        struct inflate_out out = {take_inflated, body};
        return inflate_new(codings[i].kind, &limits, out, &body->inflate, &error) == STATUS_OK ||
               refuse_inflated(body, &error, problem);
    }
    problem_set(problem, PROBLEM_UNSUPPORTED_FORMAT, "Content-Encoding %.80s is not taken", coding);
    problem_add_list(problem, "supported", body->kind == BODY_PIECE ? "identity" : "gzip,zstd,identity");
    return false;
}

/* ------------------------------------------------------------------------------------------------ digests */

/* The value of sha-256 in a header like `sha-256=:BASE64:, sha-512=:...:`; NULL = not there. */
static const char *find_digest(const char *header) {
    for (const char *item = header; item && *item;) {
        item += strspn(item, " \t,");
        if (strncmp(item, "sha-256=", 8) == 0) return item + 8;
        item += strcspn(item, ",");
    }
    return NULL;
}

static bool is_digest(const char *value) {
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    return value[0] == ':' && strspn(value + 1, digits) == 43 && strncmp(value + 44, "=:", 2) == 0;
}

/* Whether the bytes come in as the cloud's, so that its hash is theirs. */
static bool is_upload(const struct body *body) { return body->kind == BODY_CLOUD && !body->inflate; }

static bool start_digest(struct body *body, struct problem *problem) {
    const struct {
        const char *name, *value;
    } headers[] = {{"Content-Digest", find_digest(body->plan.content_digest)},
                   {"Repr-Digest", find_digest(body->plan.repr_digest)}};
    bool asked = false;
    for (size_t i = 0; i < 2; i++) {
        if (!headers[i].value) continue;
        asked = true;
        if (is_digest(headers[i].value)) continue;
        problem_set(problem, PROBLEM_MALFORMED_REQUEST, "%s: sha-256 wants 32 bytes as :BASE64:", headers[i].name);
        return false;
    }
    if (!asked || is_upload(body)) return true;
    if ((body->digest = digest_new())) return true;
    problem_set(problem, PROBLEM_INTERNAL_ERROR, "no memory");
    return false;
}

/* Both headers are over the body as it came: what is sent is what is represented. */
static bool check_digest(struct body *body, struct problem *problem) {
    const char *const given[] = {find_digest(body->plan.content_digest), find_digest(body->plan.repr_digest)};
    char own[DIGEST_HEX_BYTES], found[DIGEST_BASE64_BYTES];
    const char *hex = own;
    if (!given[0] && !given[1]) return true;
    if (is_upload(body))
        hex = upload_hash(body->upload, problem);
    else
        digest_finish(body->digest, own);
    if (!hex) return false;
    digest_base64(hex, found);
    for (size_t i = 0; i < 2; i++) {
        if (!given[i] || strncmp(given[i] + 1, found, DIGEST_BASE64_BYTES - 1) == 0) continue;
        problem_set(problem, PROBLEM_DIGEST_MISMATCH, "%s is not that of the %llu bytes that came",
                    i ? "Repr-Digest" : "Content-Digest", (unsigned long long)body->bytes);
        problem_add_text(problem, "actual", found);
        return false;
    }
    return true;
}

/* ------------------------------------------------------------------------------------------------ the body */

static bool start(struct body *body, struct problem *problem) {
    const struct body_plan *plan = &body->plan;
    uint64_t expected = plan->content_length;
    struct multipart_sink sink = {begin_field, take_field, end_field, body};
    if (!choose_kind(body, problem) || !start_inflating(body, problem) || !start_digest(body, problem)) return false;
    if (expected != UINT64_MAX && expected > plan->max_bytes) {
        upload_too_large(plan->max_bytes, expected, problem);
        return false;
    }
    switch (body->kind) {
    case BODY_CLOUD: return start_upload(body, body->inflate ? UINT64_MAX : expected, problem);
    case BODY_FORM: return (body->form = multipart_new(plan->type, sink, problem)) != NULL;
    case BODY_JSON:
    case BODY_PIECE: break;
    }
    return true;
}

struct body *body_new(const struct body_plan *plan, struct problem *problem) {
    struct body *body = calloc(1, sizeof *body);
    if (!body) {
        uploads_writer_free(plan->writer);
        problem_set(problem, PROBLEM_INTERNAL_ERROR, "no memory");
        return NULL;
    }
    body->plan = *plan;
    if (start(body, problem)) return body;
    body_free(body);
    return NULL;
}

void body_free(struct body *body) {
    if (!body) return;
    upload_free(body->upload);
    inflate_free(body->inflate);
    digest_free(body->digest);
    multipart_free(body->form);
    uploads_writer_free(body->plan.writer);
    free(body);
}

bool body_write(struct body *body, const void *bytes, size_t count, struct problem *problem) {
    struct error error = {0};
    if (count > body->plan.max_bytes - body->bytes) {
        upload_too_large(body->plan.max_bytes, UINT64_MAX, problem);
        return false;
    }
    body->bytes += count;
    body->problem = problem;
    if (body->digest) digest_update(body->digest, bytes, count);
    if (!body->inflate) return take_plain(body, bytes, count, problem);
    return inflate_push(body->inflate, bytes, count, &error) == STATUS_OK || refuse_inflated(body, &error, problem);
}

bool body_end(struct body *body, struct problem *problem) {
    struct error error = {0};
    body->problem = problem;
    if (!check_digest(body, problem)) return false;
    if (body->inflate && inflate_end(body->inflate, &error) != STATUS_OK) return refuse_inflated(body, &error, problem);
    if (body->kind == BODY_JSON)
        return job_request_read(&body->request, body->text, body->text_bytes, body->plan.names, problem);
    if (body->kind == BODY_FORM && !multipart_end(body->form, problem)) return false;
    if (body->upload || body->kind == BODY_PIECE) return true;
    problem_set(problem, PROBLEM_MALFORMED_REQUEST, "the form has no part called file");
    return false;
}

struct upload *body_upload(struct body *body) {
    return body->upload;
}

void body_drop_upload(struct body *body) {
    upload_free(body->upload);
    body->upload = NULL;
}

struct uploads_writer *body_writer(struct body *body) {
    return body->plan.writer;
}

const char *body_input(const struct body *body) { return body->request.input; }

size_t body_pairs(const struct body *body, struct query_pair *pairs, size_t max) {
    for (size_t i = 0; i < body->request.count && i < max; i++)
        pairs[i] = (struct query_pair){body->request.field[i].name, body->request.field[i].value};
    return body->request.count;
}
