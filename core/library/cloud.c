/* Clouds from arrays and files.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/build.h"
#include "core/io/read.h"
#include "core/library/handles.h"

_Static_assert(sizeof(vec3) == 3 * sizeof(double), "positions are handed out as triples");

static enum whittle_status no_memory(struct whittle_error *error) {
    struct error inner = {0};
    error_set(&inner, STATUS_NO_MEMORY, "cloud", "no memory for the cloud");
    return library_status(STATUS_NO_MEMORY, &inner, error);
}

static bool name_is_fit(const char *name) {
    size_t n = name ? strlen(name) : 0;
    for (size_t i = 0; i < n; i++)
        if (name[i] < 33 || name[i] > 126) return false;
    return n > 0 && n < PROPERTY_NAME_BYTES;
}

static enum status check_attribute(const struct whittle_attribute *attributes, size_t i, struct error *error) {
    const struct whittle_attribute *a = &attributes[i];
    if (!name_is_fit(a->name))
        return error_set(error, STATUS_BAD_PARAMETER, "attributes",
                         "attribute %zu: a name takes 1 to %d printable ASCII characters without blanks", i,
                         PROPERTY_NAME_BYTES - 1);
    if ((unsigned)a->type >= SCALAR_TYPE_COUNT)
        return error_set(error, STATUS_BAD_PARAMETER, a->name, "attribute %zu: %d is no type", i, (int)a->type);
    if (!a->values) return error_set(error, STATUS_BAD_PARAMETER, a->name, "attribute %zu: values is NULL", i);
    for (size_t j = 0; j < i; j++)
        if (strcmp(attributes[j].name, a->name) == 0)
            return error_set(error, STATUS_BAD_PARAMETER, a->name, "attributes %zu and %zu have the same name", j, i);
    return STATUS_OK;
}

static bool has_attribute(const struct whittle_attribute *attributes, size_t n, const char *name) {
    for (size_t i = 0; i < n; i++)
        if (strcmp(attributes[i].name, name) == 0) return true;
    return false;
}

static enum status check_attributes(size_t count, const struct whittle_attribute *attributes, size_t n,
                                    struct error *error) {
    if (n > CLOUD_MAX_PROPERTIES)
        return error_set(error, STATUS_LIMIT, "attributes", "%zu attributes, at most %d are allowed", n,
                         CLOUD_MAX_PROPERTIES);
    if (count == 0 || count >= NONE)
        return error_set(error, count ? STATUS_LIMIT : STATUS_DEGENERATE, "points",
                         "%zu points; a cloud takes 1 to %" PRIu32, count, NONE - 1);
    enum status status = STATUS_OK;
    for (size_t i = 0; i < n && !status; i++) status = check_attribute(attributes, i, error);
    static const char *const axes[] = {"x", "y", "z"};
    for (int axis = 0; axis < 3 && !status; axis++)
        if (!has_attribute(attributes, n, axes[axis]))
            status = error_set(error, STATUS_BAD_PARAMETER, axes[axis], "there is no attribute %s", axes[axis]);
    return status;
}

/* Ids are the caller's indices, so no point is dropped here as a file's is that has no position. */
static enum status check_position(const struct cloud_build *build, const unsigned char *record, size_t i) {
    for (int axis = 0; axis < 3; axis++) {
        const struct property *property = &build->cloud.property[build->cloud.xyz[axis]];
        if (!isfinite(scalar_load(record + property->offset_bytes, property->type)))
            return error_set(build->error, STATUS_MALFORMED, property->name, "point %zu: %s is not a finite number", i,
                             property->name);
    }
    return STATUS_OK;
}

/* Puts the points in, record by record. */
static enum status fill(struct cloud_build *build, size_t count, const struct whittle_attribute *attributes, size_t n) {
    unsigned char *record = alloc_array(build->cloud.record_bytes, 1);
    enum status status = record ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; i < count && !status; i++) {
        for (size_t j = 0; j < n; j++) {
            size_t bytes = scalar_bytes((enum scalar_type)attributes[j].type);
            size_t stride = attributes[j].stride_bytes ? attributes[j].stride_bytes : bytes;
            memcpy(record + build->cloud.property[j].offset_bytes,
                   (const unsigned char *)attributes[j].values + i * stride, bytes);
        }
        status = check_position(build, record, i);
        if (!status) status = cloud_build_point(build, record, (struct cloud_place){0, i});
    }
    free(record);
    return status;
}

static enum status build_cloud(size_t count, const struct whittle_attribute *attributes, size_t n, struct cloud *cloud,
                               struct error *error) {
    struct cloud_build build;
    enum status status = check_attributes(count, attributes, n, error);
    if (status) return status;
    cloud_build_start(&build, "arrays", count, NULL, NULL, error);
    for (size_t j = 0; j < n && !status; j++)
        status = cloud_build_property(&build, attributes[j].name, (enum scalar_type)attributes[j].type);
    if (!status) status = cloud_build_room(&build, count);
    if (!status) status = fill(&build, count, attributes, n);
    return cloud_build_end(&build, status, cloud);
}

