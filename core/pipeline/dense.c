/* Where vertices move freely: a closed surface of all points or of many, its edges collapsed to as many vertices as are
 * kept.
 *
 * More points tell the surface better than the kept ones: which are neighbours across a sharp edge or between two
 * limbs. All of them also tell how the triangles lie where points are few (core/refine/likely_edges.h), so the mesh is
 * fitted to samples of theirs then. That matters where the surface has creases, and is little work where points are
 * few; else several times as many as are kept will do, and what neighbours tell.
 *
 * Points at random on a body, or evenly, are hardly ever on its edges, and a surface through them cuts these off.  They
 * are the corners of no mesh, so their diagonals stay but across gaps, and vertices are put where faces meet
 * (core/refine/sharpen.h).
 *
 * Flat faces of machines may have points along their edges alone, which no method can tell from air by what is near.
 * Where such are found (core/spatial/flat_faces.h), the very first surface goes through places on them as well.
 *
 * But where sheets touch, dense points join them or leave shells in between.  What is small of that is taken away
 * (topology.h); where it doesn't do, half as many points are tried, which are the more important ones and farther
 * apart, or where most are kept, first more and then fewer than that.  Sides of bodies and of limbs are far longer than
 * their corners are apart elsewhere, as gaps are: surfaces that span such at little cost come first.  The first two are
 * made with the normals that the points' Voronoi cells bear out (core/surface/poles.h): those that are fitted to points
 * of a ring lie across the limb that it is around, which comes apart then.  None of it is tried unless it has as few
 * pieces and handles as the mesh of the kept points, lies nearer to the points, and has no more surface where there is
 * none (core/measure/phantom.h).  Whether it is taken is known when it is fitted (refine_steps.c): until then the mesh
 * of the kept points is put aside.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/clean/noise.h"
#include "core/cloud/cloud.h"
#include "core/cloud/on_grid_lines.h"
#include "core/measure/phantom.h"
#include "core/mesh/decimate.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline_run.h"
#include "core/refine/follow_creases.h"
#include "core/refine/likely_edges.h"
#include "core/refine/refine.h"
#include "core/refine/sharpen.h"
#include "core/spatial/bvh.h"
#include "core/spatial/density.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/poles.h"

/* For each point, at most: surfaces have 6.4 to 7.1, points on exact circles, which few may be, 8 to 13. */
enum { TETRAHEDRA = 8, ON_CIRCLES = 16 };

enum { FEW = 20000 /* points that may be all of the first trial's */ };
enum { DENSER = 8 /* times the kept ones, else */, FIRST_LEAST = 12000 /* then, if there are */ };
static const double NEARLY_ALL = 0.7, MOST = 0.8; /* of the points: from where on all are taken; of later trials */

/* How many times as many points as are kept there have to be at least, for each of the trials. */
static const double ENOUGH[DENSE_TRIALS] = {1.25, 1.25, 1.25, 1.25, 1.25, 1.5, 1.25}, SPARE = 1.6, LITTLE_SPARE = 1.28;

/* What spanning gaps costs (struct reconstruct_input) of half of the points or more, which are so near to each other
 * that what is far longer is a side of the body, not a gap; and once a surface or their Voronoi cells have told their
 * normals. */
static const double BOLD = 0.25, VERY_BOLD = 1 / 12.0;

