# SPDX-License-Identifier: GPL-3.0-or-later
"""whittle as a user runs it: options, outputs, exit statuses, progress, signals."""
import gzip
import json
import math
import os
import pathlib
import pty
import random
import re
import shutil
import signal
import struct
import subprocess

import pytest

from conftest import PATIENCE_S, SANITIZED

BUILD = os.environ.get("WHITTLE_BUILD", "build/release")
WHITTLE = os.path.join(BUILD, "whittle")
PROGRAMS = os.path.dirname(os.path.abspath(WHITTLE))
FIXTURES = pathlib.Path(__file__).parent.parent / "fixtures"


def whittle(*arguments, **options):
    return subprocess.run([WHITTLE, *map(str, arguments)], capture_output=True, text=True, check=False, **options)


def test_help_is_120_wide():
    for arguments in (["--help"], ["convert", "--help"], ["measure", "--help"], ["info", "--help"], ["tiles", "--help"]):
        assert max(map(len, whittle(*arguments).stdout.splitlines())) <= 120, arguments


def test_counts_may_have_units_and_conditions_blanks(tmp_path):
    (tmp_path / "in.xyz").write_text("x y z class\n" + "".join(f"{x} {y} {z} {i % 3}\n" for i, (x, y, z) in
                                                              enumerate(sphere(3000))))
    for points in ("1k", "1e3", "0.001M", "1K", "1000"):
        run = whittle(tmp_path / "in.xyz", tmp_path / "out.ply", "-f", "--points", points)
        assert run.returncode == 0 and "1000 of 3000" in run.stdout, run.stderr
    for points in ("0.0001k", "1kk", "k", "1e", "0x10", "1.5"):
        run = whittle(tmp_path / "in.xyz", tmp_path / "out.ply", "-f", "--points", points)
        assert run.returncode == 64 and f"'{points}' is not allowed" in run.stderr, run.stderr
    run = whittle(tmp_path / "in.xyz", tmp_path / "out.ply", "-f", "--where", " class == 1 | 2 , z > 0 ", "--ratio", 1)
    assert run.returncode == 0 and "points           996 of 996" in run.stdout, run.stderr
    assert whittle(tmp_path / "in.xyz", tmp_path / "out.ply", "-f", "--where", "class==1 2").returncode == 64


def test_quiet_leaves_warnings_on_standard_error(tmp_path):
    (tmp_path / "far.xyz").write_text("".join(f"{x} {y} {z}\n" for x, y, z in sphere(500)) + "9000 0 0\n")
    run = whittle(tmp_path / "far.xyz", tmp_path / "out.ply", "-q")
    assert run.returncode == 0 and run.stdout == ""
    assert re.fullmatch(r"whittle: warning: input: 1 points? lies? hundreds of times .*\n", run.stderr)
    (tmp_path / "cut.las").write_bytes((FIXTURES / "valid/las-cut-tail/input.las").read_bytes())
    told = "whittle: warning: input: the last 1 of 3 points: the file is cut short\n"
    assert whittle(tmp_path / "cut.las", tmp_path / "a.ply", "--ratio", 1, "-q").stderr == told
    assert whittle("convert", tmp_path / "cut.las", tmp_path / "b.ply", "-q").stderr == told
    assert "warning          input: the last 1 of 3 points" in whittle("convert", tmp_path / "cut.las",
                                                                       tmp_path / "c.ply").stdout
    assert "cut.las: the last 1 of 3" in whittle("measure", tmp_path / "a.ply", tmp_path / "cut.las").stderr


def test_coordinates_that_float32_rounded_are_warned_of(tmp_path):
    """Northings of millions of metres are in steps of half a metre; those of a raster of metres are exact."""
    chance = random.Random(4)

    def warns(kind, points):
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        header += "".join(f"property {kind} {axis}\n" for axis in "xyz") + "end_header\n"
        packed = b"".join(struct.pack("<3f" if kind == "float" else "<3d", *point) for point in points)
        (tmp_path / "in.ply").write_bytes(header.encode() + packed)
        run = whittle(tmp_path / "in.ply", tmp_path / "out.ply", "-f", "-q")
        assert run.returncode == 0, run.stderr
        return "float32 holds them in steps of 0.5, " in run.stderr

    scanned = [(chance.random() * 20, chance.random() * 20) for _ in range(3000)]
    raster = [(float(x), float(y)) for x in range(50) for y in range(50)]
    on_earth = [[(x + 500000, y + 5400000, math.sin(x / 3)) for x, y in plane] for plane in (scanned, raster)]
    assert warns("float", on_earth[0])
    assert not warns("double", on_earth[0])
    assert not warns("float", on_earth[1])


def test_a_full_disk_is_told_of_the_output_and_leaves_no_folder(tmp_path):
    (tmp_path / "in.xyz").write_text("".join(f"{x} {y} {z}\n" for x, y, z in sphere(5000)))
    limited = ["sh", "-c", 'ulimit -f 20; exec "$@"', "sh", WHITTLE, tmp_path / "in.xyz", "--ratio", "1", "-o"]
    run = subprocess.run([*limited, tmp_path / "new"], capture_output=True, text=True, check=False)
    assert run.returncode == 74 and run.stderr == f"whittle: {tmp_path}/new/cloud.ply: can't write: File too large\n"
    assert not (tmp_path / "new").exists()


