/* The numbers are looked at together, since one cloud has one kind of colours: their largest tells which white they go
 * up to.  Then the records are packed anew with the components in their new type.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/colour_depth.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"

enum { COMPONENTS = 4 };

struct colours {
    size_t count;                /* of components: 3, or 4 with alpha; 0 = there are no colours */
    size_t property[COMPONENTS]; /* of the cloud */
    double white;                /* 1, 255 or 65535 */
    bool is_whole;               /* all are whole numbers */
    bool is_fit;                 /* all lie in 0 .. 65535 */
};

static size_t find_colour(const struct cloud *cloud, const char *name) {
    const struct property *p = attribute_find(cloud, name);
    return p ? (size_t)(p - cloud->property) : cloud->property_count;
}

static struct colours find_colours(const struct cloud *cloud) {
    static const char *const names[COMPONENTS] = {"red", "green", "blue", "alpha"};
    struct colours c = {0};
    while (c.count < COMPONENTS && (c.property[c.count] = find_colour(cloud, names[c.count])) < cloud->property_count)
        c.count++;
    if (c.count < 3) c.count = 0;
    return c;
}

static void look_at_values(const struct cloud *cloud, struct colours *c) {
    double largest = 0;
    bool is_float = false;
    c->is_whole = c->is_fit = true;
    for (size_t k = 0; k < c->count; k++) {
        const struct property *p = &cloud->property[c->property[k]];
        is_float = is_float || p->type >= SCALAR_FLOAT32;
        for (size_t i = 0; i < cloud->count; i++) {
            double value = scalar_load(cloud->record + i * cloud->record_bytes + p->offset_bytes, p->type);
            if (!(value >= 0 && value <= UINT16_MAX)) c->is_fit = false;
            if (value != floor(value)) c->is_whole = false;
            largest = fmax(largest, value);
        }
    }
    c->white = is_float && largest <= 1 ? 1 : largest <= UINT8_MAX ? UINT8_MAX : UINT16_MAX;
}

static double convert(double value, double white, double to) {
    if (white == UINT16_MAX && to == UINT8_MAX) return floor(value / 256);
    return rint(value * (to / white));
}

static bool is_colour(const struct colours *c, size_t j) {
    for (size_t k = 0; k < c->count; k++)
        if (c->property[k] == j) return true;
    return false;
}

/* Packs the record at `from` as `to`: the properties' new types and offsets are in `cloud`, the old ones in `old`. */
static void pack(const struct cloud *cloud, const struct property *old, const struct colours *c, double white,
                 const unsigned char *from, unsigned char *to) {
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *p = &cloud->property[j];
        if (p->is_list) continue;
        if (is_colour(c, j))
            scalar_store(to + p->offset_bytes, p->type,
                         convert(scalar_load(from + old[j].offset_bytes, old[j].type), c->white, white));
        else
            memcpy(to + p->offset_bytes, from + old[j].offset_bytes, scalar_bytes(p->type));
    }
}

static size_t lay_out_depths(struct cloud *cloud, const struct colours *c, enum scalar_type type) {
    size_t bytes = 0;
    for (size_t j = 0; j < cloud->property_count; j++) {
        struct property *p = &cloud->property[j];
        if (p->is_list) continue;
        if (is_colour(c, j)) p->type = type;
        p->offset_bytes = bytes;
        bytes += scalar_bytes(p->type);
    }
    return bytes;
}

static enum status repack(struct cloud *cloud, const struct colours *c, enum scalar_type type) {
    size_t old_bytes = cloud->record_bytes, most = cloud->property_count * 8;
    double white = type == SCALAR_UINT8 ? UINT8_MAX : UINT16_MAX;
    struct property *old = alloc_array(cloud->property_count, sizeof *old);
    unsigned char *record = alloc_array(2, most), *grown = NULL;
    enum status status = old && record ? STATUS_OK : STATUS_NO_MEMORY;
    if (status) goto out;
    size_t wider = old_bytes + 2 * COMPONENTS; /* at most */
    memcpy(old, cloud->property, cloud->property_count * sizeof *old);
    if (type == SCALAR_UINT16 && !(grown = alloc_resize(cloud->record, cloud->count, wider))) {
        status = STATUS_NO_MEMORY;
        goto out;
    }
    if (grown) cloud->record = grown;
    size_t bytes = cloud->record_bytes = lay_out_depths(cloud, c, type);
    for (size_t k = 0; k < cloud->count; k++) {
        size_t i = bytes > old_bytes ? cloud->count - 1 - k : k;
        memcpy(record, cloud->record + i * old_bytes, old_bytes);
        pack(cloud, old, c, white, record, record + most);
        memcpy(cloud->record + i * bytes, record + most, bytes);
    }
out:
    free(old);
    free(record);
    return status;
}

static void note(const struct colours *c, enum colour_bits bits, struct left_out *left_out) {
    int to = bits == COLOURS_8 ? 8 : 16;
    if (!c->is_fit)
        left_out_add(left_out, "outputs",
                     "colours: numbers below 0 or over 65535 are among them; they are as in the input");
    else if (c->white == 1)
        left_out_add(left_out, "outputs", "colours: 0 to 1 became %d bits", to);
    else if (c->white == UINT16_MAX && to == 8)
        left_out_add(left_out, "outputs", "colours: 16 bits became 8, divided by 256 (colours=keep keeps them)");
    else if (c->white == UINT8_MAX && to == 16)
        left_out_add(left_out, "outputs", "colours: 8 bits became 16, times 257");
    else if (!c->is_whole)
        left_out_add(left_out, "outputs", "colours: rounded to whole numbers");
}

enum status cloud_set_colours(struct cloud *cloud, enum colour_bits bits, struct left_out *left_out,
                              struct error *error) {
    struct colours c = find_colours(cloud);
    enum scalar_type type = bits == COLOURS_8 ? SCALAR_UINT8 : SCALAR_UINT16;
    bool is_so = true;
    for (size_t k = 0; k < c.count; k++) is_so = is_so && cloud->property[c.property[k]].type == type;
    if (bits == COLOURS_KEEP || is_so) return STATUS_OK;
    look_at_values(cloud, &c);
    note(&c, bits, left_out);
    if (c.is_fit && repack(cloud, &c, type))
        return error_set(error, STATUS_NO_MEMORY, "write", "no memory for colours");
    return STATUS_OK;
}
