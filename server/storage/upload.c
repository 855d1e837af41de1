/* A cloud on its way in.
 *
 * The kind is told by the first SNIFF_BYTES, a PLY header is checked as soon as it is complete, and both are checked
 * once more with the true length at the end.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/upload.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/fault.h"
#include "core/io/codec/inflate.h"
#include "core/io/formats/ply_header.h"
#include "core/io/sniff.h"
#include "server/base/digest.h"
#include "server/storage/upload_hasher.h"

enum { SNIFF_BYTES = 4096 };

struct upload {
    struct store *store;
    struct scratch_file file;
    struct upload_hasher *hasher; /* hashes the file */
    uint64_t bytes, expected_bytes, max_bytes;
    bool checked; /* the format is known and right, as far as the first bytes tell */
    struct admission admission;
    struct upload_facts facts;
    size_t head_bytes;
    unsigned char head[INFLATE_HEAD_BYTES]; /* the first bytes */
};

void upload_too_large(uint64_t max_bytes, uint64_t bytes, struct problem *problem) {
    problem_set(problem, PROBLEM_BODY_TOO_LARGE, "the body is longer than %llu bytes", (unsigned long long)max_bytes);
    problem_add_number(problem, "limit", (int64_t)max_bytes);
    if (bytes <= INT64_MAX) problem_add_number(problem, "actual", (int64_t)bytes);
    problem_add_text(problem, "hint", "send binary PLY, or thin the cloud out first");
}

void upload_piece_too_large(uint64_t left, uint64_t bytes, struct problem *problem) {
    problem_set(problem, PROBLEM_BODY_TOO_LARGE, "the piece is longer than the %llu bytes that its upload still takes",
                (unsigned long long)left);
    problem_add_number(problem, "limit", (int64_t)left);
    if (bytes <= INT64_MAX) problem_add_number(problem, "actual", (int64_t)bytes);
    problem_add_text(problem, "hint", "HEAD tells how far the upload is, and its length; OPTIONS how long one may be");
}

struct upload *upload_new(struct store *store, struct thread_pool *threads, uint64_t expected_bytes, uint64_t max_bytes,
                          const struct admission *admission, struct problem *problem) {
    struct error error = {0};
    struct upload *upload = alloc_zeroed(1, sizeof *upload);
    if (!upload) {
        problem_set(problem, PROBLEM_INTERNAL_ERROR, "no memory");
        return NULL;
    }
    *upload = (struct upload){.store = store,
                              .file.fd = -1,
                              .expected_bytes = expected_bytes,
                              .max_bytes = max_bytes,
                              .admission = *admission};
    bool fits = expected_bytes == UINT64_MAX || expected_bytes <= max_bytes;
    if (!fits)
        upload_too_large(max_bytes, expected_bytes, problem);
    else if (scratch_file_begin(store_scratch(store), &upload->file, &error) != STATUS_OK)
        problem_from_error(problem, &error);
    else if (!(upload->hasher = upload_hasher_new(threads, upload->file.fd, expected_bytes)))
        problem_set(problem, PROBLEM_INTERNAL_ERROR, "no memory");
    else
        return upload;
    upload_free(upload);
    return NULL;
}

void upload_free(struct upload *upload) {
    if (!upload) return;
    scratch_file_drop(store_scratch(upload->store), &upload->file);
    upload_hasher_free(upload->hasher);
    free(upload);
}

/* ------------------------------------------------------------------------------------------------ format */

static bool check_ply(struct upload *upload, uint64_t total, struct problem *problem) {
    struct ply_summary summary = {0};
    struct error error = {0};
    enum status status = ply_header_check(upload->head, upload->head_bytes, total, &summary, &error);
    if (status != STATUS_OK) {
        problem_from_error(problem, &error);
        return false;
    }
    if (!summary.complete) return true;
    upload->checked = true;
    upload->facts.points = summary.vertex_count;
    snprintf(upload->facts.format, sizeof upload->facts.format, "%s", ply_form_name(summary.form));
    return true;
}

static bool refuse_kind(const char *looks_like, struct problem *problem) {
    struct error error = {0};
    error_set(&error, STATUS_UNSUPPORTED, "", "the body looks like %s, not like a cloud in a supported format",
              looks_like);
    problem_from_error(problem, &error);
    if (strcmp(looks_like, "JSON") == 0)
        problem_add_text(problem, "hint", "a job on a cloud that is here comes as Content-Type: application/json");
    return false;
}

