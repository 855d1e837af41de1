#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions of each stage for each point, against what they were: a figure that a busy machine doesn't change.

Usage: counts.py BUILD_FOLDER [--save]

Runs whittle under callgrind on a synthetic scan, one thread, with mesh and error, and compares every stage with
tests/bench/counts.json.  A stage that takes more than ALLOWED times its count is told, and the exit status is 1.
--save writes the counts as the new ones, to be committed together with the change that explains them.  Another
compiler, FLANN or CGAL counts differently: the baseline is of Debian 12's.
"""
import argparse
import json
import pathlib
import re
import subprocess
import sys
import tempfile

BASELINE = pathlib.Path(__file__).with_name("counts.json")
POINTS, ALLOWED = 20000, 1.03
FUNCTIONS = {"cloud_read_path": "read", "cloud_write_ply": "write"}


def counts(build):
    """Instructions for each point, by stage."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        scan, profile = folder / "scan.ply", folder / "profile"
        with open(scan, "wb") as out:
            subprocess.run([build / "tests/bench/make_scan", str(POINTS)], stdout=out, check=True)
        subprocess.run(["valgrind", "--tool=callgrind", f"--callgrind-out-file={profile}", build / "whittle", scan, "-q",
                        "--threads", "1", "--outputs", "cloud,mesh,report", "-o", folder / "out"],
                       check=True, capture_output=True)
        told = subprocess.run(["callgrind_annotate", "--inclusive=yes", "--threshold=100", "--auto=no", profile],
                              check=True, capture_output=True, text=True).stdout
    found = {}
    for line in told.splitlines():
        match = re.match(r"\s*([\d,]+) .*:(?:pipeline_)?(\w+)", line)
        if not match:
            continue
        stage = match[2] if f":pipeline_{match[2]}" in line else FUNCTIONS.get(match[2])
        if stage and stage not in ("run",):
            each = int(match[1].replace(",", "")) / POINTS
            found[stage] = max(found.get(stage, 0), round(each, 1))
    return {stage: each for stage, each in found.items() if each >= 10}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--save", action="store_true")
    options = parser.parse_args()
    now = counts(options.build.resolve())
    before = json.loads(BASELINE.read_text()) if BASELINE.exists() else {}
    worse = 0
    print(f"{'instructions for each point':28s} {'now':>10s} {'before':>10s} {'ratio':>6s}")
    for stage, each in sorted(now.items(), key=lambda item: -item[1]):
        ratio = each / before[stage] if stage in before else 1
        worse += ratio > ALLOWED
        print(f"{stage:28s} {each:10.0f} {before.get(stage, 0):10.0f} {ratio:6.3f}{'  MORE' if ratio > ALLOWED else ''}")
    if options.save:
        BASELINE.write_text(json.dumps(now, indent=1, sort_keys=True) + "\n")
    elif worse:
        sys.exit(f"{worse} stages take more than {ALLOWED} times the instructions that they took")


main()
