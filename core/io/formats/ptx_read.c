/* PTX, the text of terrestrial scanners (Leica).
 *
 *     file   = {scan}
 *     scan   = columns  rows              a line each: the grid that was scanned
 *              x y z                      the scanner's place
 *              3 lines of 3               its axes
 *              4 lines of 4               from its own coordinates to the file's: (x y z 1) times this matrix
 *              columns * rows lines       x y z intensity [red green blue]
 *
 * Points with x, y and z 0 are directions without a return, and are none.  The others come out in the file's
 * coordinates in double; intensity is float32, colours are uint8.  Colours of some scans alone are left out, and noted.
 *
 * A scan's viewpoint is where the matrix puts the scanner's own origin.  Software that has points in other coordinates
 * writes an identity and an origin that may be anywhere: a viewpoint farther from its points than those are from each
 * other isn't believed.
 *
 * Two passes: one finds the scans and what all of them have, the other reads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/viewpoints.h"
#include "core/io/reader.h"

#include <inttypes.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/build.h"
#include "core/io/first_bytes.h"
#include "core/io/parts.h"
#include "core/io/text_scanner.h"

enum { HEADER_LINES = 10, POSITION_WORDS = 3, WITH_INTENSITY = 4, WITH_COLOURS = 7, LEAST_LINE_BYTES = 4 };

/* How many numbers are on each line of a header. */
static const unsigned header_words[HEADER_LINES] = {1, 1, 3, 3, 3, 3, 4, 4, 4, 4};

struct header {
    uint64_t points;
    double matrix[4][4];
    size_t words; /* on the line of the first point */
};

struct reader {
    struct cloud_build build;
    struct scan scan;
    struct viewpoints views;
    size_t scans;
    bool intensity, colours; /* of all scans */
    bool numbered;           /* points say of which scan they are */
};

static struct cloud_place ptx_here(const struct reader *r) {
    return (struct cloud_place){r->scan.line, (uint64_t)(r->scan.at - r->scan.begin)};
}

static enum status ptx_bad_word(struct reader *r, const struct scan_word *word, const char *what) {
    char quote[NUMBER_QUOTE_BYTES];
    if (!word->n) return cloud_build_bad(&r->build, "read", ptx_here(r), "the line ends where %s should be", what);
    return cloud_build_bad(&r->build, "read", ptx_here(r), "'%s' is not %s", scan_quote(word, quote), what);
}

/* To the next line that isn't empty; false: there is none. */
static bool skip_empty_lines(struct scan *scan) {
    struct scan_word word;
    for (;;) {
        struct scan ahead = *scan;
        if (scan_word(&ahead, &word)) return true;
        if (scan->at >= scan->end) return false;
        scan_next_line(scan);
    }
}

/* ------------------------------------------------------------------------------------------------ headers */

static enum status ptx_take_count(struct reader *r, uint64_t *count) {
    struct scan_word word = {0};
    bool there = skip_empty_lines(&r->scan) && scan_word(&r->scan, &word);
    if (!there || !scan_u64(&word, count) || *count > UINT32_MAX)
        return ptx_bad_word(r, &word, "how many columns or rows the grid of a scan has");
    if (scan_word(&r->scan, &word)) return ptx_bad_word(r, &word, "the end of that line");
    scan_next_line(&r->scan);
    return STATUS_OK;
}

static enum status ptx_take_numbers(struct reader *r, double *number, unsigned n) {
    for (unsigned i = 0; i < n; i++) {
        struct scan_word word = {0};
        if (!scan_word(&r->scan, &word) || !scan_f64(&word, &number[i]) || !isfinite(number[i]))
            return ptx_bad_word(r, &word, "a number of the scan's place");
    }
    scan_next_line(&r->scan);
    return STATUS_OK;
}

static enum status ptx_take_header(struct reader *r, struct header *header) {
    uint64_t columns = 0, rows = 0;
    double number[4];
    enum status status = ptx_take_count(r, &columns);
    if (!status) status = ptx_take_count(r, &rows);
    for (int line = 2; !status && line < HEADER_LINES; line++) {
        status = ptx_take_numbers(r, number, header_words[line]);
        if (line >= HEADER_LINES - 4) memcpy(header->matrix[line - (HEADER_LINES - 4)], number, sizeof number);
    }
    uint64_t left = (uint64_t)(r->scan.end - r->scan.at);
    header->points = columns * rows;
    if (!status && header->points > left / LEAST_LINE_BYTES)
        status = cloud_build_bad(&r->build, "read", ptx_here(r),
                                 "a grid of %" PRIu64 " x %" PRIu64 " is promised, which %" PRIu64 " bytes can't hold",
                                 columns, rows, left);
    header->words = status ? 0 : scan_count_words(r->scan);
    return status;
}

/* ------------------------------------------------------------------------------------------------ what there is */

