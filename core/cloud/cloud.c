/* Ownership of clouds, and scalars of any type.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/cloud.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

size_t scalar_bytes(enum scalar_type type) {
    static const size_t bytes[SCALAR_TYPE_COUNT] = {1, 1, 2, 2, 4, 4, 4, 8};
    return bytes[type];
}

/* Any of the types. */
union scalar {
    int8_t i8;
    uint8_t u8;
    int16_t i16;
    uint16_t u16;
    int32_t i32;
    uint32_t u32;
    float f32;
    double f64;
};

double scalar_load(const void *p, enum scalar_type type) {
    union scalar v;
    memcpy(&v, p, scalar_bytes(type));
    switch (type) {
    case SCALAR_INT8: return v.i8;
    case SCALAR_UINT8: return v.u8;
    case SCALAR_INT16: return v.i16;
    case SCALAR_UINT16: return v.u16;
    case SCALAR_INT32: return v.i32;
    case SCALAR_UINT32: return v.u32;
    case SCALAR_FLOAT32: return (double)v.f32;
    case SCALAR_FLOAT64: return v.f64;
    }
    return 0;
}

static double saturate(double value, double low, double high) {
    if (!(value > low)) return low; /* NaN too */
    return value < high ? nearbyint(value) : high;
}

void scalar_store(void *p, enum scalar_type type, double value) {
    union scalar v;
    switch (type) {
    case SCALAR_INT8: v.i8 = (int8_t)saturate(value, INT8_MIN, INT8_MAX); break;
    case SCALAR_UINT8: v.u8 = (uint8_t)saturate(value, 0, UINT8_MAX); break;
    case SCALAR_INT16: v.i16 = (int16_t)saturate(value, INT16_MIN, INT16_MAX); break;
    case SCALAR_UINT16: v.u16 = (uint16_t)saturate(value, 0, UINT16_MAX); break;
    case SCALAR_INT32: v.i32 = (int32_t)saturate(value, INT32_MIN, INT32_MAX); break;
    case SCALAR_UINT32: v.u32 = (uint32_t)saturate(value, 0, UINT32_MAX); break;
    case SCALAR_FLOAT32: v.f32 = (float)value; break;
    case SCALAR_FLOAT64: v.f64 = value; break;
    }
    memcpy(p, &v, scalar_bytes(type));
}

void cloud_done(struct cloud *cloud) {
    if (!cloud) return;
    for (size_t i = 0; cloud->property && i < cloud->property_count; i++) {
        free(cloud->property[i].list_offset);
        free(cloud->property[i].list_data);
    }
    free(cloud->property);
    free(cloud->record);
    free(cloud->position);
    free(cloud->triangle);
    free(cloud->view), free(cloud->comments);
    free(cloud->left_out);
    free(cloud->las);
    free(cloud->colour);
    *cloud = (struct cloud){0};
}

static double round_to(double value, enum scalar_type type) {
    unsigned char bytes[8];
    scalar_store(bytes, type, value);
    return scalar_load(bytes, type);
}

vec3 cloud_round(const struct cloud *cloud, vec3 p) {
    const struct property *property = cloud->property;
    return (vec3){round_to(p.x, property[cloud->xyz[0]].type), round_to(p.y, property[cloud->xyz[1]].type),
                  round_to(p.z, property[cloud->xyz[2]].type)};
}

/* Whether a number needs the last bit that a float has there. */
static bool needs_last_bit(double x) {
    uint32_t bits;
    float as_float = (float)x;
    memcpy(&bits, &as_float, sizeof bits);
    return bits & 1;
}

double cloud_rounding_step(const struct cloud *cloud) {
    enum { SOME = 4096 };
    static const double OFTEN = 0.25; /* of what was rounded half needs it */
    size_t n = cloud->count, each = n / SOME + 1, looked = 0, fine[3] = {0};
    double largest[3] = {0}, step = 0;
    for (size_t i = 0; i < n; i += each, looked++) {
        const double at[3] = {cloud->position[i].x, cloud->position[i].y, cloud->position[i].z};
        for (int axis = 0; axis < 3; axis++) {
            fine[axis] += needs_last_bit(at[axis]);
            largest[axis] = fmax(largest[axis], fabs(at[axis]));
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        bool counts =
            cloud->property[cloud->xyz[axis]].type == SCALAR_FLOAT32 && (double)fine[axis] > OFTEN * (double)looked;
        float high = (float)largest[axis];
        if (counts) step = fmax(step, (double)high - (double)nextafterf(high, 0));
    }
    return step;
}

void cloud_move(struct cloud *cloud, const vec3 *position) {
    for (size_t i = 0; i < cloud->count; i++) {
        const double to[3] = {position[i].x, position[i].y, position[i].z};
        for (int axis = 0; axis < 3; axis++) {
            const struct property *property = &cloud->property[cloud->xyz[axis]];
            scalar_store(&cloud->record[i * cloud->record_bytes + property->offset_bytes], property->type, to[axis]);
        }
        cloud->position[i] = cloud_round(cloud, position[i]);
    }
}
