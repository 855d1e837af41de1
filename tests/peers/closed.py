#!/usr/bin/env python3
"""Whether every closed model comes out closed: soundness, lost points, topology and error of whittle's meshes.

Usage: closed.py [--build build/release] [--models horse,venus] [--ratios 0.2,0.1,0.05] [--placement subset]
                 [--refine full] [-o out/closed.md]

A mesh is sound if it is watertight, manifold and oriented.  "points" is how many of the kept points are vertices (copies
where a vertex had to be split don't count).  Shells and handles are those of all components together, got and true; a
handle too many is a tunnel that isn't there, one too few is a hole that was filled.  Mean and maximum are of both
directions against the true mesh, in 1e-4 of the diagonal.  The exit status tells whether all meshes are sound with at
least 99.9 % of the points.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import concurrent.futures
import itertools
import os
import pathlib
import sys

import models
from programs import Failed, Programs, markdown

LEAST_SHARE = 0.999
HEADER = ("model", "kept", "sound", "points", "split", "shells", "true", "handles", "true", "mean", "max")


def shells_of(mesh):
    """(components, handles) of a closed mesh; Euler's formula for all its components together."""
    _, corners = models.read_ply(mesh)
    parent = list(range(max(corners) + 1))

    def find(v):
        while parent[v] != v:
            parent[v] = parent[parent[v]]
            v = parent[v]
        return v

    for i in range(0, len(corners), 3):
        a, b, c = (find(v) for v in corners[i:i + 3])
        parent[a] = parent[b] = c
        parent[c] = c
    shells = sum(find(v) == v for v in range(len(parent)))
    return shells, handles_of(shells, len(parent), len(corners) // 3)


def handles_of(shells, vertices, triangles):
    return shells - (vertices - triangles // 2) // 2


def measure(programs, model, ratio, options):
    """One row, and whether all is well.  The input is the vertices alone, so that a surface has to be found."""
    arguments = ["--ratio", ratio, "--placement", options.placement, "--refine", options.refine, "--threads", 1]
    name = f"{model.name}-{ratio:g}"
    try:
        folder, report = programs.whittle(model.cloud, *arguments, outputs="mesh,report", name=name)
    except Failed as failure:
        print(f"{name}: {failure}", file=sys.stderr)
        return [model.name, f"{100 * ratio:g} %", "none", *["-"] * (len(HEADER) - 3)], False
    mesh, kept = report["mesh"], report["points_out"]
    error = programs.measure(folder / "mesh.ply", model.mesh)
    sound = mesh["watertight"] and mesh["manifold"] and mesh["oriented"]
    share = 1 - mesh["points_lost"] / kept
    shells, handles = shells_of(model.mesh)
    row = [model.name, f"{100 * ratio:g} %", "yes" if sound else "NO", f"{100 * share:.2f} %", mesh["vertices_split"],
           mesh["components"], shells, handles_of(mesh["components"], mesh["vertices"], mesh["triangles"]), handles,
           f"{1e4 * error.mean:.2f}", f"{1e4 * error.max:.1f}"]
    return row, sound and share >= LEAST_SHARE


def measure_all(options, programs, chosen):
    cases = list(itertools.product(chosen, options.ratios))
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(lambda case: measure(programs, *case, options), cases))


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", type=pathlib.Path)
    parser.add_argument("--models", default="", help="separated by commas; default all")
    parser.add_argument("--ratios", default=[0.2, 0.1, 0.05], type=lambda text: [float(w) for w in text.split(",")])
    parser.add_argument("--placement", default="subset")
    parser.add_argument("--refine", default="full")
    parser.add_argument("-o", "--output", default="out/closed.md", type=pathlib.Path)
    return parser.parse_args()


def main():
    options = parse()
    chosen = models.find(options.models.split(",") if options.models else None)
    if not chosen:
        sys.exit("closed: no model is there")
    results = measure_all(options, Programs(options.build, "out/closed"), chosen)
    well = sum(fine for _, fine in results)
    verdict = f"{well} of {len(results)} meshes are sound and have {100 * LEAST_SHARE:g} % of the points or more."
    text = f"{markdown(HEADER, [row for row, _ in results])}\n\n{verdict}\n"
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text)
    print(text, end="")
    sys.exit(well < len(results))


if __name__ == "__main__":
    main()
