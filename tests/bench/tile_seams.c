/* Whether borders of tiles show in a result: tile_seams SCRATCH KEPT.ply
 *
 * Of the points of the tiles in a scratch folder, a share: how many of them are kept, and how far the nearest kept
 * point is, near the borders between tiles against inside.  Near: within four mean distances.  Prints ratios, which are
 * 1 where there is no seam, with their standard errors.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/morton.h"
#include "core/io/read.h"
#include "core/spatial/knn.h"
#include "core/tiles/scratch.h"

enum { PIECE = 1 << 20, EACH = 7 };
static const double NEAR = 4;

struct zone {
    double points, kept, sum, sum_sq;
};

static void fail(const char *what) {
    fprintf(stderr, "tile_seams: %s\n", what);
    exit(1);
}

/* How far the point is from the nearest face of its tile that another tile may lie behind. */
static double depth_of(const struct scratch *s, const struct grid *grid, const struct grid_tile *tile,
                       const struct grid_tile *all, vec3 p) {
    double side = grid_side(grid), least = INFINITY;
    const double at[3] = {p.x - grid->anchor.x, p.y - grid->anchor.y, p.z - grid->anchor.z};
    (void)s;
    for (int axis = 0; axis < 3; axis++) {
        if (tile->from.at[axis] > all->from.at[axis])
            least = fmin(least, at[axis] - side * (double)tile->from.at[axis]);
        if (tile->to.at[axis] < all->to.at[axis]) least = fmin(least, side * (double)tile->to.at[axis] - at[axis]);
    }
    return least;
}

static double mean_of(const struct zone *zone) { return zone->sum / zone->points; }

static double error_of(const struct zone *zone) {
    double mean = mean_of(zone);
    return sqrt(fmax(zone->sum_sq / zone->points - mean * mean, 0) / zone->points) / mean;
}

int main(int argc, char **argv) {
    struct scratch s = {0};
    struct grid grid = {0};
    struct error error = {0};
    struct cloud kept = {0};
    struct ordered_points ordered;
    struct knn *knn;
    if (argc != 3) fail("usage: tile_seams SCRATCH KEPT.ply");
    if (scratch_load(argv[1], &s, &error) || cloud_read_path(argv[2], NULL, NULL, &kept, &error)) fail(error.text);
    if (grid_from(&grid, s.head.anchor, s.head.level, s.cell, s.head.cells) ||
        order_points_of(&s.head.whole, kept.position, kept.count, 0, &ordered) ||
        knn_new(ordered.point, ordered.count, 0, &knn, &error))
        fail("no memory");
    struct grid_tile all = s.tile[0];
    for (size_t t = 1; t < s.head.tiles; t++)
        for (int axis = 0; axis < 3; axis++) {
            if (s.tile[t].from.at[axis] < all.from.at[axis]) all.from.at[axis] = s.tile[t].from.at[axis];
            if (s.tile[t].to.at[axis] > all.to.at[axis]) all.to.at[axis] = s.tile[t].to.at[axis];
        }
    struct zone zone[2] = {{0}}; /* inside, near a border */
    double width = -1;
    for (size_t t = 0; t < s.head.tiles; t++) {
        struct scratch_points points;
        if (scratch_gather(argv[1], &s, &grid, &s.tile[t], 0, UINT64_MAX, 1, &points, &error)) fail(error.text);
        size_t n = 0;
        vec3 *query = alloc_array(points.count, sizeof *query);
        uint32_t *id = alloc_array(points.count, sizeof *id);
        double *distance_sq = alloc_array(points.count, sizeof *distance_sq),
               *depth = alloc_array(points.count, sizeof *depth);
        if (!query || !id || !distance_sq || !depth) fail("no memory");
        for (size_t i = 0; i < points.count; i += EACH) {
            if (!points.own[i]) continue;
            vec3 d = vec3_sub(points.position[i], s.head.whole.centre);
            depth[n] = depth_of(&s, &grid, &s.tile[t], &all, points.position[i]) / s.head.whole.scale;
            query[n++] = (vec3){d.x / s.head.whole.scale, d.y / s.head.whole.scale, d.z / s.head.whole.scale};
        }
        if (knn_search(knn, query, n, 1, 0, id, distance_sq)) fail("no memory");
        double sum = 0;
        for (size_t i = 0; i < n; i++) sum += sqrt(distance_sq[i]);
        if (width < 0) width = NEAR * sum / (double)n;
        for (size_t i = 0; i < n; i++) {
            struct zone *z = &zone[depth[i] < width];
            double distance = sqrt(distance_sq[i]);
            z->points++;
            z->kept += distance == 0;
            z->sum += distance;
            z->sum_sq += distance * distance;
        }
        free(query), free(id), free(distance_sq), free(depth);
        scratch_points_done(&points);
    }
    if (zone[0].kept == 0 || zone[1].kept == 0) fail("too few points near borders");
    double density = zone[1].kept / zone[1].points / (zone[0].kept / zone[0].points);
    printf("near borders     %.0f of %.0f points\n", zone[1].points, zone[0].points + zone[1].points);
    printf("density          %.4f of the inside's, standard error %.4f\n", density,
           density * sqrt(1 / zone[1].kept + 1 / zone[0].kept));
    printf("distance         %.4f of the inside's, standard error %.4f\n", mean_of(&zone[1]) / mean_of(&zone[0]),
           hypot(error_of(&zone[0]), error_of(&zone[1])));
    knn_free(knn);
    ordered_points_done(&ordered);
    cloud_done(&kept);
    grid_done(&grid);
    scratch_done(&s);
    return 0;
}
