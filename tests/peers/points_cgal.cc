/* CGAL's simplification of point sets.
 *
 * random     any COUNT points.
 * grid       one point of each cell of a grid.
 * hierarchy  clusters split by their principal axes until they are small and flat (Pauly, Gross, Kobbelt 2002); the
 *            point nearest to each centroid.  The largest size is searched for; the variation is CGAL's default, 1/3.
 * wlop       weighted locally optimal projection (Huang et al. 2009): positions are new.  Its radius decides.  Of 0.8,
 *            1, 1.15, 1.3, 2, 3 and 4 spacings of the simplified cloud 1.3 had the lowest mean error (Horse, Venus,
 *            bunny).  CGAL's default, 8 spacings of the full cloud, is 2.5 such spacings where a tenth is kept.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <CGAL/Simple_cartesian.h>
#include <CGAL/compute_average_spacing.h>
#include <CGAL/grid_simplify_point_set.h>
#include <CGAL/hierarchy_simplify_point_set.h>
#include <CGAL/random_simplify_point_set.h>
#include <CGAL/wlop_simplify_and_regularize_point_set.h>

#include "tests/peers/peer.h"

using kernel = CGAL::Simple_cartesian<double>;
using points = std::vector<kernel::Point_3>;

/* WLOP's radius in mean distances to six neighbours of a cloud of the size that is wanted. */
static constexpr double wlop_spacings = 1.3;

static points points_of(const surface &s) {
    points p;
    p.reserve(s.vertex.size());
    for (const auto &v : s.vertex) p.emplace_back(v[0], v[1], v[2]);
    return p;
}

static surface surface_of(const points &p) {
    surface s;
    for (const auto &q : p) s.vertex.push_back({q.x(), q.y(), q.z()});
    return s;
}

/* Times an algorithm that moves what it removes to the end. */
template <class remove> static peer::outcome keep_first(points p, remove algorithm) {
    peer::spent time = peer::time_of([&] { p.erase(algorithm(p), p.end()); });
    return {surface_of(p), time};
}

static peer::outcome run_random(const surface &in, std::size_t count) {
    /* Half a point more, or rounding may remove one too many. */
    double percent = 100 * (1 - (double(count) + 0.5) / double(in.vertex.size()));
    return keep_first(points_of(in),
                      [&](points &p) { return CGAL::random_simplify_point_set(p, std::max(percent, 0.)); });
}

static peer::outcome run_grid(const surface &in, std::size_t count) {
    points all = points_of(in);
    double size = peer::diagonal(in);
    return peer::search(count, 1e-5 * size, size, [&](double cell) {
        return keep_first(all, [&](points &p) { return CGAL::grid_simplify_point_set(p, cell); });
    });
}

static peer::outcome run_hierarchy(const surface &in, std::size_t count) {
    points all = points_of(in);
    return peer::search(count, 1, double(all.size()), [&](double size) {
        return keep_first(all, [&](points &p) {
            return CGAL::hierarchy_simplify_point_set(
                p, CGAL::parameters::size(unsigned(std::lround(size))).maximum_variation(1. / 3));
        });
    });
}

static peer::outcome run_wlop(const surface &in, std::size_t count) {
    points all = points_of(in), made;
    double n = double(all.size()), percent = 100 * (double(count) + 0.5) / n;
    peer::spent time = peer::time_of([&] {
        double spacing = CGAL::compute_average_spacing<CGAL::Parallel_if_available_tag>(all, 6);
        double radius = wlop_spacings * spacing * std::sqrt(n / double(count));
        CGAL::wlop_simplify_and_regularize_point_set<CGAL::Parallel_if_available_tag>(
            all, std::back_inserter(made), CGAL::parameters::select_percentage(percent).neighbor_radius(radius));
    });
    return {surface_of(made), time};
}

int main(int argc, char **argv) {
    return peer::main(argc, argv,
                      {{"random", run_random}, {"grid", run_grid}, {"hierarchy", run_hierarchy}, {"wlop", run_wlop}});
}