static enum status skip_points(struct reader *r, uint64_t points) {
    for (uint64_t i = 0; i < points; i++) {
        if (r->scan.at >= r->scan.end)
            return cloud_build_bad(&r->build, "read", ptx_here(r),
                                   "the file ends after %" PRIu64 " of %" PRIu64 " points of scan %zu", i, points,
                                   r->scans);
        scan_next_line(&r->scan);
    }
    return STATUS_OK;
}

static enum status find_scans(struct reader *r) {
    enum status status = STATUS_OK;
    bool some_colours = false;
    r->intensity = r->colours = true;
    while (!status && skip_empty_lines(&r->scan)) {
        struct header header;
        r->scans++;
        status = ptx_take_header(r, &header);
        if (!status && header.points) {
            r->intensity &= header.words >= WITH_INTENSITY;
            r->colours &= header.words >= WITH_COLOURS;
            some_colours |= header.words >= WITH_COLOURS;
        }
        if (!status) status = skip_points(r, header.points);
    }
    if (!status && r->scans == 0)
        status = cloud_build_bad(&r->build, "read", ptx_here(r), "there is no scan in this file");
    if (!status && r->scans > UINT16_MAX)
        status =
            error_set(r->build.error, STATUS_LIMIT, "read", "%zu scans, at most %d are read", r->scans, UINT16_MAX);
    if (!status && some_colours && !r->colours)
        status = cloud_build_leave_out(&r->build, "colours: only some of the scans have any");
    return status;
}

static enum status ptx_describe(struct reader *r) {
    static const struct {
        const char *name;
        enum scalar_type type;
    } rows[] = {{"x", SCALAR_FLOAT64}, {"y", SCALAR_FLOAT64},   {"z", SCALAR_FLOAT64},  {"intensity", SCALAR_FLOAT32},
                {"red", SCALAR_UINT8}, {"green", SCALAR_UINT8}, {"blue", SCALAR_UINT8}, {CLOUD_SCAN, SCALAR_UINT16}};
    bool wanted[] = {true, true, true, r->intensity, r->colours, r->colours, r->colours, r->numbered};
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < sizeof rows / sizeof *rows; i++)
        if (wanted[i]) status = cloud_build_property(&r->build, rows[i].name, rows[i].type);
    return status;
}

/* ------------------------------------------------------------------------------------------------ points */

struct point {
    double position[3];
    float intensity;
    uint8_t colour[3];
};

static enum status ptx_take_point(struct reader *r, size_t words, struct point *point) {
    struct scan_word word = {0};
    for (size_t i = 0; i < words; i++) {
        double value;
        word = (struct scan_word){0};
        if (!scan_word(&r->scan, &word)) return ptx_bad_word(r, &word, "a number");
        if (i == POSITION_WORDS) {
            if (!scan_f32(&word, &point->intensity)) return ptx_bad_word(r, &word, "an intensity");
            continue;
        }
        if (!scan_f64(&word, &value)) return ptx_bad_word(r, &word, "a number");
        if (i < POSITION_WORDS) {
            point->position[i] = value;
        } else {
            if (!(value >= 0 && value <= UINT8_MAX)) return ptx_bad_word(r, &word, "a colour from 0 to 255");
            point->colour[i - WITH_INTENSITY] = (uint8_t)value;
        }
    }
    if (scan_word(&r->scan, &word)) return ptx_bad_word(r, &word, "the end of the line, as that of the first point is");
    scan_next_line(&r->scan);
    return STATUS_OK;
}

static vec3 transform(const struct header *header, const double p[3]) {
    double q[3];
    for (int k = 0; k < 3; k++)
        q[k] = p[0] * header->matrix[0][k] + p[1] * header->matrix[1][k] + p[2] * header->matrix[2][k] +
               header->matrix[3][k];
    return (vec3){q[0], q[1], q[2]};
}

static enum status ptx_put_point(struct reader *r, const struct header *header, const struct point *point,
                                 uint16_t number, struct cloud_place place) {
    unsigned char record[48];
    size_t used = sizeof(vec3);
    vec3 position = transform(header, point->position);
    memcpy(record, &position, sizeof position);
    if (r->intensity) {
        memcpy(record + used, &point->intensity, sizeof point->intensity);
        used += sizeof point->intensity;
    }
    if (r->colours) {
        memcpy(record + used, point->colour, sizeof point->colour);
        used += sizeof point->colour;
    }
    if (r->numbered) memcpy(record + used, &number, sizeof number);
    viewpoints_see(&r->views, position);
    return cloud_build_point(&r->build, record, place);
}

static enum status ptx_begin_scan(struct reader *r, struct header *header) {
    (void)skip_empty_lines(&r->scan);
    enum status status = ptx_take_header(r, header);
    bool known = header->words == POSITION_WORDS || header->words == WITH_INTENSITY || header->words == WITH_COLOURS;
    if (!status && header->points && !known)
        status = cloud_build_bad(&r->build, "read", ptx_here(r), "%zu numbers on a line; a point has 3, 4 or 7",
                                 header->words);
    if (!status) viewpoints_begin(&r->views, transform(header, (const double[3]){0, 0, 0}));
    return status;
}

