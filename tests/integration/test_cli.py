# SPDX-License-Identifier: GPL-3.0-or-later
"""whittle as a user runs it: options, outputs, exit statuses, progress, signals."""
import json
import math
import os
import pathlib
import random
import signal
import struct
import subprocess

import pytest

BUILD = os.environ.get("WHITTLE_BUILD", "build/release")
WHITTLE = os.path.join(BUILD, "whittle")
FIXTURES = pathlib.Path(__file__).parent.parent / "fixtures"


def whittle(*arguments, **options):
    return subprocess.run([WHITTLE, *map(str, arguments)], capture_output=True, text=True, check=False, **options)


def sphere(count, seed=1):
    """Points spread evenly over a unit sphere."""
    turn = math.pi * (3 - math.sqrt(5))
    points = []
    for i in range(count):
        z = 1 - (2 * i + 1) / count
        r = math.sqrt(1 - z * z)
        points.append((r * math.cos(turn * i), r * math.sin(turn * i), z))
    random.Random(seed).shuffle(points)
    return points


@pytest.fixture(name="scan", scope="module")
def make_scan(tmp_path_factory):
    """3 000 points of a sphere with a colour, a label and a time each, as binary PLY; returns path and records."""
    path = tmp_path_factory.mktemp("scan") / "scan.ply"
    header = ("ply\nformat binary_big_endian 1.0\ncomment made for a test\nelement vertex 3000\n"
              "property uchar red\nproperty float z\nproperty float x\nproperty double time\n"
              "property short label\nproperty float y\nend_header\n")
    records = [struct.pack(">Bffdhf", i % 256, z, x, i / 7, i - 1500, y) for i, (x, y, z) in enumerate(sphere(3000))]
    path.write_bytes(header.encode() + b"".join(records))
    return path, records


def body_of(path, record):
    data = pathlib.Path(path).read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    return [data[i:i + record] for i in range(start, len(data), record)]


def test_help_names_every_parameter_of_the_table():
    text = whittle("--help")
    assert text.returncode == 0
    for name in ("--ratio", "--points", "--max_error", "--levels", "--outputs", "--placement", "--dso", "--dso_exponent",
                 "--refine", "--boundary", "--reference", "--threads", "--progress-fd", "Exit status"):
        assert name in text.stdout
    assert whittle("--version").stdout.startswith("whittle ")


