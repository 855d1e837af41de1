/* Resumable uploads as tus 1.0.0 has them: core, creation, creation-with-upload, creation-defer-length, expiration,
 * checksum, termination, concatenation; and as the IETF's draft-ietf-httpbis-resumable-upload has them, without its
 * interim responses (server/http/DECISIONS.md), at the same resources.
 *
 * An upload that is whole becomes a cloud: Whittle-Cloud names it in the answer to its last piece, and in every later
 * answer to HEAD and GET.  Where the service ended between the last byte and that, tus's HEAD, whose client is about to
 * go on, does what is left to do; of the draft's an empty last piece does.  GET changes nothing.
 *
 * A request that begins an upload, and isn't answered with its Location, leaves nothing: nobody could name it.
 *
 * A partial upload (Upload-Concat: partial) becomes no cloud.  A final one is made of partial ones that are whole, by
 * this request: their bytes are put one behind the other into an upload of its own, which becomes a cloud, and then
 * they go.  Who asks again for what is made of the same parts gets the same upload, for the first answer may be lost.
 *
 * A request is the draft's where it has one of its headers, and not tus's.  There the client says which piece is the
 * last one (Upload-Complete: ?1); until then an upload that has its length is no cloud.  Clients of tus may have the
 * draft's headers added by what they send through, so Tus-Resumable decides.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "api/codecs/upload_json.h"
#include "api/links.h"
#include "server/base/log.h"
#include "server/base/wall_clock.h"
#include "server/handlers/handlers.h"

static const char version[] = "1.0.0";

/* ------------------------------------------------------------------------------------------------ headers */

static bool speaks_tus(struct request *request, struct response *response) {
    const char *spoken = request->header[HEADER_TUS_RESUMABLE];
    request->tus = true;
    if (spoken && strcmp(spoken, version) == 0) return true;
    response_refuse(response, PROBLEM_UPLOAD_PROTOCOL, "Tus-Resumable must be %s", version);
    response_header(response, "Tus-Version", "%s", version);
    return false;
}

static bool speaks_draft(const struct request *request) {
    return !request->header[HEADER_TUS_RESUMABLE] &&
           (request->header[HEADER_UPLOAD_DRAFT] || request->header[HEADER_UPLOAD_COMPLETE]);
}

/* Interop versions of the draft that say the same of requests, but for the type of a piece: draft 03 has 5, draft 08
 * and later have 8. */
enum { FIRST_INTEROP = 5, LAST_INTEROP = 8 };

/* Whether the request's version is one of these, or it has none, as those of the protocol that the draft becomes. */
static bool knows_draft(const struct request *request, struct response *response) {
    int64_t spoken = 0;
    if (!request->header[HEADER_UPLOAD_DRAFT]) return true;
    bool is_number = request_integer(request, HEADER_UPLOAD_DRAFT, &spoken);
    if (is_number && spoken >= FIRST_INTEROP && spoken <= LAST_INTEROP) return true;
    response_refuse(response, PROBLEM_UPLOAD_PROTOCOL, "Upload-Draft-Interop-Version must be %d to %d", FIRST_INTEROP,
                    LAST_INTEROP);
    response_header(response, "Upload-Draft-Interop-Version", "%d", LAST_INTEROP);
    return false;
}

static bool speaks_either(struct request *request, struct response *response) {
    return speaks_draft(request) ? knows_draft(request, response) : speaks_tus(request, response);
}

/* Whether it is the last piece; one of tus's is when the length is there. */
static bool is_last(const struct request *request) {
    return !speaks_draft(request) || request_flag(request, HEADER_UPLOAD_COMPLETE) == FLAG_TRUE;
}

static bool read_complete(const struct request *request, struct response *response) {
    enum request_flag complete = request_flag(request, HEADER_UPLOAD_COMPLETE);
    if (!speaks_draft(request) || complete == FLAG_FALSE || complete == FLAG_TRUE) return true;
    response_refuse(response, PROBLEM_MALFORMED_REQUEST, "the header Upload-Complete must be there, ?0 or ?1");
    return false;
}

/* Of the draft: the length that a last piece tells by its own one, which has to be what Upload-Length said. */
static bool read_rest(const struct request *request, uint64_t offset, uint64_t *length, struct response *response) {
    uint64_t body = request->has_body ? request->content_length : 0;
    if (!speaks_draft(request) || !is_last(request) || body == UINT64_MAX) return true;
    bool same = *length == UINT64_MAX || (offset <= *length && body == *length - offset);
    if (!same)
        response_refuse(response, PROBLEM_MALFORMED_REQUEST,
                        "this last piece ends at %llu bytes, but the length of the upload is %llu",
                        (unsigned long long)(offset + body), (unsigned long long)*length);
    *length = offset + body;
    return same;
}

