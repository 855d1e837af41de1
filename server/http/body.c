/* A request's body on its way in.
 *
 * Each stage hands on to the next one in the same call, so nothing but the format's first bytes, a text, a field or a
 * page of the cloud is in memory, and what a stage refuses ends the request at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/body.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "api/codecs/job_request.h"
#include "core/io/codec/inflate.h"
#include "server/base/digest.h"
#include "server/http/multipart.h"

enum { ALGORITHMS = 2, TEXT_BYTES = 64 * 1024, ZSTD_WINDOW_BYTES = 8 * 1024 * 1024 /* RFC 9659 */ };
enum { GATHER_BYTES = 4096 /* no more than a format is told by: nothing is refused later for it */ };

enum field { FIELD_FILE, FIELD_PARAMS, FIELD_VALUE };

struct body {
    struct body_plan plan;
    enum body_kind kind;
    struct upload *upload;
    struct inflate *inflate;           /* NULL: no content coding */
    struct digest *digest[ALGORITHMS]; /* NULL: no header tells it, or the upload has it */
    struct multipart *form;
    struct problem *problem; /* while bytes are inflated: where a refusal goes */
    bool refused;            /* it has gone there */
    uint64_t bytes;          /* that came in */
    size_t waiting_bytes;
    char waiting[GATHER_BYTES]; /* of these, not yet given to the first stage */

    enum field field; /* of the form: the present one */
    char name[MULTIPART_NAME_BYTES];
    bool has_params;
    size_t text_bytes, gathered_bytes;
    union {
        char text[TEXT_BYTES];       /* the document, or the present field's value */
        char gathered[GATHER_BYTES]; /* of the cloud, not yet written */
    };
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
                                           "application/vnd.laszip",
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
             piece ? "application/offset+octet-stream,application/partial-upload"
                   : "application/octet-stream,text/plain,model/ply");
    size_t used = strlen(supported);
    snprintf(supported + used, sizeof supported - used, "%s%s", plan->takes & BODY_FORM ? ",multipart/form-data" : "",
             plan->takes & BODY_JSON ? ",application/json" : "");
    problem_set(problem, PROBLEM_UNSUPPORTED_FORMAT, "Content-Type %.80s is not supported here",
                plan->type ? plan->type : "(none)");
    problem_add_list(problem, "supported", supported);
    return false;
}

