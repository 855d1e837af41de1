/* XYZ text.
 *
 *     file    = [BOM] { blank | comment | names | count | point }
 *     comment = ("#" | "//" | "%" | ";") anything            anywhere
 *     names   = word { separator word }                      once, before the first point, no word of it a number
 *     units   = unit { separator unit }                      once, after the names; passed over
 *     count   = digits                                       once, before the first point; the points must be as many
 *     point   = number { separator number }                  all with as many columns as the first, at least 3
 *     number  = digits and so on, or the same in quotes
 *     separator = blanks with at most one "," or one ";".  One may stand at the end of a line.
 *
 * Where semicolons separate the first point's values, commas in the file are decimal ("1,5; 2,5; 3,5"), and points then
 * can't be: one of both might set off thousands, so a file with both is refused.  Where blanks separate them and single
 * commas stand inside of numbers ("1,5 2,5 3,5"), nobody can tell three columns from six: that is refused, too.
 *
 * Lines end by \n, \r\n or \r.  Columns are named by the names line, or by a comment whose words contain x, y and z
 * (CloudCompare's "//X Y Z R G B"), when it has as many names as there are columns; x, y and z may then stand anywhere.
 * Else the first three columns are x, y, z and the others column4, column5 ...; but a names line that has x, y and z
 * in other places is refused then, since columns would be taken for others.  Names are separated by commas,
 * where there are any, else by semicolons, tabs, or blanks; quotes around them are dropped, blanks, commas and
 * semicolons in them become "_".  A unit in brackets after x, y or z ("X [m]") is dropped.
 *
 * There is no header that could promise anything, so arrays grow by half as points come in.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud_xyz.h"

#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/alloc.h"
#include "core/number.h"
#include "core/padding.h"

enum { TICK_POINTS = 16384, FIRST_CAPACITY = 1024, WORD_BYTES = 512 };

struct reader {
    const char *begin, *at, *end;
    uint64_t line;     /* which one at is on */
    const char *names; /* line that may name the columns; NULL = none */
    bool names_are_comment;
    bool decimal_commas;
    bool seen_comma, seen_point; /* in numbers, where commas may be decimal */
    bool has_count;
    uint64_t count; /* promised, if has_count */
    uint64_t max_points;
    size_t max_columns;
    size_t capacity;
    const struct progress *progress;
    struct cloud *cloud;
    struct error *error;
};

/* ------------------------------------------------------------------------------------------------ lines, words */

static bool is_newline(char c) { return c == '\n' || c == '\r'; }
static bool is_blank(char c) { return c == ' ' || c == '\t'; }
static bool is_mark(char c) { return c == ',' || c == ';'; }
static bool is_digit(char c) { return c >= '0' && c <= '9'; }

static bool is_separator(const struct reader *r, char c) {
    return is_blank(c) || c == ';' || (c == ',' && !r->decimal_commas);
}

static void skip_blanks(struct reader *r) {
    while (r->at < r->end && is_blank(*r->at)) r->at++;
}

static void skip_line(struct reader *r) {
    while (r->at < r->end && !is_newline(*r->at)) r->at++;
    if (r->at == r->end) return;
    if (*r->at == '\r' && r->at + 1 < r->end && r->at[1] == '\n') r->at++;
    r->at++;
    r->line++;
}

static bool at_comment(const struct reader *r) {
    char c = *r->at;
    return c == '#' || c == '%' || c == ';' || (c == '/' && r->at + 1 < r->end && r->at[1] == '/');
}

/* The next word at *at of a line, its end in *stop; false at the line's end. */
static bool next_word(const struct reader *r, const char **at, const char **stop) {
    while (*at < r->end && is_separator(r, **at)) ++*at;
    for (*stop = *at; *stop < r->end && !is_separator(r, **stop) && !is_newline(**stop);) ++*stop;
    return *stop > *at;
}

static size_t count_words(const struct reader *r, const char *at) {
    size_t n = 0;
    for (const char *stop; next_word(r, &at, &stop); at = stop) n++;
    return n;
}

static bool is_quote(char c) { return c == '"' || c == '\''; }

/* The same as number_parse_f64, of a copy that has points for commas. */
static const char *parse_decimal_comma(const char *at, const char *end, double *value) {
    char copy[WORD_BYTES];
    size_t n = 0;
    for (; at + n < end && n < sizeof copy && !is_blank(at[n]) && !is_newline(at[n]); n++)
        copy[n] = at[n] == ',' ? '.' : at[n];
    const char *after = number_parse_f64(copy, copy + n, value);
    return after ? at + (after - copy) : NULL;
}

