#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of deploy/README.md on sizing: what each million points takes of processor, memory and disk.

Usage: sizing.py BUILD_FOLDER [POINTS]      on a synthetic scan of a million points, on one thread, at 10 %
Below some hundred thousand points the program itself, a few MB, counts in the memory as well."""
import os
import pathlib
import subprocess
import sys
import tempfile

ROWS = {"the cloud alone": "cloud,report", "cloud, mesh and measured error": "cloud,mesh,report"}


def measured(build, cloud, outputs, folder):
    """Processor time in seconds, peak of memory and size of the outputs in bytes."""
    program = subprocess.Popen([build / "whittle", cloud, "--ratio", "0.1", "--threads", "1", "--outputs", outputs,
                                "-q", "-o", folder])
    _, status, usage = os.wait4(program.pid, 0)
    if status:
        sys.exit(f"whittle ended with {os.waitstatus_to_exitcode(status)}")
    written = sum(p.stat().st_size for p in folder.iterdir())
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024, written


def main():
    build, points = pathlib.Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 10**6
    with tempfile.TemporaryDirectory() as name:
        cloud = pathlib.Path(name) / "scan.ply"
        with open(cloud, "wb") as out:
            subprocess.run([build / "tests/bench/make_scan", str(points)], stdout=out, check=True)
        print("| for each million points | processor time | memory at the peak | disk: input, outputs |")
        print("|---|---|---|---|")
        for row, outputs in ROWS.items():
            seconds, memory, written = measured(build, cloud, outputs, pathlib.Path(name) / outputs)
            each = 10**6 / points
            print(f"| {row} | {seconds * each:.1f} s | {memory * each / 1e6:.0f} MB | "
                  f"{cloud.stat().st_size * each / 1e6:.0f} MB, {written * each / 1e6:.1f} MB |", flush=True)


main()
