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
def test_assimp_reads_what_we_write_and_we_what_it_writes(tmp_path, seen, ours):
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
    seen("assimp", ours, "ply", ("x", "y", "z", *SHOWN))


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


@pytest.fixture(name="seen")
def tell_what_was_seen(record_property):
    """For `make readers`: who has read which format, what it came from, and which attributes were as they should be."""
    def tell(who, kind, first, names):
        record_property("seen", json.dumps([who, kind, first, [name for name in POINTS if name in names]]))
    return tell


def made_by(tmp_path, first, second, mesh=False):
    """The points, or the mesh of them, as a format that was converted from another one."""
    source = make_mesh(tmp_path / "mesh.ply") if mesh or first not in FORMATS else make(tmp_path / "scan.ply", {})
    between, out = tmp_path / f"one.{first}", tmp_path / f"two.{second}"
    for step in ((source, between, *HEADER), (between, out)):
        done = whittle("convert", *step, "--force")
        assert done.returncode == 0, done.stderr
    return out


def held_by(*formats):
    """What comes through formats of meshes."""
    return [name for name in POINTS if all(name in ("x", "y", "z", *MESHES.get(form, POINTS)) for form in formats)]


def columns_of_ascii_ply(path):
    head, body = path.read_text(errors="replace").split("end_header\n", 1)
    vertex = head.split("element vertex")[1].split("element")[0]
    names = re.findall(r"property \w+ (\w+)", vertex)
    rows = [line.split() for line in body.splitlines()[:3]]
    return {name: tuple(float(row[i]) for row in rows) for i, name in enumerate(names)}


needs_pcl = pytest.mark.skipif(not shutil.which("pcl_pcd2ply"), reason="pcl_pcd2ply isn't installed")
needs_cloudcompare = pytest.mark.skipif(not shutil.which("CloudCompare"), reason="CloudCompare isn't installed")


@needs_pcl
@pytest.mark.parametrize("first", FORMATS)
def test_pcl_has_every_attribute(tmp_path, seen, first):
    out = made_by(tmp_path, first, "pcd")
    subprocess.run(["pcl_pcd2ply", "-format", "0", out, tmp_path / "pcl.ply"], check=True, capture_output=True)
    found = columns_of_ascii_ply(tmp_path / "pcl.ply")
    for name, values in POINTS.items():
        assert found[name] == pytest.approx(values, abs=1e-4), name
    seen("PCL", "pcd", first, POINTS)


@needs_pcl
@pytest.mark.parametrize("first", FORMATS + ("glb", "obj"))
def test_pcl_has_every_attribute_of_ply(tmp_path, seen, first):
    out = made_by(tmp_path, first, "ply")
    subprocess.run(["pcl_ply2pcd", "-format", "0", out, tmp_path / "pcl.pcd"], check=True, capture_output=True)
    head, body = (tmp_path / "pcl.pcd").read_text().split("DATA ascii\n")
    columns = zip(*map(str.split, body.splitlines()))
    found = dict(zip(head.split("FIELDS ")[1].splitlines()[0].split(), columns))
    names = held_by(first)
    for name, theirs in zip(("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")):
        found[name] = found[theirs]
    for i, name in enumerate(("red", "green", "blue")):
        found[name] = [int(value) >> 16 - 8 * i & 255 for value in found["rgba" if "rgba" in found else "rgb"]]
    for name in names:
        assert list(map(float, found[name])) == pytest.approx(POINTS[name], abs=1e-4), name
    seen("PCL", "ply", first, names)


def columns_of_cloudcompare(path, folder):
    subprocess.run(["CloudCompare", "-SILENT", "-AUTO_SAVE", "OFF", "-C_EXPORT_FMT", "ASC", "-ADD_HEADER", "-SEP",
                    "SPACE", "-PREC", "6", "-O", path, "-MERGE_CLOUDS", "-SAVE_CLOUDS", "FILE", folder / "out.asc"],
                   check=True, capture_output=True, env={"QT_QPA_PLATFORM": "offscreen", "HOME": str(folder),
                                                         "PATH": "/usr/bin:/bin"})
    names, *lines = next(folder.glob("out.asc*")).read_text().splitlines()  # out.asc_0 of several
    return dict(zip(names.lstrip("/").split(), zip(*(map(float, line.split()) for line in lines))))


@needs_cloudcompare
@pytest.mark.parametrize("name", ["ptx-pose", "ptx-two-scans"])
def test_ptx_is_read_as_cloudcompare_reads_it(tmp_path, name):
    """Places, which the scanner's pose moves, of the points that it saw."""
    shutil.copy(ROOT / "tests/fixtures/valid" / name / "input.ptx", tmp_path / "scan.ptx")
    theirs, ours = columns_of_cloudcompare(tmp_path / "scan.ptx", tmp_path), read(tmp_path / "scan.ptx")
    assert len(ours["x"]) > 2
    for axis in "xyz":
        assert sorted(ours[axis]) == pytest.approx(sorted(theirs[axis.upper()]), abs=1e-5), axis


