# SPDX-License-Identifier: GPL-3.0-or-later
"""whittle as a user runs it: options, outputs, exit statuses, progress, signals."""
import json
import math
import os
import pathlib
import random
import re
import signal
import struct
import subprocess

import pytest

from conftest import SANITIZED

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
    for name in ("--force", "--dry-run", "--ratio", "--points", "--max_error", "--levels", "--outputs", "--placement", "--dso", "--dso_exponent",
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
    assert len((tmp_path / "out" / "cloud.xyz").read_text().splitlines()) == 300


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
    (["x.ply", "--raito", "0.1"], "--raito: unknown option; did you mean '--ratio'?\n"),
    (["x.ply", "--max-eror=0.1"], "--max-eror: unknown option; did you mean '--max_error'?\n"),
    (["x.ply", "--dry-rnu"], "--dry-rnu: unknown option; did you mean '--dry-run'?\n"),
    (["x.ply", "--foo"], "--foo: unknown option\n"),
    (["x.ply", "--no-such-option=5"], "--no-such-option: unknown option\n"),
    (["x.ply", "--max-error", "lots"], "--max-error: 'lots' is not allowed"),
    (["x.ply", "--neighbours-max=4"], "--neighbours-max: is below neighbours_min"),
    (["x.ply", "--cocone=loose"], "--cocone: 'loose' is not allowed; it takes one of tight, literal"),
    (["x.ply", "--cocone=literal", "--reconstruction", "tight"],
     "--cocone: is a deprecated name of reconstruction and conflicts with it; give one of them"),
    (["x.ply", "--force=1"], "--force: it takes no value"),
    (["x.ply", "--progress_fd"], "--progress_fd: a value is missing"),
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


def columns_of(case):
    """The value of `columns` that a fixture is read with, or None."""
    lines = (case / "expect").read_text().splitlines()
    return next((line.split(" ", 1)[1] for line in lines if line.startswith("columns ")), None)


def test_every_bad_cloud_is_refused_and_leaves_nothing(tmp_path):
    cases = sorted((FIXTURES / "invalid").iterdir())
    assert len(cases) > 40
    for case in cases:
        cloud = next(p for p in case.iterdir() if p.name.startswith("input"))
        columns = columns_of(case)
        run = whittle(cloud, "-o", tmp_path / case.name, *(["--columns", columns] if columns else []))
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


# ------------------------------------------------------------------------------------------------ what is replaced

def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(name="folder")
def make_folder(scan, tmp_path):
    """A folder that has a scan by the name that whittle gives to clouds, and a copy by another."""
    for name in ("cloud.ply", "scan.ply"):
        (tmp_path / name).write_bytes(scan[0].read_bytes())
    return tmp_path


@pytest.mark.parametrize("arguments", [
    ["cloud.ply"], ["cloud.ply", "--force"], ["cloud.ply", "-o", "."], ["cloud.ply", "-o", "cloud.ply"],
    ["./cloud.ply", "-o", "cloud.PLY/../cloud.ply"], ["symbolic.ply", "--force"], ["hard.ply", "--force"],
    ["cloud.ply", "-o", "hard.ply"], ["cloud.ply", "-o", "symbolic.ply"], ["cloud.ply", "-o", "linked/"],
    ["cloud.ply", "--levels", "0.2,0.1", "-o", "levels"], ["cloud.ply", "--force", "--dry-run"]], ids=" ".join)
def test_the_input_is_never_replaced(folder, arguments):
    (folder / "symbolic.ply").symlink_to("cloud.ply")
    (folder / "hard.ply").hardlink_to(folder / "cloud.ply")
    (folder / "linked").symlink_to(".")
    (folder / "cloud.PLY").mkdir()
    (folder / "levels").mkdir()
    (folder / "levels" / "cloud_0.1.ply").symlink_to("../hard.ply")
    before = contents(folder)
    run = whittle(*arguments, cwd=folder)
    assert run.returncode == 2 and "is the input itself; -o names another place\n" in run.stderr, run
    assert contents(folder) == before


def test_neither_is_a_mesh_or_standard_input_or_output(folder):
    assert whittle("scan.ply", "--ratio", 1, "--outputs", "mesh", "-q", cwd=folder).returncode == 0
    before = contents(folder)
    run = whittle("mesh.ply", "--outputs", "mesh", "--force", cwd=folder)
    assert run.returncode == 2 and "mesh.ply is the input itself" in run.stderr
    with open(folder / "cloud.ply", "rb") as stream:
        run = whittle("-", "--force", cwd=folder, stdin=stream)
    assert run.returncode == 2 and "cloud.ply is the input itself" in run.stderr
    with open(folder / "cloud.ply", "ab") as stream:
        run = subprocess.run([WHITTLE, "cloud.ply", "-o", "-"], cwd=folder, stdout=stream, stderr=subprocess.PIPE,
                             check=False)
    assert run.returncode == 2 and b"standard output is the input itself" in run.stderr
    assert contents(folder) == before


def test_other_files_are_replaced_only_where_that_was_said(folder):
    before = contents(folder)
    run = whittle("scan.ply", cwd=folder)
    assert run.returncode == 2 and contents(folder) == before
    assert run.stderr == ("whittle: scan.ply: output: cloud.ply is there already; --force replaces it, "
                          "-o names another place\n")
    (folder / "broken.ply").symlink_to("nowhere")
    for arguments in (["--force"], ["-o", "."], ["-f"], ["--output", "."]):
        (folder / "cloud.ply").write_bytes(b"old")
        run = whittle("scan.ply", *arguments, cwd=folder)
        assert run.returncode == 0, run.stderr
        assert len(body_of(folder / "cloud.ply", 23)) == 300
        assert run.stdout.splitlines()[-2:] == ["written          cloud.ply", " " * 17 + "report.json"]
    assert sorted(contents(folder)) == ["cloud.ply", "report.json", "scan.ply"]


def test_a_name_of_a_folder_is_refused_before_the_work(folder):
    (folder / "out" / "cloud.ply").mkdir(parents=True)
    run = whittle("scan.ply", "-o", "out", cwd=folder)
    assert run.returncode == 74 and "out/cloud.ply is a folder" in run.stderr and "\n" == run.stderr[-1]
    assert sorted(p.name for p in (folder / "out").iterdir()) == ["cloud.ply"]


RACE = """
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <errno.h>
#include <unistd.h>
#include <sys/syscall.h>
/* Between the checks and the moment when a file gets its name, somebody moves a file to that name. */
int renameat2(int a, const char *from, int b, const char *to, unsigned flags) {
    const char *moved = getenv("MOVED"), *lacks = getenv("LACKS");
    if (lacks) { errno = EINVAL; return -1; }
    if (moved && !strcmp(to, "cloud.ply")) { unsetenv("MOVED"); rename(moved, to); }
    return (int)syscall(SYS_renameat2, a, from, b, to, flags);
}
"""


@pytest.fixture(name="race", scope="module")
def make_race(tmp_path_factory):
    if SANITIZED:
        pytest.skip("sanitizers come first")
    folder = tmp_path_factory.mktemp("race")
    (folder / "race.c").write_text(RACE)
    subprocess.run(["cc", "-shared", "-fPIC", "-w", "-D_GNU_SOURCE", "-o", folder / "race.so", folder / "race.c"],
                   check=True)
    return {**os.environ, "LD_PRELOAD": str(folder / "race.so")}


def test_a_file_that_comes_while_whittle_works_is_kept(folder, race):
    (folder / "cloud.ply").rename(folder / "other.ply")
    before = contents(folder)
    run = whittle("scan.ply", cwd=folder, env={**race, "MOVED": "other.ply"})
    assert run.returncode == 2 and "cloud.ply is there already" in run.stderr
    assert contents(folder) == {"cloud.ply": before["other.ply"], "scan.ply": before["scan.ply"]}
    (folder / "cloud.ply").unlink()
    run = whittle("scan.ply", "--force", cwd=folder, env={**race, "MOVED": "scan.ply"})
    assert run.returncode == 2 and "cloud.ply is the input itself" in run.stderr
    assert contents(folder) == {"cloud.ply": before["scan.ply"]}


def test_file_systems_without_exchange_of_names_keep_and_replace_too(folder, race):
    lacks = {**race, "LACKS": "1"}
    before = contents(folder)
    assert whittle("cloud.ply", "--force", cwd=folder, env=lacks).returncode == 2
    assert whittle("scan.ply", cwd=folder, env=lacks).returncode == 2
    assert contents(folder) == before
    assert whittle("scan.ply", "-o", ".", "-q", cwd=folder, env=lacks).returncode == 0
    assert len(body_of(folder / "cloud.ply", 23)) == 300
    assert whittle("scan.ply", "-o", "new", "-q", cwd=folder, env=lacks).returncode == 0
    assert (folder / "new/cloud.ply").read_bytes() == (folder / "cloud.ply").read_bytes()
    assert sorted(p.name for p in folder.iterdir()) == ["cloud.ply", "new", "report.json", "scan.ply"]


# ------------------------------------------------------------------------------------------------ one file

@pytest.mark.parametrize("name, more, begins, same", [
    ("small.ply", [], b"ply\n", "cloud.ply"), ("small.PLY", [], b"ply\n", "cloud.ply"),
    ("small.xyz", [], b"", "cloud.xyz"), ("small.pcd", ["--outputs", "cloud"], b"", "cloud.pcd"),
    ("a.ply", ["--outputs", "mesh"], b"ply\n", "mesh.ply"), ("a.stl", ["--outputs", "mesh"], b"", "mesh.stl"),
    ("a.obj", [], b"", "mesh.obj"), ("a.glb", ["--outputs", "mesh.glb"], b"glTF", "mesh.glb"),
    ("small.ply", ["--outputs", "dso"], b"ply\n", "dso.ply"), ("figures.json", [], b"{", "report.json"),
    ("small.v2.ply", [], b"ply\n", "cloud.ply")])
def test_a_name_of_a_format_is_one_file(folder, name, more, begins, same):
    run = whittle("scan.ply", "-o", "deep/" + name, *more, cwd=folder)
    assert run.returncode == 74 and "can't write into the folder deep" in run.stderr
    run = whittle("scan.ply", "-o", name, *more, cwd=folder)
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == f"written          {name}"
    assert (folder / name).read_bytes().startswith(begins)
    assert sorted(contents(folder)) == sorted(["cloud.ply", "scan.ply", name])
    assert whittle("scan.ply", "--outputs", same, "-q", "-o", "all", cwd=folder).returncode == 0
    if same != "report.json":
        assert (folder / name).read_bytes() == (folder / "all" / same).read_bytes()
    assert whittle("scan.ply", "-q", "-o", name, *more, cwd=folder).returncode == 0  # again: it was named


@pytest.mark.parametrize("arguments, part", [
    (["-o", "a.ply", "--outputs", "cloud,mesh"], "a.ply takes one output"),
    (["-o", "a.ply", "--levels", "0.1,0.2"], "a.ply takes one output, of one level"),
    (["-o", "a.pcd", "--outputs", "mesh"], "a.pcd isn't a name for what --outputs asks for, mesh.ply"),
    (["-o", "a.stl", "--outputs", "mesh.obj"], "a.stl isn't a name for what --outputs asks for, mesh.obj"),
    (["-o", "a.json", "--outputs", "cloud"], "a.json isn't a name"),
    (["-o", "a.las"], "no .las is written; files are .ply, .xyz, .pcd, .obj, .stl, .glb, .json, and a folder ends in /"),
    (["--output=a.ply.gz"], "--output: no .gz is written")], ids=lambda value: " ".join(value))
def test_what_can_not_be_one_file_is_refused(folder, arguments, part):
    run = whittle("scan.ply", *arguments, cwd=folder)
    assert run.returncode == 2 and part in run.stderr, run.stderr
    assert sorted(p.name for p in folder.iterdir()) == ["cloud.ply", "scan.ply"]


def test_other_names_are_folders(folder):
    (folder / "there.ply").mkdir()
    for name in ("out", "v1.2", "there.ply", ".ply", "las.d", "new.las/", "very/../deep"):
        (folder / "very").mkdir(exist_ok=True)
        run = whittle("scan.ply", "-o", name, cwd=folder)
        assert run.returncode == 0, run.stderr
        assert sorted(p.name for p in (folder / name).iterdir()) == ["cloud.ply", "report.json"]


def test_a_name_that_is_too_long_is_refused(folder):
    before = contents(folder)
    for name in ("x" * 300, "x/" * 2100, "./" * 2040 + "abcdef"):
        assert whittle("scan.ply", "-o", name, cwd=folder).returncode == 74
    assert contents(folder) == before


# ------------------------------------------------------------------------------------------------ dry runs

def test_a_dry_run_tells_and_writes_nothing(folder):
    before = contents(folder)
    run = whittle("scan.ply", "--outputs", "cloud,mesh,report", "--dry-run", "-o", ".", cwd=folder)
    assert run.returncode == 0 and run.stderr == ""
    told = run.stdout.splitlines()
    assert told[0] == "input            ply/binary_big_endian, 3000 points, 0 triangles"
    assert told[1] == "would keep       300 of 3000 points"
    assert re.fullmatch(r" {17}at most [0-9.]+ MiB where points lie along lines", told[3])
    assert told[4:] == ["would write      cloud.ply (replaces what is there)", " " * 17 + "mesh.ply",
                        " " * 17 + "report.json"]
    assert contents(folder) == before
    def most(*arguments):
        told = whittle("scan.ply", *arguments, "-n", "-o", "out", cwd=folder).stdout
        return float(re.search(r"^would take +at most ([\d.]+) MiB$", told, re.M)[1])

    assert most("--outputs", "mesh", "--ratio", 1) > most("--outputs", "mesh") > most("--outputs", "cloud") > 1


def test_a_dry_run_ends_as_the_run_would(folder):
    before = contents(folder)
    assert whittle("scan.ply", "--dry-run", cwd=folder).returncode == 2  # cloud.ply is there
    assert whittle("none.ply", "-n", cwd=folder).returncode == 74
    broken = FIXTURES / "invalid" / "empty" / "input.ply"
    assert whittle(broken, "--dry-run", "-o", "out", cwd=folder).returncode == 65
    for more, kept in ((["--points", 7], "7 of 3000 points"), (["--levels", "0.5,0.25"], "1500 of 3000 points"),
                       (["--max-error", 0.01], "as many of 3000 points as max_error 0.01 of the diagonal demands")):
        run = whittle("scan.ply", *more, "--dry_run", "-o", "out", cwd=folder)
        assert run.returncode == 0 and f"would keep       {kept}\n" in run.stdout, run
    assert "cloud_0.25.ply" in whittle("scan.ply", "--levels=0.5,0.25", "-n", "-o", "out", cwd=folder).stdout
    piped = whittle("scan.ply", "-n", "-o", "-", cwd=folder)
    assert piped.returncode == 0 and piped.stdout == "" and "would write      standard output\n" in piped.stderr
    assert contents(folder) == before


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
