/* Thin walls: once kept points are farther apart than a wall is thick, edges of the mesh run across it, from the one
 * sheet to the other, and the inner sheet is lost.  Then the surface is reconstructed from more points of the ranking,
 * where the sheets can be told apart, and its edges are collapsed to as many vertices as are kept, with the topology
 * that it has.
 *
 * Where the surface has creases, more points tell their course as well, so that twice as many are tried in any case.
 *
 * More points aren't always better: where sheets touch, points that are dense join them.  So counts double from the
 * kept ones on, as long as fewer edges run across for it or the mesh gets much nearer, the first with which hardly any
 * edge runs across ends the search, and the nearest to the original points of those tried is taken, unless it has more
 * pieces or handles than the mesh of the kept points.
 *
 * Of a sheet that is lost whole no edge runs anywhere.  Then many points are far off, which counts as edges across do.
 *
 * Where most of the cloud is both sides of walls that are hardly thicker than its points are apart, kept points tell
 * nothing, and few of them have edges that run across: the search begins with all points, and goes on with half as
 * many.
 *
 * Where the mesh of the kept points has fewer pieces than the points are known to have, it joins what is apart: then
 * others are tried, too, and the first that doesn't is taken even if it is hardly farther.
 *
 * There is no search where there can be no walls: in a noisy cloud, where most vertices have another normal than the
 * points nearby, unless their number grows as on a surface, and among points that have more tetrahedra than those of a
 * surface do.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/mesh/decimate.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline_run.h"
#include "core/surface/delaunay_cgal.h"

/* Cosine between an edge and the normals at its ends, over what an arc between them has: the sine of half its turn. */
static const double ACROSS = 0.5;
static const double WALLS_LOST = 0.005; /* share of the vertices with such edges, over which walls are lost */
enum { PLACES = 4 /* of each vertex, that are looked at */ };
enum { DENSER = 2, TRIALS = 4, IN_VAIN = 2 /* trials after which no fewer edges run across */ };
static const double GAINS = 0.9; /* of the least distance so far: a trial so near wasn't in vain */
enum { TETRAHEDRA = 8 };         /* for each point, at most: surfaces have 6.4 to 7.1 */

static const double SHEET_OFF =
    0.3; /* of the spacing: points so far off, in the mean, are those of a sheet that is lost */

enum { IN_DOUBT = 2 }; /* after so many trials the surface has to be far nearer, else there are no walls: */
static const double FAR_NEARER = 0.5; /* of the first distance, at most, unless the last trial gained much */

enum { PIECES = 8, PIECES_SHARE = 100 }; /* of the vertices: what comes in more pieces in doubt is dust */

enum { ALONG = 4 /* as many points before and after one along the curve are near it, as a rule */ };
static const double ALIKE = 0.7;     /* cosine between normals of a surface that are near each other */
static const double CERTAIN = 0.5;   /* share of a surface's vertices with such normals, at least */
static const double DOUBTFUL = 0.28; /* the same of thin bodies with points at random on them */

size_t pipeline_wall_tetrahedra(const struct run *run) {
    const struct memory_job job = {run->cloud->count, run->cloud->record_bytes, run->cloud->triangle_count, 0, 0};
    return memory_surface_tetrahedra(&job, run->kept_count, run->params);
}

size_t pipeline_wall_points(const struct run *run) {
    size_t n = run->points.count, most = memory_usual_points(n, run->kept_count);
    if (run->neighbours.walls) most = pipeline_wall_tetrahedra(run) / TETRAHEDRA;
    return most < n ? most : n;
}

static bool runs_across(const struct run *run, const struct mesh *mesh, uint32_t v, uint32_t w) {
    vec3 edge = vec3_sub(mesh->vertex[w], mesh->vertex[v]);
    vec3 from = run->normal[mesh->source[v]], to = run->normal[mesh->source[w]];
    double half_turn = sqrt(fmax(0, 1 - fabs(vec3_dot(from, to))) / 2);
    double least = (ACROSS + half_turn) * vec3_length(edge);
    return fabs(vec3_dot(edge, from)) > least && fabs(vec3_dot(edge, to)) > least;
}

/* Whether most points near one have its normal, or the opposite one, as those of either sheet of a wall do: true
 * of nine tenths of a scan's, of two thirds of a coarse model's, and of a quarter of those in a volume of noise. */