def test_one_point_has_no_diagonal(tmp_path):
    (tmp_path / "in.xyz").write_text("1 2 3\n")
    assert json.loads(whittle("info", "--json", tmp_path / "in.xyz").stdout)["diagonal"] == 0


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
    for name in ("--force", "--dry-run", "--json", "--verbose", "--ratio", "--points", "--max-error", "--levels", "--outputs", "--placement", "--dso",
                 "--dso-exponent",
                 "--refine", "--boundary", "--reference", "--threads", "--progress-fd", "Exit status"):
        assert name in text.stdout
    assert not re.search(r"--[a-z-]*_", text.stdout)
    everyday, advanced = text.stdout.split("Parameters for every day:")[1].split("Advanced parameters:")
    assert "--ratio\n" in everyday and "--outputs\n" in everyday and "--ratio\n" not in advanced
    assert "--line-quadric\n" in advanced and "--line-quadric\n" not in everyday
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
    assert report["params"]["ratio"] == 0.1 and report["params"]["placement"] == "auto"
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
    ([], "use the name of a cloud"),
    (["x.ply", "--raito", "0.1"], "--raito: unknown option; did you mean '--ratio'?\n"),
    (["x.ply", "--max-eror=0.1"], "--max-eror: unknown option; did you mean '--max-error'?\n"),
    (["x.ply", "--dry-rnu"], "--dry-rnu: unknown option; did you mean '--dry-run'?\n"),
    (["x.ply", "--foo"], "--foo: unknown option\n"),
    (["x.ply", "--no-such-option=5"], "--no-such-option: unknown option\n"),
    (["x.ply", "--max-error", "lots"], "--max-error: 'lots' is not allowed"),
    (["x.ply", "--neighbours-max=4"], "--neighbours-max: is below neighbours-min"),
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
    (["x.ply", "--json", "-o", "-"], "use -o FILE"), (["x.ply", "y.off"], "no .off is written; use one of"),
    (["x.ply", "-z"], "unknown option"),
    (["x.ply", "--progress-fd", "no"], "number of a descriptor"),
])
def test_wrong_options_are_refused_with_a_reason(arguments, part):
    run = whittle(*arguments)
    assert run.returncode == 64
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
        told = run.stderr.splitlines()
        assert len(told) == 1 and told[0].startswith(f"whittle: {cloud}: "), (case.name, run.stderr)
        assert not (tmp_path / case.name).exists()


MANY = 2 * 10**9  # points, for which no machine of a test has memory
PROMISES = {
    "ply": b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
           b"property float z\nend_header\n",
    "ascii.ply": b"ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
                 b"end_header\n",
    "pcd": b"# .PCD v0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH %d\nHEIGHT 1\nDATA binary\n",
    "ascii.pcd": b"# .PCD v0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH %d\nHEIGHT 1\nDATA ascii\n",
}


@pytest.mark.parametrize("pack", [bytes, gzip.compress], ids=["plain", "gzip"])
@pytest.mark.parametrize("name", PROMISES)
def test_a_promise_that_the_file_cannot_hold_is_refused_in_one_line(tmp_path, name, pack):
    """Tiles aren't announced for points that can't be there."""
    cloud = tmp_path / f"in.{name}"
    cloud.write_bytes(pack(PROMISES[name] % MANY + 400 * b"0 0 0\n"))
    run = whittle(cloud, "-o", tmp_path / "out", "--memory", "1G")
    assert run.returncode == 65 and run.stderr.startswith(f"whittle: {cloud}: "), run.stderr
    assert run.stderr.count("\n") == 1 and str(MANY) in run.stderr
    assert [p.name for p in tmp_path.iterdir()] == [cloud.name]


def test_a_las_file_that_is_cut_short_takes_no_tiles_for_what_is_not_there(tmp_path):
    cloud = tmp_path / "in.las"
    header = bytearray((FIXTURES / "valid/las-cut-tail/input.las").read_bytes())
    assert header[25] < 4
    header[107:111] = MANY.to_bytes(4, "little")
    cloud.write_bytes(header)
    run = whittle(cloud, "-o", tmp_path / "out", "--ratio", 1)
    assert run.returncode == 0 and "tiles" not in run.stderr + run.stdout, run.stderr
    assert f"the last {MANY - 2} of {MANY} points" in run.stdout


@pytest.mark.parametrize("lines, part", [
    (["0 0 0", "1 1 1", "2 2 2", "3 3 3", "4 4 4"], "one line"),
    (["1 2 3"] * 9, "distinct"),
    (["0 0 0", "1 0 0", "0 1 0"], "4 distinct points"),
])
def test_what_has_no_volume_has_no_mesh_but_a_cloud(tmp_path, lines, part):
    (tmp_path / "in.xyz").write_text("\n".join(lines) + "\n")
    run = whittle(tmp_path / "in.xyz", "--ratio", 1, "--outputs", "mesh", "-o", tmp_path / "out")
    assert run.returncode == 65 and part in run.stderr
    run = whittle(tmp_path / "in.xyz", "--ratio", 1, "-o", tmp_path / "out", "-q")
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("options, kind", [([], "heightfield"), (["--surface", "open"], "heightfield"),
                                           (["--surface", "closed"], None)])
def test_points_on_one_plane_are_a_sheet(tmp_path, options, kind):
    points = "\n".join(f"{i % 15} {i // 15} {2 * (i % 15)}" for i in range(225))
    (tmp_path / "in.xyz").write_text(points + "\n")
    run = whittle(tmp_path / "in.xyz", "--ratio", 0.5, "--outputs", "mesh,report", "-o", tmp_path / "out", *options)
    if kind is None:
        assert run.returncode == 65 and "one plane" in run.stderr
        return
    assert run.returncode == 0, run.stderr
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["surface"]["kind"] == kind and report["surface"]["sure"]
    assert report["mesh"]["area"] == pytest.approx(14 * 14 * 5 ** 0.5, rel=0.02)


def test_what_can_not_be_written_is_an_io_error(scan, tmp_path):
    (tmp_path / "file").write_text("in the way")
    run = whittle(scan[0], "-o", tmp_path / "file")
    assert run.returncode == 73 and "file" in run.stderr


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
    assert run.returncode == 73 and "is the input itself; use -o for another place\n" in run.stderr, run
    assert contents(folder) == before


