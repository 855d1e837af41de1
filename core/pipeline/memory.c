/* The peak of a job as a table of its stages.
 *
 * Nearly all memory is in arrays with an entry for each point, so what is held during a stage is a sum of
 *
 *     HELD     by every stage once points are in order: records, coordinates, the points along the curve
 *     point    bytes of the stage and of what others left for later ones, for each input point
 *     near     the same for each point and each neighbour that it may have
 *     kept     for each point that is kept
 *     face     for each triangle of the input
 *     tets     whether there are tetrahedra, at TET bytes each, and between which points
 *
 * and the peak is the largest of them, with a margin.  The figures are sizes of the arrays where those are ours, and
 * measured where they aren't (FLANN, CGAL); the test measures them all again.
 *
 * Invariant: how many tetrahedra there are nobody knows before.  The prediction counts what surfaces, volumes and cones
 * have; a run stops where there are more than the memory it was allowed has room for, so it takes no more than that.
 * Whoever can allow more does so then: at most as much as memory_predict_most says.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pipeline/memory.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "core/base/endian.h"
#include "core/base/par.h"
#include "core/io/formats/pcd_header.h"
#include "core/io/formats/ply_header.h"
#include "core/io/formats/tar_members.h"
#include "core/io/laz/laz.h"
#include "core/io/sniff.h"
#include "core/picture/picture.h"
#include "core/spatial/neighbourhood.h"

static const double PROGRAM = 6.1e6; /* the program, its libraries, stacks and buffers */
static const double MARGIN = 1.05;
/* Of small clouds' heap, which isn't given back between stages; of larger ones the usual margin has room for it. */
enum { SMALL_POINTS = 1 << 16 };
static const double SMALL_MARGIN = 1.16, SMALL_LEAST = 3e6;
enum { POSITION = 24, TRIANGLE = 12, GIVEN = 25 /* of a face that is the surface */, HELD = 32 };

/* Of tetrahedra, which are what points between them make it: for each point kept, for each point, for small clouds. */
static const double TETS_KEPT = 9, TETS_POINT = 1.5, TETS_LEAST = 20000;
enum { TET = 176, SITE = 100 }; /* bytes, measured: of a tetrahedron, and of a kept point beside those */

/* Of all points, where they are only looked at if they are a surface's, which have 6.4 to 7.1. */
static const double TETS_SURFACE = 7.5;

/* Points of turned parts and pipes lie on exact circles, and have up to twice as many: few points may. */
static const double TETS_CIRCLES = 16, TETS_CIRCLES_MOST = 240e3;

static double surface_tetrahedra(double points) {
    return fmax(TETS_SURFACE * points, fmin(TETS_CIRCLES * points, TETS_CIRCLES_MOST));
}

static bool refined(const struct params *p) { return params_want_mesh(p) && p->refine != REFINE_NONE; }
static bool refined_closely(const struct params *p) { return refined(p) && p->placement == PLACEMENT_OPTIMAL; }
static bool denoised(const struct params *p) { return params_want_denoising(p); }
static bool has_spacing(const struct params *p) { return !isnan(p->spacing); }
static bool attributed(const struct params *p) {
    return params_want_mesh(p) && (p->placement == PLACEMENT_OPTIMAL || p->attributes == ATTRIBUTES_MEAN);
}
static bool with_normals(const struct params *p) { return p->normals == SWITCH_TRUE; }
static bool maybe_given(const struct params *p) {
    return params_want_mesh(p) && (p->surface == SURFACE_GIVEN || p->surface == SURFACE_AUTO);
}
static bool cloud_alone(const struct params *p) { return !params_want_mesh(p); }
static bool reconstructed_whole(const struct params *p) {
    return params_want_mesh(p) && p->reference == REFERENCE_RECONSTRUCTION;
}
static bool maybe_dense(const struct params *p) {
    bool closed = p->surface == SURFACE_AUTO || p->surface == SURFACE_CLOSED;
    return params_want_mesh(p) && closed && p->placement == PLACEMENT_OPTIMAL && p->refine == REFINE_FULL &&
           p->order != ORDER_SIMPLIFY_FIRST && p->boundary != BOUNDARY_KEEP && !has_spacing(p);
}
/* Not counted in predictions, but what it may take: most clouds have no such walls. */
static bool maybe_walls(const struct params *p) {
    bool closed = p->surface == SURFACE_AUTO || p->surface == SURFACE_CLOSED;
    return params_want_mesh(p) && closed && p->order != ORDER_SIMPLIFY_FIRST && p->boundary != BOUNDARY_KEEP;
}
static bool painted(const struct params *p) { return p->outputs & (OUTPUT_DSO | OUTPUT_ERROR | OUTPUT_PREVIEW); }

