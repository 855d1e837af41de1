/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tiles/told.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/radix.h"
#include "core/tiles/left.h"

enum { CODE_BYTES = TOLD_NORMAL_BYTES / 2, CODE_MOST = (1 << 24) - 1 };

/* ------------------------------------------------------------------------------------------------ normals */

/* The sphere as an octahedron, whose lower half is folded out around the upper one into a square. */
static void fold(double *u, double *v) {
    double x = *u, y = *v;
    *u = copysign(1 - fabs(y), x);
    *v = copysign(1 - fabs(x), y);
}

struct told_normal told_normal_of(vec3 unit) {
    struct told_normal normal;
    double sum = fabs(unit.x) + fabs(unit.y) + fabs(unit.z);
    double at[2] = {sum > 0 ? unit.x / sum : 0, sum > 0 ? unit.y / sum : 0};
    if (unit.z < 0) fold(&at[0], &at[1]);
    for (int axis = 0; axis < 2; axis++) {
        uint32_t code = (uint32_t)nearbyint((at[axis] + 1) / 2 * CODE_MOST);
        for (int i = 0; i < CODE_BYTES; i++) normal.code[axis * CODE_BYTES + i] = (unsigned char)(code >> 8 * i);
    }
    return normal;
}

vec3 told_normal_back(const struct told_normal *normal) {
    double at[2];
    for (int axis = 0; axis < 2; axis++) {
        uint32_t code = 0;
        for (int i = 0; i < CODE_BYTES; i++) code |= (uint32_t)normal->code[axis * CODE_BYTES + i] << 8 * i;
        at[axis] = 2 * (double)code / CODE_MOST - 1;
    }
    double z = 1 - fabs(at[0]) - fabs(at[1]);
    if (z < 0) fold(&at[0], &at[1]);
    return vec3_unit((vec3){at[0], at[1], z});
}

/* ------------------------------------------------------------------------------------------------ points */

enum status told_new(struct told *told, size_t n, bool with_normals) {
    *told = (struct told){.count = n};
    told->key = alloc_array(n, sizeof *told->key);
    told->id = alloc_array(n, sizeof *told->id);
    if (with_normals) told->normal = alloc_array(n, sizeof *told->normal);
    return told->key && told->id && (told->normal || !with_normals) ? STATUS_OK : STATUS_NO_MEMORY;
}

void told_done(struct told *told) {
    if (!told) return;
    free(told->key), free(told->id), free(told->normal);
    *told = (struct told){0};
}

static size_t put_gap(uint32_t gap, unsigned char to[TOLD_GAP_BYTES]) {
    size_t n = 0;
    for (; gap > 0x7f; gap >>= 7) to[n++] = (unsigned char)(gap | 0x80);
    to[n++] = (unsigned char)gap;
    return n;
}

size_t told_gap_bytes(const struct told *told) {
    unsigned char gap[TOLD_GAP_BYTES];
    size_t bytes = 0;
    for (size_t i = 0; i < told->count; i++) bytes += put_gap(told->id[i] - (i ? told->id[i - 1] : 0), gap);
    return bytes;
}

void told_put(struct sink *sink, const struct told *told) {
    unsigned char gap[TOLD_GAP_BYTES];
    for (size_t i = 0; i < told->count; i++) sink_bytes(sink, &told->key[i], sizeof *told->key);
    for (size_t i = 0; told->normal && i < told->count; i++) sink_bytes(sink, &told->normal[i], sizeof *told->normal);
    for (size_t i = 0; i < told->count; i++)
        sink_bytes(sink, gap, put_gap(told->id[i] - (i ? told->id[i - 1] : 0), gap));
}

bool told_get_ids(const unsigned char *gaps, size_t bytes, uint32_t *id, size_t n) {
    size_t at = 0;
    uint64_t last = 0;
    for (size_t i = 0; i < n; i++) {
        uint64_t gap = 0;
        for (unsigned shift = 0;; shift += 7) {
            if (at == bytes || shift >= 7 * TOLD_GAP_BYTES) return false;
            gap |= (uint64_t)(gaps[at] & 0x7f) << shift;
            if (!(gaps[at++] & 0x80)) break;
        }
        last += gap;
        if (last >= UINT32_MAX) return false;
        id[i] = (uint32_t)last;
    }
    return at == bytes;
}

/* ------------------------------------------------------------------------------------------------ ranking */

/* Those at the places that the items tell. */
static enum status told_pick(struct told *told, const uint64_t *item, size_t n) {
    struct told picked;
    enum status status = told_new(&picked, n, told->normal != NULL);
    for (size_t i = 0; !status && i < n; i++) {
        size_t from = radix_value(item[i]);
        picked.key[i] = told->key[from];
        picked.id[i] = told->id[from];
        if (told->normal) picked.normal[i] = told->normal[from];
    }
    if (status) {
        told_done(&picked);
    } else {
        told_done(told);
        *told = picked;
    }
    return status;
}

enum status told_rank(struct told *told, size_t most, unsigned threads) {
    size_t n = told->count;
    uint64_t *item = alloc_array(n, sizeof *item), *spare = alloc_array(n, sizeof *spare), *sorted = item;
    enum status status = item && spare ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < n; i++)
        item[i] = radix_item((uint32_t)whole_key(told->key[i], told->id[i]), (uint32_t)i);
    if (!status) sorted = radix_sort(item, spare, n, threads);
    for (size_t i = 0; !status && i < n; i++)
        sorted[i] = radix_item(told->key[radix_value(sorted[i])], radix_value(sorted[i]));
    if (!status) sorted = radix_sort(sorted, sorted == item ? spare : item, n, threads);
    if (!status) status = told_pick(told, sorted, most < n ? most : n);
    free(item), free(spare);
    return status;
}
