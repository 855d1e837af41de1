/* The shim around CGAL's Delaunay triangulation: in go points, out come flat arrays, and no exception.
 *
 * Design.  Points are inserted one by one, each found from the cell of the one before, so that a caller can cancel.
 * They come along a space-filling curve, so sorting them is saved: rounds of ever more points go along it, each round's
 * spread evenly over all that are left for it (a biased randomised insertion order).  Predicates are exact (EPICK),
 * constructions are not needed but for the circumcentres, which are computed here in double relative to a vertex, and
 * exactly for the flat cells where double would lose them: few on surfaces, many where lines meet.  Insertion is one
 * thread's work; all threads share what comes after it.
 *
 * Invariant.  The Delaunay triangulation with CGAL's symbolic perturbation is unique for a set of points, so the set of
 * cells doesn't depend on the order of insertion; `Numbering` makes the arrays unique, too: it orders the vertices in
 * each cell and then the cells, by counting on the smallest id and comparing the rest.
 *
 * Conventions of the border: every extern "C" function is noexcept and its whole body runs inside guard(), which turns
 * exceptions into statuses; CGAL's failure handlers throw quietly while it runs.
 *
 * Sources: N. Amenta, S. Choi, G. Rote, Incremental constructions con BRIO, 2003.  C. Jamin, S. Pion, M. Teillaud, 3D
 * Triangulations, CGAL manual.  O. Devillers, M. Teillaud, Perturbations
 * for Delaunay and weighted Delaunay 3D triangulations, 2011.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/delaunay_cgal.h"

#include <stdlib.h>

#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Exact_rational.h>
#include <CGAL/Mpzf.h>
#include <CGAL/Triangulation_cell_base_with_info_3.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_3.h>
#include <CGAL/assertions_behaviour.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <memory>
#include <new>
#include <numeric>
#include <type_traits>
#include <vector>

extern "C" {
#include "core/base/alloc.h"
#include "core/base/par.h"
}

namespace {

constexpr uint32_t AT_INFINITY = UINT32_MAX; /* NONE of core/cloud/cloud.h */
constexpr size_t MAX_POINTS = size_t{1} << 28;
constexpr size_t TICK_EVERY = 2048; /* insertions: a few milliseconds */
constexpr size_t FIRST_ROUND = 64;  /* points, at most */
constexpr size_t GROWTH = 8;        /* of a round from those before */
constexpr size_t GRAIN = 2048;      /* cells, or buckets of cells */
constexpr double FLAT = 1e-10;      /* of the cube of the longest edge: below, double loses the circumcentre */
constexpr double FARTHEST = 1e100;  /* squares and products of coordinates up to here stay finite */

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Vertex_base = CGAL::Triangulation_vertex_base_with_info_3<uint32_t, Kernel>;
using Cell_base = CGAL::Triangulation_cell_base_with_info_3<uint32_t, Kernel>;
using Delaunay = CGAL::Delaunay_triangulation_3<Kernel, CGAL::Triangulation_data_structure_3<Vertex_base, Cell_base>>;
using Point = Kernel::Point_3;
using Planar = CGAL::Delaunay_triangulation_2<
    Kernel, CGAL::Triangulation_data_structure_2<CGAL::Triangulation_vertex_base_with_info_2<uint32_t, Kernel>>>;

struct Failure {
    enum status status;
    const char *text;
};

/* CGAL prints before it throws, unless its handlers are others. */
void stay_quiet(const char *, const char *, const char *, int, const char *) {}

struct Quiet_handlers {
    CGAL::Failure_function error = CGAL::set_error_handler(stay_quiet);
    CGAL::Failure_function warning = CGAL::set_warning_handler(stay_quiet);
    ~Quiet_handlers() {
        CGAL::set_error_handler(error);
        CGAL::set_warning_handler(warning);
    }
};