enum status pipeline_points_off(const struct run *run, const struct mesh *mesh, size_t most, struct points_off *off) {
    size_t n = run->points.count < most ? run->points.count : most;
    struct bvh *bvh = NULL;
    vec3 *point = alloc_array(n, sizeof *point);
    struct bvh_hit *hit = alloc_array(n, sizeof *hit);
    enum status status = point && hit ? bvh_new(mesh, run->threads, &bvh) : STATUS_NO_MEMORY;
    if (!status) {
        double sum = 0, by_area = 0, squares = 0, areas = 0, spacings = 0;
        for (size_t i = 0; i < n; i++) point[i] = run->points.point[i * run->points.count / n];
        bvh_closest_all(bvh, point, n, run->threads, hit);
        for (size_t i = 0; i < n; i++) {
            double spacing = (double)run->neighbours.spacing[i * run->points.count / n], area = spacing * spacing;
            double distance = sqrt(hit[i].distance_sq);
            sum += distance / (double)n;
            by_area += area * distance, squares += area * hit[i].distance_sq, areas += area, spacings += area * area;
        }
        *off = (struct points_off){.mean = sum};
        if (areas > 0) off->mean_by_area = by_area / areas, off->rms_by_area = sqrt(squares / areas);
        if (areas > 0) off->spacing = sqrt(spacings / areas);
    }
    bvh_free(bvh);
    free(point), free(hit);
    return status;
}

enum status pipeline_find_islands(struct run *run) {
    if (run->islands) return STATUS_OK;
    return topology_count_islands(&run->neighbours, run->knn, run->points.point, run->threads, &run->islands);
}

/* Of meshes that have no more pieces than the points are known to have none is simpler than another. */
enum status pipeline_judge(struct run *run, const struct mesh *mesh, struct surface_judged *judged) {
    struct points_off off;
    enum status status = pipeline_find_islands(run);
    if (!status) status = topology_find(mesh, &judged->topology);
    judged->joined = !status && judged->topology.components < run->islands;
    if (judged->joined) judged->topology.components = run->islands;
    if (!status) status = pipeline_points_off(run, mesh, POINTS_OFF_MOST, &off);
    if (!status) judged->mean = off.mean, judged->spacing = off.spacing;
    return status;
}

bool pipeline_wants_dense(const struct run *run) {
    const struct params *params = run->params;
    bool may_be_closed = params->surface == SURFACE_AUTO || params->surface == SURFACE_CLOSED;
    bool plain = isnan(params->spacing) && params->boundary != BOUNDARY_KEEP && !run->neighbours.noisy;
    return may_be_closed && plain && run->placement == PLACEMENT_OPTIMAL && params->refine == REFINE_FULL &&
           params->order != ORDER_SIMPLIFY_FIRST && (double)run->points.count > ENOUGH[0] * (double)run->kept_count;
}

/* Told after what a reconstruction tells, as a stage of their own. */
static int tick_flips(void *ctx, const char *stage, double fraction) {
    static const double BEFORE = 0.9;
    (void)stage;
    return progress_tick(ctx, "flips", BEFORE + (1 - BEFORE) * fraction);
}

/* A reconstruction joins points that are near; on long strips beside creases, where they lie along the edges alone,
 * other diagonals are the surface's.  Those that the triangles between neighbours tell are taken. */
static enum status flip_to_neighbours(struct run *run, struct mesh *mesh) {
    const struct refine_input input = {.points = run->points.point,
                                       .normals = pipeline_normals_told(run),
                                       .spacing = run->neighbours.spacing,
                                       .n = run->points.count,
                                       .neighbours = &run->neighbours,
                                       .creases = &run->creases};
    const struct refine_options options = {REFINE_FLIPS, PLACEMENT_SUBSET, run->threads};
    const struct progress progress = {tick_flips, &run->progress};
    return refine_mesh(mesh, &input, &options, &progress, NULL);
}

/* Points at random on a surface are often far nearer to each other than they are in the mean; corners of a mesh hardly
 * ever, unless it was put through a grid, and those that were put evenly never. */
static bool are_at_random(const struct run *run) {
    static const double NEAR = 0.25, OFTEN = 0.08;
    const struct neighbourhood *neighbours = &run->neighbours;
    size_t near = 0;
    for (size_t p = 0; p < run->points.count; p++) {
        if (!neighbours->count[p]) continue;
        uint32_t nearest = neighbours->id[p * neighbours->stride];
        double distance = vec3_distance(run->points.point[p], run->points.point[nearest]);
        near += distance < NEAR * (double)neighbours->spacing[p];
    }
    return (double)near > OFTEN * (double)run->points.count;
}

