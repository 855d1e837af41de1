/* Clouds are joined one by one, so that no more than the whole and the one that is added are in memory.
 *
 * A plan says for each property of the result from which of either cloud it is; then records are converted by it.
 * Where the cloud that is there doesn't change its layout, its records stay where they are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/join.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"
#include "core/base/left_out.h"
#include "core/cloud/attribute_names.h"
#include "core/cloud/colour_depth.h"
#include "core/io/build.h"
#include "core/io/formats/las_fields.h"
#include "core/params.h"

enum { NOTE_BYTES = 256, LACKING_BYTES = 84 };

struct plan {
    size_t count;
    struct property property[CLOUD_MAX_PROPERTIES];                   /* of the result; lists' arrays aren't set */
    uint32_t left[CLOUD_MAX_PROPERTIES], right[CLOUD_MAX_PROPERTIES]; /* which of the cloud's; NONE = it has none */
    size_t record_bytes;
};

static enum status no_memory_to_join(struct error *error) {
    return error_set(error, STATUS_NO_MEMORY, "read", "no memory for clouds joined");
}

static void set_name(char to[JOIN_NAME_BYTES], const char *name) {
    const char *slash = strrchr(name, '/');
    snprintf(to, JOIN_NAME_BYTES, "%s", strcmp(name, "-") == 0 ? "standard input" : slash ? slash + 1 : name);
}