template <class Body> enum status guard(struct error *error, Body &&body) noexcept {
    try {
        Quiet_handlers quiet;
        body();
        return STATUS_OK;
    } catch (const Failure &failure) {
        return error_set(error, failure.status, "delaunay", "%s", failure.text);
    } catch (const std::bad_alloc &) {
        return error_set(error, STATUS_NO_MEMORY, "delaunay", "out of memory");
    } catch (const std::exception &exception) {
        return error_set(error, STATUS_ENGINE, "delaunay", "CGAL: %s", exception.what());
    } catch (...) {
        return error_set(error, STATUS_ENGINE, "delaunay", "CGAL threw");
    }
}

struct Tets_owner {
    struct tets tets = {};
    ~Tets_owner() { tets_done(&tets); }
    struct tets release() {
        struct tets out = tets;
        tets = {};
        return out;
    }
};

template <class Item> Item *new_array(size_t n) {
    auto *array = static_cast<Item *>(alloc_array(n, sizeof(Item)));
    if (!array) throw std::bad_alloc();
    return array;
}

/* ------------------------------------------------------------------------------------------------ insertion */

/* A number below n for each index below n.  Those of indices in a row are spread evenly: i times the golden ratio, of
 * which the whole part is left out. */
size_t spread(size_t i, size_t n) { return static_cast<uint32_t>(i * 2654435769u) * uint64_t{n} >> 32; }

/* Round by round, the last one with most of the points. */
std::vector<size_t> insertion_order(size_t n) {
    std::vector<size_t> order;
    order.reserve(n);
    size_t before = 0, end = n;
    while (end > FIRST_ROUND) end /= GROWTH;
    for (; before < n; before = end, end = std::min(n, end * GROWTH + GROWTH))
        for (size_t i = 0; i < n; i++)
            if (size_t at = spread(i, n); at >= before && at < end) order.push_back(i);
    return order;
}

/* While CGAL makes up to so many cells of an insertion it fills a table that lives as long as the thread.  An exception
 * then would leave it filled for the next triangulation, so there is room for these cells before. */
constexpr size_t SMALL_HOLE = 128;

void make_room_for_cells(Delaunay &delaunay) {
    auto &cells = delaunay.tds().cells();
    static_assert(Delaunay::Triangulation_data_structure::maximal_nb_of_facets_of_small_hole == SMALL_HOLE, "as CGAL");
    while (cells.capacity() - cells.size() < SMALL_HOLE) cells.reserve(cells.capacity() + 1);
}

void insert_all(Delaunay &delaunay, const std::vector<Point> &points, size_t most_cells,
                const struct progress *progress) {
    std::vector<size_t> order = insertion_order(points.size());
    Delaunay::Cell_handle near;
    for (size_t i = 0; i < order.size(); i++) {
        if (i % TICK_EVERY == 0 &&
            progress_tick(progress, "delaunay", 0.9 * static_cast<double>(i) / static_cast<double>(order.size())))
            throw Failure{STATUS_CANCELLED, "cancelled"};
        make_room_for_cells(delaunay);
        auto vertex = delaunay.insert(points[order[i]], near);
        vertex->info() = static_cast<uint32_t>(order[i]);
        near = vertex->cell();
        if (delaunay.number_of_cells() > most_cells)
            throw Failure{STATUS_LIMIT, "the kept points have too many tetrahedra between them, as points along curves "
                                        "have and those of surfaces don't: leave the mesh out (outputs=cloud), or keep "
                                        "fewer points (ratio)"};
    }
}

/* -------------------------------------------------------------------------------------------- circumcentres */

vec3 facet_circumcentre(vec3 a, vec3 b, vec3 c) {
    vec3 u = vec3_sub(b, a), v = vec3_sub(c, a), w = vec3_cross(u, v);
    vec3 to =
        vec3_add(vec3_scale(vec3_cross(w, u), vec3_length_sq(v)), vec3_scale(vec3_cross(v, w), vec3_length_sq(u)));
    return vec3_add(a, vec3_scale(to, 1 / (2 * vec3_length_sq(w))));
}