def test_neither_is_a_mesh_or_standard_input_or_output(folder):
    assert whittle("scan.ply", "--ratio", 1, "--outputs", "mesh", "-q", cwd=folder).returncode == 0
    before = contents(folder)
    run = whittle("mesh.ply", "--outputs", "mesh", "--force", cwd=folder)
    assert run.returncode == 73 and "mesh.ply is the input itself" in run.stderr
    with open(folder / "cloud.ply", "rb") as stream:
        run = whittle("-", "--force", cwd=folder, stdin=stream)
    assert run.returncode == 73 and "cloud.ply is the input itself" in run.stderr
    with open(folder / "cloud.ply", "ab") as stream:
        run = subprocess.run([WHITTLE, "cloud.ply", "-o", "-"], cwd=folder, stdout=stream, stderr=subprocess.PIPE,
                             check=False)
    assert run.returncode == 73 and b"standard output is the input itself" in run.stderr
    assert contents(folder) == before


def test_other_files_are_replaced_only_where_that_was_said(folder):
    before = contents(folder)
    run = whittle("scan.ply", cwd=folder)
    assert run.returncode == 73 and contents(folder) == before
    assert run.stderr == ("whittle: scan.ply: output: cloud.ply is there already; use --force to replace it, "
                          "or -o for another place\n")
    (folder / "broken.ply").symlink_to("nowhere")
    for arguments in (["--force"], ["-o", "."], ["-f"], ["--output", "."]):
        (folder / "cloud.ply").write_bytes(b"old")
        run = whittle("scan.ply", *arguments, cwd=folder)
        assert run.returncode == 0, run.stderr
        assert len(body_of(folder / "cloud.ply", 23)) == 300
        sizes = [f"{(folder / name).stat().st_size / 1024:.1f} KiB" for name in ("cloud.ply", "report.json")]
        assert run.stdout.splitlines()[-2:] == [f"written          cloud.ply, {sizes[0]}", " " * 17 + f"report.json, {sizes[1]}"]
    assert sorted(contents(folder)) == ["cloud.ply", "report.json", "scan.ply"]


def test_a_name_of_a_folder_is_refused_before_the_work(folder):
    (folder / "out" / "cloud.ply").mkdir(parents=True)
    run = whittle("scan.ply", "-o", "out", cwd=folder)
    assert run.returncode == 73 and "out/cloud.ply is a folder" in run.stderr and "\n" == run.stderr[-1]
    assert sorted(p.name for p in (folder / "out").iterdir()) == ["cloud.ply"]


@pytest.mark.parametrize("more", [[], ["--force"]], ids=["", "force"])
def test_a_pipe_is_never_replaced(tmp_path, more):
    (tmp_path / "in.xyz").write_text("0 0 0\n1 0 0\n0 1 0\n0 0 1\n")
    os.mkfifo(tmp_path / "out.ply")
    run = whittle(tmp_path / "in.xyz", tmp_path / "out.ply", "--ratio", 1, *more)
    assert run.returncode == 73 and "out.ply is no regular file; use -o - to write into it" in run.stderr
    assert (tmp_path / "out.ply").is_fifo()


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
    assert run.returncode == 73 and "cloud.ply is there already" in run.stderr
    assert contents(folder) == {"cloud.ply": before["other.ply"], "scan.ply": before["scan.ply"]}
    (folder / "cloud.ply").unlink()
    run = whittle("scan.ply", "--force", cwd=folder, env={**race, "MOVED": "scan.ply"})
    assert run.returncode == 73 and "cloud.ply is the input itself" in run.stderr
    assert contents(folder) == {"cloud.ply": before["scan.ply"]}


def test_file_systems_without_exchange_of_names_keep_and_replace_too(folder, race):
    lacks = {**race, "LACKS": "1"}
    before = contents(folder)
    assert whittle("cloud.ply", "--force", cwd=folder, env=lacks).returncode == 73
    assert whittle("scan.ply", cwd=folder, env=lacks).returncode == 73
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
    assert run.returncode == 73 and "can't write into the folder deep" in run.stderr
    run = whittle("scan.ply", "-o", name, *more, cwd=folder)
    assert run.returncode == 0, run.stderr
    assert re.fullmatch(rf"written          {re.escape(name)}, [\d.]+ (bytes|KiB)", run.stdout.splitlines()[-1]), run.stdout
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
    (["-o", "a.e57"], "no .e57 is written; use one of .ply, .xyz, .pcd, .obj, .stl, .glb, .png, .las, .laz, .3tz, .copc.laz, .json, or "
                      "a folder, which ends in /"),
    (["--output=a.ply.gz"], "--output: no .gz is written")], ids=lambda value: " ".join(value))
def test_what_can_not_be_one_file_is_refused(folder, arguments, part):
    run = whittle("scan.ply", *arguments, cwd=folder)
    assert run.returncode == 64 and part in run.stderr, run.stderr
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
        assert whittle("scan.ply", "-o", name, cwd=folder).returncode == 73
    assert contents(folder) == before


def test_a_second_name_is_the_output(folder):
    assert whittle("scan.ply", "small.ply", "-q", cwd=folder).returncode == 0
    assert whittle("scan.ply", "-o", "other.ply", "-q", cwd=folder).returncode == 0
    small = (folder / "small.ply").read_bytes()
    assert small == (folder / "other.ply").read_bytes() and len(body_of(folder / "small.ply", 23)) == 300
    before = contents(folder)
    run = whittle("scan.ply", "cloud.ply", cwd=folder)  # as `whittle *.ply` would have it
    assert run.returncode == 73 and "cloud.ply is there already; use --force" in run.stderr
    assert whittle("scan.ply", "scan.ply", "--force", cwd=folder).returncode == 73
    assert contents(folder) == before
    assert whittle("scan.ply", "--points=7", "small.ply", "--force", "-q", cwd=folder).returncode == 0
    assert len(body_of(folder / "small.ply", 23)) == 7
    assert whittle("scan.ply", "new/", "-q", cwd=folder).returncode == 0
    assert sorted(p.name for p in (folder / "new").iterdir()) == ["cloud.ply", "report.json"]
    run = subprocess.run([WHITTLE, "scan.ply", "-", "-q"], cwd=folder, capture_output=True, check=True)
    assert run.stdout == small


