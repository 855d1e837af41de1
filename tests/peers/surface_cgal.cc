/* CGAL's surfaces: a cloud becomes one, or one becomes smaller.
 *
 * front            advancing front reconstruction (Cohen-Steiner, Da 2004) of all points; COUNT is not looked at.
 * delaunay         two-dimensional Delaunay triangulation of all points, seen from above (z); nor is it here.
 * lindstrom-turk   edge collapse, memoryless (Lindstrom, Turk 1998), CGAL's default cost and placement.
 * garland-heckbert edge collapse by plane quadrics (Garland, Heckbert 1997), with CGAL's bound on the normals' change.
 *
 * The last two take a triangle mesh and stop at COUNT vertices.  They see the true connectivity, which no method on
 * points does.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <CGAL/Advancing_front_surface_reconstruction.h>
#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/repair.h>
#include <CGAL/Projection_traits_xy_3.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/Bounded_normal_change_placement.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/GarlandHeckbert_plane_policies.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/LindstromTurk_cost.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/LindstromTurk_placement.h>
#include <CGAL/Surface_mesh_simplification/edge_collapse.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>

#include "tests/peers/peer.h"

namespace collapse = CGAL::Surface_mesh_simplification;
namespace processing = CGAL::Polygon_mesh_processing;
using kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using mesh = CGAL::Surface_mesh<kernel::Point_3>;

static std::vector<kernel::Point_3> points_of(const surface &s) {
    std::vector<kernel::Point_3> p;
    p.reserve(s.vertex.size());
    for (const auto &v : s.vertex) p.emplace_back(v[0], v[1], v[2]);
    return p;
}

static mesh mesh_of(const surface &s) {
    std::vector<kernel::Point_3> p = points_of(s);
    std::vector<std::vector<std::size_t>> faces;
    faces.reserve(s.triangle.size());
    for (const auto &t : s.triangle) faces.push_back({std::size_t(t[0]), std::size_t(t[1]), std::size_t(t[2])});
    if (!processing::is_polygon_soup_a_polygon_mesh(faces)) processing::orient_polygon_soup(p, faces);
    mesh m;
    processing::polygon_soup_to_polygon_mesh(p, faces, m);
    processing::remove_isolated_vertices(m);
    return m;
}

static surface surface_of(mesh m) {
    m.collect_garbage();
    surface s;
    for (auto v : m.vertices()) s.vertex.push_back({m.point(v).x(), m.point(v).y(), m.point(v).z()});
    for (auto f : m.faces()) {
        std::array<std::int32_t, 3> t{};
        int corner = 0;
        for (auto v : m.vertices_around_face(m.halfedge(f))) t[std::size_t(corner++)] = std::int32_t(v.idx());
        s.triangle.push_back(t);
    }
    return s;
}

static peer::outcome run_front(const surface &in, std::size_t) {
    std::vector<kernel::Point_3> p = points_of(in);
    std::vector<std::array<std::size_t, 3>> facets;
    peer::outcome o;
    o.time = peer::time_of(
        [&] { CGAL::advancing_front_surface_reconstruction(p.begin(), p.end(), std::back_inserter(facets)); });
    o.made.vertex = in.vertex;
    for (const auto &f : facets)
        o.made.triangle.push_back({std::int32_t(f[0]), std::int32_t(f[1]), std::int32_t(f[2])});
    return o;
}

static peer::outcome run_delaunay(const surface &in, std::size_t) {
    using traits = CGAL::Projection_traits_xy_3<kernel>;
    using vertices = CGAL::Triangulation_vertex_base_with_info_2<std::int32_t, traits>;
    using triangulation = CGAL::Delaunay_triangulation_2<traits, CGAL::Triangulation_data_structure_2<vertices>>;
    std::vector<std::pair<kernel::Point_3, std::int32_t>> p;
    for (const auto &v : points_of(in)) p.emplace_back(v, std::int32_t(p.size()));
    triangulation made;
    peer::outcome o;
    o.time = peer::time_of([&] { made.insert(p.begin(), p.end()); });
    o.made.vertex = in.vertex;
    for (auto f : made.finite_face_handles())
        o.made.triangle.push_back({f->vertex(0)->info(), f->vertex(1)->info(), f->vertex(2)->info()});
    return o;
}

/* Stops at count vertices.  A collapse takes three edges of a closed mesh, and two at a border. */
struct stop_at {
    std::size_t count;
    template <class cost, class profile>
    bool operator()(const cost &, const profile &edge, std::size_t, std::size_t) const {
        return edge.surface_mesh().number_of_vertices() <= count;
    }
};

static peer::outcome run_lindstrom_turk(const surface &in, std::size_t count) {
    mesh m = mesh_of(in);
    stop_at stop{count};
    peer::spent time = peer::time_of([&] {
        collapse::edge_collapse(m, stop,
                                CGAL::parameters::get_cost(collapse::LindstromTurk_cost<mesh>())
                                    .get_placement(collapse::LindstromTurk_placement<mesh>()));
    });
    return {surface_of(m), time};
}

static peer::outcome run_garland_heckbert(const surface &in, std::size_t count) {
    using policies = collapse::GarlandHeckbert_plane_policies<mesh, kernel>;
    mesh m = mesh_of(in);
    stop_at stop{count};
    peer::spent time = peer::time_of([&] {
        policies quadrics(m);
        collapse::Bounded_normal_change_placement<policies::Get_placement> placement(quadrics.get_placement());
        collapse::edge_collapse(m, stop, CGAL::parameters::get_cost(quadrics.get_cost()).get_placement(placement));
    });
    return {surface_of(m), time};
}

int main(int argc, char **argv) {
    return peer::main(argc, argv,
                      {{"front", run_front},
                       {"delaunay", run_delaunay},
                       {"lindstrom-turk", run_lindstrom_turk},
                       {"garland-heckbert", run_garland_heckbert}});
}