static enum status note_join(struct cloud_join *join, const char *text, struct error *error) {
    return cloud_leave_out(&join->cloud, text) ? no_memory_to_join(error) : STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ types */

static bool is_whole(enum scalar_type type) { return type < SCALAR_FLOAT32; }

/* The least type that holds all values of both. */
static enum scalar_type widest(enum scalar_type a, enum scalar_type b) {
    static const struct {
        double low, high;
    } range[] = {{INT8_MIN, INT8_MAX}, {0, UINT8_MAX},         {INT16_MIN, INT16_MAX},
                 {0, UINT16_MAX},      {INT32_MIN, INT32_MAX}, {0, UINT32_MAX}};
    if (a == b) return a;
    if (is_whole(a) && is_whole(b)) {
        double low = fmin(range[a].low, range[b].low), high = fmax(range[a].high, range[b].high);
        for (int t = SCALAR_INT8; t <= SCALAR_UINT32; t++)
            if (range[t].low <= low && range[t].high >= high) return (enum scalar_type)t;
        return SCALAR_FLOAT64;
    }
    enum scalar_type whole = is_whole(a) ? a : b, other = is_whole(a) ? b : a;
    bool fits = is_whole(whole) && whole <= SCALAR_UINT16 && other == SCALAR_FLOAT32;
    return fits ? SCALAR_FLOAT32 : SCALAR_FLOAT64;
}

static bool has_colours(const struct cloud *cloud, enum scalar_type *type) {
    const struct property *red = attribute_find(cloud, "red");
    if (red) *type = red->type;
    return red && attribute_find(cloud, "green") && attribute_find(cloud, "blue");
}

/* 255 of one cloud and 65535 of another are the same white. */
static enum status level_colours(struct cloud *a, struct cloud *b, struct error *error) {
    enum scalar_type of_a, of_b;
    if (!has_colours(a, &of_a) || !has_colours(b, &of_b) || of_a == of_b) return STATUS_OK;
    enum status status = cloud_set_colours(a, COLOURS_16, NULL, error);
    return status ? status : cloud_set_colours(b, COLOURS_16, NULL, error);
}

/* ------------------------------------------------------------------------------------------------ the plan */

static bool is_match(const struct cloud *to, size_t i, const struct cloud *from, size_t j, bool exactly) {
    int axis = cloud_axis_of(to, i), other = cloud_axis_of(from, j);
    if (axis >= 0 || other >= 0) return axis == other;
    const char *a = to->property[i].name, *b = from->property[j].name;
    return exactly ? strcmp(a, b) == 0 : attribute_is_same(a, b);
}

static bool can_join(const struct property *a, const struct property *b) {
    if (a->is_list != b->is_list) return false;
    return !a->is_list || (a->type == b->type && a->count_type == b->count_type);
}

/* Exact names come first, so that no cloud's two properties become one. */
static void match(const struct cloud *to, const struct cloud *from, struct plan *plan) {
    bool taken[CLOUD_MAX_PROPERTIES] = {false};
    for (int exactly = 1; exactly >= 0; exactly--)
        for (size_t i = 0; i < to->property_count; i++)
            for (size_t j = 0; j < from->property_count && plan->right[i] == NONE; j++)
                if (!taken[j] && is_match(to, i, from, j, exactly) && can_join(&to->property[i], &from->property[j])) {
                    plan->right[i] = (uint32_t)j;
                    taken[j] = true;
                }
}

static bool is_named(const struct plan *plan, const char *name) {
    for (size_t i = 0; i < plan->count; i++)
        if (strcmp(plan->property[i].name, name) == 0) return true;
    return false;
}

static enum status add_property(struct plan *plan, const struct property *p, uint32_t left, uint32_t right,
                                struct error *error) {
    if (plan->count == CLOUD_MAX_PROPERTIES)
        return error_set(error, STATUS_LIMIT, "properties", "more than %d properties are joined", CLOUD_MAX_PROPERTIES);
    size_t i = plan->count++;
    plan->property[i] = *p;
    plan->property[i].list_offset = NULL, plan->property[i].list_data = NULL;
    plan->left[i] = left, plan->right[i] = right;
    return STATUS_OK;
}

/* What of `from` is in no property of `to` comes behind them; of another kind under a name that is there, it stays. */
static enum status add_unmatched(struct cloud_join *join, const struct cloud *from, const char *name, struct plan *plan,
                                 struct error *error) {
    enum status status = STATUS_OK;
    size_t there = plan->count;
    for (size_t j = 0; j < from->property_count && !status; j++) {
        bool matched = false;
        for (size_t i = 0; i < there; i++) matched = matched || plan->right[i] == j;
        if (matched) continue;
        if (!is_named(plan, from->property[j].name)) {
            join->lacks[plan->count % CLOUD_MAX_PROPERTIES] = join->inputs;
            memcpy(join->lacking[plan->count % CLOUD_MAX_PROPERTIES], join->first, JOIN_NAME_BYTES);
            status = add_property(plan, &from->property[j], NONE, (uint32_t)j, error);
            continue;
        }
        char text[NOTE_BYTES];
        snprintf(text, sizeof text, "%s of %.63s: of another kind than the others'", from->property[j].name, name);
        status = note_join(join, text, error);
    }
    return status;
}

static enum status add_scan(const struct cloud_join *join, const struct cloud *from, size_t scans, struct plan *plan,
                            struct error *error) {
    const struct cloud *to = &join->cloud;
    bool wanted = to->view_count || from->view_count || attribute_find(from, CLOUD_SCAN) || is_named(plan, CLOUD_SCAN);
    struct property scan = {.name = CLOUD_SCAN, .type = SCALAR_UINT16};
    if (!wanted) return STATUS_OK;
    enum status status = is_named(plan, CLOUD_SCAN) ? STATUS_OK : add_property(plan, &scan, NONE, NONE, error);
    for (size_t i = 0; i < plan->count; i++)
        if (strcmp(plan->property[i].name, CLOUD_SCAN) == 0 && !plan->property[i].is_list)
            plan->property[i].type =
                widest(plan->property[i].type, join->scans + scans > CLOUD_SCANS_MOST ? SCALAR_UINT32 : SCALAR_UINT16);
    return status;
}

static enum status make_plan(struct cloud_join *join, const struct cloud *from, const char *name, size_t scans,
                             struct plan *plan, struct error *error) {
    const struct cloud *to = &join->cloud;
    enum status status = STATUS_OK;
    plan->count = plan->record_bytes = 0;
    for (size_t i = 0; i < to->property_count && !status; i++)
        status = add_property(plan, &to->property[i], (uint32_t)i, NONE, error);
    if (!status) match(to, from, plan);
    for (size_t i = 0; i < plan->count && !status; i++)
        if (plan->right[i] != NONE)
            plan->property[i].type = widest(plan->property[i].type, from->property[plan->right[i]].type);
    for (size_t i = 0; i < plan->count && !status; i++)
        if (plan->right[i] == NONE && join->lacks[i]++ == 0) set_name(join->lacking[i], name);
    if (!status) status = add_unmatched(join, from, name, plan, error);
    if (!status) status = add_scan(join, from, scans, plan, error);
    for (size_t i = 0; i < plan->count; i++) {
        struct property *p = &plan->property[i];
        p->offset_bytes = plan->record_bytes;
        if (!p->is_list) plan->record_bytes += scalar_bytes(p->type);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ records */

/* Writes point k of a cloud as the plan has it; the number of its scan grows by `scans`. */
static void convert(const struct plan *plan, const uint32_t *which, const struct cloud *cloud, size_t k, size_t scans,
                    unsigned char *to) {
    const unsigned char *from = cloud->record + k * cloud->record_bytes;
    for (size_t i = 0; i < plan->count; i++) {
        const struct property *p = &plan->property[i];
        const struct property *old = which[i] == NONE ? NULL : &cloud->property[which[i]];
        if (p->is_list) continue;
        if (strcmp(p->name, CLOUD_SCAN) == 0)
            scalar_store(to + p->offset_bytes, p->type,
                         (double)scans + (old ? scalar_load(from + old->offset_bytes, old->type) : 0));
        else if (!old)
            memset(to + p->offset_bytes, 0, scalar_bytes(p->type));
        else if (old->type == p->type)
            memcpy(to + p->offset_bytes, from + old->offset_bytes, scalar_bytes(p->type));
        else
            scalar_store(to + p->offset_bytes, p->type, scalar_load(from + old->offset_bytes, old->type));
    }
}

static bool is_laid_out(const struct plan *plan, const struct cloud *cloud) {
    bool same = plan->count == cloud->property_count && plan->record_bytes == cloud->record_bytes;
    for (size_t i = 0; i < plan->count && same; i++)
        same = plan->property[i].type == cloud->property[i].type &&
               (plan->property[i].is_list || plan->property[i].offset_bytes == cloud->property[i].offset_bytes);
    return same;
}

static enum status join_records(const struct plan *plan, struct cloud *to, const struct cloud *from, size_t scans) {
    size_t count = to->count + from->count, each = plan->record_bytes;
    bool stays = is_laid_out(plan, to);
    unsigned char *record = stays ? alloc_resize(to->record, count, each) : alloc_array(count, each);
    if (!record) return STATUS_NO_MEMORY;
    for (size_t k = 0; k < to->count && !stays; k++) convert(plan, plan->left, to, k, 0, record + k * each);
    for (size_t k = 0; k < from->count; k++)
        convert(plan, plan->right, from, k, scans, record + (to->count + k) * each);
    if (!stays) free(to->record);
    to->record = record;
    return STATUS_OK;
}

/* Appends the lists of `from` (NULL: empty ones) to those of a property, which may have none yet. */
static enum status join_list(struct property *to, size_t to_count, const struct property *from, size_t from_count) {
    size_t used = to->list_offset ? to->list_offset[to_count] : 0, more = from ? from->list_offset[from_count] : 0;
    bool is_new = !to->list_offset;
    size_t *offset = alloc_resize(to->list_offset, to_count + from_count + 1, sizeof *offset);
    if (!offset) return STATUS_NO_MEMORY;
    to->list_offset = offset;
    if (is_new) memset(offset, 0, (to_count + 1) * sizeof *offset);
    for (size_t k = 0; k < from_count; k++) offset[to_count + k + 1] = used + (from ? from->list_offset[k + 1] : 0);
    unsigned char *data = alloc_resize(to->list_data, used + more ? used + more : 1, 1);
    if (!data) return STATUS_NO_MEMORY;
    to->list_data = data;
    if (more) memcpy(data + used, from->list_data, more);
    return STATUS_OK;
}

/* The properties of the plan, with the lists that are there and those that are added. */
static enum status join_properties(const struct plan *plan, struct cloud *to, const struct cloud *from) {
    struct property *property = alloc_resize(to->property, plan->count, sizeof *property);
    enum status status = property ? STATUS_OK : STATUS_NO_MEMORY;
    if (status) return status;
    to->property = property;
    for (size_t i = 0; i < plan->count; i++) {
        size_t *offset = i < to->property_count ? property[i].list_offset : NULL;
        unsigned char *data = i < to->property_count ? property[i].list_data : NULL;
        property[i] = plan->property[i];
        property[i].list_offset = offset, property[i].list_data = data;
    }
    to->property_count = plan->count;
    to->record_bytes = plan->record_bytes;
    for (size_t i = 0; i < plan->count && !status; i++) {
        const struct property *more = plan->right[i] == NONE ? NULL : &from->property[plan->right[i]];
        if (property[i].is_list) status = join_list(&property[i], to->count, more, from->count);
    }
    return status;
}

static enum status join_points(const struct plan *plan, struct cloud *to, const struct cloud *from, size_t scans) {
    vec3 *position = alloc_resize(to->position, to->count + from->count, sizeof *position);
    if (!position) return STATUS_NO_MEMORY;
    to->position = position;
    memcpy(position + to->count, from->position, from->count * sizeof *position);
    enum status status = join_records(plan, to, from, scans);
    return status ? status : join_properties(plan, to, from);
}

/* ------------------------------------------------------------------------------------------------ faces, places */

static enum status join_faces(struct cloud_join *join, const struct cloud *from) {
    struct cloud *to = &join->cloud;
    bool before = to->triangle_count > 0, more = from->triangle_count > 0;
    if (join->faces_lost || (!before && !more)) return STATUS_OK;
    if (before != more) {
        join->faces_lost = true;
        free(to->triangle);
        to->triangle = NULL, to->triangle_count = 0;
        return STATUS_OK;
    }
    size_t count = to->triangle_count + from->triangle_count;
    void *grown = alloc_resize(to->triangle, count, sizeof *to->triangle);
    if (!grown) return STATUS_NO_MEMORY;
    to->triangle = grown;
    for (size_t t = 0; t < from->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            to->triangle[to->triangle_count + t][k] = from->triangle[t][k] + (uint32_t)to->count;
    to->triangle_count = count;
    return STATUS_OK;
}

/* How many scans a cloud has: 1 unless it says more. */
static size_t count_scans(const struct cloud *cloud) {
    const struct property *scan = attribute_find(cloud, CLOUD_SCAN);
    size_t count = cloud->view_count > 1 ? cloud->view_count : 1;
    for (size_t k = 0; scan && k < cloud->count; k++) {
        double number = scalar_load(cloud->record + k * cloud->record_bytes + scan->offset_bytes, scan->type);
        if (number >= (double)count && number < CLOUD_SCANS_MOST) count = (size_t)number + 1;
    }
    return count;
}

/* Places of those added behind those that are there; who has none has NAN. */
static enum status join_views(struct cloud *to, size_t to_scans, const struct cloud *from, size_t from_scans) {
    if (!to->view_count && !from->view_count) return STATUS_OK;
    vec3 *view = alloc_array(to_scans + from_scans, sizeof *view);
    if (!view) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < to_scans + from_scans; i++) view[i] = (vec3){NAN, NAN, NAN};
    if (to->view_count) memcpy(view, to->view, to->view_count * sizeof *view);
    if (from->view_count) memcpy(view + to_scans, from->view, from->view_count * sizeof *view);
    free(to->view);
    to->view = view, to->view_count = to_scans + from_scans;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ texts, systems */

/* Lines behind those that are there, unless they are the same. */
static enum status join_lines(char **to, const char *lines) {
    if (!lines || (*to && strstr(*to, lines))) return STATUS_OK;
    size_t used = *to ? strlen(*to) : 0, more = strlen(lines) + 1;
    char *grown = alloc_resize(*to, used + more, 1);
    if (!grown) return STATUS_NO_MEMORY;
    memcpy(grown + used, lines, more);
    *to = grown;
    return STATUS_OK;
}

static enum status agree_on_system(struct cloud_join *join, const struct cloud *cloud, const char *name,
                                   struct error *error) {
    char text[JOIN_SYSTEM_BYTES] = "";
    if (cloud->las) las_records_system(cloud->las, text, sizeof text);
    bool is_number = strncmp(text, "EPSG:", 5) == 0, was_number = strncmp(join->system, "EPSG:", 5) == 0;
    if (!text[0] || (join->system[0] && is_number != was_number)) join->untold++;
    if (!text[0] || strcmp(text, join->system) == 0) return STATUS_OK;
    if (join->system[0] && is_number == was_number) {
        char base[JOIN_NAME_BYTES];
        set_name(base, name);
        return error_set(
            error, STATUS_MALFORMED, "join",
            "%.63s is in the coordinate system %.60s, and %.63s in %.60s; use clouds of one system, or PLY "
            "where these are the same",
            base, text, join->system_of, join->system);
    }
    if (was_number) return STATUS_OK;
    memcpy(join->system, text, sizeof text);
    set_name(join->system_of, name);
    return STATUS_OK;
}

static bool is_field_same(const struct las_field *a, const struct las_field *b, bool scaled) {
    bool same = strcmp(a->name, b->name) == 0 && a->type == b->type && a->offset == b->offset && a->shift == b->shift &&
                a->bits == b->bits && a->scaled == b->scaled;
    return same && (!scaled || !a->scaled || (a->scale == b->scale && a->add == b->add));
}

static bool has_same_fields(const struct cloud_las *a, const struct cloud_las *b) {
    bool same = a->format == b->format && a->record_bytes == b->record_bytes && a->field_count == b->field_count;
    for (size_t i = 0; i < a->field_count && same; i++) same = is_field_same(&a->field[i], &b->field[i], i >= 3);
    return same;
}

/* The finer of two scales, that of the first cloud where they are equal. */
static void take_finer(struct cloud_las *to, const struct cloud_las *from) {
    for (size_t i = 0; i < 3; i++)
        if (from->field[i].scale < to->field[i].scale) to->field[i].scale = from->field[i].scale;
}

/* What the records say of a coordinate system, as LAS of no format of its own. */
static enum status keep_system(struct cloud *cloud, struct cloud_las *las) {
    struct cloud_las *kept = alloc_array(1, sizeof *kept + las->records_bytes);
    if (!kept) return STATUS_NO_MEMORY;
    *kept = (struct cloud_las){.has_crs = las->has_crs, .source = las->source};
    for (size_t at = 0; at < las->records_bytes;) {
        const unsigned char *vlr = las->records + at;
        size_t whole = LAS_VLR_BYTES + (size_t)load_little_endian(vlr + 20, 2);
        at += whole;
        if (strncmp((const char *)vlr + 2, "LASF_Projection", 16) != 0) continue;
        memcpy(kept->records + kept->records_bytes, vlr, whole);
        kept->records_bytes += whole;
        kept->record_count++;
    }
    free(cloud->las);
    cloud->las = NULL;
    if (kept->has_crs)
        cloud->las = kept;
    else
        free(kept);
    return STATUS_OK;
}

static enum status join_las(struct cloud *to, struct cloud *from) {
    if (!to->las && !from->las) return STATUS_OK;
    if (to->las && from->las && has_same_fields(to->las, from->las) && to->las->field_count) {
        take_finer(to->las, from->las);
        return STATUS_OK;
    }
    return keep_system(to, to->las && to->las->has_crs ? to->las : from->las ? from->las : to->las);
}

/* Coordinates from the middle, and coarser ones, where the first cloud's don't reach them all. */
static void reach_all(struct cloud *cloud) {
    static const double WIDEST = 2e9;
    for (size_t axis = 0; axis < 3; axis++) {
        struct las_field *field = &cloud->las->field[axis];
        double low = INFINITY, high = -INFINITY;
        for (size_t k = 0; k < cloud->count; k++) {
            double value = (&cloud->position[k].x)[axis];
            low = fmin(low, value), high = fmax(high, value);
        }
        if (fmax(fabs(low - field->add), fabs(high - field->add)) <= WIDEST * field->scale) continue;
        field->add = floor(low / 2 + high / 2);
        while (fmax(fabs(low - field->add), fabs(high - field->add)) > WIDEST * field->scale) field->scale *= 10;
    }
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status add_next(struct cloud_join *join, struct cloud *from, const char *name, struct error *error) {
    struct cloud *to = &join->cloud;
    size_t scans = count_scans(from);
    if ((uint64_t)to->count + from->count >= NONE)
        return error_set(error, STATUS_LIMIT, "points", "more than %" PRIu32 " points are joined", NONE - 1);
    struct plan *plan = alloc_array(1, sizeof *plan);
    if (!plan) return no_memory_to_join(error);
    enum status status = level_colours(to, from, error);
    if (!status) status = make_plan(join, from, name, scans, plan, error);
    if (!status && (join_faces(join, from) || join_las(to, from) || join_views(to, join->scans, from, scans) ||
                    join_lines(&to->comments, from->comments) || join_lines(&to->left_out, from->left_out) ||
                    join_points(plan, to, from, join->scans)))
        status = no_memory_to_join(error);
    if (!status) to->count += from->count;
    if (!status && strcmp(to->form, from->form) != 0) to->form = "several";
    if (!status && to->up != from->up) to->up = UP_AUTO;
    join->scans += scans;
    free(plan);
    return status;
}

enum status cloud_join_add(struct cloud_join *join, struct cloud *cloud, const char *name, struct error *error) {
    struct cloud from = *cloud;
    *cloud = (struct cloud){0};
    enum status status = agree_on_system(join, &from, name, error);
    if (!status && join->inputs) {
        status = add_next(join, &from, name, error);
        cloud_done(&from);
    } else if (!status) {
        join->cloud = from;
        join->scans = count_scans(&from);
        set_name(join->first, name);
    } else {
        cloud_done(&from);
    }
    join->inputs += !status;
    return status;
}

/* Whether property j is to be told of, and lacked by the same inputs as property i. */
static bool is_lacked_alike(const struct cloud_join *join, size_t i, size_t j) {
    return join->lacks[j] && strcmp(join->cloud.property[j].name, CLOUD_SCAN) != 0 &&
           strcmp(join->lacking[i], join->lacking[j]) == 0 && (join->lacks[i] > 1) == (join->lacks[j] > 1);
}

/* "c.ply and others have no intensity, gps_time: 0 there" */
static enum status note_lacking(struct cloud_join *join, size_t i, struct error *error) {
    char names[NOTE_BYTES / 2] = "", text[NOTE_BYTES];
    size_t used = 0;
    for (size_t j = i; j < join->cloud.property_count; j++) {
        const char *name = join->cloud.property[j].name;
        if (!is_lacked_alike(join, i, j)) continue;
        bool fits = used + strlen(name) + 8 < LACKING_BYTES;
        used += (size_t)snprintf(names + used, sizeof names - used, "%s%s", used ? ", " : "", fits ? name : "...");
        if (!fits) break;
    }
    snprintf(text, sizeof text, "%.48s %s no %s: 0 there", join->lacking[i],
             join->lacks[i] > 1 ? "and others have" : "has", names);
    return note_join(join, text, error);
}

static enum status note_all(struct cloud_join *join, struct error *error) {
    enum status status = STATUS_OK;
    char text[NOTE_BYTES];
    for (size_t i = 0; i < join->cloud.property_count && !status; i++) {
        bool told = !is_lacked_alike(join, i, i);
        for (size_t j = 0; j < i && !told; j++) told = is_lacked_alike(join, i, j);
        if (!told) status = note_lacking(join, i, error);
    }
    if (!status && join->faces_lost) status = note_join(join, "faces: only some of the inputs have them", error);
    if (status || !join->system[0] || !join->untold) return status;
    snprintf(text, sizeof text,
             LEFT_OUT_NOTE "coordinate system: %.60s is taken for that of all; inputs that don't say so: %zu",
             join->system, join->untold);
    return note_join(join, text, error);
}

enum status cloud_join_end(struct cloud_join *join, struct cloud *cloud, struct error *error) {
    enum status status = join->inputs > 1 ? note_all(join, error) : STATUS_OK;
    if (!status && join->inputs > 1 && join->cloud.las && join->cloud.las->field_count) reach_all(&join->cloud);
    if (!status) {
        *cloud = join->cloud;
        join->cloud = (struct cloud){0};
    }
    cloud_join_done(join);
    return status;
}

void cloud_join_done(struct cloud_join *join) {
    if (!join) return;
    cloud_done(&join->cloud);
    *join = (struct cloud_join){0};
}