static const char *parse_number(const struct reader *r, const char *at, const char *end, double *value) {
    const char *after = number_parse_f64(at, end, value);
    bool whole = !r->decimal_commas || (after && (after == end || *after != ','));
    return whole ? after : parse_decimal_comma(at, end, value);
}

/* Reads a number, which may stand in quotes; returns what follows it, NULL: there is none. */
static const char *parse_value(const struct reader *r, const char *at, const char *end, double *value) {
    char quote = at < end && is_quote(*at) ? *at++ : '\0';
    const char *after = parse_number(r, at, end, value);
    if (!quote || !after) return after;
    return after < end && *after == quote ? after + 1 : NULL;
}

static bool is_number(const struct reader *r, const char *at, const char *stop) {
    double value;
    return parse_value(r, at, stop, &value) == stop;
}

static bool has_semicolon(const char *at, const char *end) {
    while (at < end && !is_newline(*at) && *at != ';') at++;
    return at < end && *at == ';';
}

/* Blanks separate the words of a line, at least three, and inside of some is a comma, and nowhere else: the first such
 * word; NULL: it isn't so. */
static const char *comma_inside(const char *at, const char *end) {
    const char *found = NULL;
    size_t words = 0;
    for (; at < end && !is_newline(*at); words++) {
        const char *word = at, *comma = NULL;
        for (; at < end && !is_blank(*at) && !is_newline(*at); at++) {
            if (*at != ',') continue;
            if (comma || at == word || !is_digit(at[-1]) || at + 1 == end || !is_digit(at[1])) return NULL;
            comma = at;
        }
        if (comma && !found) found = word;
        while (at < end && is_blank(*at)) at++;
    }
    return words >= 3 ? found : NULL;
}

/* What separates the names of a line; 0 = blanks. */
static char mark_of(const char *at, const char *end) {
    static const char marks[] = ",;\t";
    for (const char *mark = marks; *mark; mark++)
        for (const char *c = at; c < end && !is_newline(*c); c++)
            if (*c == *mark) return *mark;
    return 0;
}

static bool is_bracketed(const char *from, const char *stop) {
    return stop - from >= 2 && ((*from == '[' && stop[-1] == ']') || (*from == '(' && stop[-1] == ')'));
}

/* The next name at *at of a line, which is moved past it; false at the line's end.  Among blanks, what stands in
 * brackets is the unit of the name before it. */
static bool next_name(const char **at, const char *end, char mark, const char **from, const char **stop) {
    if (!mark) {
        do {
            while (*at < end && is_blank(**at)) ++*at;
            for (*from = *at; *at < end && !is_blank(**at) && !is_newline(**at);) ++*at;
            *stop = *at;
            if (*stop == *from) return false;
        } while (is_bracketed(*from, *stop));
    } else {
        if (*at == end || is_newline(**at)) return false;
        for (*from = *at; *at < end && **at != mark && !is_newline(**at);) ++*at;
        *stop = *at;
        if (*at < end && **at == mark) ++*at;
    }
    while (*from < *stop && (is_blank(**from) || is_quote(**from))) ++*from;
    while (*from < *stop && (is_blank((*stop)[-1]) || is_quote((*stop)[-1]))) --*stop;
    return true;
}

static size_t count_names(const char *at, const char *end) {
    char mark = mark_of(at, end);
    size_t n = 0;
    for (const char *from, *stop; next_name(&at, end, mark, &from, &stop);) n++;
    return n;
}

/* ------------------------------------------------------------------------------------------------ before the points */

static bool no_word_is_a_number(const struct reader *r) {
    const char *at = r->at;
    for (const char *stop; next_word(r, &at, &stop); at = stop)
        if (is_number(r, at, stop)) return false;
    return true;
}

static bool is_unit(const char *at, const char *stop) {
    static const char *const units[] = {"m", "mm", "cm", "dm", "km", "um", "nm", "ft", "in", "deg", "rad", "-"};
    if (is_bracketed(at, stop)) return true;
    for (size_t i = 0; i < sizeof units / sizeof *units; i++)
        if ((size_t)(stop - at) == strlen(units[i]) && strncasecmp(at, units[i], (size_t)(stop - at)) == 0) return true;
    return false;
}

static bool all_words_are_units(const struct reader *r) {
    const char *at = r->at;
    for (const char *stop; next_word(r, &at, &stop); at = stop)
        if (!is_unit(at, stop)) return false;
    return count_words(r, r->at) > 0;
}