vec3 largest_facet_circumcentre(const vec3 p[4]) {
    static constexpr int facet[4][3] = {{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}};
    int best = 0;
    double best_sq = -1;
    for (int i = 0; i < 4; i++) {
        double area_sq = vec3_length_sq(vec3_triangle_normal(p[facet[i][0]], p[facet[i][1]], p[facet[i][2]]));
        if (area_sq > best_sq) best = i, best_sq = area_sq;
    }
    vec3 centre = facet_circumcentre(p[facet[best][0]], p[facet[best][1]], p[facet[best][2]]);
    return vec3_is_finite(centre) ? centre : p[0];
}

/* Numerators and denominator, which are exact, divided.  Without the divisions of rational numbers, which look for
 * common divisors at each step, that takes a small part of their time.  False where either is beyond double. */
bool divided_circumcentre(const vec3 p[4], vec3 *centre) {
    using Number = CGAL::Mpzf;
    Number origin[3] = {p[0].x, p[0].y, p[0].z}, edge[3][3], square[3], cross[3][3];
    for (int i = 0; i < 3; i++) {
        const double corner[3] = {p[i + 1].x, p[i + 1].y, p[i + 1].z};
        for (int k = 0; k < 3; k++) edge[i][k] = Number(corner[k]) - origin[k];
        square[i] = edge[i][0] * edge[i][0] + edge[i][1] * edge[i][1] + edge[i][2] * edge[i][2];
    }
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const Number *u = edge[(i + 1) % 3], *v = edge[(i + 2) % 3];
            int next = (k + 1) % 3, last = (k + 2) % 3;
            cross[i][k] = u[next] * v[last] - u[last] * v[next];
        }
    Number volume = edge[0][0] * cross[0][0] + edge[0][1] * cross[0][1] + edge[0][2] * cross[0][2];
    Number below = volume + volume;
    double place[3] = {0, 0, 0}, divisor = below.to_double();
    for (int k = 0; k < 3; k++) {
        Number sum = square[0] * cross[0][k] + square[1] * cross[1][k] + square[2] * cross[2][k];
        Number above = sum + below * origin[k];
        if (CGAL::sign(above) == CGAL::ZERO) continue;
        double dividend = above.to_double();
        place[k] = dividend / divisor;
        if (!std::isnormal(dividend) || !std::isnormal(place[k])) return false;
    }
    *centre = vec3{place[0], place[1], place[2]};
    return std::isnormal(divisor);
}

vec3 exact_circumcentre(const vec3 p[4]) {
    vec3 centre = {};
    if (divided_circumcentre(p, &centre)) return centre;
    using Exact = CGAL::Simple_cartesian<CGAL::Exact_rational>;
    std::array<Exact::Point_3, 4> q;
    for (int i = 0; i < 4; i++) q[i] = Exact::Point_3(p[i].x, p[i].y, p[i].z);
    auto c = CGAL::circumcenter(q[0], q[1], q[2], q[3]);
    return vec3{CGAL::to_double(c.x()), CGAL::to_double(c.y()), CGAL::to_double(c.z())};
}

bool is_near(vec3 a) { return vec3_is_finite(a) && fabs(a.x) + fabs(a.y) + fabs(a.z) < FARTHEST; }

vec3 presentable(vec3 centre, const vec3 p[4]) { return is_near(centre) ? centre : largest_facet_circumcentre(p); }

/* In double; false where that would lose it. */
bool circumcentre(const vec3 p[4], vec3 *centre) noexcept {
    vec3 a = vec3_sub(p[1], p[0]), b = vec3_sub(p[2], p[0]), c = vec3_sub(p[3], p[0]);
    vec3 bc = vec3_cross(b, c), ca = vec3_cross(c, a), ab = vec3_cross(a, b);
    double det = vec3_dot(a, bc), aa = vec3_length_sq(a), bb = vec3_length_sq(b), cc = vec3_length_sq(c);
    double longest = sqrt(std::max({aa, bb, cc}));
    if (!(fabs(det) > FLAT * longest * longest * longest)) return false;
    vec3 sum = vec3_add(vec3_add(vec3_scale(bc, aa), vec3_scale(ca, bb)), vec3_scale(ab, cc));
    *centre = presentable(vec3_add(p[0], vec3_scale(sum, 1 / (2 * det))), p);
    return true;
}