def test_the_summary_of_levels_is_one_table(folder):
    told = whittle("scan.ply", "-o", "out", "--levels=0.5,0.25,0.1", "--outputs=mesh,report", cwd=folder).stdout.splitlines()
    levels = json.loads((folder / "out/report.json").read_text())["levels"]
    top = told.index(next(line for line in told if line.startswith("ratio ")))
    assert [line.split()[0] for line in told].count("ratio") == 1 and told[top].split()[1:3] == ["points", "triangles"]
    for ratio, level, line in zip(("0.5", "0.25", "0.1"), levels, told[top + 1:], strict=False):
        error = level["error"]["symmetric"]
        assert line.split() == [ratio, str(level["points_out"]), str(level["mesh"]["triangles"]),
                                *(f"{value:.4g}" for value in (error["mean"], error["max"], 1e4 * error["mean_rel"], 1e4 * error["max_rel"])),
                                "watertight"], line
    told = whittle("scan.ply", "-o", "clouds", "--levels=0.5,0.25", cwd=folder).stdout
    assert re.search(r"^levels, distances to planes ", told, re.M) and re.search(r"^0.25 +750 ", told, re.M), told


def test_json_is_the_report_and_verbose_tells_the_stages(folder):
    run = whittle("scan.ply", "small.ply", "--json", cwd=folder)
    report = json.loads(run.stdout)
    assert run.returncode == 0 and report["points_out"] == 300 and report["params"]["ratio"] == 0.1
    assert sorted(contents(folder)) == ["cloud.ply", "scan.ply", "small.ply"]
    plain, more = (whittle("scan.ply", "-o", "out", *flags, cwd=folder).stdout for flags in ([], ["-v"]))
    assert re.search(r"^stages +order +[0-9.]+ ms$", more, re.M) and "contract" in more
    assert "stages" not in plain
    with open("/dev/full", "wb") as full:
        run = subprocess.run([WHITTLE, "scan.ply", "-o", "out", "--json"], cwd=folder, stdout=full,
                             stderr=subprocess.PIPE, check=False)
    assert run.returncode == 74 and b"No space" in run.stderr


# ------------------------------------------------------------------------------------------------ exit statuses

def test_exit_statuses_are_those_of_sysexits(folder):
    (folder / "file").write_text("in the way")
    for arguments, status in ((["--no-such-option"], 64), (["none.ply"], 66), (["scan.ply/none"], 66), (["."], 66),
                              (["file", "-o", "out"], 65), (["scan.ply", "-o", "file"], 73), (["scan.ply", "none/a.ply"], 73),
                              (["scan.ply", "cloud.ply"], 73), (["scan.ply", "--where", "no==1", "-o", "out"], 64),
                              (["measure", "scan.ply"], 64), (["measure", "scan.ply", "none.ply"], 66),
                              (["info"], 64), (["info", "none.ply"], 66), (["info", "file"], 65),
                              (["convert", "scan.ply"], 64), (["convert", "none.ply", "a.ply"], 66),
                              (["convert", "file", "a.ply"], 65), (["convert", "scan.ply", "cloud.ply"], 73)):
        run = whittle(*arguments, cwd=folder)
        assert run.returncode == status, (arguments, run)
        assert run.stderr.startswith("whittle") and run.stdout == ""
    told = whittle("--help").stdout.split("Exit status:")[1].split()
    page = whittle("--man").stdout.split(".SH EXIT STATUS")[1]
    for status in ("64", "65", "66", "70", "71", "73", "74", "75"):
        assert status in told and f".TP\n{status}\n" in page


# ------------------------------------------------------------------------------------------------ convert

def test_convert_keeps_every_point_and_property(folder, scan):
    run = whittle("convert", "scan.ply", "all.ply", cwd=folder)
    assert run.returncode == 0 and run.stderr == "", run.stderr
    assert re.fullmatch(r"points           3000\nwritten          all\.ply, [\d.]+ KiB\n", run.stdout), run.stdout
    assert body_of(folder / "all.ply", 23) == [struct.pack("<Bffdhf", *struct.unpack(">Bffdhf", r)) for r in scan[1]]
    for name in ("a.pcd", "a.xyz", "a.pcd"):
        assert whittle("convert", "scan.ply", name, "--header", "plain", "-f", cwd=folder).returncode == 0
    assert whittle("convert", "a.pcd", "back.xyz", "--header", "plain", cwd=folder).returncode == 0
    straight, back = ((folder / name).read_text().splitlines() for name in ("a.xyz", "back.xyz"))
    assert len(back) == 3001 and sorted(back[0].split()) == sorted(straight[0].split())
    columns = [straight[0].split().index(name) for name in back[0].split()]
    for a, b in zip(straight[1:], back[1:], strict=True):
        assert [float(a.split()[c]) for c in columns] == pytest.approx([float(v) for v in b.split()], rel=1e-6)
    assert whittle("convert", "scan.ply", "part.ply", "--where", "label>=0", "-q", cwd=folder).returncode == 0
    assert len(body_of(folder / "part.ply", 23)) == 1500


def test_convert_keeps_faces_where_the_format_has_them(folder):
    assert whittle("scan.ply", "m.ply", "--outputs", "mesh", "-q", cwd=folder).returncode == 0
    whole = json.loads(whittle("info", "m.ply", "--json", "--quick", cwd=folder).stdout)
    for name in ("m.obj", "m.glb", "n.ply"):
        run = whittle("convert", "m.ply", name, cwd=folder)
        assert run.returncode == 0 and f"mesh             {whole['triangles']} triangles\n" in run.stdout, run
    for name in ("m.obj", "n.ply"):
        seen = json.loads(whittle("info", name, "--json", "--quick", cwd=folder).stdout)
        assert seen["triangles"] == whole["triangles"] and seen["points"] == whole["points"]
    assert [a["name"] for a in seen["attributes"]] == [a["name"] for a in whole["attributes"]]
    run = whittle("convert", "scan.ply", "m.stl", cwd=folder)
    assert run.returncode == 64 and ".stl holds faces, and the input has none; use whittle without convert" in run.stderr
    for more, part in ((["--ratio", "0.5"], "--ratio: all points are converted"), (["--json"], "use whittle info"),
                       (["--memory", "20M"], "--memory: all points are converted at once"),
                       (["--tile-points=9"], "--tile-points: all points are converted at once"),
                       (["--points=5"], "--points: all points")):
        run = whittle("convert", "scan.ply", "c.ply", *more, cwd=folder)
        assert run.returncode == 64 and part in run.stderr, run
    run = whittle("convert", "scan.ply", "c.json", cwd=folder)
    assert run.returncode == 64 and "no cloud and no mesh" in run.stderr
    assert not (folder / "c.ply").exists() and not (folder / "m.stl").exists()
    piped = subprocess.run([WHITTLE, "convert", "scan.ply", "-", "--outputs", "cloud", "-q"], cwd=folder,
                           capture_output=True, check=True).stdout
    assert piped.startswith(b"ply\n") and len(piped) > 3000 * 23


