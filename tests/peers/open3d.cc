/* Open3D: farthest-point sampling of a cloud, and quadric decimation of a closed triangle mesh to the number of
 * triangles that leaves COUNT vertices.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <open3d/geometry/PointCloud.h>
#include <open3d/geometry/TriangleMesh.h>

#include "tests/peers/peer.h"

namespace geometry = open3d::geometry;
using vectors = std::vector<Eigen::Vector3d>;

static vectors vectors_of(const surface &s) {
    vectors p;
    for (const auto &v : s.vertex) p.emplace_back(v[0], v[1], v[2]);
    return p;
}

static surface surface_of(const vectors &p, const std::vector<Eigen::Vector3i> &triangles) {
    surface s;
    for (const auto &v : p) s.vertex.push_back({v[0], v[1], v[2]});
    for (const auto &t : triangles) s.triangle.push_back({t[0], t[1], t[2]});
    return s;
}

static peer::outcome run_farthest(const surface &in, std::size_t count) {
    geometry::PointCloud all(vectors_of(in));
    std::shared_ptr<geometry::PointCloud> made;
    peer::spent time = peer::time_of([&] { made = all.FarthestPointDownSample(count); });
    return {surface_of(made->points_, {}), time};
}

static peer::outcome run_decimation(const surface &in, std::size_t count) {
    std::vector<Eigen::Vector3i> triangles;
    for (const auto &t : in.triangle) triangles.emplace_back(t[0], t[1], t[2]);
    geometry::TriangleMesh mesh(vectors_of(in), triangles);
    std::shared_ptr<geometry::TriangleMesh> made;
    int goal = int(peer::triangles_for(in, count));
    peer::spent time = peer::time_of([&] { made = mesh.SimplifyQuadricDecimation(goal, HUGE_VAL, 1); });
    return {surface_of(made->vertices_, made->triangles_), time};
}

int main(int argc, char **argv) {
    return peer::main(argc, argv, {{"farthest", run_farthest}, {"decimation", run_decimation}});
}
