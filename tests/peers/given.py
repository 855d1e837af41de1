#!/usr/bin/env python3
"""Meshes simplified with their own faces, beside Lindstrom and Turk's collapse of edges: error and time.

Usage: given.py [--build build/release] [--models horse,venus] [--ratios 0.2,0.1,0.05] [--judge cgal]
                [-o out/given.md]

Both get the closed mesh and a count of vertices.  Mean and maximum are of both directions against it, in 1e-4 of the
diagonal, by `whittle measure` or by CGAL (--judge cgal); seconds are of processors, of the work alone.  The last row
has geometric means of the quotients.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import json
import math
import pathlib
import tempfile

import models
from programs import Made, Programs, markdown, run, work_of

HEADER = ("model", "kept", "L-T mean", "whittle", "quotient", "L-T max", "whittle", "L-T s", "whittle s")
# What looks at the result, or ranks points for a cloud that nobody asked for, isn't left out: all but measuring counts.
NOT_THE_WORK = ("total", "tangent", "examine", "measure")


def judge(programs, by, path, truth):
    """(mean, maximum) of both directions, relative to the diagonal."""
    if by == "whittle":
        errors = programs.measure(path, truth)
        return errors.mean, errors.max
    told = json.loads(run([programs.build / "tests/peers/distances", path, truth, 200000]))
    columns, _ = models.read_ply(truth)
    diagonal = math.dist(*[[f(columns[axis]) for axis in "xyz"] for f in (min, max)])
    means = [told[way]["mean"] / diagonal for way in ("there", "back")]
    return sum(means) / 2, max(told[way]["max"] for way in ("there", "back")) / diagonal


def compare(programs, by, model, ratio):
    count = int(ratio * model.points)
    peer = programs.peer("surface_cgal", "lindstrom-turk", Made(model.mesh, model.points), count)
    folder, report = programs.whittle(model.mesh, "--points", count, outputs="mesh,report")
    assert report["surface"]["kind"] == "given", report["surface"]
    _, ours_ms = work_of(report, NOT_THE_WORK)
    theirs = judge(programs, by, peer.path, model.mesh)
    ours = judge(programs, by, programs.plain(folder / "mesh.ply", "made"), model.mesh)
    return theirs, ours, peer.processor_ms, ours_ms


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--build", default="build/release")
    parser.add_argument("--models", type=lambda text: text.split(","))
    parser.add_argument("--ratios", type=lambda text: [float(r) for r in text.split(",")], default=[0.2, 0.1, 0.05])
    parser.add_argument("--judge", choices=["whittle", "cgal"], default="whittle")
    parser.add_argument("-o", "--output", type=pathlib.Path, default=models.ROOT / "out/given.md")
    options = parser.parse_args()
    rows, quotients = [], []
    with tempfile.TemporaryDirectory() as folder:
        programs = Programs(pathlib.Path(options.build).resolve(), folder)
        for model in models.find(options.models):
            for ratio in options.ratios:
                theirs, ours, their_ms, our_ms = compare(programs, options.judge, model, ratio)
                quotients.append((ours[0] / theirs[0], ours[1] / theirs[1], our_ms / their_ms))
                rows.append([model.name, f"{100 * ratio:g} %", f"{1e4 * theirs[0]:.3f}", f"{1e4 * ours[0]:.3f}",
                             f"{quotients[-1][0]:.2f}", f"{1e4 * theirs[1]:.1f}", f"{1e4 * ours[1]:.1f}",
                             f"{their_ms / 1e3:.2f}", f"{our_ms / 1e3:.2f}"])
                print(*rows[-1], flush=True)
    means = [math.exp(sum(map(math.log, column)) / len(column)) for column in zip(*quotients)]
    rows.append(["all", "", "", "", f"{means[0]:.2f}", "", f"{means[1]:.2f}", "", f"{means[2]:.2f}"])
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(markdown(HEADER, rows) + "\n", encoding="utf-8")
    print(options.output.read_text(encoding="utf-8"), end="")


if __name__ == "__main__":
    main()
