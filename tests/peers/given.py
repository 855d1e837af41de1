#!/usr/bin/env python3
"""Meshes simplified with their own faces, beside Lindstrom and Turk's collapse of edges: error and time.

Usage: given.py [--build build/release] [--models horse,venus] [--ratios 0.2,0.1,0.05] [--judge cgal] [--times 3]
                [-o out/given.md]

Both get the closed mesh and a count of vertices.  Mean and maximum are of both directions against it, in 1e-4 of the
diagonal, by `whittle measure` or by CGAL (--judge cgal).  Seconds are of processors, the least of several runs: theirs
of the collapse alone ("work") and of the whole process, from its start to the written mesh; ours of the whole process,
but for what it spends on measuring its error, which is told beside it, by its median share of the clock.  "of work" is
in their favour: files, and their mesh made of the file, don't count.  The last row has geometric means of the quotients.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import collections
import json
import math
import pathlib
import statistics
import tempfile

import models
from programs import Made, Programs, markdown, processor_ms, run

HEADER = ("model", "kept", "L-T mean", "whittle", "quotient", "L-T max", "whittle", "L-T work s", "L-T s", "whittle s",
          "measure s", "of work", "of L-T s")
LOOKS = ("tangent", "examine", "measure")  # stages that only look at the result

Quotient = collections.namedtuple("Quotient", "mean max work process")


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


def collapse(programs, model, count, times):
    """Lindstrom and Turk's mesh; ms of its work alone and of the whole process."""
    runs = []
    for _ in range(times):
        before = processor_ms()
        peer = programs.peer("surface_cgal", "lindstrom-turk", Made(model.mesh, model.points), count)
        runs.append((peer.processor_ms, processor_ms() - before))
    return peer.path, tuple(map(min, zip(*runs)))


def simplify(programs, model, count, times):
    """Ours; ms of the process but for measuring, and of that.  One thread: then a stage takes as much of the process as
    of the clock."""
    whole, shares = [], []
    for _ in range(times):
        folder, report = programs.whittle(model.mesh, "--points", count, "--threads", 1, outputs="mesh,report")
        assert report["surface"]["kind"] == "given", report["surface"]
        stages = report["timings_ms"]
        whole.append(report["processor_ms"])
        shares.append(sum(stages.get(name, 0) for name in LOOKS) / stages["total"])
    measuring = min(whole) * statistics.median(shares)
    return programs.plain(folder / "mesh.ply", "made"), (min(whole) - measuring, measuring)


def compare(programs, options, model, ratio):
    """((mean, maximum), what it took) of theirs and of ours."""
    count = int(ratio * model.points)
    made = [make(programs, model, count, options.times) for make in (collapse, simplify)]
    return [(judge(programs, options.judge, path, model.mesh), spent) for path, spent in made]


def quotient_of(theirs, ours):
    (error, (work, process)), (our_error, (spent, _)) = theirs, ours
    return Quotient(our_error[0] / error[0], our_error[1] / error[1], spent / work, spent / process)


def row_of(model, ratio, theirs, ours, quotient):
    (error, spent), (our_error, our_spent) = theirs, ours
    return [model.name, f"{100 * ratio:g} %", f"{1e4 * error[0]:.3f}", f"{1e4 * our_error[0]:.3f}",
            f"{quotient.mean:.2f}", f"{1e4 * error[1]:.1f}", f"{1e4 * our_error[1]:.1f}",
            *(f"{ms / 1e3:.3f}" for ms in (*spent, *our_spent)), f"{quotient.work:.2f}", f"{quotient.process:.2f}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--build", default="build/release")
    parser.add_argument("--models", type=lambda text: text.split(","))
    parser.add_argument("--ratios", type=lambda text: [float(r) for r in text.split(",")], default=[0.2, 0.1, 0.05])
    parser.add_argument("--judge", choices=["whittle", "cgal"], default="whittle")
    parser.add_argument("--times", type=int, default=3, help="how often each runs")
    parser.add_argument("-o", "--output", type=pathlib.Path, default=models.ROOT / "out/given.md")
    options = parser.parse_args()
    rows, quotients = [], []
    with tempfile.TemporaryDirectory() as folder:
        programs = Programs(pathlib.Path(options.build).resolve(), folder)
        for model in models.find(options.models):
            for ratio in options.ratios:
                theirs, ours = compare(programs, options, model, ratio)
                quotients.append(quotient_of(theirs, ours))
                rows.append(row_of(model, ratio, theirs, ours, quotients[-1]))
                print(*rows[-1], flush=True)
    mean = Quotient(*(math.exp(sum(map(math.log, column)) / len(column)) for column in zip(*quotients)))
    rows.append(["all", "", "", "", f"{mean.mean:.2f}", "", f"{mean.max:.2f}", "", "", "", "", f"{mean.work:.2f}",
                 f"{mean.process:.2f}"])
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(markdown(HEADER, rows) + "\n", encoding="utf-8")
    print(options.output.read_text(encoding="utf-8"), end="")


if __name__ == "__main__":
    main()
