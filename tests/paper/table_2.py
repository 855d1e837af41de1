"""Table 2: simplify first, or reconstruct first.

Everything is measured in turns, each of which runs every way once on every model and at every ratio: what else a
machine does comes and goes in seconds, and then it disturbs all of them alike.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import collections
import math
import statistics

import words
from programs import NOT_TO_RECONSTRUCT, Made, fastest

PAPER_IMPROVEMENT = 65.3  # in %, mean of its table 2
KEPT = (0.4, 0.3, 0.2, 0.1)
TURNS = 5

# How whittle goes about it, what it is held against, and by which clock.
OURS = {"S": ("--refine", "none"), "S flipped": ("--refine", "flips"), "S refined": ()}
REFERENCES = ("R", "peers")
WAYS = (*OURS, *REFERENCES)
ALL_THREADS, ONE_THREAD = (), ("--threads", 1)
CLOCKS = {"all threads, wall time": (ALL_THREADS, "ms"), "all threads, processor time": (ALL_THREADS, "processor_ms"),
          "one thread each, wall time": (ONE_THREAD, "ms"),
          "one thread each, processor time": (ONE_THREAD, "processor_ms")}
COLLAPSES = {"R": ("surface_cgal", "garland-heckbert"), "peers": ("meshoptimizer", "simplify")}
SURFACES = {"R": ("cocone",), "peers": ("cocone", "front")}  # of all points, the faster one counts

Case = collections.namedtuple("Case", "points made errors")  # made: {threads: {way: Made}}; errors: {way: mean}


class Table2:
    """Times and errors of all ways, on models and at ratios."""

    def __init__(self, programs, chosen, log):
        self.programs, self.chosen, self.log = programs, chosen, log
        self.runs = collections.defaultdict(list)  # by what was done: all of its times
        self.plain = {}  # surfaces of all points, in the peers' format
        self.errors = {}  # by model, ratio and way, and for the peers by surface

    def measure(self):
        """{(name, ratio): Case}"""
        for turn in range(TURNS):
            for model in self.chosen:
                self.log(f"{model.name}: table 2, turn {turn + 1} of {TURNS}")
                self.reconstruct_all(model)
                for ratio in KEPT:
                    self.simplify_first(model, ratio)
                    self.collapse(model, ratio)
        return {(model.name, ratio): self.case(model, ratio) for model in self.chosen for ratio in KEPT}

    def record(self, key, made, truth=None):
        """One more run; the first one's result is measured against the true mesh."""
        if truth and key not in self.runs:
            self.errors[key] = self.programs.measure(made.path, truth).mean
        self.runs[key].append(made)

    def reconstruct_all(self, model):
        """By Tight Cocone, and by CGAL's advancing front, which takes one thread."""
        for threads in (ALL_THREADS, ONE_THREAD):
            made = self.programs.mesh(model.cloud, "--ratio", 1, "--refine", "none", *threads, name="full",
                                      without=NOT_TO_RECONSTRUCT)
            self.record((model.name, "cocone", threads), made)
        if (model.name, "cocone") not in self.plain:
            self.plain[model.name, "cocone"] = self.programs.plain(made.path, f"{model.name}.full")
        made = self.programs.peer("surface_cgal", "front", Made(model.cloud), 0, f"{model.name}.front")
        self.record((model.name, "front"), made)
        self.plain[model.name, "front"] = made.path

    def simplify_first(self, model, ratio):
        for way, options in OURS.items():
            for threads in (ALL_THREADS, ONE_THREAD):
                made = self.programs.mesh(model.cloud, "--ratio", ratio, *threads, *options)
                self.record((model.name, ratio, way, threads), made, model.mesh)

    def collapse(self, model, ratio):
        count = math.floor(ratio * model.points)
        for way, program in COLLAPSES.items():
            for surface in SURFACES[way]:
                made = self.programs.peer(*program, Made(self.plain[model.name, surface]), count)
                self.record((model.name, ratio, way, surface), made, model.mesh)

    def case(self, model, ratio):
        made, errors = {}, {}
        for threads in (ALL_THREADS, ONE_THREAD):
            made[threads] = {way: fastest(self.runs[model.name, ratio, way, threads]) for way in OURS}
            for way in REFERENCES:
                made[threads][way], surface = self.reconstruct_first(model, ratio, way, threads)
                errors.setdefault(way, self.errors[model.name, ratio, way, surface])
        errors.update({way: self.errors[model.name, ratio, way, ALL_THREADS] for way in OURS})
        return Case(made[ALL_THREADS]["S"].points, made, errors)

    def reconstruct_first(self, model, ratio, way, threads):
        """(time of the surface and the collapse together, which surface)"""
        def whole(surface):
            key = (model.name, surface) if surface == "front" else (model.name, surface, threads)
            large, small = fastest(self.runs[key]), fastest(self.runs[model.name, ratio, way, surface])
            return small._replace(ms=large.ms + small.ms, processor_ms=large.processor_ms + small.processor_ms), surface
        return min(map(whole, SURFACES[way]), key=lambda pair: pair[0].ms)


def seconds(case, clock, way):
    threads, figure = CLOCKS[clock]
    return getattr(case.made[threads][way], figure) / 1e3


def improvements(clock, cases):
    """Means of (time_R - time_S) / time_R in %: a row of the summary."""
    def one(case, way, other):
        return 100 * (1 - seconds(case, clock, way) / seconds(case, clock, other))
    return [clock, *(f"{statistics.fmean(one(case, way, other) for case in cases):.1f} %"
                     for other in REFERENCES for way in OURS)]


def write(page, cases):
    page.heading("Table 2: simplify first, or reconstruct first")
    page.text(words.TABLE_2.format(turns=TURNS))
    for clock in CLOCKS:
        page.text(f"Seconds, {clock}:")
        page.table(["model", "kept", *WAYS],
                   [[name, f"{100 * ratio:g} %", *(f"{seconds(case, clock, way):.3f}" for way in WAYS)]
                    for (name, ratio), case in cases.items()])
    page.table(["mean improvement", *(f"{way} against {other}" for other in REFERENCES for way in OURS)],
               [*(improvements(clock, cases.values()) for clock in CLOCKS),
                ["the paper", f"{PAPER_IMPROVEMENT} %", *["-"] * (len(OURS) * len(REFERENCES) - 1)]])
    page.text(words.TABLE_2_IMPROVEMENT)
    page.table(["mean error", "kept", "points", *WAYS],
               [[name, f"{100 * ratio:g} %", case.points, *(f"{1e4 * case.errors[way]:.2f}" for way in WAYS)]
                for (name, ratio), case in cases.items()])
    losses = {way: statistics.geometric_mean(c.errors[way] / c.errors["R"] for c in cases.values()) for way in WAYS}
    page.text(words.TABLE_2_ERRORS.format(loss=losses["S"], flipped=losses["S flipped"], refined=losses["S refined"],
                                          peers=losses["peers"]))
