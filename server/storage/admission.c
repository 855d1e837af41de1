/* Admission by prediction.
 *
 * The number of points of a text is a guess from its first lines (core/pipeline/memory.h, which guesses on the high
 * side), so for the limit of points a fifth is taken off: nobody is refused for a guess that is a little too high.
 * What is compressed is looked at through its first bytes, decompressed: a header there is as good as any other, but
 * how long a text becomes is guessed from how much the beginning has grown, and nobody is refused for that.  Memory is
 * what core/pipeline/memory.h predicts for the job; a refusal says what would fit, a smaller part to keep or a smaller
 * cloud.  What parameters name and the header of a PLY hasn't is refused, as the job would be.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/admission.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/select.h"
#include "core/io/codec/inflate.h"
#include "core/io/formats/ply_header.h"
#include "core/io/sniff.h"
#include "core/pipeline/memory.h"
#include "core/tiles/fit.h"

enum { STEPS = 40, HEAD_BYTES = 64 * 1024 };
static const double SMALLEST_RATIO = 0.001;

static uint64_t sure_points(const struct memory_job *job, bool is_text) {
    return is_text ? job->points - job->points / 5 : job->points;
}

static bool refuse_points(const struct admission *admission, uint64_t points, struct problem *problem) {
    problem_set(problem, PROBLEM_TOO_MANY_POINTS, "the cloud has %llu points, more than %llu",
                (unsigned long long)points, (unsigned long long)admission->max_points);
    problem_add_number(problem, "limit", (int64_t)admission->max_points);
    problem_add_number(problem, "actual", (int64_t)points);
    problem_add_text(problem, "hint", "thin the cloud out first, or send parts of it");
    return false;
}

/* What the job takes with a part of the points, keeping a part of those. */
static uint64_t predict(const struct admission *admission, const struct memory_job *job, double part, double ratio) {
    struct memory_job less = *job;
    struct params params = admission->params;
    less.points = (uint64_t)((double)job->points * part);
    less.faces = (uint64_t)((double)job->faces * part);
    less.input_bytes = (uint64_t)((double)job->input_bytes * part);
    if (ratio > 0) params.ratio = ratio, params.points = 0, params.levels.count = 0;
    return memory_predict(&less, &params);
}

/* The largest x in (0, 1) with which the job fits, as the part of the points or, of all, as the ratio; 0: none. */
static double largest(const struct admission *admission, const struct memory_job *job, bool as_ratio) {
    double low = 0, high = 1;
    for (int i = 0; i < STEPS; i++) {
        double x = (low + high) / 2;
        uint64_t bytes = as_ratio ? predict(admission, job, 1, x) : predict(admission, job, x, 0);
        *(bytes <= admission->max_memory_bytes ? &low : &high) = x;
    }
    return low;
}

static void put_hint(const struct admission *admission, const struct memory_job *job, char *hint, size_t bytes) {
    double ratio = largest(admission, job, true), part = largest(admission, job, false);
    if (ratio >= SMALLEST_RATIO)
        snprintf(hint, bytes, "ratio=%.3f would fit", floor(ratio * 1000) / 1000);
    else
        snprintf(hint, bytes, "about %llu points would fit: thin the cloud out first, or leave the mesh out",
                 (unsigned long long)(part * (double)job->points));
}

static bool refuse_memory(const struct admission *admission, const struct memory_job *job, uint64_t bytes,
                          struct problem *problem) {
    char hint[PROBLEM_TEXT_BYTES];
    put_hint(admission, job, hint, sizeof hint);
    problem_set(problem, PROBLEM_WOULD_EXCEED_MEMORY, "the job would take about %llu MiB, and may take %llu",
                (unsigned long long)(bytes >> 20), (unsigned long long)(admission->max_memory_bytes >> 20));
    problem_add_number(problem, "limit", (int64_t)admission->max_memory_bytes);
    problem_add_number(problem, "actual", bytes > INT64_MAX ? INT64_MAX : (int64_t)bytes);
    problem_add_text(problem, "hint", hint);
    return false;
}

/* ------------------------------------------------------------------------------------------------ the first bytes */

/* The beginning of a cloud: as it is, or decompressed. */
struct beginning {
    const void *bytes;
    size_t n;
    uint64_t total_bytes;
    unsigned char *inflated; /* owned; NULL: it isn't compressed */
};

static struct beginning begin(const void *first_bytes, size_t n, uint64_t total_bytes) {
    struct beginning beginning = {.bytes = first_bytes, .n = n, .total_bytes = total_bytes};
    enum inflate_kind kind;
    if (!inflate_sniff(first_bytes, n, &kind)) return beginning;
    beginning.bytes = beginning.inflated = alloc_array(HEAD_BYTES, 1);
    beginning.n = beginning.inflated
                      ? inflate_beginning(kind, first_bytes, n, beginning.inflated, HEAD_BYTES, &beginning.total_bytes)
                      : 0;
    return beginning;
}

/* ------------------------------------------------------------------------------------------------ what there is */

/* What the job would fail for as soon as it knows what a cloud of these properties and faces holds. */
static enum status check_names(const struct params *params, const struct cloud *cloud, bool has_faces,
                               struct error *error) {
    enum status status = select_check_names(cloud, params, error);
    if (status || has_faces || !params_want_mesh(params)) return status;
    if (params->surface == SURFACE_GIVEN)
        return error_set(error, STATUS_BAD_PARAMETER, "surface",
                         "given: the input has no faces; leave it out, and the surface is reconstructed");
    if (params->reference == REFERENCE_FACES)
        return error_set(error, STATUS_BAD_PARAMETER, "reference", "faces: the input has no faces");
    return STATUS_OK;
}

