/* OBJ.
 *
 *     v x y z [w | red green blue [alpha]]      a vertex
 *     vn x y z, vt u [v [w]]                    a normal, texture coordinates: for corners of faces to refer to
 *     f v[/[vt][/[vn]]] ...                     a face; indices count from 1, negative ones back from the last
 *     anything else of OBJ                      is passed over, as other words are, which are told
 *
 * "#" begins a comment, a backslash at the end of a line joins the next one to it.  Numbers become float64.  Faces
 * become fans of triangles.  Where lines of a kind have different numbers of numbers, those that all of them have are
 * kept, and that is noted.
 *
 * A point of a cloud has one normal, a vertex of OBJ as many as it has corners.  Normals become properties nx, ny, nz
 * (texture coordinates s, t) where every vertex has exactly one: all corners at it refer to equal ones, or there are no
 * faces and as many normals as vertices.  Where texture coordinates differ at a few vertices, those of a seam, these
 * have copies behind all vertices, one for each of the others that corners refer to.  Else they are left out, and that
 * is noted.
 *
 * Invariant: table.count is the number of lines of its kind that came so far; of_vertex[i] is NONE or < attribute
 * count.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"

#include <ctype.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/build.h"
#include "core/io/first_bytes.h"
#include "core/io/text_scanner.h"

enum {
    MAX_WIDTH = 8,
    COLOURED = 6,
    FIRST_ROWS = 1024,
    COPIES_SHARE = 4 /* of the vertices */,
    COPIES_MOST = 256 /* of one */
};

/* Rows of numbers. */
struct table {
    size_t count, capacity;
    size_t stride, width; /* numbers that there is room for, of the first row; that all rows have */
    bool uneven;          /* some have others as well */
    double *value;        /* owned */
};

/* What corners refer to besides the vertex. */
struct attribute {
    struct table table;
    uint32_t *of_vertex; /* which row each vertex has; NONE: none yet; owned */
    size_t capacity;     /* of of_vertex */
    bool used, differs;  /* corners refer to it; two corners of one vertex to different rows */
    uint32_t *copy_of;   /* of each vertex the first of its copies, or NONE; owned; capacity as of_vertex */
};

/* A vertex once more, with another row of texture coordinates. */
struct copy {
    uint32_t vertex, row, next; /* next: of the same vertex, or NONE */
};

enum { NORMALS, TEXTURE, ATTRIBUTES };

struct reader {
    struct cloud_build build;
    struct scan scan;
    struct table vertex;
    uint64_t *vertex_line; /* of each vertex, for errors; owned */
    size_t line_capacity;
    struct attribute attribute[ATTRIBUTES];
    struct copy *copy; /* owned */
    size_t copies, copy_capacity;
    bool too_many;                  /* copies would be */
    bool has_unknown;               /* lines with a first word that isn't OBJ's; told */
    uint64_t largest, largest_line; /* index of a vertex, from 1, that a face has used, and where */
};

static struct cloud_place obj_here(const struct reader *r) {
    return (struct cloud_place){r->scan.line, (uint64_t)(r->scan.at - r->scan.begin)};
}

static enum status obj_no_memory(struct reader *r) {
    return error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for more than %zu vertices", r->vertex.count);
}

/* ------------------------------------------------------------------------------------------------ numbers */

static double *obj_row(const struct table *table, size_t i) { return table->value + i * table->stride; }

static enum status obj_add_row(struct reader *r, struct table *table, const double *row) {
    if (table->count == table->capacity) {
        size_t capacity = table->capacity + table->capacity / 2 + FIRST_ROWS;
        double *grown = alloc_resize(table->value, capacity, table->stride * sizeof *grown);
        if (!grown) return obj_no_memory(r);
        table->value = grown;
        table->capacity = capacity;
    }
    memcpy(obj_row(table, table->count), row, table->stride * sizeof *row);
    table->count++;
    return STATUS_OK;
}

/* How many numbers mean the same in rows of a and of b: the fourth is a colour's where there are six or more. */
static size_t common_width(size_t a, size_t b) {
    size_t fewer = a < b ? a : b, more = a < b ? b : a;
    return fewer > 3 && fewer < COLOURED && more >= COLOURED ? 3 : fewer;
}

static void obj_set_width(struct table *table, size_t n) {
    if (table->count == 0) table->stride = table->width = n;
    table->uneven = table->uneven || n != table->width;
    table->width = common_width(table->width, n);
}

