/* OFF.
 *
 *     file   = ["ST"] ["C"] ["N"] "OFF"  vertices faces [edges]  {vertex} {face}
 *     vertex = x y z [nx ny nz] [red green blue [alpha]] [s t]      as the letters before OFF promise
 *     face   = count index ... [colour]                              the colour up to the end of its line
 *
 * "#" begins a comment, and letters may be small ("noff" is then NOFF).  Numbers may be spread over lines as one likes,
 * but how many a vertex has is told by the first vertex's line: colours have three or four, and what stands there
 * without a letter that promises it becomes columns without a name where the second vertex's line is as long.  Where
 * one line holds all vertices, they are equal parts of it.  Where it holds the faces, too, vertices have what the
 * letters promise, with three or four components of a colour as the faces fit, and faces have no colours.  Everything
 * becomes float64, so that what is written is what is kept.  Faces become fans of triangles; their colours are left
 * out.
 *
 * After "OFF BINARY" and the end of that line all numbers have 32 bits and come big endian: three counts, vertices as
 * floats (colours have four of them), faces as count, indices, how many numbers a colour has, and these.  What is
 * written of floats are floats.
 *
 * Invariant: every number takes at least two bytes of the file, so its counts bound what is allocated.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"

#include <inttypes.h>
#include <stdbool.h>
#include <string.h>

#include "core/base/endian.h"
#include "core/io/build.h"
#include "core/io/first_bytes.h"
#include "core/io/padding.h"
#include "core/io/text_scanner.h"

struct reader {
    struct cloud_build build;
    struct scan scan;
    bool texture, colour, normal, is_binary;
    bool one_line; /* all that follows the header is on one */
    uint64_t vertices, faces;
    const unsigned char *bytes; /* of binary: all, how many, and the next one */
    size_t n, at;
};

static struct cloud_place off_here(const struct reader *r) {
    return (struct cloud_place){r->scan.line, (uint64_t)(r->scan.at - r->scan.begin)};
}

static enum status off_bad_word(struct reader *r, const char *where, const struct scan_word *word, const char *what) {
    char quote[NUMBER_QUOTE_BYTES];
    if (!word->n) return cloud_build_bad(&r->build, where, off_here(r), "the file ends where %s should be", what);
    return cloud_build_bad(&r->build, where, off_here(r), "'%s' is not %s", scan_quote(word, quote), what);
}

static enum status unsupported(struct reader *r, const char *what) {
    return error_set_at(r->build.error, STATUS_UNSUPPORTED, "header", r->scan.line, UINT64_MAX, "%s", what);
}

/* ------------------------------------------------------------------------------------------------ header */

static bool pass(const char **at, const char *end, const char *prefix) {
    size_t n = strlen(prefix);
    if ((size_t)(end - *at) < n || memcmp(*at, prefix, n) != 0) return false;
    *at += n;
    return true;
}

static enum status off_take_keyword(struct reader *r) {
    struct scan_word word;
    if (!scan_token(&r->scan, &word)) return off_bad_word(r, "header", &word, "OFF");
    const char *at = word.text, *end = at + word.n;
    r->texture = pass(&at, end, "ST") || pass(&at, end, "st");
    r->colour = pass(&at, end, "C") || pass(&at, end, "c");
    r->normal = pass(&at, end, "N") || (end - at == 4 && memcmp(at, "noff", 4) == 0 && pass(&at, end, "n"));
    if (pass(&at, end, "4")) return unsupported(r, "OFF with homogeneous coordinates isn't read");
    if (pass(&at, end, "n")) return unsupported(r, "OFF of more dimensions than three isn't read");
    if ((!pass(&at, end, "OFF") && !pass(&at, end, "off")) || at != end)
        return off_bad_word(r, "header", &word, "an OFF keyword");
    return STATUS_OK;
}

static enum status off_take_count(struct reader *r, const char *what, uint64_t *count) {
    struct scan_word word;
    if (!scan_token(&r->scan, &word) || !scan_u64(&word, count)) return off_bad_word(r, "header", &word, what);
    return STATUS_OK;
}

