/* The header of a PCD file: lines of a keyword and its values, up to DATA.
 *
 *     FIELDS x y z rgb     SIZE 4 4 4 4     TYPE F F F U     COUNT 1 1 1 1     WIDTH 640     HEIGHT 480
 *     VIEWPOINT 0 0 0 1 0 0 0     POINTS 307200     DATA ascii | binary | binary_compressed
 *
 * FIELDS (COLUMNS in old files) comes before SIZE, TYPE and COUNT; COUNT, HEIGHT, VIEWPOINT and POINTS may be left out.
 * "#" begins a comment. Each keyword is a row of a table.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/pcd_header.h"

#include <inttypes.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "core/io/text_scanner.h"

enum { HEADER_MAX_BYTES = 64 * 1024, MAX_COUNT = 4096 };

struct reader {
    struct scan scan;
    struct pcd_header *header;
    struct error *error;
    unsigned seen; /* a bit for each keyword */
    uint64_t width, height;
    bool ended;
};

static enum status pcd_header_bad(struct reader *r, const char *where, const char *what, const struct scan_word *word) {
    char quote[NUMBER_QUOTE_BYTES] = "";
    if (word && word->n) scan_quote(word, quote);
    return error_set_at(r->error, STATUS_MALFORMED, where, r->scan.line, UINT64_MAX, quote[0] ? "%s: '%s'" : "%s", what,
                        quote);
}

static enum status take_version(struct reader *r) {
    (void)r;
    return STATUS_OK;
}

static enum status take_fields(struct reader *r) {
    struct pcd_header *h = r->header;
    struct scan_word word;
    for (h->field_count = 0; scan_word(&r->scan, &word); h->field_count++) {
        if (h->field_count == CLOUD_MAX_PROPERTIES)
            return error_set_at(r->error, STATUS_LIMIT, "properties", r->scan.line, UINT64_MAX, "more than %d fields",
                                CLOUD_MAX_PROPERTIES);
        if (word.n >= PROPERTY_NAME_BYTES) return pcd_header_bad(r, "FIELDS", "the name of a field is too long", &word);
        struct pcd_field *field = &h->field[h->field_count];
        *field = (struct pcd_field){.bytes = 4, .kind = 'F', .count = 1};
        memcpy(field->name, word.text, word.n);
    }
    return h->field_count ? STATUS_OK : pcd_header_bad(r, "FIELDS", "there are no fields", NULL);
}

/* Calls take for each field with its word of this line. */
static enum status each_field(struct reader *r, const char *keyword,
                              bool (*take)(struct pcd_field *field, const struct scan_word *word)) {
    struct scan_word word;
    for (size_t i = 0; i < r->header->field_count; i++) {
        if (!scan_word(&r->scan, &word)) return pcd_header_bad(r, keyword, "fewer values than there are fields", NULL);
        if (!take(&r->header->field[i], &word)) return pcd_header_bad(r, keyword, "this isn't allowed here", &word);
    }
    return scan_word(&r->scan, &word) ? pcd_header_bad(r, keyword, "more values than there are fields", &word)
                                      : STATUS_OK;
}

static bool set_size(struct pcd_field *field, const struct scan_word *word) {
    uint64_t bytes;
    if (!scan_u64(word, &bytes) || (bytes != 1 && bytes != 2 && bytes != 4 && bytes != 8)) return false;
    field->bytes = (unsigned)bytes;
    return true;
}

static bool set_type(struct pcd_field *field, const struct scan_word *word) {
    if (word->n != 1 || !strchr("IUF", word->text[0]) || !word->text[0]) return false;
    field->kind = word->text[0];
    return true;
}

static bool set_count(struct pcd_field *field, const struct scan_word *word) {
    uint64_t count;
    if (!scan_u64(word, &count) || count == 0 || count > MAX_COUNT) return false;
    field->count = (uint32_t)count;
    return true;
}

