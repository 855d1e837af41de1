/* Writing PCD.
 *
 * What a point is made of is decided once, as a list of fields; a field is a property of the cloud, or the colour,
 * which is packed of three or four.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud_pcd_write.h"

#include <assert.h>
#include <stdbool.h>
#include <string.h>

#include "core/cloud_write.h"
#include "core/scan.h"

struct field {
    const char *name;
    const struct property *from; /* NULL: the colour */
};

struct layout {
    const struct property *colour[4]; /* red, green, blue, alpha; colour[0] NULL: isn't packed */
    size_t count;
    struct field field[CLOUD_MAX_PROPERTIES];
};

static const char *const colour_names[4] = {"red", "green", "blue", "alpha"};

static const struct property *find(const struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return &cloud->property[j];
    return NULL;
}

static const struct property *find_byte(const struct cloud *cloud, const char *name) {
    const struct property *found = find(cloud, name);
    return found && !found->is_list && found->type == SCALAR_UINT8 ? found : NULL;
}

static void find_colour(const struct cloud *cloud, struct layout *layout) {
    const struct property *colour[4];
    for (int k = 0; k < 4; k++) colour[k] = find_byte(cloud, colour_names[k]);
    if (colour[0] && colour[1] && colour[2] && !find(cloud, "rgb") && !find(cloud, "rgba"))
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
        if (strcmp(pairs[i][0], name) == 0 && !find(cloud, pairs[i][1])) return pairs[i][1];
    return name;
}

static void lay_out(const struct cloud *cloud, struct layout *layout, struct losses *losses) {
    bool colour_is_in = false;
    find_colour(cloud, layout);
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *property = &cloud->property[j];
        if (property->is_list) {
            losses_add(losses, "cloud.pcd", "%s: PCD has no lists of varying length", property->name);
        } else if (!is_packed(layout, property)) {
            layout->field[layout->count++] = (struct field){pcd_name(cloud, property->name), property};
        } else if (!colour_is_in) {
            layout->field[layout->count++] = (struct field){layout->colour[3] ? "rgba" : "rgb", NULL};
            colour_is_in = true;
        }
    }
}

/* ------------------------------------------------------------------------------------------------ header */

static bool is_viewpoint(const char *text, size_t n) {
    struct scan scan = scan_start(text, n);
    struct scan_word word;
    double value;
    size_t numbers = 0;
    while (scan_word(&scan, &word))
        if (!scan_f64(&word, &value) || ++numbers > 7) return false;
    return numbers == 7;
}

/* "comment viewpoint 0 0 0 1 0 0 0" becomes the viewpoint, other lines become comments. */
static void put_comments(struct sink *sink, const char *comments, const char **viewpoint, size_t *viewpoint_bytes) {
    static const char mark[] = "comment viewpoint ", plain[] = "comment ";
    for (const char *at = comments; at && *at;) {
        size_t n = strcspn(at, "\n");
        size_t skip = strncmp(at, plain, sizeof plain - 1) == 0 ? sizeof plain - 1 : 0;
        if (strncmp(at, mark, sizeof mark - 1) == 0 && is_viewpoint(at + sizeof mark - 1, n - (sizeof mark - 1))) {
            *viewpoint = at + sizeof mark - 1;
            *viewpoint_bytes = n - (sizeof mark - 1);
        } else {
            sink_text(sink, "# ");
            sink_bytes(sink, at + skip, n - skip);
            sink_text(sink, "\n");
        }
        at += n + (at[n] == '\n');
    }
}

static char kind_of(const struct field *field) {
    if (!field->from) return 'U';
    if (field->from->type >= SCALAR_FLOAT32) return 'F';
    return field->from->type % 2 ? 'U' : 'I';
}

static void put_header(struct sink *sink, const struct cloud *cloud, const struct layout *layout, size_t n) {
    const char *viewpoint = "0 0 0 1 0 0 0";
    size_t viewpoint_bytes = strlen(viewpoint);
    sink_text(sink, "# .PCD v0.7 - Point Cloud Data file format\n");
    put_comments(sink, cloud->comments, &viewpoint, &viewpoint_bytes);
    sink_text(sink, "VERSION 0.7\nFIELDS");
    for (size_t j = 0; j < layout->count; j++) sink_format(sink, " %s", layout->field[j].name);
    sink_text(sink, "\nSIZE");
    for (size_t j = 0; j < layout->count; j++)
        sink_format(sink, " %zu", layout->field[j].from ? scalar_bytes(layout->field[j].from->type) : 4);
    sink_text(sink, "\nTYPE");
    for (size_t j = 0; j < layout->count; j++) sink_format(sink, " %c", kind_of(&layout->field[j]));
    sink_text(sink, "\nCOUNT");
    for (size_t j = 0; j < layout->count; j++) sink_text(sink, " 1");
    sink_format(sink, "\nWIDTH %zu\nHEIGHT 1\nVIEWPOINT ", n);
    sink_bytes(sink, viewpoint, viewpoint_bytes);
    sink_format(sink, "\nPOINTS %zu\nDATA binary\n", n);
}

/* ------------------------------------------------------------------------------------------------ points */

static void put_colour(struct sink *sink, const struct layout *layout, const unsigned char *record) {
    uint32_t packed = 0;
    for (int k = 0; k < 3; k++) packed |= (uint32_t)record[layout->colour[k]->offset_bytes] << (16 - 8 * k);
    if (layout->colour[3]) packed |= (uint32_t)record[layout->colour[3]->offset_bytes] << 24;
    cloud_write_scalar(sink, &packed, SCALAR_UINT32, ENCODING_BINARY);
}

static void put_point(struct sink *sink, const struct layout *layout, const unsigned char *record) {
    for (size_t j = 0; j < layout->count; j++) {
        const struct property *from = layout->field[j].from;
        if (from)
            cloud_write_scalar(sink, record + from->offset_bytes, from->type, ENCODING_BINARY);
        else
            put_colour(sink, layout, record);
    }
}

enum status cloud_write_pcd(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n, struct losses *losses,
                            struct error *error) {
    struct sink sink;
    struct layout layout = {0};
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    lay_out(cloud, &layout, losses);
    put_header(&sink, cloud, &layout, n);
    for (size_t i = 0; i < n && !sink.failure; i++) {
        size_t id = ids ? ids[i] : i;
        assert(id < cloud->count);
        put_point(&sink, &layout, cloud->record + id * cloud->record_bytes);
    }
    return sink_done(&sink, STATUS_OK, error);
}