/* Whether the header of a PLY, which is the only one that tells all of it, has what the parameters name. */
static bool has_what_is_named(const struct params *params, const struct beginning *beginning, struct problem *problem) {
    struct ply_header header;
    struct error error = {0};
    bool is_ply = cloud_sniff(beginning->bytes, beginning->n).kind == CLOUD_KIND_PLY, has_faces = false;
    if (!is_ply || ply_header_parse(beginning->bytes, beginning->n, &header, &error) != STATUS_OK) return true;
    const struct ply_element *vertex = &header.element[header.vertex];
    const struct cloud cloud = {.property = header.property + vertex->first, .property_count = vertex->property_count};
    for (size_t i = 0; i < header.element_count && !has_faces; i++)
        has_faces = strcmp(header.element[i].name, "face") == 0;
    enum status status = check_names(params, &cloud, has_faces, &error);
    ply_header_done(&header);
    if (status) problem_from_error(problem, &error);
    return !status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

/* What is known of the job; *guessed: only by how long the cloud seems to become.  false: nothing. */
static bool read_job(const struct beginning *beginning, struct memory_job *job, bool *guessed) {
    enum cloud_kind kind = cloud_sniff(beginning->bytes, beginning->n).kind;
    bool has_header = kind == CLOUD_KIND_PLY || kind == CLOUD_KIND_PCD || kind == CLOUD_KIND_LAS;
    bool packed = beginning->inflated, known = beginning->total_bytes != UINT64_MAX;
    uint64_t total_bytes = packed && has_header ? UINT64_MAX : beginning->total_bytes;
    *guessed = (packed && !has_header) || kind == CLOUD_KIND_TAR;
    if (!known && kind == CLOUD_KIND_TEXT) return false;
    if (memory_job_of(beginning->bytes, beginning->n, total_bytes, job) != STATUS_OK) return false;
    if (packed || !known) job->input_bytes = known ? beginning->total_bytes : 0;
    return true;
}

/* Whether the job can be done in tiles, each within the limit: what is read part by part, compressed or not. */
static bool fits_in_tiles(const struct admission *admission, const struct beginning *beginning,
                          const struct memory_job *job) {
    struct params params = admission->params;
    struct error ignored;
    enum cloud_kind kind = cloud_sniff(beginning->bytes, beginning->n).kind;
    bool in_parts = cloud_kind_has_parts(kind);
    params.memory_bytes = admission->max_memory_bytes;
    return in_parts && tiles_can(&params, &ignored) == STATUS_OK &&
           fit_kept(&params, job->points, job->record_bytes, fit_room(&params), &ignored) == STATUS_OK;
}

static bool check(const struct admission *admission, const struct beginning *beginning, struct admitted *admitted,
                  struct problem *problem) {
    struct memory_job job;
    bool guessed;
    if (!read_job(beginning, &job, &guessed)) return true;
    bool is_text = cloud_sniff(beginning->bytes, beginning->n).kind == CLOUD_KIND_TEXT;
    uint64_t points = sure_points(&job, is_text), most = admission->max_memory_bytes;
    if (points > admission->max_points && !guessed) return refuse_points(admission, points, problem);
    if (!admission->has_params) return true;
    if (!has_what_is_named(&admission->params, beginning, problem)) return false;
    uint64_t bytes = memory_predict(&job, &admission->params);
    admitted->in_tiles = bytes > most && fits_in_tiles(admission, beginning, &job);
    bool fits = bytes <= most || guessed || admitted->in_tiles;
    admitted->memory_bytes = fits && bytes > most ? most : bytes;
    return fits || refuse_memory(admission, &job, bytes, problem);
}

bool admission_check(const struct admission *admission, const void *first_bytes, size_t n, uint64_t total_bytes,
                     struct admitted *admitted, struct problem *problem) {
    *admitted = (struct admitted){0};
    struct beginning beginning = begin(first_bytes, n, total_bytes);
    bool fits = check(admission, &beginning, admitted, problem);
    free(beginning.inflated);
    return fits;
}

uint64_t admission_most(const struct admission *admission, const void *first_bytes, size_t n, uint64_t total_bytes) {
    struct beginning beginning = begin(first_bytes, n, total_bytes);
    struct memory_job job;
    bool guessed;
    uint64_t most = 0;
    if (read_job(&beginning, &job, &guessed)) most = memory_predict_most(&job, &admission->params);
    free(beginning.inflated);
    return most < admission->max_memory_bytes ? most : admission->max_memory_bytes;
}

void admission_advise(const struct admission *admission, const void *first_bytes, size_t n, uint64_t total_bytes,
                      char *advice, size_t bytes) {
    struct beginning beginning = begin(first_bytes, n, total_bytes);
    struct memory_job job;
    bool guessed;
    snprintf(advice, bytes, "a smaller cloud, or no mesh, takes less");
    if (read_job(&beginning, &job, &guessed)) {
        struct admission less = *admission;
        uint64_t predicted = memory_predict(&job, &admission->params);
        if (predicted < less.max_memory_bytes) less.max_memory_bytes = predicted;
        less.max_memory_bytes -= less.max_memory_bytes / 4;
        put_hint(&less, &job, advice, bytes);
    }
    free(beginning.inflated);
}
