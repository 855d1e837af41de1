#!/usr/bin/env python3
"""The evaluation of Lee and Jong's "Point-based Simplification Algorithm", made again with whittle.

Usage: run.py [--build build/release] [--models horse,venus,armadillo,bunny00] [--parts table_2,figure_8] [-o out/paper]

Writes out/paper.md, out/paper.html and the pictures that they show, in out/paper/.  Its tables and figures are the
paper's: the time of the discrete shape operator (DSO, table 1), simplifying first against reconstructing first (table
2), the DSO as colours (figure 4), errors of the simplified models (figures 7 and 9), and where the points lie with and
without the DSO (figure 8).  Each is measured for two settings: the paper's formulas as they stand, and whittle's
defaults.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import pathlib
import statistics
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "peers"))
# pylint: disable=wrong-import-position
import numpy as np

import draw
import models
import table_2
import words
from page import Page
from programs import Failed, Programs

# What the paper prints, of its figure 7; errors relative to the diagonal.
PAPER_POINTS = {"horse": (9697, 4848, 2424), "santa": (15156, 7578, 3789), "venus": (10000, 5000, 2500)}
PAPER_ERRORS = {"horse": (0.006335, 0.007514, 0.016095), "santa": (0.002241, 0.003527, 0.005259),
                "venus": (0.002784, 0.00405, 0.005678)}
KEPT = (0.2, 0.1, 0.05)
REPEATS = 3

LITERAL = ("--dso", "sum", "--dso_exponent", 1, "--area_weight", "unit", "--line_quadric", 0,
           "--reconstruction", "literal", "--refine", "none")
SETTINGS = {"the paper's formulas": LITERAL, "whittle": ()}


def log(text):
    print(text, file=sys.stderr, flush=True)


def load(path):
    """(xyz as n x 3, faces as m x 3) of a PLY file."""
    columns, corners = models.read_ply(path)
    xyz = np.column_stack([np.asarray(columns[axis], float) for axis in "xyz"])
    return xyz, np.asarray(corners, int).reshape(-1, 3)


def load_colours(path):
    columns, _ = models.read_ply(path)
    return np.column_stack([np.asarray(columns[c], float) / 255 for c in ("red", "green", "blue")])


def percent(ratio):
    return f"{100 * ratio:g} %"


class Evaluation:
    """The programs, the page that grows, and where the pictures go."""

    def __init__(self, build, stem):
        self.programs = Programs(build, "out/paper-work")
        self.pictures = pathlib.Path(stem)
        self.pictures.mkdir(parents=True, exist_ok=True)
        self.page = Page("Lee and Jong's evaluation, again")

    def picture(self, name, caption):
        self.page.picture(f"{self.pictures.name}/{name}", caption)

    # ------------------------------------------------------------------------------------------------ table 1
    def table_1(self, chosen):
        """Time of the stages up to the DSO."""
        self.page.heading("Table 1: the time of the discrete shape operator")
        rows = []
        for model in chosen:
            log(f"{model.name}: table 1")
            runs = [self.stages(model) for _ in range(REPEATS)]
            middle = [statistics.median(run[stage] for run in runs) for stage in ("neighbours", "normals", "dso")]
            rows.append([model.name, model.points, *(f"{ms:.1f}" for ms in middle), f"{sum(middle):.1f}",
                         f"{1e3 * sum(middle) / model.points:.2f}"])
        self.page.table(["model", "points", "neighbours (ms)", "normals (ms)", "DSO (ms)", "sum (ms)", "us / point"],
                        rows)
        self.page.text(words.TABLE_1.format(repeats=REPEATS))

    def stages(self, model):
        return self.programs.whittle(model.cloud, "--ratio", 0.5, *LITERAL, "--threads", 1,
                                     outputs="cloud,report")[1]["timings_ms"]

    # ------------------------------------------------------------------------------------------------ table 2
    def table_2(self, chosen):
        """Simplify first, or reconstruct first."""
        table_2.write(self.page, table_2.Table2(self.programs, chosen, log).measure())

    # ------------------------------------------------------------------------------------------------ figure 4
    def figure_4(self, chosen):
        """The DSO as colours."""
        self.page.heading("Figure 4: the discrete shape operator")
        for model in chosen:
            log(f"{model.name}: figure 4")
            xyz, faces = load(model.mesh)
            camera = draw.Camera(model.name, xyz, 620)
            pictures = []
            for form in ("sum", "rms"):
                folder, _ = self.programs.whittle(model.cloud, "--ratio", 0.5, "--dso", form, outputs="dso,report")
                pictures.append(draw.draw_mesh(camera, xyz, faces, load_colours(folder / "dso.ply"), smooth=True))
            draw.panels(self.pictures / f"dso-{model.name}.png", pictures,
                        ["the paper's vector sums (--dso sum)", "root mean square (--dso rms, the default)"])
            self.picture(f"dso-{model.name}.png", f"{model.name}: the DSO, from green (low) to red (high)")
        self.page.text(words.FIGURE_4)

    # ------------------------------------------------------------------------------------------------ figures 7, 9
    def figures_7_and_9(self, chosen):
        """Errors at 20, 10 and 5 %."""
        self.page.heading("Figures 7 and 9: the error of the simplified models")
        rows, above = [], []
        for model in chosen:
            more, ratios = self.errors(model)
            rows += more
            above += ratios
        rows += [["santa", "paper", percent(ratio), PAPER_POINTS["santa"][i], "-", "-", "-", "-",
                  f"{PAPER_ERRORS['santa'][i]:.6f}"] for i, ratio in enumerate(KEPT)]
        self.page.table(["model", "setting", "kept", "points", "mean", "RMS", "max", "max by Metro", "the paper's"],
                        rows)
        self.discuss_errors(above)

    def errors(self, model):
        """Rows of one model, and how far the paper's figures are above its own formulas'; draws the pictures."""
        rows, series, above = [], [], []
        xyz, faces = load(model.mesh)
        camera = draw.Camera(model.name, xyz, 620)
        pictures, titles = [draw.draw_mesh(camera, xyz, faces)], [f"{model.points} points"]
        for setting, options in SETTINGS.items():
            means, maxima = {}, {}
            for i, ratio in enumerate(KEPT):
                log(f"{model.name} {percent(ratio)}: figure 7, {setting}")
                path, points, figures = self.errors_of(model, ratio, options)
                paper = f"{PAPER_ERRORS[model.name][i]:.6f}" if model.name in PAPER_ERRORS else "-"
                rows.append([model.name, setting, percent(ratio), points, *(f"{f:.6f}" for f in figures), paper])
                means[100 * ratio], maxima[100 * ratio] = figures[0], figures[2]
                if setting != "whittle" and model.name in PAPER_ERRORS:
                    above.append((PAPER_ERRORS[model.name][i] / figures[0], PAPER_ERRORS[model.name][i] / figures[2]))
                if setting == "whittle":
                    pictures.append(draw.draw_mesh(camera, *load(path)))
                    titles.append(f"{percent(ratio)}: {points} points")
            mark = "o" if setting == "whittle" else "s"
            series += [(f"{setting}: max", f"{mark}-", maxima), (f"{setting}: mean", f"{mark}--", means)]
        self.draw_errors(model, series, pictures, titles)
        return rows, above

    def errors_of(self, model, ratio, options):
        folder, report = self.programs.whittle(model.cloud, "--ratio", ratio, *options)
        mesh = folder / "mesh.ply"
        errors = self.programs.measure(mesh, model.mesh)
        metro = self.programs.measure_as_metro(mesh, model.mesh)
        return mesh, report["points_out"], (*errors[:3], metro)

    def draw_errors(self, model, series, pictures, titles):
        if model.name in PAPER_ERRORS:
            paper = {100 * ratio: error for ratio, error in zip(KEPT, PAPER_ERRORS[model.name])}
            series.append(("the paper's error", "k^-", paper))
        draw.curves(self.pictures / f"errors-{model.name}.png", series, model.name, "error / diagonal")
        draw.panels(self.pictures / f"meshes-{model.name}.png", pictures, titles, rows=1 if len(pictures) < 3 else 2)
        self.picture(f"errors-{model.name}.png", f"{model.name}: errors at 20, 10 and 5 %")
        self.picture(f"meshes-{model.name}.png", f"{model.name}: whittle's meshes, flat shaded")

    def discuss_errors(self, above):
        """above: for each of the paper's figures, how often our literal mean and maximum go into it."""
        self.page.text(words.ERRORS)
        if above:
            means, maxima = ([edge(ratio[i] for ratio in above) for edge in (min, max)] for i in (0, 1))
            self.page.text(words.PAPER_ERRORS.format(means=means, maxima=maxima))

    # ------------------------------------------------------------------------------------------------ figure 8
    def figure_8(self, chosen):
        """Where the points lie with and without the DSO."""
        self.page.heading("Figure 8: where the points lie, with and without the DSO")
        settings = {"without the DSO (--dso none)": ("--dso", "none"),
                    "with it (--dso rms, the default)": ("--dso", "rms"),
                    "with the paper's weight (--dso sum --dso_exponent 1)": ("--dso", "sum", "--dso_exponent", 1)}
        for model in chosen:
            log(f"{model.name}: figure 8")
            surface = load(model.mesh)
            camera = draw.Camera(model.name, surface[0], 620)
            pictures = []
            for options in settings.values():
                folder, _ = self.programs.whittle(model.cloud, "--ratio", KEPT[2], *options, outputs="cloud,report")
                pictures.append(draw.draw_points(camera, surface, load(folder / "cloud.ply")[0], 2.4))
            draw.panels(self.pictures / f"points-{model.name}.png", pictures, list(settings))
            self.picture(f"points-{model.name}.png", f"{model.name}: the points kept of 5 %")
        self.page.text(words.FIGURE_8)


PARTS = ("table_1", "table_2", "figure_4", "figures_7_and_9", "figure_8")


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", type=pathlib.Path)
    parser.add_argument("--models", default="horse,venus,armadillo,bunny00", help="separated by commas")
    parser.add_argument("--parts", default=",".join(PARTS), help="separated by commas")
    parser.add_argument("-o", "--output", default="out/paper", type=pathlib.Path)
    return parser.parse_args()


def main():
    options = parse()
    chosen = models.find(options.models.split(","))
    evaluation = Evaluation(options.build, options.output)
    try:
        for part in options.parts.split(","):
            getattr(evaluation, part)(chosen)
    except Failed as failure:
        sys.exit(f"paper: {failure}")
    evaluation.page.save(str(options.output))
    print(f"The report is {options.output}.html and {options.output}.md.")


if __name__ == "__main__":
    main()
