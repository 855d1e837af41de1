/* Writing PCD.
 *
 * What a point is made of is decided once, as a list of fields; a field is a property of the cloud, or the colour,
 * which is packed of three or four.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/pcd_write.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "core/io/formats/pcd_header.h"
#include "core/io/out/write.h"
#include "core/io/text_scanner.h"

struct field {
    const char *name;
    const struct property *from; /* NULL: the colour */
    enum scalar_type type;       /* in the file */
    double origin;               /* is taken off before; 0 but for coordinates */
};

struct layout {
    const struct property *colour[4]; /* red, green, blue, alpha; colour[0] NULL: isn't packed */
    size_t count;
    struct field field[CLOUD_MAX_PROPERTIES];
    double origin[3];
};

static const char *const colour_names[4] = {"red", "green", "blue", "alpha"};

static const struct property *pcd_find(const struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return &cloud->property[j];
    return NULL;
}

static const struct property *find_byte(const struct cloud *cloud, const char *name) {
    const struct property *found = pcd_find(cloud, name);
    return found && !found->is_list && found->type == SCALAR_UINT8 ? found : NULL;
}

static void find_colour(const struct cloud *cloud, struct layout *layout) {
    const struct property *colour[4];
    for (int k = 0; k < 4; k++) colour[k] = find_byte(cloud, colour_names[k]);
    if (colour[0] && colour[1] && colour[2] && !pcd_find(cloud, "rgb") && !pcd_find(cloud, "rgba"))
        memcpy(layout->colour, colour, sizeof colour);
}

static bool is_packed(const struct layout *layout, const struct property *property) {
    for (int k = 0; k < 4 && layout->colour[0]; k++)
        if (layout->colour[k] == property) return true;
    return false;
}

static const char *pcd_name(const struct cloud *cloud, const char *name) {
    static const char *const pairs[][2] = {{"nx", "normal_x"}, {"ny", "normal_y"}, {"nz", "normal_z"}};
    for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++)
        if (strcmp(pairs[i][0], name) == 0 && !pcd_find(cloud, pairs[i][1])) return pairs[i][1];
    return name;
}

static void lay_out(const struct cloud *cloud, struct layout *layout, struct left_out *left_out) {
    bool colour_is_in = false;
    find_colour(cloud, layout);
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *property = &cloud->property[j];
        if (property->is_list) {
            left_out_add(left_out, "cloud.pcd", "%s: PCD has no lists of varying length", property->name);
        } else if (!is_packed(layout, property)) {
            layout->field[layout->count++] =
                (struct field){pcd_name(cloud, property->name), property, property->type, 0};
        } else if (!colour_is_in) {
            layout->field[layout->count++] = (struct field){layout->colour[3] ? "rgba" : "rgb", NULL, SCALAR_UINT32, 0};
            colour_is_in = true;
        }
    }
}

/* ------------------------------------------------------------------------------------------------ precision */

/* The points that are written. */
struct points {
    const struct cloud *cloud;
    const uint32_t *ids; /* NULL = all in order */
    size_t n;
};

static const unsigned char *record_of(const struct points *points, size_t i) {
    size_t id = points->ids ? points->ids[i] : i;
    assert(id < points->cloud->count);
    return points->cloud->record + id * points->cloud->record_bytes;
}

static double pcd_value_of(const struct points *points, const struct field *field, size_t i) {
    return scalar_load(record_of(points, i) + field->from->offset_bytes, field->from->type);
}

static double rounded(double value, double origin) { return (double)(float)(value - origin) + origin; }

/* How far float32 around the field's origin is off, at most. */
static double rounding_error(const struct points *points, const struct field *field) {
    double worst = 0;
    for (size_t i = 0; i < points->n; i++) {
        double value = pcd_value_of(points, field, i);
        if (isfinite(value)) worst = fmax(worst, fabs(rounded(value, field->origin) - value));
    }
    return worst;
}

/* The middle of each coordinate that lies far from 0 for the cloud's size, to the size's first digit, so that it is
 * short to write; 0 for the others. */
