# SPDX-License-Identifier: GPL-3.0-or-later
"""Time and memory over geometries that are unlike scans: make odd-geometries [POINTS=30000] [ONLY=name,name].

Each shape of odd_shapes.py goes through whittle, to a cloud and to a mesh, on one thread. The table has processor time
for each point against the plain cloud's of as many points, and the peak of memory against the prediction. It fails
where a ratio is over 4, or a peak over its prediction; that is what a run may use (--memory), as the service starts
it, so a mesh that takes more is refused. A shape whose ratio is over 2.5 runs twice again, between two
runs of the plain cloud, and the least ratio counts: other work on the machine makes times longer, never shorter.
"""
import argparse
import pathlib
import subprocess
import sys
import tempfile

import odd_shapes

MOST_RATIO, NEAR, AGAIN = 4.0, 2.5, 2
OUTPUTS = ("cloud", "cloud,mesh")
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
        self.plain_path = self.folder / "plain.ply"
        self.plain_points = odd_shapes.write("plain", points, self.plain_path)
        self.plain = {outputs: self.plain_seconds(outputs) for outputs in OUTPUTS}

    def run(self, path, outputs, *settings):
        memory = predicted(self.build, path, outputs, *(setting.removeprefix("--") for setting in settings))
        return run(self.build, path, outputs, self.folder, "--memory", memory, *settings)

    def plain_seconds(self, outputs):
        return min(self.run(self.plain_path, outputs)[0] for _ in range(2)) / self.plain_points

    def again(self, path, count, outputs, *settings):
        """The ratio, measured side by side."""
        before = self.run(self.plain_path, outputs)[0]
        odd = self.run(path, outputs, *settings)[0]
        after = self.run(self.plain_path, outputs)[0]
        return odd / count / (max(before, after) / self.plain_points)

    def measure(self, name, *settings):
        """Rows of (outputs, ratio, memory of prediction, what was said); settings: such as --surface=open."""
        path = self.folder / "odd.ply"
        count = odd_shapes.write(name, self.points, path)
        for outputs in OUTPUTS:
            seconds, peak, status, said = self.run(path, outputs, *settings)
            ratio = seconds / count / self.plain[outputs]
            for _ in range(AGAIN):
                if NEAR < ratio < 5 * MOST_RATIO:
                    ratio = min(ratio, self.again(path, count, outputs, *settings))
            if status and not said:
                said = f"ended by {status}"
            told = predicted(self.build, path, outputs, *(setting.removeprefix("--") for setting in settings))
            yield outputs, ratio, peak / told, status, said


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--points", type=int, default=30000)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    names = [name.strip() for name in options.only.split(",") if name.strip()] or list(odd_shapes.SHAPES)
    worst, failures = [0, 0], 0
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(options.build, options.points, folder)
        print(f"{'shape':26} {'outputs':10} {'time':>6} {'memory':>6}   of the plain cloud's; of the prediction")
        for name in names:
            for outputs, ratio, memory, status, said in bench.measure(name):
                bad = ratio > MOST_RATIO or memory > 1 or status < 0
                failures += bad
                worst = [max(worst[0], ratio), max(worst[1], memory)]
                print(f"{name:26} {outputs:10} {ratio:6.2f} {memory:6.2f} {'!' if bad else ' '} {said[:100]}",
                      flush=True)
    print(f"largest: {worst[0]:.2f} times the plain cloud's time, {worst[1]:.2f} of the prediction; {failures} over")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
