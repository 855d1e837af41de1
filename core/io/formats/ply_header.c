/* PLY headers.
 *
 *     ply
 *     format binary_little_endian 1.0          or ascii, binary_big_endian
 *     comment anything                         also obj_info; both are kept
 *     element vertex 12
 *     property float x                         char uchar short ushort int uint float double, or int8 .. float64
 *     property list uchar int vertex_indices   a list: type of its length, type of its items
 *     end_header
 *
 * Lines end by \n or \r\n; a file whose first line ends by a lone \r has lone \r throughout.  The first line decides,
 * so that a binary body that begins with \n isn't taken for a part of the header.  A byte order mark may come before it
 * (an editor's), and coordinates may be named in capitals; they become x, y and z.
 *
 * The parser knows one line at a time, split into words; a table gives each keyword its function.  Nothing that the
 * header promises is allocated here but room for the properties that it names, which PLY_HEADER_MAX_BYTES bounds.
 *
 * Source: G. Turk: The PLY polygon file format, 1994.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/ply_header.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/text/number.h"

enum { MAX_WORDS = 6 };

struct word {
    const char *text, *end;
};

struct parser {
    const char *at, *end;
    char terminator;
    uint64_t line;
    struct word whole; /* the line, without its end */
    size_t word_count;
    struct word word[MAX_WORDS];
    bool has_format;
    size_t comment_bytes, property_capacity;
    struct ply_header *header;
    struct error *error;
};

static const struct {
    const char *name;
    enum scalar_type type;
} type_names[] = {
    {"char", SCALAR_INT8},     {"int8", SCALAR_INT8},       {"uchar", SCALAR_UINT8},    {"uint8", SCALAR_UINT8},
    {"short", SCALAR_INT16},   {"int16", SCALAR_INT16},     {"ushort", SCALAR_UINT16},  {"uint16", SCALAR_UINT16},
    {"int", SCALAR_INT32},     {"int32", SCALAR_INT32},     {"uint", SCALAR_UINT32},    {"uint32", SCALAR_UINT32},
    {"float", SCALAR_FLOAT32}, {"float32", SCALAR_FLOAT32}, {"double", SCALAR_FLOAT64}, {"float64", SCALAR_FLOAT64},
};

static const struct {
    const char *name;
    enum ply_form form;
} format_names[] = {
    {"ascii", PLY_ASCII}, {"binary_little_endian", PLY_LITTLE_ENDIAN}, {"binary_big_endian", PLY_BIG_ENDIAN}};

const char *ply_form_name(enum ply_form form) {
    static const char *const names[] = {"ply/ascii", "ply/binary_little_endian", "ply/binary_big_endian"};
    return names[form];
}

/* ------------------------------------------------------------------------------------------------ lines, words */

static bool is_word(struct word word, const char *text) {
    size_t length = strlen(text);
    return (size_t)(word.end - word.text) == length && memcmp(word.text, text, length) == 0;
}

/* Takes the next line, or returns false where the data ends before the line does. */
static bool next_line(struct parser *p) {
    const char *stop = memchr(p->at, p->terminator, (size_t)(p->end - p->at));
    if (!stop) return false;
    p->whole = (struct word){p->at, stop};
    if (p->whole.end > p->whole.text && p->whole.end[-1] == '\r') p->whole.end--;
    p->at = stop + 1;
    p->line++;
    return true;
}

static bool ply_is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

static void ply_split(struct parser *p) {
    const char *at = p->whole.text, *end = p->whole.end;
    for (p->word_count = 0; p->word_count < MAX_WORDS; p->word_count++) {
        while (at < end && ply_is_blank(*at)) at++;
        if (at == end) return;
        struct word *word = &p->word[p->word_count];
        word->text = at;
        while (at < end && !ply_is_blank(*at)) at++;
        word->end = at;
    }
}

