/* meshoptimizer: quadric simplification of a triangle mesh to the number of triangles that leaves COUNT vertices of a
 * closed one.  Vertices stay where they are; coordinates are float.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <meshoptimizer.h>

#include <algorithm>

#include "tests/peers/peer.h"

/* The vertices that are in use, and the triangles of them. */
static surface surface_of(const surface &in, const std::vector<unsigned> &corner) {
    std::vector<unsigned> used(corner);
    std::sort(used.begin(), used.end());
    used.erase(std::unique(used.begin(), used.end()), used.end());
    auto place = [&](unsigned v) { return std::int32_t(std::lower_bound(used.begin(), used.end(), v) - used.begin()); };
    surface s;
    for (unsigned v : used) s.vertex.push_back(in.vertex[v]);
    for (std::size_t i = 0; i < corner.size(); i += 3)
        s.triangle.push_back({place(corner[i]), place(corner[i + 1]), place(corner[i + 2])});
    return s;
}

static peer::outcome run_simplify(const surface &in, std::size_t count) {
    std::vector<float> position;
    std::vector<unsigned> corner;
    for (const auto &v : in.vertex)
        for (double x : v) position.push_back(float(x));
    for (const auto &t : in.triangle)
        for (std::int32_t v : t) corner.push_back(unsigned(v));
    std::vector<unsigned> kept(corner.size());
    std::size_t goal = 3 * peer::triangles_for(in, count);
    peer::spent time = peer::time_of([&] {
        kept.resize(meshopt_simplify(kept.data(), corner.data(), corner.size(), position.data(), in.vertex.size(),
                                     3 * sizeof(float), goal, HUGE_VALF));
    });
    return {surface_of(in, kept), time};
}

int main(int argc, char **argv) { return peer::main(argc, argv, {{"simplify", run_simplify}}); }