static bool choose_kind(struct body *body, struct problem *problem) {
    const struct body_plan *plan = &body->plan;
    if (plan->takes & BODY_PIECE &&
        (is_type(plan->type, "application/offset+octet-stream") || is_type(plan->type, "application/partial-upload")))
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

/* Writes what was gathered. */
static bool write_gathered(struct body *body, struct problem *problem) {
    size_t count = body->gathered_bytes;
    body->gathered_bytes = 0;
    return !count || upload_write(body->upload, body->gathered, count, problem);
}

/* Bytes of the cloud.  What is between two things that look like the beginning of a boundary may be as short as a byte:
 * such pieces are gathered, as each write costs a system call. */
static bool take_cloud(struct body *body, const void *bytes, size_t count, struct problem *problem) {
    if (count > GATHER_BYTES - body->gathered_bytes && !write_gathered(body, problem)) return false;
    if (count > GATHER_BYTES) return upload_write(body->upload, bytes, count, problem);
    memcpy(body->gathered + body->gathered_bytes, bytes, count);
    body->gathered_bytes += count;
    return true;
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
    if (body->field == FIELD_FILE) return take_cloud(body, bytes, count, problem);
    return add_text(body, bytes, count, body->field == FIELD_PARAMS ? TEXT_BYTES : JOB_REQUEST_VALUE_BYTES - 1,
                    problem);
}

static bool end_field(void *ctx, struct problem *problem) {
    struct body *body = ctx;
    switch (body->field) {
    case FIELD_PARAMS: return job_request_read_params(&body->request, body->text, body->text_bytes, problem);
    case FIELD_VALUE: return job_request_add(&body->request, body->name, body->text, body->text_bytes, problem);
    case FIELD_FILE: return write_gathered(body, problem);
    }
    return true;
}

/* ------------------------------------------------------------------------------------------------ stages */

/* The last stage: bytes without coding. */
static bool take_plain(struct body *body, const void *bytes, size_t count, struct problem *problem) {
    switch (body->kind) {
    case BODY_CLOUD: return take_cloud(body, bytes, count, problem);
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
        problem_set(problem, PROBLEM_MALFORMED_REQUEST, "the body does not match its Content-Encoding: %s",
                    error->text);
        if (error->byte_offset != UINT64_MAX) problem_add_number(problem, "byte_offset", (int64_t)error->byte_offset);
    } else if (error->code == STATUS_LIMIT) {
        problem_set(problem, PROBLEM_BODY_TOO_LARGE, "the decompressed body is too large: %s", error->text);
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
    problem_set(problem, PROBLEM_UNSUPPORTED_FORMAT, "Content-Encoding %.80s is not supported", coding);
    problem_add_list(problem, "supported", body->kind == BODY_PIECE ? "identity" : "gzip,zstd,identity");
    return false;
}

/* ------------------------------------------------------------------------------------------------ digests */

/* What is verified; RFC 9530 lets others be ignored. */
static const struct algorithm {
    const char *name;
    size_t digits; /* of base64, with the = that fill it up */
    struct digest *(*new_digest)(void);
} algorithms[ALGORITHMS] = {{"sha-256", 44, digest_new}, {"sha-512", 88, digest_new_sha512}};
enum { SHA_256 /* in the table above */ };

/* One digest that a header tells. */
struct told_digest {
    size_t algorithm;
    const char *base64;
};

static bool is_digest(const char *value, size_t digits) {
    static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    if (value[0] != ':') return false;
    size_t length = strspn(value + 1, letters), filled = length + strspn(value + 1 + length, "=");
    return filled == digits && digits - length <= 2 && value[1 + digits] == ':';
}

/* Finds the next one in a header like `sha-256=:BASE64:, sha-512=:BASE64:`; *text moves on.  false: there is none; or
 * it is malformed: then told->base64 is NULL. */
static bool next_digest(const char **text, struct told_digest *told) {
    for (; *text && **text; *text += strcspn(*text, ",")) {
        *text += strspn(*text, " \t,");
        for (size_t i = 0; i < ALGORITHMS; i++) {
            size_t name = strlen(algorithms[i].name);
            if (strncasecmp(*text, algorithms[i].name, name) != 0 || (*text)[name] != '=') continue;
            bool good = is_digest(*text + name + 1, algorithms[i].digits);
            told->algorithm = i;
            told->base64 = good ? *text + name + 2 : NULL;
            *text += strcspn(*text, ",");
            return good;
        }
    }
    return false;
}

/* Whether the bytes come in as the cloud's, so that its hash is theirs. */
static bool is_upload(const struct body *body) { return body->kind == BODY_CLOUD && !body->inflate; }

/* Begins to hash what a header tells the hash of. */
static bool start_digests_of(struct body *body, const char *header, const char *text, struct problem *problem) {
    struct told_digest told = {.base64 = ""};
    while (next_digest(&text, &told)) {
        const struct algorithm *algorithm = &algorithms[told.algorithm];
        bool is_there = body->digest[told.algorithm] || (told.algorithm == SHA_256 && is_upload(body));
        if (is_there || (body->digest[told.algorithm] = algorithm->new_digest())) continue;
        problem_set(problem, PROBLEM_INTERNAL_ERROR, "no memory");
        return false;
    }
    if (told.base64) return true;
    problem_set(problem, PROBLEM_MALFORMED_REQUEST, "%s: %s takes %d bits as :BASE64:", header,
                algorithms[told.algorithm].name, told.algorithm == SHA_256 ? 256 : 512);
    return false;
}

static bool start_digests(struct body *body, struct problem *problem) {
    return start_digests_of(body, "Content-Digest", body->plan.content_digest, problem) &&
           start_digests_of(body, "Repr-Digest", body->plan.repr_digest, problem);
}

static bool check_digests_of(const struct body *body, const char *header, const char *text,
                             char found[ALGORITHMS][DIGEST_LONGEST_BASE64_BYTES], struct problem *problem) {
    struct told_digest told = {0};
    while (next_digest(&text, &told)) {
        const struct algorithm *algorithm = &algorithms[told.algorithm];
        if (strncmp(told.base64, found[told.algorithm], algorithm->digits) == 0) continue;
        problem_set(problem, PROBLEM_DIGEST_MISMATCH, "%s: %s is not that of the %llu bytes that came", header,
                    algorithm->name, (unsigned long long)body->bytes);
        problem_add_text(problem, "actual", found[told.algorithm]);
        return false;
    }
    return true;
}

/* Both headers are over the body as it came: what is sent is what is represented. */
static bool check_digests(struct body *body, struct problem *problem) {
    char found[ALGORITHMS][DIGEST_LONGEST_BASE64_BYTES] = {{0}};
    if (!body->plan.content_digest && !body->plan.repr_digest) return true;
    for (size_t i = 0; i < ALGORITHMS; i++)
        if (body->digest[i]) digest_finish_base64(body->digest[i], found[i]);
    if (is_upload(body)) {
        const char *hex = upload_hash(body->upload, problem);
        if (!hex) return false;
        digest_base64(hex, found[SHA_256]);
    }
    return check_digests_of(body, "Content-Digest", body->plan.content_digest, found, problem) &&
           check_digests_of(body, "Repr-Digest", body->plan.repr_digest, found, problem);
}

/* ------------------------------------------------------------------------------------------------ the body */

static void refuse_longer(const struct body *body, uint64_t bytes, struct problem *problem) {
    if (body->kind == BODY_PIECE)
        upload_piece_too_large(body->plan.max_bytes, bytes, problem);
    else
        upload_too_large(body->plan.max_bytes, bytes, problem);
}

static bool body_start(struct body *body, struct problem *problem) {
    const struct body_plan *plan = &body->plan;
    uint64_t expected = plan->content_length;
    struct multipart_sink sink = {begin_field, take_field, end_field, body};
    if (!choose_kind(body, problem) || !start_inflating(body, problem) || !start_digests(body, problem)) return false;
    if (expected != UINT64_MAX && expected > plan->max_bytes) {
        refuse_longer(body, expected, problem);
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

/* Gives bytes to the first stage. */
static bool body_take(struct body *body, const void *bytes, size_t count, struct problem *problem) {
    struct error error = {0};
    body->problem = problem;
    for (size_t i = 0; i < ALGORITHMS; i++)
        if (body->digest[i]) digest_update(body->digest[i], bytes, count);
    if (!body->inflate) return take_plain(body, bytes, count, problem);
    return inflate_push(body->inflate, bytes, count, &error) == STATUS_OK || refuse_inflated(body, &error, problem);
}

static bool take_waiting(struct body *body, struct problem *problem) {
    size_t count = body->waiting_bytes;
    body->waiting_bytes = 0;
    return !count || body_take(body, body->waiting, count, problem);
}

void body_free(struct body *body) {
    if (!body) return;
    /* What was taken of the piece of an upload stays, though its sender is gone. */
    struct problem problem;
    bool kept = body->kind != BODY_PIECE || take_waiting(body, &problem);
    (void)kept; /* nobody is there to hear of it */
    upload_free(body->upload);
    inflate_free(body->inflate);
    for (size_t i = 0; i < ALGORITHMS; i++) digest_free(body->digest[i]);
    multipart_free(body->form);
    uploads_writer_free(body->plan.writer);
    free(body);
}

struct body *body_new(const struct body_plan *plan, struct problem *problem) {
    struct body *body = calloc(1, sizeof *body);
    if (!body) {
        uploads_writer_free(plan->writer);
        problem_set(problem, PROBLEM_INTERNAL_ERROR, "no memory");
        return NULL;
    }
    body->plan = *plan;
    if (body_start(body, problem)) return body;
    body_free(body);
    return NULL;
}

/* Chunks may be as short as a byte, and each stage costs more than that: so short pieces wait for others. */
bool body_write(struct body *body, const void *bytes, size_t count, struct problem *problem) {
    if (count > body->plan.max_bytes - body->bytes) {
        refuse_longer(body, UINT64_MAX, problem);
        return false;
    }
    body->bytes += count;
    if (count > GATHER_BYTES - body->waiting_bytes && !take_waiting(body, problem)) return false;
    if (count > GATHER_BYTES) return body_take(body, bytes, count, problem);
    memcpy(body->waiting + body->waiting_bytes, bytes, count);
    body->waiting_bytes += count;
    return true;
}

bool body_end(struct body *body, struct problem *problem) {
    struct error error = {0};
    body->problem = problem;
    if (!take_waiting(body, problem) || !write_gathered(body, problem) || !check_digests(body, problem)) return false;
    if (body->inflate && inflate_end(body->inflate, &error) != STATUS_OK) return refuse_inflated(body, &error, problem);
    if (!write_gathered(body, problem)) return false;
    if (body->kind == BODY_JSON)
        return job_request_read(&body->request, body->text, body->text_bytes, body->plan.names, body->plan.input,
                                problem);
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

size_t body_joined(const struct body *body) { return body->request.joined; }

const char *body_joined_cloud(const struct body *body, size_t i) { return body->request.join[i]; }

void body_take_upload(struct body *body, struct upload *upload) {
    upload_free(body->upload);
    body->upload = upload;
}

size_t body_pairs(const struct body *body, struct query_pair *pairs, size_t max) {
    for (size_t i = 0; i < body->request.count && i < max; i++)
        pairs[i] = (struct query_pair){body->request.field[i].name, body->request.field[i].value};
    return body->request.count;
}
