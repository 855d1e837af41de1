# SPDX-License-Identifier: GPL-3.0-or-later
"""deploy/recipes: each is run where its program is installed."""
import json
import os
import pathlib
import re
import shutil
import struct
import subprocess
import sys

import pytest

from conftest import SMALL
from test_cli import WHITTLE, sphere

ROOT = pathlib.Path(__file__).resolve().parents[2]
RECIPES = ROOT / "deploy/recipes"
ENVIRONMENT = {**os.environ, "WHITTLE": str(pathlib.Path(WHITTLE).resolve()), "PYTHONPATH": str(ROOT / "api/python")}


def run(*command, **options):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False, timeout=600,
                          env={**ENVIRONMENT, **options.pop("environment", {})}, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def needs(program):
    return pytest.mark.skipif(not shutil.which(program), reason=f"{program} isn't installed")


@pytest.fixture(name="scan")
def make_scan(tmp_path):
    """A sphere of 2 000 points with colours and an intensity."""
    lines = "".join(f"{x:.6f} {y:.6f} {z:.6f} {i % 256} 7 9 {i}\n" for i, (x, y, z) in enumerate(sphere(2000)))
    head = "".join(f"property {kind} {name}\n" for kind, name in
                   [("float", "x"), ("float", "y"), ("float", "z"), ("uchar", "red"), ("uchar", "green"),
                    ("uchar", "blue"), ("float", "intensity")])
    path = tmp_path / "scan.ply"
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex 2000\n{head}end_header\n{lines}")
    return path


def test_make_meshes_each_scan_once(scan, tmp_path):
    (tmp_path / "scans").mkdir()
    for name in ("a.ply", "b.ply"):
        shutil.copy(scan, tmp_path / "scans" / name)
    command = "make", "-C", tmp_path, "-f", RECIPES / "Makefile", "RATIO=0.2"
    run(*command)
    made = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "meshes").iterdir()}
    assert set(made) == {"a.glb", "b.glb"} and (tmp_path / "meshes/a.glb").read_bytes()[:4] == b"glTF"
    os.utime(tmp_path / "scans/b.ply", ns=(2 * made["b.glb"], 2 * made["b.glb"]))
    run(*command)
    assert (tmp_path / "meshes/a.glb").stat().st_mtime_ns == made["a.glb"]
    assert (tmp_path / "meshes/b.glb").stat().st_mtime_ns != made["b.glb"]


def test_tasks_of_an_array_take_a_tile_each(scan, tmp_path):
    shutil.copy(scan, tmp_path / "other.ply")
    (tmp_path / "tiles.txt").write_text(f"{scan}\n{tmp_path}/other.ply\n")
    for number in ("1", "2"):
        run("bash", RECIPES / "tiles.sbatch", tmp_path / "tiles.txt", tmp_path / "out",
            environment={"SLURM_ARRAY_TASK_ID": number, "SLURM_CPUS_PER_TASK": "1", "SLURM_MEM_PER_NODE": "2000"})
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["other.laz", "scan.laz"]
    assert "points             200" in run(WHITTLE, "info", "--quick", tmp_path / "out/scan.laz")


def test_tasks_of_a_runner_may_be_run_again(daemon, tmp_path):
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans/ball.xyz").write_bytes(SMALL)
    command = sys.executable, RECIPES / "tasks.py", daemon.url, tmp_path / "scans", tmp_path / "meshes"
    assert run(*command) == run(*command) == f"{tmp_path}/meshes/ball.ply\n"
    assert (tmp_path / "meshes/ball.ply").read_bytes().startswith(b"ply\n")


@needs("pdal")
def test_pdal_filters_before(tmp_path):
    lines = "".join(f"{x},{y},{(x * y) % 3 / 10}\n" for x in range(60) for y in range(60))
    (tmp_path / "in.csv").write_text("x,y,z\n" + lines)
    run(WHITTLE, "convert", tmp_path / "in.csv", tmp_path / "in.las")
    run(RECIPES / "pdal.sh", tmp_path / "in.las", tmp_path / "out.laz", "--ratio", "0.5")
    assert "classification" in run(WHITTLE, "info", "--quick", tmp_path / "out.laz")


@needs("CloudCompare")
def test_cloudcompare_measures_what_whittle_says(scan, tmp_path):
    run(RECIPES / "cloudcompare.sh", scan, tmp_path / "distances.asc", "--ratio", "0.2")
    names, *lines = (tmp_path / "distances.asc").read_text().splitlines()
    column = next(i for i, name in enumerate(re.split(r"[ ,;]", names)) if "C2M" in name)
    distances = [abs(float(re.split(r"[ ,;]", line)[column])) for line in lines]
    assert len(distances) == 2000 and "intensity" in names and 0 < max(distances) < 0.05
    report = run(WHITTLE, scan, "--ratio", "0.2", "--outputs", "mesh,report", "-o", tmp_path / "out", "--json")
    told = float(re.search(r'"input_to_mesh":\s*{[^}]*"max":\s*([0-9.e+-]+)', report).group(1))
    assert max(distances) == pytest.approx(told, rel=0.02)


@needs("meshlabserver")
def test_meshlab_measures_what_whittle_says(scan, tmp_path):
    run(RECIPES / "meshlab.sh", scan, tmp_path / "distances.ply", "--ratio", "0.2")
    head, data = (tmp_path / "distances.ply").read_bytes().split(b"end_header\n", 1)
    assert re.findall(rb"(?:element|property) (?:float )?(\w+ 2000|\w+)\n", head) == [b"vertex 2000", b"x", b"y", b"z", b"quality"]
    distances = [distance for *_, distance in struct.iter_unpack("<4f", data[:2000 * 16])]
    report = run(WHITTLE, scan, "--ratio", "0.2", "--outputs", "mesh,report", "-o", tmp_path / "out", "--json")
    told = json.loads(report)["error"]["input_to_mesh"]
    assert max(distances) == pytest.approx(told["max"], rel=1e-3)
    assert sum(distances) / 2000 == pytest.approx(told["mean"], rel=1e-3)


@needs("pcl_pcd2ply")
def test_pcl_has_normals_and_colours_by_its_names(scan, tmp_path):
    said = run(RECIPES / "pcl.sh", scan, tmp_path / "small.pcd", "--ratio", "0.1")
    text = (tmp_path / "small.ply").read_text(errors="replace")
    assert "element vertex 200\n" in text
    for name in ("float nx", "uchar red", "float intensity"):
        assert f"property {name}\n" in text, said


@needs("blender")
def test_blender_has_the_mesh(scan, tmp_path):
    run(WHITTLE, scan, tmp_path / "mesh.glb", "--ratio", "0.2")
    said = run("blender", "--background", "--python-exit-code", "1", "--python", RECIPES / "blender.py", "--",
               tmp_path / "mesh.glb", tmp_path / "scene.blend")
    assert "vertices 400 faces 796" in said, said
    assert (tmp_path / "scene.blend").stat().st_size > 1000