/* The corners of a surface that was put through a grid are near each other around its nodes, but as many of them are on
 * one part of it as on the next. */
static enum status vary_as_at_random(const struct run *run, bool *vary) {
    static const double LEAST = 0.14;
    double change = 0;
    enum status status = density_change(run->knn, run->points.point, run->points.count, run->threads, &change);
    *vary = change > LEAST;
    return status;
}

static enum status find_blunt(const struct run *run, struct dense_surface *dense) {
    bool random = are_at_random(run), grid = false;
    enum status status = STATUS_OK;
    if (random) status = vary_as_at_random(run, &random);
    if (!status && random) status = on_grid_lines(run->points.point, run->points.count, run->threads, &grid);
    dense->blunt = random && !grid;
    return status || random ? status : sharpen_is_due(&dense->mesh, &dense->blunt);
}

/* Whether free vertices are to be fitted to the points, which are on no edges, rather than to triangles between them:
 * these average noise, as many points for each vertex do. */
static enum status find_anywhere(struct run *run, bool blunt) {
    enum { MANY = 10 /* points for each vertex */ };
    static const double EXACT = 0.006; /* of the spacing */
    size_t n = run->points.count;
    bool asked = blunt && n < MANY * run->kept_count;
    enum status status = STATUS_OK;
    if (asked && !run->noise_asked) {
        status = noise_where_least(run->knn, run->points.point, n, run->threads, &run->least_noise);
        run->noise_asked = !status;
    }
    run->anywhere = blunt && (!asked || run->least_noise < EXACT);
    return status;
}

/* Edges of a surface of k points are flipped, where it has creases to what tells of them, and unless it is to be plain,
 * of all points, to where they more probably are; else across gaps alone. */
static enum status flip_as_told(struct run *run, size_t k, bool *plain, struct mesh *mesh) {
    bool creased = creases_matter(&run->creases, run->points.count);
    enum status status = creased ? flip_to_neighbours(run, mesh) : STATUS_OK;
    size_t flips = 0;
    if (!status && !*plain) status = take_likely_edges(mesh, &flips);
    *plain = flips == 0;
    double share = (double)k / (double)run->points.count;
    if (!status && *plain) status = take_likely_edges_across_gaps(mesh, run->neighbours.spacing, share, NULL);
    if (!status && creased) status = follow_creases(mesh, &run->creases, pipeline_normals_told(run), NULL);
    if (!status && progress_tick(&run->progress, "flips", 1)) status = STATUS_CANCELLED;
    return status;
}

/* The same.  Of points that are made up nothing is told. */
static enum status flip_edges(struct run *run, size_t k, bool *plain, struct mesh *mesh) {
    size_t n = mesh->vertex_count;
    if (!run->with_made) return flip_as_told(run, k, plain, mesh);
    uint32_t *source = alloc_array(n, sizeof *source);
    if (!source) return STATUS_NO_MEMORY;
    memcpy(source, mesh->source, n * sizeof *source);
    for (size_t v = 0; v < n; v++)
        if (source[v] >= run->points.count) mesh->source[v] = NONE;
    enum status status = flip_as_told(run, k, plain, mesh);
    if (!status) memcpy(mesh->source, source, n * sizeof *source);
    free(source);
    return status;
}

/* The tetrahedra of the k most important points. */
struct triangulated {
    size_t k; /* 0: none */
    struct tets tets;
};

static void triangulated_done(struct triangulated *of) {
    tets_done(&of->tets);
    of->k = 0;
}

static enum status triangulate_most(struct run *run, const struct sites *sites, size_t k, struct triangulated *of) {
    if (of->k == k) return STATUS_OK;
    struct error ignored = {0};
    const struct memory_job job = {run->cloud->count, run->cloud->record_bytes, run->cloud->triangle_count, 0, 0};
    size_t most = memory_surface_tetrahedra(&job, run->kept_count, run->params);
    size_t expected = (k <= FEW ? ON_CIRCLES : TETRAHEDRA) * sites->count;
    if (most > expected) most = expected;
    triangulated_done(of);
    enum status status =
        delaunay_build_within(sites->point, sites->count, most, run->threads, &run->progress, &of->tets, &ignored);
    if (!status) of->k = k;
    return status;
}