static bool is_certain(const struct run *run, size_t point) {
    size_t first = point < ALONG ? 0 : point - ALONG, last = point + ALONG;
    size_t alike = 0;
    if (last >= run->points.count) last = run->points.count - 1;
    for (size_t i = first; i <= last; i++)
        alike += i != point && fabs(vec3_dot(run->normal[i], run->normal[point])) > ALIKE;
    return 2 * alike > last - first;
}

/* Whether there are about as many points around most of them as on a surface, or on two near each other: their number
 * grows as the square of the distance, and in a volume as its cube. */
static enum status grow_as_surface(const struct run *run, bool *as_surface) {
    enum { MANY_ENOUGH = 1000, NEAR = 16, FAR = 63, K = FAR + 1 };
    static const double BETWEEN = 2.9, MANY = 0.25;
    size_t n = run->points.count, m = n < MANY_ENOUGH ? n : MANY_ENOUGH, more = 0;
    vec3 *place = alloc_array(m, sizeof *place);
    uint32_t *id = alloc_array(m * K, sizeof *id);
    double *distance_sq = alloc_array(m * K, sizeof *distance_sq);
    enum status status = place && id && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < m; i++) place[i] = run->points.point[i * n / m];
    if (!status) status = knn_search(run->knn, place, m, K, run->threads, id, distance_sq);
    for (size_t i = 0; !status && i < m; i++)
        more += distance_sq[i * K + FAR] < distance_sq[i * K + NEAR] * pow((double)FAR / NEAR, 2 / BETWEEN);
    *as_surface = (double)more < MANY * (double)m;
    free(place), free(id), free(distance_sq);
    return status;
}

/* Whether a mesh is of a surface at all, so that there may be walls: normals tell, or where these don't, as on both
 * sides of many a thin wall, the number of points does; then it is in doubt.  Around thin bars there are normals of all
 * directions, and no doubt. */
static enum status may_have_walls(const struct run *run, const struct mesh *mesh, bool *may, bool *doubtful) {
    size_t count = 0;
    for (size_t v = 0; v < mesh->vertex_count; v++) count += is_certain(run, mesh->source[v]);
    double share = (double)count / (double)mesh->vertex_count;
    *may = run->bars || share > CERTAIN;
    *doubtful = !*may;
    return *may || share <= DOUBTFUL ? STATUS_OK : grow_as_surface(run, may);
}

enum status pipeline_find_lost(const struct run *run, const struct mesh *mesh, double *share) {
    uint8_t *lost = alloc_zeroed(mesh->vertex_count, 1);
    size_t count = 0;
    if (!lost) return STATUS_NO_MEMORY;
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            uint32_t v = mesh->triangle[t][k], w = mesh->triangle[t][(k + 1) % 3];
            if (runs_across(run, mesh, v, w)) lost[v] = lost[w] = 1;
        }
    for (size_t v = 0; v < mesh->vertex_count; v++) count += lost[v];
    *share = mesh->vertex_count ? (double)count / (double)mesh->vertex_count : 0;
    free(lost);
    return STATUS_OK;
}

struct wall_trial {
    struct mesh mesh;
    struct reconstruct_facts facts;
    struct surface_judged judged;
    double lost;
    bool had_shells; /* more of them than the mesh before, which are left out */
    size_t from;
};

/* Of thin walls: points at random on either side are nearer to those of the other than to their own here and there,
 * and a mesh of all of them has tunnels there, which go through points as well. */
static bool is_simpler_at_hand(const struct run *run, const struct surface_judged *judged,
                               const struct surface_judged *than) {
    static const double HARDLY = 0.01; /* of the spacing */
    const struct topology *own = &judged->topology, *other = &than->topology;
    bool fewer = own->components <= other->components && own->handles < other->handles;
    return run->neighbours.walls && fewer && judged->mean < than->mean + HARDLY * judged->spacing;
}

/* What joins pieces that are apart goes for a mesh that doesn't, though its few vertices may be a little nearer. */
static bool is_parted(const struct surface_judged *judged, const struct surface_judged *than) {
    static const double HARDLY_FARTHER = 1.2;
    return than->joined && !judged->joined && judged->topology.components <= than->topology.components &&
           judged->topology.handles <= than->topology.handles && judged->mean < HARDLY_FARTHER * than->mean;
}

/* Whether it is to be in place of run->mesh.  Where there were shells, between points that are too near to each other,
 * there may be spikes, and it has to gain more, unless the other lacks a wall. */
