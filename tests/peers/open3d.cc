/* Open3D: farthest-point sampling of a cloud; Poisson reconstruction of all points (Kazhdan, Hoppe 2013), without what
 * is FAR spacings from any; and quadric decimation of a triangle mesh to COUNT vertices.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <open3d/geometry/KDTreeFlann.h>
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

#define FAR 4.0
enum { NEIGHBOURS = 15, SIXTH = 7, DEPTH = 10 };

/* Of the distances to the sixth neighbour the median. */
static double spacing_of(const geometry::KDTreeFlann &tree, const vectors &p) {
    std::vector<double> spacing, square;
    std::vector<int> id;
    for (std::size_t i = 0; i < p.size(); i += 1 + p.size() / 5000)
        if (tree.SearchKNN(p[i], SIXTH, id, square) == SIXTH) spacing.push_back(std::sqrt(square.back()));
    if (spacing.empty()) throw std::runtime_error("too few points");
    std::nth_element(spacing.begin(), spacing.begin() + std::ptrdiff_t(spacing.size() / 2), spacing.end());
    return spacing[spacing.size() / 2];
}

static void keep_what_is_near(geometry::TriangleMesh &mesh, const vectors &p) {
    geometry::KDTreeFlann tree;
    tree.SetMatrixData(Eigen::Map<const Eigen::MatrixXd>(p[0].data(), 3, Eigen::Index(p.size())));
    double far = FAR * spacing_of(tree, p);
    std::vector<bool> is_far;
    std::vector<double> square;
    std::vector<int> id;
    for (const auto &v : mesh.vertices_)
        is_far.push_back(tree.SearchKNN(v, 1, id, square) < 1 || square[0] > far * far);
    mesh.RemoveVerticesByMask(is_far);
}

/* Normals are Open3D's own, turned alike along a spanning tree. */
static peer::outcome run_poisson(const surface &in, std::size_t) {
    geometry::PointCloud all(vectors_of(in));
    std::shared_ptr<geometry::TriangleMesh> made;
    peer::spent time = peer::time_of([&] {
        all.EstimateNormals(geometry::KDTreeSearchParamKNN(NEIGHBOURS));
        all.OrientNormalsConsistentTangentPlane(NEIGHBOURS);
        made = std::get<0>(geometry::TriangleMesh::CreateFromPointCloudPoisson(all, DEPTH));
        keep_what_is_near(*made, all.points_);
    });
    return {surface_of(made->vertices_, made->triangles_), time};
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
    return peer::main(argc, argv,
                      {{"farthest", run_farthest}, {"poisson", run_poisson}, {"decimation", run_decimation}});
}
