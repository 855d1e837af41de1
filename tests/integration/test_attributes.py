# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes through every pair of formats, in by one and out by another; and what readers that aren't ours see."""
import itertools
import json
import pathlib
import re
import shutil
import struct
import subprocess

import pytest

from test_cli import whittle

ROOT = pathlib.Path(__file__).resolve().parents[2]
NODE = ROOT / "tests/node"

# One cloud by what programs call it: name, value of each of three points.
POINTS = {"x": (1, 4, 7), "y": (2, 5, 8), "z": (3, 6, 9.5), "nx": (0, 0, 1), "ny": (0, 1, 0), "nz": (1, 0, 0),
          "red": (10, 40, 70), "green": (20, 50, 80), "blue": (30, 60, 90), "intensity": (5, 6, 7),
          "classification": (2, 6, 9), "gps_time": (100.5, 200.25, 300), "label": (7, 8, 9)}
TYPES = {"red": "uchar", "green": "uchar", "blue": "uchar", "intensity": "ushort", "classification": "uchar",
         "gps_time": "double", "label": "int"}
CALLED = {  # by others
    "usual": {},
    "CloudCompare": {"intensity": "scalar_Intensity", "classification": "scalar_Classification",
                     "gps_time": "scalar_GpsTime", "label": "scalar_Label"},
    "PCL": {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"},
    "PDAL": {"red": "Red", "green": "Green", "blue": "Blue", "nx": "NormalX", "ny": "NormalY", "nz": "NormalZ",
             "intensity": "Intensity", "classification": "Classification", "gps_time": "GpsTime", "label": "Label"},
    "Potree": {"red": "r", "green": "g", "blue": "b", "classification": "class", "gps_time": "gps-time"},
}
FORMATS = ("ply", "pcd", "las", "laz", "xyz")
HEADER = ("--header", "plain")


def make(path, called):
    head = "".join(f"property {TYPES.get(name, 'float')} {called.get(name, name)}\n" for name in POINTS)
    rows = "".join(" ".join(f"{POINTS[name][i]:g}" for name in POINTS) + "\n" for i in range(3))
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex 3\n{head}end_header\n{rows}")
    return path


def read(path):
    """The columns of a cloud by our own reader, as text with names."""
    text = path.with_suffix(".columns.xyz")
    done = whittle("convert", path, text, *HEADER, "--force")
    assert done.returncode == 0, done.stderr
    names, *lines = text.read_text().splitlines()
    return {name: tuple(map(float, column)) for name, column in zip(names.split(), zip(*map(str.split, lines)))}


@pytest.mark.parametrize("first, second", itertools.product(FORMATS, FORMATS))
def test_every_attribute_survives_every_pair_of_formats(tmp_path, first, second):
    scan = make(tmp_path / "scan.ply", {})
    for source, out in ((scan, tmp_path / f"one.{first}"), (tmp_path / f"one.{first}", tmp_path / f"two.{second}")):
        done = whittle("convert", source, out, *HEADER)
        assert done.returncode == 0, done.stderr
    found = read(tmp_path / f"two.{second}")
    for name, values in POINTS.items():
        assert found[name] == pytest.approx(values, abs=1e-6), name


# Formats of meshes, and what each can hold beside coordinates.
SHOWN = ("nx", "ny", "nz", "red", "green", "blue")
MESHES = {"ply": tuple(POINTS)[3:], "glb": tuple(POINTS)[3:], "obj": SHOWN, "stl": ()}


def make_mesh(path):
    make(path, {})
    path.write_text(path.read_text().replace("end_header\n", "element face 1\nproperty list uchar int vertex_indices\n"
                                             "end_header\n") + "3 0 1 2\n")
    return path


@pytest.mark.parametrize("first, second", itertools.product(MESHES, MESHES))
def test_every_attribute_of_a_mesh_survives_every_pair_of_formats(tmp_path, first, second):
    mesh = make_mesh(tmp_path / "mesh.ply")
    for source, out in ((mesh, tmp_path / f"one.{first}"), (tmp_path / f"one.{first}", tmp_path / f"two.{second}")):
        done = whittle("convert", source, out)
        assert done.returncode == 0 and "1 triangles" in done.stdout, done
    found = read(tmp_path / f"two.{second}")
    for name in ("x", "y", "z", *(set(MESHES[first]) & set(MESHES[second]))):
        assert found[name] == pytest.approx(POINTS[name], abs=1e-6), name


def test_numbers_that_glb_would_round_are_left_out_and_told(tmp_path):
    """Of 32 bits, and doubles: whole columns, where one value isn't a float32."""
    mesh = make_mesh(tmp_path / "mesh.ply")
    mesh.write_text(mesh.read_text().replace(" 300 9\n", " 300.1 16777217\n"))
    done = whittle("convert", mesh, tmp_path / "out.glb")
    assert done.returncode == 0 and "gps_time" in done.stdout + done.stderr and "label" in done.stdout + done.stderr
    found = read(tmp_path / "out.glb")
    assert "label" not in found and "gps_time" not in found
    assert found["classification"] == pytest.approx(POINTS["classification"])


PTX = "3\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" + "".join(
    f"{x} {y} {z} {i} {r} {g} {b}\n" for x, y, z, i, r, g, b in zip(*(
        POINTS[n] for n in ("x", "y", "z")), (0.25, 0.5, 0.75), *(POINTS[n] for n in ("red", "green", "blue"))))
E57 = ROOT / "tests/fixtures/valid/e57-all-kinds/input.e57"


@pytest.mark.parametrize("second", ("ply", "pcd", "xyz", "las"))
def test_what_scanners_write_keeps_its_attributes(tmp_path, second):
    """LAS has whole numbers for intensities."""
    (tmp_path / "scan.ptx").write_text(PTX)
    assert whittle("convert", tmp_path / "scan.ptx", tmp_path / f"ptx.{second}", *HEADER).returncode == 0
    found = read(tmp_path / f"ptx.{second}")
    for name in ("x", "y", "z", "red", "green", "blue"):
        assert found[name] == pytest.approx(POINTS[name], abs=1e-6), name
    assert second == "las" or found["intensity"] == pytest.approx((0.25, 0.5, 0.75))
    assert whittle("convert", E57, tmp_path / f"e57.{second}", *HEADER, "--colours", "keep").returncode == 0
    found, direct = read(tmp_path / f"e57.{second}"), columns_of_e57(tmp_path)
    for name in ("x", "y", "z"):
        assert found[name] == pytest.approx(direct[name], abs=1e-6), name
    assert second == "las" or found["intensity"] == pytest.approx(direct["intensity"])


def columns_of_e57(folder):
    copy = folder / "copy.e57"
    copy.write_bytes(E57.read_bytes())
    return read(copy)


def from_linear(value):
    return 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055


@pytest.mark.skipif(not shutil.which("assimp"), reason="assimp isn't installed")
@pytest.mark.parametrize("ours", ("glb", "obj", "ply"))
def test_assimp_reads_what_we_write_and_we_what_it_writes(tmp_path, ours):
    """Its colours are those of the file: linear in glTF."""
    assert whittle("convert", make_mesh(tmp_path / "mesh.ply"), tmp_path / f"ours.{ours}").returncode == 0
    for end, form in (("glb", "glb2"), ("obj", "obj"), ("ply", "ply")):
        theirs = tmp_path / f"theirs.{end}"
        subprocess.run(["assimp", "export", tmp_path / f"ours.{ours}", theirs, f"-f{form}"], check=True,
                       capture_output=True)
        found = read(theirs)
        for name in ("x", "y", "z", "nx", "ny", "nz"):
            assert sorted(found[name]) == pytest.approx(sorted(POINTS[name]), abs=1e-5), (end, name)
    linear = read(tmp_path / "theirs.ply")
    for name in ("red", "green", "blue"):
        values = [255 * from_linear(v / 255) for v in linear[name]] if ours == "glb" else linear[name]
        assert values == pytest.approx(POINTS[name], abs=13 if ours == "glb" else 1.5), name  # linear ones in 8 bits


@pytest.mark.parametrize("who", CALLED)
def test_what_others_call_the_same_becomes_what_las_calls_it(tmp_path, who):
    done = whittle("convert", make(tmp_path / "scan.ply", CALLED[who]), tmp_path / "out.las")
    assert done.returncode == 0, done.stderr
    found = read(tmp_path / "out.las")
    for name in ("red", "green", "blue", "intensity", "classification", "gps_time"):
        assert found[name] == pytest.approx(POINTS[name]), (who, name)


@pytest.mark.parametrize("who", CALLED)
def test_conditions_know_all_names(tmp_path, who):
    scan = make(tmp_path / "scan.ply", CALLED[who])
    for condition, left in (("class==2|6", 2), ("intensity>5", 2), ("gps_time<200", 1), ("red>=70", 1), ("nz>0.5", 1)):
        done = whittle("convert", scan, tmp_path / "out.xyz", "--where", condition, "--force", "-q")
        assert done.returncode == 0, done.stderr
        assert len((tmp_path / "out.xyz").read_text().splitlines()) == left, (who, condition)


# ---------------------------------------------------------------------------------------------- others' readers


def columns_of_ascii_ply(path):
    head, body = path.read_text(errors="replace").split("end_header\n", 1)
    vertex = head.split("element vertex")[1].split("element")[0]
    names = re.findall(r"property \w+ (\w+)", vertex)
    rows = [line.split() for line in body.splitlines()[:3]]
    return {name: tuple(float(row[i]) for row in rows) for i, name in enumerate(names)}


@pytest.mark.skipif(not shutil.which("pcl_pcd2ply"), reason="pcl_pcd2ply isn't installed")
@pytest.mark.parametrize("first", FORMATS)
def test_pcl_has_every_attribute(tmp_path, first):
    scan = make(tmp_path / "scan.ply", {})
    assert whittle("convert", scan, tmp_path / f"one.{first}", *HEADER).returncode == 0
    assert whittle("convert", tmp_path / f"one.{first}", tmp_path / "two.pcd").returncode == 0
    subprocess.run(["pcl_pcd2ply", "-format", "0", tmp_path / "two.pcd", tmp_path / "pcl.ply"], check=True,
                   capture_output=True)
    found = columns_of_ascii_ply(tmp_path / "pcl.ply")
    for name, values in POINTS.items():
        assert found[name] == pytest.approx(values, abs=1e-4), name


def columns_of_cloudcompare(path, folder):
    subprocess.run(["CloudCompare", "-SILENT", "-AUTO_SAVE", "OFF", "-C_EXPORT_FMT", "ASC", "-ADD_HEADER", "-SEP",
                    "SPACE", "-PREC", "6", "-O", path, "-MERGE_CLOUDS", "-SAVE_CLOUDS", "FILE", folder / "out.asc"],
                   check=True, capture_output=True, env={"QT_QPA_PLATFORM": "offscreen", "HOME": str(folder),
                                                         "PATH": "/usr/bin:/bin"})
    names, *lines = next(folder.glob("out.asc*")).read_text().splitlines()  # out.asc_0 of several
    return dict(zip(names.lstrip("/").split(), zip(*(map(float, line.split()) for line in lines))))


@pytest.mark.skipif(not shutil.which("CloudCompare"), reason="CloudCompare isn't installed")
@pytest.mark.parametrize("name", ["ptx-pose", "ptx-two-scans"])
def test_ptx_is_read_as_cloudcompare_reads_it(tmp_path, name):
    """Places, which the scanner's pose moves, of the points that it saw."""
    shutil.copy(ROOT / "tests/fixtures/valid" / name / "input.ptx", tmp_path / "scan.ptx")
    theirs, ours = columns_of_cloudcompare(tmp_path / "scan.ptx", tmp_path), read(tmp_path / "scan.ptx")
    assert len(ours["x"]) > 2
    for axis in "xyz":
        assert sorted(ours[axis]) == pytest.approx(sorted(theirs[axis.upper()]), abs=1e-5), axis


@pytest.mark.skipif(not shutil.which("CloudCompare"), reason="CloudCompare isn't installed")
@pytest.mark.parametrize("first", FORMATS)
def test_cloudcompare_has_colours_normals_and_intensity(tmp_path, first):
    scan = make(tmp_path / "scan.ply", {})
    assert whittle("convert", scan, tmp_path / f"one.{first}", *HEADER).returncode == 0
    assert whittle("convert", tmp_path / f"one.{first}", tmp_path / "two.ply", "--force").returncode == 0
    found = columns_of_cloudcompare(tmp_path / "two.ply", tmp_path)
    others = {"x": "X", "y": "Y", "z": "Z", "red": "R", "green": "G", "blue": "B", "nx": "Nx", "ny": "Ny", "nz": "Nz",
              "intensity": "intensity"}
    for name, other in others.items():
        assert found[other] == pytest.approx(POINTS[name], abs=2e-3), name  # its normals are of 16 bits


@pytest.mark.parametrize("first", FORMATS)
def test_open3d_has_colours_and_normals(tmp_path, first):
    open3d = pytest.importorskip("open3d", reason="python3-open3d isn't installed")
    scan = make(tmp_path / "scan.ply", {})
    assert whittle("convert", scan, tmp_path / f"one.{first}", *HEADER).returncode == 0
    for second in ("ply", "pcd"):
        out = tmp_path / f"two.{second}"
        assert whittle("convert", tmp_path / f"one.{first}", out).returncode == 0
        cloud = open3d.io.read_point_cloud(str(out))
        for axis, (place, normal, colour) in enumerate((("x", "nx", "red"), ("y", "ny", "green"), ("z", "nz", "blue"))):
            assert [p[axis] for p in cloud.points] == pytest.approx(POINTS[place])
            assert [n[axis] for n in cloud.normals] == pytest.approx(POINTS[normal], abs=1e-6)
            assert [255 * c[axis] for c in cloud.colors] == pytest.approx(POINTS[colour], abs=1e-3)


# Readers of browsers: which formats, and what each has of a point, by which name; colours of three.js are linear.
OWN = ("intensity", "classification", "gps_time", "label")
BY_THREE = {"position": ("x", "y", "z"), "normal": ("nx", "ny", "nz"), "color": ("red", "green", "blue")}
BY_LOADERS = {"POSITION": ("x", "y", "z"), "NORMAL": ("nx", "ny", "nz"), "COLOR_0": ("red", "green", "blue")}


def own(form="{}", names=OWN):
    return {form.format(name): (name,) for name in names}


READERS = {
    ("three", "ply"): BY_THREE | own(), ("three", "pcd"): BY_THREE | own(names=("intensity", "label")),
    ("three", "glb"): BY_THREE | own("_{}"), ("three", "obj"): BY_THREE, ("three", "stl"): {"position": ("x", "y", "z")},
    ("loaders.gl", "ply"): BY_LOADERS | own(),
    # It takes the label for the colour.
    ("loaders.gl", "pcd"): {name: BY_LOADERS[name] for name in ("POSITION", "NORMAL")},
    ("loaders.gl", "las"): {name: BY_LOADERS[name] for name in ("POSITION", "COLOR_0")} |
                           own(names=("intensity", "classification")),
    ("loaders.gl", "glb"): BY_LOADERS | {f"_{name.upper()}": (name,) for name in OWN},
    ("loaders.gl", "obj"): {name: BY_LOADERS[name] for name in ("POSITION", "NORMAL", "COLOR_0")},
}
READERS["loaders.gl", "laz"] = READERS["loaders.gl", "las"]


def needs_npm(package):
    return pytest.mark.skipif(not shutil.which("node") or not (NODE / "node_modules" / package).exists(),
                              reason="node, or what make test-contract installs into tests/node, is not there")


def read_by(who, *paths):
    done = subprocess.run(["node", NODE / "read_cloud.mjs", who, *paths], capture_output=True, text=True, check=False,
                          timeout=300)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def bytes_of_colour(who, kind, value):
    """A colour as the reader has it, as a byte: three.js makes all linear, GLB's are, in 16 bits."""
    if who == "three":
        return 255 * from_linear(value)
    return {"glb": lambda v: 255 * from_linear(v / 65535), "obj": lambda v: 255 * v}.get(kind, lambda v: v)(value)


@needs_npm("@loaders.gl/core")
@pytest.mark.parametrize("who, kind", READERS)
def test_readers_of_browsers_have_what_every_format_had(tmp_path, who, kind):
    """From each format that holds all into this one; STL's corners alone come as they are."""
    cloud = (who, kind) in READERS and kind in FORMATS
    sources = [(make(tmp_path / "scan.ply", {}), "cloud", FORMATS)] if cloud else []
    if kind in MESHES:
        sources.append((make_mesh(tmp_path / "mesh.ply"), "mesh", ("ply", "glb", "obj")))
    paths = []
    for source, what, firsts in sources:
        for first in firsts:
            between, out = tmp_path / f"{what}.by.{first}", tmp_path / f"{what}.{first}.{kind}"
            for step in ((source, between, *HEADER), (between, out)):
                done = whittle("convert", *step)
                assert done.returncode == 0, done.stderr
            paths.append(out)
    for path, found in zip(paths, read_by(who, *paths), strict=True):
        held = SHOWN if ".obj." in path.name else tuple(POINTS)  # by what was between
        for theirs, names in READERS[who, kind].items():
            if not set(names) <= {"x", "y", "z", *held}:
                continue
            columns = list(zip(*found["attributes"][theirs]))
            for name, column in zip(names, columns):
                if name in ("red", "green", "blue"):
                    column = [bytes_of_colour(who, kind, value) for value in column]
                assert column == pytest.approx(POINTS[name], abs=0.02 if name in SHOWN else 1e-6), (path, name)
        assert not path.name.startswith("mesh") or kind == "obj" or found["corners"] == 3


@needs_npm("web-e57")
@pytest.mark.parametrize("name", ["bunnyDouble", "bunnyInt19", "tinyCartesianFloatRgb", "tiny_spherical"])
def test_e57_is_read_as_others_read_it(tmp_path, name):
    path = ROOT.parent / "shared/data/e57" / f"{name}.e57"
    if not path.exists():
        pytest.skip("../shared/data/e57 isn't there")
    theirs = read_by("web-e57", path)[0]["attributes"]
    assert whittle("convert", path, tmp_path / "ours.xyz", *HEADER, "--colours", "keep").returncode == 0
    found = read(tmp_path / "ours.xyz")
    assert len(found["x"]) == len(theirs["POSITION"]) > 100
    for name_of, column in zip("xyz", zip(*theirs["POSITION"])):
        assert found[name_of] == pytest.approx(column, rel=1e-6, abs=1e-6)
    for name_of, column in zip(("red", "green", "blue"), zip(*theirs["COLOR_0"])):
        assert found[name_of] == pytest.approx(column, abs=1)


def test_glb_has_colours_and_normals_by_its_own_names(tmp_path):
    """A mesh of the three points: what the JSON of the file names, and the bytes of the colours."""
    scan = make(tmp_path / "scan.ply", CALLED["PCL"])
    scan.write_text(scan.read_text().replace("end_header\n", "element face 1\nproperty list uchar int vertex_indices\n"
                                             "end_header\n") + "3 0 1 2\n")
    assert whittle("convert", scan, tmp_path / "mesh.glb").returncode == 0
    data = pathlib.Path(tmp_path / "mesh.glb").read_bytes()
    length, = struct.unpack_from("<I", data, 12)
    attributes = json.loads(data[20:20 + length])["meshes"][0]["primitives"][0]["attributes"]
    assert {"POSITION", "NORMAL", "COLOR_0"} <= set(attributes)