/* Reads the rest of the line as a row of at least `least` numbers. */
static enum status take_row(struct reader *r, struct table *table, size_t least, const char *what) {
    double row[MAX_WIDTH] = {0};
    struct scan_word word;
    size_t n = 0;
    char quote[NUMBER_QUOTE_BYTES];
    uint64_t line = r->scan.line;
    for (; scan_word(&r->scan, &word); n++) {
        if (n == MAX_WIDTH) break;
        if (!scan_f64(&word, &row[n]))
            return cloud_build_bad(&r->build, what, obj_here(r), "'%s' is not a number", scan_quote(&word, quote));
    }
    if (n < least || word.n)
        return cloud_build_bad(&r->build, what, (struct cloud_place){line, 0}, "%s%zu numbers, but it takes %zu to %d",
                               word.n ? "more than " : "", n, least, MAX_WIDTH);
    obj_set_width(table, n);
    return obj_add_row(r, table, row);
}

static enum status obj_take_vertex(struct reader *r) {
    if (r->vertex.count == r->build.max_points)
        return error_set_at(r->build.error, STATUS_LIMIT, "points", r->scan.line, UINT64_MAX,
                            "more than the %" PRIu64 " points that are allowed", r->build.max_points);
    if (r->vertex.count == r->line_capacity) {
        size_t capacity = r->line_capacity + r->line_capacity / 2 + FIRST_ROWS;
        uint64_t *grown = alloc_resize(r->vertex_line, capacity, sizeof *grown);
        if (!grown) return obj_no_memory(r);
        r->vertex_line = grown;
        r->line_capacity = capacity;
    }
    r->vertex_line[r->vertex.count] = r->scan.line;
    return take_row(r, &r->vertex, 3, "v");
}

static enum status take_normal(struct reader *r) { return take_row(r, &r->attribute[NORMALS].table, 3, "vn"); }
static enum status take_texture(struct reader *r) { return take_row(r, &r->attribute[TEXTURE].table, 1, "vt"); }

/* ------------------------------------------------------------------------------------------------ faces */

/* The index from 0 that a number of the file means, where `count` rows came so far.  A vertex may come later. */
static bool resolve(int64_t number, size_t count, uint64_t *index) {
    if (number > 0) *index = (uint64_t)number - 1;
    if (number < 0 && (uint64_t)-number <= count) *index = count - (uint64_t)-number;
    return number > 0 || (number < 0 && (uint64_t)-number <= count);
}

static bool same_row(const struct table *table, uint32_t a, uint32_t b) {
    return a == b || memcmp(obj_row(table, a), obj_row(table, b), table->width * sizeof *table->value) == 0;
}

/* The number that a corner at a copy has until it is known how many vertices there are. */
static uint32_t corner_of_copy(size_t i) { return UINT32_MAX - 1 - (uint32_t)i; }

/* The corner has texture coordinates other than those that its vertex came with: it becomes one of a copy. */
static enum status copy_vertex(struct reader *r, uint32_t row, uint32_t *vertex) {
    struct attribute *a = &r->attribute[TEXTURE];
    uint32_t *last = &a->copy_of[*vertex];
    for (int i = 0; *last != NONE; last = &r->copy[*last].next) {
        if (same_row(&a->table, r->copy[*last].row, row)) {
            *vertex = corner_of_copy(*last);
            return STATUS_OK;
        }
        if (++i == COPIES_MOST) r->too_many = true;
    }
    if (r->copies > r->vertex.count / COPIES_SHARE) r->too_many = true;
    if (r->too_many) return STATUS_OK;
    uint32_t index = (uint32_t)r->copies;
    *last = index; /* before the copies are moved */
    if (r->copies == r->copy_capacity) {
        size_t capacity = r->copies + r->copies / 2 + FIRST_ROWS;
        struct copy *grown = alloc_resize(r->copy, capacity, sizeof *grown);
        if (!grown) return obj_no_memory(r);
        r->copy = grown;
        r->copy_capacity = capacity;
    }
    r->copy[r->copies++] = (struct copy){*vertex, row, NONE};
    *vertex = corner_of_copy(index);
    return STATUS_OK;
}