/* STATUS_MALFORMED on this line: what is wrong, and the word that is. */
static enum status ply_header_bad(struct parser *p, const char *what, size_t word) {
    char quote[NUMBER_QUOTE_BYTES] = "";
    if (word < MAX_WORDS && word < p->word_count) number_quote(p->word[word].text, p->word[word].end, quote);
    return error_set_at(p->error, STATUS_MALFORMED, "header", p->line, UINT64_MAX, quote[0] ? "%s: '%s'" : "%s", what,
                        quote);
}

static enum status over(struct parser *p, const char *what, int limit) {
    return error_set_at(p->error, STATUS_LIMIT, "header", p->line, UINT64_MAX, "more than %d %s", limit, what);
}

static enum status copy_name(struct parser *p, size_t word, char name[PROPERTY_NAME_BYTES]) {
    size_t length = (size_t)(p->word[word].end - p->word[word].text);
    if (length >= PROPERTY_NAME_BYTES) return over(p, "bytes in a name", PROPERTY_NAME_BYTES - 1);
    for (size_t i = 0; i < length; i++)
        if (p->word[word].text[i] < 33 || p->word[word].text[i] > 126)
            return ply_header_bad(p, "name is no printable ASCII", word);
    memcpy(name, p->word[word].text, length);
    name[length] = '\0';
    return STATUS_OK;
}

static bool read_type(struct word word, enum scalar_type *type) {
    for (size_t i = 0; i < sizeof type_names / sizeof *type_names; i++)
        if (is_word(word, type_names[i].name)) return *type = type_names[i].type, true;
    return false;
}

static bool read_count(struct word word, uint64_t *count) {
    uint64_t n = 0;
    for (const char *c = word.text; c < word.end; c++)
        if (*c < '0' || *c > '9' || __builtin_mul_overflow(n, 10u, &n) ||
            __builtin_add_overflow(n, (uint64_t)(*c - '0'), &n))
            return false;
    return *count = n, true;
}

/* ------------------------------------------------------------------------------------------------ keywords */

static enum status parse_format(struct parser *p) {
    if (p->has_format) return ply_header_bad(p, "a second format line", MAX_WORDS);
    if (p->word_count != 3) return ply_header_bad(p, "a format line has a format and a version", MAX_WORDS);
    size_t n = sizeof format_names / sizeof *format_names, i = 0;
    while (i < n && !is_word(p->word[1], format_names[i].name)) i++;
    if (i == n) return ply_header_bad(p, "unknown PLY format", 1);
    if (!is_word(p->word[2], "1.0"))
        return error_set_at(p->error, STATUS_UNSUPPORTED, "header", p->line, UINT64_MAX,
                            "only PLY version 1.0 is read");
    p->header->form = format_names[i].form;
    p->has_format = true;
    return STATUS_OK;
}

/* Keeps the line, with '?' for control characters: it will stand in headers that we write. */
static enum status parse_comment(struct parser *p) {
    size_t length = (size_t)(p->whole.end - p->whole.text);
    if (p->comment_bytes + length + 1 > PLY_COMMENTS_MAX_BYTES) return STATUS_OK;
    char *comments = alloc_resize(p->header->comments, p->comment_bytes + length + 2, 1);
    if (!comments) return error_set(p->error, STATUS_NO_MEMORY, "header", "no memory for comments");
    p->header->comments = comments;
    for (size_t i = 0; i < length; i++) {
        unsigned char c = (unsigned char)p->whole.text[i];
        comments[p->comment_bytes++] = (char)(c < 32 && c != '\t' ? '?' : c);
    }
    memcpy(comments + p->comment_bytes++, "\n", 2);
    return STATUS_OK;
}

static enum status parse_element(struct parser *p) {
    struct ply_header *h = p->header;
    if (p->word_count != 3) return ply_header_bad(p, "an element line has a name and a count", MAX_WORDS);
    if (h->element_count == PLY_MAX_ELEMENTS) return over(p, "elements", PLY_MAX_ELEMENTS);
    struct ply_element element = {.first = h->property_count};
    enum status status = copy_name(p, 1, element.name);
    if (status) return status;
    if (!read_count(p->word[2], &element.count))
        return ply_header_bad(p, "count of an element isn't a whole number", 2);
    for (size_t i = 0; i < h->element_count; i++)
        if (strcmp(h->element[i].name, element.name) == 0) return ply_header_bad(p, "a second element of this name", 1);
    h->element[h->element_count++] = element;
    return STATUS_OK;
}

