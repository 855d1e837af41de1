/* Options, the call itself, and what came of it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>

#include "core/base/alloc.h"
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
    struct whittle_result *made = status ? NULL : alloc_zeroed(1, sizeof *made);
    if (!status && !made) status = error_set(&inner, STATUS_NO_MEMORY, "result", "no memory for the result");
    if (!status) status = pipeline_run(&cloud->cloud, &params, library_progress(progress, &tick), &made->made, &inner);
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

const float *whittle_result_operator(const struct whittle_result *result) { return result->made.dso; }

const float *whittle_result_distances(const struct whittle_result *result) { return result->made.distance; }
