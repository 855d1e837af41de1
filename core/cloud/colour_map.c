/* Red begins where one point in twenty is: a few extreme values, at a crease or a stray point, would leave all others
 * green if the largest one were the end of the scale.  What the numbers are is in the property beside the colour.
 *
 * Lee, Jong: Point-based Simplification Algorithm, figure 4.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/colour_map.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"

enum { PROPERTIES = 7 };           /* x y z value red green blue */
static const double RED_AT = 0.95; /* of the points are below the value that is painted red */

/* The value painted red; never 0. */
static enum status find_red(const float *value, size_t n, double *red) {
    float *some = alloc_array(n, sizeof *some);
    if (!some) return STATUS_NO_MEMORY;
    memcpy(some, value, n * sizeof *some);
    *red = n ? (double)quantile_of(some, n, RED_AT) : 0;
    if (!(*red > 0)) *red = n ? (double)quantile_of(some, n, 1) : 0;
    if (!(*red > 0)) *red = 1;
    free(some);
    return STATUS_OK;
}

/* Green at 0, yellow at a half, red at 1 and over. */
static void colour_of(double t, unsigned char rgb[3]) {
    t = fmin(fmax(t, 0), 1);
    rgb[0] = (unsigned char)(255 * fmin(1, 2 * t) + 0.5);
    rgb[1] = (unsigned char)(255 * fmin(1, 2 - 2 * t) + 0.5);
    rgb[2] = 0;
}

static void lay_out_map(const struct cloud *cloud, const char *name, struct cloud *out) {
    static const char *const names[PROPERTIES] = {"x", "y", "z", "", "red", "green", "blue"};
    for (uint32_t i = 0; i < PROPERTIES; i++) {
        struct property *p = &out->property[i];
        *p = (struct property){.type = i == 3 ? SCALAR_FLOAT32 : SCALAR_UINT8, .offset_bytes = out->record_bytes};
        if (i < 3) p->type = cloud->property[cloud->xyz[i]].type, out->xyz[i] = i;
        snprintf(p->name, sizeof p->name, "%s", i == 3 ? name : names[i]);
        out->record_bytes += scalar_bytes(p->type);
    }
}

static void paint_point(const struct cloud *cloud, size_t i, float value, double red, struct cloud *out) {
    unsigned char *to = &out->record[i * out->record_bytes];
    const unsigned char *from = &cloud->record[i * cloud->record_bytes];
    for (int axis = 0; axis < 3; axis++) {
        const struct property *p = &cloud->property[cloud->xyz[axis]];
        memcpy(to + out->property[axis].offset_bytes, from + p->offset_bytes, scalar_bytes(p->type));
    }
    scalar_store(to + out->property[3].offset_bytes, SCALAR_FLOAT32, (double)value);
    colour_of((double)value / red, to + out->property[4].offset_bytes);
}

enum status paint_cloud(const struct cloud *cloud, const char *name, const float *value, struct cloud *out) {
    struct cloud made = {.count = cloud->count, .property_count = PROPERTIES, .form = cloud->form};
    double red = 1;
    enum status status = find_red(value, cloud->count, &red);
    made.property = alloc_array(PROPERTIES, sizeof *made.property);
    if (!status && made.property) lay_out_map(cloud, name, &made);
    made.record = alloc_array(cloud->count, made.record_bytes);
    made.position = alloc_array(cloud->count, sizeof *made.position);
    if (status || !made.property || !made.record || !made.position) {
        cloud_done(&made);
        return STATUS_NO_MEMORY;
    }
    memcpy(made.position, cloud->position, cloud->count * sizeof *made.position);
    for (size_t i = 0; i < cloud->count; i++) paint_point(cloud, i, value[i], red, &made);
    *out = made;
    return STATUS_OK;
}