# ------------------------------------------------------------------------------------------------ info

def test_info_tells_what_a_cloud_is(folder, scan):
    found = json.loads(whittle("info", "scan.ply", "--json", cwd=folder).stdout)
    assert found["format"] == "ply/binary_big_endian" and found["points"] == found["points_distinct"] == 3000
    points = [struct.unpack(">Bffdhf", record) for record in scan[1]]
    for axis, member in enumerate((2, 5, 1)):  # x, y, z
        values = [point[member] for point in points]
        assert (found["box"]["min"][axis], found["box"]["max"][axis]) == (min(values), max(values))
    assert [(a["name"], a["type"]) for a in found["attributes"]] == [
        ("red", "uchar"), ("z", "float"), ("x", "float"), ("time", "double"), ("label", "short"), ("y", "float")]
    xyz = [(p[2], p[5], p[1]) for p in points[:40]]
    everyone = [(p[2], p[5], p[1]) for p in points]
    nearest = sorted(min(math.dist(a, b) for b in everyone if b != a) for a in xyz)
    assert nearest[0] <= found["spacing"] <= nearest[-1]
    assert found["noise"] < found["spacing"] / 10 and found["surface"]["kind"] == "closed"
    assert "coordinate_system" not in found and found["triangles"] == 0
    table = whittle("info", "scan.ply", cwd=folder).stdout
    assert "points             3000, 3000 distinct\n" in table and "\nsurface            closed: " in table
    quick = json.loads(whittle("info", "scan.ply", "--json", "--quick", cwd=folder).stdout)
    assert "spacing" not in quick and "surface" not in quick and quick["diagonal"] == found["diagonal"]


def test_a_cloud_without_points_is_told_of_not_measured(tmp_path):
    (tmp_path / "none.ply").write_text("ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n"
                                       "property float z\nend_header\n")
    (tmp_path / "one.xyz").write_text("1 2 3\n")
    told = whittle("info", tmp_path / "none.ply")
    assert told.returncode == 0 and "\npoints             0, 0 distinct\n" in told.stdout and "box" not in told.stdout
    assert json.loads(whittle("info", tmp_path / "none.ply", "--json").stdout)["points"] == 0
    for files in (("none.ply", "one.xyz"), ("one.xyz", "none.ply"), ("none.ply", "none.ply")):
        refused = whittle("measure", *(tmp_path / name for name in files))
        assert refused.returncode == 65 and "none.ply: points: the cloud has no points" in refused.stderr


def test_info_tells_what_keeps_colours(tmp_path):
    names = "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    (tmp_path / "coloured.ply").write_text(f"{head}{names}end_header\n0 0 0 9 9 9\n1 0 0 5 6 7\n")
    (tmp_path / "grey.ply").write_text(f"{head}end_header\n0 0 0\n1 0 0\n")
    told = [whittle("info", tmp_path / f"{name}.ply", "--quick").stdout for name in ("coloured", "grey")]
    assert ["--weights rgb:0.2" in table for table in told] == [True, False]


def test_info_tells_noise_and_kinds_apart(tmp_path):
    chance = random.Random(3)
    with open(tmp_path / "noisy.xyz", "w", encoding="ascii") as out:
        for x, y, z in sphere(4000):
            r = 1 + chance.gauss(0, 0.02)
            out.write(f"{x * r} {y * r} {z * r}\n")
    with open(tmp_path / "hill.xyz", "w", encoding="ascii") as out:
        out.writelines(f"{i % 60} {i // 60} {3 * math.sin(i % 60 / 9)}\n" for i in range(3600))
    noisy = json.loads(whittle("info", tmp_path / "noisy.xyz", "--json").stdout)
    assert 0.01 < noisy["noise"] < 0.04
    assert noisy["noise_rel"] == pytest.approx(noisy["noise"] / noisy["diagonal"])
    assert json.loads(whittle("info", tmp_path / "hill.xyz", "--json").stdout)["surface"]["kind"] == "heightfield"
    (tmp_path / "line.xyz").write_text("".join(f"{i} 0 0\n" for i in range(50)))
    line = json.loads(whittle("info", tmp_path / "line.xyz", "--json").stdout)
    assert line["spacing"] == pytest.approx(1) and "surface" not in line
    with open(tmp_path / "line.xyz", "rb") as stream:
        assert json.loads(whittle("info", "-", "--json", "--quick", stdin=stream).stdout)["points"] == 50


def test_info_tells_of_the_surface_that_a_run_makes(tmp_path):
    """A ball without a small cap: how much of a closed mesh is far from the points depends on how many it is of."""
    chance = random.Random(3)
    with open(tmp_path / "ball.xyz", "w", encoding="ascii") as file:
        for _ in range(6000):
            height, turn = 1 - 1.92 * chance.random(), chance.uniform(0, 2 * math.pi)
            radius = math.sqrt(1 - height * height)
            file.write(f"{radius * math.cos(turn):.5f} {radius * math.sin(turn):.5f} {height:.5f}\n")
    told = json.loads(whittle("info", tmp_path / "ball.xyz", "--json").stdout)["surface"]
    whittle(tmp_path / "ball.xyz", "-o", f"{tmp_path}/out/", "--outputs", "mesh,report")
    made = json.loads((tmp_path / "out/report.json").read_text())["surface"]
    assert "of its area where there are no points" in told["reason"]
    assert {key: made[key] for key in ("kind", "reason", "sure")} == {key: told[key] for key in ("kind", "reason", "sure")}