@needs_cloudcompare
@pytest.mark.parametrize("first, second", itertools.product(FORMATS, ("ply", "xyz")))
def test_cloudcompare_has_colours_normals_and_intensity(tmp_path, seen, first, second):
    """Of text it takes the first columns alone for what they are, unless somebody names the others in its window."""
    found = columns_of_cloudcompare(made_by(tmp_path, first, second), tmp_path)
    others = {"x": "X", "y": "Y", "z": "Z"}
    if second == "ply":
        others |= {"red": "R", "green": "G", "blue": "B", "nx": "Nx", "ny": "Ny", "nz": "Nz", "intensity": "intensity"}
    for name, other in others.items():
        assert found[other] == pytest.approx(POINTS[name], abs=2e-3), name  # its normals are of 16 bits
    seen("CloudCompare", second, first, others)


@needs_cloudcompare
@pytest.mark.parametrize("first, second", itertools.product(("ply", "glb", "obj"), ("ply", "obj", "stl")))
def test_cloudcompare_has_the_mesh(tmp_path, seen, first, second):
    """Colours and normals of PLY; of OBJ's it saves none."""
    out = made_by(tmp_path, first, second, mesh=True)
    subprocess.run(["CloudCompare", "-SILENT", "-AUTO_SAVE", "OFF", "-M_EXPORT_FMT", "PLY", "-PLY_EXPORT_FMT", "ASCII",
                    "-O", out, "-SAVE_MESHES", "FILE", tmp_path / "theirs.ply"], check=True, capture_output=True,
                   env={"QT_QPA_PLATFORM": "offscreen", "HOME": str(tmp_path), "PATH": "/usr/bin:/bin"})
    found, names = columns_of_ascii_ply(tmp_path / "theirs.ply"), ("x", "y", "z", *(SHOWN if second == "ply" else ()))
    for name in names:
        assert found[name] == pytest.approx(POINTS[name], abs=2e-3), name
    assert (tmp_path / "theirs.ply").read_text().rstrip().endswith("3 0 1 2")
    seen("CloudCompare", second, first, names)


def open3d_of():
    return pytest.importorskip("open3d", reason="python3-open3d isn't installed")


@pytest.mark.parametrize("first, second", itertools.product(FORMATS, ("ply", "pcd")))
def test_open3d_has_colours_and_normals(tmp_path, seen, first, second):
    open3d = open3d_of()
    cloud = open3d.io.read_point_cloud(str(made_by(tmp_path, first, second)))
    for axis, (place, normal, colour) in enumerate((("x", "nx", "red"), ("y", "ny", "green"), ("z", "nz", "blue"))):
        assert [p[axis] for p in cloud.points] == pytest.approx(POINTS[place])
        assert [n[axis] for n in cloud.normals] == pytest.approx(POINTS[normal], abs=1e-6)
        assert [255 * c[axis] for c in cloud.colors] == pytest.approx(POINTS[colour], abs=1e-3)
    seen("Open3D", second, first, ("x", "y", "z", *SHOWN))


@pytest.mark.parametrize("first, second", itertools.product(("ply", "glb", "obj"), MESHES))
def test_open3d_has_the_mesh(tmp_path, seen, first, second):
    """Colours of GLB are linear, as in the file; STL has none, and normals of its own."""
    open3d = open3d_of()
    mesh = open3d.io.read_triangle_mesh(str(made_by(tmp_path, first, second, mesh=True)))
    names = held_by(second)
    columns = [*zip(*mesh.vertices), *zip(*mesh.vertex_normals), *zip(*mesh.vertex_colors)]
    for name, column in zip(("x", "y", "z", *SHOWN), columns):
        if name in ("red", "green", "blue"):
            column = [255 * (from_linear(value) if second == "glb" else value) for value in column]
        assert name not in names or column == pytest.approx(POINTS[name], abs=0.02), name
    assert [sorted(t) for t in mesh.triangles] == [[0, 1, 2]] and (second == "stl" or len(columns) == 9)
    seen("Open3D", second, first, [name for name in names if name in ("x", "y", "z", *SHOWN)])


@pytest.mark.parametrize("first, second", itertools.product(("ply", "glb", "obj"), MESHES))
def test_trimesh_has_the_mesh(tmp_path, seen, first, second):
    trimesh = pytest.importorskip("trimesh", reason="trimesh isn't installed; Debian 12 has no package of it")
    mesh = trimesh.load(str(made_by(tmp_path, first, second, mesh=True)), force="mesh", process=False)
    for axis, name in enumerate("xyz"):
        assert sorted(mesh.vertices[:, axis]) == pytest.approx(sorted(POINTS[name]))
    assert len(mesh.faces) == 1
    seen("trimesh", second, first, ("x", "y", "z"))


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


@needs_npm("gltf-validator")
@pytest.mark.parametrize("first", ("ply", "glb", "obj"))
def test_the_validator_of_gltf_takes_every_attribute(tmp_path, seen, first):
    out = made_by(tmp_path, first, "glb", mesh=True)
    done = subprocess.run(["node", NODE / "validate_glb.js", out], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout == "", done.stdout + done.stderr
    seen("gltf-validator", "glb", first, held_by(first))


@needs_npm("@loaders.gl/core")
@pytest.mark.parametrize("who, kind", READERS)
def test_readers_of_browsers_have_what_every_format_had(tmp_path, seen, who, kind):
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
        seen(who, kind, path.name.split(".")[1],
             [name for names in READERS[who, kind].values() for name in names if name in ("x", "y", "z", *held)])


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