/* Bytes for each point beside Delaunay, and after it where samples are made then (pipeline/mesh_steps.c): usual
 * tetrahedra and these are less than "refine", but as many as memory has room for are not. */
enum { LOCAL_DELAUNAY = 135, SAMPLES = 259 };

enum { CREASES = 44 }; /* of each point, if each had sheets of its own (core/spatial/sheets.h) */
enum { MESH = 56 };    /* of each kept point: a closed mesh that is held while another is fitted */
enum { TOLD = 48 };    /* of each point: a normal that a dense surface tells, and one that its Voronoi cell does */
enum { REACH = 4 };    /* of each point: how far apart feet are in the plane of a height field */

static const struct stage {
    const char *name;
    bool (*wanted)(const struct params *params);
    double point, near, kept, face;
    enum { NO_TETS, OF_KEPT, OF_ALL, OF_SURFACE } tets;
} stages[] = {
    {"denoise", denoised, 600, 0, 0, 0, NO_TETS},
    {"join", cloud_alone, 94, 9.6, 0, 0, NO_TETS},
    {"contract", cloud_alone, 124, 7, 0, 0, NO_TETS},
    {"space", has_spacing, 100, 0, 0, 0, NO_TETS},
    {"tangent", cloud_alone, 40, 0, 70, 0, NO_TETS},
    {"join", params_want_mesh, 130, 9, 0, 0, NO_TETS},
    {"contract", params_want_mesh, 165, 11, 0, 0, NO_TETS},
    {"delaunay", params_want_mesh, 81 + REACH + CREASES, 4, SITE, 0, OF_KEPT},
    {"local_delaunay", refined, LOCAL_DELAUNAY + CREASES, 4, SITE, 0, OF_KEPT},
    {"densify", maybe_dense, 81 + CREASES + SITE + TOLD + MESH, 4, SITE + 60 + 2 * MESH, 0, OF_SURFACE},
    {"walls", maybe_walls, 81 + CREASES + SITE + MESH, 4, SITE + MESH, 0, OF_SURFACE},
    {"flips", maybe_dense, 680 + 800 + CREASES + TOLD, 4, SITE + 2 * MESH, 0, NO_TETS}, /* of a mesh of all points */
    {"collapse", maybe_given, 245 + CREASES, 4, 0, 107, NO_TETS},
    {"refine", refined, 680 + CREASES, 4, 800, 0, NO_TETS},
    {"closer", refined_closely, 1080 + CREASES + TOLD, 4, 1400 + 2 * MESH, 0, NO_TETS},
    {"measure", params_want_mesh, 105 + CREASES, 4, 320, 175, NO_TETS},
    {"reference", reconstructed_whole, SITE, 4, 150, 0, OF_ALL},
    {"attributes", attributed, 110, 0, 300, 0, NO_TETS},
    {"normals", with_normals, 80, 0, 200, 0, NO_TETS},
    {"paint", painted, 160, 4, 200, 0, NO_TETS},
};
enum { STAGES = sizeof stages / sizeof stages[0] };

/* The most neighbours of a point, in a noisy cloud. */
static double most_neighbours(const struct params *params) {
    return neighbourhood_noisy_count((unsigned)params->neighbours_max);
}

