#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What denoising wins: clouds made noisy by tests/tools/add_noise, simplified to 10 %, measured against the truth.

Usage: noise.py BUILD_FOLDER [MESH.ply ...]      (default: Horse and Venus of ../shared/data)

Noise is the standard deviation of each coordinate and outliers are spread over the bounding box; both and all errors
are relative, to the diagonal and to the number of points.  Cloud: the mean distance of the kept points to the true
mesh, and the largest.  Mesh: the mean of both directions.
"""
import json
import pathlib
import subprocess
import sys
import tempfile

CASES = ((0, 0), (0.0005, 0), (0.001, 0), (0.005, 0), (0.01, 0), (0, 0.05), (0.001, 0.05), (0.005, 0.05))
FORMS = ("none", "outliers", "full")


def run(*arguments):
    done = subprocess.run([str(a) for a in arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, arguments))}\n{done.stderr}")
    return done.stdout


def errors(whittle, cloud, truth, form, folder):
    run(whittle, cloud, "--ratio", "0.1", "--denoise", form, "--outputs", "cloud,mesh,report", "-o", folder)
    points = json.loads(run(whittle, "measure", folder / "cloud.ply", truth, "--json"))
    mesh = json.loads(run(whittle, "measure", folder / "mesh.ply", truth, "--json"))
    points = next(v for v in points.values() if isinstance(v, dict) and "mean_rel" in v)
    both = (mesh["surface"]["mean_rel"] + mesh["backward"]["mean_rel"]) / 2
    report = json.loads((folder / "report.json").read_text())
    return points["mean_rel"] * 1e4, points["max_rel"] * 1e4, both * 1e4, report["timings_ms"].get("denoise", 0)


def main():
    build = pathlib.Path(sys.argv[1])
    meshes = sys.argv[2:] or [f"../shared/data/{name}.mesh.ply" for name in ("horse", "venus")]
    meshes = [m for m in map(pathlib.Path, meshes) if m.exists() or print(f"skipped: {m} isn't there")]
    for truth in meshes:
        print(f"\n{truth.name.split('.')[0]}, 1e-4 of the diagonal: cloud mean (maximum), mesh mean\n")
        print("| noise | outliers | " + " | ".join(f"denoise={form}" for form in FORMS) + " |")
        print("|---|---|" + "---|" * len(FORMS))
        for noise, outliers in CASES:
            with tempfile.TemporaryDirectory() as name:
                folder = pathlib.Path(name)
                cloud = folder / "noisy.ply"
                run(build / "tests/tools/add_noise", truth, cloud, "--noise", noise, "--outliers", outliers)
                cells = []
                for form in FORMS:
                    mean, largest, mesh, ms = errors(build / "whittle", cloud, truth, form, folder)
                    cells.append(f"{mean:.2f} ({largest:.0f}), {mesh:.2f}" + (f", {ms:.0f} ms" if ms else ""))
            print(f"| {noise:.2%} | {outliers:.0%} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
