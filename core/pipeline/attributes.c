/* Attributes of places.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pipeline/attributes.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/mesh/vertex_normals.h"
#include "core/spatial/knn.h"

enum { CHUNK = 1 << 16 };

static enum status no_memory(struct error *error, size_t n) {
    if (error && error->code == STATUS_NO_MEMORY) return STATUS_NO_MEMORY;
    return error_set(error, STATUS_NO_MEMORY, "attributes", "no memory for attributes of %zu vertices", n);
}

/* ------------------------------------------------------------------------------------------------ the nearest */

/* id[i] = which of the points is nearest to query i. */
static enum status find_nearest(const vec3 *point, size_t points, const vec3 *query, size_t n, unsigned threads,
                                uint32_t *id, struct error *error) {
    struct knn *knn = NULL;
    double *distance_sq = alloc_array(CHUNK, sizeof *distance_sq);
    enum status status = distance_sq ? knn_new(point, points, threads, &knn, error) : STATUS_NO_MEMORY;
    for (size_t at = 0; !status && at < n; at += CHUNK)
        status = knn_search(knn, query + at, n - at < CHUNK ? n - at : CHUNK, 1, threads, id + at, distance_sq);
    knn_free(knn);
    free(distance_sq);
    return status;
}

/* The point whose record each place has. */
static enum status find_base(const struct cloud *cloud, const vec3 *place, const uint32_t *source, size_t n,
                             unsigned threads, uint32_t *base, struct error *error) {
    size_t moved = 0;
    vec3 *query = alloc_array(n, sizeof *query);
    uint32_t *id = alloc_array(n, sizeof *id);
    enum status status = query && id ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < n; i++) {
        base[i] = source ? source[i] : NONE;
        if (base[i] == NONE) query[moved++] = place[i];
    }
    if (!status && moved) status = find_nearest(cloud->position, cloud->count, query, moved, threads, id, error);
    for (size_t i = 0, k = 0; !status && i < n; i++)
        if (base[i] == NONE) base[i] = id[k++];
    free(query), free(id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ means */

static bool is_averaged(const struct property *p) {
    static const char *const whole[] = {"red", "green", "blue", "alpha", "intensity"};
    if (p->is_list) return false;
    for (size_t i = 0; i < sizeof whole / sizeof *whole; i++)
        if (strcmp(p->name, whole[i]) == 0) return true;
    return p->type >= SCALAR_FLOAT32;
}

/* Adds the values of one property over the points of each place, and writes the means.  sum and count: n of each. */
static void average(const struct cloud *cloud, size_t j, const uint32_t *place_of, double *sum, uint32_t *count,
                    struct cloud *out) {
    const struct property *from = &cloud->property[j], *to = &out->property[j];
    memset(sum, 0, out->count * sizeof *sum), memset(count, 0, out->count * sizeof *count);
    for (size_t p = 0; p < cloud->count; p++) {
        double value = scalar_load(cloud->record + p * cloud->record_bytes + from->offset_bytes, from->type);
        if (!isfinite(value)) continue;
        sum[place_of[p]] += value;
        count[place_of[p]]++;
    }
    for (size_t i = 0; i < out->count; i++)
        if (count[i]) scalar_store(out->record + i * out->record_bytes + to->offset_bytes, to->type, sum[i] / count[i]);
}

static const struct property *find(const struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return &cloud->property[j];
    return NULL;
}

/* The normals' properties, or false where some have no fractions or aren't there. */
static bool find_normals(const struct cloud *cloud, const struct property *normal[3]) {
    static const char *const names[3] = {"nx", "ny", "nz"};
    for (int k = 0; k < 3; k++) {
        normal[k] = find(cloud, names[k]);
        if (!normal[k] || !is_averaged(normal[k])) return false;
    }
    return true;
}

static void load_normal(const unsigned char *record, const struct property *const normal[3], double n[3]) {
    for (int k = 0; k < 3; k++) n[k] = scalar_load(record + normal[k]->offset_bytes, normal[k]->type);
}

static void store_normal(unsigned char *record, const struct property *const normal[3], const double n[3],
                         double scale) {
    for (int k = 0; k < 3; k++) scalar_store(record + normal[k]->offset_bytes, normal[k]->type, n[k] * scale);
}

/* Means of unit vectors are shorter; where nothing is left of one it stays as it is. */
static void normalise(struct cloud *out) {
    const struct property *normal[3];
    if (!find_normals(out, normal)) return;
    for (size_t i = 0; i < out->count; i++) {
        unsigned char *record = out->record + i * out->record_bytes;
        double n[3];
        load_normal(record, normal, n);
        double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        if (length > 1e-6) store_normal(record, normal, n, 1 / length);
    }
}

static enum status average_all(const struct cloud *cloud, const vec3 *place, unsigned threads, struct cloud *out,
                               struct error *error) {
    double *sum = alloc_array(out->count, sizeof *sum);
    uint32_t *count = alloc_array(out->count, sizeof *count), *of = alloc_array(cloud->count, sizeof *of);
    enum status status = sum && count && of ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = find_nearest(place, out->count, cloud->position, cloud->count, threads, of, error);
    for (size_t j = 0; !status && j < cloud->property_count; j++)
        if (cloud_axis_of(cloud, j) < 0 && is_averaged(&out->property[j])) average(cloud, j, of, sum, count, out);
    if (!status) normalise(out);
    free(sum), free(count), free(of);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the cloud */

/* The cloud's properties, but lists without items, and coordinates with fractions. */
static enum status lay_out(const struct cloud *cloud, size_t n, struct cloud *out) {
    *out = (struct cloud){.form = cloud->form};
    out->property = alloc_zeroed(cloud->property_count, sizeof *out->property);
    if (!out->property) return STATUS_NO_MEMORY;
    out->property_count = cloud->property_count;
    memcpy(out->xyz, cloud->xyz, sizeof out->xyz);
    for (size_t j = 0; j < cloud->property_count; j++) {
        struct property *p = &out->property[j];
        *p = cloud->property[j];
        p->list_offset = NULL, p->list_data = NULL;
        if (p->is_list) continue;
        if (cloud_axis_of(cloud, j) >= 0 && p->type < SCALAR_FLOAT32) p->type = SCALAR_FLOAT64;
        p->offset_bytes = out->record_bytes;
        out->record_bytes += scalar_bytes(p->type);
    }
    out->position = alloc_array(n, sizeof *out->position);
    out->record = alloc_array(n, out->record_bytes);
    out->count = n;
    return out->position && out->record ? STATUS_OK : STATUS_NO_MEMORY;
}

static void fill(const struct cloud *cloud, const vec3 *place, const uint32_t *base, struct cloud *out) {
    for (size_t i = 0; i < out->count; i++) {
        const unsigned char *from = cloud->record + base[i] * cloud->record_bytes;
        unsigned char *to = out->record + i * out->record_bytes;
        for (size_t j = 0; j < cloud->property_count; j++) {
            const struct property *old = &cloud->property[j], *p = &out->property[j];
            int axis = cloud_axis_of(cloud, j);
            if (p->is_list) continue;
            if (axis >= 0)
                scalar_store(to + p->offset_bytes, p->type, (&place[i].x)[axis]);
            else
                memcpy(to + p->offset_bytes, from + old->offset_bytes, scalar_bytes(p->type));
        }
        out->position[i] = cloud_round(out, place[i]);
    }
}

enum status attributes_at(const struct cloud *cloud, const vec3 *place, const uint32_t *source, size_t n, bool mean,
                          unsigned threads, struct cloud *out, struct error *error) {
    struct cloud made = {0};
    uint32_t *base = alloc_array(n, sizeof *base);
    enum status status = base ? lay_out(cloud, n, &made) : STATUS_NO_MEMORY;
    if (!status) status = find_base(cloud, place, source, n, threads, base, error);
    if (!status) fill(cloud, place, base, &made);
    free(base);
    if (!status && mean && n) status = average_all(cloud, place, threads, &made, error);
    if (status) {
        cloud_done(&made);
        return status == STATUS_NO_MEMORY ? no_memory(error, n) : status;
    }
    *out = made;
    return STATUS_OK;
}

enum status attributes_turn_normals(struct cloud *vertices, const struct mesh *mesh) {
    const struct property *normal[3];
    if (!find_normals(vertices, normal)) return STATUS_OK;
    vec3 *around = alloc_array(mesh->vertex_count, sizeof *around);
    if (!around) return STATUS_NO_MEMORY;
    mesh_vertex_normals(mesh, around);
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        unsigned char *record = vertices->record + v * vertices->record_bytes;
        double n[3];
        load_normal(record, normal, n);
        if (vec3_dot((vec3){n[0], n[1], n[2]}, around[v]) < 0) store_normal(record, normal, n, -1);
    }
    free(around);
    return STATUS_OK;
}
