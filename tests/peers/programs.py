"""Runs whittle, its error tool and the peers, and tells what each made: the file, its count and the time.

Time is the work's alone: no program's reading and writing counts, nor whittle's own measuring of the error.  The error
of everything comes from one tool, `whittle measure`, against the true mesh.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import collections
import json
import pathlib
import resource
import subprocess

import models

SAMPLES = 200000  # of each surface
NOT_THE_WORK = ("total", "tangent", "examine", "measure")  # stages of whittle's report that only look at the result
NOT_TO_RECONSTRUCT = (*NOT_THE_WORK, "dso", "quadrics", "contract", "keep")  # what the mesh of all points doesn't need

Made = collections.namedtuple("Made", "path points ms processor_ms", defaults=(0, 0, 0))
Errors = collections.namedtuple("Errors", "mean rms max forward backward")  # of both directions, / diagonal


class Failed(Exception):
    """A program ended with an error; its last words."""


def fastest(runs):
    """Of runs that made the same thing the shortest: whatever disturbs a run makes it longer."""
    return min(runs, key=lambda made: made.ms)._replace(processor_ms=min(made.processor_ms for made in runs))


def best(make, times):
    return fastest([make() for _ in range(times)])


def run(command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        words = (done.stderr.strip() or f"exit status {done.returncode}").splitlines()[-1]
        raise Failed(f"{pathlib.Path(str(command[0])).name}: {words}")
    return done.stdout


def processor_ms():
    """Of all programs that have ended, all their threads together."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (usage.ru_utime + usage.ru_stime)


class Programs:
    """The programs of one build, and a folder for what they write."""

    def __init__(self, build, folder):
        self.build, self.folder = pathlib.Path(build), pathlib.Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)

    def whittle(self, cloud, *options, outputs="cloud,mesh,report", name="whittle"):
        """Runs whittle; (folder of its outputs, its report, with the processors' time)."""
        folder, before = self.folder / name, processor_ms()
        run([self.build / "whittle", cloud, "-q", "--outputs", outputs, "-o", folder, *options])
        return folder, {**json.loads((folder / "report.json").read_text()), "processor_ms": processor_ms() - before}

    def peer(self, program, method, made, count, name=None):
        """Runs one method of a peer on a file."""
        target = self.folder / f"{name or method}.ply"
        told = json.loads(run([self.build / "tests/peers" / program, method, made.path, count, target]))
        return Made(target, told["points"], made.ms + told["ms"], made.processor_ms + told["processor_ms"])

    def mesh(self, cloud, *options, name="whittle", without=NOT_THE_WORK):
        """Runs whittle for its mesh."""
        folder, report = self.whittle(cloud, *options, name=name)
        return Made(folder / "mesh.ply", report["mesh"]["vertices"], *work_of(report, without))

    def kept(self, cloud, *options):
        """Runs whittle for the points that it keeps."""
        folder, report = self.whittle(cloud, *options, outputs="cloud,report")
        return Made(self.plain(folder / "cloud.ply", "kept"), report["points_out"], *work_of(report))

    def plain(self, path, name):
        """A copy of what whittle wrote, for the peers."""
        target = self.folder / f"{name}.ply"
        models.to_plain(path, target)
        return target

    def measure(self, path, truth, samples=SAMPLES):
        told = json.loads(run([self.build / "whittle", "measure", path, truth, "--samples", samples, "--json"]))
        return errors_of(told)

    def measure_as_metro(self, path, truth):
        """The larger of Metro's two maxima, relative to Metro's diagonal."""
        told = json.loads(run([self.build / "whittle", "measure", path, truth, "--method", "metro", "--json"]))
        return told["hausdorff_metro_rel"]


def errors_of(told):
    """Mean and RMS of both directions: of the true surface to the mesh, and of the mesh to the true surface."""
    there, back = told["surface"], told["backward"]
    rms = ((there["rms_rel"] ** 2 + back["rms_rel"] ** 2) / 2) ** 0.5
    return Errors((there["mean_rel"] + back["mean_rel"]) / 2, rms, told["hausdorff_rel"], there["mean_rel"],
                  back["mean_rel"])


def work_of(report, without=NOT_THE_WORK):
    """(ms, ms of processors) of the stages that make the result; of the program's processor time as large a share.

    Stages side by side come to more than they take together: never more than the whole without what is measured."""
    stages = report["timings_ms"]
    each = sum(ms for stage, ms in stages.items() if stage not in without)
    share = each / sum(ms for stage, ms in stages.items() if stage != "total")
    return min(each, stages["total"] - stages.get("measure", 0)), report["processor_ms"] * share


def markdown(header, rows):
    """A table of Markdown whose columns line up; all but the first are numbers."""
    rows = [[str(cell) for cell in row] for row in rows]
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]

    def line(cells):
        laid = [c.rjust(w) if i else c.ljust(w) for i, (c, w) in enumerate(zip(cells, widths))]
        return f"| {' | '.join(laid)} |"

    rule = "|" + "|".join("-" * (w + 2) if i == 0 else "-" * (w + 1) + ":" for i, w in enumerate(widths)) + "|"
    return "\n".join([line(header), rule, *map(line, rows)])
