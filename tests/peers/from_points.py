#!/usr/bin/env python3
"""Closed models from their points alone, beside what knows the true mesh, and their topology.

Usage: from_points.py [--build build/release] [--models horse,venus] [--ratios 0.2,0.1,0.05] [-o out/from_points.md]

Optimal placement stands beside Lindstrom and Turk's collapse (CGAL) of the true mesh; subset placement beside the other
way from points to few triangles: CGAL's advancing front of all points, then meshoptimizer.  Mean and maximum are of both
directions against the true mesh, in 1e-4 of the diagonal.  Pieces, handles and crossings (pairs of triangles that pass
through each other) are those of optimal placement; the true mesh's are told where they differ.

Geometric means of the quotients are of all models, and of those that are sampled well: nearly everywhere on the true
surface the nearest point is one of the triangle that the place is of.  On flat parts of machines that have points along
their edges alone, which no method can tell from air, it is another one.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import functools
import math
import pathlib
import statistics
import sys

import models
import numpy
import scipy.spatial
from closed import shells_of
from programs import Failed, Made, Programs, markdown

ELSEWHERE_MOST = 0.125  # of the area: middles of triangles whose nearest point is no corner
HEADER = ("model", "kept", "L-T mean", "optimal", "quotient", "L-T max", "optimal", "quotient", "front mean", "subset",
          "quotient", "")
CRITERION = (f"Sampled well: of at most {100 * ELSEWHERE_MOST:g} % of the true area, in whole triangles, the point nearest "
             "to the triangle's middle is none of its corners.")
QUOTIENTS = ("optimal / L-T, mean", "maximum", "subset / front, mean")


@functools.cache
def share_elsewhere(mesh):
    """Of the true surface's area: triangles whose middle is nearer to another point than to their corners."""
    columns, corners = models.read_ply(mesh)
    points = numpy.array([columns[axis] for axis in "xyz"]).T
    triangles = numpy.array(corners).reshape(-1, 3)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    areas = numpy.linalg.norm(numpy.cross(b - a, c - a), axis=1)
    nearest = scipy.spatial.cKDTree(points).query((a + b + c) / 3)[1]
    return areas[(triangles != nearest[:, None]).all(axis=1)].sum() / areas.sum()


def is_sampled_well(model):
    return share_elsewhere(model.mesh) <= ELSEWHERE_MOST


def remarks(model, report):
    mesh = report["mesh"]
    shells, handles = shells_of(model.mesh)
    told = []
    if (mesh["components"], mesh["handles"]) != (shells, handles):
        told.append(f"{mesh['components']} pieces, {mesh['handles']} handles (true {shells}, {handles})")
    if mesh["self_intersections"]:
        told.append(f"{mesh['self_intersections']} crossings")
    if not is_sampled_well(model):
        told.append(f"sampled badly: {100 * share_elsewhere(model.mesh):.0f} % elsewhere")
    return "; ".join(told)


def errors_of_points(programs, model, ratio, placement):
    folder, report = programs.whittle(model.cloud, "--ratio", ratio, "--placement", placement, outputs="mesh,report")
    return programs.measure(folder / "mesh.ply", model.mesh), report


def compare(programs, model, ratio):
    """(the row, its quotients)."""
    count = math.floor(ratio * model.points)
    collapsed = programs.peer("surface_cgal", "lindstrom-turk", Made(model.mesh), count)
    front = programs.peer("meshoptimizer", "simplify", programs.peer("surface_cgal", "front", Made(model.cloud), 0), count)
    theirs, way = programs.measure(collapsed.path, model.mesh), programs.measure(front.path, model.mesh)
    ours, report = errors_of_points(programs, model, ratio, "optimal")
    subset, _ = errors_of_points(programs, model, ratio, "subset")
    quotients = (ours.mean / theirs.mean, ours.max / theirs.max, subset.mean / way.mean)
    row = [model.name, f"{100 * ratio:g} %", f"{1e4 * theirs.mean:.3f}", f"{1e4 * ours.mean:.3f}", f"{quotients[0]:.2f}",
           f"{1e4 * theirs.max:.1f}", f"{1e4 * ours.max:.1f}", f"{quotients[1]:.2f}", f"{1e4 * way.mean:.3f}",
           f"{1e4 * subset.mean:.3f}", f"{quotients[2]:.2f}", remarks(model, report)]
    return row, quotients


def means_of(compared, ratios):
    """Geometric means at each ratio; compared: [(model, ratio, quotients)]."""
    rows = []
    for which, of in (("all", lambda model: True), ("sampled well", is_sampled_well)):
        for ratio in ratios:
            columns = list(zip(*(quotients for model, at, quotients in compared if at == ratio and of(model))))
            if columns:
                rows.append([f"{which}, {len(columns[0])}", f"{100 * ratio:g} %",
                             *(f"{statistics.geometric_mean(column):.3f}" for column in columns)])
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", type=pathlib.Path)
    parser.add_argument("--models", default="", help="separated by commas; default all, with ../shared/data/solids")
    parser.add_argument("--ratios", default=[0.2, 0.1, 0.05], type=lambda text: [float(w) for w in text.split(",")])
    parser.add_argument("-o", "--output", default="out/from_points.md", type=pathlib.Path)
    options = parser.parse_args()
    programs = Programs(options.build, "out/from_points")
    rows, compared = [], []
    for model in models.find_with_solids(options.models.split(",") if options.models else None):
        for ratio in options.ratios:
            try:
                row, quotients = compare(programs, model, ratio)
            except Failed as failure:
                print(f"{model.name} {ratio:g}: {failure}", file=sys.stderr)
                continue
            rows.append(row)
            compared.append((model, ratio, quotients))
            print(*row, flush=True)
    tables = (markdown(("models", "kept", *QUOTIENTS), means_of(compared, options.ratios)), CRITERION, markdown(HEADER, rows))
    text = "\n\n".join(tables) + "\n"
    options.output.write_text(text, encoding="utf-8")
    print(text, end="")


if __name__ == "__main__":
    main()