/* ------------------------------------------------------------------------------------------------ numbering */

struct Cell {
    std::array<uint32_t, 4> id;   /* in canonical order */
    std::array<uint8_t, 4> index; /* of each in CGAL's cell */
    Delaunay::Cell_handle handle;
};

/* Cells with the same smallest id are in the order of the others. */
struct Place {
    uint64_t key;  /* the two next ids */
    uint32_t high; /* the largest */
    uint32_t cell;
    bool operator<(const Place &other) const { return key != other.key ? key < other.key : high < other.high; }
};

/* par_for over a body that doesn't throw. */
template <class Body> void for_ranges(unsigned threads, size_t n, Body &&body) {
    auto run = [](void *ctx, size_t begin, size_t end) {
        (*static_cast<std::remove_reference_t<Body> *>(ctx))(begin, end);
    };
    par_for(threads, n, GRAIN, run, &body);
}

/* Ascending ids; where that is an odd permutation the last two change places. */
void make_canonical(Cell &cell) noexcept {
    std::array<uint32_t, 4> id;
    cell.index = {0, 1, 2, 3};
    for (int i = 0; i < 4; i++) id[i] = cell.handle->vertex(i)->info();
    bool odd = false;
    for (int i = 1; i < 4; i++)
        for (int j = i; j > 0 && id[cell.index[j]] < id[cell.index[j - 1]]; j--)
            std::swap(cell.index[j], cell.index[j - 1]), odd = !odd;
    if (odd) std::swap(cell.index[2], cell.index[3]);
    for (int i = 0; i < 4; i++) cell.id[i] = id[cell.index[i]];
}

bool is_infinite(const Cell &cell) { return cell.id[2] == AT_INFINITY || cell.id[3] == AT_INFINITY; }

std::vector<Cell> list_cells(Delaunay &delaunay, unsigned threads) {
    std::vector<Cell> cells;
    cells.reserve(delaunay.number_of_cells());
    delaunay.infinite_vertex()->info() = AT_INFINITY;
    for (auto c = delaunay.all_cells_begin(); c != delaunay.all_cells_end(); ++c) cells.push_back({{}, {}, c});
    for_ranges(threads, cells.size(), [&](size_t begin, size_t end) noexcept {
        for (size_t c = begin; c < end; c++) make_canonical(cells[c]);
    });
    return cells;
}

/* All cells in their final order: buckets by (infinite, smallest id), each small, sorted by the rest. */
std::vector<Place> number_cells(const std::vector<Cell> &cells, size_t n, unsigned threads) {
    std::vector<size_t> begin(2 * n + 1, 0);
    auto bucket = [n](const Cell &cell) { return (is_infinite(cell) ? n : 0) + cell.id[0]; };
    for (const Cell &cell : cells) begin[bucket(cell) + 1]++;
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    std::vector<size_t> next(begin.begin(), begin.end() - 1);
    std::vector<Place> places(cells.size());
    for (size_t c = 0; c < cells.size(); c++) {
        const auto &id = cells[c].id;
        uint64_t key = uint64_t{id[1]} << 32 | std::min(id[2], id[3]);
        places[next[bucket(cells[c])]++] = {key, std::max(id[2], id[3]), static_cast<uint32_t>(c)};
    }
    for_ranges(threads, 2 * n, [&](size_t first, size_t last) noexcept {
        for (size_t b = first; b < last; b++) std::sort(&places[0] + begin[b], &places[0] + begin[b + 1]);
        for (size_t i = begin[first]; i < begin[last]; i++)
            cells[places[i].cell].handle->info() = static_cast<uint32_t>(i);
    });
    return places;
}