static enum status keeps_more(const struct run *run, const struct wall_trial *trial, const struct surface_judged *than,
                              bool *more) {
    static const double NEARER = 0.8;
    const struct surface_judged *judged = &trial->judged;
    if (is_simpler_at_hand(run, judged, than) || is_parted(judged, than)) {
        *more = true;
        return STATUS_OK;
    }
    bool enough = !trial->had_shells || judged->mean < NEARER * than->mean || surface_is_lost(than, judged);
    *more = false;
    if (!enough) return STATUS_OK;
    return pipeline_is_preferred(run, &trial->mesh, judged, than, PLACES * run->kept_count, more);
}

/* Points of thin walls enclose shells of their own, which are left out as far as there are more pieces than before. */
static enum status leave_out_shells_over(struct mesh *mesh, size_t components, unsigned threads, bool *left_out) {
    struct topology topology;
    enum status status = topology_find(mesh, &topology);
    const struct topology as_it_is = {.components = components, .handles = topology.handles};
    *left_out = !status && topology.components > components;
    return status ? status : topology_simplify(mesh, &as_it_is, false, threads, &topology);
}

/* The surface through the k most important points, with as many vertices as are kept.  Tubes are counted where it has
 * more handles than another. */
static enum status try_denser(struct run *run, size_t k, const struct topology *than, struct wall_trial *trial) {
    struct sites sites = {0};
    struct tets tets = {0};
    struct error ignored = {0};
    const struct memory_job job = {run->cloud->count, run->cloud->record_bytes, run->cloud->triangle_count, 0, 0};
    size_t most = memory_tetrahedra(&job, run->kept_count, false, run->params);
    if (run->params->order == ORDER_AUTO && most > TETRAHEDRA * k) most = TETRAHEDRA * k;
    if (run->neighbours.walls) most = pipeline_wall_tetrahedra(run);
    enum status status = pipeline_sites_of(run, k, &sites);
    if (!status) status = delaunay_build_within(sites.point, k, most, run->threads, &run->progress, &tets, &ignored);
    if (!status) status = pipeline_reconstruct_closed(run, &sites, &tets, &trial->mesh, &trial->facts);
    tets_done(&tets);
    pipeline_sites_done(&sites);
    if (!status) status = pipeline_find_lost(run, &trial->mesh, &trial->lost);
    if (!status) status = leave_out_shells_over(&trial->mesh, than->components, run->threads, &trial->had_shells);
    struct topology before = {0};
    if (!status && run->bars) status = topology_find(&trial->mesh, &before);
    if (!status && before.handles > than->handles) status = topology_count_tubes(&trial->mesh, &before);
    if (!status) status = mesh_decimate(&trial->mesh, NULL, run->kept_count);
    trial->from = k;
    if (!status) status = pipeline_judge(run, &trial->mesh, &trial->judged);
    trial->judged.topology.tubes = before.tubes;
    return status;
}

enum status pipeline_count_vertices(const struct run *run, const struct mesh *mesh, struct reconstruct_facts *facts) {
    uint8_t *there = alloc_zeroed(run->points.count, 1);
    size_t distinct = 0, kept = run->kept_count;
    if (!there) return STATUS_NO_MEMORY;
    for (size_t v = 0; v < mesh->vertex_count; v++) there[mesh->source[v]] = 1;
    for (size_t i = 0; i < run->points.count; i++) distinct += there[i];
    facts->points_lost = kept > distinct ? kept - distinct : 0;
    facts->vertices_split = mesh->vertex_count - distinct;
    free(there);
    return STATUS_OK;
}

/* Whether so many points are so far off that a whole sheet may be lost, from which no edge runs across any more. */
static enum status are_far(const struct run *run, const struct mesh *mesh, bool *far) {
    enum { FEW = 500, SCARCE = 16 /* times as many points, at least: else walls are hardly lost whole */ };
    struct points_off off;
    *far = false;
    if (run->kept_count * SCARCE > run->points.count) return STATUS_OK;
    enum status status = pipeline_points_off(run, mesh, FEW, &off);
    *far = !status && off.mean > SHEET_OFF * off.spacing;
    return status;
}

/* How many points the next trial has, 0: there is none. */
static size_t next_count(const struct run *run, size_t k, size_t most) {
    size_t kept = run->kept_count;
    if (!run->neighbours.walls) return k >= most ? 0 : k < most / DENSER ? k * DENSER : most;
    size_t next = k == kept ? most : k / DENSER;
    return next > kept ? next : 0;
}