/* Looks at the first bytes; total is the length of all, UINT64_MAX = not known. */
static bool check_kind(struct upload *upload, uint64_t total, bool at_end, struct problem *problem) {
    if (upload->head_bytes < SNIFF_BYTES && !at_end && upload->head_bytes < total) return true;
    struct cloud_guess guess = cloud_sniff(upload->head, upload->head_bytes);
    if (guess.kind == CLOUD_KIND_PLY) return check_ply(upload, total, problem);
    if (guess.kind == CLOUD_KIND_OTHER) return refuse_kind(guess.looks_like, problem);
    if (guess.kind == CLOUD_KIND_EMPTY) {
        problem_set(problem, PROBLEM_MALFORMED_CLOUD, "the body is empty");
        return false;
    }
    upload->checked = true;
    snprintf(upload->facts.format, sizeof upload->facts.format, "%s", guess.form);
    return true;
}

static bool check_head(struct upload *upload, uint64_t total, bool at_end, struct problem *problem) {
    struct admitted ignored;
    if (!check_kind(upload, total, at_end, problem)) return false;
    return !upload->checked ||
           admission_check(&upload->admission, upload->head, upload->head_bytes, total, &ignored, problem);
}

static bool check_more(struct upload *upload, const void *bytes, size_t count, struct problem *problem) {
    size_t room = sizeof upload->head - upload->head_bytes, taken = count < room ? count : room;
    memcpy(upload->head + upload->head_bytes, bytes, taken);
    upload->head_bytes += taken;
    return upload->checked || check_head(upload, upload->expected_bytes, false, problem);
}

/* ------------------------------------------------------------------------------------------------ bytes */

static bool write_all(struct upload *upload, const char *bytes, size_t count, struct problem *problem) {
    while (count) {
        bool fails =
            fault_at("upload-write") || !scratch_may_go_on(store_scratch(upload->store), upload->bytes - count, count);
        ssize_t n = fails ? -1 : write(upload->file.fd, bytes, count);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) {
            struct error error;
            error_set(&error, status_from_errno(errno), "", "the body can't be stored: %s", strerror(errno));
            problem_from_error(problem, &error);
            return false;
        }
        bytes += n;
        count -= (size_t)n;
    }
    return true;
}

bool upload_write(struct upload *upload, const void *bytes, size_t count, struct problem *problem) {
    if (count > upload->max_bytes - upload->bytes) {
        upload_too_large(upload->max_bytes, UINT64_MAX, problem);
        return false;
    }
    if (!check_more(upload, bytes, count, problem)) return false;
    upload->bytes += count;
    if (!write_all(upload, bytes, count, problem)) return false;
    upload_hasher_advance(upload->hasher, count);
    return true;
}

const char *upload_hash(struct upload *upload, struct problem *problem) {
    if (upload->facts.sha256[0] || upload_hasher_finish(upload->hasher, upload->facts.sha256) == 0)
        return upload->facts.sha256;
    problem_set(problem, PROBLEM_INTERNAL_ERROR, "the body can't be read back: %s", strerror(errno));
    return NULL;
}

bool upload_end(struct upload *upload, struct upload_facts *facts, struct problem *problem) {
    if (!check_head(upload, upload->bytes, true, problem) || !upload_hash(upload, problem)) return false;
    upload->facts.bytes = upload->bytes;
    *facts = upload->facts;
    return true;
}

const void *upload_head(const struct upload *upload, size_t *count) {
    *count = upload->head_bytes;
    return upload->head;
}

bool upload_check_file(int fd, const struct admission *admission, struct upload_facts *facts, struct problem *problem) {
    struct upload *upload = alloc_zeroed(1, sizeof *upload);
    ssize_t n = upload ? pread(fd, upload->head, sizeof upload->head, 0) : -1;
    bool ok = n >= 0 && digest_file(fd, upload->facts.sha256, &upload->facts.bytes) == 0;
    if (ok) {
        upload->admission = *admission;
        upload->head_bytes = (size_t)n;
        ok = check_head(upload, upload->facts.bytes, true, problem);
        *facts = upload->facts;
    } else {
        problem_set(problem, PROBLEM_INTERNAL_ERROR, "the upload can't be read");
    }
    free(upload);
    return ok;
}

enum status upload_sync(struct upload *upload, struct error *error) { return scratch_file_sync(&upload->file, error); }

enum status upload_keep(struct upload *upload, struct error *error) {
    return store_upload_keep(upload->store, &upload->file, upload->facts.sha256, error);
}
