/* Selection, point by point.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/select.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"
#include "core/cloud/keep.h"
#include "core/text/condition_list.h"
#include "core/text/weight_list.h"

/* ------------------------------------------------------------------------------------------------ properties */

enum status select_refuse(const struct cloud *cloud, const char *parameter, const char *name, struct error *error) {
    char names[ERROR_TEXT_BYTES - 96] = "";
    size_t used = 0;
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *p = &cloud->property[j];
        if (p->is_list) continue;
        if (used + strlen(p->name) + 8 >= sizeof names) {
            snprintf(names + used, sizeof names - used, " ...");
            break;
        }
        used += (size_t)snprintf(names + used, sizeof names - used, "%s%s", used ? ", " : "", p->name);
    }
    return error_set(error, STATUS_BAD_PARAMETER, parameter, "the input has no property '%.60s'; it has %s", name,
                     names);
}

enum status select_check_names(const struct cloud *cloud, const struct params *params, struct error *error) {
    struct condition condition;
    struct weight_entry entry;
    for (const char *at = params->where; *at && condition_list_next(&at, &condition);)
        if (!attribute_find(cloud, condition.name)) return select_refuse(cloud, "where", condition.name, error);
    for (const char *at = params->weights; *at && weight_list_next(&at, &entry);) {
        const char *const rgb[] = {"red", "green", "blue", NULL}, *const one[] = {entry.name, NULL};
        for (const char *const *name = strcmp(entry.name, "rgb") == 0 ? rgb : one; *name; name++)
            if (!attribute_find(cloud, *name)) return select_refuse(cloud, "weights", *name, error);
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the rules */

static bool in_box(const double *box, vec3 p) {
    double x[3] = {p.x, p.y, p.z};
    for (int k = 0; k < 3; k++)
        if (x[k] < fmin(box[k], box[k + 3]) || x[k] > fmax(box[k], box[k + 3])) return false;
    return true;
}

/* How often a line from p in the direction of x crosses the edges: once more than even inside. */
static bool in_polygon(const struct param_numbers *corner, vec3 p) {
    bool inside = false;
    size_t n = corner->count / 2;
    for (size_t i = 0, j = n - 1; i < n; j = i++) {
        double ax = corner->value[2 * i], ay = corner->value[2 * i + 1];
        double bx = corner->value[2 * j], by = corner->value[2 * j + 1];
        if ((ay > p.y) != (by > p.y) && p.x < ax + (bx - ax) * ((p.y - ay) / (by - ay))) inside = !inside;
    }
    return inside;
}

static bool in_crop(const struct param_numbers *crop, vec3 p) {
    return crop->count == PARAMS_BOX_NUMBERS ? in_box(crop->value, p) : in_polygon(crop, p);
}

static uint64_t crop_points(const struct cloud *cloud, const struct param_numbers *crop, uint8_t *kept) {
    uint64_t dropped = 0;
    for (size_t i = 0; i < cloud->count; i++) {
        kept[i] = !crop->count || in_crop(crop, cloud->position[i]);
        dropped += !kept[i];
    }
    return dropped;
}

static uint64_t filter_points(const struct cloud *cloud, const struct condition *condition,
                              const struct property *property, uint8_t *kept) {
    uint64_t dropped = 0;
    for (size_t i = 0; i < cloud->count; i++) {
        if (!kept[i]) continue;
        const unsigned char *at = cloud->record + i * cloud->record_bytes + property->offset_bytes;
        kept[i] = condition_holds(condition, scalar_load(at, property->type));
        dropped += !kept[i];
    }
    return dropped;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status refuse_all(const struct cloud *cloud, const struct selection *selection, struct error *error) {
    vec3 low = cloud->position[0], high = low;
    for (size_t i = 1; i < cloud->count; i++) {
        vec3 p = cloud->position[i];
        low = (vec3){fmin(low.x, p.x), fmin(low.y, p.y), fmin(low.z, p.z)};
        high = (vec3){fmax(high.x, p.x), fmax(high.y, p.y), fmax(high.z, p.z)};
    }
    if (selection->cropped == cloud->count)
        return error_set(error, STATUS_BAD_PARAMETER, "crop",
                         "no point is in there: all %zu are between %.10g %.10g %.10g and %.10g %.10g %.10g",
                         cloud->count, low.x, low.y, low.z, high.x, high.y, high.z);
    return error_set(error, STATUS_BAD_PARAMETER, "where", "no point meets the conditions, of %" PRIu64,
                     (uint64_t)cloud->count - selection->cropped);
}

enum status select_part(const struct cloud *cloud, const struct params *params, uint8_t *kept,
                        struct selection *selection, struct error *error) {
    struct selection made = {.cropped = crop_points(cloud, &params->crop, kept)};
    struct condition condition;
    for (const char *at = params->where; *at;) {
        if (!condition_list_next(&at, &condition))
            return error_set(error, STATUS_BAD_PARAMETER, "where", "is no list of conditions");
        const struct property *property = attribute_find(cloud, condition.name);
        if (!property) return select_refuse(cloud, "where", condition.name, error);
        made.filtered += filter_points(cloud, &condition, property, kept);
    }
    *selection = made;
    return STATUS_OK;
}

enum status select_points(const struct cloud *cloud, const struct params *params, uint8_t *kept,
                          struct selection *selection, struct error *error) {
    struct selection made;
    enum status status = select_part(cloud, params, kept, &made, error);
    if (!status && made.cropped + made.filtered == cloud->count) status = refuse_all(cloud, &made, error);
    if (!status) *selection = made;
    return status;
}

enum status select_in_place(struct cloud *cloud, const struct params *params, struct selection *selection,
                            struct error *error) {
    size_t triangles, count = cloud->count;
    uint8_t *kept = alloc_array(count, sizeof *kept);
    if (!kept) return error_set(error, STATUS_NO_MEMORY, "crop", "no memory for %zu points", count);
    enum status status = select_points(cloud, params, kept, selection, error);
    if (!status && selection->cropped + selection->filtered) {
        status = cloud_keep(cloud, kept, &triangles);
        if (status) error_set(error, status, "crop", "no memory for %zu points", count);
    }
    free(kept);
    return status;
}
