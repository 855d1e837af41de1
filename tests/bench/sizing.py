#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of deploy/README.md on sizing: what each million points takes of processor, memory and disk.

Usage: sizing.py BUILD_FOLDER [POINTS]      on a synthetic scan of a million points, on one thread, at 10 %
What the program itself takes of memory, ten MB as a job of some points shows, is left out."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile

ROWS = {"the cloud alone": "cloud,report", "cloud, mesh and measured error": "cloud,mesh,report"}


FEW = 1000


def measured(build, cloud, outputs, folder):
    """Processor time in seconds, peak of memory and size of the outputs in bytes."""
    # A process counts what the one that started it had as its own peak: that is a shell, not this program.
    program = subprocess.Popen(["sh", "-c", '"$@"; exit $?', "sh", build / "whittle", cloud, "--ratio", "0.1",
                                "--threads", "1", "--outputs", outputs, "-q", "-o", folder])
    _, status, usage = os.wait4(program.pid, 0)
    if status:
        sys.exit(f"whittle ended with {os.waitstatus_to_exitcode(status)}")
    report = json.loads((folder / "report.json").read_text())
    written = sum(p.stat().st_size for p in folder.iterdir())
    return usage.ru_utime + usage.ru_stime, report["peak_rss_bytes"], written


def make_scan(build, points, path):
    with open(path, "wb") as out:
        subprocess.run([build / "tests/bench/make_scan", str(points)], stdout=out, check=True)
    return path


def main():
    build, points = pathlib.Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 10**6
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        few, cloud = make_scan(build, FEW, folder / "few.ply"), make_scan(build, points, folder / "scan.ply")
        print("| for each million points | processor time | memory at the peak | disk: input, outputs |")
        print("|---|---|---|---|")
        for row, outputs in ROWS.items():
            itself = measured(build, few, outputs, folder / f"few,{outputs}")[1]
            seconds, memory, written = measured(build, cloud, outputs, folder / outputs)
            each, memory = 10**6 / points, memory - itself
            print(f"| {row} | {seconds * each:.1f} s | {memory * each / 1e6:.0f} MB | "
                  f"{cloud.stat().st_size * each / 1e6:.0f} MB, {written * each / 1e6:.1f} MB |", flush=True)


main()