/* Reads "property [list COUNT_TYPE] TYPE NAME" but for the name. */
static enum status read_types(struct parser *p, struct property *property) {
    bool list = p->word_count > 1 && is_word(p->word[1], "list");
    if (p->word_count != (list ? 5u : 3u)) return ply_header_bad(p, "a property line has a type and a name", MAX_WORDS);
    property->is_list = list;
    if (list && !read_type(p->word[2], &property->count_type)) return ply_header_bad(p, "unknown type", 2);
    if (list && property->count_type >= SCALAR_FLOAT32)
        return ply_header_bad(p, "length of a list must be an integer", 2);
    if (!read_type(p->word[list ? 3 : 1], &property->type)) return ply_header_bad(p, "unknown type", list ? 3 : 1);
    return STATUS_OK;
}

static enum status append_property(struct parser *p, const struct property *property) {
    struct ply_header *h = p->header;
    if (h->property_count == p->property_capacity) {
        size_t capacity = p->property_capacity ? 2 * p->property_capacity : 16;
        struct property *grown = alloc_resize(h->property, capacity, sizeof *grown);
        if (!grown) return error_set(p->error, STATUS_NO_MEMORY, "header", "no memory for properties");
        h->property = grown;
        p->property_capacity = capacity;
    }
    h->property[h->property_count++] = *property;
    h->element[h->element_count - 1].property_count++;
    return STATUS_OK;
}

static enum status parse_property(struct parser *p) {
    struct ply_header *h = p->header;
    if (h->element_count == 0) return ply_header_bad(p, "a property before any element", MAX_WORDS);
    struct property property = {0};
    enum status status = read_types(p, &property);
    if (!status) status = copy_name(p, p->word_count - 1, property.name);
    if (status) return status;
    struct ply_element *element = &h->element[h->element_count - 1];
    if (element->property_count == CLOUD_MAX_PROPERTIES) return over(p, "properties", CLOUD_MAX_PROPERTIES);
    for (size_t i = element->first; i < h->property_count; i++) {
        if (strcmp(h->property[i].name, property.name) == 0)
            return ply_header_bad(p, "a second property of this name", p->word_count - 1);
        if (!h->property[i].is_list) property.offset_bytes += scalar_bytes(h->property[i].type);
    }
    return append_property(p, &property);
}

static const struct {
    const char *name;
    enum status (*parse)(struct parser *p);
} keywords[] = {
    {"property", parse_property}, {"element", parse_element},  {"comment", parse_comment},
    {"format", parse_format},     {"obj_info", parse_comment},
};

/* ------------------------------------------------------------------------------------------------ the whole */

/* Which property of the element has this name; its property_count when none has. */
static size_t ply_find_property(const struct ply_header *h, const struct ply_element *element, const char *name) {
    size_t i = 0;
    while (i < element->property_count && strcmp(h->property[element->first + i].name, name) != 0) i++;
    return i;
}

static enum status ply_find_xyz(struct parser *p, const struct ply_element *vertex) {
    static const char *const names[3] = {"x", "y", "z"}, *const capitals[3] = {"X", "Y", "Z"};
    for (int axis = 0; axis < 3; axis++) {
        size_t i = ply_find_property(p->header, vertex, names[axis]);
        if (i == vertex->property_count) {
            i = ply_find_property(p->header, vertex, capitals[axis]);
            if (i < vertex->property_count) memcpy(p->header->property[vertex->first + i].name, names[axis], 2);
        }
        if (i == vertex->property_count || p->header->property[vertex->first + i].is_list)
            return error_set(p->error, STATUS_MALFORMED, names[axis], "the vertex element has no scalar property %s",
                             names[axis]);
        p->header->xyz[axis] = (uint32_t)i;
    }
    return STATUS_OK;
}