/* A whole number in a header; absent leaves it alone. */
static bool read_number(const struct request *request, enum request_header header, uint64_t *number,
                        struct response *response) {
    const char *text = request->header[header];
    char *end;
    if (!text) return true;
    errno = 0;
    unsigned long long value = strtoull(text, &end, 10);
    if (text[0] >= '0' && text[0] <= '9' && !*end && !errno && value <= INT64_MAX) {
        *number = value;
        return true;
    }
    response_refuse(response, PROBLEM_MALFORMED_REQUEST, "%s is no whole number", message_header_names[header]);
    return false;
}

/* Upload-Checksum: "sha1 BASE64" or "sha256 BASE64". */
static bool read_check(const struct request *request, struct uploads_check *check, struct response *response) {
    const char *text = request->header[HEADER_UPLOAD_CHECKSUM], *hash = text ? strchr(text, ' ') : NULL;
    *check = (struct uploads_check){.whole = text || request->header[HEADER_CONTENT_DIGEST] ||
                                             request->header[HEADER_REPR_DIGEST]};
    if (!text) return true;
    size_t name = hash ? (size_t)(hash - text) : 0, length = hash ? strlen(hash + 1) : 0;
    check->is_sha1 = name == 4 && strncmp(text, "sha1", 4) == 0;
    bool is_sha256 = name == 6 && strncmp(text, "sha256", 6) == 0;
    if ((check->is_sha1 && length == 28) || (is_sha256 && length == 44)) {
        memcpy(check->base64, hash + 1, length + 1);
        return true;
    }
    response_refuse(response, PROBLEM_MALFORMED_REQUEST,
                    "Upload-Checksum takes sha1 or sha256, and the hash as base64");
    return false;
}

/* As it came, with the paths of its parts. */
static void put_concat(const struct catalog_upload *info, struct response *response) {
    char text[RESPONSE_HEADER_BYTES];
    size_t used = (size_t)snprintf(text, sizeof text, "%.*s", (int)strcspn(info->concat, " "), info->concat);
    const char *id = strchr(info->concat, ' ');
    for (const char *before = ";"; id && used < sizeof text; id = strchr(id + 1, ' '), before = " ")
        used +=
            (size_t)snprintf(text + used, sizeof text - used, "%s%s/v1/uploads/%.36s", before, links_base(), id + 1);
    if (used && used < sizeof text) response_header(response, "Upload-Concat", "%s", text);
}

/* What the draft's answers have: how much an upload may have, and for how many seconds it is there (0 = it isn't). */
static void put_limit(const struct service *service, const struct request *request, int64_t expires_ms,
                      struct response *response) {
    int64_t age_ms = expires_ms - job_now_ms(), most = service->config->max_body_bytes, version_spoken;
    if (!speaks_draft(request)) return;
    if (age_ms > 0)
        response_header(response, "Upload-Limit", "max-size=%lld, max-age=%lld", (long long)most,
                        (long long)(age_ms / 1000));
    else
        response_header(response, "Upload-Limit", "max-size=%lld", (long long)most);
    if (request_integer(request, HEADER_UPLOAD_DRAFT, &version_spoken))
        response_header(response, "Upload-Draft-Interop-Version", "%lld", (long long)version_spoken);
}

static void put_progress(const struct service *service, const struct request *request,
                         const struct catalog_upload *info, struct response *response) {
    if (speaks_draft(request)) response_header(response, "Upload-Complete", info->cloud[0] ? "?1" : "?0");
    put_limit(service, request, info->expires_ms, response);
}

static void put_state(const struct catalog_upload *info, struct response *response) {
    char text[64];
    struct tm tm;
    time_t seconds = (time_t)(info->expires_ms / 1000);
    response_header(response, "Upload-Offset", "%llu", (unsigned long long)info->offset);
    if (strftime(text, sizeof text, "%a, %d %b %Y %H:%M:%S GMT", gmtime_r(&seconds, &tm)))
        response_header(response, "Upload-Expires", "%s", text);
    put_concat(info, response);
    if (info->cloud[0]) response_header(response, "Whittle-Cloud", "%s/v1/clouds/%s", links_base(), info->cloud);
    response_header(response, "Cache-Control", "no-store");
}

static void put_document(const struct catalog_upload *info, int status, struct response *response) {
    struct upload_document document = {.id = info->id,
                                       .metadata = info->metadata,
                                       .cloud = info->cloud,
                                       .offset = info->offset,
                                       .length = info->length,
                                       .created_ms = info->created_ms,
                                       .expires_ms = info->expires_ms};
    response_text(response, status, "application/json", upload_encode(&document));
    put_state(info, response);
}