/* Cosine between a fitted normal and the surface's, at most, for that to be taken; and where it has sharp creases. */
static const double ASKEW = 0.7, ASKEW_BESIDE = 0.97;
enum { ASKEW_SHARE = 1000 }; /* of the points: fewer than one in so many aren't worth another surface */

/* Sets run->mended, once, by the cells of the points that the sites are, unless none changes.  A point on a
 * crease has several normals, and its cell says little of each. */
static enum status mend_normals(struct run *run, const struct triangulated *of, const struct sites *sites) {
    size_t n = run->points.count, changed = 0;
    bool creased = creases_matter(&run->creases, n);
    vec3 *better = alloc_array(sites->count, sizeof *better), *mended = alloc_array(n, sizeof *mended);
    enum status status = better && mended ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = poles_find_better(&of->tets, sites->point, sites->count, sites->normal, better);
    if (!status) memcpy(mended, run->normal, n * sizeof *mended);
    for (size_t i = 0; !status && i < sites->count - sites->made; i++) {
        if (vec3_length_sq(better[i]) == 0 || (creased && creases_at(&run->creases, sites->id[i]))) continue;
        mended[sites->id[i]] = better[i];
        changed++;
    }
    run->cells_seen = !status;
    if (!status && changed) run->mended = mended, mended = NULL;
    free(better), free(mended);
    return status;
}

/* The sites of the k most important points, with those made up where these count. */
static enum status list_sites(struct run *run, size_t k, struct sites *sites) {
    enum status status = pipeline_sites_of(run, k, sites);
    return status || !run->with_made ? status : made_points_add(run, sites);
}

/* Likewise, and their tetrahedra, which tell normals first where they are to. */
static enum status prepare_sites(struct run *run, size_t k, struct triangulated *of, struct sites *sites) {
    enum status status = list_sites(run, k, sites);
    if (!status) status = triangulate_most(run, sites, k, of);
    if (status || !run->by_cells || run->cells_seen || of->tets.dimension < 3) return status;
    status = mend_normals(run, of, sites);
    pipeline_sites_done(sites);
    return status ? status : list_sites(run, k, sites);
}

/* The closed surface through the k most important points; STATUS_LIMIT or _DEGENERATE: there is none, without a mesh:
 * none of so few pieces.  Their tetrahedra stay for another surface of them, by other normals, but where flips take
 * much memory. */
static enum status reconstruct_points(struct run *run, size_t k, struct triangulated *of, struct dense_surface *dense) {
    struct sites sites = {0};
    struct reconstruct_facts facts = {0};
    enum status status = prepare_sites(run, k, of, &sites);
    if (!status) status = pipeline_reconstruct_closed(run, &sites, &of->tets, &dense->mesh, &facts);
    pipeline_sites_done(&sites);
    if (creases_matter(&run->creases, run->points.count)) triangulated_done(of);
    if (!status && facts.too_many_pieces) {
        mesh_done(&dense->mesh);
        dense->pieces = run->pieces.most;
        return STATUS_OK;
    }
    if (!status) status = find_blunt(run, dense);
    if (dense->blunt) dense->plain = true; /* a flat face has no likelier diagonals */
    if (!status) status = flip_edges(run, k, &dense->plain, &dense->mesh);
    if (!status) status = topology_find(&dense->mesh, &dense->topology);
    return status;
}

static bool are_half(const struct run *run, size_t k) { return 2 * k + 1 >= run->points.count; }

static double gaps_of(const struct run *run, size_t trial, size_t k) {
    if (trial == DENSE_USUAL || trial == DENSE_PLAIN || !are_half(run, k)) return 1;
    return run->told || run->by_cells ? VERY_BOLD : BOLD;
}