/* Takes a line with a single whole number as the count of points; false when it is something else. */
static bool take_count(struct reader *r) {
    if (r->has_count || count_words(r, r->at) != 1) return false;
    uint64_t n = 0;
    for (const char *c = r->at; c < r->end && !is_newline(*c) && !is_separator(r, *c); c++)
        if (*c < '0' || *c > '9' || __builtin_mul_overflow(n, 10u, &n) ||
            __builtin_add_overflow(n, (uint64_t)(*c - '0'), &n))
            return false;
    r->has_count = true;
    r->count = n;
    return true;
}

/* Which axis a name is of, with or without a unit ("Y", "y [m]", "Y(mm)"): 0, 1, 2; 3 = none. */
static unsigned axis_of(const char *from, const char *stop) {
    if (from == stop || (*from | 32) < 'x' || (*from | 32) > 'z') return 3;
    const char *unit = from + 1;
    while (unit < stop && (is_blank(*unit) || *unit == '_')) unit++;
    return stop - from == 1 || is_bracketed(unit, stop) ? (unsigned)((*from | 32) - 'x') : 3;
}

/* Whether a line's names have x, y and z among them. */
static bool names_xyz(const char *at, const char *end) {
    char mark = mark_of(at, end);
    unsigned found = 0;
    for (const char *from, *stop; next_name(&at, end, mark, &from, &stop);) found |= 1u << axis_of(from, stop);
    return (found & 7) == 7;
}

static void take_comment(struct reader *r) {
    const char *at = r->at;
    while (at < r->end && (*at == '#' || *at == '%' || *at == ';' || *at == '/')) at++;
    if ((!r->names || r->names_are_comment) && names_xyz(at, r->end)) {
        r->names = at;
        r->names_are_comment = true;
    }
}

/* Skips what stands before the first point, taking names and the count from it; false at the end of the file. */
static bool find_first_point(struct reader *r) {
    if (r->end - r->at >= 3 && memcmp(r->at, "\xef\xbb\xbf", 3) == 0) r->at += 3;
    bool has_names = false, has_units = false;
    for (; skip_blanks(r), r->at < r->end; skip_line(r)) {
        if (is_newline(*r->at)) continue;
        if (at_comment(r)) {
            take_comment(r);
        } else if (!has_names && no_word_is_a_number(r)) {
            has_names = true;
            r->names = r->at;
            r->names_are_comment = false;
        } else if (has_names && !has_units && all_words_are_units(r)) {
            has_units = true;
        } else if (!take_count(r)) {
            return true;
        }
    }
    return false;
}

/* ------------------------------------------------------------------------------------------------ columns */

static bool is_fit_name(const char *at, const char *stop) {
    if (stop - at >= PROPERTY_NAME_BYTES) return false;
    if (stop - at >= 6 && memcmp(at, "column", 6) == 0) return false; /* those are ours, and so can't clash */
    for (; at < stop; at++)
        if ((*at < 33 || *at > 126) && !is_blank(*at)) return false;
    return true;
}

static bool is_taken(const struct cloud *cloud, size_t columns, const char *name) {
    for (size_t j = 0; j < columns; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return true;
    return false;
}

/* Gives column j the name at .. stop, or one of its own where that can't be. */
static void name_column(struct cloud *cloud, size_t j, const char *at, const char *stop) {
    char *name = cloud->property[j].name;
    if (stop > at && is_fit_name(at, stop)) {
        for (size_t k = 0; at + k < stop; k++) name[k] = is_blank(at[k]) || is_mark(at[k]) ? '_' : at[k];
        if (!is_taken(cloud, j, name)) return;
    }
    snprintf(name, PROPERTY_NAME_BYTES, "column%zu", j + 1);
}

static void name_columns(struct reader *r) {
    static const char xyz[] = "xyz";
    struct cloud *cloud = r->cloud;
    bool fits = r->names && count_names(r->names, r->end) == cloud->property_count;
    bool has_xyz = fits && names_xyz(r->names, r->end);
    const char *at = fits ? r->names : r->end, *from = at, *stop = at;
    char mark = mark_of(at, r->end);
    for (size_t j = 0; j < cloud->property_count; j++) {
        if (fits) (void)next_name(&at, r->end, mark, &from, &stop);
        size_t axis_here = !has_xyz && j < 3 ? j : axis_of(from, stop);
        if (axis_here < 3)
            name_column(cloud, j, xyz + axis_here, xyz + axis_here + 1);
        else
            name_column(cloud, j, from, stop);
        for (unsigned axis = 0; axis < 3; axis++)
            if (strcmp(cloud->property[j].name, (const char[2]){xyz[axis]}) == 0) cloud->xyz[axis] = (uint32_t)j;
    }
}

static bool begins_with_xyz(const char *at, const char *end) {
    char mark = mark_of(at, end);
    const char *from, *stop;
    for (unsigned axis = 0; axis < 3; axis++)
        if (!next_name(&at, end, mark, &from, &stop) || axis_of(from, stop) != axis) return false;
    return true;
}

/* Names that aren't as many as the columns, and say that x, y, z aren't the first three. */
static enum status check_names(struct reader *r) {
    if (!r->names || r->names_are_comment || !names_xyz(r->names, r->end)) return STATUS_OK;
    size_t names = count_names(r->names, r->end), columns = r->cloud->property_count;
    if (names == columns || begins_with_xyz(r->names, r->end)) return STATUS_OK;
    return error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                        "the point has %zu values, but the line of names has %zu", columns, names);
}

