#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether programs write the same bits: cloud, mesh, and the report but for times, memory and version.

Usage: same_bits.py [--clouds NAME ... --] WHITTLE WHITTLE ...

Runs each on Horse and Venus, where ../shared/data is, and on eight clouds of Debian's libcgal-demo (tests/demo/scan.sh
unpacks them), for placements subset and optimal, with one thread and with two.  All are compared with the first program's
with one thread; a difference is told and makes the exit status 1.
"""
import argparse
import concurrent.futures
import hashlib
import json
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared" / "data"
SCANS = ("horse", "venus")
MODELS = ("elephant", "dino", "homer", "kitten", "bull", "camel", "mannequin-devil", "armadillo")
VARIES = ("params", "timings_ms", "peak_rss_bytes", "version")


def clouds(folder, chosen):
    """name -> path; of those that aren't there, why."""
    found = {}
    for name in SCANS:
        if name not in chosen:
            continue
        path = SHARED / f"{name}.points.ply"
        if path.exists():
            found[name] = path
        else:
            print(f"without {name}: {path} isn't there")
    for name in MODELS:
        if name not in chosen:
            continue
        path = folder / f"{name}.xyz"
        told = subprocess.run([ROOT / "tests/demo/scan.sh", name, path], capture_output=True, text=True, check=False)
        if told.returncode == 0:
            found[name] = path
        else:
            print(f"without {name}: {told.stderr.strip()}")
    return found


def outputs(program, cloud, placement, threads):
    """name of each output -> digest of what is in it."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([program, cloud, "-q", "--placement", placement, "--threads", str(threads), "--outputs",
                        "cloud,mesh,report", "-o", folder], check=True)
        found = {path.name: path.read_bytes() for path in pathlib.Path(folder).iterdir()}
    report = json.loads(found["report.json"])
    found["report.json"] = json.dumps({k: v for k, v in report.items() if k not in VARIES}, sort_keys=True).encode()
    return {name: hashlib.sha256(content).hexdigest()[:12] for name, content in found.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", nargs="+", type=pathlib.Path)
    parser.add_argument("--clouds", nargs="+", choices=SCANS + MODELS, default=SCANS + MODELS)
    options = parser.parse_args()
    programs = [path.resolve() for path in options.program]
    differences = runs = 0
    with tempfile.TemporaryDirectory() as folder, concurrent.futures.ThreadPoolExecutor(2) as pool:
        for name, cloud in clouds(pathlib.Path(folder), options.clouds).items():
            for placement in ("subset", "optimal"):
                cases = [(program, threads) for program in programs for threads in (1, 2)]
                told = list(pool.map(lambda case: outputs(case[0], cloud, placement, case[1]), cases))
                runs += len(told)
                print(f"{name:16s} {placement:8s} " + "  ".join(f"{k} {v}" for k, v in sorted(told[0].items())))
                for (program, threads), other in zip(cases, told):
                    unlike = [output for output in told[0] if other.get(output) != told[0][output]]
                    differences += bool(unlike)
                    if unlike:
                        print(f"    {program}, {threads} thread(s): {', '.join(unlike)} differ")
    print(f"{runs} runs of {len(programs)} programs, {differences} differ from the first one's")
    return 1 if differences or not runs else 0


if __name__ == "__main__":
    sys.exit(main())
