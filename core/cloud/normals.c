/* Records grow from the last one to the first, in place.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/normals.h"

#include <stdio.h>
#include <string.h>

#include "core/base/alloc.h"

enum { AXES = 3 };
static const char *const names[AXES] = {"nx", "ny", "nz"};

static struct property *find_component(struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return &cloud->property[j];
    return NULL;
}

/* The name of a property that is in the way becomes "name_given", as often as it takes. */
static void move_aside(struct cloud *cloud, const char *name) {
    struct property *taken = find_component(cloud, name);
    if (!taken) return;
    char other[PROPERTY_NAME_BYTES];
    snprintf(other, sizeof other, "%s_given", name);
    for (unsigned i = 2; find_component(cloud, other); i++) snprintf(other, sizeof other, "%s_given%u", name, i);
    memcpy(taken->name, other, sizeof other);
}

static enum status append(struct cloud *cloud, struct error *error) {
    size_t old = cloud->record_bytes, grown = old + AXES * sizeof(float);
    if (cloud->property_count + AXES > CLOUD_MAX_PROPERTIES)
        return error_set(error, STATUS_LIMIT, "normals", "%zu properties leave no room for three more, at most %d",
                         cloud->property_count, CLOUD_MAX_PROPERTIES);
    void *property = alloc_resize(cloud->property, cloud->property_count + AXES, sizeof *cloud->property);
    if (property) cloud->property = property;
    void *record = property ? alloc_resize(cloud->record, cloud->count, grown) : NULL;
    if (!record)
        return error_set(error, STATUS_NO_MEMORY, "normals", "no memory for normals of %zu points", cloud->count);
    cloud->record = record;
    for (size_t i = cloud->count; i-- > 0;) memmove(cloud->record + i * grown, cloud->record + i * old, old);
    cloud->record_bytes = grown;
    for (int k = 0; k < AXES; k++) {
        move_aside(cloud, names[k]);
        struct property *p = &cloud->property[cloud->property_count++];
        *p = (struct property){.type = SCALAR_FLOAT32, .offset_bytes = old + (size_t)k * sizeof(float)};
        snprintf(p->name, sizeof p->name, "%s", names[k]);
    }
    return STATUS_OK;
}

enum status cloud_set_normals(struct cloud *cloud, const float (*normal)[3], struct error *error) {
    bool there = true;
    for (int k = 0; k < AXES; k++) {
        const struct property *p = find_component(cloud, names[k]);
        there = there && p && !p->is_list && p->type >= SCALAR_FLOAT32;
    }
    enum status status = there ? STATUS_OK : append(cloud, error);
    if (status) return status;
    for (int k = 0; k < AXES; k++) {
        const struct property *p = find_component(cloud, names[k]);
        for (size_t i = 0; i < cloud->count; i++)
            scalar_store(cloud->record + i * cloud->record_bytes + p->offset_bytes, p->type, (double)normal[i][k]);
    }
    return STATUS_OK;
}