static enum status no_memory(struct reader *r) {
    return error_set_at(r->error, STATUS_NO_MEMORY, "read", r->line, UINT64_MAX, "no memory for more than %zu points",
                        r->cloud->count);
}

/* Sets up the columns from the first point's line, where at is. */
static enum status describe(struct reader *r) {
    struct cloud *cloud = r->cloud;
    r->decimal_commas = has_semicolon(r->at, r->end);
    size_t columns = count_words(r, r->at);
    if (columns > r->max_columns)
        return error_set_at(r->error, STATUS_LIMIT, "properties", r->line, UINT64_MAX,
                            "%zu columns, at most %zu are allowed", columns, r->max_columns);
    cloud->format = CLOUD_XYZ;
    cloud->property = alloc_zeroed(columns ? columns : 1, sizeof *cloud->property);
    if (!cloud->property) return no_memory(r);
    cloud->property_count = columns;
    cloud->record_bytes = columns * sizeof(double);
    for (size_t j = 0; j < columns; j++) {
        cloud->property[j].type = SCALAR_FLOAT64;
        cloud->property[j].offset_bytes = j * sizeof(double);
    }
    name_columns(r);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ points */

static enum status resize(struct reader *r, size_t capacity) {
    struct cloud *cloud = r->cloud;
    vec3 *position = alloc_resize(cloud->position, capacity, sizeof *position);
    if (!position) return no_memory(r);
    cloud->position = position;
    unsigned char *record = alloc_resize(cloud->record, capacity, cloud->record_bytes);
    if (!record) return no_memory(r);
    cloud->record = record;
    r->capacity = capacity;
    return STATUS_OK;
}

static enum status bad(struct reader *r, size_t column, const char *what) {
    char quote[NUMBER_QUOTE_BYTES];
    const char *name = column < r->cloud->property_count ? r->cloud->property[column].name : "columns";
    return error_set_at(r->error, STATUS_MALFORMED, name, r->line, UINT64_MAX, "value %zu of the line is '%s': %s",
                        column + 1, number_quote(r->at, r->end, quote), what);
}

static enum status bad_width(struct reader *r, size_t columns) {
    const char *which = columns < r->cloud->property_count ? "fewer" : "more";
    return error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                        "the line has %s values than the first point, which has %zu", which, r->cloud->property_count);
}

/* Skips a separator; *mark is the comma or semicolon that this line has used, 0 = none yet. */
static enum status take_separator(struct reader *r, char *mark, size_t column) {
    skip_blanks(r);
    if (r->at == r->end || (*r->at != ',' && *r->at != ';')) return STATUS_OK;
    if (*mark && *mark != *r->at) return bad(r, column, "both commas and semicolons between values");
    *mark = *r->at++;
    skip_blanks(r);
    return STATUS_OK;
}

static enum status one_or_two(struct reader *r, const char *word) {
    char quote[NUMBER_QUOTE_BYTES];
    return error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                        "'%s' may be one value or two: if its comma is decimal, write a point for it (tr , .) or put "
                        "semicolons between the values; if not, put commas between all",
                        number_quote(word, r->end, quote));
}

static bool at_line_end(const struct reader *r) { return r->at == r->end || is_newline(*r->at); }

/* Whether the file has had both decimal commas and decimal points, now that this number was read. */
static bool mixes_decimals(struct reader *r, const char *at, const char *after) {
    size_t n = (size_t)(after - at);
    r->seen_comma = r->seen_comma || memchr(at, ',', n);
    r->seen_point = r->seen_point || memchr(at, '.', n);
    return r->seen_comma && r->seen_point;
}