/* ------------------------------------------------------------------------------------------------ OPTIONS */

static void upload_options(struct service *service, struct request *request, struct response *response) {
    request->tus = true;
    response->status = 204;
    response_header(response, "Tus-Version", "%s", version);
    response_header(
        response, "Tus-Extension",
        "creation,creation-with-upload,creation-defer-length,expiration,checksum,termination,concatenation");
    response_header(response, "Tus-Checksum-Algorithm", "sha1,sha256");
    response_header(response, "Tus-Max-Size", "%lld", (long long)service->config->max_body_bytes);
    response_header(response, "Accept-Patch", "application/partial-upload, application/offset+octet-stream");
    response_header(response, "Upload-Limit", "max-size=%lld", (long long)service->config->max_body_bytes);
}

const struct handler handlers_upload_options = {.run = upload_options, .quick = true};

/* ------------------------------------------------------------------------------------------------ admission */

/* The upload in the path, if the request's principal may see it. */
static bool find_upload(struct service *service, const struct request *request, struct catalog_upload *info,
                        struct response *response) {
    const char *id = request->match.capture[0];
    struct error error = {0};
    bool found;
    if (uploads_find(service->uploads, id, info, &found, &error) != STATUS_OK) {
        response_error(response, &error);
        return false;
    }
    found = found && principal_sees(&request->principal, info->principal);
    if (!found) response_refuse(response, PROBLEM_NO_SUCH_UPLOAD, "there is no upload %.40s", id);
    return found;
}

/* Gives the writer the request's body; a piece that would be too long is refused by its length. */
static bool take_piece(struct service *service, struct request *request, struct uploads_writer *writer, uint64_t most,
                       struct response *response) {
    struct body_plan plan = {.takes = BODY_PIECE,
                             .store = service->store,
                             .max_bytes = most,
                             .content_length = request->content_length,
                             .type = request->header[HEADER_CONTENT_TYPE],
                             .coding = request->header[HEADER_CONTENT_ENCODING],
                             .content_digest = request->header[HEADER_CONTENT_DIGEST],
                             .repr_digest = request->header[HEADER_REPR_DIGEST],
                             .writer = writer};
    struct problem problem;
    /* An empty one needs no type; the draft's first has that of the cloud, and its early versions' others have none. */
    if (!request->has_body || (speaks_draft(request) && (!plan.type || strcmp(request->method, "POST") == 0)))
        plan.type = "application/partial-upload";
    request->body = body_new(&plan, &problem);
    if (request->body) return true;
    response_problem(response, &problem);
    if (problem.kind == PROBLEM_BODY_TOO_LARGE) put_limit(service, request, 0, response);
    return false;
}

static bool read_length(struct service *service, const struct request *request, uint64_t *length,
                        struct response *response) {
    const char *defer = request->header[HEADER_UPLOAD_DEFER_LENGTH];
    uint64_t most = (uint64_t)service->config->max_body_bytes;
    struct problem problem;
    *length = UINT64_MAX;
    if (!read_number(request, HEADER_UPLOAD_LENGTH, length, response) || !read_complete(request, response) ||
        !read_rest(request, 0, length, response))
        return false;
    bool known = *length != UINT64_MAX, tus = !speaks_draft(request);
    if (tus && ((defer && strcmp(defer, "1") != 0) || known == (defer != NULL))) {
        response_refuse(response, PROBLEM_MALFORMED_REQUEST,
                        "either Upload-Length or Upload-Defer-Length: 1 must be there");
        return false;
    }
    if (!known || *length <= most) return true;
    upload_too_large(most, *length, &problem);
    response_problem(response, &problem);
    put_limit(service, request, 0, response);
    return false;
}

/* Visible ASCII and blanks, as a header is; it is given back as it came. */
static bool read_metadata(const struct request *request, struct catalog_upload *info, struct response *response) {
    const char *text = request->header[HEADER_UPLOAD_METADATA];
    bool ok = !text || strlen(text) < sizeof info->metadata;
    for (const char *c = text; ok && c && *c; c++) ok = *c >= ' ' && *c <= '~';
    if (ok)
        snprintf(info->metadata, sizeof info->metadata, "%s", text ? text : "");
    else
        response_refuse(response, PROBLEM_MALFORMED_REQUEST, "Upload-Metadata takes up to %d visible characters",
                        CATALOG_METADATA_BYTES - 1);
    return ok;
}

static const char final_prefix[] = "final;", final_kept[] = "final", partial_kept[] = "partial";

static bool is_final(const struct request *request) {
    const char *concat = request->header[HEADER_UPLOAD_CONCAT];
    return concat && strncmp(concat, final_prefix, sizeof final_prefix - 1) == 0;
}

