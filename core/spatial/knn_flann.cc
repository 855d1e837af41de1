/* The shim around FLANN (Muja, Lowe), by its templates: with the distance in three dimensions and these sets of results
 * compiled together, and with queries for all points of a ball, which its C interface lacks.
 *
 * What to know of FLANN 1.9: KDTreeSingleIndex with unlimited checks and eps 0 is exact.  It has no generator of random
 * numbers and no globals, so trees are built and asked by any threads.  It copies the points in the order of its
 * leaves, and doesn't look at what it was given any more once it is built.  Its pool of nodes prints, and goes on with
 * a null pointer, where malloc fails; so malloc is one that throws there.
 *
 * Conventions of the border: every extern "C" function is noexcept and its whole body runs inside guard().
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/knn_flann.h"

#include <stdio.h>
#include <stdlib.h>

#include <limits>
#include <new>
#include <vector>

static inline void *malloc_or_throw(size_t bytes) {
    void *memory = malloc(bytes);
    if (!memory) throw std::bad_alloc();
    return memory;
}

#define malloc malloc_or_throw
#include <flann/util/allocator.h>
#undef malloc

#include <flann/util/params.h>

#include <flann/algorithms/dist.h>
#include <flann/algorithms/kdtree_single_index.h>

extern "C" {
#include "core/base/radix.h"
}

namespace {

constexpr int LEAF_POINTS = 28;
constexpr double FARTHEST = std::numeric_limits<double>::max();
constexpr double ROUNDING = 1 + 1e-12; /* more than the tree's bounds are off by */

using Tree = flann::KDTreeSingleIndex<flann::L2_3D<double>>;

/* Of equals the lower id comes first and is in.  FLANN passes by what is as far as worstDist(), and what its bounds,
 * which are rounded, put there; so it is told a little more.  It asks once for each node that it looks at; once there
 * were too many it is told that nothing is worth looking at any more. */
class Nearest final : public flann::ResultSet<double> {
  public:
    Nearest(unsigned most, uint32_t *ids, double *distances_sq, unsigned there, const uint32_t *all_ids,
            const struct knn_slack *slacks, unsigned most_visits)
        : count(there), visits(most_visits), k(most), id_of(all_ids), slack(slacks), id(ids),
          distance_sq(distances_sq) {
        set_worst();
    }
    bool full() const override { return count == k; }
    double worstDist() const override { return visits && --visits ? worst : -1; }
    void addPoint(double d, size_t index) override {
        uint32_t added = id_of[index];
        if (count == k && !is_after(k - 1, d, added)) return;
        unsigned i = count < k ? count++ : k - 1;
        for (; i > 0 && is_after(i - 1, d, added); i--) distance_sq[i] = distance_sq[i - 1], id[i] = id[i - 1];
        distance_sq[i] = d, id[i] = added;
        set_worst();
    }

    unsigned count;
    mutable unsigned visits; /* that are left */

  private:
    bool is_after(unsigned i, double d, uint32_t added) const {
        return distance_sq[i] > d || (distance_sq[i] == d && id[i] > added);
    }
    void set_worst() {
        if (count < k) return;
        worst = distance_sq[k - 1] * (is_far() ? nearly_sq() : ROUNDING) + std::numeric_limits<double>::min();
    }
    bool is_far() const {
        if (!slack) return false;
        double own = slack->far * static_cast<double>(slack->length[id[k - 1]]);
        return distance_sq[k - 1] > own * own;
    }
    double nearly_sq() const { return (1 - slack->share) * (1 - slack->share); }

    unsigned k;
    const uint32_t *id_of;
    const struct knn_slack *slack;
    uint32_t *id;
    double *distance_sq, worst = FARTHEST;
};

class Ball final : public flann::ResultSet<double> {
  public:
    Ball(double radius, unsigned capacity, uint32_t *ids, unsigned there, const uint32_t *all_ids)
        : count(there), most(capacity), id_of(all_ids), id(ids), radius_sq(radius * radius) {}
    bool full() const override { return count > most; }
    double worstDist() const override { return radius_sq; }
    void addPoint(double, size_t index) override {
        if (count < most) id[count] = id_of[index];
        if (++count > most) radius_sq = -1; /* nothing is worth looking at any more */
    }

    unsigned count;

  private:
    unsigned most;
    const uint32_t *id_of;
    uint32_t *id;
    double radius_sq;
};

template <class Body> enum status guard(Body &&body) noexcept {
    try {
        body();
        return STATUS_OK;
    } catch (...) { /* nothing else can go wrong with points that are there */
        return STATUS_NO_MEMORY;
    }
}

} // namespace

struct knn_flann {
    knn_flann(const vec3 *points, const uint64_t *item, size_t n) : id(n) {
        std::vector<vec3> own(n);
        for (size_t i = 0; i < n; i++) id[i] = radix_value(item[i]), own[i] = points[id[i]];
        tree.buildIndex(flann::Matrix<double>(&own[0].x, n, 3));
    }
    void ask(flann::ResultSet<double> &results, vec3 query) const { tree.findNeighbors(results, &query.x, exact); }

    std::vector<uint32_t> id; /* of the tree's points */
    Tree tree{flann::KDTreeSingleIndexParams(LEAF_POINTS)};
    flann::SearchParams exact{flann::FLANN_CHECKS_UNLIMITED, 0, true};
};

extern "C" {

enum status knn_flann_new(const vec3 *points, const uint64_t *item, size_t n, struct knn_flann **tree) {
    static_assert(sizeof(vec3) == 3 * sizeof(double), "a row of FLANN's matrix");
    return guard([&] { *tree = new knn_flann(points, item, n); });
}

enum status knn_flann_nearest(const struct knn_flann *tree, vec3 query, unsigned k, const struct knn_slack *slack,
                              uint32_t *id, double *distance_sq, unsigned *count, unsigned *visits) {
    return guard([&] {
        Nearest nearest(k, id, distance_sq, *count, tree->id.data(), slack, *visits);
        tree->ask(nearest, query);
        *count = nearest.count;
        *visits = nearest.visits;
    });
}

enum status knn_flann_within(const struct knn_flann *tree, vec3 centre, double radius, unsigned most, uint32_t *id,
                             unsigned *count) {
    return guard([&] {
        Ball ball(radius, most, id, *count, tree->id.data());
        tree->ask(ball, centre);
        *count = ball.count;
    });
}

void knn_flann_free(struct knn_flann *tree) { delete tree; }
}