/* No file of n bytes can hold more numbers than half of them. */
static enum status check_counts(struct reader *r) {
    uint64_t left = (uint64_t)(r->scan.end - r->scan.at) + 1;
    if (r->vertices > left / 6 || r->faces > left / 2)
        return cloud_build_bad(&r->build, "header", off_here(r),
                               "%" PRIu64 " vertices and %" PRIu64 " faces are promised, which %" PRIu64
                               " bytes can't hold",
                               r->vertices, r->faces, left - 1);
    return STATUS_OK;
}

static enum status off_take_header(struct reader *r) {
    struct scan_word word;
    enum status status = off_take_keyword(r);
    struct scan ahead = r->scan;
    if (!status && scan_word(&ahead, &word) && scan_is(&word, "BINARY")) {
        r->is_binary = true;
        while (ahead.at < ahead.end && *ahead.at != '\n') ahead.at++;
        r->at = (size_t)(ahead.at - ahead.begin) + 1;
        return STATUS_OK;
    }
    if (!status) status = off_take_count(r, "the count of vertices", &r->vertices);
    if (!status) status = off_take_count(r, "the count of faces", &r->faces);
    if (!status && scan_word(&r->scan, &word)) { /* edges: of no use to anybody */
        uint64_t edges;
        if (!scan_u64(&word, &edges)) status = off_bad_word(r, "header", &word, "the count of edges");
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ vertices */

/* How many words the line of the next one has, and the one after that; 0 = there is none.  Moves the cursor. */
static size_t words_of_line(struct scan *ahead) {
    struct scan_word word;
    size_t n = scan_token(ahead, &word) ? 1 + scan_count_words(*ahead) : 0;
    scan_next_line(ahead);
    return n;
}

/* Whether vertices of this many numbers leave just the faces, of three corners or more. */
static bool fits_before_faces(const struct reader *r, size_t width) {
    struct scan ahead = r->scan;
    struct scan_word word;
    uint64_t n, index;
    for (uint64_t i = 0; i < r->vertices * width; i++)
        if (!scan_token(&ahead, &word)) return false;
    for (uint64_t i = 0; i < r->faces; i++) {
        if (!scan_token(&ahead, &word) || !scan_u64(&word, &n) || n < 3) return false;
        for (; n; n--)
            if (!scan_token(&ahead, &word) || !scan_u64(&word, &index) || index >= r->vertices) return false;
    }
    return !scan_token(&ahead, &word);
}

/* The numbers of a vertex where faces are on the same line: colours may have one more, and only one of both may fit. */
static size_t width_before_faces(const struct reader *r, size_t promised) {
    if (!r->colour) return promised;
    bool three = fits_before_faces(r, promised), four = fits_before_faces(r, promised + 1);
    return three == four ? 0 : four ? promised + 1 : promised;
}

/* How many numbers the first vertex has, 0: can't be told; the scan stands before it. */
static size_t off_width_of(struct reader *r, size_t promised) {
    struct scan ahead = r->scan;
    size_t here_words = words_of_line(&ahead), next_words = words_of_line(&ahead), width = here_words;
    r->one_line = !next_words;
    if (here_words && r->one_line && r->faces) return width_before_faces(r, promised);
    if (here_words != next_words) {
        bool all_here = r->vertices && here_words % r->vertices == 0;
        width = all_here ? (size_t)(here_words / r->vertices) : r->colour ? here_words : promised;
    }
    return width < promised ? promised : width;
}

static enum status off_add_properties(struct reader *r, const char *const *names, size_t n) {
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < n; i++) status = cloud_build_property(&r->build, names[i], SCALAR_FLOAT64);
    return status;
}

static enum status off_describe(struct reader *r) {
    static const char *const xyz[] = {"x", "y", "z"}, *const normal[] = {"nx", "ny", "nz"}, *const st[] = {"s", "t"},
                             *const colour[] = {"red", "green", "blue", "alpha"}, *const unnamed[] = {""};
    size_t promised = 3u + (r->normal ? 3u : 0u) + (r->colour ? 3u : 0u) + (r->texture ? 2u : 0u);
    size_t width = off_width_of(r, promised);
    if (!width)
        return unsupported(r, "faces on the line of the vertices don't tell whether colours have three or four "
                              "components: put a line end after each vertex");
    size_t extra = width - promised;
    size_t colours = r->colour ? 3 + (extra > 0) : 0;
    if (r->colour && extra > 0) extra--;
    enum status status = off_add_properties(r, xyz, 3);
    if (!status && r->normal) status = off_add_properties(r, normal, 3);
    if (!status) status = off_add_properties(r, colour, colours);
    if (!status && r->texture) status = off_add_properties(r, st, 2);
    for (; !status && extra > 0; extra--) status = off_add_properties(r, unnamed, 1);
    return status;
}

static enum status off_take_vertex(struct reader *r) {
    double record[CLOUD_MAX_PROPERTIES];
    struct scan_word word;
    struct cloud_place place = off_here(r);
    for (size_t j = 0; j < r->build.cloud.property_count; j++) {
        if (!scan_token(&r->scan, &word) || !scan_f64(&word, &record[j]))
            return off_bad_word(r, r->build.cloud.property[j].name, &word, "a number");
        if (j == 0) place.line = r->scan.line;
    }
    return cloud_build_point(&r->build, record, place);
}

/* ------------------------------------------------------------------------------------------------ faces */

static enum status off_take_index(struct reader *r, uint32_t *index) {
    struct scan_word word;
    uint64_t value;
    if (!scan_token(&r->scan, &word) || !scan_u64(&word, &value))
        return off_bad_word(r, "face", &word, "the index of a vertex");
    if (value >= r->build.cloud.count)
        return cloud_build_bad(&r->build, "face", off_here(r), "index %" PRIu64 ", but there are %zu vertices", value,
                               r->build.cloud.count);
    *index = (uint32_t)value;
    return STATUS_OK;
}

static enum status off_take_face(struct reader *r) {
    struct scan_word word;
    uint64_t n = 0;
    uint32_t first = 0, last = 0, next = 0;
    if (!scan_token(&r->scan, &word) || !scan_u64(&word, &n))
        return off_bad_word(r, "face", &word, "how many vertices a face has");
    if (n > (size_t)(r->scan.end - r->scan.at) / 2)
        return cloud_build_bad(&r->build, "face", off_here(r), "a face of %" PRIu64 " vertices is longer than the file",
                               n);
    enum status status = STATUS_OK;
    for (uint64_t i = 0; !status && i < n; i++, last = next) {
        status = off_take_index(r, &next);
        if (i == 0) first = next;
        if (!status && i >= 2) status = cloud_build_triangle(&r->build, first, last, next);
    }
    if (r->one_line) return status;
    if (!status && scan_word(&r->scan, &word)) status = cloud_build_leave_out(&r->build, "colours of faces");
    scan_next_line(&r->scan);
    return status;
}

/* What follows the last face goes to the report. */
static enum status off_note_rest(struct reader *r, const void *rest, size_t n) {
    char note[PADDING_NOTE_BYTES];
    if (n == 0) return STATUS_OK;
    padding_note(note, rest, n);
    return cloud_build_leave_out(&r->build, note);
}

static enum status off_end_lines(struct reader *r) {
    struct scan_word word;
    if (!scan_token(&r->scan, &word)) return STATUS_OK;
    return off_note_rest(r, word.text, (size_t)(r->scan.end - word.text));
}

/* ------------------------------------------------------------------------------------------------ binary */

static enum status binary_bad(struct reader *r, const char *where, const char *what, uint64_t value) {
    return cloud_build_bad(&r->build, where, (struct cloud_place){0, r->at < r->n ? r->at : r->n}, "%s (%" PRIu64 ")",
                           what, value);
}

/* The next number; false where the file ends. */
static bool take_u32(struct reader *r, uint32_t *value) {
    if (r->at > r->n || r->n - r->at < 4) return false;
    *value = (uint32_t)load_big_endian(r->bytes + r->at, 4);
    r->at += 4;
    return true;
}

static enum status take_binary_counts(struct reader *r) {
    uint32_t vertices, faces, edges;
    if (!take_u32(r, &vertices) || !take_u32(r, &faces) || !take_u32(r, &edges))
        return binary_bad(r, "header", "the file ends in its counts; bytes there", r->n);
    r->vertices = vertices, r->faces = faces;
    uint64_t left = r->n - r->at;
    if (r->vertices > left / 12 || r->faces > (left - 12 * r->vertices) / 8)
        return cloud_build_bad(&r->build, "header", (struct cloud_place){0, r->at - 12},
                               "%" PRIu64 " vertices and %" PRIu64 " faces are promised, which %" PRIu64
                               " bytes can't hold",
                               r->vertices, r->faces, left);
    return STATUS_OK;
}

static enum status describe_binary(struct reader *r) {
    static const char *const names[] = {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha", "s", "t"};
    const bool has[] = {true, r->normal, r->colour, r->texture};
    static const size_t first[] = {0, 3, 6, 10, 12};
    enum status status = STATUS_OK;
    for (size_t k = 0; k < 4; k++)
        for (size_t j = first[k]; !status && has[k] && j < first[k + 1]; j++)
            status = cloud_build_property(&r->build, names[j], SCALAR_FLOAT32);
    return status;
}

static enum status take_binary_vertex(struct reader *r) {
    float record[12];
    struct cloud_place place = {0, r->at};
    for (size_t j = 0; j < r->build.cloud.property_count; j++) {
        uint32_t bits;
        if (!take_u32(r, &bits)) return binary_bad(r, "read", "the file ends in vertex", r->build.cloud.count);
        memcpy(&record[j], &bits, sizeof bits);
    }
    return cloud_build_point(&r->build, record, place);
}

static enum status take_binary_face(struct reader *r) {
    uint32_t n, first = 0, last = 0, next, colours;
    if (!take_u32(r, &n)) return binary_bad(r, "face", "the file ends in its faces; bytes there", r->n);
    enum status status = STATUS_OK;
    for (uint32_t i = 0; !status && i < n; i++, last = next) {
        if (!take_u32(r, &next)) return binary_bad(r, "face", "the file ends in a face of so many vertices", n);
        if (next >= r->build.cloud.count) return binary_bad(r, "face", "there is no such vertex", next);
        if (i == 0) first = next;
        if (i >= 2) status = cloud_build_triangle(&r->build, first, last, next);
    }
    if (!status && !take_u32(r, &colours)) return binary_bad(r, "face", "the file ends in a face", r->n);
    if (!status && colours > (r->n - r->at) / 4) return binary_bad(r, "face", "no colour has so many numbers", colours);
    if (!status && colours) {
        r->at += 4 * (size_t)colours;
        status = cloud_build_leave_out(&r->build, "colours of faces");
    }
    return status;
}

static enum status read_binary_off(struct reader *r) {
    enum status status = take_binary_counts(r);
    if (!status) status = describe_binary(r);
    if (!status) status = cloud_build_room(&r->build, r->vertices);
    for (uint64_t i = 0; !status && i < r->vertices; i++) status = take_binary_vertex(r);
    for (uint64_t i = 0; !status && i < r->faces; i++) status = take_binary_face(r);
    return status ? status : off_note_rest(r, r->bytes + r->at, r->n - r->at);
}

static enum status off_read_file(struct reader *r) {
    enum status status = off_take_header(r);
    if (!status && r->is_binary) return read_binary_off(r);
    if (!status) status = check_counts(r);
    if (!status) status = off_describe(r);
    if (!status) status = cloud_build_room(&r->build, r->vertices);
    for (uint64_t i = 0; !status && i < r->vertices; i++) status = off_take_vertex(r);
    for (uint64_t i = 0; !status && i < r->faces; i++) status = off_take_face(r);
    return status ? status : off_end_lines(r);
}

const char *cloud_off_look(const struct first_bytes *first) {
    static const char *const marks[] = {"ST", "st", "C", "c", "N", "4", "n"};
    struct scan_word word;
    struct scan rest;
    if (!first_word(first, &word, &rest)) return "";
    const char *at = word.text, *end = at + word.n;
    for (size_t i = 0; i < sizeof marks / sizeof *marks; i++) (void)pass(&at, end, marks[i]);
    return (pass(&at, end, "OFF") || pass(&at, end, "off")) && at == end ? "off" : "";
}

enum status cloud_off_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct reader r = {.scan = scan_start(bytes, n), .bytes = bytes, .n = n};
    r.scan.comment = '#';
    cloud_build_start(&r.build, "off", n, limits, progress, error);
    return cloud_build_end(&r.build, off_read_file(&r), cloud);
}
