# SPDX-License-Identifier: GPL-3.0-or-later
"""Each parameter has its effect: every value of a row gives another result, and there is a row for every parameter."""
import json
import math
import os
import pathlib
import random
import re
import subprocess

import pytest

WHITTLE = os.path.join(os.environ.get("WHITTLE_BUILD", "build/release"), "whittle")
AROUND, ALONG = 72, 36


def place(u, v, side):
    """A torus with bumps of several sizes; side moves along its normal."""
    r = 0.4 + 0.05 * math.sin(5 * u) * math.cos(3 * v) + (0.05 if 1 < u < 1.6 else 0) + side
    return ((1 + r * math.cos(v)) * math.cos(u), (1 + r * math.cos(v)) * math.sin(u), r * math.sin(v))


def torus(noise=0.0):
    spread = random.Random(5)
    return [place(2 * math.pi * (i + 0.6 * spread.random()) / AROUND, 2 * math.pi * (j + 0.6 * spread.random()) / ALONG,
                  spread.gauss(0, noise)) for i in range(AROUND) for j in range(ALONG)]


def faces():
    def vertex(i, j):
        return i % AROUND * ALONG + j % ALONG + 1
    for i in range(AROUND):
        for j in range(ALONG):
            a, b, c, d = vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)
            yield (a, b, c)
            yield (a, c, d)


def survey(path):
    """Text far from the origin, with 16 bits of colour; the order of its columns is that of its names."""
    lines = [f"{500000 + x:.5f},{y:.5f},{z:.5f},{i % 7},{i * 25},3,65535" for i, (x, y, z) in enumerate(torus())]
    path.write_text("x,y,z,i,r,g,b\n" + "\n".join(lines) + "\n", encoding="ascii")
    return path


def write(path, points, triangles=()):
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points] + [f"f {a} {b} {c}" for a, b, c in triangles]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


@pytest.fixture(name="scans", scope="module")
def make_scans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    strays = random.Random(9)
    noisy = torus(0.004) + [tuple(strays.uniform(-1.5, 1.5) for _ in range(3)) for _ in range(12)]
    return {"torus": write(folder / "torus.obj", torus()),
            "survey": survey(folder / "survey.csv"),
            "faces": write(folder / "faces.obj", torus(), faces()),
            "noisy": write(folder / "noisy.obj", noisy),
            "open": write(folder / "open.obj", [p for p in torus() if p[0] > 0]),
            "holed": write(folder / "holed.obj", [p for p in torus() if math.dist(p, place(2, 0.5, 0)) > 0.8])}


def files(scan, folder, options, program=WHITTLE):
    """What a run writes: name -> content, of the report what doesn't differ from run to run."""
    arguments = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    run = subprocess.run([program, str(scan), *arguments, "-o", str(folder), "-q"], capture_output=True, text=True,
                         check=False)
    assert run.returncode == 0, run.stderr
    found = {path.name: path.read_bytes() for path in folder.iterdir()}
    if "report.json" in found:
        report = json.loads(found["report.json"])
        for name in ("params", "timings_ms", "peak_rss_bytes", "version"):
            del report[name]
        found["report.json"] = report
        found["mesh_to_input"] = report.get("error", {}).get("mesh_to_input")
    return found


