/* PCL's grids: voxel keeps the centroid of each cell's points, uniform the point nearest to the cell's centre.  Both
 * take the size of a cell, which is searched for.  PCL's coordinates are float.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <pcl/filters/uniform_sampling.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/point_types.h>

#include "tests/peers/peer.h"

using cloud = pcl::PointCloud<pcl::PointXYZ>;

static cloud::Ptr cloud_of(const surface &s) {
    cloud::Ptr c(new cloud);
    for (const auto &v : s.vertex) c->push_back({float(v[0]), float(v[1]), float(v[2])});
    return c;
}

static surface surface_of(const cloud &c) {
    surface s;
    for (const auto &p : c) s.vertex.push_back({p.x, p.y, p.z});
    return s;
}

/* set(filter, cell) tells the filter how large a cell is. */
template <class filter, class setter>
static peer::outcome run_filter(const surface &in, std::size_t count, setter set) {
    cloud::Ptr all = cloud_of(in);
    double size = peer::diagonal(in);
    /* Under 1/1000 of the diagonal PCL's indices of cells may pass 32 bits. */
    return peer::search(count, 1e-3 * size, size, [&](double cell) {
        cloud made;
        peer::spent time = peer::time_of([&] {
            filter f;
            f.setInputCloud(all);
            set(f, float(cell));
            f.filter(made);
        });
        return peer::outcome{surface_of(made), time};
    });
}

static peer::outcome run_voxel(const surface &in, std::size_t count) {
    using filter = pcl::VoxelGrid<pcl::PointXYZ>;
    return run_filter<filter>(in, count, [](filter &f, float cell) { f.setLeafSize(cell, cell, cell); });
}

static peer::outcome run_uniform(const surface &in, std::size_t count) {
    using filter = pcl::UniformSampling<pcl::PointXYZ>;
    return run_filter<filter>(in, count, [](filter &f, float cell) { f.setRadiusSearch(cell); });
}

int main(int argc, char **argv) { return peer::main(argc, argv, {{"voxel", run_voxel}, {"uniform", run_uniform}}); }