static bool is_partial(const struct catalog_upload *info) { return strcmp(info->concat, partial_kept) == 0; }

static bool read_partial(const struct request *request, struct catalog_upload *info, struct response *response) {
    const char *concat = request->header[HEADER_UPLOAD_CONCAT];
    if (concat && strcmp(concat, partial_kept) != 0) {
        response_refuse(response, PROBLEM_MALFORMED_REQUEST,
                        "Upload-Concat takes partial, or final; and the URLs of partial uploads");
        return false;
    }
    if (concat) memcpy(info->concat, partial_kept, sizeof partial_kept);
    return true;
}

/* One that is made of others has neither a length nor bytes of its own. */
static bool admit_final(struct service *service, struct request *request, struct response *response) {
    bool has_bytes = request->has_body && request->content_length != 0;
    if (!speaks_tus(request, response) || !handlers_takes_no_query(request, response) ||
        !handlers_is_open(service, 0, false, response))
        return false;
    if (!has_bytes && !request->header[HEADER_UPLOAD_LENGTH] && !request->header[HEADER_UPLOAD_DEFER_LENGTH])
        return true;
    response_refuse(response, PROBLEM_MALFORMED_REQUEST, "a final upload has no body, and the length of its parts");
    return false;
}

static bool admit_upload(struct service *service, struct request *request, struct response *response) {
    struct catalog_upload info = {0};
    struct uploads_check check;
    struct problem problem;
    if (speaks_draft(request) && request->header[HEADER_UPLOAD_CONCAT]) {
        response_refuse(response, PROBLEM_MALFORMED_REQUEST, "Upload-Concat is of tus, and wants Tus-Resumable");
        return false;
    }
    if (is_final(request)) return admit_final(service, request, response);
    if (!speaks_either(request, response) || !handlers_takes_no_query(request, response) ||
        !read_partial(request, &info, response) || !read_length(service, request, &info.length, response) ||
        !read_metadata(request, &info, response) || !read_check(request, &check, response) ||
        !handlers_has_room(service, request, info.length == UINT64_MAX ? 0 : info.length, false, response))
        return false;
    memcpy(info.principal, request->principal.name, sizeof info.principal);
    const struct config *config = service->config;
    struct uploads_limits limits = {(uint64_t)config->max_uploads, (uint64_t)config->principal_uploads,
                                    (uint64_t)config->principal_bytes};
    info.expires_ms = job_now_ms() + config->upload_expiry_ms; /* until its first piece ends */
    struct uploads_writer *writer = uploads_create(service->uploads, &info, &check, &limits, &problem);
    if (!writer) {
        response_problem(response, &problem);
        return false;
    }
    uint64_t most = (uint64_t)config->max_body_bytes;
    return take_piece(service, request, writer, info.length < most ? info.length : most, response);
}

/* The length of an upload counts from the time on that it is known; a length that is told now is new. */
static bool has_room_for_piece(struct service *service, const struct request *request,
                               const struct catalog_upload *info, uint64_t length, struct response *response) {
    uint64_t body = request->content_length == UINT64_MAX ? 0 : request->content_length;
    if (!handlers_is_open(service, body, false, response)) return false;
    if (info->length != UINT64_MAX) return true;
    if (length != UINT64_MAX && length > info->offset) body = length - info->offset;
    return handlers_is_within_share(service, request, body, false, response);
}

static bool admit_piece(struct service *service, struct request *request, struct response *response) {
    struct catalog_upload info;
    struct uploads_check check;
    struct problem problem;
    uint64_t offset = UINT64_MAX, length = UINT64_MAX, most = (uint64_t)service->config->max_body_bytes;
    if (!speaks_either(request, response) || !read_complete(request, response) ||
        !handlers_takes_no_query(request, response) || !find_upload(service, request, &info, response) ||
        !read_number(request, HEADER_UPLOAD_OFFSET, &offset, response) ||
        !read_number(request, HEADER_UPLOAD_LENGTH, &length, response) || !read_check(request, &check, response) ||
        !has_room_for_piece(service, request, &info, length, response))
        return false;
    if (strncmp(info.concat, final_kept, sizeof final_kept - 1) == 0) {
        response_refuse(response, PROBLEM_FORBIDDEN, "a final upload takes no bytes: it has those of its parts");
        return false;
    }
    if (offset == UINT64_MAX) {
        response_refuse(response, PROBLEM_MALFORMED_REQUEST, "the header Upload-Offset is missing");
        return false;
    }
    if (speaks_draft(request) && offset == info.offset) { /* another one is refused with what it should be */
        if (length == UINT64_MAX) length = info.length;
        if (!read_rest(request, offset, &length, response)) return false;
    }
    if (length != UINT64_MAX && length > most) {
        upload_too_large(most, length, &problem);
        response_problem(response, &problem);
        put_limit(service, request, 0, response);
        return false;
    }
    uint64_t bytes = (uint64_t)service->config->principal_bytes;
    struct uploads_writer *writer = uploads_resume(service->uploads, info.id, offset, length, &check, bytes, &problem);
    if (!writer) {
        response_problem(response, &problem);
        response_header(response, "Upload-Offset", "%llu", (unsigned long long)info.offset);
        put_limit(service, request, info.expires_ms, response);
        return false;
    }
    uint64_t whole = length != UINT64_MAX ? length : info.length;
    if (whole > most) whole = most;
    return take_piece(service, request, writer, whole > offset ? whole - offset : 0, response);
}