static enum status make_dense(struct run *run, size_t trial, size_t k, struct triangulated *of,
                              struct dense_surface *dense) {
    assert(k <= run->points.count);
    bool too_strict = dense->pieces && dense->pieces < run->pieces.most; /* for another level */
    if (dense->from == k && !too_strict) return STATUS_OK;
    dense_surface_done(dense);
    dense->trial = trial, dense->plain = trial == DENSE_PLAIN || k < run->points.count;
    run->gaps = gaps_of(run, trial, k);
    enum status status = reconstruct_points(run, k, of, dense);
    run->gaps = 0;
    if (status == STATUS_LIMIT || status == STATUS_DEGENERATE) {
        dense_surface_done(dense);
        status = STATUS_OK;
    }
    dense->from = k;
    return status;
}

/* The fourth has half of the first one's, or where that is hardly more than are kept, as many as are enough, and then
 * the last a few more than are kept; 0 where there aren't so many. */
static size_t points_of_trial(const struct run *run, size_t trial) {
    size_t n = run->points.count, several = DENSER * run->kept_count;
    bool all = n <= FEW || creases_matter(&run->creases, n) || (double)several >= NEARLY_ALL * (double)n;
    if (!all) n = several > FIRST_LEAST ? several : FIRST_LEAST;
    if (trial < DENSE_FEWER) return n;
    size_t few = (size_t)(SPARE * (double)run->kept_count);
    if ((double)few > MOST * (double)n) few = (size_t)(MOST * (double)n);
    if (trial == DENSE_FEWER) return few > n / 2 ? few : n / 2;
    size_t fewest = (size_t)(LITTLE_SPARE * (double)run->kept_count);
    return few > n / 2 && fewest <= run->points.count ? fewest : 0;
}

/* ------------------------------------------------------------------------------------------------ normals */

/* Sums of the normals of the triangles around each vertex, by their angles there; of vertices at one place together. Of
 * n points. */
static void sum_normals(const struct mesh *mesh, size_t n, vec3 *sum) {
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        vec3 normal = vec3_unit(mesh_triangle_normal(mesh, t));
        for (int k = 0; k < 3; k++) {
            const uint32_t *corner = mesh->triangle[t];
            vec3 at = mesh->vertex[corner[k]];
            vec3 to = vec3_unit(vec3_sub(mesh->vertex[corner[(k + 1) % 3]], at));
            vec3 from = vec3_unit(vec3_sub(mesh->vertex[corner[(k + 2) % 3]], at));
            double angle = acos(fmax(-1, fmin(1, vec3_dot(to, from))));
            uint32_t of = mesh->source[corner[k]];
            if (of < n) sum[of] = vec3_add(sum[of], vec3_scale(normal, angle));
        }
    }
}

/* Sets run->told, what was told before but where the surface's normals are over so far off that, unless it is next to
 * nowhere. */
static enum status tell_normals(struct run *run, const struct mesh *surface, double cosine) {
    size_t n = run->points.count, askew = 0;
    const vec3 *before = pipeline_normals_told(run);
    vec3 *normal = alloc_zeroed(n, sizeof *normal);
    if (!normal) return STATUS_NO_MEMORY;
    sum_normals(surface, n, normal);
    for (size_t p = 0; p < n; p++) {
        vec3 unit = vec3_unit(normal[p]);
        bool is_askew = vec3_length_sq(unit) > 0 && fabs(vec3_dot(unit, before[p])) < cosine;
        if (run->normals_fit && vec3_dot(unit, run->normal[p]) < 0) unit = vec3_scale(unit, -1); /* as given */
        normal[p] = is_askew ? unit : before[p];
        askew += is_askew;
    }
    if (askew * ASKEW_SHARE >= n)
        run->told = normal;
    else
        free(normal);
    return STATUS_OK;
}

static void forget_normals(struct run *run) {
    free(run->told);
    run->told = NULL;
}

