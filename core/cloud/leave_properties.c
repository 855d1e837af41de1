/* Records become shorter from the first one to the last, in place.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/leave_properties.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"
#include "core/text/name_list.h"

/* Whether a name of the list means this property. */
static bool means(const char *name, const char *property) {
    static const char *const several[][5] = {{"rgb", "red", "green", "blue", "alpha"},
                                             {"normals", "nx", "ny", "nz", "nz"}};
    for (size_t i = 0; i < sizeof several / sizeof *several; i++)
        for (size_t k = 1; k < 5 && strcmp(name, several[i][0]) == 0; k++)
            if (attribute_is_same(several[i][k], property)) return true;
    return attribute_is_same(name, property);
}

static bool is_listed(const char *list, const char *property) {
    char name[NAME_LIST_NAME_BYTES];
    while (*list && name_list_next(&list, name))
        if (means(name, property)) return true;
    return false;
}

static enum status refuse(const struct cloud *cloud, const char *name, struct error *error) {
    char names[160] = "";
    for (size_t j = 0; j < cloud->property_count; j++) {
        size_t used = strlen(names);
        bool fits = used + strlen(cloud->property[j].name) + 8 < sizeof names;
        if (cloud_axis_of(cloud, j) >= 0 || !fits) continue;
        snprintf(names + used, sizeof names - used, "%s%s", used ? ", " : "", cloud->property[j].name);
    }
    return error_set(error, STATUS_BAD_PARAMETER, "properties", "the input has no %s; it has %s", name,
                     names[0] ? names : "x, y, z alone");
}

enum status cloud_has_properties(const struct cloud *cloud, const char *list, struct error *error) {
    char name[NAME_LIST_NAME_BYTES];
    while (*list && strcmp(list, "none") != 0 && name_list_next(&list, name)) {
        bool found = false;
        for (size_t j = 0; j < cloud->property_count && !found; j++) found = means(name, cloud->property[j].name);
        if (!found) return refuse(cloud, name, error);
    }
    return STATUS_OK;
}

/* Puts the properties that stay into `stay`, where they will be in records, and frees the others' lists. */
static size_t choose(struct cloud *cloud, const char *list, struct property *stay, size_t *record_bytes) {
    uint32_t xyz[3] = {0};
    size_t count = 0;
    *record_bytes = 0;
    for (size_t j = 0; j < cloud->property_count; j++) {
        struct property *p = &cloud->property[j];
        int axis = cloud_axis_of(cloud, j);
        if (axis < 0 && !is_listed(list, p->name)) {
            free(p->list_offset), free(p->list_data);
            continue;
        }
        if (axis >= 0) xyz[axis] = (uint32_t)count;
        stay[count] = *p;
        if (!p->is_list) stay[count].offset_bytes = *record_bytes, *record_bytes += scalar_bytes(p->type);
        cloud->property[count++] = *p; /* where it was */
    }
    memcpy(cloud->xyz, xyz, sizeof xyz);
    return count;
}

enum status cloud_leave_properties(struct cloud *cloud, const char *list, struct error *error) {
    size_t bytes, old = cloud->record_bytes;
    enum status status = cloud_has_properties(cloud, list, error);
    if (status || !list[0]) return status;
    struct property *stay = alloc_array(cloud->property_count, sizeof *stay);
    unsigned char *record = alloc_array(old, 1);
    if (!stay || !record) {
        free(stay), free(record);
        return error_set(error, STATUS_NO_MEMORY, "properties", "no memory for a list of properties");
    }
    cloud->property_count = choose(cloud, list, stay, &bytes);
    for (size_t i = 0; i < cloud->count; i++) {
        memcpy(record, cloud->record + i * old, old);
        for (size_t j = 0; j < cloud->property_count; j++)
            if (!stay[j].is_list)
                memcpy(cloud->record + i * bytes + stay[j].offset_bytes, record + cloud->property[j].offset_bytes,
                       scalar_bytes(stay[j].type));
    }
    memcpy(cloud->property, stay, cloud->property_count * sizeof *stay);
    cloud->record_bytes = bytes;
    free(stay), free(record);
    if (cloud->view_count > 1 && !attribute_find(cloud, CLOUD_SCAN)) {
        free(cloud->view);
        cloud->view = NULL, cloud->view_count = 0;
    }
    if (!attribute_find(cloud, "red")) {
        free(cloud->colour);
        cloud->colour = NULL;
    }
    return STATUS_OK;
}
