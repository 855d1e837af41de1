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
 * Tables have more than points: names of places, remarks.  Where each value of the first point is one number, a text or
 * nothing once it is split by semicolons or by commas (by tabs, where the names are as many), these alone separate from
 * there on, so that a text may have blanks, or none be there.  What isn't needed for a point's place, colour, normal or
 * for the caller's list is *free*: a free column is left out where the first point has no number in it, and what is no
 * number further down is nan there.  Both are told.
 *
 * Where semicolons separate the first point's values, commas in the file are decimal ("1,5; 2,5; 3,5"), and points then
 * can't be: one of both might set off thousands, so a file with both is refused.  Where blanks separate them and single
 * commas stand inside of numbers ("1,5 2,5 3,5"), nobody can tell three columns from six: that is refused, too.
 *
 * Lines end by \n, \r\n or \r.  Columns are named by the caller's list (core/text/column_list.h), else by the names
 * line, or by a comment that has x, y and z among its names (CloudCompare's "//X Y Z R G B"), when it has as many names
 * as there are columns.  x, y and z may then stand anywhere, and by other names that are known (column_names.c); a
 * names line without them is refused, since columns would be taken for others.  One that has other than as many names
 * is a title, and passed over, unless x, y and z are there or commas or semicolons are.
 *
 * Without names the first three columns are x, y, z and the others column4, column5 ...; after a count of points they
 * are those of PTS: intensity, red, green, blue; and so are three or four others without a count where the last three
 * are whole numbers from 0 to 255, of which one is larger than those of classes and returns are, which is told. Blanks,
 * commas and semicolons in names become "_".
 *
 * There is no header that could promise anything, so arrays grow by half as points come in.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"

#include <assert.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/base/alloc.h"
#include "core/base/left_out.h"
#include "core/io/build.h"
#include "core/io/finite.h"
#include "core/io/first_bytes.h"
#include "core/io/formats/column_names.h"
#include "core/io/padding.h"
#include "core/io/parts.h"
#include "core/text/column_list.h"
#include "core/text/number.h"

enum { PART_POINTS = 1 << 18, TICK_POINTS = 16384, FIRST_CAPACITY = 1024 };
enum { WORD_BYTES = 512, NAMES_BYTES = 120, NOTE_BYTES = 160 };
enum { COLOUR_LEAST = 32 /* classes and numbers of returns are below */ };
enum { NAMES_WITHIN_BYTES = 64 * 1024 /* of the file's beginning a comment may name the columns */ };

struct reader {
    const char *begin, *at, *end;
    uint64_t line;        /* which one at is on */
    const char *list;     /* core/text/column_list.h, of the caller; NULL = none */
    const char *names_at; /* line that may name the columns; NULL = none */
    bool names_are_comment;
    bool decimal_commas;
    bool seen_comma, seen_point; /* in numbers, where commas may be decimal */
    char mark;                   /* alone separates values; 0 = blanks do, too */
    bool has_count, is_pts;
    bool is_bare;   /* neither names nor a count tell what the columns are */
    uint64_t count; /* promised, if has_count */
    uint64_t max_points;
    size_t max_columns;
    size_t columns;                        /* of the file */
    uint32_t target[CLOUD_MAX_PROPERTIES]; /* of each column: which property it becomes; NONE = it is left out */
    bool is_free[CLOUD_MAX_PROPERTIES];    /* of each column */
    uint64_t words;                        /* in free columns that have numbers otherwise */
    char first_word[NOTE_BYTES];           /* of these: what it is, and where */
    struct column_names names;             /* on that line */
    size_t capacity;
    const struct progress *progress;
    struct cloud *cloud;
    struct error *error;
};

/* ------------------------------------------------------------------------------------------------ lines, words */

static bool is_mark(char c) { return c == ',' || c == ';'; }
static bool is_digit(char c) { return c >= '0' && c <= '9'; }

static bool is_separator(const struct reader *r, char c) {
    if (r->mark) return c == r->mark;
    return scan_is_blank(c) || c == ';' || (c == ',' && !r->decimal_commas);
}

static const char *after_blanks(const struct reader *r, const char *at) {
    while (at < r->end && scan_is_blank(*at) && *at != r->mark) at++;
    return at;
}

static void skip_blanks(struct reader *r) { r->at = after_blanks(r, r->at); }

static void skip_line(struct reader *r) {
    while (r->at < r->end && !scan_is_newline(*r->at)) r->at++;
    if (r->at == r->end) return;
    if (*r->at == '\r' && r->at + 1 < r->end && r->at[1] == '\n') r->at++;
    r->at++;
    r->line++;
}

static bool at_comment(const struct reader *r) {
    char c = *r->at;
    return c == '#' || c == '%' || c == ';' || (c == '/' && r->at + 1 < r->end && r->at[1] == '/');
}

/* Whether a value may end before `at`. */
static bool ends_value(const struct reader *r, const char *at) {
    at = r->mark ? after_blanks(r, at) : at;
    return at == r->end || is_separator(r, *at) || scan_is_newline(*at);
}

/* The end of the word at `at`, which may have separators in quotes, and quotes there as two. */
static const char *end_of_word(const struct reader *r, const char *at) {
    const char *stop = at;
    if (stop < r->end && scan_is_quote(*stop)) {
        for (stop++; stop < r->end && !scan_is_newline(*stop); stop++) {
            if (*stop != *at) continue;
            if (stop + 1 == r->end || stop[1] != *at) break;
            stop++;
        }
        if (stop < r->end && *stop == *at && ends_value(r, stop + 1)) return stop + 1;
        stop = at;
    }
    while (stop < r->end && !is_separator(r, *stop) && !scan_is_newline(*stop)) stop++;
    return stop;
}

/* The next word at *at of a line, its end in *stop; false at the line's end. */
static bool next_word(const struct reader *r, const char **at, const char **stop) {
    while (*at < r->end && is_separator(r, **at)) ++*at;
    *stop = end_of_word(r, *at);
    return *stop > *at;
}

static size_t count_words(const struct reader *r, const char *at) {
    size_t n = 0;
    for (const char *stop; next_word(r, &at, &stop); at = stop) n++;
    return n;
}

/* The same as number_parse_f64, of a copy that has points for commas. */
static const char *parse_decimal_comma(const char *at, const char *end, double *value) {
    char copy[WORD_BYTES];
    size_t n = 0;
    for (; at + n < end && n < sizeof copy && !scan_is_blank(at[n]) && !scan_is_newline(at[n]); n++)
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
    char quote = at < end && scan_is_quote(*at) ? *at++ : '\0';
    const char *after = parse_number(r, at, end, value);
    if (!quote || !after) return after;
    return after < end && *after == quote ? after + 1 : NULL;
}

/* Whether the word is one number; blanks around it don't count. */
static bool is_number(const struct reader *r, const char *at, const char *stop) {
    double value;
    const char *after = parse_value(r, after_blanks(r, at), stop, &value);
    return after && after_blanks(r, after) >= stop;
}

static bool line_has(const char *at, const char *end, char c) {
    while (at < end && !scan_is_newline(*at) && *at != c) at++;
    return at < end && *at == c;
}

/* Blanks separate the words of a line, at least three, and inside of some is a comma, and nowhere else: the first such
 * word; NULL: it isn't so. */
static const char *comma_inside(const char *at, const char *end) {
    const char *found = NULL;
    size_t words = 0;
    for (; at < end && !scan_is_newline(*at); words++) {
        const char *word = at, *comma = NULL;
        for (; at < end && !scan_is_blank(*at) && !scan_is_newline(*at); at++) {
            if (*at != ',') continue;
            if (comma || at == word || !is_digit(at[-1]) || at + 1 == end || !is_digit(at[1])) return NULL;
            comma = at;
        }
        if (comma && !found) found = word;
        while (at < end && scan_is_blank(*at)) at++;
    }
    return words >= 3 ? found : NULL;
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
    if (scan_is_bracketed(at, stop)) return true;
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
static bool xyz_take_count(struct reader *r) {
    if (r->has_count || count_words(r, r->at) != 1) return false;
    uint64_t n = 0;
    for (const char *c = r->at; c < r->end && !scan_is_newline(*c) && !is_separator(r, *c); c++)
        if (*c < '0' || *c > '9' || __builtin_mul_overflow(n, 10u, &n) ||
            __builtin_add_overflow(n, (uint64_t)(*c - '0'), &n))
            return false;
    r->has_count = true;
    r->count = n;
    return true;
}

/* Whether all columns that the caller's list refers to by name are there. */
static bool has_listed_names(const struct column_names *names, const char *list) {
    struct column_entry entry;
    bool pairs = false;
    while (column_list_next(&list, &entry)) {
        pairs = entry.column != NULL;
        if (pairs && column_names_find(names, entry.column, entry.column_bytes) == names->count) return false;
    }
    return pairs;
}

/* Takes a comment that names x, y and z, or what the caller's list refers to. */
static void take_comment(struct reader *r) {
    struct column_names names;
    const char *at = r->at;
    while (at < r->end && (*at == '#' || *at == '%' || *at == ';' || *at == '/')) at++;
    if ((r->names_at && !r->names_are_comment) || r->at - r->begin > NAMES_WITHIN_BYTES) return;
    column_names_split(at, r->end, &names);
    if (!names.has_xyz && !(r->list && has_listed_names(&names, r->list))) return;
    r->names_at = at;
    r->names_are_comment = true;
}

/* Skips what stands before the first point, taking names and the count from it; false at the end of the file. */
static bool find_first_point(struct reader *r) {
    if (r->end - r->at >= 3 && memcmp(r->at, "\xef\xbb\xbf", 3) == 0) r->at += 3;
    bool has_names = false, has_units = false;
    for (; skip_blanks(r), r->at < r->end; skip_line(r)) {
        if (scan_is_newline(*r->at)) continue;
        if (at_comment(r)) {
            take_comment(r);
        } else if (!has_names && no_word_is_a_number(r)) {
            has_names = true;
            r->names_at = r->at;
            r->names_are_comment = false;
        } else if (has_names && !has_units && all_words_are_units(r)) {
            has_units = true;
        } else if (!xyz_take_count(r)) {
            return true;
        }
    }
    return false;
}

/* ------------------------------------------------------------------------------------------------ values of a line */

/* Whether blanks separate several numbers, and nothing else is there. */
static bool are_numbers(const struct reader *r, const char *at, const char *stop) {
    size_t n = 0;
    for (double value; (at = after_blanks(r, at)) < stop; n++) {
        at = parse_number(r, at, stop, &value);
        if (!at || (at < stop && !scan_is_blank(*at))) return false;
    }
    return n > 1;
}

struct split {
    size_t values, numbers; /* of a line; what is behind the last mark counts only where it isn't empty */
    bool ends_in_mark;
};

/* Splits the line at `at` by r->mark.  False where that leaves several numbers in one value. */
static bool split_by_mark(const struct reader *r, const char *at, struct split *split) {
    *split = (struct split){0};
    for (;; at++) {
        at = after_blanks(r, at);
        const char *stop = end_of_word(r, at);
        split->ends_in_mark = stop == at && split->values && (stop == r->end || *stop != r->mark);
        if (split->ends_in_mark) return true;
        split->values++;
        split->numbers += is_number(r, at, stop);
        if (are_numbers(r, at, stop)) return false;
        at = after_blanks(r, stop);
        if (at == r->end || *at != r->mark) return true;
    }
}

/* How many columns the caller's list has by their order, or the line of names has; 0 = neither is known. */
static size_t columns_told(const struct reader *r) {
    struct column_entry entry;
    size_t n = 0;
    for (const char *at = r->list; at && column_list_next(&at, &entry); n++)
        if (entry.column) return r->names.count;
    return n ? n : r->names.count;
}

/* Finds out what separates the values of the first point, where at is, and how many there are. */
static size_t count_columns(struct reader *r) {
    static const char marks[] = ";,\t";
    size_t told = columns_told(r);
    for (const char *mark = marks; *mark; mark++) {
        struct split split;
        r->mark = *mark;
        r->decimal_commas = *mark == ';';
        if (!line_has(r->at, r->end, *mark) || !split_by_mark(r, r->at, &split) || split.numbers < 3) continue;
        size_t n = split.values + (split.ends_in_mark && told == split.values + 1);
        if (*mark != '\t' || (told == n && split.numbers < n)) return n; /* else tabs are blanks like others */
    }
    r->mark = 0;
    r->decimal_commas = line_has(r->at, r->end, ';');
    return count_words(r, r->at);
}

/* ------------------------------------------------------------------------------------------------ columns */

static enum status xyz_no_memory(struct reader *r) {
    return error_set_at(r->error, STATUS_NO_MEMORY, "read", r->line, UINT64_MAX, "no memory for more than %zu points",
                        r->cloud->count);
}

static bool is_fit_name(const char *at, size_t n) {
    double value;
    if (n == 0 || n >= PROPERTY_NAME_BYTES) return false;
    if (number_parse_f64(at, at + n, &value) == at + n) return false; /* a line with it wouldn't be one of names */
    if (n >= 6 && memcmp(at, "column", 6) == 0) return false;         /* those are ours, and so can't clash */
    for (size_t k = 0; k < n; k++)
        if ((at[k] < 33 || at[k] > 126) && !scan_is_blank(at[k])) return false;
    return true;
}

static bool xyz_is_taken(const struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return true;
    return false;
}

/* Gives property j the name of column c, which is n bytes at `at`; its number where that can't be. */
static void name_property(struct cloud *cloud, size_t j, size_t c, const char *at, size_t n) {
    char name[PROPERTY_NAME_BYTES] = "";
    for (size_t k = 0; is_fit_name(at, n) && k < n; k++) name[k] = scan_is_blank(at[k]) || is_mark(at[k]) ? '_' : at[k];
    if (!name[0] || xyz_is_taken(cloud, name)) snprintf(name, sizeof name, "column%zu", c + 1);
    memcpy(cloud->property[j].name, name, sizeof name);
}

/* What the file itself says of a column: the meaning of its name, or its name. */
static void name_from_file(struct reader *r, size_t c) {
    const struct column_names *names = &r->names;
    const char *meaning = c < names->count ? names->meaning[c] : NULL;
    if (meaning)
        name_property(r->cloud, r->target[c], c, meaning, strlen(meaning));
    else if (c < names->count)
        name_property(r->cloud, r->target[c], c, names->name[c].text, names->name[c].n);
    else
        name_property(r->cloud, r->target[c], c, "", 0);
}

static void forget_meanings(struct column_names *names) {
    memset(names->meaning, 0, sizeof names->meaning);
    names->has_xyz = names->is_geographic = false;
}

/* A file that begins with a count of its points and names no columns has those of PTS: x y z, intensity, r g b. */
static void name_as_pts(struct reader *r) {
    static const char *const names[8][7] = {[4] = {"x", "y", "z", "intensity"},
                                            [6] = {"x", "y", "z", "red", "green", "blue"},
                                            [7] = {"x", "y", "z", "intensity", "red", "green", "blue"}};
    r->is_pts = r->has_count && r->columns < 8 && names[r->columns][0];
    r->is_bare = !r->has_count && !r->names_at;
    for (size_t c = 0; c < r->columns; c++) {
        r->is_free[c] = c >= 3 && !r->is_pts;
        const char *name = r->is_pts ? names[r->columns][c] : c < 3 ? (const char[2]){"xyz"[c]} : "";
        name_property(r->cloud, c, c, name, strlen(name));
    }
}

/* The names on the line for an error message. */
static const char *quote_names(const struct column_names *names, char text[NAMES_BYTES]) {
    size_t used = 0, kept = names->count < CLOUD_MAX_PROPERTIES ? names->count : CLOUD_MAX_PROPERTIES;
    text[0] = 0;
    for (size_t j = 0; j < kept; j++) {
        char name[NUMBER_QUOTE_BYTES], whole[NUMBER_QUOTE_BYTES];
        snprintf(whole, sizeof whole, "%.*s", (int)(names->name[j].n < 30 ? names->name[j].n : 30),
                 names->name[j].text);
        for (char *c = whole; *c; c++)
            if (*c == ' ' || *c == '\t') *c = '_';
        number_quote(whole, whole + strlen(whole), name);
        if (used + strlen(name) + 8 > NAMES_BYTES) {
            snprintf(text + used, NAMES_BYTES - used, ", ...");
            break;
        }
        used += (size_t)snprintf(text + used, NAMES_BYTES - used, "%s%s", j ? ", " : "", name);
    }
    return text;
}

static enum status no_xyz(struct reader *r) {
    char text[NAMES_BYTES];
    return error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                        "x, y and z aren't known among the columns %s; name them by the parameter columns: in their "
                        "order (-,x,y,z) or by name or number (x:east,y:north,z:4)",
                        quote_names(&r->names, text));
}

/* Names that aren't as many as the values are no names of the columns, but a title.  Where some of them are known, or
 * they are separated as the values are, they would be taken for others. */
static enum status check_misfit(struct reader *r) {
    const struct column_names *names = &r->names;
    const char *const *meaning = names->meaning;
    bool in_front = names->has_xyz && meaning[0] && meaning[1] && meaning[2] && strcmp(meaning[0], "x") == 0 &&
                    strcmp(meaning[1], "y") == 0 && strcmp(meaning[2], "z") == 0;
    bool is_title = !names->has_xyz && !line_has(r->names_at, r->end, ';') && !line_has(r->names_at, r->end, ',');
    if (r->names_are_comment || in_front || is_title) return STATUS_OK;
    return error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                        "the point has %zu values, but the line of names has %zu", r->columns, names->count);
}

