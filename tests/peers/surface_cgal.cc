/* CGAL's surfaces: a cloud becomes one, or one becomes smaller.
 *
 * front            advancing front reconstruction (Cohen-Steiner, Da 2004) of all points; COUNT is not looked at.
 * delaunay         two-dimensional Delaunay triangulation of all points, seen from above (z); nor is it here.
 * greedy           greedy insertion (Garland, Heckbert 1995) into such a triangulation: the point farthest above or
 *                  below its triangle, again and again, until there are COUNT.
 * lindstrom-turk   edge collapse, memoryless (Lindstrom, Turk 1998), CGAL's default cost and placement.
 * garland-heckbert edge collapse by plane quadrics (Garland, Heckbert 1997), with CGAL's bound on the normals' change.
 *
 * The collapses take a triangle mesh and stop at COUNT vertices.  They see the true connectivity, which no method on
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
#include <CGAL/Triangulation_face_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <CGAL/convex_hull_2.h>

#include <map>
#include <queue>

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

/* A height field that takes in the point farthest from it, by z, until it has enough. */
class greedy_insertion {
  public:
    explicit greedy_insertion(const std::vector<kernel::Point_3> &points) : p(points) {
        std::vector<kernel::Point_3> hull;
        CGAL::convex_hull_2(p.begin(), p.end(), std::back_inserter(hull), traits());
        std::vector<std::pair<kernel::Point_3, std::int32_t>> first;
        std::map<kernel::Point_3, std::int32_t> id;
        for (std::size_t i = 0; i < p.size(); i++) id[p[i]] = std::int32_t(i);
        for (const auto &v : hull) first.emplace_back(v, id[v]);
        made.insert(first.begin(), first.end());
        std::vector<std::int32_t> all(p.size());
        for (std::size_t i = 0; i < p.size(); i++) all[i] = std::int32_t(i);
        for (auto i : all) {
            auto f = made.locate(p[std::size_t(i)]);
            if (!made.is_infinite(f)) f->info().points.push_back(i);
        }
        for (auto f : made.finite_face_handles()) judge(f);
    }

    void insert_until(std::size_t count) {
        while (made.number_of_vertices() < count && !worst.empty()) {
            candidate next = worst.top();
            worst.pop();
            if (next.at->info().version == next.version) insert(next);
        }
    }

    std::vector<std::array<std::int32_t, 3>> triangles() const {
        std::vector<std::array<std::int32_t, 3>> t;
        for (auto f : made.finite_face_handles())
            t.push_back({f->vertex(0)->info(), f->vertex(1)->info(), f->vertex(2)->info()});
        return t;
    }

  private:
    struct waiting { /* points above or below a face */
        std::vector<std::int32_t> points;
        std::size_t version = 0;
    };
    using traits = CGAL::Projection_traits_xy_3<kernel>;
    using vertices = CGAL::Triangulation_vertex_base_with_info_2<std::int32_t, traits>;
    using faces = CGAL::Triangulation_face_base_with_info_2<waiting, traits>;
    using triangulation = CGAL::Delaunay_triangulation_2<traits, CGAL::Triangulation_data_structure_2<vertices, faces>>;
    using face = triangulation::Face_handle;
    struct candidate {
        double error;
        std::size_t version;
        face at;
        std::int32_t point;
        bool operator<(const candidate &other) const { return error < other.error; }
    };

    static double area(const kernel::Point_3 &a, const kernel::Point_3 &b, const kernel::Point_3 &c) {
        return (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
    }

    /* By how much the point is outside of the face, in units of area; negative within. */
    static double outside(face f, const kernel::Point_3 &q) {
        double most = -INFINITY;
        for (int k = 0; k < 3; k++)
            most = std::max(most, -area(f->vertex(k)->point(), f->vertex((k + 1) % 3)->point(), q));
        return most;
    }

    static double error(face f, const kernel::Point_3 &q) {
        const auto &a = f->vertex(0)->point(), &b = f->vertex(1)->point(), &c = f->vertex(2)->point();
        double all = area(a, b, c);
        if (all <= 0) return 0;
        return std::fabs(q.z() - (area(q, b, c) * a.z() + area(a, q, c) * b.z() + area(a, b, q) * c.z()) / all);
    }

    void judge(face f) {
        candidate best{0, ++versions, f, -1};
        f->info().version = versions;
        for (auto i : f->info().points) {
            double off = error(f, p[std::size_t(i)]);
            if (off > best.error) best.error = off, best.point = i;
        }
        if (best.point >= 0) worst.push(best);
    }

    void insert(const candidate &next) {
        std::vector<face> gone;
        std::vector<std::int32_t> points;
        const auto &q = p[std::size_t(next.point)];
        made.get_conflicts(q, std::back_inserter(gone), next.at);
        for (auto f : gone) points.insert(points.end(), f->info().points.begin(), f->info().points.end());
        for (auto f : gone) f->info() = waiting();
        auto v = made.insert(q, next.at);
        v->info() = next.point;
        std::vector<face> around;
        auto f = made.incident_faces(v), first = f;
        do {
            if (!made.is_infinite(f)) around.push_back(f), face(f)->info() = waiting();
        } while (++f != first);
        for (auto i : points) {
            if (i == next.point) continue;
            auto in = std::min_element(around.begin(), around.end(), [&](face a, face b) {
                return outside(a, p[std::size_t(i)]) < outside(b, p[std::size_t(i)]);
            });
            (*in)->info().points.push_back(i);
        }
        for (auto g : around) judge(g);
    }

    const std::vector<kernel::Point_3> &p;
    triangulation made;
    std::priority_queue<candidate> worst;
    std::size_t versions = 0;
};

static peer::outcome run_greedy(const surface &in, std::size_t count) {
    std::vector<kernel::Point_3> p = points_of(in);
    peer::outcome o;
    std::vector<std::array<std::int32_t, 3>> triangles;
    o.time = peer::time_of([&] {
        greedy_insertion greedy(p);
        greedy.insert_until(count);
        triangles = greedy.triangles();
    });
    std::vector<std::int32_t> of(p.size(), -1);
    for (auto &t : triangles)
        for (auto &corner : t) {
            if (of[std::size_t(corner)] < 0) {
                of[std::size_t(corner)] = std::int32_t(o.made.vertex.size());
                o.made.vertex.push_back(in.vertex[std::size_t(corner)]);
            }
            corner = of[std::size_t(corner)];
        }
    o.made.triangle = triangles;
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
                       {"greedy", run_greedy},
                       {"lindstrom-turk", run_lindstrom_turk},
                       {"garland-heckbert", run_garland_heckbert}});
}