static enum status is_sound(const struct run *run, const struct dense_surface *dense, const struct surface_judged *kept,
                            bool *sound) {
    struct topology topology = dense->topology;
    struct mesh mesh = {0};
    enum status status = mesh_copy(&mesh, &dense->mesh);
    if (!status) status = topology_simplify(&mesh, &kept->topology, run->bars, run->threads, &topology);
    *sound = !status && topology_is_simpler(&topology, &kept->topology);
    mesh_done(&mesh);
    return status;
}

/* Where the points around one are those of a ring around a limb, or of both sides of a wall, the plane fitted to them
 * lies across the surface.  A dense surface knows better which of them are neighbours, even where it is made with such
 * normals: most others outvote them.  So it is made again with those that it tells, if it is one that could be taken;
 * else it is itself too far from the truth.  *again stays zeroed where there is nothing to be told. */
static enum status make_again(struct run *run, const struct dense_surface *dense, const struct surface_judged *kept,
                              struct triangulated *of, struct dense_surface *again) {
    bool sound;
    forget_normals(run);
    enum status status = is_sound(run, dense, kept, &sound);
    if (!status && sound) status = tell_normals(run, &dense->mesh, ASKEW);
    if (!status && run->told) status = make_dense(run, dense->trial, dense->from, of, again);
    if (!again->mesh.triangle_count) forget_normals(run);
    return status;
}

/* ------------------------------------------------------------------------------------------------ trials */

enum status pipeline_find_phantom(const struct run *run, const struct mesh *mesh, const struct mesh *other,
                                  size_t places, bool *more) {
    const struct metro_reference reference = pipeline_reference(run);
    const struct metro_options options = {.samples = places, .seed = run->params->seed, .threads = run->threads};
    return phantom_is_more(mesh, other, &reference, &options, more);
}

enum status pipeline_is_preferred(const struct run *run, const struct mesh *mesh, const struct surface_judged *judged,
                                  const struct surface_judged *than, size_t places, bool *preferred) {
    bool more = false, refuted = surface_is_lost(than, judged);
    bool told = refuted || topology_is_simpler(&judged->topology, &than->topology);
    *preferred = false;
    if (judged->mean >= than->mean) return STATUS_OK;
    if (!told && judged->topology.components > than->topology.components) return STATUS_OK;
    enum status status = pipeline_find_phantom(run, mesh, &run->mesh, places, &more);
    if (!status && !more && !told) status = pipeline_find_phantom(run, &run->mesh, mesh, places, &refuted);
    *preferred = !status && !more && (told || refuted);
    return status;
}

static void put_aside(struct run *run) {
    const struct report_level *level = &run->report.level[run->level];
    run->aside = (struct mesh_aside){run->mesh, level->reconstructed_from, level->points_lost, level->vertices_split};
    run->mesh = (struct mesh){0};
}

/* What a dense surface becomes on the way to a mesh. */
struct trial {
    struct mesh mesh;
    struct surface_judged judged;
    struct surface_faces faces;
    size_t sharp; /* vertices on creases that no point is on, the last ones */
    vec3 *told;   /* normals before it told any; owned unless they are run->told still */
};

static enum status begin_trial(const struct run *run, const struct dense_surface *dense,
                               const struct surface_judged *kept, struct trial *trial, bool *sound) {
    *trial = (struct trial){.judged.topology = dense->topology, .told = run->told};
    enum status status = mesh_copy(&trial->mesh, &dense->mesh);
    if (!status)
        status = topology_simplify(&trial->mesh, &kept->topology, run->bars, run->threads, &trial->judged.topology);
    *sound = !status && topology_may_be_right(&trial->judged.topology, &kept->topology);
    return status;
}

static void end_trial(struct run *run, struct trial *trial, bool taken) {
    if (run->told != trial->told) {
        free(taken ? trial->told : run->told);
        if (!taken) run->told = trial->told;
    }
    mesh_done(&trial->mesh);
    surface_faces_done(&trial->faces);
}