static enum status name_columns(struct reader *r) {
    struct column_names *names = &r->names;
    bool fits = r->names_at && names->count == r->columns;
    if (fits && !names->has_xyz) return no_xyz(r);
    if (!fits) {
        enum status status = r->names_at ? check_misfit(r) : STATUS_OK;
        if (!status) name_as_pts(r);
        return status;
    }
    for (size_t c = 0; c < r->columns; c++) {
        name_from_file(r, c);
        r->is_free[c] = !names->meaning[c];
    }
    if (names->is_geographic &&
        cloud_leave_out(r->cloud, LEFT_OUT_WARNING "x and y are degrees, longitude and latitude, unlike z: "
                                                   "project the points before, to one unit of length"))
        return xyz_no_memory(r);
    return STATUS_OK;
}

/* The number of the column from 0 that an entry of the list means; r->columns: there is none. */
static size_t listed_column(const struct reader *r, const struct column_entry *entry, size_t place) {
    if (!entry->column) return place < r->columns ? place : r->columns;
    struct scan_word word = {entry->column, entry->column_bytes};
    size_t found = column_names_find(&r->names, word.text, word.n);
    uint64_t number;
    if (found < r->names.count) return found < r->columns ? found : r->columns;
    return scan_u64(&word, &number) && number > 0 && number <= r->columns ? (size_t)number - 1 : r->columns;
}