/* Reads the values of one line into record. */
static enum status take_values(struct reader *r, double *record) {
    size_t j = 0, columns = r->cloud->property_count;
    char mark = 0;
    for (; !at_line_end(r); j++) {
        if (j == columns) return bad_width(r, j + 1);
        const char *after = parse_value(r, r->at, r->end, &record[j]);
        if (!after || (after < r->end && !is_separator(r, *after) && !is_newline(*after)))
            return bad(r, j, "not a number");
        if (r->decimal_commas && mixes_decimals(r, r->at, after))
            return bad(r, j,
                       "the file has commas and points in numbers, one of which may set off thousands; write "
                       "points for decimals and nothing for thousands");
        r->at = after;
        enum status status = take_separator(r, &mark, j + 1);
        if (status) return status;
    }
    return j == columns ? STATUS_OK : bad_width(r, j);
}

static enum status not_finite(struct reader *r, int axis, double value) {
    const char *name = r->cloud->property[r->cloud->xyz[axis]].name;
    return error_set_at(r->error, STATUS_MALFORMED, name, r->line, UINT64_MAX, "vertex %zu: coordinate %s is %s",
                        r->cloud->count, name, isnan(value) ? "not a number (nan)" : "infinite");
}

static enum status take_point(struct reader *r) {
    struct cloud *cloud = r->cloud;
    double record[CLOUD_MAX_PROPERTIES];
    const char *line = r->at;
    enum status status = take_values(r, record);
    const char *unclear = status || cloud->count == 0 ? comma_inside(line, r->end) : NULL;
    if (unclear && !r->decimal_commas) return one_or_two(r, unclear);
    if (status) return status;
    for (int axis = 0; axis < 3; axis++)
        if (!isfinite(record[cloud->xyz[axis]])) return not_finite(r, axis, record[cloud->xyz[axis]]);
    if (cloud->count == r->max_points)
        return error_set_at(r->error, STATUS_LIMIT, "points", r->line, UINT64_MAX,
                            "more than the %" PRIu64 " points that are allowed", r->max_points);
    if (cloud->count == r->capacity) status = resize(r, r->capacity + r->capacity / 2 + FIRST_CAPACITY);
    if (status) return status;
    cloud->position[cloud->count] = (vec3){record[cloud->xyz[0]], record[cloud->xyz[1]], record[cloud->xyz[2]]};
    memcpy(cloud->record + cloud->count * cloud->record_bytes, record, cloud->record_bytes);
    cloud->count++;
    return STATUS_OK;
}

static enum status take_points(struct reader *r) {
    for (; skip_blanks(r), r->at < r->end; skip_line(r)) {
        if (is_newline(*r->at) || at_comment(r)) continue;
        if (r->cloud->count % TICK_POINTS == 0 &&
            progress_tick(r->progress, "read", (double)(r->at - r->begin) / (double)(r->end - r->begin)))
            return error_set(r->error, STATUS_CANCELLED, "read", "cancelled");
        enum status status = take_point(r);
        if (status) return status;
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status check_count(struct reader *r) {
    if (!r->has_count || r->count == r->cloud->count) return STATUS_OK;
    return error_set_at(r->error, STATUS_MALFORMED, "count", 1, UINT64_MAX,
                        "the file begins with a count of %" PRIu64 " points, %zu are there", r->count, r->cloud->count);
}

static enum status read_file(struct reader *r) {
    if (!find_first_point(r)) return error_set_at(r->error, STATUS_MALFORMED, "read", r->line, UINT64_MAX, "no points");
    enum status status = describe(r);
    if (!status && r->cloud->property_count < 3)
        status = error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                              "the line has %zu values, a point has at least 3", r->cloud->property_count);
    if (!status) status = check_names(r);
    if (!status) status = take_points(r);
    if (!status) status = check_count(r);
    return status ? status : resize(r, r->cloud->count);
}

static struct reader start(const void *bytes, size_t n, const struct cloud_limits *limits) {
    uint64_t points = limits && limits->max_points ? limits->max_points : NONE - 1;
    size_t columns = limits && limits->max_properties ? limits->max_properties : CLOUD_MAX_PROPERTIES;
    const char *text = bytes;
    return (struct reader){.begin = text,
                           .at = text,
                           .end = text + padding_text_bytes(text, n),
                           .line = 1,
                           .max_points = points < NONE - 1 ? points : NONE - 1,
                           .max_columns = columns < CLOUD_MAX_PROPERTIES ? columns : CLOUD_MAX_PROPERTIES};
}

enum status cloud_xyz_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct cloud read = {0};
    struct reader r = start(bytes, n, limits);
    r.progress = progress;
    r.cloud = &read;
    r.error = error;
    enum status status = read_file(&r);
    if (!status) {
        *cloud = read;
        read = (struct cloud){0};
    }
    cloud_done(&read);
    return status;
}
