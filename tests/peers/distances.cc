/* How far two surfaces are from each other, by CGAL: a judge of whittle's own measuring.
 *
 *     distances A.ply B.ply SAMPLES
 *
 * prints one line of JSON: mean and largest distance from A to B ("there") and from B to A ("back").  Means are over
 * SAMPLES points uniform by area.  The largest distance is within a hundredth of the true one: a distance changes by no
 * more than the place does, so a part of a triangle whose middle is so near that none of the part can be farther than
 * the farthest point known is done with, and any other is divided.  Nothing of whittle's is in here.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <CGAL/AABB_traits.h>
#include <CGAL/AABB_tree.h>
#include <CGAL/AABB_triangle_primitive.h>
#include <CGAL/Simple_cartesian.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <random>

#include "tests/peers/ply.h"

using kernel = CGAL::Simple_cartesian<double>;
using point = kernel::Point_3;
using triangle = kernel::Triangle_3;
using primitive = CGAL::AABB_triangle_primitive<kernel, std::vector<triangle>::const_iterator>;
using tree = CGAL::AABB_tree<CGAL::AABB_traits<kernel, primitive>>;

constexpr double PRECISION = 0.01; /* of the largest distance */

struct found {
    double mean = 0, max = 0;
};

static std::vector<triangle> triangles_of(const surface &s) {
    std::vector<triangle> list;
    for (const auto &t : s.triangle) {
        point p[3];
        for (int k = 0; k < 3; k++) {
            const auto &v = s.vertex.at(std::size_t(t[k]));
            p[k] = point(v[0], v[1], v[2]);
        }
        if (triangle made(p[0], p[1], p[2]); made.squared_area() > 0) list.push_back(made);
    }
    if (list.empty()) throw std::runtime_error("no triangles");
    return list;
}

/* Samples of the area go to triangles by chance, in proportion to it. */
static found distance(const std::vector<triangle> &from, const tree &to, std::size_t samples) {
    std::mt19937_64 random(20240731);
    std::uniform_real_distribution<double> unit(0, 1);
    std::vector<double> area;
    double whole = 0;
    for (const triangle &t : from) area.push_back(whole += std::sqrt(t.squared_area()));
    found f;
    auto look = [&](const point &p) {
        double d = std::sqrt(to.squared_distance(p));
        f.max = std::max(f.max, d);
        return d;
    };
    for (std::size_t i = 0; i < samples; i++) {
        auto at = std::upper_bound(area.begin(), area.end() - 1, whole * unit(random)) - area.begin();
        double u = unit(random), v = unit(random);
        if (u + v > 1) u = 1 - u, v = 1 - v;
        const triangle &t = from[std::size_t(at)];
        f.mean += look(t[0] + u * (t[1] - t[0]) + v * (t[2] - t[0]));
    }
    f.mean /= double(samples);
    for (const triangle &t : from)
        for (int k = 0; k < 3; k++) look(t[k]);
    std::vector<triangle> parts = from;
    while (!parts.empty()) {
        triangle t = parts.back();
        parts.pop_back();
        point middle = CGAL::centroid(t);
        double reach = 0, at_middle = look(middle);
        for (int k = 0; k < 3; k++) reach = std::max(reach, std::sqrt(CGAL::squared_distance(middle, t[k])));
        if (at_middle + reach <= (1 + PRECISION) * f.max) continue;
        point a = CGAL::midpoint(t[1], t[2]), b = CGAL::midpoint(t[2], t[0]), c = CGAL::midpoint(t[0], t[1]);
        for (const triangle &part :
             {triangle(t[0], c, b), triangle(t[1], a, c), triangle(t[2], b, a), triangle(a, b, c)})
            parts.push_back(part);
    }
    return f;
}

int main(int argc, char **argv) {
    if (argc != 4) {
        std::fprintf(stderr, "Usage: %s A.ply B.ply SAMPLES\n", argv[0]);
        return 2;
    }
    try {
        std::vector<triangle> a = triangles_of(ply::read(argv[1])), b = triangles_of(ply::read(argv[2]));
        tree tree_a(a.cbegin(), a.cend()), tree_b(b.cbegin(), b.cend());
        std::size_t samples = std::stoul(argv[3]);
        found there = distance(a, tree_b, samples), back = distance(b, tree_a, samples);
        std::printf("{\"there\": {\"mean\": %.9g, \"max\": %.9g}, \"back\": {\"mean\": %.9g, \"max\": %.9g}}\n",
                    there.mean, there.max, back.mean, back.max);
        return 0;
    } catch (const std::exception &e) {
        std::fprintf(stderr, "%s: %s\n", argv[0], e.what());
        return 1;
    }
}