# parameter: (scan, what else is asked for, values, what of the results has to differ between any two of them)
CLOUD, MESH = {"outputs": "cloud"}, {"outputs": "mesh,report"}
PREVIEW = {"outputs": "preview.png", "preview_size": 128}
ROWS = {
    "ratio": ("torus", CLOUD, (0.1, 0.2, 1), "cloud.ply"),
    "points": ("torus", CLOUD, (1, 100, 101), "cloud.ply"),
    "max_deviation": ("torus", CLOUD, (0.003, 0.03, 0.3), "cloud.ply"),
    "max_deviation_rel": ("torus", MESH | {"refine": "none"}, (0.004, 0.04), "mesh.ply"),
    "deviation_share": ("torus", CLOUD | {"max_deviation": 0.003}, (1, 0.99, 0.8), "cloud.ply"),
    "max_error": ("torus", CLOUD, (0.0003, 0.003, 0.03), "cloud.ply"),
    "spacing": ("torus", CLOUD, (0.04, 0.1, 0.4), "cloud.ply"),
    "crop": ("torus", CLOUD, ("0,-2,-2,2,2,2", "-2,0,-2,2,2,2", "-2,-2,2,-2,2,2,1,2"), "cloud.ply"),
    "where": ("survey", CLOUD, ("i==2", "i==2|3", "i>=3", "i>=3,y>0"), "cloud.ply"),
    "viewpoint": ("open", CLOUD | {"normals": "true"}, ("0,0,9", "0,0,-9"), "cloud.ply"),
    "normals": ("torus", CLOUD, ("false", "true"), "cloud.ply"),
    "levels": ("torus", CLOUD, ("0.1", "0.2", "0.2,0.1", "0.2,0.05"), None),
    "outputs": ("torus", {}, ("cloud", "xyz", "mesh", "report", "dso", "error", "cloud.pcd", "mesh.obj", "mesh.stl",
                              "mesh.glb", "preview.png", "cloud.las", "cloud.laz", "cloud.copc.laz", "tileset"), None),
    "quantize": ("torus", MESH | {"outputs": "mesh.glb"}, ("false", "true"), "mesh.glb"),
    "meshopt": ("torus", MESH | {"outputs": "mesh.glb"}, ("false", "true"), "mesh.glb"),
    "denoise": ("noisy", CLOUD | {"ratio": 1}, ("none", "outliers", "full"), "cloud.ply"),
    "placement": ("torus", MESH | {"order": "simplify-first"}, ("subset", "optimal"), "mesh.ply"),
    "dso": ("torus", CLOUD, ("rms", "sum", "none"), "cloud.ply"),
    "dso_exponent": ("torus", CLOUD, (-0.5, 0, 0.25, 1), "cloud.ply"),
    "area_weight": ("torus", CLOUD, ("unit", "area"), "cloud.ply"),
    "line_quadric": ("torus", CLOUD, (0, 0.003, 0.1), "cloud.ply"),
    "neighbourhood": ("torus", CLOUD | {"neighbours_min": 3, "neighbours_max": 40}, (1, 2.5, 4), "cloud.ply"),
    "neighbours_min": ("torus", CLOUD | {"neighbourhood": 1}, (3, 6, 9), "cloud.ply"),
    "neighbours_max": ("torus", CLOUD | {"neighbourhood": 16}, (6, 10, 20), "cloud.ply"),
    "reconstruction": ("torus", MESH | {"refine": "none"}, ("tight", "literal"), "mesh.ply"),
    "surface": ("open", MESH | {"refine": "none"}, ("closed", "open", "heightfield"), "mesh.ply"),
    "order": ("torus", MESH | {"refine": "none"}, ("simplify-first", "reconstruct-first"), "mesh.ply"),
    "boundary": ("open", MESH | {"refine": "none"}, ("fill", "keep"), "mesh.ply"),
    "weights": ("survey", CLOUD, ("rgb:0.2", "i:0.5", "i:0.5,rgb:0.2"), "cloud.ply"),
    "close_holes": ("holed", MESH | {"refine": "none", "surface": "open", "ratio": 0.3}, (0.01, 5), "mesh.ply"),
    "attributes": ("survey", MESH | {"placement": "optimal"}, ("nearest", "mean"), "mesh.ply"),
    "refine": ("torus", MESH, ("none", "flips", "full"), "mesh.ply"),
    "reference": ("faces", MESH | {"refine": "none", "surface": "closed"}, ("points", "faces", "reconstruction"),
                  "mesh_to_input"),
    "encoding": ("torus", CLOUD, ("binary", "ascii"), "cloud.ply"),
    "colours": ("survey", CLOUD, ("8", "16", "keep"), "cloud.ply"),
    "pcd_precision": ("survey", {"outputs": "cloud.pcd"}, ("float", "double"), "cloud.pcd"),
    "header": ("survey", {"outputs": "xyz"}, ("none", "plain", "hash"), "cloud.xyz"),
    "columns": ("survey", CLOUD, ("x,y,z", "y,x,z", "x,y,z,-", "x:2,y:1,z:i"), "cloud.ply"),
    "properties": ("survey", CLOUD, ("none", "rgb", "i", "i,rgb"), "cloud.ply"),
    "preview_size": ("torus", PREVIEW, (64, 65, 200), "preview.png"),
    "preview_azimuth": ("torus", PREVIEW, (-90, 0, 0.5, 200), "preview.png"),
    "preview_elevation": ("torus", PREVIEW, (-90, 0, 10.5, 90), "preview.png"),
    "up": ("torus", PREVIEW, ("x", "y", "z"), "preview.png"),
    "seed": ("torus", MESH, (0, 1, 2), "mesh_to_input"),
    "threads": ("torus", MESH | {"outputs": "cloud,mesh,dso,error,report,preview.png"}, (0, 1, 3), None),
}
WITHOUT_EFFECT = {"threads"}


