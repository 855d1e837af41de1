# SPDX-License-Identifier: GPL-3.0-or-later
"""Time and memory over geometries that are unlike scans: make odd-geometries [POINTS=30000] [ONLY=name,name].

Each shape of odd_shapes.py goes through whittle, to a cloud and to a mesh, on one thread. The table has processor time
for each point against the plain cloud's of as many points, and the peak of memory against the prediction. It fails
where a ratio is over 4, or a peak over its prediction; that is what a run may use (--memory), as the service starts
it, so a mesh that takes more is refused. A shape whose ratio is over 2.5 runs twice again, between two
runs of the plain cloud, and the least ratio counts: other work on the machine makes times longer, never shorter.

Rows of SETTINGS run with settings of their own, to a mesh, beside a plain one with the same settings: the plain cloud,
or where the input's own faces are the surface, a closed grid of them. They may use what whoever has memory to spare
gives them (memory_predict_most).
"""
import argparse
import pathlib
import subprocess
import sys
import tempfile

import odd_shapes

MOST_RATIO, NEAR, AGAIN = 4.0, 2.5, 2
OUTPUTS = ("cloud", "cloud,mesh")
SETTINGS = {  # rows: a shape, what it is held beside, and the settings of both
    "all of 14 scan lines": ("14 scan lines", "plain", "--ratio=1"),
    "all of 14 scan lines closed": ("14 scan lines", "plain", "--ratio=1", "--surface=closed"),
    "all of 97 scan lines closed": ("97 scan lines", "plain", "--ratio=1", "--surface=closed"),
    "all of staves closed": ("staves", "plain", "--ratio=1", "--surface=closed"),
    "all of a cone of lines closed": ("cone of lines", "plain", "--ratio=1", "--surface=closed"),
    "given faces doubled": ("faces doubled", "faces", "--surface=given"),
    "a given face in 100 doubled": ("a face in 100 doubled", "faces", "--surface=given"),
    "a given face in 10 doubled": ("a face in 10 doubled", "faces", "--surface=given"),
    "a given face in 10 across": ("one face in 10 across", "faces", "--surface=given"),
    "a given face in 100 across": ("one face in 100 across", "faces", "--surface=given"),
    "given faces knotted": ("faces knotted", "faces", "--surface=given"),
}
MOST_SECONDS, MOST_BYTES = 100, 6 << 30  # of a run, so that a bad one ends


def run(build, path, outputs, folder, *settings):
    """Processor seconds, peak bytes, exit status and what it said."""
    with open(folder / "errors", "wb") as errors:
        told = subprocess.run([build / "tests/tools/run_measured", str(MOST_SECONDS), str(MOST_BYTES),
                               build / "whittle", path, "--outputs", outputs, "--threads", "1", "-q",
                               "-o", folder / "out", *map(str, settings)], check=True, stdout=subprocess.PIPE, stderr=errors, text=True)
    seconds, peak, status = told.stdout.split()
    said = (folder / "errors").read_text().strip().removeprefix(f"whittle: {path}: ")
    return float(seconds), int(peak), int(status), said


def predicted(build, path, outputs, *settings):
    told = subprocess.run([build / "tests/tools/predict_memory", path, *settings, f"outputs={outputs}"], check=True,
                          capture_output=True, text=True)
    return int(told.stdout)


class Bench:
    def __init__(self, build, points, folder):
        self.build, self.points, self.folder = pathlib.Path(build).absolute(), points, pathlib.Path(folder)
        self.written = {}  # of what others are held beside: path, number of points
        self.plain = {outputs: self.seconds_beside(("plain", outputs)) for outputs in OUTPUTS}

    def run(self, path, outputs, *settings, most=False):
        """Processor seconds, peak by the prediction, exit status and what it said."""
        memory = predicted(self.build, path, outputs, *(["--most"] if most else []),
                           *(setting.removeprefix("--") for setting in settings))
        seconds, peak, status, said = run(self.build, path, outputs, self.folder, "--memory", memory, *settings)
        return seconds, peak / memory, status, said

    def run_beside(self, beside):
        """Processor seconds for each point of a run that others are held beside: a shape, outputs, settings."""
        name, outputs, *settings = beside
        if name not in self.written:
            path = self.folder / f"beside.{len(self.written)}.ply"
            self.written[name] = path, odd_shapes.write(name, self.points, path)
        path, count = self.written[name]
        return self.run(path, outputs, *settings, most=bool(settings))[0] / count

    def seconds_beside(self, beside):
        return min(self.run_beside(beside) for _ in range(2))

    def plain_seconds(self, outputs):
        return self.seconds_beside(("plain", outputs))

    def compare(self, path, count, outputs, settings, beside, usual, most=False):
        """Outputs, ratio to the usual seconds of a point, memory of prediction, exit status, what was said."""
        seconds, memory, status, said = self.run(path, outputs, *settings, most=most)
        ratio = seconds / count / usual
        for _ in range(AGAIN):
            if NEAR < ratio < 5 * MOST_RATIO:
                before = self.run_beside(beside)
                seconds = self.run(path, outputs, *settings, most=most)[0]
                ratio = min(ratio, seconds / count / max(before, self.run_beside(beside)))
        if status and not said:
            said = f"ended by {status}"
        return outputs, ratio, memory, status, said

    def measure(self, name, *settings):
        """Rows of what compare returns, for each of OUTPUTS; settings: such as --surface=open."""
        path = self.folder / "odd.ply"
        count = odd_shapes.write(name, self.points, path)
        for outputs in OUTPUTS:
            yield self.compare(path, count, outputs, settings, ("plain", outputs), self.plain[outputs])

    def measure_set(self, name):
        """What compare returns of a row of SETTINGS."""
        shape, beside, *settings = SETTINGS[name]
        path, outputs = self.folder / "odd.ply", OUTPUTS[-1]
        count = odd_shapes.write(shape, self.points, path)
        beside = (beside, outputs, *settings)
        return self.compare(path, count, outputs, settings, beside, self.seconds_beside(beside), most=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--points", type=int, default=30000)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    names = [name.strip() for name in options.only.split(",") if name.strip()]
    for name in names:
        if name not in odd_shapes.SHAPES and name not in SETTINGS:
            parser.error(f"{name} is none of these: {', '.join([*odd_shapes.SHAPES, *SETTINGS])}")
    names = names or [*odd_shapes.SHAPES, *SETTINGS]
    worst, failures = [0, 0], 0
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(options.build, options.points, folder)
        print(f"{'shape':30} {'outputs':10} {'time':>6} {'memory':>6}   of the plain cloud's; of the prediction")
        for name in names:
            rows = [bench.measure_set(name)] if name in SETTINGS else bench.measure(name)
            for outputs, ratio, memory, status, said in rows:
                bad = ratio > MOST_RATIO or memory > 1 or status < 0
                failures += bad
                worst = [max(worst[0], ratio), max(worst[1], memory)]
                print(f"{name:30} {outputs:10} {ratio:6.2f} {memory:6.2f} {'!' if bad else ' '} {said[:100]}",
                      flush=True)
    print(f"largest: {worst[0]:.2f} times the plain cloud's time, {worst[1]:.2f} of the prediction; {failures} over")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