/* ------------------------------------------------------------------------------------------------ pieces */

/* Whether its principal has more than its share, the upload included, whose length may not have been told before. */
static bool is_over_share(struct service *service, const struct catalog_upload *info, uint64_t *has) {
    uint64_t limit = (uint64_t)service->config->principal_bytes;
    if (!limit || info->cloud[0]) return false;
    struct catalog_usage figures = catalog_usage(service->catalog, info->principal);
    *has = figures.bytes + figures.reserved;
    return *has > limit;
}

/* What was gathered of an upload that any host goes on with is a copy, of this request alone. */
static void drop_copy(struct service *service, const char *id) {
    if (service->is_shared) scratch_part_delete(store_scratch(service->store), id);
}

/* Makes the whole upload a cloud; what is no cloud is removed.  false: *error says why, or *problem where that has no
 * code. */
static bool make_cloud(struct service *service, struct catalog_upload *info, struct problem *problem,
                       struct error *error) {
    struct upload_facts facts = {0};
    struct error ignored = {0};
    struct admission admission = service_admission(service->config, NULL);
    if (uploads_gather(service->uploads, info->id, info->length, error) != STATUS_OK) return false;
    int fd = scratch_part_open(store_scratch(service->store), info->id, false);
    if (fd < 0) {
        error_set(error, STATUS_IO, "uploads", "can't open upload %s: %s", info->id, strerror(errno));
        return false;
    }
    bool ok = upload_check_file(fd, &admission, &facts, problem);
    close(fd);
    if (!ok) {
        if (problem->kind != PROBLEM_INTERNAL_ERROR && uploads_delete(service->uploads, info->id, &ignored))
            log_line(LOG_ERROR, "upload=%s: %s", info->id, ignored.text);
        return false;
    }
    enum status status = service_keep_part(service, info->id, &facts, info->principal, error);
    if (status == STATUS_OK) status = uploads_complete(service->uploads, info->id, facts.sha256, error);
    if (status == STATUS_OK) memcpy(info->cloud, facts.sha256, sizeof info->cloud);
    return status == STATUS_OK;
}

/* Whether another request has made the cloud meanwhile, or deleted the upload: then no cloud is named. */
static bool is_settled(struct service *service, struct catalog_upload *info) {
    struct catalog_upload now = {0};
    struct error error = {0};
    bool found = true;
    enum status status = uploads_find(service->uploads, info->id, &now, &found, &error);
    bool open = status != STATUS_OK || (found && !now.cloud[0]);
    if (!open) memcpy(info->cloud, now.cloud, sizeof info->cloud);
    return !open;
}

/* Makes the upload a cloud if it is whole and none yet; false: the response says why that can't be. */
static bool finish(struct service *service, struct catalog_upload *info, struct response *response) {
    struct problem problem;
    struct error error = {0};
    struct uploads_turn turn;
    if (info->offset != info->length || info->cloud[0] || is_partial(info)) return true;
    bool is_over = uploads_take_turn(service->uploads, info->id, &turn) && is_settled(service, info);
    bool is_made = !is_over && make_cloud(service, info, &problem, &error);
    if (!is_over && !is_made) drop_copy(service, info->id);
    uploads_end_turn(service->uploads, &turn);
    if (is_made) return true;
    if (!is_over && !error.code)
        response_problem(response, &problem);
    else if (!is_over && !is_settled(service, info))
        response_error(response, &error);
    else if (info->cloud[0])
        return true;
    else
        response_refuse(response, PROBLEM_NO_SUCH_UPLOAD, "upload %s was deleted", info->id);
    return false;
}