/* Makes what is fitted, and what it is fitted to. */
static enum status prepare_trial(struct run *run, const struct dense_surface *dense, bool sharpen,
                                 struct trial *trial) {
    struct decimate_rules rules = {.moves = true};
    double noise = isnan(run->report.noise_level) ? 0 : run->report.noise_level / run->points.scale;
    bool creased = creases_matter(&run->creases, run->points.count), few = run->points.count <= FEW;
    bool tells = (few || !dense->plain || creased) && dense->from == run->points.count;
    bool smooths = tells && !creased && !dense->blunt;
    enum status status = smooths ? take_smooth_edges(&trial->mesh, NULL) : STATUS_OK;
    if (!status && sharpen) status = sharpen_creases(&trial->mesh, noise, &trial->sharp);
    if (!status && trial->sharp) status = tell_normals(run, &trial->mesh, ASKEW_BESIDE);
    if (!status && (trial->sharp || tells))
        status = pipeline_list_faces(run, &trial->mesh, trial->sharp, &trial->faces);
    long tubes = trial->judged.topology.tubes;
    if (!status) status = mesh_decimate(&trial->mesh, &rules, run->kept_count);
    if (!status) status = pipeline_judge(run, &trial->mesh, &trial->judged);
    if (!status) trial->judged.topology.tubes = tubes;
    return status;
}

/* Puts the dense surface, collapsed, in place of run->mesh if it is as simple as that and better; *sharpen becomes
 * whether it got sharp creases. */
static enum status try_dense(struct run *run, const struct dense_surface *dense, const struct surface_judged *kept,
                             bool *sharpen, bool *taken) {
    struct trial trial;
    bool sound, preferred = false;
    enum status status = begin_trial(run, dense, kept, &trial, &sound);
    if (sound) status = prepare_trial(run, dense, *sharpen, &trial);
    bool nearer = sound && !status && trial.mesh.vertex_count == run->kept_count;
    if (nearer) status = pipeline_is_preferred(run, &trial.mesh, &trial.judged, kept, 0, &preferred);
    *taken = !status && preferred;
    *sharpen = trial.sharp > 0;
    run->sharpened = *taken && *sharpen;
    if (*taken) {
        put_aside(run);
        run->mesh = trial.mesh, trial.mesh = (struct mesh){0};
        run->fitted_to = trial.faces, trial.faces = (struct surface_faces){0};
    }
    end_trial(run, &trial, *taken);
    return status;
}

/* With sharp creases where there may be such, else, or where that isn't taken, as it is. */
static enum status try_sharp(struct run *run, const struct dense_surface *dense, const struct surface_judged *kept,
                             bool *taken) {
    bool sharpen = !run->stay_blunt && !run->rods && dense->blunt;
    enum status status = try_dense(run, dense, kept, &sharpen, taken);
    if (status || *taken || !sharpen) return status;
    sharpen = false;
    return try_dense(run, dense, kept, &sharpen, taken);
}

/* With the normals that the surface tells, and where that isn't taken with those it was made with. */
static enum status try_both(struct run *run, const struct dense_surface *dense, const struct surface_judged *kept,
                            struct triangulated *of, bool *taken) {
    struct dense_surface again = {0};
    enum status status = make_again(run, dense, kept, of, &again);
    triangulated_done(of);
    if (!status && again.mesh.triangle_count) status = try_sharp(run, &again, kept, taken);
    dense_surface_done(&again);
    if (status || *taken) return status;
    forget_normals(run);
    return try_sharp(run, dense, kept, taken);
}

/* Where points are beside creases the likelier diagonals cut these off, as a mesh does that has no more corners, and
 * strips as they were reconstructed are as near to the sharp edge: both have been the true surface. */
static enum status is_worth_plain(const struct run *run, size_t k, const struct surface_judged *kept, bool *worth) {
    const struct dense_surface *usual = &run->dense[DENSE_USUAL];
    *worth = false;
    if (k < run->points.count || !creases_matter(&run->creases, k)) return STATUS_OK;
    if (!usual->mesh.triangle_count || usual->plain) return STATUS_OK;
    return is_sound(run, usual, kept, worth);
}