def las(records):
    """A LAS file of two points with these variable length records: user, id, bytes."""
    body = b"".join(struct.pack("<H16sHH32s", 0, user, number, len(data), b"") + data for user, number, data in records)
    header = bytearray(227)
    header[0:4] = b"LASF"
    header[24:26] = b"\x01\x02"
    struct.pack_into("<HIIBHI", header, 94, 227, 227 + len(body), len(records), 0, 20, 2)
    struct.pack_into("<3d", header, 131, 0.01, 0.01, 0.01)
    points = b"".join(struct.pack("<3i8x", x, 200, 300) for x in (100, 400))
    return bytes(header) + body + points


GEO = struct.pack("<16H", 1, 1, 0, 3, 1024, 0, 1, 1, 3072, 0, 1, 25832, 3076, 0, 1, 9001)


@pytest.mark.parametrize("records, system", [
    ([], None), ([(b"other", 34735, GEO)], None), ([(b"LASF_Projection", 34735, GEO)], "EPSG:25832"),
    ([(b"LASF_Projection", 34735, struct.pack("<8H", 1, 1, 0, 1, 3072, 0, 1, 32767)),
      (b"LASF_Projection", 2112, b'PROJCS["Mine",GEOGCS["WGS 84",AUTHORITY["EPSG","4326"]],AUTHORITY["EPSG","32633"]]')],
     "EPSG:32633"),
    ([(b"LASF_Projection", 2112, b'LOCAL_CS["the quarry"]')], "the quarry"),
    ([(b"LASF_Projection", 2112, b"nothing that is quoted")], None)])
def test_info_tells_the_coordinate_system_of_las(tmp_path, records, system):
    (tmp_path / "a.las").write_bytes(las(records))
    run = whittle("info", tmp_path / "a.las", "--json", "--quick")
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert found["points"] == 2 and found.get("coordinate_system") == system
    assert found["box"] == {"min": [1, 2, 3], "max": [4, 2, 3]}


# ------------------------------------------------------------------------------------------------ a first try

@pytest.mark.parametrize("arguments, said", [
    (("scan.ply", "out.fbx"), "no .fbx is written; use one of .ply, "),
    (("scan.ply", "out.drc"), "no .drc is written; use one of .ply, "),
    (("scan.ply", "out.HDF5"), "no .HDF5 is written; use one of .ply, "),
    (("convert", "scan.ply", "out.ptx"), "no .ptx is written; use one of .ply, "),
    (("scan.ply", "out.ply", "0.1"), "0.1 is a value without its option; use --ratio 0.1"),
    (("scan.ply", "out.ply", "10%"), "10% is a value without its option; use --ratio 0.1"),
    (("scan.ply", "out.ply", "--levels", "0.4", "0.2"), "0.2 is a value without its option; "),
    (("simplify", "scan.ply", "out.ply"), "simplify: no such file and no such command; use whittle INPUT OUTPUT.ply"),
    (("mesure", "scan.ply", "out.ply"), "or info, convert, measure"),
    (("scan.ply", "out.ply", "-r", "0.1"), "-r: unknown option; did you mean '--ratio'?"),
    (("scan.ply", "out.ply", "--voxel-size", "0.1"), "did you mean '--spacing'?"),
    (("scan.ply", "out.ply", "--faces=100"), "did you mean '--points'?"),
    (("scan.ply", "out.ply", "-ratio", "0.1"), "-ratio: unknown option; did you mean '--ratio'?"),
    (("scan.ply", "out.ply", "-j4"), "-j4: unknown option; did you mean '--threads'?"),
    (("scan.ply", "out.ply", "--bbox", "0,0,0,1,1,1"), "did you mean '--crop'?"),
    (("-i", "scan.ply", "-o", "out.ply"), "-i: inputs and outputs have no option of their own; use whittle INPUT OUTPUT"),
    (("convert", "scan.ply", "--to", "las"), "--to: the end of the output's name is its format; use whittle INPUT"),
    (("--completion", "bash"), "--completion: completion comes with the installed programs"),
    (("scan.ply", "out.ply", "--ratio", "10"), "--ratio: '10' is not allowed; it takes a number over 0, at most 1; use %"),
    (("scan.ply", "out.ply", "--ratio", "0,1"), "use a decimal point, as 0.1"),
    (("scan.ply", "out.ply", "--points", "10%"), "use --ratio for a share, as --ratio 10%"),
    (("scan.ply", "out.ply", "--points", "1,000"), "use digits alone, as 10000"),
    (("scan.ply", "out.ply", "--max_deviation", "5mm"), "use a number alone, in the file's units"),
    (("scan.ply", "out/", "--outputs", "cloud,", "mesh"), "--outputs: 'cloud,' is not allowed; use commas without blanks"),
    (("scan.ply", "out.ply", "--crop", "1", "2", "3", "4", "5", "6"), "8 to 40; use commas without blanks"),
    (("scan.ply", "out.ply", "--normals"), "--normals: a value is missing; it takes one of false, true"),
    (("scan.ply", "out.ply", "ratio=0.1"), "ratio=0.1: options begin with two dashes; use --ratio=0.1"),
    (("http://127.0.0.1/scan.ply", "out.ply"), "files are read, no addresses; use curl -sS URL | whittle - OUTPUT.ply"),
])
def test_a_first_try_is_told_what_to_use(folder, arguments, said):
    before = contents(folder)
    run = whittle(*arguments, cwd=folder)
    assert run.returncode == 64 and said in run.stderr, run
    assert contents(folder) == before