/* The draft's last piece says that there is no more; the length that it made is noted, where it wasn't known. */
static bool seal(struct service *service, struct catalog_upload *info, struct response *response) {
    struct uploads_check check = {.whole = false};
    struct problem problem;
    int64_t expires_ms = job_now_ms() + service->config->upload_expiry_ms;
    if (info->length == UINT64_MAX) {
        struct uploads_writer *writer = uploads_resume(service->uploads, info->id, info->offset, info->offset, &check,
                                                       (uint64_t)service->config->principal_bytes, &problem);
        bool ok = writer && uploads_end(writer, expires_ms, info, &problem);
        uploads_writer_free(writer);
        if (!ok) response_problem(response, &problem);
        return ok;
    }
    if (info->offset == info->length) return true;
    response_refuse(response, PROBLEM_MALFORMED_REQUEST,
                    "this was the last piece, but the upload has %llu bytes of %llu", (unsigned long long)info->offset,
                    (unsigned long long)info->length);
    return false;
}

/* Makes a cloud of what the last piece was the end of.  That it is none is said as of the whole, not of the piece. */
static bool finish_last(struct service *service, const struct request *request, struct catalog_upload *info,
                        struct response *response) {
    if (!is_last(request)) return true;
    if (speaks_draft(request) && !seal(service, info, response)) return false;
    bool ok = finish(service, info, response);
    if (!ok && speaks_draft(request) && response->status < 500) response_header(response, "Upload-Complete", "?1");
    return ok;
}

/* The end of a piece.  false: the response says why; where info has an id, its bytes are kept. */
static bool end_piece(struct service *service, struct request *request, struct catalog_upload *info,
                      struct response *response) {
    struct problem problem;
    bool ended = body_end(request->body, &problem);
    if (ended) {
        wall_clock_hold();
        int64_t expires_ms = job_now_ms() + service->config->upload_expiry_ms;
        ended = uploads_end(body_writer(request->body), expires_ms, info, &problem);
        wall_clock_release();
    }
    if (!ended) {
        response_problem(response, &problem);
        info->id[0] = '\0';
        return false;
    }
    uint64_t has;
    if (!is_over_share(service, info, &has)) return finish_last(service, request, info, response);
    response_limit(response, PROBLEM_RATE_LIMITED, "principal_bytes", (uint64_t)service->config->principal_bytes, has);
    return false;
}

/* ------------------------------------------------------------------------------------------------ parts */

/* Reads the ids out of "final;URL URL ...", whether with a host or without.  Returns how many; 0: the response says
 * what is wrong. */
static size_t read_parts(const struct request *request, char (*ids)[JOB_ID_BYTES], struct response *response) {
    static const char path[] = "/v1/uploads/";
    const char *at = request->header[HEADER_UPLOAD_CONCAT] + sizeof final_prefix - 1;
    size_t count = 0;
    for (at += strspn(at, " "); *at; at += strspn(at, " ")) {
        size_t length = strcspn(at, " "), tail = sizeof path - 1 + JOB_ID_BYTES - 1;
        const char *first = strstr(at, path); /* two that something else than a blank parts aren't one */
        bool ok = count < CATALOG_MAX_PARTS && length >= tail && first == at + length - tail;
        if (ok) snprintf(ids[count], JOB_ID_BYTES, "%.36s", at + length - (JOB_ID_BYTES - 1));
        if (!ok || !job_id_valid(ids[count++])) {
            response_refuse(response, PROBLEM_MALFORMED_REQUEST,
                            "Upload-Concat: final; takes the URLs of 1 to %d partial uploads", CATALOG_MAX_PARTS);
            return 0;
        }
        at += length;
    }
    if (!count) response_refuse(response, PROBLEM_MALFORMED_REQUEST, "Upload-Concat: final; names no partial upload");
    return count;
}

/* Whether an id is none of those before it: a part that is named twice is there, and goes, once. */
static bool is_first(char (*ids)[JOB_ID_BYTES], size_t at) {
    for (size_t i = 0; i < at; i++)
        if (strcmp(ids[i], ids[at]) == 0) return false;
    return true;
}

/* Whether the upload is a part that is whole; adds its length. */
static bool find_part(struct service *service, const struct request *request, const char *id, uint64_t *length,
                      struct response *response) {
    struct catalog_upload part;
    struct error error = {0};
    bool found;
    if (uploads_find(service->uploads, id, &part, &found, &error) != STATUS_OK)
        response_error(response, &error);
    else if (!found || !principal_sees(&request->principal, part.principal))
        response_refuse(response, PROBLEM_NO_SUCH_UPLOAD, "there is no upload %.40s", id);
    else if (!is_partial(&part))
        response_refuse(response, PROBLEM_MALFORMED_REQUEST, "the upload %s is not partial", id);
    else if (part.offset != part.length)
        response_refuse(response, PROBLEM_OFFSET_MISMATCH, "the upload %s has %llu bytes, and is not whole", id,
                        (unsigned long long)part.offset);
    else
        return *length += part.length, true;
    return false;
}

