/* The peak of a job as a table of its stages.
 *
 * Nearly all memory is in arrays with an entry for each point, so what is held during a stage is a sum of
 *
 *     HELD     by every stage once points are in order: records, coordinates, the points along the curve
 *     point    bytes of the stage and of what others left for later ones, for each input point
 *     near     the same for each point and each neighbour that it may have
 *     kept     for each point that is kept
 *     face     for each triangle of the input
 *
 * and the peak is the largest of them, with a margin.  The figures are sizes of the arrays where those are ours, and
 * measured where they aren't (FLANN, CGAL); the test measures them all again.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/memory.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "core/cloud_sniff.h"
#include "core/little.h"
#include "core/neighbourhood.h"
#include "core/pcd_header.h"
#include "core/ply_header.h"

static const double PROGRAM = 5.6e6; /* the program, its libraries, stacks and buffers */
static const double MARGIN = 1.05, KEPT_MARGIN = 1.16;
enum { POSITION = 24, TRIANGLE = 12, HELD = 32 };

static bool refined(const struct params *p) { return params_want_mesh(p) && p->refine != REFINE_NONE; }
static bool refined_closely(const struct params *p) { return refined(p) && p->placement == PLACEMENT_OPTIMAL; }
static bool denoised(const struct params *p) { return p->denoise != DENOISE_NONE; }
static bool cloud_alone(const struct params *p) { return !params_want_mesh(p); }
static bool reconstructed_whole(const struct params *p) {
    return params_want_mesh(p) && p->reference == REFERENCE_RECONSTRUCTION;
}
static bool painted(const struct params *p) { return p->outputs & (OUTPUT_DSO | OUTPUT_ERROR); }

static const struct stage {
    const char *name;
    bool (*wanted)(const struct params *params);
    double point, near, kept, face;
} stages[] = {
    {"denoise", denoised, 470, 0, 0, 0},
    {"join", cloud_alone, 94, 9, 0, 0},
    {"contract", cloud_alone, 124, 7, 0, 0},
    {"tangent", cloud_alone, 40, 0, 70, 0},
    {"join", params_want_mesh, 130, 9, 0, 0},
    {"contract", params_want_mesh, 165, 11, 0, 0},
    {"delaunay", params_want_mesh, 81, 4, 1350, 0},
    {"umbrellas", refined, 135, 4, 1350, 0},
    {"refine", refined, 400, 4, 800, 0},
    {"closer", refined_closely, 950, 4, 1300, 0},
    {"measure", params_want_mesh, 105, 4, 300, 160},
    {"reference", reconstructed_whole, 1350, 4, 150, 0},
    {"paint", painted, 160, 4, 200, 0},
};
/* Samples that are made beside Delaunay are 178 for each point more, and umbrellas gone by then: up to a quarter of the
 * points, that is less than "refine" (pipeline_mesh.c). */
enum { STAGES = sizeof stages / sizeof stages[0] };

/* The most neighbours of a point, in a noisy cloud. */
static double most_neighbours(const struct params *params) {
    return neighbourhood_noisy_count((unsigned)params->neighbours_max);
}

static double kept_points(const struct memory_job *job, const struct params *params) {
    double points = (double)job->points, ratio = params->levels.count ? params->levels.ratio[0] : params->ratio;
    for (uint32_t i = 1; i < params->levels.count; i++) ratio = fmax(ratio, params->levels.ratio[i]);
    if (!isnan(params->max_error)) return points;
    if (params->points) return fmin(points, (double)params->points);
    return isnan(ratio) ? points : ratio * points;
}

/* What all levels leave behind: meshes. */
static double results(const struct memory_job *job, const struct params *params) {
    double points = (double)job->points, bytes = 0;
    for (uint32_t i = 0; i < params->levels.count; i++) bytes += params->levels.ratio[i] * points;
    if (params->levels.count == 0) bytes = kept_points(job, params);
    return params_want_mesh(params) ? 60 * bytes : 0;
}

uint64_t memory_predict(const struct memory_job *job, const struct params *params) {
    double points = (double)job->points, faces = (double)job->faces, kept = kept_points(job, params);
    double cloud = points * (POSITION + (double)job->record_bytes) + faces * TRIANGLE;
    if (params->denoise == DENOISE_FULL) cloud += points * POSITION;
    double peak = cloud + (double)job->input_bytes;
    for (int i = 0; i < STAGES; i++) {
        const struct stage *s = &stages[i];
        if (!s->wanted(params)) continue;
        double each = HELD + s->point + s->near * most_neighbours(params);
        peak = fmax(peak, cloud + points * each + kept * s->kept + faces * s->face);
    }
    double margin = memory_is_kept(job->points, params) ? KEPT_MARGIN : MARGIN;
    peak = PROGRAM + margin * (peak + results(job, params));
    return peak < 0x1p64 ? (uint64_t)peak : UINT64_MAX;
}