enum whittle_status whittle_cloud_new(size_t count, const struct whittle_attribute *attributes, size_t attribute_count,
                                      struct whittle_cloud **cloud, struct whittle_error *error) {
    struct error inner = {0};
    struct whittle_cloud *made = alloc_zeroed(1, sizeof *made);
    if (!made) return no_memory(error);
    enum status status = build_cloud(count, attributes, attribute_count, &made->cloud, &inner);
    if (status)
        free(made);
    else
        *cloud = made;
    return library_status(status, &inner, error);
}

enum whittle_status whittle_cloud_from_positions(const double *xyz, size_t count, struct whittle_cloud **cloud,
                                                 struct whittle_error *error) {
    const size_t stride = 3 * sizeof *xyz;
    const struct whittle_attribute attributes[] = {{"x", WHITTLE_FLOAT64, xyz, stride},
                                                   {"y", WHITTLE_FLOAT64, xyz ? xyz + 1 : NULL, stride},
                                                   {"z", WHITTLE_FLOAT64, xyz ? xyz + 2 : NULL, stride}};
    return whittle_cloud_new(count, attributes, 3, cloud, error);
}

enum whittle_status whittle_cloud_set_triangles(struct whittle_cloud *cloud, const uint32_t *corners, size_t count,
                                                struct whittle_error *error) {
    struct error inner = {0};
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < 3; k++)
            if (corners[3 * i + k] >= cloud->cloud.count) {
                error_set(&inner, STATUS_MALFORMED, "triangles",
                          "triangle %zu: there is no point %" PRIu32 " among %zu", i, corners[3 * i + k],
                          cloud->cloud.count);
                return library_status(STATUS_MALFORMED, &inner, error);
            }
    uint32_t(*copy)[3] = count ? alloc_array(count, sizeof *copy) : NULL;
    if (count && !copy) return no_memory(error);
    if (count) memcpy(copy, corners, count * sizeof *copy);
    free(cloud->cloud.triangle);
    cloud->cloud.triangle = copy;
    cloud->cloud.triangle_count = count;
    return WHITTLE_OK;
}

/* Reads from path, or where it is NULL from bytes. */
static enum whittle_status read_cloud(const char *path, const void *bytes, size_t n, const char *columns,
                                      const struct whittle_progress *progress, struct whittle_cloud **cloud,
                                      struct whittle_error *error) {
    struct error inner = {0};
    struct progress tick;
    struct params params;
    params_defaults(&params);
    enum status status = columns && columns[0] ? params_set(&params, "columns", columns, &inner) : STATUS_OK;
    if (status) return library_status(status, &inner, error);
    const struct cloud_limits limits = {.columns = params.columns};
    struct whittle_cloud *made = alloc_zeroed(1, sizeof *made);
    if (!made) return no_memory(error);
    library_progress(progress, &tick);
    status = path ? cloud_read_path(path, &limits, &tick, &made->cloud, &inner)
                  : cloud_read_memory(bytes, n, &limits, &tick, &made->cloud, &inner);
    if (status)
        free(made);
    else
        *cloud = made;
    return library_status(status, &inner, error);
}

enum whittle_status whittle_cloud_read(const char *path, const char *columns, const struct whittle_progress *progress,
                                       struct whittle_cloud **cloud, struct whittle_error *error) {
    return read_cloud(path, NULL, 0, columns, progress, cloud, error);
}

enum whittle_status whittle_cloud_read_memory(const void *bytes, size_t n, const char *columns,
                                              const struct whittle_progress *progress, struct whittle_cloud **cloud,
                                              struct whittle_error *error) {
    return read_cloud(NULL, bytes, n, columns, progress, cloud, error);
}

void whittle_cloud_free(struct whittle_cloud *cloud) {
    if (!cloud) return;
    cloud_done(&cloud->cloud);
    free(cloud);
}

size_t whittle_cloud_count(const struct whittle_cloud *cloud) { return cloud->cloud.count; }

size_t whittle_cloud_attribute_count(const struct whittle_cloud *cloud) { return cloud->cloud.property_count; }

struct whittle_attribute whittle_cloud_attribute(const struct whittle_cloud *cloud, size_t i) {
    const struct property *property = &cloud->cloud.property[i];
    const unsigned char *values = property->is_list ? NULL : cloud->cloud.record + property->offset_bytes;
    return (struct whittle_attribute){property->name, (enum whittle_type)property->type, values,
                                      cloud->cloud.record_bytes};
}

const double *whittle_cloud_positions(const struct whittle_cloud *cloud) {
    return (const double *)(const void *)cloud->cloud.position;
}

const uint32_t *whittle_cloud_triangles(const struct whittle_cloud *cloud, size_t *count) {
    *count = cloud->cloud.triangle_count;
    return (const uint32_t *)(const void *)cloud->cloud.triangle;
}