def test_what_memory_is_wanted_is_told_in_figures_that_tell_it(folder):
    run = whittle("scan.ply", "out.ply", "--memory", "2M", cwd=folder)
    wanted, allowed = map(float, re.search(r"take ([0-9.]+) MiB, and ([0-9.]+) MiB are allowed", run.stderr).groups())
    assert run.returncode == 71 and allowed == 2 and wanted > 2 and not (folder / "out.ply").exists()


@pytest.mark.parametrize("percent, fraction", [
    (("--ratio", "7%"), ("--ratio", "0.07")), (("--ratio=12.5%",), ("--ratio", "0.125")),
    (("--levels", "40%,20%,0.1"), ("--levels", "0.4,0.2,0.1")),
    (("--max-deviation-rel", "1%"), ("--max-deviation-rel", "0.01"))])
def test_a_share_may_be_in_percent(folder, percent, fraction):
    wrote = []
    for name, arguments in (("percent", percent), ("fraction", fraction)):
        assert whittle("scan.ply", *arguments, "-o", name, "--outputs", "cloud,report", cwd=folder).returncode == 0
        report = json.loads((folder / name / "report.json").read_text())
        wrote.append((report["params"], {path.name: path.read_bytes() for path in (folder / name).glob("*.ply")}))
    assert wrote[0] == wrote[1] and wrote[0][1]


@pytest.mark.parametrize("arguments, said", [
    (("--ratio", "110%"), "--ratio: '110%' is not allowed; it takes a number over 0, at most 1"),
    (("--ratio", "%"), "'%' is not allowed"), (("--ratio", "10%%"), "'10%%'"), (("--ratio", "1e1%"), "'1e1%'"),
    (("--points", "10%"), "--points: '10%' is not allowed"), (("--spacing", "1%"), "--spacing: '1%' is not allowed")])
def test_what_is_no_share_is_told_as_it_was_written(folder, arguments, said):
    run = whittle("scan.ply", "out.ply", *arguments, cwd=folder)
    assert run.returncode == 64 and said in run.stderr, run
    assert not (folder / "out.ply").exists()


@pytest.mark.parametrize("arguments, status, said", [
    ((".", "out.ply"), 66, ". is a folder; use the names of its files"),
    (("scan.ply", "out.ply", "-o", "mesh"), 66, "out.ply isn't there; with -o all names are inputs, use one of both"),
    (("cloud.ply", "scan.ply", "last.ply"), 73, "last.ply is there already, and the last name is the output; use -o")])
def test_names_that_mean_something_else_are_told_what_to_use(folder, arguments, status, said):
    (folder / "last.ply").write_bytes((folder / "scan.ply").read_bytes())
    before = contents(folder)
    run = whittle(*arguments, cwd=folder)
    assert run.returncode == status and said in run.stderr, run
    assert contents(folder) == before


def test_after_two_dashes_all_are_names(folder):
    (folder / "-scan.ply").write_bytes((folder / "scan.ply").read_bytes())
    (folder / "ratio=0.5").write_bytes((folder / "scan.ply").read_bytes())
    assert whittle("--ratio", "0.2", "-q", "--", "-scan.ply", "out.ply", cwd=folder).returncode == 0
    assert whittle("-q", "ratio=0.5", "--", "both.ply", cwd=folder).returncode == 0
    assert whittle("-scan.ply", "out2.ply", cwd=folder).returncode == 64


def test_a_file_may_be_called_as_a_command_is_elsewhere(folder):
    (folder / "simplify").write_bytes((folder / "scan.ply").read_bytes())
    assert whittle("simplify", "scan.ply", "both.ply", cwd=folder).returncode == 0
    assert whittle("simplify", "10", "-o", "one.ply", cwd=folder).returncode == 66  # 10 is a name, too


def test_help_is_a_command(folder):
    assert whittle("help", cwd=folder).stdout == whittle("--help", cwd=folder).stdout
    for command in ("info", "convert", "measure"):
        told = whittle("help", command, cwd=folder)
        assert told.returncode == 0 and told.stdout == whittle(command, "--help", cwd=folder).stdout != ""
    assert whittle("-V", cwd=folder).stdout == whittle("--version", cwd=folder).stdout


# ------------------------------------------------------------------------------------------------ completion

COMPLETION = pathlib.Path(__file__).resolve().parents[2] / "deploy" / "completion"


def complete(folder, *words):
    """What bash offers for the last of these words."""
    script = (f"source {COMPLETION / 'bash' / 'whittle'}; COMP_WORDS=(\"$@\"); COMP_CWORD=$(($# - 1)); _whittle; "
              "printf '%s\\n' \"${COMPREPLY[@]}\"")
    run = subprocess.run(["bash", "-c", script, "bash", os.path.abspath(WHITTLE), *words], cwd=folder,
                         capture_output=True, text=True, check=True)
    assert run.stderr == ""
    return sorted(run.stdout.split())


def test_bash_completes_options_values_commands_and_files(folder):
    assert complete(folder, "c") == ["cloud.ply", "convert"]
    assert complete(folder, "scan.ply", "--max-d") == ["--max-deviation", "--max-deviation-rel"]
    assert complete(folder, "scan.ply", "--refine", "f") == ["flips", "full"]
    assert complete(folder, "scan.ply", "--refine", "=", "n") == ["none"]
    assert complete(folder, "scan.ply", "--pcd_precision", "") == ["double", "float"]
    assert complete(folder, "scan.ply", "--outputs", "cloud,mesh.o") == ["cloud,mesh.obj"]
    assert complete(folder, "scan.ply", "-o", "s") == ["scan.ply"]
    assert complete(folder, "scan.ply", "--ratio", "") == []
    assert complete(folder, "info", "--q") == ["--quick"]
    assert complete(folder, "measure", "a", "b", "--method", "") == ["metro", "uniform"]


def test_the_list_for_completion_has_every_option_of_help():
    listed = {line.split("\t")[0] for line in whittle("--list-options").stdout.splitlines()}
    assert listed == set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", whittle("--help").stdout, re.M))