/* A corner at this vertex has row `row` of the attribute. */
static enum status refer(struct reader *r, struct attribute *a, uint32_t vertex, uint32_t row) {
    if (vertex >= a->capacity) {
        size_t capacity = vertex + (size_t)vertex / 2 + FIRST_ROWS;
        uint32_t *grown = alloc_resize(a->of_vertex, capacity, sizeof *grown);
        if (!grown) return obj_no_memory(r);
        memset(grown + a->capacity, 0xff, (capacity - a->capacity) * sizeof *grown);
        a->of_vertex = grown;
        uint32_t *copies = alloc_resize(a->copy_of, capacity, sizeof *copies);
        if (!copies) return obj_no_memory(r);
        memset(copies + a->capacity, 0xff, (capacity - a->capacity) * sizeof *copies);
        a->copy_of = copies;
        a->capacity = capacity;
    }
    a->used = true;
    if (a->of_vertex[vertex] == NONE) a->of_vertex[vertex] = row;
    if (!same_row(&a->table, a->of_vertex[vertex], row)) a->differs = true;
    return STATUS_OK;
}

static enum status bad_corner(struct reader *r, const struct scan_word *word, const char *what) {
    char quote[NUMBER_QUOTE_BYTES];
    return cloud_build_bad(&r->build, "f", obj_here(r), "corner '%s' %s", scan_quote(word, quote), what);
}

/* Splits "1/2/3" at its slashes; false where there are more than two. */
static bool obj_split(const struct scan_word *word, struct scan_word part[3], size_t *parts) {
    *parts = 0;
    const char *at = word->text, *end = at + word->n;
    for (;;) {
        if (*parts == 3) return false;
        const char *slash = memchr(at, '/', (size_t)(end - at));
        part[(*parts)++] = (struct scan_word){at, (size_t)((slash ? slash : end) - at)};
        if (!slash) return true;
        at = slash + 1;
    }
}

static enum status take_corner(struct reader *r, const struct scan_word *word, uint32_t *vertex) {
    static const int attribute_of_part[3] = {0, TEXTURE, NORMALS};
    struct scan_word part[3];
    size_t parts;
    int64_t number;
    uint64_t index;
    if (!obj_split(word, part, &parts) || !scan_i64(&part[0], &number)) return bad_corner(r, word, "is no vertex");
    if (!resolve(number, r->vertex.count, &index) || index >= NONE) return bad_corner(r, word, "is out of range");
    if (index >= r->largest) r->largest = index + 1, r->largest_line = r->scan.line;
    uint32_t of = *vertex = (uint32_t)index;
    if (index >= r->vertex.count) return STATUS_OK; /* defined later, if at all */
    for (size_t k = 1; k < parts; k++) {
        struct attribute *a = &r->attribute[attribute_of_part[k]];
        if (part[k].n == 0) continue;
        if (!scan_i64(&part[k], &number)) return bad_corner(r, word, "has no whole numbers");
        if (!resolve(number, a->table.count, &index) || index >= a->table.count || index >= NONE)
            return bad_corner(r, word, k == 1 ? "has a texture index out of range" : "has a normal out of range");
        enum status status = refer(r, a, of, (uint32_t)index);
        if (!status && k == 1 && !same_row(&a->table, a->of_vertex[of], (uint32_t)index))
            status = copy_vertex(r, (uint32_t)index, vertex);
        if (status) return status;
    }
    return STATUS_OK;
}