static enum status bad_entry(struct reader *r, const struct column_entry *entry, const char *why) {
    char text[NAMES_BYTES];
    bool has_names = r->names_at != NULL;
    return error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                        "%.*s: %s; the file has %zu columns%s%s", (int)entry->name_bytes, entry->name, why, r->columns,
                        has_names ? ": " : "", has_names ? quote_names(&r->names, text) : "");
}

/* Names the columns by the caller's list; the others keep their names, but not a meaning. */
static enum status apply_list(struct reader *r) {
    struct column_entry entry, of_column[CLOUD_MAX_PROPERTIES] = {{0}};
    size_t place = 0, kept = 0;
    if (r->names_at && r->names.count != r->columns) r->names_at = NULL, r->names.count = 0;
    forget_meanings(&r->names);
    for (const char *at = r->list; column_list_next(&at, &entry); place++) {
        size_t c = listed_column(r, &entry, place);
        if (c == r->columns) return bad_entry(r, &entry, "there is no such column");
        if (of_column[c].name) return bad_entry(r, &entry, "this column has a name already");
        of_column[c] = entry;
    }
    for (size_t c = 0; c < r->columns; c++) {
        bool left_out = of_column[c].name_bytes == 1 && *of_column[c].name == '-';
        r->target[c] = left_out ? NONE : (uint32_t)kept++;
    }
    for (size_t c = 0; c < r->columns; c++)
        if (of_column[c].name && r->target[c] != NONE)
            name_property(r->cloud, r->target[c], c, of_column[c].name, of_column[c].name_bytes);
    for (size_t c = 0; c < r->columns; c++)
        if ((r->is_free[c] = !of_column[c].name)) name_from_file(r, c);
    r->cloud->property_count = kept;
    return STATUS_OK;
}