def test_every_parameter_has_a_row():
    text = subprocess.run([WHITTLE, "--help"], capture_output=True, text=True, check=True).stdout
    options = re.findall(r"^  --([\w-]+)$", text[text.index("\nParameters for every day:"):], re.M)
    names = [option.replace("-", "_") for option in options]
    assert "ratio" in names and "threads" in names
    assert set(names) == set(ROWS)


@pytest.mark.parametrize("name", ROWS)
def test_each_value_gives_another_result(name, scans, tmp_path):
    scan, others, values, part = ROWS[name]
    found = [files(scans[scan], tmp_path / str(i), others | {name: value}) for i, value in enumerate(values)]
    results = [run[part] if part else run for run in found]
    same = [(values[i], values[j]) for j in range(len(values)) for i in range(j) if results[i] == results[j]]
    assert len(same) == (len(values) * (len(values) - 1) // 2 if name in WITHOUT_EFFECT else 0), same


def test_a_deprecated_name_does_the_same_and_help_shows_the_new_one(scans, tmp_path):
    """The report tells the parameter by its present name, and as long as the old one is accepted by that, too."""
    runs = [files(scans["torus"], tmp_path / name, MESH | {name: "literal"}) for name in ("cocone", "reconstruction")]
    assert runs[0] == runs[1]
    params = json.loads((tmp_path / "cocone" / "report.json").read_text(encoding="utf-8"))["params"]
    assert params["reconstruction"] == params["cocone"] == "literal"
    assert "cocone" not in subprocess.run([WHITTLE, "--help"], capture_output=True, text=True, check=True).stdout


def test_borders_are_filled_or_kept(scans, tmp_path):
    meshes = [files(scans["open"], tmp_path / kind, ROWS["boundary"][1] | {"boundary": kind})["report.json"]["mesh"]
              for kind in ("fill", "keep")]
    assert [mesh["watertight"] for mesh in meshes] == [True, False]
    assert meshes[0]["borders"] == 0 < meshes[1]["borders"]


def error(run):
    return run["report.json"]["error"]["symmetric"]["mean"]


def vertices(run):
    head, data = run["mesh.ply"].split(b"end_header\n", 1)
    count = int(re.search(rb"element vertex (\d+)", head)[1])
    assert b"format ascii" in head
    return {tuple(map(float, line.split()[:3])) for line in data.splitlines()[:count]}


def test_refinement_lowers_the_error_at_each_step(scans, tmp_path):
    runs = [files(scans["torus"], tmp_path / form, MESH | {"encoding": "ascii", "refine": form})
            for form in ("none", "flips", "full")]
    errors = [error(run) for run in runs]
    assert errors[1] < 0.97 * errors[0] and errors[2] < 0.85 * errors[1], errors
    assert vertices(runs[0]) == vertices(runs[1]) != vertices(runs[2])


@pytest.mark.parametrize("order", ["auto", "simplify-first"])
def test_optimal_placement_leaves_the_points_for_a_lower_error(scans, tmp_path, order):
    given = {tuple(float(f"{c:.9g}") for c in point) for point in torus()}
    runs = [files(scans["torus"], tmp_path / form, MESH | {"encoding": "ascii", "placement": form, "order": order})
            for form in ("subset", "optimal")]
    assert vertices(runs[0]) <= given
    assert len(vertices(runs[1]) & given) < len(vertices(runs[1])) / 10
    assert error(runs[1]) < 0.9 * error(runs[0])


def test_the_reference_is_the_faces_where_there_are_any(scans, tmp_path):
    runs = [files(scans["faces"], tmp_path / form, MESH | {"refine": "none", "reference": form})
            for form in ("auto", "faces")]
    assert runs[0] == runs[1] and runs[0]["report.json"]["error"]["reference"] == "faces"