/* Sets run->with_made: made-up points count in the first trial, where it is of all points, which are few, and there are
 * such. */
static enum status count_made_points(struct run *run, size_t trial, size_t k) {
    run->with_made = false;
    if (trial != DENSE_WITH_FACES || k < run->points.count || k > FEW) return STATUS_OK;
    enum status status = made_points_find(run);
    run->with_made = !status && run->made.count > 0;
    return status;
}

/* What a surface with made-up points has to be as simple as: the mesh of the kept points needn't have the holes through
 * flat faces, nor one in their midst. */
static struct surface_judged may_have_holes(const struct run *run, const struct surface_judged *kept) {
    struct surface_judged than = *kept;
    long holes = run->with_made ? (long)run->made.holes + 1 : 0;
    if (than.topology.handles < holes) than.topology.handles = holes;
    return than;
}

enum status pipeline_densify(struct run *run) {
    struct surface_judged kept = {0};
    struct triangulated of = {0};
    bool taken = false;
    if (!pipeline_wants_dense(run) || run->dense_tried == DENSE_TRIALS) return STATUS_OK;
    enum status status = pipeline_judge(run, &run->mesh, &kept);
    run->pieces = (struct reconstruct_pieces){kept.topology.components, TOPOLOGY_LEFT_OUT_MOST};
    if (run->sharpened) run->stay_blunt = true, run->dense_tried--; /* the same once more, without sharp creases */
    while (run->dense_tried < DENSE_TRIALS && !status && !taken) {
        size_t i = run->dense_tried++, k = points_of_trial(run, i);
        struct dense_surface *dense = &run->dense[i];
        if ((double)k <= ENOUGH[i] * (double)run->kept_count) continue;
        run->by_cells = i == DENSE_BY_CELLS || i == DENSE_WITH_FACES;
        if (run->by_cells && !are_half(run, k)) continue;
        status = count_made_points(run, i, k);
        if (status || (i == DENSE_WITH_FACES && !run->with_made)) continue;
        struct surface_judged than = may_have_holes(run, &kept);
        bool plain = i == DENSE_PLAIN, worth = true;
        if (plain) status = is_worth_plain(run, k, &kept, &worth);
        if (status || !worth) continue;
        if (i == DENSE_USUAL && gaps_of(run, DENSE_FIRST, k) == 1) continue; /* that was the first */
        if (i == DENSE_BY_CELLS) triangulated_done(&of);
        if (i != DENSE_WITH_FACES && i != DENSE_FEWER) dense_surface_done(&run->dense[i - 1]); /* for its memory */
        status = make_dense(run, i, k, &of, dense);
        if (!status && dense->mesh.triangle_count) status = find_anywhere(run, dense->blunt);
        if (!status && dense->mesh.triangle_count) status = try_both(run, dense, &than, &of, &taken);
        if (!taken) continue;
        struct report_level *level = &run->report.level[run->level];
        level->reconstructed_from = dense->from;
        level->points_lost = level->vertices_split = 0; /* vertices stand at no points any more */
    }
    if (!taken) run->by_cells = run->with_made = false;
    run->pieces = (struct reconstruct_pieces){0};
    triangulated_done(&of);
    return status;
}

void pipeline_put_back(struct run *run) {
    struct report_level *level = &run->report.level[run->level];
    mesh_done(&run->mesh);
    surface_faces_done(&run->fitted_to);
    forget_normals(run);
    run->mesh = run->aside.mesh;
    level->reconstructed_from = run->aside.from;
    level->points_lost = run->aside.points_lost, level->vertices_split = run->aside.vertices_split;
    run->aside = (struct mesh_aside){0};
}

void dense_surface_done(struct dense_surface *dense) {
    mesh_done(&dense->mesh);
    *dense = (struct dense_surface){0};
}
