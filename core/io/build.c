/* Making a cloud.
 *
 * Arrays grow by half; where the count is known they are made once, and never for more than the caller has found room
 * for in the file.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/build.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/finite.h"

enum { TICK_POINTS = 16384, FIRST_CAPACITY = 1024, TEXT_LIMIT_BYTES = 32 * 1024, BAD_TEXT_BYTES = 256 };

void cloud_build_start(struct cloud_build *build, const char *form, uint64_t bytes, const struct cloud_limits *limits,
                       const struct progress *progress, struct error *error) {
    uint64_t points = limits && limits->max_points ? limits->max_points : NONE - 1;
    size_t properties = limits && limits->max_properties ? limits->max_properties : CLOUD_MAX_PROPERTIES;
    *build =
        (struct cloud_build){.cloud.form = form,
                             .bytes = bytes ? bytes : 1,
                             .max_points = points < NONE - 1 ? points : NONE - 1,
                             .max_properties = properties < CLOUD_MAX_PROPERTIES ? properties : CLOUD_MAX_PROPERTIES,
                             .triangles.most = limits ? limits->max_triangles : 0,
                             .progress = progress,
                             .error = error};
}

static enum status no_memory(struct cloud_build *build) {
    return error_set(build->error, STATUS_NO_MEMORY, "read", "no memory for more than %zu points", build->cloud.count);
}

enum status cloud_build_bad(struct cloud_build *build, const char *where, struct cloud_place place, const char *format,
                            ...) {
    char text[BAD_TEXT_BYTES];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    return error_set_at(build->error, STATUS_MALFORMED, where, place.line, place.line ? UINT64_MAX : place.byte, "%s",
                        text);
}

/* ------------------------------------------------------------------------------------------------ properties */

static bool is_fit(const struct cloud *cloud, const char *name) {
    size_t n = strlen(name);
    if (n == 0 || n >= PROPERTY_NAME_BYTES) return false;
    for (size_t i = 0; i < n; i++)
        if (name[i] < 33 || name[i] > 126) return false;
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return false;
    return true;
}

