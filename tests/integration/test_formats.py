# SPDX-License-Identifier: GPL-3.0-or-later
"""Formats from end to end: pipes, compressed input, every output of the command and of the service."""
import gzip
import json
import os
import pathlib
import re
import shutil
import struct
import subprocess
import tempfile

import numpy
import pytest

from test_cli import FIXTURES, WHITTLE, sphere, whittle

TREE = pathlib.Path(__file__).parent.parent.parent
ALL = "cloud,xyz,cloud.pcd,mesh,mesh.obj,mesh.stl,mesh.glb,report"
FILES = ["cloud.pcd", "cloud.ply", "cloud.xyz", "mesh.glb", "mesh.obj", "mesh.ply", "mesh.stl", "report.json"]
# Real meshes: those of Debian's libcgal-demo, where tests/demo/scan.sh has unpacked them.
SCANS = pathlib.Path(os.environ.get("WHITTLE_SCANS", f"{tempfile.gettempdir()}/whittle-scans-{os.getuid()}"))


def run(*arguments, stdin=b""):
    return subprocess.run([WHITTLE, *map(str, arguments)], input=stdin, capture_output=True, check=False)


def coloured(count):
    """A PLY of a sphere far from the origin with normals, colours, an intensity and a list."""
    points = sphere(count)
    header = (f"ply\nformat ascii 1.0\nelement vertex {count}\nproperty double x\nproperty double y\nproperty double z\n"
              "property float nx\nproperty float ny\nproperty float nz\nproperty uchar red\nproperty uchar green\n"
              "property uchar blue\nproperty ushort intensity\nproperty list uchar int seen_by\nend_header\n")
    return (header + "".join(f"{5e6 + x:.7f} {y:.7f} {z:.7f} {x:.6f} {y:.6f} {z:.6f} {i % 256} 128 7 {i} 2 {i} 1\n"
                             for i, (x, y, z) in enumerate(points))).encode()


CLOUD = coloured(500)


@pytest.fixture(name="outputs", scope="module")
def make_outputs(tmp_path_factory):
    """All outputs of one run, and what it said."""
    folder = tmp_path_factory.mktemp("all")
    done = run("-", "--ratio", 0.4, "--outputs", ALL, "--pcd-precision", "double", "-o", folder, stdin=CLOUD)
    assert done.returncode == 0, done.stderr
    return folder


def test_all_outputs_are_there(outputs):
    assert sorted(p.name for p in outputs.iterdir()) == FILES


def test_names_of_files_are_names_of_outputs(tmp_path):
    names = "cloud.ply,cloud.xyz,mesh.ply,report.json"
    assert run("-", "--outputs", names, "-o", tmp_path, stdin=CLOUD).returncode == 0
    assert json.loads((tmp_path / "report.json").read_text())["params"]["outputs"] == ["cloud", "xyz", "mesh", "report"]


def test_the_report_says_what_was_left_out(outputs):
    left_out = json.loads((outputs / "report.json").read_text())["left_out"]
    said = {(entry["file"], entry["what"].split(":")[0]) for entry in left_out}
    assert ("cloud.pcd", "seen_by") in said and ("cloud.xyz", "seen_by") in said
    assert ("mesh.stl", "warning") in said and ("mesh.stl", "properties of the points") in said
    assert ("mesh.glb", "properties of the points") in said
    assert next(e["what"] for e in left_out if e["file"] == "mesh.obj").endswith(": intensity, seen_by")


def points_of(text):
    return sorted(tuple(line.split()[:3]) for line in text.decode().splitlines() if line[0] != "#")


@pytest.mark.parametrize("name", ["cloud.pcd", "cloud.ply", "cloud.xyz"])
def test_clouds_read_back_to_the_same_points(outputs, name):
    again = run(outputs / name, "--ratio", 1, "--outputs", "xyz", "-q", "-o", "-")
    assert points_of(again.stdout) == points_of((outputs / "cloud.xyz").read_bytes())
    assert len(points_of(again.stdout)) == 200