/* Why meshes of more points are tried. */
struct wall_signs {
    bool sure;     /* the first in any case */
    bool joined;   /* there are fewer pieces than the points are known to have */
    bool far;      /* many points are far off */
    bool doubtful; /* whether there are walls */
};

static enum status is_joined(struct run *run, const struct mesh *mesh, bool *joined) {
    struct topology topology = {0};
    enum status status = pipeline_find_islands(run);
    if (!status && run->islands > 1) status = topology_find(mesh, &topology);
    *joined = !status && run->islands > 1 && topology.components < run->islands;
    return status;
}

/* Whether there is a reason. */
static enum status look_for_signs(const struct run *run, const struct wall_trial *kept, struct wall_signs *signs,
                                  bool *search) {
    *search = signs->sure || signs->joined;
    if (*search) return STATUS_OK;
    bool many = kept->lost > WALLS_LOST;
    enum status status = many ? STATUS_OK : are_far(run, &kept->mesh, &signs->far);
    if (!status && (many || signs->far)) status = may_have_walls(run, &kept->mesh, search, &signs->doubtful);
    return status;
}

enum status pipeline_resolve_walls(struct run *run, struct reconstruct_facts *facts) {
    enum order asked = (enum order)run->params->order;
    struct wall_trial best = {.mesh = run->mesh, .facts = *facts, .from = run->kept_count};
    bool always = asked == ORDER_RECONSTRUCT_FIRST;
    size_t most = pipeline_wall_points(run);
    if (run->neighbours.noisy && !always) return STATUS_OK;
    if (asked == ORDER_SIMPLIFY_FIRST || run->kept_count >= most) return STATUS_OK;
    enum status status = pipeline_find_lost(run, &best.mesh, &best.lost);
    double lost = best.lost;
    struct wall_signs signs = {.sure = creases_matter(&run->creases, run->points.count)};
    signs.sure = signs.sure || run->neighbours.walls || always;
    bool search = false;
    if (!status) status = is_joined(run, &best.mesh, &signs.joined);
    if (!status) status = look_for_signs(run, &best, &signs, &search);
    if (!status && search) status = pipeline_doubt_lid(run, facts);
    if (status || !search || run->surface.form != SURFACE_CLOSED) return status;
    status = pipeline_judge(run, &best.mesh, &best.judged);
    if (status || (signs.doubtful && best.judged.topology.components > PIECES + run->kept_count / PIECES_SHARE))
        return status;
    size_t k = run->kept_count;
    double least_lost = lost, first = best.judged.mean, least = first;
    bool nearer = false;
    int in_vain = 0;
    for (int i = 0; i < TRIALS && !status; i++) {
        struct wall_trial trial = {0};
        bool wanted = (i == 0 && signs.sure) || signs.far || lost > WALLS_LOST || nearer || best.judged.joined;
        k = next_count(run, k, most);
        if (in_vain == IN_VAIN || !wanted || k == 0) break;
        status = try_denser(run, k, &best.judged.topology, &trial);
        if (status == STATUS_LIMIT || status == STATUS_DEGENERATE) {
            mesh_done(&trial.mesh);
            status = STATUS_OK;
            break;
        }
        lost = trial.lost;
        bool gains = trial.judged.mean < GAINS * least;
        nearer = run->neighbours.walls &&
                 (trial.judged.mean < least || is_simpler_at_hand(run, &trial.judged, &best.judged));
        signs.far = !signs.doubtful && trial.judged.mean > SHEET_OFF * trial.judged.spacing;
        in_vain = lost < least_lost || gains || signs.far ? 0 : in_vain + 1;
        if (signs.doubtful && i + 1 == IN_DOUBT && trial.judged.mean > FAR_NEARER * first && !gains) in_vain = IN_VAIN;
        least_lost = fmin(least_lost, lost), least = fmin(least, trial.judged.mean);
        bool better = i == 0 && always;
        if (!better && !status) status = keeps_more(run, &trial, &best.judged, &better);
        if (better && !status) {
            struct wall_trial before = best;
            best = trial, trial = before;
            run->mesh = best.mesh;
        }
        mesh_done(&trial.mesh);
    }
    if (!status && best.from > run->kept_count) status = pipeline_count_vertices(run, &best.mesh, &best.facts);
    if (status) return status;
    *facts = best.facts;
    run->report.level[run->level].reconstructed_from = best.from;
    return STATUS_OK;
}