static void pcd_choose_origin(const struct cloud *cloud, double origin[3]) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, size = 0;
    for (size_t i = 0; i < cloud->count; i++)
        for (int axis = 0; axis < 3; axis++) {
            low[axis] = fmin(low[axis], (&cloud->position[i].x)[axis]);
            high[axis] = fmax(high[axis], (&cloud->position[i].x)[axis]);
        }
    for (int axis = 0; axis < 3; axis++) size = fmax(size, high[axis] - low[axis]);
    double step = size > 0 ? pow(10, floor(log10(size))) : 1;
    for (int axis = 0; axis < 3; axis++) {
        double middle = low[axis] / 2 + high[axis] / 2, rounded_middle = rint(middle / step) * step;
        origin[axis] = fabs(middle) > 2 * size && isfinite(rounded_middle) ? rounded_middle : 0;
    }
}

/* What the Point Cloud Library has as float32 besides coordinates. */
static bool is_float(const char *name) {
    static const char *const names[] = {"normal_x", "normal_y", "normal_z", "curvature", "intensity"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(names[i], name) == 0) return true;
    return false;
}

/* Whether uint32, which labels are in that library, holds each of the field's values. */
static bool are_labels(const struct points *points, const struct field *field) {
    for (size_t i = 0; i < points->n; i++) {
        double value = pcd_value_of(points, field, i);
        if (!(value >= 0 && value <= UINT32_MAX && value == floor(value))) return false;
    }
    return true;
}

static void narrow(const struct points *points, struct layout *layout, struct left_out *left_out) {
    double worst = 0, far[3];
    pcd_choose_origin(points->cloud, far);
    for (size_t j = 0; j < layout->count; j++) {
        struct field *field = &layout->field[j];
        int axis = field->from ? cloud_axis_of(points->cloud, (size_t)(field->from - points->cloud->property)) : -1;
        if (field->from && strcmp(field->name, "label") == 0 && are_labels(points, field)) field->type = SCALAR_UINT32;
        if (!field->from || field->type == SCALAR_FLOAT32 || (axis < 0 && !is_float(field->name))) continue;
        field->type = SCALAR_FLOAT32;
        double error = rounding_error(points, field);
        if (axis >= 0 && error > 0) {
            field->origin = layout->origin[axis] = far[axis];
            worst = fmax(worst, rounding_error(points, field));
        } else if (error > 0) {
            left_out_add(left_out, "cloud.pcd", "%s is float32, off by up to %.2g", field->name, error);
        }
    }
    const double *origin = layout->origin;
    if (worst > 0 || origin[0] != 0 || origin[1] != 0 || origin[2] != 0)
        left_out_add(
            left_out, "cloud.pcd",
            "precision: x, y, z are float32 around %.10g %.10g %.10g, off by up to %.2g (pcd_precision=double)",
            origin[0], origin[1], origin[2], worst);
}

/* ------------------------------------------------------------------------------------------------ header */

static bool read_viewpoint(const char *text, size_t n, double viewpoint[7]) {
    struct scan scan = scan_start(text, n);
    struct scan_word word;
    double value[7];
    size_t numbers = 0;
    while (scan_word(&scan, &word))
        if (numbers == 7 || !scan_f64(&word, &value[numbers++])) return false;
    if (numbers == 7) memcpy(viewpoint, value, sizeof value);
    return numbers == 7;
}

/* "comment viewpoint 0 0 0 1 0 0 0" becomes the viewpoint, other lines become comments. */
static void put_comments(struct sink *sink, const char *comments, double viewpoint[7]) {
    static const char mark[] = "comment viewpoint ", plain[] = "comment ";
    for (const char *at = comments; at && *at;) {
        size_t n = strcspn(at, "\n");
        size_t skip = strncmp(at, plain, sizeof plain - 1) == 0 ? sizeof plain - 1 : 0;
        bool marked = strncmp(at, mark, sizeof mark - 1) == 0;
        if (!marked || !read_viewpoint(at + sizeof mark - 1, n - (sizeof mark - 1), viewpoint)) {
            sink_text(sink, "# ");
            sink_bytes(sink, at + skip, n - skip);
            sink_text(sink, "\n");
        }
        at += n + (at[n] == '\n');
    }
}

/* The Point Cloud Library's packed rgb is called a float, its rgba an unsigned number.  What has other sizes may be
 * called so, too. */