static void xyz_find_places(struct cloud *cloud) {
    for (size_t j = 0; j < cloud->property_count; j++)
        for (unsigned axis = 0; axis < 3; axis++)
            if (strcmp(cloud->property[j].name, (const char[2]){"xyz"[axis]}) == 0) cloud->xyz[axis] = (uint32_t)j;
}

static enum status leave_out_column(struct reader *r, size_t column) {
    struct cloud *cloud = r->cloud;
    char note[NOTE_BYTES];
    uint32_t j = r->target[column];
    snprintf(note, sizeof note, "the column %s, which has no numbers", cloud->property[j].name);
    memmove(&cloud->property[j], &cloud->property[j + 1], (--cloud->property_count - j) * sizeof *cloud->property);
    r->target[column] = NONE;
    for (size_t c = 0; c < r->columns; c++)
        if (r->target[c] != NONE && r->target[c] > j) r->target[c]--;
    return cloud_leave_out(cloud, note) ? xyz_no_memory(r) : STATUS_OK;
}

/* Leaves out the free columns in which the first point, where at is, has no number. */
static enum status leave_out_texts(struct reader *r) {
    const char *at = r->at;
    for (size_t c = 0; c < r->columns; c++) {
        const char *stop = end_of_word(r, at);
        enum status status = STATUS_OK;
        if (r->is_free[c] && r->target[c] != NONE && !is_number(r, at, stop)) status = leave_out_column(r, c);
        if (status) return status;
        at = after_blanks(r, stop);
        if (at < r->end && (r->mark ? *at == r->mark : is_mark(*at))) at = after_blanks(r, at + 1);
    }
    return STATUS_OK;
}

