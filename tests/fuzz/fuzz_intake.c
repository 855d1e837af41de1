/* Fuzzes what takes the bodies of requests apart: forms, in pieces that the input chooses, and JSON documents.
 *
 * The first byte chooses; of a form, whatever the pieces, the same parts must come out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/job_request.h"
#include "server/http/multipart.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition) {
    if (!condition) abort();
}

/* What came out, as a number. */
struct seen {
    uint64_t hash;
    int open, parts;
};

static void add(struct seen *seen, const void *bytes, size_t count) {
    const unsigned char *p = bytes;
    for (size_t i = 0; i < count; i++) seen->hash = (seen->hash ^ p[i]) * 0x100000001b3;
}

static bool begin(void *ctx, const struct multipart_part *part, struct problem *problem) {
    struct seen *seen = ctx;
    (void)problem;
    require(!seen->open++ && part->name[0]);
    seen->parts++;
    add(seen, part->name, strlen(part->name) + 1);
    add(seen, part->type, strlen(part->type) + 1);
    return true;
}

static bool take(void *ctx, const void *bytes, size_t count, struct problem *problem) {
    struct seen *seen = ctx;
    (void)problem;
    require(seen->open && count);
    add(seen, bytes, count);
    return true;
}

static bool end(void *ctx, struct problem *problem) {
    struct seen *seen = ctx;
    (void)problem;
    require(seen->open--);
    add(seen, "|", 1);
    return true;
}

/* Pieces of `piece` bytes; 0 = all at once. */
static bool parse(const uint8_t *data, size_t size, size_t piece, struct seen *seen) {
    struct multipart_sink sink = {begin, take, end, seen};
    struct problem problem = {.kind = PROBLEM_COUNT};
    struct multipart *form = multipart_new("multipart/form-data; boundary=\"b\"", sink, &problem);
    require(form != NULL);
    bool ok = true;
    for (size_t i = 0, n; ok && i < size; i += n) {
        n = piece && piece < size - i ? piece : size - i;
        ok = multipart_push(form, data + i, n, &problem);
    }
    ok = ok && multipart_end(form, &problem);
    require(ok || problem.kind != PROBLEM_COUNT);
    require(!ok || !seen->open);
    multipart_free(form);
    return ok;
}

static void fuzz_form(const uint8_t *data, size_t size, size_t piece) {
    struct seen whole = {0}, pieces = {0};
    bool one = parse(data, size, 0, &whole), other = parse(data, size, piece, &pieces);
    require(one == other && whole.parts == pieces.parts);
    require(!one || whole.hash == pieces.hash);
}

static void fuzz_boundary(const uint8_t *data, size_t size) {
    struct multipart_sink sink = {begin, take, end, NULL};
    struct problem problem;
    char *type = malloc(size + 1);
    require(type != NULL);
    memcpy(type, data, size);
    type[size] = 0;
    multipart_free(multipart_new(type, sink, &problem));
    free(type);
}

static void fuzz_document(const uint8_t *data, size_t size) {
    static const char *const names[] = {"label", "priority", NULL};
    static struct job_request request;
    struct problem problem = {.kind = PROBLEM_COUNT};
    memset(&request, 0, sizeof request);
    bool ok = job_request_read(&request, (const char *)data, size, names, NULL, &problem);
    require(ok ? request.input[0] != 0 : problem.kind != PROBLEM_COUNT);
    if (!ok) free(problem_encode(&problem));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (!size) return 0;
    size_t choice = data[0];
    if (choice == '{')
        fuzz_document(data, size);
    else if (choice == ';')
        fuzz_boundary(data, size);
    else
        fuzz_form(data, size, choice % 9 + 1);
    return 0;
}