static char kind_of(const struct field *field) {
    bool is_packed = scalar_bytes(field->type) == 4 && strcmp(field->name, "rgb") == 0;
    if (field->type >= SCALAR_FLOAT32 || is_packed) return 'F';
    return field->type % 2 ? 'U' : 'I';
}

/* The viewpoint lies in the frame of the points that are written. */
static void put_frame(struct sink *sink, const struct layout *layout, const double viewpoint[7]) {
    static const double none[7] = {0, 0, 0, 1, 0, 0, 0};
    bool given = memcmp(viewpoint, none, sizeof none) != 0;
    sink_text(sink, "\nVIEWPOINT");
    for (int i = 0; i < 7; i++) sink_format(sink, " %.17g", viewpoint[i] - (given && i < 3 ? layout->origin[i] : 0));
}

static void pcd_put_header(struct sink *sink, const struct cloud *cloud, const struct layout *layout, size_t n) {
    double viewpoint[7] = {0, 0, 0, 1, 0, 0, 0};
    const double *origin = layout->origin;
    sink_text(sink, "# .PCD v0.7 - Point Cloud Data file format\n");
    put_comments(sink, cloud->comments, viewpoint);
    if (origin[0] != 0 || origin[1] != 0 || origin[2] != 0)
        sink_format(sink, "# origin %.17g %.17g %.17g " PCD_ORIGIN_MARK "\n", origin[0], origin[1], origin[2]);
    sink_text(sink, "VERSION 0.7\nFIELDS");
    for (size_t j = 0; j < layout->count; j++) sink_format(sink, " %s", layout->field[j].name);
    sink_text(sink, "\nSIZE");
    for (size_t j = 0; j < layout->count; j++) sink_format(sink, " %zu", scalar_bytes(layout->field[j].type));
    sink_text(sink, "\nTYPE");
    for (size_t j = 0; j < layout->count; j++) sink_format(sink, " %c", kind_of(&layout->field[j]));
    sink_text(sink, "\nCOUNT");
    for (size_t j = 0; j < layout->count; j++) sink_text(sink, " 1");
    sink_format(sink, "\nWIDTH %zu\nHEIGHT 1", n);
    put_frame(sink, layout, viewpoint);
    sink_format(sink, "\nPOINTS %zu\nDATA binary\n", n);
}

/* ------------------------------------------------------------------------------------------------ points */

static void pcd_put_colour(struct sink *sink, const struct layout *layout, const unsigned char *record) {
    uint32_t packed = 0;
    for (int k = 0; k < 3; k++) packed |= (uint32_t)record[layout->colour[k]->offset_bytes] << (16 - 8 * k);
    if (layout->colour[3]) packed |= (uint32_t)record[layout->colour[3]->offset_bytes] << 24;
    cloud_write_scalar(sink, &packed, SCALAR_UINT32, ENCODING_BINARY);
}

static void pcd_put_point(struct sink *sink, const struct layout *layout, const unsigned char *record) {
    for (size_t j = 0; j < layout->count; j++) {
        const struct field *field = &layout->field[j];
        const unsigned char *at = field->from ? record + field->from->offset_bytes : NULL;
        unsigned char scalar[8];
        if (!field->from) {
            pcd_put_colour(sink, layout, record);
            continue;
        }
        if (field->type != field->from->type) {
            scalar_store(scalar, field->type, scalar_load(at, field->from->type) - field->origin);
            at = scalar;
        }
        cloud_write_scalar(sink, at, field->type, ENCODING_BINARY);
    }
}

enum status cloud_write_pcd(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n,
                            enum pcd_precision precision, struct left_out *left_out, struct error *error) {
    const struct points points = {cloud, ids, n};
    struct sink sink;
    struct layout layout = {0};
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    lay_out(cloud, &layout, left_out);
    if (precision == PCD_FLOAT) narrow(&points, &layout, left_out);
    pcd_put_header(&sink, cloud, &layout, n);
    for (size_t i = 0; i < n && !sink.failure; i++) pcd_put_point(&sink, &layout, record_of(&points, i));
    return sink_done(&sink, STATUS_OK, error);
}
