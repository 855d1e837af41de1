/* Thin walls: once kept points are farther apart than a wall is thick, edges of the mesh run across it, from the one
 * sheet to the other, and the inner sheet is lost.  Then the surface is reconstructed from more points of the ranking,
 * where the sheets can be told apart, and its edges are collapsed to as many vertices as are kept, with the topology
 * that it has.
 *
 * Where the surface has creases, more points tell their course as well, so that twice as many are tried in any case.
 *
 * More points aren't always better: where sheets touch, points that are dense join them.  So counts double from the
 * kept ones on, the first with which hardly any edge runs across ends the search, and the nearest to the original
 * points of those tried is taken, unless it has more pieces or handles than the mesh of the kept points.
 *
 * There is no search where there can be no walls: in a noisy cloud, where most vertices have another normal than the
 * points nearby, and among points that have more tetrahedra than those of a surface do.
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
enum { DENSER = 2, TRIALS = 4, IN_VAIN = 2 /* trials after which no fewer edges run across */ };
enum { TETRAHEDRA = 8 }; /* for each point, at most: surfaces have 6.4 to 7.1 */

enum { ALONG = 4 /* as many points before and after one along the curve are near it, as a rule */ };
static const double ALIKE = 0.7;   /* cosine between normals of a surface that are near each other */
static const double CERTAIN = 0.5; /* share of a surface's vertices with such normals, at least */

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

static bool are_certain(const struct run *run, const struct mesh *mesh) {
    size_t count = 0;
    for (size_t v = 0; v < mesh->vertex_count; v++) count += is_certain(run, mesh->source[v]);
    return (double)count > CERTAIN * (double)mesh->vertex_count;
}

/* The share of a mesh's vertices from which an edge runs across a wall. */
static enum status find_lost(const struct run *run, const struct mesh *mesh, double *share) {
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
    size_t from;
};

/* The surface through the k most important points, with as many vertices as are kept. */
static enum status try_denser(struct run *run, size_t k, struct wall_trial *trial) {
    struct sites sites = {0};
    struct tets tets = {0};
    struct error ignored = {0};
    const struct memory_job job = {run->cloud->count, run->cloud->record_bytes, run->cloud->triangle_count, 0, 0};
    size_t most = memory_tetrahedra(&job, run->kept_count, false, run->params);
    if (run->params->order == ORDER_AUTO && most > TETRAHEDRA * k) most = TETRAHEDRA * k;
    enum status status = pipeline_sites_of(run, k, &sites);
    if (!status) status = delaunay_build_within(sites.point, k, most, run->threads, &run->progress, &tets, &ignored);
    if (!status) status = pipeline_reconstruct_closed(run, &sites, &tets, &trial->mesh, &trial->facts);
    tets_done(&tets);
    pipeline_sites_done(&sites);
    if (!status) status = find_lost(run, &trial->mesh, &trial->lost);
    if (!status) status = mesh_decimate(&trial->mesh, NULL, run->kept_count);
    trial->from = k;
    return status ? status : pipeline_judge(run, &trial->mesh, &trial->judged);
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

enum status pipeline_resolve_walls(struct run *run, struct reconstruct_facts *facts) {
    enum order asked = (enum order)run->params->order;
    struct wall_trial best = {.mesh = run->mesh, .facts = *facts, .from = run->kept_count};
    bool always = asked == ORDER_RECONSTRUCT_FIRST;
    size_t most = memory_usual_points(run->points.count, run->kept_count);
    if (most > run->points.count) most = run->points.count;
    if (run->neighbours.noisy && !always) return STATUS_OK;
    if (asked == ORDER_SIMPLIFY_FIRST || run->kept_count >= most) return STATUS_OK;
    enum status status = find_lost(run, &best.mesh, &best.lost);
    double lost = best.lost;
    bool creased = creases_matter(&run->creases, run->points.count);
    if (status || !(always || creased || (lost > WALLS_LOST && are_certain(run, &best.mesh)))) return status;
    status = pipeline_judge(run, &best.mesh, &best.judged);
    size_t k = run->kept_count;
    double least_lost = lost;
    int in_vain = 0;
    for (int i = 0; i < TRIALS && !status && k < most && ((i == 0 && (always || creased)) || lost > WALLS_LOST); i++) {
        struct wall_trial trial = {0};
        if (in_vain == IN_VAIN) break;
        k = k < most / DENSER ? k * DENSER : most;
        status = try_denser(run, k, &trial);
        if (status == STATUS_LIMIT || status == STATUS_DEGENERATE) {
            mesh_done(&trial.mesh);
            status = STATUS_OK;
            break;
        }
        lost = trial.lost;
        in_vain = lost < least_lost ? 0 : in_vain + 1;
        least_lost = fmin(least_lost, lost);
        if (!status && ((i == 0 && always) || surface_is_better(&trial.judged, &best.judged))) {
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