def test_all_outputs_of_a_scan(scan, tmp_path):
    run = whittle(scan[0], "--ratio", 0.1, "--outputs", "cloud,xyz,mesh,report,dso,error", "-o", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    names = ["cloud.ply", "cloud.xyz", "dso.ply", "error.ply", "mesh.ply", "report.json"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == names
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["points_in"] == 3000 and report["points_out"] == 300
    assert report["mesh"]["watertight"] and report["mesh"]["manifold"] and report["mesh"]["oriented"]
    assert report["mesh"]["volume"] == pytest.approx(4 / 3 * math.pi, rel=0.05)
    assert 0 < report["error"]["mean_rel"] < report["error"]["max_rel"] < 0.02
    assert report["error"]["reference"] == "points"
    assert report["params"]["ratio"] == 0.1 and report["params"]["placement"] == "subset"
    assert {"neighbours", "contract", "delaunay", "reconstruct", "measure", "total"} <= report["timings_ms"].keys()
    assert len((tmp_path / "out" / "cloud.xyz").read_text().splitlines()) == 301  # a line names the columns


def test_every_property_comes_out_bit_for_bit(scan, tmp_path):
    assert whittle(scan[0], "--points", 500, "-o", tmp_path, "-q").returncode == 0
    originals = {struct.pack("<Bffdhf", *struct.unpack(">Bffdhf", r)) for r in scan[1]}
    kept = body_of(tmp_path / "cloud.ply", 23)
    assert len(kept) == len(set(kept)) == 500
    assert set(kept) <= originals
    header = (tmp_path / "cloud.ply").read_bytes().split(b"end_header")[0].decode()
    assert "comment made for a test" in header
    assert [line.split()[1:] for line in header.splitlines() if line.startswith("property")] == [
        ["uchar", "red"], ["float", "z"], ["float", "x"], ["double", "time"], ["short", "label"], ["float", "y"]]


def test_ascii_says_the_same_as_binary(scan, tmp_path):
    assert whittle(scan[0], "--points", 50, "-o", tmp_path / "b", "-q").returncode == 0
    assert whittle(scan[0], "--points", 50, "-o", tmp_path / "a", "-q", "--encoding=ascii").returncode == 0
    lines = (tmp_path / "a" / "cloud.ply").read_text().split("end_header\n")[1].splitlines()
    for line, record in zip(lines, body_of(tmp_path / "b" / "cloud.ply", 23), strict=True):
        red, z, x, time, label, y = line.split()
        assert struct.pack("<Bffdhf", int(red), float(z), float(x), float(time), int(label), float(y)) == record


def test_a_prefix_is_the_smaller_job(scan, tmp_path):
    assert whittle(scan[0], "--points", 400, "-o", tmp_path / "large", "-q").returncode == 0
    assert whittle(scan[0], "--points", 37, "-o", tmp_path / "small", "-q").returncode == 0
    assert body_of(tmp_path / "large" / "cloud.ply", 23)[:37] == body_of(tmp_path / "small" / "cloud.ply", 23)


def test_levels_leave_a_cloud_and_a_mesh_each(scan, tmp_path):
    run = whittle(scan[0], "--levels", "0.05,0.2", "--outputs", "cloud,mesh,report", "-o", tmp_path)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "cloud.ply").read_bytes() == (tmp_path / "cloud_0.2.ply").read_bytes()
    assert (tmp_path / "mesh.ply").read_bytes() == (tmp_path / "mesh_0.2.ply").read_bytes()
    assert len(body_of(tmp_path / "cloud_0.05.ply", 23)) == 150
    levels = json.loads((tmp_path / "report.json").read_text())["levels"]
    assert [level["points_out"] for level in levels] == [600, 150]
    assert levels[0]["error"]["mean"] < levels[1]["error"]["mean"]


def test_threads_do_not_change_a_byte(scan, tmp_path):
    for threads in (1, 4):
        assert whittle(scan[0], "--outputs", "cloud,mesh", "--threads", threads, "-o", tmp_path / str(threads),
                       "-q").returncode == 0
    for name in ("cloud.ply", "mesh.ply"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "4" / name).read_bytes()


def test_standard_input_is_read(scan, tmp_path):
    with open(scan[0], "rb") as stream:
        run = whittle("-", "--points", 10, "-o", tmp_path, "-q", stdin=stream)
    assert run.returncode == 0, run.stderr
    assert len(body_of(tmp_path / "cloud.ply", 23)) == 10


@pytest.mark.parametrize("arguments, part", [
    ([], "name a cloud"),
    (["x.ply", "--raito", "0.1"], "did you mean 'ratio'"),
    (["x.ply", "--ratio", "0"], "over 0, at most 1"),
    (["x.ply", "--ratio", "2"], "at most 1"),
    (["x.ply", "--ratio", "lots"], "'lots' is not allowed"),
    (["x.ply", "--ratio"], "value is missing"),
    (["x.ply", "--ratio", "0.1", "--points", "5"], "conflicts with ratio"),
    (["x.ply", "--levels", "0.1,0.1"], "separated by commas"),
    (["x.ply", "y.ply"], "only one input"),
    (["x.ply", "-z"], "unknown option"),
    (["x.ply", "--progress-fd", "no"], "number of a descriptor"),
])
def test_wrong_options_are_refused_with_a_reason(arguments, part):
    run = whittle(*arguments)
    assert run.returncode == 2
    assert part in run.stderr and run.stdout == ""


def test_every_bad_cloud_is_refused_and_leaves_nothing(tmp_path):
    cases = sorted((FIXTURES / "invalid").iterdir())
    assert len(cases) > 40
    for case in cases:
        cloud = next(p for p in case.iterdir() if p.name.startswith("input"))
        run = whittle(cloud, "-o", tmp_path / case.name)
        assert run.returncode == 65, (case.name, run.stderr)
        assert run.stderr.startswith(f"whittle: {cloud}: ") and run.stderr.count("\n") == 1
        assert not (tmp_path / case.name).exists()


@pytest.mark.parametrize("lines, part", [
    (["0 0 0", "1 1 1", "2 2 2", "3 3 3", "4 4 4"], "one line"),
    ([f"{i % 5} {i // 5} 0" for i in range(25)], "one plane"),
    (["1 2 3"] * 9, "distinct"),
    (["0 0 0", "1 0 0", "0 1 0"], "4 distinct points"),
])
def test_what_has_no_volume_has_no_mesh_but_a_cloud(tmp_path, lines, part):
    (tmp_path / "in.xyz").write_text("\n".join(lines) + "\n")
    run = whittle(tmp_path / "in.xyz", "--ratio", 1, "--outputs", "mesh", "-o", tmp_path / "out")
    assert run.returncode == 65 and part in run.stderr
    run = whittle(tmp_path / "in.xyz", "--ratio", 1, "-o", tmp_path / "out", "-q")
    assert run.returncode == 0, run.stderr


def test_what_can_not_be_written_is_an_io_error(scan, tmp_path):
    assert whittle("/nonexistent/cloud.ply").returncode == 74
    (tmp_path / "file").write_text("in the way")
    run = whittle(scan[0], "-o", tmp_path / "file")
    assert run.returncode == 74 and "file" in run.stderr


def test_progress_ends_with_done_or_the_failure(scan, tmp_path):
    def told(*arguments):
        read, write = os.pipe()
        run = subprocess.run([WHITTLE, *map(str, arguments), "--progress-fd", str(write), "-o", str(tmp_path)],
                             pass_fds=[write], capture_output=True, text=True, check=False)
        os.close(write)
        with os.fdopen(read) as stream:
            return run, stream.read().splitlines()

    run, lines = told(scan[0], "--outputs", "mesh")
    assert run.returncode == 0 and run.stdout == ""
    assert lines[-1] == "done"
    fractions = [float(line.split()[2]) for line in lines[:-1]]
    assert all(line.startswith("progress ") for line in lines[:-1])
    assert fractions == sorted(fractions) and 0 <= fractions[0] and fractions[-1] <= 1 and len(fractions) > 8
    run, lines = told(FIXTURES / "invalid" / "empty" / "input.ply")
    assert run.returncode == 65 and lines[-1].startswith("failed malformed ")


def test_a_signal_stops_it_and_leaves_no_output(tmp_path):
    with open(tmp_path / "in.xyz", "w", encoding="ascii") as out:
        out.writelines(f"{x} {y} {z}\n" for x, y, z in sphere(60000))
    read, write = os.pipe()
    with subprocess.Popen([WHITTLE, str(tmp_path / "in.xyz"), "--outputs", "cloud,mesh", "-o", str(tmp_path / "out"),
                           "--progress-fd", str(write)], pass_fds=[write], stderr=subprocess.DEVNULL) as process:
        os.close(write)
        with os.fdopen(read) as stream:
            assert stream.readline().startswith("progress ")
            process.send_signal(signal.SIGTERM)
            last = stream.read().splitlines()[-1]
        assert process.wait() == 75
    assert last.startswith("failed cancelled ")
    assert not (tmp_path / "out").exists()