/* Sets up the columns from the first point's line, where at is. */
static enum status xyz_describe(struct reader *r) {
    struct cloud *cloud = r->cloud;
    if (r->names_at) column_names_split(r->names_at, r->end, &r->names);
    size_t columns = r->columns = count_columns(r);
    if (columns > r->max_columns)
        return error_set_at(r->error, STATUS_LIMIT, "properties", r->line, UINT64_MAX,
                            "%zu columns, at most %zu are allowed", columns, r->max_columns);
    if (columns < 3)
        return error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                            "the line has %zu values, a point has at least 3", columns);
    cloud->form = "xyz";
    cloud->property = alloc_zeroed(columns, sizeof *cloud->property);
    if (!cloud->property) return xyz_no_memory(r);
    cloud->property_count = columns;
    for (size_t j = 0; j < columns; j++) r->target[j] = (uint32_t)j;
    enum status status = r->list ? apply_list(r) : name_columns(r);
    if (!status) status = leave_out_texts(r);
    xyz_find_places(cloud);
    cloud->record_bytes = cloud->property_count * sizeof(double);
    for (size_t j = 0; j < cloud->property_count; j++) {
        cloud->property[j].type = SCALAR_FLOAT64;
        cloud->property[j].offset_bytes = j * sizeof(double);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ points */

static enum status resize(struct reader *r, size_t capacity) {
    struct cloud *cloud = r->cloud;
    vec3 *position = alloc_resize(cloud->position, capacity, sizeof *position);
    if (!position) return xyz_no_memory(r);
    cloud->position = position;
    unsigned char *record = alloc_resize(cloud->record, capacity, cloud->record_bytes);
    if (!record) return xyz_no_memory(r);
    cloud->record = record;
    r->capacity = capacity;
    return STATUS_OK;
}

static enum status xyz_bad(struct reader *r, size_t column, const char *what) {
    char quote[NUMBER_QUOTE_BYTES];
    bool kept = column < r->columns && r->target[column] != NONE;
    const char *name = kept ? r->cloud->property[r->target[column]].name : "columns";
    return error_set_at(r->error, STATUS_MALFORMED, name, r->line, UINT64_MAX, "value %zu of the line is '%s': %s",
                        column + 1, number_quote(r->at, end_of_word(r, r->at), quote), what);
}

static enum status bad_width(struct reader *r, size_t columns) {
    const char *which = columns < r->columns ? "fewer" : "more";
    return error_set_at(r->error, STATUS_MALFORMED, "columns", r->line, UINT64_MAX,
                        "the line has %s values than the first point, which has %zu", which, r->columns);
}

/* Skips a separator; *mark is the comma or semicolon that this line has used, 0 = none yet. */
static enum status take_separator(struct reader *r, char *mark, size_t column) {
    skip_blanks(r);
    if (r->at == r->end || (r->mark ? *r->at != r->mark : !is_mark(*r->at))) return STATUS_OK;
    if (*mark && *mark != *r->at) return xyz_bad(r, column, "both commas and semicolons between values");
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

static bool at_line_end(const struct reader *r) { return r->at == r->end || scan_is_newline(*r->at); }

/* Whether the file has had both decimal commas and decimal points, now that this number was read. */
static bool mixes_decimals(struct reader *r, const char *at, const char *after) {
    size_t n = (size_t)(after - at);
    r->seen_comma = r->seen_comma || memchr(at, ',', n);
    r->seen_point = r->seen_point || memchr(at, '.', n);
    return r->seen_comma && r->seen_point;
}

/* What is in a free column, and is no number, is nan there. */
static void take_word(struct reader *r, size_t column, double *value) {
    char quote[NUMBER_QUOTE_BYTES];
    *value = NAN;
    if (r->words++) return;
    snprintf(r->first_word, sizeof r->first_word, "'%s' in line %" PRIu64 " of the column %s",
             number_quote(r->at, end_of_word(r, r->at), quote), r->line, r->cloud->property[r->target[column]].name);
}

/* Reads the value of a column that is kept. */
static enum status xyz_take_value(struct reader *r, size_t column, double *value) {
    const char *after = parse_value(r, r->at, r->end, value);
    if (!after || !ends_value(r, after)) {
        if (!r->is_free[column])
            return xyz_bad(r, column, "not a number (the parameter columns leaves a column out by -)");
        take_word(r, column, value);
        after = end_of_word(r, r->at);
    } else if (r->decimal_commas && mixes_decimals(r, r->at, after)) {
        return xyz_bad(r, column,
                       "the file has commas and points in numbers, one of which may set off thousands; write points "
                       "for decimals and nothing for thousands");
    }
    r->at = after;
    return STATUS_OK;
}

/* Whether nothing is left of a line but its last value, which need not be there. */
static bool lacks_last(const struct reader *r, size_t column) {
    const char *at = r->at;
    if (!r->mark || column + 1 != r->columns || !(r->is_free[column] || r->target[column] == NONE)) return false;
    while (scan_is_blank(at[-1]) && at[-1] != r->mark) at--;
    return at[-1] == r->mark;
}

/* Reads the values of one line into record. */
static enum status take_values(struct reader *r, double *record) {
    size_t j = 0, columns = r->columns;
    char mark = 0;
    for (; !at_line_end(r) || lacks_last(r, j); j++) {
        enum status status = STATUS_OK;
        if (j == columns) return bad_width(r, j + 1);
        if (r->target[j] == NONE)
            r->at = end_of_word(r, r->at);
        else
            status = xyz_take_value(r, j, &record[r->target[j]]);
        if (!status) status = take_separator(r, &mark, j + 1);
        if (status) return status;
    }
    return j == columns ? STATUS_OK : bad_width(r, j);
}

static enum status xyz_take_point(struct reader *r) {
    struct cloud *cloud = r->cloud;
    double record[CLOUD_MAX_PROPERTIES];
    const char *line = r->at;
    enum status status = take_values(r, record);
    const char *unclear = status || cloud->count == 0 ? comma_inside(line, r->end) : NULL;
    if (unclear && !r->decimal_commas) return one_or_two(r, unclear);
    if (status) return status;
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

/* Whether a line that begins with a semicolon is one whose first value isn't there. */
static bool is_row(const struct reader *r) {
    struct split split;
    return r->mark == ';' && *r->at == ';' && split_by_mark(r, r->at, &split) &&
           (split.values == r->columns || (split.ends_in_mark && split.values + 1 == r->columns));
}

/* Up to `most` points in the cloud. */
static enum status xyz_take_points(struct reader *r, size_t most) {
    for (; skip_blanks(r), r->at < r->end && r->cloud->count < most; skip_line(r)) {
        if (scan_is_newline(*r->at) || (at_comment(r) && !is_row(r))) continue;
        if (r->cloud->count % TICK_POINTS == 0 &&
            progress_tick(r->progress, "read", (double)(r->at - r->begin) / (double)(r->end - r->begin)))
            return error_set(r->error, STATUS_CANCELLED, "read", "cancelled");
        enum status status = xyz_take_point(r);
        if (status) return status;
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the whole */

/* Fewer points than the file counts are lost; more are kept, which goes to the report. */
static enum status check_count(struct reader *r, uint64_t points) {
    char note[2 * NOTE_BYTES];
    if (!r->has_count || r->count == points) return STATUS_OK;
    snprintf(note, sizeof note, "the file begins with a count of %" PRIu64 " points, %" PRIu64 " are there", r->count,
             points);
    if (points < r->count) return error_set_at(r->error, STATUS_MALFORMED, "count", 1, UINT64_MAX, "%s", note);
    return cloud_leave_out(r->cloud, note) ? xyz_no_memory(r) : STATUS_OK;
}

/* Words that are nan go to the report. */
static enum status note_words(struct reader *r) {
    char note[2 * NOTE_BYTES];
    if (!r->words) return STATUS_OK;
    snprintf(note, sizeof note, "%" PRIu64 " %s, nan there: the first is %s", r->words,
             r->words == 1 ? "value that is no number" : "values that are no numbers", r->first_word);
    return cloud_leave_out(r->cloud, note) ? xyz_no_memory(r) : STATUS_OK;
}

/* The largest number in the last three columns; -1 where one is no whole number from 0 to 255. */
static double largest_of_colours(const struct reader *r) {
    const struct cloud *cloud = r->cloud;
    double largest = -1;
    for (size_t i = 0; i < cloud->count; i++)
        for (size_t c = r->columns - 3; c < r->columns; c++) {
            double value =
                scalar_load(cloud->record + i * cloud->record_bytes + cloud->property[c].offset_bytes, SCALAR_FLOAT64);
            if (!(value >= 0 && value <= 255 && value == floor(value))) return -1;
            largest = fmax(largest, value);
        }
    return largest;
}

/* Names the columns at the place of PTS's colours by what they hold: those of PTS need not be colours, and without a
 * count they may be. */
static enum status settle_colours(struct reader *r) {
    static const char *const names[] = {"intensity", "red", "green", "blue"};
    struct cloud *cloud = r->cloud;
    bool has_room = (r->columns == 6 || r->columns == 7) && cloud->property_count == r->columns;
    if (!has_room || !(r->is_pts || r->is_bare)) return STATUS_OK;
    double largest = largest_of_colours(r);
    if (r->is_pts && largest < 0)
        for (size_t c = 3; c < r->columns; c++)
            snprintf(cloud->property[c].name, PROPERTY_NAME_BYTES, "column%zu", c + 1);
    if (!r->is_bare || largest < COLOUR_LEAST) return STATUS_OK;
    for (size_t c = 3; c < r->columns; c++)
        snprintf(cloud->property[c].name, PROPERTY_NAME_BYTES, "%s", names[c + 4 - r->columns]);
    char note[NOTE_BYTES];
    snprintf(note, sizeof note,
             LEFT_OUT_NOTE "columns 4 to %zu, which have no names, are taken for %sred, green and blue; the parameter "
                           "columns names them",
             r->columns, r->columns == 7 ? "intensity, " : "");
    return cloud_leave_out(cloud, note) ? xyz_no_memory(r) : STATUS_OK;
}

static enum status xyz_read_file(struct reader *r) {
    if (!find_first_point(r)) return error_set_at(r->error, STATUS_MALFORMED, "read", r->line, UINT64_MAX, "no points");
    enum status status = xyz_describe(r);
    if (!status) status = xyz_take_points(r, SIZE_MAX);
    if (!status) status = check_count(r, r->cloud->count);
    if (!status) status = note_words(r);
    if (!status) status = cloud_drop_unplaced(r->cloud, r->error);
    if (!status) status = settle_colours(r);
    return status ? status : resize(r, r->cloud->count);
}

static struct reader xyz_start(const void *bytes, size_t n, const struct cloud_limits *limits) {
    uint64_t points = limits && limits->max_points ? limits->max_points : NONE - 1;
    size_t columns = limits && limits->max_properties ? limits->max_properties : CLOUD_MAX_PROPERTIES;
    const char *text = bytes;
    return (struct reader){.begin = text,
                           .at = text,
                           .end = text + padding_text_bytes(text, n),
                           .line = 1,
                           .list = limits && limits->columns && limits->columns[0] ? limits->columns : NULL,
                           .max_points = points < NONE - 1 ? points : NONE - 1,
                           .max_columns = columns < CLOUD_MAX_PROPERTIES ? columns : CLOUD_MAX_PROPERTIES};
}

/* Text that is no other format's may be this one. */
const char *cloud_xyz_look(const struct first_bytes *first) { return first->is_text ? "xyz" : ""; }

enum status cloud_xyz_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct cloud read = {0};
    struct reader r = xyz_start(bytes, n, limits);
    assert(!r.list || column_list_is_valid(r.list));
    r.progress = progress;
    r.cloud = &read;
    r.error = error;
    enum status status = xyz_read_file(&r);
    if (!status) {
        *cloud = read;
        read = (struct cloud){0};
    }
    cloud_done(&read);
    return status;
}

/* ------------------------------------------------------------------------------------------------ part by part */

struct xyz_parts {
    struct cloud_parts parts;
    struct reader reader;
    struct cloud cloud;
    uint64_t points;
};

static enum status xyz_next_part(struct cloud_parts *parts, struct error *error) {
    struct xyz_parts *p = (struct xyz_parts *)parts;
    struct reader *r = &p->reader;
    bool first = p->points == 0;
    r->error = error;
    p->cloud.count = 0;
    enum status status = xyz_take_points(r, PART_POINTS);
    p->points += p->cloud.count;
    if (!status && p->cloud.count < PART_POINTS) status = check_count(r, p->points);
    if (!status && p->cloud.count < PART_POINTS) status = note_words(r);
    if (!status && first) status = settle_colours(r);
    parts->done_bytes = (size_t)(r->at - r->begin);
    return status;
}

static void xyz_free_parts(struct cloud_parts *parts) {
    struct xyz_parts *p = (struct xyz_parts *)parts;
    cloud_done(&p->cloud);
    free(p);
}

enum status cloud_xyz_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) {
    struct xyz_parts *p = alloc_zeroed(1, sizeof *p);
    if (!p) return error_set(error, STATUS_NO_MEMORY, "read", "no memory to read with");
    struct reader *r = &p->reader;
    *r = xyz_start(bytes, n, limits);
    r->cloud = &p->cloud;
    r->error = error;
    enum status status = STATUS_OK;
    if (!find_first_point(r)) status = error_set_at(error, STATUS_MALFORMED, "read", r->line, UINT64_MAX, "no points");
    if (!status) status = xyz_describe(r);
    if (!status) status = resize(r, PART_POINTS);
    p->parts = (struct cloud_parts){&p->cloud, r->has_count ? r->count : 0, 0, xyz_next_part, xyz_free_parts, false, 0};
    if (status)
        xyz_free_parts(&p->parts);
    else
        *out = &p->parts;
    return status;
}