/* ------------------------------------------------------------------------------------------------ what comes */

static enum status job_of_ply(const void *bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    struct ply_summary summary;
    struct error ignored;
    enum status status = ply_header_check(bytes, n, total_bytes, &summary, &ignored);
    if (status) return status;
    if (!summary.complete) return STATUS_MALFORMED;
    *job = (struct memory_job){summary.vertex_count, summary.record_bytes, summary.face_count, total_bytes};
    return STATUS_OK;
}

static bool is_blank(char c) { return c == ' ' || c == '\t' || c == ',' || c == ';' || c == '\r' || c == '\n'; }

/* Each word becomes a double; a line is as long as those that are there.  Lines longer than any point's hold many. */
static void job_of_text(const char *text, size_t n, uint64_t total_bytes, struct memory_job *job) {
    double lines = 0, words = 0;
    for (size_t i = 0; i < n; i++) {
        lines += text[i] == '\n' || (text[i] == '\r' && (i + 1 == n || text[i + 1] != '\n'));
        words += !is_blank(text[i]) && (i + 1 == n || is_blank(text[i + 1]));
    }
    if (lines < 1) lines = 1;
    if (words > lines * CLOUD_MAX_PROPERTIES) lines = words / 3;
    *job = (struct memory_job){.points = (uint64_t)(1.1 * lines / (double)n * (double)total_bytes) + 1,
                               .record_bytes = sizeof(double) * (uint64_t)ceil(words / lines),
                               .input_bytes = total_bytes};
}

/* Lines of a mesh are points or faces: each is counted as both. */
static void job_of_mesh_text(const char *text, size_t n, uint64_t total_bytes, struct memory_job *job) {
    job_of_text(text, n, total_bytes, job);
    job->faces = job->points;
}

/* A scalar of PCD may become one as large, or three bytes of a colour; compressed data is there unpacked, too. */
static enum status job_of_pcd(const void *bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    struct pcd_header header;
    struct error ignored;
    enum status status = pcd_header_parse(bytes, n, &header, &ignored);
    if (status) return status;
    *job = (struct memory_job){header.points, header.record_bytes, 0, total_bytes};
    if (header.data == PCD_COMPRESSED) job->input_bytes += header.points * header.record_bytes;
    return STATUS_OK;
}

/* Coordinates become double, and the three bytes of bit fields eight of their own. */
static enum status job_of_las(const unsigned char *bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    enum { COUNT = 107, RECORD_BYTES = 105, LONG_COUNT = 247, LEAST_BYTES = 255, GROWS_BY = 24 };
    if (n < LEAST_BYTES) return STATUS_MALFORMED;
    uint64_t points = little_load(bytes + COUNT, 4);
    if (bytes[25] >= 4 && little_load(bytes + LONG_COUNT, 8)) points = little_load(bytes + LONG_COUNT, 8);
    *job = (struct memory_job){points, little_load(bytes + RECORD_BYTES, 2) + GROWS_BY, 0, total_bytes};
    return STATUS_OK;
}

/* A closed surface has half as many points as facets; twice that is counted, and the table that joins corners. */
static void job_of_stl(const unsigned char *bytes, uint64_t total_bytes, struct memory_job *job) {
    enum { COUNT = 80, RECORD_BYTES = 12, TABLE_BYTES = 16 };
    uint64_t facets = little_load(bytes + COUNT, 4);
    *job = (struct memory_job){facets, RECORD_BYTES + TABLE_BYTES, facets, total_bytes};
}

enum status memory_job_of(const void *first_bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    struct cloud_guess guess = cloud_sniff(first_bytes, n);
    switch (guess.kind) {
    case CLOUD_KIND_PLY: return job_of_ply(first_bytes, n, total_bytes, job);
    case CLOUD_KIND_PCD: return job_of_pcd(first_bytes, n, total_bytes, job);
    case CLOUD_KIND_LAS: return job_of_las(first_bytes, n, total_bytes, job);
    case CLOUD_KIND_TEXT: job_of_text(first_bytes, n, total_bytes, job); return STATUS_OK;
    case CLOUD_KIND_OBJ:
    case CLOUD_KIND_OFF: job_of_mesh_text(first_bytes, n, total_bytes, job); return STATUS_OK;
    case CLOUD_KIND_STL:
        if (strcmp(guess.format, "stl/ascii") == 0)
            job_of_mesh_text(first_bytes, n, total_bytes, job);
        else
            job_of_stl(first_bytes, total_bytes, job);
        return STATUS_OK;
    case CLOUD_KIND_EMPTY: return STATUS_MALFORMED;
    default: return STATUS_UNSUPPORTED;
    }
}