/* Gives the writer the bytes of a part, of which there are so many. */
static bool append_part(struct service *service, const char *id, uint64_t length, struct uploads_writer *writer,
                        struct problem *problem) {
    enum { PART_BYTES = 1 << 18 };
    struct error error = {0};
    struct uploads_turn turn;
    struct scratch *scratch = store_scratch(service->store);
    char *bytes = malloc(PART_BYTES);
    uploads_take_turn(service->uploads, id, &turn);
    enum status status = bytes ? uploads_gather(service->uploads, id, length, &error)
                               : error_set(&error, STATUS_NO_MEMORY, "", "no memory");
    int fd = status == STATUS_OK ? scratch_part_open(scratch, id, false) : -1;
    if (status == STATUS_OK && fd < 0)
        error_set(&error, STATUS_IO, "uploads", "can't open upload %s: %s", id, strerror(errno));
    bool ok = !error.code;
    if (!ok) problem_from_error(problem, &error);
    for (ssize_t n = 1; ok && n > 0;) {
        n = read(fd, bytes, PART_BYTES);
        if (n < 0) problem_set(problem, PROBLEM_INTERNAL_ERROR, "can't read upload %s: %s", id, strerror(errno));
        ok = n >= 0 && (n == 0 || uploads_write(writer, bytes, (size_t)n, problem));
    }
    if (fd >= 0) close(fd);
    drop_copy(service, id);
    uploads_end_turn(service->uploads, &turn);
    free(bytes);
    return ok;
}

/* What a final upload is made of. */
struct parts {
    char id[CATALOG_MAX_PARTS][JOB_ID_BYTES];
    uint64_t length[CATALOG_MAX_PARTS];
    size_t count, different; /* those that are named again counted once */
    uint64_t different_bytes;
};

/* Makes the upload of its parts; they count for its principal until they go, which isn't held against what they make.
 * Where that fails there is nothing of it. */
static bool join_parts(struct service *service, struct catalog_upload *info, const struct parts *parts,
                       struct response *response) {
    const struct config *config = service->config;
    struct uploads_check check = {.whole = false};
    struct uploads_limits limits = {(uint64_t)config->max_uploads + parts->different,
                                    (uint64_t)config->principal_uploads + parts->different,
                                    (uint64_t)config->principal_bytes};
    struct problem problem;
    struct error error = {0};
    if (limits.principal_bytes) limits.principal_bytes += parts->different_bytes;
    struct uploads_writer *writer = uploads_create(service->uploads, info, &check, &limits, &problem);
    char id[JOB_ID_BYTES];
    memcpy(id, info->id, sizeof id);
    bool ok = writer != NULL, ends = false;
    for (size_t i = 0; ok && i < parts->count; i++)
        ok = append_part(service, parts->id[i], parts->length[i], writer, &problem);
    if (ok) {
        wall_clock_hold();
        ok = uploads_end(writer, job_now_ms() + config->upload_expiry_ms, info, &problem);
        wall_clock_release();
        ends = true;
    }
    uploads_writer_free(writer);
    if (!ok) response_problem(response, &problem);
    if (!ok && ends && uploads_delete(service->uploads, id, &error) != STATUS_OK)
        log_line(LOG_ERROR, "upload=%s expires: %s", id, error.text);
    return ok;
}

/* A final upload of parts that are there and whole; info has its name. */
static bool make_final(struct service *service, struct request *request, struct parts *parts,
                       struct catalog_upload *info, struct response *response) {
    struct problem problem;
    uint64_t most = (uint64_t)service->config->max_body_bytes;
    for (size_t i = 0; i < parts->count; i++) {
        uint64_t before = info->length;
        if (!find_part(service, request, parts->id[i], &info->length, response)) return false;
        parts->length[i] = info->length - before;
        if (is_first(parts->id, i)) parts->different++, parts->different_bytes += parts->length[i];
    }
    if (info->length > most) {
        upload_too_large(most, info->length, &problem);
        response_problem(response, &problem);
        return false;
    }
    info->expires_ms = job_now_ms() + service->config->upload_expiry_ms;
    return handlers_is_open(service, info->length, false, response) && join_parts(service, info, parts, response) &&
           finish(service, info, response);
}

/* Looks for what an earlier request, whose answer may have been lost, has made of these parts; *found false: nothing.
 * Returns whether it is a cloud; else, where it is found, the response says why not. */
static bool find_made(struct service *service, struct catalog_upload *info, bool *found, struct response *response) {
    struct catalog_upload made;
    struct error error = {0};
    enum status status = uploads_find_final(service->uploads, info->principal, info->concat, &made, found, &error);
    *found = *found && status == STATUS_OK;
    if (!*found) return false;
    response_done(response);
    *info = made;
    return finish(service, info, response);
}