static enum status take_size(struct reader *r) { return each_field(r, "SIZE", set_size); }
static enum status take_type(struct reader *r) { return each_field(r, "TYPE", set_type); }
static enum status pcd_take_count(struct reader *r) { return each_field(r, "COUNT", set_count); }

static enum status take_number(struct reader *r, const char *keyword, uint64_t *value) {
    struct scan_word word;
    if (!scan_word(&r->scan, &word) || !scan_u64(&word, value)) return pcd_header_bad(r, keyword, "not a count", &word);
    return STATUS_OK;
}

static enum status take_width(struct reader *r) { return take_number(r, "WIDTH", &r->width); }
static enum status take_height(struct reader *r) { return take_number(r, "HEIGHT", &r->height); }
static enum status pcd_take_points(struct reader *r) { return take_number(r, "POINTS", &r->header->points); }

static enum status take_viewpoint(struct reader *r) {
    struct scan_word word;
    for (int i = 0; i < 7; i++)
        if (!scan_word(&r->scan, &word) || !scan_f64(&word, &r->header->viewpoint[i]))
            return pcd_header_bad(r, "VIEWPOINT", "not a number", &word);
    return STATUS_OK;
}

static enum status take_data(struct reader *r) {
    static const char *const names[] = {"ascii", "binary", "binary_compressed"};
    struct scan_word word;
    (void)scan_word(&r->scan, &word);
    for (int i = 0; i < 3; i++) {
        if (!scan_is(&word, names[i])) continue;
        r->header->data = (enum pcd_data)i;
        r->ended = true;
        return STATUS_OK;
    }
    return pcd_header_bad(r, "DATA", "this is none of ascii, binary, binary_compressed", &word);
}

enum { VERSION, FIELDS, SIZE, TYPE, COUNT, WIDTH, HEIGHT, VIEWPOINT, POINTS, DATA };

static const struct {
    const char *word;
    enum status (*take)(struct reader *r);
} keywords[] = {
    [VERSION] = {"VERSION", take_version},  [FIELDS] = {"FIELDS", take_fields},
    [SIZE] = {"SIZE", take_size},           [TYPE] = {"TYPE", take_type},
    [COUNT] = {"COUNT", pcd_take_count},    [WIDTH] = {"WIDTH", take_width},
    [HEIGHT] = {"HEIGHT", take_height},     [VIEWPOINT] = {"VIEWPOINT", take_viewpoint},
    [POINTS] = {"POINTS", pcd_take_points}, [DATA] = {"DATA", take_data},
};

/* Old files have COLUMNS for FIELDS. */
static bool is_keyword(const struct scan_word *word, size_t i) {
    return scan_is(word, keywords[i].word) || (i == FIELDS && scan_is(word, "COLUMNS"));
}

static enum status pcd_take_header_line(struct reader *r, const struct scan_word *word) {
    for (size_t i = 0; i < sizeof keywords / sizeof *keywords; i++) {
        if (!is_keyword(word, i)) continue;
        if (r->seen & 1u << i) return pcd_header_bad(r, "header", "this keyword is there twice", word);
        if (i != FIELDS && i != VERSION && !(r->seen & 1u << FIELDS) && i >= SIZE && i <= COUNT)
            return pcd_header_bad(r, "header", "FIELDS must come before this", word);
        r->seen |= 1u << i;
        return keywords[i].take(r);
    }
    return pcd_header_bad(r, "header", "this is no keyword of PCD", word);
}

