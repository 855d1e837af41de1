/* Options, the call itself, and what came of it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/select.h"
#include "core/library/handles.h"
#include "core/pipeline/memory.h"

/* ---------------------------------------------------------------------------------------------------- options */

struct whittle_options *whittle_options_new(void) {
    struct whittle_options *options = alloc_zeroed(1, sizeof *options);
    if (options) params_defaults(&options->params);
    return options;
}

void whittle_options_free(struct whittle_options *options) { free(options); }

enum whittle_status whittle_options_set(struct whittle_options *options, const char *name, const char *value,
                                        struct whittle_error *error) {
    struct error inner = {0};
    return library_status(params_set(&options->params, name, value, &inner), &inner, error);
}

void whittle_options_set_memory(struct whittle_options *options, uint64_t bytes) {
    options->params.memory_bytes = bytes;
}

int whittle_option_at(size_t i, struct whittle_option *option) {
    size_t count;
    const struct param *table = params_table(&count);
    if (i >= count) return 0;
    *option = (struct whittle_option){table[i].name, table[i].default_text, table[i].unit, table[i].help};
    return 1;
}

void whittle_option_allowed(size_t i, char *text, size_t text_bytes) {
    size_t count;
    const struct param *table = params_table(&count);
    if (text_bytes) text[0] = 0;
    if (i < count) params_allowed(&table[i], text, text_bytes);
}

/* ---------------------------------------------------------------------------------------------------- the call */

/* The parameters that the options stand for; defaults where there are none. */
static enum status resolve(const struct whittle_options *options, struct params *params, struct error *error) {
    params_defaults(params);
    if (options) *params = options->params;
    return params_resolve(params, error);
}

/* Copies what stages look at of the points with these ids: positions, records, and the triangles between them.  Lists
 * are none of it.  The properties stay borrowed. */
static enum status part_of(const struct cloud *cloud, const uint32_t *id, const uint32_t *new_id, struct cloud *part) {
    size_t each = cloud->record_bytes;
    part->position = alloc_array(part->count, sizeof *part->position);
    part->record = alloc_array(part->count, each);
    part->triangle = cloud->triangle_count ? alloc_array(cloud->triangle_count, sizeof *part->triangle) : NULL;
    if (!part->position || !part->record || (cloud->triangle_count && !part->triangle)) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < part->count; i++) {
        part->position[i] = cloud->position[id[i]];
        memcpy(part->record + i * each, cloud->record + id[i] * each, each);
    }
    part->triangle_count = 0;
    for (size_t t = 0; t < cloud->triangle_count; t++) {
        uint32_t v[3];
        for (int k = 0; k < 3; k++) v[k] = new_id[cloud->triangle[t][k]];
        if (v[0] != NONE && v[1] != NONE && v[2] != NONE) memcpy(part->triangle[part->triangle_count++], v, sizeof v);
    }
    return STATUS_OK;
}

/* Values of a part, `each` for each point, as those of the whole, which has 0 elsewhere; the part's are freed. */
static enum status spread(size_t count, const uint32_t *id, size_t n, size_t each, float **value) {
    float *whole = *value ? alloc_zeroed(count, each * sizeof *whole) : NULL;
    if (*value && !whole) return STATUS_NO_MEMORY;
    for (size_t i = 0; whole && i < n; i++) memcpy(&whole[each * id[i]], &(*value)[each * i], each * sizeof *whole);
    free(*value);
    *value = whole;
    return STATUS_OK;
}

/* What came of a part, in terms of the whole. */
static enum status translate(const struct cloud *cloud, const uint32_t *id, size_t n, struct pipeline_result *made) {
    for (size_t i = 0; i < made->level[0].kept_count; i++) made->kept[i] = id[made->kept[i]];
    for (size_t l = 0; l < made->level_count; l++) {
        const struct mesh *mesh = &made->level[l].mesh;
        for (size_t v = 0; v < mesh->vertex_count; v++)
            if (mesh->source[v] != NONE) mesh->source[v] = id[mesh->source[v]];
    }
    vec3 *moved = made->moved ? alloc_array(cloud->count, sizeof *moved) : NULL;
    if (made->moved && !moved) return STATUS_NO_MEMORY;
    if (moved) {
        memcpy(moved, cloud->position, cloud->count * sizeof *moved);
        for (size_t i = 0; i < n; i++) moved[id[i]] = made->moved[i];
        free(made->moved);
        made->moved = moved;
    }
    float *normal = (float *)(void *)made->normal;
    enum status status = spread(cloud->count, id, n, 3, &normal);
    made->normal = (float(*)[3])(void *)normal;
    if (!status) status = spread(cloud->count, id, n, 1, &made->dso);
    return status ? status : spread(cloud->count, id, n, 1, &made->distance);
}

