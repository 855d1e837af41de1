#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The error tables of tests/bench/README.md: Horse and Venus at 20, 10 and 5 %, measured against their true meshes.

Usage: accuracy.py BUILD_FOLDER [MESH.ply ...]      (default: Horse and Venus of ../shared/data)

Each mesh's vertices are the cloud that is simplified; its faces are only measured against.  Means are of both
directions, divided by the bounding-box diagonal, in 1e-4; the maximum is of both directions.  Each figure is measured
once more by a judge that has nothing of whittle's (tests/peers/distances.cc, CGAL); it fails where one is off by more
than 5 %.
"""
import json
import pathlib
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "peers"))
import models  # noqa: E402

JUDGE_SAMPLES, MOST_OFF = 50000, 0.05
RATIOS = ("0.2", "0.1", "0.05")
CASES = (
    ("no refinement, dso=none", ["--refine", "none", "--dso", "none"]),
    ("no refinement, dso=rms", ["--refine", "none"]),
    ("flips, dso=rms", ["--refine", "flips"]),
    ("subset, dso=none", ["--dso", "none"]),
    ("subset, dso=rms (the default)", []),
    ("optimal, dso=none", ["--placement", "optimal", "--dso", "none"]),
    ("optimal, dso=rms", ["--placement", "optimal"]),
)


def run(*arguments):
    done = subprocess.run([str(a) for a in arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, arguments))}\n{done.stderr}")
    return done.stdout


def judged(build, made, truth, folder):
    """Mean and maximum of both directions, in the files' units."""
    models.to_plain(made, folder / "made.ply")
    told = json.loads(run(build / "tests/peers/distances", folder / "made.ply", truth, JUDGE_SAMPLES))
    there, back = told["there"], told["back"]
    return (there["mean"] + back["mean"]) / 2, max(there["max"], back["max"])


def measure(build, mesh, truth, ratio, extra, folder):
    """Mean, maximum, points lost, whether it is closed; and by how much mean and maximum differ from the judge's."""
    whittle = build / "whittle"
    run(whittle, mesh, "--ratio", ratio, "--outputs", "mesh,report", "--reference", "points", "--surface", "closed", "-o",
        folder, *extra)
    report = json.loads((folder / "report.json").read_text())
    found = json.loads(run(whittle, "measure", folder / "mesh.ply", mesh, "--json"))
    both = (found["surface"]["mean_rel"] + found["backward"]["mean_rel"]) / 2
    maximum = max(found["surface"]["max_rel"], found["backward"]["max_rel"])
    sound = report["mesh"]["watertight"] and report["mesh"]["manifold"] and report["mesh"]["oriented"]
    mean, largest = (value / found["diagonal"] for value in judged(build, folder / "mesh.ply", truth, folder))
    return both, maximum, report["mesh"]["points_lost"], sound, (both / mean - 1, maximum / largest - 1)


def main():
    build = pathlib.Path(sys.argv[1])
    worst = [0, 0]
    meshes = sys.argv[2:] or [f"../shared/data/{name}.mesh.ply" for name in ("horse", "venus")]
    meshes = [m for m in map(pathlib.Path, meshes) if m.exists() or print(f"skipped: {m} isn't there")]
    for mesh in meshes:
        plain = tempfile.NamedTemporaryFile(suffix=".ply")
        models.to_plain(mesh, plain.name)
        print(f"\n| {mesh.name.split('.')[0]}: mean (maximum), 1e-4 of the diagonal | 20 % | 10 % | 5 % |")
        print("|---|---|---|---|")
        for name, extra in CASES:
            cells = []
            for ratio in RATIOS:
                with tempfile.TemporaryDirectory() as folder:
                    both, maximum, lost, sound, off = measure(build, mesh, plain.name, ratio, extra, pathlib.Path(folder))
                worst = [max(w, o, key=abs) for w, o in zip(worst, off)]
                note = "" if sound and not lost else f", {lost} lost" if sound else ", NOT CLOSED"
                cells.append(f"{both * 1e4:.2f} ({maximum * 1e4:.1f}{note})")
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
    if meshes:
        print(f"\noff from the judge by at most {worst[0]:+.1%} (mean), {worst[1]:+.1%} (maximum)")
    sys.exit(max(map(abs, worst)) > MOST_OFF)


main()