enum status cloud_build_property(struct cloud_build *build, const char *name, enum scalar_type type) {
    struct cloud *cloud = &build->cloud;
    if (cloud->property_count == build->max_properties)
        return error_set(build->error, STATUS_LIMIT, "properties", "more than the %zu properties that are allowed",
                         build->max_properties);
    if (!cloud->property) cloud->property = alloc_zeroed(build->max_properties, sizeof *cloud->property);
    if (!cloud->property) return no_memory(build);
    struct property *property = &cloud->property[cloud->property_count];
    property->type = type;
    property->offset_bytes = cloud->record_bytes;
    if (is_fit(cloud, name))
        snprintf(property->name, PROPERTY_NAME_BYTES, "%s", name);
    else
        for (size_t k = cloud->property_count + 1; !is_fit(cloud, property->name); k++)
            snprintf(property->name, PROPERTY_NAME_BYTES, "column%zu", k);
    for (int axis = 0; axis < 3; axis++)
        if (strcmp(property->name, (const char[2]){"xyz"[axis]}) == 0)
            cloud->xyz[axis] = (uint32_t)cloud->property_count;
    cloud->record_bytes += scalar_bytes(type);
    cloud->property_count++;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ points */

static enum status resize(struct cloud_build *build, size_t capacity) {
    struct cloud *cloud = &build->cloud;
    vec3 *position = alloc_resize(cloud->position, capacity, sizeof *position);
    if (!position) return no_memory(build);
    cloud->position = position;
    unsigned char *record = alloc_resize(cloud->record, capacity, cloud->record_bytes);
    if (!record) return no_memory(build);
    cloud->record = record;
    build->point_capacity = capacity;
    return STATUS_OK;
}

static enum status check_limit(struct cloud_build *build, uint64_t points) {
    if (points <= build->max_points) return STATUS_OK;
    return error_set(build->error, STATUS_LIMIT, "points", "%" PRIu64 " points, at most %" PRIu64 " are allowed",
                     points, build->max_points);
}

enum status cloud_build_room(struct cloud_build *build, uint64_t points) {
    enum status status = check_limit(build, points);
    return status || points <= build->point_capacity ? status : resize(build, (size_t)points);
}

/* Room for one more. */
static enum status build_reserve(struct cloud_build *build) {
    size_t count = build->cloud.count;
    enum status status = check_limit(build, (uint64_t)count + 1);
    return status || count < build->point_capacity ? status : resize(build, count + count / 2 + FIRST_CAPACITY);
}

enum status cloud_build_point(struct cloud_build *build, const void *record, struct cloud_place place) {
    struct cloud *cloud = &build->cloud;
    double p[3];
    if (cloud->count % TICK_POINTS == 0 &&
        progress_tick(build->progress, "read", (double)place.byte / (double)build->bytes))
        return error_set(build->error, STATUS_CANCELLED, "read", "cancelled");
    for (int axis = 0; axis < 3; axis++) {
        const struct property *property = &cloud->property[cloud->xyz[axis]];
        p[axis] = scalar_load((const unsigned char *)record + property->offset_bytes, property->type);
    }
    enum status status = build_reserve(build);
    if (status) return status;
    memcpy(cloud->record + cloud->count * cloud->record_bytes, record, cloud->record_bytes);
    cloud->position[cloud->count++] = (vec3){p[0], p[1], p[2]};
    return STATUS_OK;
}

enum status cloud_build_slots(struct cloud_build *build, uint64_t points) {
    enum status status = cloud_build_room(build, points);
    if (!status) build->cloud.count = (size_t)points;
    return status;
}

void cloud_build_place(struct cloud_build *build, size_t i) {
    struct cloud *cloud = &build->cloud;
    const unsigned char *record = cloud->record + i * cloud->record_bytes;
    double p[3];
    for (int axis = 0; axis < 3; axis++) {
        const struct property *property = &cloud->property[cloud->xyz[axis]];
        p[axis] = scalar_load(record + property->offset_bytes, property->type);
    }
    cloud->position[i] = (vec3){p[0], p[1], p[2]};
}

static enum status make_triangle_room(struct cloud *cloud, struct triangle_room *room, struct error *error) {
    size_t count = cloud->triangle_count, capacity = count + count / 2 + FIRST_CAPACITY;
    if (room->most && count >= room->most)
        return error_set(error, STATUS_NO_MEMORY, "faces",
                         "the faces are more than %" PRIu64 " triangles, and the memory allowed has no room for more",
                         room->most);
    if (room->most && capacity > room->most) capacity = (size_t)room->most;
    void *grown = alloc_resize(cloud->triangle, capacity, sizeof *cloud->triangle);
    if (!grown) return error_set(error, STATUS_NO_MEMORY, "read", "no memory for more than %zu triangles", count);
    cloud->triangle = grown;
    room->capacity = capacity;
    return STATUS_OK;
}

enum status cloud_build_append(struct cloud *cloud, struct triangle_room *room, uint32_t a, uint32_t b, uint32_t c,
                               struct error *error) {
    enum status status = cloud->triangle_count < room->capacity ? STATUS_OK : make_triangle_room(cloud, room, error);
    if (status) return status;
    uint32_t *triangle = cloud->triangle[cloud->triangle_count++];
    triangle[0] = a, triangle[1] = b, triangle[2] = c;
    return STATUS_OK;
}

enum status cloud_build_triangle(struct cloud_build *build, uint32_t a, uint32_t b, uint32_t c) {
    return cloud_build_append(&build->cloud, &build->triangles, a, b, c, build->error);
}

void cloud_build_renumber(struct cloud_build *build, const uint32_t *id, size_t count) {
    for (size_t t = 0; t < build->cloud.triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            uint32_t *corner = &build->cloud.triangle[t][k];
            if (UINT32_MAX - 1 - *corner < count) *corner = id[UINT32_MAX - 1 - *corner];
        }
}

/* ------------------------------------------------------------------------------------------------ notes */

/* Appends a line to a text, unless it would become too long.  STATUS_NO_MEMORY. */
static enum status add_line(char **text, const char *before, const char *line, size_t n) {
    size_t used = *text ? strlen(*text) : 0, more = strlen(before) + n + 1;
    if (used + more >= TEXT_LIMIT_BYTES) return STATUS_OK;
    char *grown = alloc_resize(*text, used + more + 1, 1);
    if (!grown) return STATUS_NO_MEMORY;
    snprintf(grown + used, more + 1, "%s%.*s\n", before, (int)n, line);
    *text = grown;
    for (char *c = grown + used; *c; c++)
        if ((unsigned char)*c < 32 && c[1]) *c = ' ';
    return STATUS_OK;
}

enum status cloud_leave_out(struct cloud *cloud, const char *what) {
    if (cloud->left_out && strstr(cloud->left_out, what)) return STATUS_OK;
    return add_line(&cloud->left_out, "", what, strlen(what));
}

enum status cloud_build_leave_out(struct cloud_build *build, const char *what) {
    return cloud_leave_out(&build->cloud, what) ? no_memory(build) : STATUS_OK;
}

enum status cloud_build_comment(struct cloud_build *build, const char *text, size_t n) {
    while (n && (text[0] == ' ' || text[0] == '\t')) text++, n--;
    const char *end = memchr(text, 0, n);
    if (end) n = (size_t)(end - text);
    if (n == 0 || n > TEXT_LIMIT_BYTES) return STATUS_OK;
    return add_line(&build->cloud.comments, "comment ", text, n) ? no_memory(build) : STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the end */

/* Gives back what growing has taken too much.  Where that fails, the larger arrays do as well. */
static void trim(struct cloud_build *build) {
    struct cloud *cloud = &build->cloud;
    void *position = alloc_resize(cloud->position, cloud->count, sizeof *cloud->position);
    if (position) cloud->position = position;
    void *record = alloc_resize(cloud->record, cloud->count, cloud->record_bytes);
    if (record) cloud->record = record;
    void *property = alloc_resize(cloud->property, cloud->property_count, sizeof *cloud->property);
    if (property) cloud->property = property;
    void *triangle =
        cloud->triangle ? alloc_resize(cloud->triangle, cloud->triangle_count, sizeof *cloud->triangle) : NULL;
    if (triangle) cloud->triangle = triangle;
}

enum status cloud_build_end(struct cloud_build *build, enum status status, struct cloud *cloud) {
    if (!status && build->cloud.count == 0)
        status = error_set_at(build->error, STATUS_MALFORMED, "read", 0, UINT64_MAX, "no points");
    if (!status) status = cloud_drop_unplaced(&build->cloud, build->error);
    if (status) {
        cloud_done(&build->cloud);
        return status;
    }
    trim(build);
    *cloud = build->cloud;
    return STATUS_OK;
}