static enum status obj_take_face(struct reader *r) {
    struct scan_word word;
    uint32_t first = 0, last = 0, next = 0;
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && scan_word(&r->scan, &word); i++, last = next) {
        status = take_corner(r, &word, &next);
        if (i == 0) first = next;
        if (!status && i >= 2) status = cloud_build_triangle(&r->build, first, last, next);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ lines */

static enum status pass_over(struct reader *r) {
    (void)r;
    return STATUS_OK;
}

static enum status note_materials(struct reader *r) { return cloud_build_leave_out(&r->build, "materials"); }
static enum status note_curves(struct reader *r) {
    return cloud_build_leave_out(&r->build, "lines, curves and free-form surfaces");
}
static enum status note_groups(struct reader *r) { return cloud_build_leave_out(&r->build, "groups and objects"); }

static const struct {
    const char *word;
    enum status (*take)(struct reader *r);
} keywords[] = {
    {"v", obj_take_vertex},     {"f", obj_take_face},       {"vn", take_normal},        {"vt", take_texture},
    {"fo", obj_take_face},      {"g", note_groups},         {"o", note_groups},         {"s", pass_over},
    {"mg", pass_over},          {"usemtl", note_materials}, {"mtllib", note_materials}, {"usemap", note_materials},
    {"maplib", note_materials}, {"p", pass_over},           {"l", note_curves},         {"vp", note_curves},
    {"deg", note_curves},       {"bmat", note_curves},      {"step", note_curves},      {"cstype", note_curves},
    {"curv", note_curves},      {"curv2", note_curves},     {"surf", note_curves},      {"parm", note_curves},
    {"trim", note_curves},      {"hole", note_curves},      {"scrv", note_curves},      {"sp", note_curves},
    {"end", note_curves},       {"con", note_curves},       {"bevel", pass_over},       {"c_interp", pass_over},
    {"d_interp", pass_over},    {"lod", pass_over},         {"shadow_obj", pass_over},  {"trace_obj", pass_over},
    {"ctech", pass_over},       {"stech", pass_over},
};

/* Programs have words of their own, which others pass over.  Numbers without a word are no such line. */
static enum status note_unknown(struct reader *r, const char *quote) {
    char note[96 + NUMBER_QUOTE_BYTES];
    if (r->has_unknown) return STATUS_OK;
    r->has_unknown = true;
    snprintf(note, sizeof note, "lines that begin with no word of OBJ, the first of them '%s' in line %" PRIu64, quote,
             (uint64_t)r->scan.line);
    return cloud_build_leave_out(&r->build, note);
}

static enum status obj_take_line(struct reader *r, const struct scan_word *word) {
    char quote[NUMBER_QUOTE_BYTES];
    for (size_t i = 0; i < sizeof keywords / sizeof *keywords; i++)
        if (scan_is(word, keywords[i].word)) return keywords[i].take(r);
    if (isalpha((unsigned char)word->text[0])) return note_unknown(r, scan_quote(word, quote));
    return cloud_build_bad(&r->build, "read", obj_here(r), "'%s' begins no line of OBJ", scan_quote(word, quote));
}

static enum status take_lines(struct reader *r) {
    struct scan_word word;
    enum status status = STATUS_OK;
    while (!status && scan_token(&r->scan, &word)) {
        status = obj_take_line(r, &word);
        scan_next_line(&r->scan);
    }
    if (!status && r->largest > r->vertex.count)
        status = cloud_build_bad(&r->build, "f", (struct cloud_place){r->largest_line, 0},
                                 "vertex %" PRIu64 ", but there are %zu", r->largest, r->vertex.count);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the cloud */

static bool copies_are_few(const struct reader *r) {
    return r->copies && !r->too_many && r->copies <= r->vertex.count / COPIES_SHARE &&
           r->vertex.count + r->copies <= r->build.max_points;
}

/* Whether each vertex, or each copy of it, has exactly one row. */
static bool is_of_vertices(const struct reader *r, const struct attribute *a) {
    if (!a->used) return r->build.cloud.triangle_count == 0 && a->table.count == r->vertex.count;
    bool copied = a == &r->attribute[TEXTURE] && copies_are_few(r);
    if ((a->differs && !copied) || a->capacity < r->vertex.count) return false;
    for (size_t i = 0; i < r->vertex.count; i++)
        if (a->of_vertex[i] == NONE) return false;
    return true;
}

static enum status obj_add_properties(struct reader *r, const char *const *names, size_t n) {
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < n; i++) status = cloud_build_property(&r->build, names[i], SCALAR_FLOAT64);
    return status;
}

static enum status note_uneven(struct reader *r, const struct table *table, const char *word) {
    char note[96];
    if (!table->uneven) return STATUS_OK;
    snprintf(note, sizeof note, "numbers in lines '%s' that not all of these lines have", word);
    return cloud_build_leave_out(&r->build, note);
}

/* Decides on the attributes; keeps[k] tells which become properties. */
static enum status obj_describe(struct reader *r, bool keeps[ATTRIBUTES]) {
    static const char *const plain[] = {"x", "y", "z", "w", "", "", "", ""};
    static const char *const coloured[] = {"x", "y", "z", "red", "green", "blue", "alpha", ""};
    static const char *const normal[] = {"nx", "ny", "nz", "", "", "", "", ""};
    static const char *const texture[] = {"s", "t", "", "", "", "", "", ""};
    static const char *const *const names[] = {[NORMALS] = normal, [TEXTURE] = texture};
    static const char *const words[] = {[NORMALS] = "vn", [TEXTURE] = "vt"};
    static const char *const notes[] = {[NORMALS] =
                                            "normals: they differ between the faces at a vertex, or some have none",
                                        [TEXTURE] = "texture coordinates: they differ between the faces at a vertex, "
                                                    "or some have none"};
    enum status status = obj_add_properties(r, r->vertex.width >= COLOURED ? coloured : plain, r->vertex.width);
    if (!status) status = note_uneven(r, &r->vertex, "v");
    for (int k = 0; !status && k < ATTRIBUTES; k++) {
        const struct attribute *a = &r->attribute[k];
        keeps[k] = a->table.count && is_of_vertices(r, a);
        if (keeps[k]) status = obj_add_properties(r, names[k], a->table.width);
        if (!status && keeps[k]) status = note_uneven(r, &a->table, words[k]);
        if (!status && a->table.count && !keeps[k]) status = cloud_build_leave_out(&r->build, notes[k]);
    }
    return status;
}

/* Corners of copies get the copies' numbers behind all vertices, or where there are none those of the vertices. */
static enum status number_copies(struct reader *r, bool kept) {
    uint32_t *id = alloc_array(r->copies, sizeof *id);
    if (!id) return obj_no_memory(r);
    for (size_t i = 0; i < r->copies; i++) id[i] = kept ? (uint32_t)(r->vertex.count + i) : r->copy[i].vertex;
    cloud_build_renumber(&r->build, id, r->copies);
    free(id);
    return STATUS_OK;
}

/* The point of vertex i, or of this copy of it (NULL: itself). */
static enum status make_point(struct reader *r, const bool keeps[ATTRIBUTES], size_t i, const struct copy *copy) {
    double record[(ATTRIBUTES + 1) * MAX_WIDTH];
    size_t used = r->vertex.width;
    memcpy(record, obj_row(&r->vertex, i), used * sizeof *record);
    for (int k = 0; k < ATTRIBUTES; k++) {
        const struct attribute *a = &r->attribute[k];
        if (!keeps[k]) continue;
        size_t row = copy && k == TEXTURE ? copy->row : a->used ? a->of_vertex[i] : i;
        memcpy(record + used, obj_row(&a->table, row), a->table.width * sizeof *record);
        used += a->table.width;
    }
    return cloud_build_point(&r->build, record, (struct cloud_place){r->vertex_line[i], r->build.bytes});
}

static enum status make_points(struct reader *r) {
    bool keeps[ATTRIBUTES] = {0};
    if (!r->vertex.count) return STATUS_OK;
    enum status status = obj_describe(r, keeps);
    bool copied = keeps[TEXTURE] && r->copies;
    if (!status && r->copies) status = number_copies(r, copied);
    if (!status) status = cloud_build_room(&r->build, r->vertex.count + (copied ? r->copies : 0));
    for (size_t i = 0; !status && i < r->vertex.count; i++) status = make_point(r, keeps, i, NULL);
    for (size_t i = 0; !status && copied && i < r->copies; i++)
        status = make_point(r, keeps, r->copy[i].vertex, &r->copy[i]);
    return status;
}

/* "v 1", "vn 0", "f 1", "mtllib x", "o name", ... */
static bool is_line(const struct scan_word *word, struct scan *rest) {
    static const char *const before_numbers[] = {"v", "vn", "vt", NULL};
    static const char *const before_names[] = {"mtllib", "usemtl", "o", "g", "f", "s", NULL};
    struct scan_word next;
    double number;
    if (!scan_word(rest, &next)) return scan_is(word, "g") || scan_is(word, "o");
    for (size_t i = 0; before_numbers[i]; i++)
        if (scan_is(word, before_numbers[i])) return scan_f64(&next, &number);
    if (scan_is(word, "s") && !scan_is(&next, "off")) return scan_f64(&next, &number);
    for (size_t i = 0; before_names[i]; i++)
        if (scan_is(word, before_names[i])) return true;
    return false;
}

const char *cloud_obj_look(const struct first_bytes *first) {
    struct scan_word word;
    struct scan rest;
    return first->is_text && first_word(first, &word, &rest) && is_line(&word, &rest) ? "obj" : "";
}

enum status cloud_obj_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct reader r = {.scan = scan_start(bytes, n)};
    r.scan.comment = '#';
    r.scan.joins = true;
    cloud_build_start(&r.build, "obj", n, limits, progress, error);
    enum status status = take_lines(&r);
    if (!status) status = make_points(&r);
    free(r.vertex.value), free(r.vertex_line), free(r.copy);
    for (int k = 0; k < ATTRIBUTES; k++) {
        free(r.attribute[k].table.value), free(r.attribute[k].of_vertex);
        free(r.attribute[k].copy_of);
    }
    return cloud_build_end(&r.build, status, cloud);
}