def left_out(folder, name):
    return [entry["what"] for entry in json.loads((folder / "report.json").read_text())["left_out"]
            if entry["file"] == name]


def numbers_of(text):
    return sorted([float(word) for word in line.split()] for line in text.decode().splitlines())


def test_pcd_is_float_around_an_origin_and_the_report_tells_how_far_off(tmp_path):
    assert run("-", "--ratio", 1, "--outputs", "xyz,cloud.pcd,report", "-o", tmp_path, stdin=CLOUD).returncode == 0
    header = (tmp_path / "cloud.pcd").read_bytes().split(b"DATA")[0].decode()
    assert "# origin 5000000 0 0 is to be added to x y z\n" in header
    assert "FIELDS x y z normal_x normal_y normal_z rgb intensity\nSIZE 4 4 4 4 4 4 4 4\nTYPE F F F F F F F F\n" in header
    told = re.fullmatch(r"precision: x, y, z are float32 around 5000000 0 0, off by up to (\S+) \(pcd_precision=double\)",
                        left_out(tmp_path, "cloud.pcd")[-1])
    again = numbers_of(run(tmp_path / "cloud.pcd", "--ratio", 1, "--outputs", "xyz", "-q", "-o", "-").stdout)
    before = numbers_of((tmp_path / "cloud.xyz").read_bytes())
    worst = max(abs(a - b) for p, q in zip(again, before) for a, b in zip(p[:3], q[:3]))
    assert 0 < worst <= float(told[1]) * 1.05 < 1e-7


def test_colours_of_las_are_bytes_unless_asked_for(tmp_path):
    las = tmp_path / "one.las"
    las.write_bytes(next((FIXTURES / "valid/las-2").glob("input.*")).read_bytes()[:-6] + struct.pack("<3H", 65535, 256, 0))
    for colours, kind in (("8", "uchar"), ("keep", "ushort"), ("16", "ushort")):
        folder = tmp_path / colours
        arguments = [] if colours == "8" else ["--colours", colours]
        assert run(las, "--ratio", 1, "--outputs", "cloud,cloud.pcd,report", "-o", folder, *arguments).returncode == 0
        header = (folder / "cloud.ply").read_bytes().split(b"end_header")[0].decode()
        assert f"property {kind} red\nproperty {kind} green\nproperty {kind} blue\n" in header
        fields = (folder / "cloud.pcd").read_bytes().split(b"\nSIZE")[0].split()
        assert (b"rgb" in fields, b"red" in fields) == (colours == "8", colours != "8")
        told = ["colours: 16 bits became 8, divided by 256 (colours=keep keeps them)"] if colours == "8" else []
        assert left_out(folder, "outputs") == told


COLUMNS = ("id,chainage,offset,level\n" +
           "".join(f"{i},{x},{y},{z}\n" for i, (x, y, z) in enumerate(sphere(60)))).encode()


def test_columns_without_known_names_are_refused_until_they_are_named(tmp_path):
    refused = run("-", "-o", tmp_path, stdin=COLUMNS)
    assert refused.returncode == 65 and b"among the columns id, chainage, offset, level; name them" in refused.stderr
    done = run("-", "--columns=x:chainage,y:offset,z:4", "--ratio", 1, "--outputs", "xyz", "--header", "plain", "-o", "-",
               "-q", stdin=COLUMNS)
    assert done.stdout.startswith(b"x y z id\n") and len(done.stdout.splitlines()) == 61


def test_points_without_a_position_are_counted_in_the_report(tmp_path):
    text = CLOUD.replace(b"vertex 500", b"vertex 502") + b"nan nan nan 0 0 0 1 2 3 0 0\n1 2 inf 0 0 0 1 2 3 0 0\n"
    assert run("-", "--ratio", 1, "-o", tmp_path, stdin=text).returncode == 0
    assert left_out(tmp_path, "input") == ["2 points without a position (a coordinate is nan or infinite)"]
    assert json.loads((tmp_path / "report.json").read_text())["points_in"] == 500


