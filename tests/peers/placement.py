#!/usr/bin/env python3
"""Whether vertices that move anywhere are ever worse than those that stand at points, and a mesh of more points worse.

Usage: placement.py [--build build/release] [--models horse,venus] [--ratios 0.5,0.4,...] [-o out/placement.md]

For each closed model and ratio the mean of both directions against the true mesh, in 1e-4 of the diagonal, and the
maximum, with subset and with optimal placement.  The exit status tells whether optimal is nowhere above subset; steps
by which the mean falls with fewer points, by over 3 %, are told below the table.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import concurrent.futures
import itertools
import os
import pathlib
import sys

import models
from programs import Failed, Programs, errors_of, markdown

RATIOS = [0.5, 0.4, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.01]
PLACEMENTS = ("subset", "optimal")
HEADER = ("model", "kept", *(f"{figure}, {placement}" for placement in PLACEMENTS for figure in ("mean", "max")), "")
SLACK = 1.03


def measure(programs, model, ratio, placement):
    """The errors of one mesh, or None; the mesh is the input: its vertices are the cloud, its faces the truth."""
    name = f"{model.name}-{ratio:g}-{placement}"
    arguments = ["--ratio", ratio, "--placement", placement, "--surface", "closed", "--threads", 1]
    try:
        _, report = programs.whittle(model.mesh, *arguments, outputs="mesh,report", name=name)
    except Failed as failure:
        print(f"{name}: {failure}", file=sys.stderr)
        return None
    return errors_of(report["error"])


def row_of(model, ratio, errors):
    cells = [model.name, f"{100 * ratio:g} %"]
    for error in errors:
        cells += [f"{1e4 * error.mean:.2f}", f"{1e4 * error.max:.1f}"] if error else ["-", "-"]
    return cells + ["" if all(errors) and errors[1].mean <= errors[0].mean else "WORSE"]


def falls_of(rows):
    """Where a mesh of fewer points is nearer by more than the slack; rows: [(name, ratio, errors)], most points first."""
    told = []
    for (name, ratio, more), (next_name, fewer_ratio, fewer) in itertools.pairwise(rows):
        for i, placement in enumerate(PLACEMENTS):
            if name == next_name and more[i] and fewer[i] and more[i].mean > SLACK * fewer[i].mean:
                told.append(f"{name}, {placement}: {1e4 * more[i].mean:.2f} at {100 * ratio:g} %, "
                            f"{1e4 * fewer[i].mean:.2f} at {100 * fewer_ratio:g} %")
    return told


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", type=pathlib.Path)
    parser.add_argument("--models", default="", help="separated by commas; default all, with ../shared/data/solids")
    parser.add_argument("--ratios", default=RATIOS, type=lambda text: [float(w) for w in text.split(",")])
    parser.add_argument("-o", "--output", default="out/placement.md", type=pathlib.Path)
    options = parser.parse_args()
    chosen = models.find_with_solids(options.models.split(",") if options.models else None)
    if not chosen:
        sys.exit("placement: no model is there")
    programs = Programs(options.build, "out/placement")
    cases = list(itertools.product(chosen, sorted(options.ratios, reverse=True), PLACEMENTS))
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        errors = list(pool.map(lambda case: measure(programs, *case), cases))
    rows = [(case[0].name, case[1], errors[i:i + 2]) for i, case in enumerate(cases) if i % 2 == 0]
    table = [row_of(cases[2 * i][0], ratio, both) for i, (_, ratio, both) in enumerate(rows)]
    worse = sum(row[-1] != "" for row in table)
    verdict = f"Optimal placement is above subset, or missing, in {worse} of {len(table)} meshes."
    text = "\n".join([markdown(HEADER, table), "", verdict, *falls_of(rows), ""])
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text)
    print(text, end="")
    sys.exit(worse > 0)


if __name__ == "__main__":
    main()