static enum status check_whole(struct parser *p) {
    struct ply_header *h = p->header;
    if (!p->has_format) return error_set(p->error, STATUS_MALFORMED, "header", "the header has no format line");
    size_t i = 0;
    while (i < h->element_count && strcmp(h->element[i].name, "vertex") != 0) i++;
    if (i == h->element_count) return error_set(p->error, STATUS_MALFORMED, "header", "there is no element vertex");
    h->vertex = i;
    return ply_find_xyz(p, &h->element[i]);
}

static enum status parse_line(struct parser *p) {
    ply_split(p);
    if (p->word_count == 0) return STATUS_OK;
    for (size_t i = 0; i < sizeof keywords / sizeof *keywords; i++)
        if (is_word(p->word[0], keywords[i].name)) return keywords[i].parse(p);
    return ply_header_bad(p, "unknown keyword in the header", 0);
}

static enum status no_end(struct parser *p, size_t n) {
    if (n >= PLY_HEADER_MAX_BYTES)
        return error_set_at(p->error, STATUS_LIMIT, "header", p->line, PLY_HEADER_MAX_BYTES,
                            "the header is longer than %d bytes", PLY_HEADER_MAX_BYTES);
    return error_set_at(p->error, STATUS_MALFORMED, "header", p->line + 1, n,
                        "the file ends inside the header: no end_header after %zu bytes", n);
}

static struct parser ply_start(const void *bytes, size_t n) {
    const char *text = bytes, *end = text + (n < PLY_HEADER_MAX_BYTES ? n : PLY_HEADER_MAX_BYTES);
    if (n >= 3 && memcmp(text, "\xef\xbb\xbf", 3) == 0) text += 3;
    bool lone_return = end - text > 4 && text[3] == '\r' && text[4] != '\n';
    return (struct parser){.at = text, .end = end, .terminator = lone_return ? '\r' : '\n'};
}

enum status ply_header_parse(const void *bytes, size_t n, struct ply_header *header, struct error *error) {
    struct ply_header parsed = {0};
    struct parser p = ply_start(bytes, n);
    p.header = &parsed;
    p.error = error;
    enum status status = STATUS_OK;
    bool ended = false;
    while (!status && !ended && next_line(&p)) {
        ply_split(&p);
        ended = p.word_count == 1 && is_word(p.word[0], "end_header");
        if (p.line == 1 && !(p.word_count == 1 && is_word(p.word[0], "ply")))
            status = ply_header_bad(&p, "the first line isn't 'ply'", 0);
        else if (p.line > 1 && !ended)
            status = parse_line(&p);
    }
    if (!status && !ended) status = no_end(&p, n);
    if (!status) status = check_whole(&p);
    if (status) {
        ply_header_done(&parsed);
        return status;
    }
    parsed.bytes = (size_t)(p.at - (const char *)bytes);
    parsed.lines = p.line;
    *header = parsed;
    return STATUS_OK;
}

void ply_header_done(struct ply_header *header) {
    if (!header) return;
    free(header->property);
    free(header->comments);
    *header = (struct ply_header){0};
}

/* ------------------------------------------------------------------------------------------------ sizes */

/* Fewest bytes of a record: in text a digit and a separator for each value, in binary scalars and lengths of lists. */
static uint64_t record_min_bytes(const struct ply_header *h, const struct ply_element *element, bool *exact) {
    uint64_t bytes = 0;
    for (size_t i = 0; i < element->property_count; i++) {
        const struct property *property = &h->property[element->first + i];
        if (property->is_list && element->count) *exact = false;
        bytes += h->form == PLY_ASCII ? 2
                 : property->is_list  ? scalar_bytes(property->count_type)
                                      : scalar_bytes(property->type);
    }
    return bytes;
}

uint64_t ply_header_file_bytes(const struct ply_header *header, bool *exact) {
    uint64_t total = 0;
    *exact = header->form != PLY_ASCII;
    for (size_t i = 0; i < header->element_count; i++) {
        uint64_t bytes = record_min_bytes(header, &header->element[i], exact);
        if (__builtin_mul_overflow(bytes, header->element[i].count, &bytes) ||
            __builtin_add_overflow(total, bytes, &total))
            return UINT64_MAX;
    }
    if (header->form == PLY_ASCII && total > 0) total--; /* the last line's end may be missing */
    return __builtin_add_overflow(total, header->bytes, &total) ? UINT64_MAX : total;
}