/* ------------------------------------------------------------------------------------------------ flat arrays */

std::array<vec3, 4> corners_of(const struct tets &tets, const vec3 *points, size_t c) {
    const uint32_t *v = tets.vertex[c];
    return {points[v[0]], points[v[1]], points[v[2]], points[v[3]]};
}

void fill_corners(const std::vector<Cell> &cells, const std::vector<Place> &places, unsigned threads,
                  struct tets &tets) {
    for_ranges(threads, cells.size(), [&](size_t begin, size_t end) noexcept {
        for (size_t c = begin; c < end; c++) {
            const Cell &cell = cells[places[c].cell];
            for (int i = 0; i < 4; i++) tets.vertex[c][i] = cell.id[i];
        }
        for (size_t c = begin; c < end; c++) {
            const Cell &cell = cells[places[c].cell];
            for (int i = 0; i < 4; i++) tets.neighbour[c][i] = cell.handle->neighbor(cell.index[i])->info();
        }
    });
}

/* Rational numbers allocate, and may throw, so they have the calling thread to themselves. */
void fill_circumcentres(const vec3 *points, unsigned threads, struct tets &tets) {
    for_ranges(threads, tets.finite_count, [&](size_t begin, size_t end) noexcept {
        for (size_t c = begin; c < end; c++)
            if (!circumcentre(corners_of(tets, points, c).data(), &tets.circumcentre[c])) tets.circumcentre[c].x = NAN;
    });
    for (size_t c = 0; c < tets.finite_count; c++) {
        if (!std::isnan(tets.circumcentre[c].x)) continue;
        auto p = corners_of(tets, points, c);
        tets.circumcentre[c] = presentable(exact_circumcentre(p.data()), p.data());
    }
}

void fill_cells(Delaunay &delaunay, const vec3 *points, size_t n, unsigned threads, struct tets *tets) {
    std::vector<Cell> cells = list_cells(delaunay, threads);
    std::vector<Place> places = number_cells(cells, n, threads);
    tets->cell_count = cells.size();
    tets->finite_count = cells.size() - static_cast<size_t>(std::count_if(cells.begin(), cells.end(), is_infinite));
    tets->vertex = new_array<uint32_t[4]>(tets->cell_count);
    tets->neighbour = new_array<uint32_t[4]>(tets->cell_count);
    tets->circumcentre = new_array<vec3>(tets->finite_count);
    fill_corners(cells, places, threads, *tets);
    fill_circumcentres(points, threads, *tets);
}

/* The first triangle says which way all turn. */
void fill_planar(const Delaunay &delaunay, const vec3 *points, struct tets *tets) {
    std::vector<std::array<uint32_t, 3>> triangles;
    for (auto f = delaunay.finite_facets_begin(); f != delaunay.finite_facets_end(); ++f) {
        std::array<uint32_t, 3> t;
        for (int i = 0; i < 3; i++) t[i] = f->first->vertex(i)->info();
        std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
        triangles.push_back(t);
    }
    auto normal = [&](const auto &t) { return vec3_triangle_normal(points[t[0]], points[t[1]], points[t[2]]); };
    for (auto &t : triangles)
        if (vec3_dot(normal(t), normal(triangles[0])) < 0) std::swap(t[1], t[2]);
    std::sort(triangles.begin(), triangles.end());
    tets->planar_count = triangles.size();
    tets->planar = new_array<uint32_t[3]>(triangles.size());
    for (size_t t = 0; t < triangles.size(); t++) std::copy(triangles[t].begin(), triangles[t].end(), tets->planar[t]);
}