/* The next directions of a scan, with a return or without. */
static enum status ptx_take_points(struct reader *r, const struct header *header, uint16_t number, uint64_t count) {
    enum status status = STATUS_OK;
    for (uint64_t i = 0; !status && i < count; i++) {
        struct point point = {0};
        struct cloud_place place = ptx_here(r);
        status = ptx_take_point(r, header->words, &point);
        bool returned = point.position[0] != 0 || point.position[1] != 0 || point.position[2] != 0;
        if (!status && returned) status = ptx_put_point(r, header, &point, number, place);
    }
    return status;
}

static enum status ptx_take_scan(struct reader *r, uint16_t number) {
    struct header header = {0};
    enum status status = ptx_begin_scan(r, &header);
    if (!status) status = ptx_take_points(r, &header, number, header.points);
    if (!status) viewpoints_end(&r->views);
    return status;
}

/* The first pass, and back to the beginning. */
static enum status ptx_begin_file(struct reader *r, const struct cloud_limits *limits) {
    struct scan start = r->scan;
    enum status status = find_scans(r);
    r->scan = start;
    r->numbered = r->scans > 1 || (limits && limits->numbers_scans);
    if (!status) status = ptx_describe(r);
    if (!status && viewpoints_init(&r->views, r->scans))
        status = error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for %zu scans", r->scans);
    return status;
}

static enum status ptx_read_file(struct reader *r, const struct cloud_limits *limits) {
    enum status status = ptx_begin_file(r, limits);
    for (size_t i = 0; !status && i < r->scans; i++) status = ptx_take_scan(r, (uint16_t)i);
    if (!status) viewpoints_give(&r->views, &r->build.cloud);
    viewpoints_done(&r->views);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the format */

/* The first ten lines have as many numbers as they should, the first two whole ones. */
const char *cloud_ptx_look(const struct first_bytes *first) {
    struct scan scan = scan_start(first->text, first->n);
    struct scan_word word;
    uint64_t whole;
    double number;
    if (!first->is_text) return "";
    for (int line = 0; line < HEADER_LINES; line++) {
        if (scan_count_words(scan) != header_words[line]) return "";
        while (scan_word(&scan, &word))
            if (!scan_f64(&word, &number) || (line < 2 && !scan_u64(&word, &whole))) return "";
        scan_next_line(&scan);
    }
    return "ptx";
}

enum status cloud_ptx_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct reader r = {.scan = scan_start(bytes, n)};
    cloud_build_start(&r.build, "ptx", n, limits, progress, error);
    return cloud_build_end(&r.build, ptx_read_file(&r, limits), cloud);
}

/* ------------------------------------------------------------------------------------------------ part by part */

struct ptx_parts {
    struct cloud_parts parts;
    struct reader reader;
    struct header header;
    size_t begun;  /* scans */
    uint64_t left; /* lines of the one that was begun last */
};

static enum status ptx_next_part(struct cloud_parts *parts, struct error *error) {
    struct ptx_parts *p = (struct ptx_parts *)parts;
    struct reader *r = &p->reader;
    enum status status = STATUS_OK;
    r->build.error = error;
    r->build.cloud.count = 0;
    while (!status && r->build.cloud.count < CLOUD_PART_USUAL && (p->left || p->begun < r->scans)) {
        if (p->left == 0) {
            status = ptx_begin_scan(r, &p->header);
            p->left = status ? 0 : p->header.points;
            p->begun++;
        }
        uint64_t room = CLOUD_PART_USUAL - r->build.cloud.count, n = p->left < room ? p->left : room;
        if (!status) status = ptx_take_points(r, &p->header, (uint16_t)(p->begun - 1), n);
        p->left -= n;
        if (!status && p->left == 0) viewpoints_end(&r->views);
    }
    if (!status && p->left == 0 && p->begun == r->scans) viewpoints_give(&r->views, &r->build.cloud);
    parts->done_bytes = (size_t)(r->scan.at - r->scan.begin);
    return status;
}

static void ptx_free_parts(struct cloud_parts *parts) {
    struct ptx_parts *p = (struct ptx_parts *)parts;
    cloud_done(&p->reader.build.cloud);
    viewpoints_done(&p->reader.views);
    free(p);
}

enum status cloud_ptx_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) {
    struct ptx_parts *p = alloc_zeroed(1, sizeof *p);
    if (!p) return error_set(error, STATUS_NO_MEMORY, "read", "no memory to read with");
    struct reader *r = &p->reader;
    *r = (struct reader){.scan = scan_start(bytes, n)};
    cloud_build_start(&r->build, "ptx", n, NULL, NULL, error);
    enum status status = ptx_begin_file(r, limits);
    p->parts = (struct cloud_parts){&r->build.cloud, 0, 0, ptx_next_part, ptx_free_parts, false, 0};
    if (status)
        ptx_free_parts(&p->parts);
    else
        *out = &p->parts;
    return status;
}