def fish(folder, typed):
    """What fish offers for the last word of a line, each without its description."""
    script = f"set -x PATH {PROGRAMS} $PATH; source {COMPLETION}/fish/whittle.fish; complete -C $argv[1]"
    run = subprocess.run(["fish", "--no-config", "-c", script, typed], cwd=folder, capture_output=True, text=True,
                         check=True, env={**os.environ, "HOME": str(folder)})
    assert run.stderr == ""
    return sorted(line.split("\t")[0] for line in run.stdout.splitlines())


@pytest.mark.skipif(not shutil.which("fish"), reason="fish isn't there")
def test_fish_completes_options_values_commands_and_files(folder):
    assert fish(folder, "whittle c") == ["cloud.ply", "convert"]
    assert fish(folder, "whittle scan.ply --max-d") == ["--max-deviation", "--max-deviation-rel"]
    assert fish(folder, "whittle scan.ply --refine f") == ["flips", "full"]
    assert fish(folder, "whittle scan.ply --outputs cloud,mesh.o") == ["cloud,mesh.obj"]
    assert fish(folder, "whittle scan.ply -o s") == ["scan.ply"]
    assert fish(folder, "whittle scan.ply --ratio ") == []
    assert fish(folder, "whittle info --q") == ["--quick"]
    assert fish(folder, "whittle measure a b --method ") == ["metro", "uniform"]


def zsh(folder, typed):
    """What zsh makes of the line when Tab and a blank are typed, on a terminal of its own; without blanks at its end."""
    (folder / ".zshrc").write_text(f"""
PS1=
path=({PROGRAMS} $path)
fpath=({COMPLETION}/zsh $fpath)
autoload -U compinit && compinit -u -D
zstyle ':completion:*' list-ambiguous false
say() {{ print -rn -- "<<$BUFFER>>"; exit }}
zle -N say
bindkey '^X' say
print ready
""")
    master, slave = pty.openpty()
    with subprocess.Popen(["zsh", "-i"], cwd=folder, stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
                          env={**os.environ, "HOME": str(folder), "ZDOTDIR": str(folder), "TERM": "dumb"}) as shell:
        os.close(slave)
        said = b""
        try:
            while b"ready" not in said:
                said += os.read(master, 4096)
            os.write(master, typed.encode() + b"\t \x18")
            while b">>" not in said:
                said += os.read(master, 4096)
        finally:
            os.close(master)
            shell.wait(PATIENCE_S)
    return re.search(rb"<<(.*)>>", said)[1].decode().rstrip()


@pytest.mark.skipif(not shutil.which("zsh"), reason="zsh isn't there")
@pytest.mark.parametrize("typed, completed", [
    ("conv", "convert"), ("sc", "scan.ply"), ("scan.ply --max-d", "scan.ply --max-deviation"),
    ("scan.ply --refine fu", "scan.ply --refine full"), ("scan.ply --pcd_precision d", "scan.ply --pcd_precision double"),
    ("scan.ply --outputs cloud,mesh.o", "scan.ply --outputs cloud,mesh.obj"), ("scan.ply -o sc", "scan.ply -o scan.ply"),
    ("info --q", "info --quick"), ("measure a b --method u", "measure a b --method uniform")])
def test_zsh_completes_options_values_commands_and_files(folder, typed, completed):
    assert zsh(folder, "whittle " + typed) == "whittle " + completed


@pytest.mark.parametrize("shell, script", [("zsh", "zsh/_whittle"), ("fish", "fish/whittle.fish")])
def test_other_shells_can_read_theirs(shell, script):
    if not shutil.which(shell):
        pytest.skip(f"{shell} isn't there")
    run = subprocess.run([shell, "-n", COMPLETION / script], capture_output=True, text=True, check=False)
    assert run.returncode == 0 and run.stderr == ""


# ------------------------------------------------------------------------------------------------ dry runs

def test_a_dry_run_tells_and_writes_nothing(folder):
    before = contents(folder)
    run = whittle("scan.ply", "--outputs", "cloud,mesh,report", "--dry-run", "-o", ".", cwd=folder)
    assert run.returncode == 0 and run.stderr == ""
    told = run.stdout.splitlines()
    assert told[0] == "input            ply/binary_big_endian, 3000 points, 0 triangles"
    assert told[1] == "would keep       300 of 3000 points"
    assert re.fullmatch(r" {17}at most [0-9.]+ MiB where points lie along lines", told[3])
    assert told[4] == " " * 17 + "about a second or less"
    assert told[5:] == ["would write      cloud.ply (replaces what is there)", " " * 17 + "mesh.ply",
                        " " * 17 + "report.json"]
    assert contents(folder) == before
    def most(*arguments):
        told = whittle("scan.ply", *arguments, "-n", "-o", "out", cwd=folder).stdout
        return float(re.search(r"^would take +at most ([\d.]+) MiB$", told, re.M)[1])

    assert most("--outputs", "mesh", "--ratio", 1) > most("--outputs", "mesh") > most("--outputs", "cloud") > 1


def test_a_dry_run_as_json(folder):
    run = whittle("scan.ply", "--levels", "0.5,0.25", "--dry-run", "--json", "-o", "out", cwd=folder)
    assert run.returncode == 0 and run.stderr == ""
    told = json.loads(run.stdout)
    assert told["input"] == {"format": "ply/binary_big_endian", "points": 3000, "triangles": 0}
    assert told["points_out"] == [1500, 750] and "out/cloud_0.25.ply" in told["outputs"]
    assert not told["in_tiles"] and told["disk_bytes"] == 0 and told["memory_most_bytes"] == told["memory_bytes"] > 0
    spaced = json.loads(whittle("scan.ply", "--spacing", 0.5, "-n", "--json", "-o", "out", cwd=folder).stdout)
    assert spaced["points_out"] == [None]


def test_a_dry_run_ends_as_the_run_would(folder):
    before = contents(folder)
    assert whittle("scan.ply", "--dry-run", cwd=folder).returncode == 73  # cloud.ply is there
    assert whittle("none.ply", "-n", cwd=folder).returncode == 66
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