enum status ply_header_fits(const struct ply_header *header, uint64_t total_bytes, struct error *error) {
    bool exact;
    uint64_t expected = ply_header_file_bytes(header, &exact);
    if (total_bytes >= expected) return STATUS_OK;
    return error_set_at(error, STATUS_MALFORMED, "header", 0, total_bytes,
                        "the header promises %" PRIu64 " vertices: %s%" PRIu64 " bytes expected, %" PRIu64
                        " bytes are there",
                        header->element[header->vertex].count, exact ? "" : "at least ", expected, total_bytes);
}

static bool has_end(const void *bytes, size_t n) {
    struct parser p = ply_start(bytes, n);
    while (next_line(&p)) {
        ply_split(&p);
        if (p.word_count == 1 && is_word(p.word[0], "end_header")) return true;
    }
    return false;
}

static struct ply_summary summarise(const struct ply_header *header) {
    const struct ply_element *vertex = &header->element[header->vertex];
    struct ply_summary summary = {.complete = true,
                                  .form = header->form,
                                  .vertex_count = vertex->count,
                                  .property_count = vertex->property_count,
                                  .header_bytes = header->bytes};
    for (size_t i = 0; i < vertex->property_count; i++) {
        const struct property *property = &header->property[vertex->first + i];
        if (!property->is_list) summary.record_bytes += scalar_bytes(property->type);
    }
    for (size_t i = 0; i < header->element_count; i++)
        if (strcmp(header->element[i].name, "face") == 0) summary.face_count = header->element[i].count;
    summary.bytes_expected = ply_header_file_bytes(header, &summary.bytes_exact);
    summary.triangles_most = summary.face_count;
    return summary;
}

/* The bytes that a corner of a face takes at least. */
static uint64_t corner_bytes(const struct ply_header *header) {
    enum { TEXT_BYTES = 2 }; /* a digit and a blank */
    uint64_t least = UINT64_MAX;
    if (header->form == PLY_ASCII) return TEXT_BYTES;
    for (size_t i = 0; i < header->element_count; i++) {
        const struct ply_element *element = &header->element[i];
        if (strcmp(element->name, "face") != 0) continue;
        for (size_t j = element->first; j < element->first + element->property_count; j++) {
            const struct property *list = &header->property[j];
            if (list->is_list && strncmp(list->name, "vertex_ind", strlen("vertex_ind")) == 0)
                least = scalar_bytes(list->type);
        }
    }
    return least;
}

/* All bytes that the header doesn't speak for are entries of lists; a face of n corners is n - 2 triangles. */
static uint64_t most_triangles(const struct ply_header *header, const struct ply_summary *summary,
                               uint64_t total_bytes) {
    if (!summary->face_count || total_bytes == UINT64_MAX || total_bytes < summary->bytes_expected)
        return summary->face_count;
    uint64_t corners = (total_bytes - summary->bytes_expected) / corner_bytes(header);
    uint64_t spent = header->form == PLY_ASCII ? 0 : 2 * summary->face_count;
    uint64_t most = corners > spent ? corners - spent : 0;
    return most > summary->face_count ? most : summary->face_count;
}

enum status ply_header_check(const void *first_bytes, size_t n, uint64_t total_bytes, struct ply_summary *summary,
                             struct error *error) {
    if (n < total_bytes && n < PLY_HEADER_MAX_BYTES && !has_end(first_bytes, n)) {
        *summary = (struct ply_summary){0};
        return STATUS_OK;
    }
    struct ply_header header;
    enum status status = ply_header_parse(first_bytes, n, &header, error);
    if (status) return status;
    if (total_bytes != UINT64_MAX) status = ply_header_fits(&header, total_bytes, error);
    if (!status) {
        *summary = summarise(&header);
        summary->triangles_most = most_triangles(&header, summary, total_bytes);
    }
    ply_header_done(&header);
    return status;
}