static enum status finish(struct reader *r) {
    struct pcd_header *h = r->header;
    uint64_t cells;
    for (size_t i = FIELDS; i < DATA; i++)
        if (1u << i & (1u << FIELDS | 1u << SIZE | 1u << TYPE | 1u << WIDTH) & ~r->seen)
            return pcd_header_bad(r, keywords[i].word, "this line is missing", NULL);
    if (!(r->seen & 1u << HEIGHT)) r->height = 1;
    if (__builtin_mul_overflow(r->width, r->height, &cells))
        return pcd_header_bad(r, "WIDTH", "WIDTH x HEIGHT is too much", NULL);
    if (!(r->seen & 1u << POINTS)) h->points = cells;
    if (h->points != cells)
        return error_set_at(r->error, STATUS_MALFORMED, "POINTS", r->scan.line, UINT64_MAX,
                            "%" PRIu64 " points, but WIDTH x HEIGHT is %" PRIu64, h->points, cells);
    for (size_t i = 0; i < h->field_count; i++) {
        if (h->field[i].kind == 'F' && h->field[i].bytes < 4)
            return error_set_at(r->error, STATUS_MALFORMED, h->field[i].name, r->scan.line, UINT64_MAX,
                                "a float of %u bytes", h->field[i].bytes);
        h->record_bytes += (size_t)h->field[i].bytes * h->field[i].count;
    }
    return STATUS_OK;
}

bool pcd_header_origin(const char *line, size_t n, double origin[3]) {
    static const char mark[] = PCD_ORIGIN_MARK;
    struct scan scan = scan_start(line, n);
    struct scan_word word;
    double value[3];
    if (!scan_word(&scan, &word) || !scan_is(&word, "#") || !scan_word(&scan, &word) || !scan_is(&word, "origin"))
        return false;
    for (int axis = 0; axis < 3; axis++)
        if (!scan_word(&scan, &word) || !scan_f64(&word, &value[axis]) || !isfinite(value[axis])) return false;
    while (scan.at < scan.end && *scan.at == ' ') scan.at++;
    if ((size_t)(scan.end - scan.at) < sizeof mark - 1 || memcmp(scan.at, mark, sizeof mark - 1) != 0) return false;
    memcpy(origin, value, sizeof value);
    return true;
}

/* Looks for the comment that tells the origin in the header's bytes. */
static void pcd_parse_origin(const char *at, const char *end, double origin[3]) {
    while (at < end) {
        const char *stop = at;
        while (stop < end && *stop != '\n' && *stop != '\r') stop++;
        if (*at == '#' && pcd_header_origin(at, (size_t)(stop - at), origin)) return;
        at = stop + 1;
    }
}

enum status pcd_header_parse(const void *bytes, size_t n, struct pcd_header *header, struct error *error) {
    struct pcd_header h = {.viewpoint = {0, 0, 0, 1, 0, 0, 0}};
    struct reader r = {
        .scan = scan_start(bytes, n < HEADER_MAX_BYTES ? n : HEADER_MAX_BYTES), .header = &h, .error = error};
    struct scan_word word;
    enum status status = STATUS_OK;
    r.scan.comment = '#';
    while (!status && !r.ended) {
        if (!scan_token(&r.scan, &word)) return pcd_header_bad(&r, "header", "the file ends before a line DATA", NULL);
        status = pcd_take_header_line(&r, &word);
        if (!status && !r.ended) scan_next_line(&r.scan);
    }
    if (!status) status = finish(&r);
    if (status) return status;
    while (r.scan.at < r.scan.end && *r.scan.at != '\n' && *r.scan.at != '\r') r.scan.at++;
    if (r.scan.at == r.scan.end && h.points) return pcd_header_bad(&r, "DATA", "the file ends here", NULL);
    scan_next_line(&r.scan);
    h.bytes = (size_t)(r.scan.at - r.scan.begin);
    h.lines = r.scan.line - 1;
    pcd_parse_origin(bytes, (const char *)bytes + h.bytes, h.origin);
    *header = h;
    return STATUS_OK;
}

bool pcd_header_fits(const struct pcd_header *header, uint64_t total_bytes) {
    enum { LEAST_BYTES = 2 /* of a point in ascii: a digit and the line's end */ };
    uint64_t there = total_bytes > header->bytes ? total_bytes - header->bytes : 0, bytes;
    if (total_bytes == UINT64_MAX) return true;
    if (header->data == PCD_ASCII) return header->points <= there / LEAST_BYTES + 1;
    if (__builtin_mul_overflow(header->points, header->record_bytes, &bytes)) return false;
    return header->data == PCD_BINARY ? bytes <= there : bytes / PCD_LZF_MOST <= there;
}
