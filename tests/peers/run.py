#!/usr/bin/env python3
"""whittle beside what else Debian has, on the same clouds, at the same counts, with one error tool.

Usage: run.py [--build build/release] [--models horse,venus] [--ratios 0.2,0.1,0.05] [--methods ...] [-o out/peers.md]

Three kinds of rows, since they know different things:
    points   a method picks or makes points; CGAL's advancing front makes the surface of them
    whittle  its own reconstruction, and the points of it with CGAL's advancing front, to tell both apart
    mesh     the true mesh is made smaller: these know the connectivity, which a cloud doesn't tell

Where a method takes no count, the count that it came closest to is printed.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import math
import pathlib
import statistics
import subprocess
import sys

import models
from programs import SAMPLES, Failed, Made, Programs, best, markdown

WHITTLE = {"whittle": (), "whittle, no refinement": ("--refine", "none"), "whittle, flips": ("--refine", "flips"),
           "whittle, optimal": ("--placement", "optimal")}
GIVEN = {"whittle, given": (), "whittle, given, optimal": ("--placement", "optimal")}
FRONT = {"whittle + front": ("whittle", ""), "CGAL wlop + front": ("points_cgal", "wlop"),
         "CGAL hierarchy + front": ("points_cgal", "hierarchy"), "CGAL grid + front": ("points_cgal", "grid"),
         "CGAL random + front": ("points_cgal", "random"),
         "Open3D farthest + front": ("open3d", "farthest"), "PCL voxel + front": ("points_pcl", "voxel"),
         "PCL uniform + front": ("points_pcl", "uniform")}
MESH = {"CGAL Lindstrom-Turk": ("surface_cgal", "lindstrom-turk"),
        "CGAL Garland-Heckbert": ("surface_cgal", "garland-heckbert"), "Open3D decimation": ("open3d", "decimation"),
        "meshoptimizer": ("meshoptimizer", "simplify")}
METHODS = [*WHITTLE, *FRONT, *GIVEN, *MESH]
FROM = {**{m: "points" for m in [*WHITTLE, *FRONT]}, **{m: "true mesh" for m in [*GIVEN, *MESH]}}


def make(programs, method, model, ratio):
    """Runs one method; the mesh that it made."""
    count = math.floor(ratio * model.points)
    if method in WHITTLE:
        return programs.mesh(model.cloud, "--ratio", ratio, *WHITTLE[method])
    if method in GIVEN:
        return programs.mesh(model.mesh, "--ratio", ratio, "--surface", "given", *GIVEN[method])
    if method in MESH:
        return programs.peer(*MESH[method], Made(model.mesh), count)
    return programs.peer("surface_cgal", "front", pick(programs, method, model, ratio, count), 0)


def pick(programs, method, model, ratio, count):
    if FRONT[method][0] != "whittle":
        return programs.peer(*FRONT[method], Made(model.cloud), count)
    return programs.kept(model.cloud, "--ratio", ratio)


def row_of(programs, method, model, ratio, times):
    """(the row's cells, (errors, ms) or None)."""
    try:
        made = best(lambda: make(programs, method, model, ratio), times)
        errors = programs.measure(made.path, model.mesh)
    except Failed as failure:
        print(f"{model.name} {ratio:g}: {failure}", file=sys.stderr)
        return [method, FROM[method], "-", "-", "-", "-", "-"], None
    figures = [f"{1e4 * value:.3f}" for value in errors[:3]]
    return [method, FROM[method], made.points, *figures, f"{made.ms / 1000:.2f}"], (errors, made.ms)


def show_progress(text):
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


def compare(programs, model, ratio, methods, times):
    """One table; {method: (errors, ms)}."""
    rows, measured = [], {}
    for method in methods:
        show_progress(f"{model.name} {ratio:g}: {method}")
        row, measured[method] = row_of(programs, method, model, ratio, times)
        rows.append(row)
    show_progress("")
    header = ["method", "from", "points", "mean", "RMS", "max", "time (s)"]
    return f"## {model.name}, {100 * ratio:g} % of {model.points}\n\n{markdown(header, rows)}\n", measured


def geometric_mean(values):
    return math.exp(statistics.fmean(math.log(v) for v in values)) if values else math.nan


def summary(all_measured, methods):
    """Geometric means over all clouds of each method's figures divided by whittle's."""
    rows = []
    for method in methods:
        pairs = [(m[method], m["whittle"]) for m in all_measured if m.get(method) and m.get("whittle")]
        ratios = [geometric_mean([own[0][i] / whittles[0][i] for own, whittles in pairs]) for i in range(3)]
        time = geometric_mean([own[1] / whittles[1] for own, whittles in pairs])
        rows.append([method, FROM[method], f"{len(pairs)} of {len(all_measured)}", *(f"{r:.2f}" for r in ratios),
                     f"{time:.2f}"])
    return markdown(["method", "from", "runs", "mean", "RMS", "max", "time"], rows)


NOTES = """Errors are mean, root mean square and largest distance between the true mesh and the result, both directions
taken together, in 1e-4 of the diagonal; by `whittle measure`, {samples} samples on each surface. Time is wall time of
the work alone, without files and without measuring; methods that take no count were tuned to it first, which is not in
the time. "front" is CGAL's advancing front reconstruction. "true mesh" methods know the connectivity of the full model.
"""


def report(tables, all_measured, methods):
    text = "# whittle and its peers\n\n" + NOTES.format(samples=SAMPLES)
    if "whittle" in methods:
        text += "\n## All clouds: each method's figures divided by whittle's\n\n"
        text += "Geometric means; over 1 is worse than whittle, under 1 is better.\n\n" + summary(all_measured, methods)
    return text + "\n\n" + "\n".join(tables)


def check_tool(programs, model):
    """The error tool against MeshLab's, on whittle's mesh and the true one; its words, or why there are none."""
    check = models.ROOT / "tests/tools/check_metro.py"
    if not check.exists():
        return f"{check.name} isn't there."
    mesh = programs.whittle(model.cloud, "--ratio", 0.1)[0] / "mesh.ply"
    done = subprocess.run([sys.executable, check, programs.build / "whittle", mesh, model.mesh], capture_output=True,
                          text=True, check=False)
    return done.stdout.strip() + "\n" + done.stderr.strip() + f"\nexit status {done.returncode}"


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", type=pathlib.Path)
    parser.add_argument("--models", default="", help="separated by commas; default all")
    parser.add_argument("--ratios", default="0.2,0.1,0.05")
    parser.add_argument("--methods", default="", help="separated by semicolons; default all: " + "; ".join(METHODS))
    parser.add_argument("--repeat", default=1, type=int, help="runs of each; the shortest counts")
    parser.add_argument("-o", "--output", default="out/peers.md", type=pathlib.Path)
    return parser.parse_args()


def main():
    options = parse()
    methods = [m.strip() for m in options.methods.split(";")] if options.methods else METHODS
    unknown = [m for m in methods if m not in METHODS]
    if unknown:
        sys.exit(f"peers: no method {', '.join(unknown)}")
    programs = Programs(options.build, "out/peers")
    tables, all_measured = [], []
    chosen = models.find(options.models.split(",") if options.models else None)
    for model in chosen:
        for ratio in map(float, options.ratios.split(",")):
            table, measured = compare(programs, model, ratio, methods, options.repeat)
            print(table, flush=True)
            tables.append(table)
            all_measured.append(measured)
    text = report(tables, all_measured, methods)
    text += f"\n## The error tool against MeshLab's\n\n```\n{check_tool(programs, chosen[0])}\n```\n"
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text)
    print(text.partition("\n\n## ")[2].partition("\n\n## ")[0])
    print(f"\nThe tables are in {options.output}.")


if __name__ == "__main__":
    main()
