#!/usr/bin/env python3
"""What the discrete shape operator (DSO) is worth: the error of the mesh with it, divided by that without it.

Usage: ablation.py [--build build/release] [--models horse,venus] [--ratios 0.2,0.1,0.05] [--exponents -0.5,0.5,1]
                   [--refine none,full] [-o out/ablation.md]

For each form (rms, sum) and exponent, all models and ratios: mean, RMS and maximum of both directions against the true
mesh, and the mean distance of the points near features, which are the tenth of the original points with the largest DSO
(rms form, whatever form is measured).  The rows are geometric means of the ratios to dso=none, so under 1 the DSO
helps; "better" counts the runs in which the mean is lower.  Runs go side by side, each with one thread, since results
don't depend on the number of threads.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import concurrent.futures
import itertools
import math
import os
import pathlib
import statistics
import sys

import models
from programs import Failed, Programs, errors_of, markdown

FORMS = ("rms", "sum")
NOTES = """Ratios to dso=none, geometric means: under 1 the DSO helps. Mean, RMS and max are of both directions
against the true mesh. "to it" is the mean distance of the true mesh's samples to the result alone, which one wrong fin
doesn't spoil. "features" is the mean distance of the tenth of the original points with the largest DSO. "better" counts
the runs with a lower mean. Models: {models}."""
FIGURES = ("mean", "RMS", "max", "to it", "features")


def features(programs, model):
    """The ids of the tenth of the points with the largest DSO."""
    folder, _ = programs.whittle(model.cloud, "--ratio", 0.5, "--threads", 1, outputs="dso,report",
                                 name=f"{model.name}-dso")
    dso = models.read_ply(folder / "dso.ply")[0]["dso"]
    return sorted(range(len(dso)), key=lambda i: (-dso[i], i))[:max(1, len(dso) // 10)]


def measure(programs, model, near, ratio, refine, form, exponent):
    """The figures of one run, or None.  The mesh is the input: its vertices are the cloud, its faces the truth."""
    options = ["--ratio", ratio, "--refine", refine, "--dso", form, "--dso_exponent", exponent, "--surface", "closed",
               "--threads", 1]
    name = f"{model.name}-{ratio:g}-{refine}-{form}-{exponent:g}"
    try:
        folder, report = programs.whittle(model.mesh, *options, outputs="error,report", name=name)
    except Failed as failure:
        print(f"{name}: {failure}", file=sys.stderr)
        return None
    distance = models.read_ply(folder / "error.ply")[0]["distance"]
    (folder / "error.ply").unlink()
    errors = errors_of(report["error"])
    return *errors[:4], statistics.fmean(distance[i] for i in near) / report["input"]["diagonal"]


def measure_all(options, programs, chosen):
    """{(refine, form, exponent): {(model, ratio): figures}}; dso=none has the exponent 0."""
    variants = [("none", 0.0), *itertools.product(FORMS, options.exponents)]
    results = {(refine, *variant): {} for refine in options.refine for variant in variants}
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        near = dict(zip((m.name for m in chosen), pool.map(lambda m: features(programs, m), chosen)))
        runs = {pool.submit(measure, programs, model, near[model.name], ratio, *key): (key, model.name, ratio)
                for model in chosen for ratio in options.ratios for key in results}
        for i, done in enumerate(concurrent.futures.as_completed(runs), 1):
            key, name, ratio = runs[done]
            results[key][name, ratio] = done.result()
            if sys.stderr.isatty():
                print(f"\r\033[K{i} of {len(runs)} runs", end="", file=sys.stderr, flush=True)
    return results


def ratios_of(figures, base, cases):
    """For each case the ratios to dso=none, where both ran."""
    return [[own / other for own, other in zip(figures[case], base[case])]
            for case in cases if figures.get(case) and base.get(case)]


def row_of(label, ratios):
    means = [math.exp(statistics.fmean(math.log(r[i]) for r in ratios)) for i in range(len(FIGURES))]
    better = sum(r[0] < 1 for r in ratios)
    return [*label, *(f"{mean:.3f}" for mean in means), f"{better} of {len(ratios)}"]


def table(results, cases):
    rows = []
    for (refine, form, exponent), figures in results.items():
        ratios = ratios_of(figures, results[refine, "none", 0.0], cases)
        if form != "none" and ratios:
            rows.append(row_of([form, f"{exponent:g}", refine], ratios))
    return markdown(["dso", "exponent", "refine", *FIGURES, "better"], rows)


def absolute(results, chosen, ratios):
    """dso=none itself, so that the ratios can be turned back."""
    rows = []
    for (refine, form, _), figures in results.items():
        for model, ratio in itertools.product(chosen, ratios):
            if form == "none" and figures.get((model.name, ratio)):
                values = [f"{1e4 * value:.3f}" for value in figures[model.name, ratio]]
                rows.append([model.name, f"{100 * ratio:g} %", refine, *values])
    return markdown(["model", "kept", "refine", *FIGURES], rows)


def report(options, chosen, results):
    text = ["# The discrete shape operator, on and off", "",
            NOTES.format(models=", ".join(m.name for m in chosen)), ""]
    everything = list(itertools.product([m.name for m in chosen], options.ratios))
    text += ["## All models and ratios", "", table(results, everything), ""]
    for ratio in options.ratios if len(options.ratios) > 1 else ():
        text += [f"## {100 * ratio:g} % kept", "", table(results, [c for c in everything if c[1] == ratio]), ""]
    for model in chosen:
        text += [f"## {model.name}", "", table(results, [c for c in everything if c[0] == model.name]), ""]
    text += ["## dso=none itself, in 1e-4 of the diagonal", "", absolute(results, chosen, options.ratios), ""]
    return "\n".join(text)


def numbers(text):
    return [float(word) for word in text.split(",")]


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", type=pathlib.Path)
    parser.add_argument("--models", default="", help="separated by commas; default all")
    parser.add_argument("--ratios", default=[0.2, 0.1, 0.05], type=numbers)
    parser.add_argument("--exponents", default=[-0.5, -0.25, 0.25, 0.5, 1], type=numbers)
    parser.add_argument("--refine", default=["none", "full"], type=lambda text: text.split(","))
    parser.add_argument("-o", "--output", default="out/ablation.md", type=pathlib.Path)
    return parser.parse_args()


def main():
    options = parse()
    chosen = models.find(options.models.split(",") if options.models else None)
    if not chosen:
        sys.exit("ablation: no model is there")
    results = measure_all(options, Programs(options.build, "out/ablation"), chosen)
    text = report(options, chosen, results)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text)
    print(text.partition("\n## " + chosen[0].name)[0])
    print(f"Each model by itself is in {options.output}.")


if __name__ == "__main__":
    main()