void build(const vec3 *points, size_t n, size_t most_cells, unsigned threads, const struct progress *progress,
           struct tets *tets) {
    if (n > MAX_POINTS) throw Failure{STATUS_LIMIT, "too many points for one triangulation"};
    std::vector<Point> places;
    places.reserve(n);
    for (size_t i = 0; i < n; i++) places.emplace_back(points[i].x, points[i].y, points[i].z);
    Delaunay delaunay;
    if (n > 0) insert_all(delaunay, places, most_cells, progress);
    Tets_owner owner;
    owner.tets.dimension = std::max(delaunay.dimension(), 0);
    if (delaunay.dimension() == 3) fill_cells(delaunay, points, n, threads, &owner.tets);
    if (delaunay.dimension() == 2) fill_planar(delaunay, points, &owner.tets);
    *tets = owner.release();
}

/* ------------------------------------------------------------------------------------------------ in a plane */

using Triangle = std::array<uint32_t, 3>;

void insert_feet(Planar &planar, const vec3 *feet, size_t n, const struct progress *progress) {
    std::vector<size_t> order = insertion_order(n);
    Planar::Face_handle near;
    for (size_t i = 0; i < n; i++) {
        if (i % TICK_EVERY == 0 &&
            progress_tick(progress, "delaunay", 0.9 * static_cast<double>(i) / static_cast<double>(n)))
            throw Failure{STATUS_CANCELLED, "cancelled"};
        vec3 foot = feet[order[i]];
        auto vertex = planar.insert(Kernel::Point_2(foot.x, foot.y), near);
        vertex->info() = static_cast<uint32_t>(order[i]);
        near = vertex->face();
    }
}

/* Each with the smallest id first, in order. */
std::vector<Triangle> list_triangles(const Planar &planar, size_t n, unsigned threads) {
    std::vector<Triangle> found, triangles;
    std::vector<size_t> begin(n + 1, 0);
    found.reserve(planar.number_of_faces());
    for (auto f = planar.finite_faces_begin(); f != planar.finite_faces_end(); ++f) {
        Triangle t = {f->vertex(0)->info(), f->vertex(1)->info(), f->vertex(2)->info()};
        std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
        found.push_back(t), begin[t[0] + 1]++;
    }
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    std::vector<size_t> next(begin.begin(), begin.end() - 1);
    triangles.resize(found.size());
    for (const Triangle &t : found) triangles[next[t[0]]++] = t;
    for_ranges(threads, n, [&](size_t first, size_t last) noexcept {
        for (size_t v = first; v < last; v++)
            std::sort(triangles.begin() + static_cast<ptrdiff_t>(begin[v]),
                      triangles.begin() + static_cast<ptrdiff_t>(begin[v + 1]));
    });
    return triangles;
}

void build_planar(const vec3 *feet, size_t n, unsigned threads, const struct progress *progress,
                  uint32_t (**triangle)[3], size_t *count) {
    if (n > MAX_POINTS) throw Failure{STATUS_LIMIT, "too many points for one triangulation"};
    Planar planar;
    insert_feet(planar, feet, n, progress);
    std::vector<Triangle> triangles = list_triangles(planar, n, threads);
    *triangle = new_array<uint32_t[3]>(triangles.size());
    *count = triangles.size();
    for (size_t t = 0; t < triangles.size(); t++) std::copy(triangles[t].begin(), triangles[t].end(), (*triangle)[t]);
}

} // namespace

extern "C" enum status delaunay_build_within(const vec3 *points, size_t n, size_t most_cells, unsigned threads,
                                             const struct progress *progress, struct tets *tets,
                                             struct error *error) noexcept {
    return guard(error, [&] { build(points, n, most_cells, threads, progress, tets); });
}

extern "C" enum status delaunay_build(const vec3 *points, size_t n, unsigned threads, const struct progress *progress,
                                      struct tets *tets, struct error *error) noexcept {
    return delaunay_build_within(points, n, SIZE_MAX, threads, progress, tets, error);
}

extern "C" enum status delaunay_in_plane(const vec3 *feet, size_t n, unsigned threads, const struct progress *progress,
                                         uint32_t (**triangle)[3], size_t *count, struct error *error) noexcept {
    return guard(error, [&] { build_planar(feet, n, threads, progress, triangle, count); });
}
