#!/usr/bin/env python3
"""How whittle meshes open scans (boundary=keep): whether the hole stays open along its border, and nothing else opens.

Usage: open_scans.py [--build build/release] [--models horse,venus] [--ratios 0.4,0.2,0.1,0.05] [--planes x,y,z,whole]
                     [--refine full] [-o out/open_scans.md]

The scans are closed models without what lies above a plane (across x, y or z, in the middle of the box), so the border
is known; "whole" is the model itself, which has none.  Columns: borders of the truth and of the mesh; mean, 95th
percentile and maximum of the distances from the true border's points to the mesh's border; mean and maximum the other
way; how many borders of the mesh are nowhere near a true one, and their length; points that aren't in the mesh; mean
error against the true mesh, both ways.  Lengths are in 1e-4 of the diagonal, that of other borders in 1e-2.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import concurrent.futures
import itertools
import math
import os
import pathlib
import sys

import borders
import models
from programs import Failed, Programs, errors_of, markdown

HEADER = ("model", "plane", "kept", "true", "got", "mean", "95 %", "max", "back", "max", "other", "length", "lost",
          "error")
NEAR = 0.005  # of the diagonal: a border that comes so near to the true one is a part of it
LEAST_LOOP = 12  # vertices: smaller ones are where the plane grazes a triangle or two


def halved(model, plane, path):
    """(path of the scan, its border's loops)."""
    if plane == "whole":
        return model.mesh, []
    axis = "xyz".index(plane)
    points, corners = borders.points_of(model.mesh)
    middle = (min(p[axis] for p in points) + max(p[axis] for p in points)) / 2
    points, corners = borders.cut(points, corners, lambda point: point[axis] < middle)
    borders.write(path, points, corners)
    return path, [[points[v] for v in loop] for loop in borders.loops_of(corners) if len(loop) >= LEAST_LOOP]


def follow(true_loops, loops, diagonal):
    """The columns about borders."""
    near = {}
    for i, loop in enumerate(loops):
        far = borders.distances(loop, true_loops)
        if min(far, default=math.inf) < NEAR * diagonal:
            near[i] = far
    there = sorted(borders.distances([p for loop in true_loops for p in loop], [loops[i] for i in near]))
    back = [d for far in near.values() for d in far]
    other = [borders.length_of(loop) for i, loop in enumerate(loops) if i not in near]
    cells = ["-"] * 5
    if there and back:
        cells = [f"{1e4 * d / diagonal:.1f}" for d in (sum(there) / len(there), there[len(there) * 95 // 100], there[-1],
                                                       sum(back) / len(back), max(back))]
    return [len(true_loops), len(loops), *cells, len(other), f"{1e2 * sum(other) / diagonal:.1f}"]


def measure(programs, model, plane, ratio, options):
    name = f"{model.name}-{plane}-{ratio:g}"
    scan, true_loops = halved(model, plane, programs.folder / f"{name}.ply")
    arguments = ["--ratio", ratio, "--boundary", "keep", "--refine", options.refine, "--threads", 1]
    head = [model.name, plane, f"{100 * ratio:g} %"]
    try:
        folder, report = programs.whittle(scan, *arguments, outputs="mesh,report", name=name)
    except Failed as failure:
        print(f"{name}: {failure}", file=sys.stderr)
        return head + ["-"] * (len(HEADER) - len(head))
    points, corners = borders.points_of(folder / "mesh.ply")
    loops = [[points[v] for v in loop] for loop in borders.loops_of(corners)]
    error = errors_of(report["error"])
    return [*head, *follow(true_loops, loops, report["input"]["diagonal"]), report["mesh"]["points_lost"],
            f"{1e4 * error.mean:.2f}"]


def measure_all(options, programs, chosen):
    cases = list(itertools.product(chosen, options.planes, options.ratios))
    with concurrent.futures.ProcessPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(measure, itertools.repeat(programs), *zip(*cases), itertools.repeat(options)))


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", type=pathlib.Path)
    parser.add_argument("--models", default="", help="separated by commas; default all")
    parser.add_argument("--ratios", default=[0.4, 0.2, 0.1, 0.05], type=lambda text: [float(w) for w in text.split(",")])
    parser.add_argument("--planes", default=["x", "y", "z", "whole"], type=lambda text: text.split(","))
    parser.add_argument("--refine", default="full")
    parser.add_argument("-o", "--output", default="out/open_scans.md", type=pathlib.Path)
    return parser.parse_args()


def main():
    options = parse()
    chosen = models.find(options.models.split(",") if options.models else None)
    if not chosen:
        sys.exit("open_scans: no model is there")
    rows = measure_all(options, Programs(options.build, f"out/{options.output.stem}"), chosen)
    text = markdown(HEADER, rows) + "\n"
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