/* Runs with the points that crop and where leave. */
static enum status run_selected(const struct cloud *cloud, const struct params *params, const struct progress *progress,
                                struct pipeline_result *made, struct error *error) {
    struct selection selection = {0};
    struct cloud part = *cloud;
    size_t n = 0;
    uint8_t *kept = alloc_array(cloud->count, sizeof *kept);
    uint32_t *id = alloc_array(cloud->count, sizeof *id), *new_id = alloc_array(cloud->count, sizeof *new_id);
    part.position = NULL, part.record = NULL, part.triangle = NULL;
    enum status status = kept && id && new_id ? select_points(cloud, params, kept, &selection, error)
                                              : error_set(error, STATUS_NO_MEMORY, "crop", "no memory for the points");
    for (uint32_t i = 0; !status && i < cloud->count; i++) {
        new_id[i] = kept[i] ? (uint32_t)n : NONE;
        if (kept[i]) id[n++] = i;
    }
    part.count = n;
    if (!status && part_of(cloud, id, new_id, &part))
        status = error_set(error, STATUS_NO_MEMORY, "crop", "no memory for the points");
    if (!status) status = pipeline_run(&part, params, progress, made, error);
    if (!status && translate(cloud, id, n, made)) {
        pipeline_result_done(made);
        status = error_set(error, STATUS_NO_MEMORY, "crop", "no memory for the points");
    }
    if (!status) made->report.points_cropped = selection.cropped, made->report.points_filtered = selection.filtered;
    free(kept), free(id), free(new_id);
    free(part.position), free(part.record), free(part.triangle);
    return status;
}

uint64_t whittle_memory(uint64_t points, uint64_t record_bytes, const struct whittle_options *options) {
    struct params params;
    if (resolve(options, &params, NULL)) return UINT64_MAX;
    return memory_predict(&(struct memory_job){.points = points, .record_bytes = record_bytes}, &params);
}

enum whittle_status whittle_simplify(const struct whittle_cloud *cloud, const struct whittle_options *options,
                                     const struct whittle_progress *progress, struct whittle_result **result,
                                     struct whittle_error *error) {
    struct error inner = {0};
    struct progress tick;
    struct params params;
    enum status status = resolve(options, &params, &inner);
    if (!status && cloud->cloud.triangle_count) params.outputs |= OUTPUT_CLOUD; /* kept points are there always */
    struct whittle_result *made = status ? NULL : alloc_zeroed(1, sizeof *made);
    if (!status && !made) status = error_set(&inner, STATUS_NO_MEMORY, "result", "no memory for the result");
    if (!status)
        status = (select_is_asked(&params) ? run_selected : pipeline_run)(
            &cloud->cloud, &params, library_progress(progress, &tick), &made->made, &inner);
    if (status) {
        free(made);
        return library_status(status, &inner, error);
    }
    made->input = cloud;
    *result = made;
    return WHITTLE_OK;
}

/* ---------------------------------------------------------------------------------------------------- the result */

void whittle_result_free(struct whittle_result *result) {
    if (!result) return;
    pipeline_result_done(&result->made);
    free(result);
}

size_t whittle_result_levels(const struct whittle_result *result) { return result->made.level_count; }

const uint32_t *whittle_result_kept(const struct whittle_result *result, size_t level, size_t *count) {
    *count = level < result->made.level_count ? result->made.level[level].kept_count : 0;
    return *count ? result->made.kept : NULL;
}

const double *whittle_result_moved(const struct whittle_result *result) {
    return (const double *)(const void *)result->made.moved;
}

static const struct mesh *mesh_of(const struct whittle_result *result, size_t level) {
    static const struct mesh none = {0};
    return level < result->made.level_count ? &result->made.level[level].mesh : &none;
}

const double *whittle_result_vertices(const struct whittle_result *result, size_t level, size_t *count) {
    const struct mesh *mesh = mesh_of(result, level);
    *count = mesh->vertex_count;
    return (const double *)(const void *)mesh->vertex;
}

const uint32_t *whittle_result_triangles(const struct whittle_result *result, size_t level, size_t *count) {
    const struct mesh *mesh = mesh_of(result, level);
    *count = mesh->triangle_count;
    return (const uint32_t *)(const void *)mesh->triangle;
}

const uint32_t *whittle_result_sources(const struct whittle_result *result, size_t level) {
    return mesh_of(result, level)->source;
}

const float *whittle_result_normals(const struct whittle_result *result) {
    return (const float *)(const void *)result->made.normal;
}

const float *whittle_result_operator(const struct whittle_result *result) { return result->made.dso; }

const float *whittle_result_distances(const struct whittle_result *result) { return result->made.distance; }
