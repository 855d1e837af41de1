/* What is wrong with a mesh, open or closed: soundness_cgal MESH.ply prints one line of JSON.
 *
 *   pinched       vertices whose triangles form several fans
 *   crossings     pairs of triangles that cross each other
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/self_intersections.h>
#include <CGAL/Surface_mesh.h>

#include <cstdio>
#include <exception>
#include <map>

#include "tests/peers/ply.h"

namespace processing = CGAL::Polygon_mesh_processing;
using kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using mesh = CGAL::Surface_mesh<kernel::Point_3>;
using edge = std::array<std::int32_t, 2>;

static std::size_t root_of(std::vector<std::size_t> &root, std::size_t c) {
    while (root[c] != c) c = root[c] = root[root[c]];
    return c;
}

/* The corners at a vertex are joined where their triangles share an edge there; each further fan counts. */
static std::size_t count_pinched(const surface &s) {
    std::vector<std::size_t> root(3 * s.triangle.size()), fans(s.vertex.size());
    for (std::size_t c = 0; c < root.size(); c++) root[c] = c;
    std::map<edge, edge> seen; /* of each edge: a triangle that has it, its corner there */
    for (std::size_t t = 0; t < s.triangle.size(); t++)
        for (std::size_t k = 0; k < 3; k++)
            for (std::size_t side = 1; side < 3; side++) {
                std::int32_t at = s.triangle[t][k], to = s.triangle[t][(k + side) % 3];
                auto [other, is_new] = seen.insert({{at, to}, {std::int32_t(t), std::int32_t(k)}});
                if (is_new) continue;
                std::size_t there = 3 * std::size_t(other->second[0]) + std::size_t(other->second[1]);
                root[root_of(root, 3 * t + k)] = root_of(root, there);
            }
    std::size_t pinched = 0;
    for (std::size_t c = 0; c < root.size(); c++)
        if (root_of(root, c) == c) pinched += ++fans[std::size_t(s.triangle[c / 3][c % 3])] == 2;
    return pinched;
}

/* Where triangles around an edge or a vertex don't lie as in a manifold, these are doubled, and touch. */
static std::size_t count_crossings(const surface &s) {
    std::vector<kernel::Point_3> points;
    std::vector<std::vector<std::size_t>> faces;
    for (const auto &v : s.vertex) points.emplace_back(v[0], v[1], v[2]);
    for (const auto &t : s.triangle) faces.push_back({std::size_t(t[0]), std::size_t(t[1]), std::size_t(t[2])});
    processing::orient_polygon_soup(points, faces);
    mesh m;
    processing::polygon_soup_to_polygon_mesh(points, faces, m);
    std::vector<std::pair<mesh::Face_index, mesh::Face_index>> pairs;
    processing::self_intersections(m, std::back_inserter(pairs));
    return pairs.size();
}

int main(int argc, char **argv) {
    if (argc != 2) return std::fprintf(stderr, "Usage: %s MESH.ply\n", argv[0]), 2;
    try {
        surface s = ply::read(argv[1]);
        std::printf("{\"pinched\": %zu, \"crossings\": %zu}\n", count_pinched(s), count_crossings(s));
        return 0;
    } catch (const std::exception &e) {
        return std::fprintf(stderr, "%s: %s\n", argv[0], e.what()), 1;
    }
}