static double kept_points(const struct memory_job *job, const struct params *params) {
    double points = (double)job->points, ratio = params->levels.count ? params->levels.ratio[0] : params->ratio;
    for (uint32_t i = 1; i < params->levels.count; i++) ratio = fmax(ratio, params->levels.ratio[i]);
    if (!isnan(params->max_error) || params_bound_deviation(params)) return points;
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

static double usual_tetrahedra(double points, double triangulated) {
    return TETS_KEPT * triangulated + TETS_POINT * points + TETS_LEAST;
}

/* A point of a surface has about seven tetrahedra, and takes SITE bytes; there are two meshes meanwhile. */
size_t memory_usual_points(size_t points, size_t kept) {
    enum { EACH = 9 };
    return (size_t)(usual_tetrahedra((double)points, (double)kept) / EACH);
}

static double tetrahedra_expected(double points, double triangulated) {
    return fmax(usual_tetrahedra(points, triangulated), MEMORY_MOST_TETRAHEDRA * triangulated);
}

/* While a picture is made, after all stages: what they hand over for it, a distance and a normal of each point. */
enum { PICTURED = 16 };

/* A tree of kept points while it is written: places twice, ranks, what they are sorted by, what finds neighbours. */
enum { TREE = 160 };

/* What the input takes while points are simplified. */
static double cloud_bytes(const struct memory_job *job, const struct params *params) {
    double positions = denoised(params) && params->denoise != DENOISE_OUTLIERS ? 2 * POSITION : POSITION;
    return (double)job->points * (positions + (double)job->record_bytes) +
           (double)job->faces * (maybe_given(params) ? TRIANGLE + GIVEN : TRIANGLE);
}

/* What a stage takes but for tetrahedra. */
static double stage_bytes(const struct stage *stage, const struct memory_job *job, double kept,
                          const struct params *params) {
    double each = HELD + stage->point + stage->near * most_neighbours(params);
    return cloud_bytes(job, params) + (double)job->points * each + kept * stage->kept +
           (double)job->faces * stage->face;
}

static bool is_small(const struct memory_job *job, const struct params *params) {
    return job->points <= SMALL_POINTS && memory_is_kept(job->points, params);
}

static double margin_of(const struct memory_job *job, const struct params *params) {
    return is_small(job, params) ? SMALL_MARGIN : MARGIN;
}

/* What the process has without any stage. */
static double least_of(const struct memory_job *job, const struct params *params) {
    return PROGRAM + (is_small(job, params) ? SMALL_LEAST : 0);
}

/* What writing LAS or LAZ takes: colours in 16 bits beside those in 8, and on each thread a chunk, twice, with what
 * compresses it. */
static double las_bytes(const struct memory_job *job, double kept, const struct params *params) {
    enum { NEWEST_FORMAT = 10, COLOURS = 6 };
    unsigned threads = params->threads ? (unsigned)params->threads : par_processors();
    double chunks = ceil(kept / LAZ_USUAL_CHUNK), slots = fmin(chunks, threads), bytes = (double)job->record_bytes;
    double codec = (double)laz_codec_bytes(NEWEST_FORMAT, (size_t)fmin(bytes, LAZ_RECORD_MOST));
    return COLOURS * (double)job->points + slots * (2 * fmin(kept, LAZ_USUAL_CHUNK) * bytes + codec);
}

/* As the pipeline settles placement=auto, at most. */
static void settle_placement(const struct memory_job *job, struct params *params) {
    if (params->placement != PLACEMENT_AUTO) return;
    params->placement = job->faces && maybe_given(params) ? PLACEMENT_OPTIMAL : PLACEMENT_SUBSET;
}

static uint64_t predict(const struct memory_job *job, const struct params *asked,
                        double (*tetrahedra)(double points, double triangulated)) {
    struct params settled = *asked;
    const struct params *params = &settled;
    settle_placement(job, &settled);
    double points = (double)job->points, kept = kept_points(job, params);
    double peak = cloud_bytes(job, params) + (double)job->input_bytes;
    for (int i = 0; i < STAGES; i++) {
        const struct stage *s = &stages[i];
        if (!s->wanted(params) || (s->tets == OF_SURFACE && asked->placement != PLACEMENT_OPTIMAL)) continue;
        double tets = s->tets == NO_TETS      ? 0
                      : s->tets == OF_SURFACE ? surface_tetrahedra(points)
                                              : tetrahedra(points, s->tets == OF_ALL ? points : kept);
        peak = fmax(peak, stage_bytes(s, job, kept, params) + tets * TET);
    }
    if (params->outputs & OUTPUT_PREVIEW)
        peak = fmax(peak, cloud_bytes(job, params) + (double)job->input_bytes + PICTURED * points +
                              picture_bytes(points, (size_t)params->preview_size));
    double written = params->outputs & OUTPUT_ANY_LAS ? las_bytes(job, kept, params) : 0;
    if (params->outputs & OUTPUT_ANY_TREE) written += TREE * kept;
    peak = fmax(peak, cloud_bytes(job, params) + (double)job->input_bytes + written);
    peak = least_of(job, params) + margin_of(job, params) * (peak + results(job, params));
    return peak < 0x1p64 ? (uint64_t)peak : UINT64_MAX;
}

uint64_t memory_predict(const struct memory_job *job, const struct params *params) {
    return predict(job, params, usual_tetrahedra);
}

uint64_t memory_predict_most(const struct memory_job *job, const struct params *params) {
    struct memory_job most = *job;
    struct params all = *params;
    if (most.faces < most.faces_most) most.faces = most.faces_most;
    uint64_t bytes = predict(&most, params, tetrahedra_expected), kept = 0;
    all.points = most.points, all.ratio = NAN, all.levels.count = 0;
    if (most.faces && maybe_given(params)) kept = predict(&most, &all, usual_tetrahedra);
    return bytes > kept ? bytes : kept;
}

uint64_t memory_triangles(const struct params *params) {
    double each = TRIANGLE;
    for (int i = 0; i < STAGES; i++)
        if (stages[i].wanted(params)) each = fmax(each, TRIANGLE + stages[i].face);
    double triangles = ((double)params->memory_bytes - PROGRAM) / (MARGIN * each);
    return params->memory_bytes ? (uint64_t)fmax(1, triangles) : 0;
}

bool memory_lacks_for_faces(const struct memory_job *job, const struct params *params) {
    struct memory_job plain = *job;
    plain.faces = 0;
    return params->memory_bytes && job->faces && memory_predict(job, params) > params->memory_bytes &&
           memory_predict(&plain, params) <= params->memory_bytes;
}

/* At most so many, in stages with tetrahedra of one kind, beside what else is held. */
static uint64_t tetrahedra_there_is_room_for(const struct memory_job *job, uint64_t kept, int kind, double most,
                                             double held, const struct params *params) {
    double stage = 0;
    if (!params->memory_bytes) return (uint64_t)most;
    for (int i = 0; i < STAGES; i++)
        if ((int)stages[i].tets == kind && stages[i].wanted(params))
            stage = fmax(stage, stage_bytes(&stages[i], job, (double)kept, params));
    double bytes = ((double)params->memory_bytes - least_of(job, params)) / margin_of(job, params);
    bytes -= results(job, params) + held + stage;
    return (uint64_t)fmax(0, fmin(most, bytes / TET));
}

uint64_t memory_tetrahedra(const struct memory_job *job, uint64_t kept, bool of_all, const struct params *params) {
    double most = tetrahedra_expected((double)job->points, (double)(of_all ? job->points : kept)), held = 0;
    if (refined(params) && !of_all) held = (double)job->points * (SAMPLES - LOCAL_DELAUNAY);
    return tetrahedra_there_is_room_for(job, kept, of_all ? OF_ALL : OF_KEPT, most, held, params);
}

uint64_t memory_surface_tetrahedra(const struct memory_job *job, uint64_t kept, const struct params *params) {
    return tetrahedra_there_is_room_for(job, kept, OF_SURFACE, surface_tetrahedra((double)job->points), 0, params);
}

/* ------------------------------------------------------------------------------------------------ what comes */

/* Faces of a text are counted as triangles and quadrilaterals, half of each and more.  How many corners they have
 * nobody knows before: as many as there are digits with a blank each, at most. */
enum { FACE_TRIANGLES = 2, CORNER_BYTES = 2 };

static void set_text_faces(struct memory_job *job, double triangles) {
    job->faces_most = job->input_bytes / CORNER_BYTES;
    job->faces = triangles < (double)job->faces_most ? (uint64_t)triangles : job->faces_most;
}

static enum status job_of_ply(const void *bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    struct ply_summary summary;
    struct error ignored;
    enum status status = ply_header_check(bytes, n, total_bytes, &summary, &ignored);
    if (status) return status;
    if (!summary.complete) return STATUS_MALFORMED;
    *job = (struct memory_job){summary.vertex_count, summary.record_bytes, summary.triangles_most, total_bytes, 0};
    if (summary.form == PLY_ASCII) set_text_faces(job, FACE_TRIANGLES * (double)summary.face_count);
    if (summary.face_count && total_bytes == UINT64_MAX) job->faces_most = UINT64_MAX;
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
    set_text_faces(job, FACE_TRIANGLES * (double)job->points);
}

/* A scalar of PCD may become one as large, or three bytes of a colour; compressed data is there unpacked, too. */
static enum status job_of_pcd(const void *bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    struct pcd_header header;
    struct error ignored;
    enum status status = pcd_header_parse(bytes, n, &header, &ignored);
    if (status) return status;
    if (!pcd_header_fits(&header, total_bytes)) return STATUS_MALFORMED;
    *job = (struct memory_job){header.points, header.record_bytes, 0, total_bytes, 0};
    if (header.data == PCD_COMPRESSED) job->input_bytes += header.points * header.record_bytes;
    return STATUS_OK;
}

/* Coordinates become double, and the three bytes of bit fields eight of their own.  Of LAZ, each thread has what it
 * decompresses with. */
static enum status job_of_las(const unsigned char *bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    enum {
        COUNT = 107,
        RECORD_BYTES = 105,
        LONG_COUNT = 247,
        LEAST_BYTES = 255,
        GROWS_BY = 24,
        FORMAT = 104,
        LAZ_BIT = 0x80
    };
    if (n < LEAST_BYTES) return STATUS_MALFORMED;
    uint64_t points = load_little_endian(bytes + COUNT, 4);
    if (bytes[25] >= 4 && load_little_endian(bytes + LONG_COUNT, 8)) points = load_little_endian(bytes + LONG_COUNT, 8);
    uint64_t record_bytes = load_little_endian(bytes + RECORD_BYTES, 2);
    bool is_laz = bytes[FORMAT] & LAZ_BIT, is_cut = !is_laz && record_bytes && points > total_bytes / record_bytes;
    if (is_cut) points = total_bytes / record_bytes; /* what is there is read */
    *job = (struct memory_job){points, record_bytes + GROWS_BY, 0, total_bytes, 0};
    if (is_laz) job->input_bytes += par_processors() * laz_codec_bytes(bytes[FORMAT] % LAZ_BIT, record_bytes);
    return STATUS_OK;
}

/* How many points there are stands behind them.  Usual records have 6 to 24 bytes. */
static void job_of_e57(uint64_t total_bytes, struct memory_job *job) {
    enum { LEAST_BYTES = 4, RECORD_BYTES = 48 };
    *job = (struct memory_job){total_bytes / LEAST_BYTES + 1, RECORD_BYTES, 0, total_bytes, 0};
}

/* A point takes 12 bytes or more, and so do two triangles between points that have numbers of 16 bits. */
static void job_of_glb(uint64_t total_bytes, struct memory_job *job) {
    enum { POINT_BYTES = 12, RECORD_BYTES = 48 };
    *job = (struct memory_job){total_bytes / POINT_BYTES + 1, RECORD_BYTES, total_bytes / POINT_BYTES, total_bytes, 0};
}

/* A closed surface has half as many points as facets; twice that is counted, and the table that joins corners. */
static void job_of_stl(const unsigned char *bytes, uint64_t total_bytes, struct memory_job *job) {
    enum { COUNT = 80, RECORD_BYTES = 12, TABLE_BYTES = 16 };
    uint64_t facets = load_little_endian(bytes + COUNT, 4);
    *job = (struct memory_job){facets, RECORD_BYTES + TABLE_BYTES, facets, total_bytes, 0};
}

/* Members that can't be looked at have as many points for a byte as those that can; the one that is joined is there
 * twice. */
static enum status job_of_tar(const void *first_bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    struct tar_member member = {0};
    struct memory_job sum = {0};
    double seen = 0;
    while (tar_next(first_bytes, n, &member) && member.first < n) {
        struct memory_job of;
        const char *first = (const char *)first_bytes + member.first;
        size_t there = n - (size_t)member.first;
        if (cloud_sniff(first, there).kind == CLOUD_KIND_TAR) return STATUS_UNSUPPORTED;
        enum status status =
            memory_job_of(first, there < member.bytes ? there : (size_t)member.bytes, member.bytes, &of);
        if (status) return status;
        sum.points += of.points, sum.faces += of.faces;
        sum.record_bytes = of.record_bytes > sum.record_bytes ? of.record_bytes : sum.record_bytes;
        seen += (double)member.bytes;
    }
    if (seen <= 0 || total_bytes == UINT64_MAX) return STATUS_UNSUPPORTED;
    double more = fmax(1, (double)total_bytes / seen);
    sum.points = (uint64_t)((double)sum.points * more), sum.faces = (uint64_t)((double)sum.faces * more);
    sum.input_bytes = total_bytes + sum.points * (sum.record_bytes + POSITION);
    *job = sum;
    return STATUS_OK;
}

enum status memory_job_of(const void *first_bytes, size_t n, uint64_t total_bytes, struct memory_job *job) {
    struct cloud_guess guess = cloud_sniff(first_bytes, n);
    switch (guess.kind) {
    case CLOUD_KIND_TAR: return job_of_tar(first_bytes, n, total_bytes, job);
    case CLOUD_KIND_PLY: return job_of_ply(first_bytes, n, total_bytes, job);
    case CLOUD_KIND_PCD: return job_of_pcd(first_bytes, n, total_bytes, job);
    case CLOUD_KIND_LAS: return job_of_las(first_bytes, n, total_bytes, job);
    case CLOUD_KIND_GLB: job_of_glb(total_bytes, job); return STATUS_OK;
    case CLOUD_KIND_E57: job_of_e57(total_bytes, job); return STATUS_OK;
    case CLOUD_KIND_PTX:
    case CLOUD_KIND_TEXT: job_of_text(first_bytes, n, total_bytes, job); return STATUS_OK;
    case CLOUD_KIND_STL:
        if (strcmp(guess.form, "stl/ascii") == 0)
            job_of_mesh_text(first_bytes, n, total_bytes, job);
        else
            job_of_stl(first_bytes, total_bytes, job);
        return STATUS_OK;
    case CLOUD_KIND_EMPTY: return STATUS_MALFORMED;
    case CLOUD_KIND_GZIP:
    case CLOUD_KIND_ZSTD:
    case CLOUD_KIND_OTHER: return STATUS_UNSUPPORTED;
    default: job_of_mesh_text(first_bytes, n, total_bytes, job); return STATUS_OK;
    }
}