@pytest.mark.parametrize("name", ["mesh.obj", "mesh.stl", "mesh.ply"])
def test_meshes_read_back_to_the_same_surface(outputs, name):
    found = json.loads(whittle("measure", outputs / name, outputs / "mesh.ply", "--json").stdout)
    assert found["hausdorff"] < (0.3 if name.endswith("stl") else 1e-6)


def test_glb_is_valid(outputs):
    validator = TREE / "tests" / "node" / "validate_glb.js"
    if not shutil.which("node") or not (validator.parent / "node_modules" / "gltf-validator").exists():
        pytest.skip("gltf-validator isn't installed: npm ci in tests/node")
    done = subprocess.run(["node", validator, outputs / "mesh.glb"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_glb_has_lengths_that_agree(outputs):
    data = (outputs / "mesh.glb").read_bytes()
    magic, version, length, json_bytes, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    scene = json.loads(data[20:20 + json_bytes])
    assert scene["nodes"][0]["matrix"][12] == pytest.approx(5e6, abs=1)
    assert set(scene["meshes"][0]["primitives"][0]["attributes"]) == {"POSITION", "NORMAL", "COLOR_0", "_INTENSITY"}
    assert scene["buffers"][0]["byteLength"] == len(data) - 28 - json_bytes


def test_colours_that_are_all_black_are_none(tmp_path):
    """LAS of a format with colours has such where its points were never given any: in viewers all would be black."""
    black = re.sub(rb"(?m)^((?:\S+ ){6})\d+ 128 7 ", rb"\g<1>0 0 0 ", CLOUD)
    assert black.count(b" 0 0 0 ") >= 500
    for text, coloured_too in ((CLOUD, True), (black, False)):
        assert run("-", "--ratio", 1, "--outputs", "mesh.glb,mesh.obj", "-f", "-o", tmp_path, stdin=text).returncode == 0
        first = next(line for line in (tmp_path / "mesh.obj").read_text().splitlines() if line.startswith("v "))
        assert (b"COLOR_0" in (tmp_path / "mesh.glb").read_bytes()) == (len(first.split()) == 7) == coloured_too


def terrain(place):
    """A slope with hills whose z is upwards, as PLY in double around a place, with normals and faces."""
    side, points, faces = 12, [], []
    for i in range(side):
        for j in range(side):
            points.append((i + place[0], 0.7 * j + place[1], 0.1 * i + (i * j % 5) / 10 + place[2]))
            if i and j:
                a, b, c, d = ((i - p) * side + j - q for p, q in ((1, 1), (0, 1), (0, 0), (1, 0)))
                faces += [(a, b, c), (a, c, d)]
    header = (f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n" +
              "".join(f"property double {axis}\n" for axis in ("x", "y", "z", "nx", "ny", "nz")) +
              f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
    return (header + "".join(f"{x!r} {y!r} {z!r} 0.6 0 0.8\n" for x, y, z in points) +
            "".join("3 {} {} {}\n".format(*face) for face in faces)).encode()


def glb_world(path):
    """Vertices and normals where a reader of binary glTF has them: by the matrix of the scene's only node."""
    data = path.read_bytes()
    length, = struct.unpack_from("<I", data, 12)
    scene, binary = json.loads(data[20:20 + length]), data[28 + length:]
    node, = scene["nodes"]
    identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *node.get("translation", (0, 0, 0)), 1]
    matrix = numpy.array(node.get("matrix", identity)).reshape(4, 4).T
    found = []
    for name in ("POSITION", "NORMAL"):
        accessor = scene["accessors"][scene["meshes"][0]["primitives"][0]["attributes"][name]]
        view = scene["bufferViews"][accessor["bufferView"]]
        kind = numpy.dtype({5126: "<f4", 5123: "<u2", 5120: "i1"}[accessor["componentType"]])
        cells = numpy.ndarray((accessor["count"], 3), kind, binary, view["byteOffset"],
                              (view["byteStride"], kind.itemsize)).astype("f8")
        found.append(cells @ matrix[:3, :3].T + (matrix[:3, 3] if name == "POSITION" else 0))
    return found[0], found[1], node


TURNS = {"x": lambda p: (-p[:, 1], p[:, 0], p[:, 2]), "y": lambda p: p.T, "z": lambda p: (p[:, 0], p[:, 2], -p[:, 1])}


@pytest.mark.parametrize("place", [(0, 0, 0), (500000.25, 4649776.5, 312.125)])
@pytest.mark.parametrize("up", ["auto", "x", "y", "z"])
def test_glb_stands_upright_and_reads_back_as_it_was(up, place, tmp_path):
    (tmp_path / "in.ply").write_bytes(terrain(place))
    assert run(tmp_path / "in.ply", tmp_path / "m.glb", "--ratio", 1, "--up", up).returncode == 0
    assert run("convert", tmp_path / "m.glb", tmp_path / "back.ply", "--encoding", "ascii").returncode == 0
    assert run("convert", tmp_path / "in.ply", tmp_path / "all.xyz").returncode == 0
    text = (tmp_path / "back.ply").read_text().split("end_header\n")[1].splitlines()
    expected = numpy.loadtxt(tmp_path / "all.xyz")[:, :3]
    back = numpy.array([line.split()[:6] for line in text[:len(expected)]], float)
    order = numpy.lexsort(back[:, 2::-1].T)
    assert numpy.abs(back[order, :3] - expected[numpy.lexsort(expected[:, ::-1].T)]).max() < 1e-6
    assert numpy.abs(back[:, 3:] - (0.6, 0, 0.8)).max() < 1e-6
    vertices, normals, node = glb_world(tmp_path / "m.glb")
    turned = TURNS["z" if up == "auto" else up]
    assert numpy.abs(vertices - numpy.stack(turned(back[:, :3]), 1)).max() < 1e-9
    assert numpy.abs(normals - numpy.stack(turned(back[:, 3:]), 1)).max() < 1e-6
    assert ("matrix" in node) == (up != "y")
    measured = json.loads(run("measure", "--json", tmp_path / "m.glb", tmp_path / "in.ply").stdout)
    assert measured["hausdorff"] < 1e-6


def test_glb_of_16_bits_is_turned_too(tmp_path):
    (tmp_path / "in.ply").write_bytes(terrain((500000.25, 4649776.5, 312.125)))
    for up in ("y", "z"):
        assert run(tmp_path / "in.ply", tmp_path / f"{up}.glb", "--ratio", 1, "--up", up, "--quantize",
                   "true").returncode == 0
        assert run("convert", tmp_path / f"{up}.glb", tmp_path / f"{up}.ply").returncode == 0
    assert (tmp_path / "y.ply").read_bytes() == (tmp_path / "z.ply").read_bytes()


def test_what_glb_has_upwards_stays_upwards(tmp_path):
    (tmp_path / "in.ply").write_bytes(terrain((0, 0, 0)))
    assert run("convert", tmp_path / "in.ply", tmp_path / "1.glb").returncode == 0
    assert run("convert", tmp_path / "1.glb", tmp_path / "2.glb").returncode == 0
    turns = [glb_world(tmp_path / f"{i}.glb")[2] for i in (1, 2)]
    assert turns[0]["extras"] == turns[1]["extras"] and turns[0]["matrix"][:12] == turns[1]["matrix"][:12]
    data = (tmp_path / "1.glb").read_bytes()
    length, = struct.unpack_from("<I", data, 12)
    scene = json.loads(data[20:20 + length])
    del scene["nodes"][0]["extras"]
    text = json.dumps(scene, separators=(",", ":")).encode().ljust(length)
    (tmp_path / "other.glb").write_bytes(data[:20] + text + data[20 + length:])
    assert run("convert", tmp_path / "other.glb", tmp_path / "3.glb").returncode == 0
    vertices, _, node = glb_world(tmp_path / "3.glb")  # y, as all glTF has it, though z would be flat
    assert "matrix" not in node
    assert numpy.abs(vertices - glb_world(tmp_path / "1.glb")[0]).max() < 1e-6


def test_stl_of_a_survey_keeps_its_vertices_and_its_place(tmp_path):
    small = b"\n".join(line if len(line.split()) != 6 or b"." not in line else
                       b" ".join(repr(origin + float(value) / 1000).encode() for origin, value in
                                 zip((5e5, 4.6e6, 300, 0, 0, 0), line.split()))
                       for line in terrain((0, 0, 0)).splitlines()) + b"\n"
    (tmp_path / "in.ply").write_bytes(small)
    for command in ((), ("convert",)):
        goal = () if command else ("--ratio", 1)
        done = run(*command, tmp_path / "in.ply", tmp_path / "m.stl", "-f", *goal)
        assert done.returncode == 0 and b"warning          mesh.stl: coordinates are float32 around " in done.stdout
        data = (tmp_path / "m.stl").read_bytes()
        words = data[:80].rstrip(b"\0").split()
        assert words[:2] == [b"whittle;", b"origin"] and words[5:] == [b"to", b"be", b"added"]
        assert run("convert", tmp_path / "m.stl", tmp_path / "back.ply", "-f").returncode == 0
        head = (tmp_path / "back.ply").read_bytes().split(b"end_header")[0]
        assert b"element vertex 144\n" in head and b"element face 242\n" in head and b"property double x" in head
        measured = json.loads(run("measure", "--json", tmp_path / "m.stl", tmp_path / "in.ply").stdout)
        assert measured["hausdorff"] < 2e-9


@pytest.mark.parametrize("listed, left", [("none", ""), ("rgb", "red green blue"), ("intensity,normals", "nx ny nz intensity"),
                                          ("seen_by,red", "red seen_by"), ("Intensity", "intensity")])
def test_properties_leaves_the_others_out(listed, left, tmp_path):
    whole, some, again = tmp_path / "whole.ply", tmp_path / "some.ply", tmp_path / "again.ply"
    for command, goal in ((("convert",), ()), ((), ("--points", 100))):
        assert run(*command, "-", whole, *goal, "--encoding", "ascii", "-f", stdin=CLOUD).returncode == 0
        done = run(*command, "-", some, *goal, "--encoding", "ascii", "--properties", listed, "-f", stdin=CLOUD)
        assert done.returncode == 0, done.stderr
        head, points = some.read_text().split("end_header\n")
        names = [line.split()[-1] for line in head.splitlines() if line.startswith("property ")]
        assert names == ["x", "y", "z", *left.split()]
        columns = ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "intensity"]
        for line, full in zip(points.splitlines(), whole.read_text().split("end_header\n")[1].splitlines()):
            values = dict(zip(columns, full.split())) | {"seen_by": full.split()[10:]}
            expected = [value for name in names for value in ([values[name]] if name != "seen_by" else values[name])]
            assert line.split() == expected
        assert run("convert", some, again, "--encoding", "ascii", "-f").returncode == 0


def test_a_mesh_for_the_web_has_no_more_than_is_asked_for(tmp_path):
    sizes = {}
    for listed in ("", "none", "rgb"):
        options = ("--properties", listed) if listed else ()
        assert run("-", tmp_path / "m.glb", "--ratio", 0.5, "--surface", "closed", *options, "-f", stdin=CLOUD).returncode == 0
        data = (tmp_path / "m.glb").read_bytes()
        scene = json.loads(data[20:20 + struct.unpack_from("<I", data, 12)[0]])
        sizes[listed] = set(scene["meshes"][0]["primitives"][0]["attributes"])
    assert sizes == {"": {"POSITION", "NORMAL", "COLOR_0", "_INTENSITY"}, "none": {"POSITION"},
                     "rgb": {"POSITION", "COLOR_0"}}


def test_properties_that_are_not_there_are_refused(tmp_path):
    done = run("-", tmp_path / "out.ply", "--properties", "rgb,time", stdin=CLOUD)
    assert done.returncode == 64 and b"properties: the input has no time; it has nx, ny" in done.stderr
    assert not (tmp_path / "out.ply").exists()
    for listed in ("rgb,rgb", "none,rgb", "", "a,"):
        assert run("-", tmp_path / "out.ply", "--properties", listed, stdin=CLOUD).returncode == 64


def test_levels_come_in_every_format(tmp_path):
    assert run("-", "--levels", "0.4,0.2", "--outputs", "cloud.pcd,mesh.stl", "-o", tmp_path, stdin=CLOUD).returncode == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "cloud.pcd", "cloud_0.2.pcd", "cloud_0.4.pcd", "mesh.stl", "mesh_0.2.stl", "mesh_0.4.stl"]