/* A final upload.  Two requests for the same one at once may make two, of one cloud; what has gone to make the one
 * can't make the other any more, and then that is the answer.  false: the response says why there is none. */
static bool create_final(struct service *service, struct request *request, struct catalog_upload *info,
                         struct response *response) {
    struct parts parts = {.count = 0};
    struct error error = {0};
    size_t used = sizeof final_kept - 1;
    memset(info, 0, sizeof *info);
    memcpy(info->principal, request->principal.name, sizeof info->principal);
    memcpy(info->concat, final_kept, sizeof final_kept);
    parts.count = read_parts(request, parts.id, response);
    if (!parts.count || !read_metadata(request, info, response)) return false;
    for (size_t i = 0; i < parts.count; i++)
        used += (size_t)snprintf(info->concat + used, sizeof info->concat - used, " %s", parts.id[i]);
    bool found = false, ok = find_made(service, info, &found, response);
    if (!found) ok = make_final(service, request, &parts, info, response);
    if (!found && !ok) ok = find_made(service, info, &found, response);
    if (!ok) return false;
    for (size_t i = 0; i < parts.count; i++) /* what can't be removed now expires */
        if (uploads_delete(service->uploads, parts.id[i], &error) != STATUS_OK)
            log_line(LOG_ERROR, "upload=%s: %s", parts.id[i], error.text);
    return true;
}

static void create_upload(struct service *service, struct request *request, struct response *response) {
    struct catalog_upload info;
    struct error error = {0};
    bool made = is_final(request) ? create_final(service, request, &info, response)
                                  : end_piece(service, request, &info, response);
    if (!made && !is_final(request) && info.id[0] && uploads_delete(service->uploads, info.id, &error) != STATUS_OK)
        log_line(LOG_ERROR, "upload=%s expires: %s", info.id, error.text);
    if (!made) return;
    put_document(&info, 201, response);
    put_progress(service, request, &info, response);
    response_header(response, "Location", "%s/v1/uploads/%s", links_base(), info.id);
}

const struct handler handlers_create_upload = {.admit = admit_upload, .run = create_upload};

static void continue_upload(struct service *service, struct request *request, struct response *response) {
    struct catalog_upload info;
    if (!end_piece(service, request, &info, response)) return;
    if (speaks_draft(request) && is_last(request)) { /* as the answer to one that came in one piece */
        put_document(&info, 200, response);
    } else {
        response->status = 204;
        put_state(&info, response);
    }
    put_progress(service, request, &info, response);
}

const struct handler handlers_continue_upload = {.admit = admit_piece, .run = continue_upload};

/* ------------------------------------------------------------------------------------------------ read, delete */

/* Who asks with HEAD is about to go on: whoever wrote until now can't any more, and by tus what is whole becomes a
 * cloud.  GET only looks. */
static void get_upload(struct service *service, struct request *request, struct response *response) {
    struct catalog_upload info;
    request->tus = !speaks_draft(request);
    if ((request->head && !speaks_either(request, response)) || !handlers_takes_no_query(request, response) ||
        !find_upload(service, request, &info, response))
        return;
    struct error error = {0};
    if (request->head && uploads_interrupt(service->uploads, info.id, &error) != STATUS_OK) {
        response_error(response, &error);
        return;
    }
    if (!find_upload(service, request, &info, response)) return;
    uint64_t has;
    bool may_finish = request->head && !speaks_draft(request) && !is_over_share(service, &info, &has);
    if (may_finish && !finish(service, &info, response)) return;
    put_document(&info, 200, response);
    put_progress(service, request, &info, response);
    if (info.length == UINT64_MAX && !speaks_draft(request))
        response_header(response, "Upload-Defer-Length", "1");
    else if (info.length != UINT64_MAX)
        response_header(response, "Upload-Length", "%llu", (unsigned long long)info.length);
    if (info.metadata[0]) response_header(response, "Upload-Metadata", "%s", info.metadata);
}

const struct handler handlers_get_upload = {.run = get_upload};

static void delete_upload(struct service *service, struct request *request, struct response *response) {
    struct catalog_upload info;
    struct error error = {0};
    if (!speaks_either(request, response) || !handlers_takes_no_query(request, response) ||
        !find_upload(service, request, &info, response) || !handlers_admit_match(request, NULL, response))
        return;
    if (uploads_delete(service->uploads, info.id, &error) == STATUS_OK)
        response->status = 204;
    else
        response_error(response, &error);
}

const struct handler handlers_delete_upload = {.run = delete_upload};