def test_too_many_files_are_refused():
    levels = ",".join(f"0.{i:02}" for i in range(1, 16))
    done = run("-", "--levels", levels, "--outputs", ALL, stdin=CLOUD)
    assert done.returncode == 64 and b"at most 64" in done.stderr


# ---------------------------------------------------------------------------------------------- pipes
def test_a_pipe_through_whittle_equals_files(tmp_path):
    piped = run("-", "--points", 100, "-o", "-", stdin=CLOUD)
    assert run("-", "--points", 100, "--outputs", "cloud", "-o", tmp_path, stdin=CLOUD).returncode == 0
    assert piped.stdout == (tmp_path / "cloud.ply").read_bytes()
    assert b"points" in piped.stderr
    twice = run("-", "--points", 50, "-q", "-o", "-", stdin=piped.stdout)
    assert twice.stdout.startswith(b"ply\n") and twice.stderr == b""


def test_one_output_alone_goes_to_standard_output():
    for arguments in (["--outputs", "cloud,mesh"], ["--levels", "0.4,0.2"]):
        done = run("-", *arguments, "-o", "-", stdin=CLOUD)
        assert done.returncode == 64 and b"one output" in done.stderr and done.stdout == b""


def test_a_reader_that_goes_away_ends_it_silently():
    with subprocess.Popen([WHITTLE, "-", "--ratio", "1", "-q", "-o", "-"], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        process.stdin.write(CLOUD)
        process.stdin.close()
        assert process.wait(60) == -13 and process.stderr.read() == b""


@pytest.mark.parametrize("name", ["gzip-of-xyz", "zstd-of-off", "gzip-of-pcd"])
def test_compressed_input_is_read_from_files_and_pipes(name):
    path = next((FIXTURES / "valid" / name).glob("input.*"))
    from_file = run(path, "--ratio", 1, "--outputs", "xyz", "-o", "-")
    from_pipe = run("-", "--ratio", 1, "--outputs", "xyz", "-o", "-", stdin=path.read_bytes())
    assert from_file.returncode == 0 and from_file.stdout == from_pipe.stdout != b""


def test_a_bomb_in_a_pipe_is_refused():
    done = run("-", stdin=gzip.compress(b"0 0 0\n" * (1 << 23)))
    assert done.returncode == 65 and b"times as large" in done.stderr


def test_faces_of_any_format_become_the_reference(tmp_path):
    for name in ("mesh.obj", "mesh.stl", "mesh.ply"):
        source = tmp_path / name
        assert run("-", "--ratio", 1, "--outputs", name, "-o", tmp_path, stdin=CLOUD).returncode == 0
        assert run(source, "--ratio", 0.5, "--outputs", "mesh,report", "-o", tmp_path / "out").returncode == 0
        report = json.loads((tmp_path / "out" / "report.json").read_text())
        assert report["error"]["reference"] == "faces"


# ---------------------------------------------------------------------------------------------- real files
def test_real_meshes_go_through_every_format(tmp_path):
    found = [p for p in sorted(SCANS.glob("data/meshes/*")) if 20_000 < p.stat().st_size < 300_000
             and p.suffix in (".off", ".stl", ".obj", ".ply")][::4]
    if not found:
        pytest.skip("tests/demo/scan.sh hasn't unpacked Debian's libcgal-demo")
    for path in found:
        done = run(path, "--ratio", 1, "--outputs", "xyz,cloud.pcd", "--pcd-precision", "double", "-q", "-o", tmp_path)
        assert done.returncode == 0, (path, done.stderr)
        again = run(tmp_path / "cloud.pcd", "--ratio", 1, "--outputs", "xyz", "-q", "-o", "-")
        assert points_of(again.stdout) == points_of((tmp_path / "cloud.xyz").read_bytes()), path


# ---------------------------------------------------------------------------------------------- the service
def test_the_service_takes_names_of_columns(daemon):
    refused = daemon.post("/v1/simplify", COLUMNS)
    assert refused.status == 422 and "chainage, offset, level" in refused.json["detail"]
    reply = daemon.post("/v1/simplify?columns=-,y,x,z&ratio=1&output=xyz&header=hash", COLUMNS)
    assert reply.status == 200 and reply.body.startswith(b"# x y z\n")
    wrong = daemon.post("/v1/simplify?columns=x,y", COLUMNS)
    assert wrong.status in (400, 422) and wrong.slug == "invalid-parameter" and "different names" in wrong.body.decode()


@pytest.mark.parametrize("header", ["none", "plain", "hash"])
def test_a_coarser_level_of_text_has_the_header(daemon, header):
    job = daemon.submit(CLOUD, f"?points=200&outputs=xyz&header={header}")
    assert daemon.ended(job)["status"] == "successful"
    whole = daemon.curl(f"/v1/jobs/{job}/outputs/cloud.xyz").body.splitlines()
    lines = 50 if header == "none" else 51
    level = daemon.curl(f"/v1/jobs/{job}/outputs/cloud.xyz?points=50")
    assert level.body.splitlines() == whole[:lines]


def test_the_service_writes_all_outputs(daemon):
    job = daemon.submit(CLOUD, f"?ratio=0.4&outputs={ALL}")
    assert daemon.ended(job)["status"] == "successful"
    listed = daemon.curl(f"/v1/jobs/{job}/outputs").json["outputs"]
    assert sorted(o["name"] for o in listed) == FILES
    types = {o["name"]: o["media_type"] for o in listed}
    assert (types["mesh.glb"], types["mesh.obj"], types["mesh.stl"]) == ("model/gltf-binary", "model/obj", "model/stl")
    info = daemon.curl("/v1/info").json
    assert {"las", "obj", "pcd/binary", "stl/ascii"} <= set(info["input_formats"])
    assert set(FILES) <= set(info["outputs"])


@pytest.mark.parametrize("name,format_name", [("las-3-time-and-colour", "las"), ("pcd-binary-compressed",
                         "pcd/binary_compressed"), ("obj-tetrahedron", "obj"), ("zstd-of-off", "zstd")])
def test_the_service_takes_every_format(daemon, name, format_name):
    body = next((FIXTURES / "valid" / name).glob("input.*")).read_bytes()
    job = daemon.ended(daemon.submit(body, "?ratio=1&outputs=cloud.pcd"))
    assert job["status"] == "successful" and job["input"]["format"] == format_name


def test_a_coarser_level_of_a_pcd_is_that_of_a_job(daemon):
    job, fresh = (daemon.submit(CLOUD, f"?points={points}&outputs=cloud.pcd") for points in (200, 50))
    assert daemon.ended(job)["status"] == daemon.ended(fresh)["status"] == "successful"
    level = daemon.curl(f"/v1/jobs/{job}/outputs/cloud.pcd?points=50")
    assert level.status == 200 and level.body == daemon.curl(f"/v1/jobs/{fresh}/outputs/cloud.pcd").body


def test_a_one_shot_gives_any_output(daemon):
    assert daemon.post("/v1/simplify?ratio=0.4&output=mesh.glb", CLOUD).body.startswith(b"glTF")
    assert daemon.post("/v1/simplify?ratio=0.4&output=cloud.ply", CLOUD).body.startswith(b"ply")
    refused = daemon.post("/v1/simplify?output=mesh.fbx", CLOUD)
    choices = json.loads(daemon.curl("/v1/parameters").body)["properties"]["outputs"]["items"]["enum"]
    told = "one of " + ", ".join(choices[:choices.index("cloud.ply")] if "cloud.ply" in choices else choices)
    assert refused.slug == "invalid-parameter" and "preview.png" in told and told in refused.body.decode()
    assert daemon.post("/v1/simplify?output=cloud,mesh", CLOUD).slug == "invalid-parameter"
