# SPDX-License-Identifier: GPL-3.0-or-later
"""COPC: LAZ whose points are a tree of cubes, and where they are; read here from the bytes, and by another's reader."""
import collections
import json
import pathlib
import shutil
import struct
import subprocess

import pytest

from conftest import BUILD
from test_cli import whittle
from test_laz import make, with_records

NODE = pathlib.Path(__file__).parent.parent / "node"
ROOT_POINTS = 1 << 15  # core/tileset/octree.h

Cube = collections.namedtuple("Cube", "level x y z at bytes points")


def hills(path, side=400):
    """More points than a cube takes, where nothing repeats."""
    rows = (f"{i * .5 + (j * 7 % 11) * .01:.2f} {j * .5:.2f} {((i * i + j * j) % 97) * .03:.2f} {(i + j) % 256} {i % 5 + 1}\n"
            for i in range(side) for j in range(side))
    path.write_text("x y z intensity return_number\n" + "".join(rows))
    return path


def as_text(path):
    """Its points in the order of the file: rows of the columns that the first line names."""
    done = whittle("convert", path, "--outputs", "xyz", "--header", "plain", "-o", "-")
    assert done.returncode == 0, done.stderr
    names, *rows = done.stdout.splitlines()
    return names.split(), [tuple(map(float, row.split())) for row in rows]


def index_of(copc):
    """What the first record says, and the cubes in the order of the file."""
    assert copc[:4] == b"LASF" and copc[24:26] == b"\1\4" and copc[104] & 0x7f in (6, 7, 8) and copc[104] & 0x80
    assert copc[377:381] == b"copc" and struct.unpack_from("<HH", copc, 393) == (1, 160)
    x, y, z, half, spacing, at, length, *times = struct.unpack_from("<5dQQ2d", copc, 429)
    evlr, evlrs = struct.unpack_from("<QI", copc, 235)
    assert (evlr + 60, evlrs) == (at, 1) and at + length == len(copc) and copc[evlr + 2:evlr + 6] == b"copc"
    assert struct.unpack_from("<HQ", copc, evlr + 18) == (1000, length)
    cubes = [Cube(*struct.unpack_from("<4iQii", copc, at + 32 * i)) for i in range(length // 32)]
    assert [c.at for c in cubes] == sorted(c.at for c in cubes)
    return (x, y, z, half, spacing, times), cubes


def check(path):
    """Every point lies in its cube; every cube but the root has the one above it; returns rows by cube."""
    (*centre, half, spacing, times), cubes = index_of(path.read_bytes())
    names, rows = as_text(path)
    assert sum(c.points for c in cubes) == len(rows) and 0 < spacing < 4 * half
    keys = {c[:4] for c in cubes}
    assert len(keys) == len(cubes) and (0, 0, 0, 0) in keys
    by_cube, first = {}, 0
    for cube in cubes:
        assert cube.level == 0 or (cube.level - 1, cube.x >> 1, cube.y >> 1, cube.z >> 1) in keys
        edge = 2 * half / 2 ** cube.level
        own = rows[first:first + cube.points]
        for axis in range(3):
            low = centre[axis] - half + cube[1 + axis] * edge
            assert all(low <= row[axis] <= low + edge for row in own)
        by_cube[cube[:4]] = own
        first += cube.points
    if "gps_time" in names:
        of_time = [row[names.index("gps_time")] for row in rows]
        assert times == [min(of_time), max(of_time)]
    return names, by_cube


def test_each_cube_has_the_most_important_points_that_none_above_has(tmp_path):
    done = whittle(hills(tmp_path / "in.xyz"), "--ratio", 0.9, "--outputs", "copc,cloud", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    _, by_cube = check(tmp_path / "out/cloud.copc.laz")
    _, ranked = as_text(tmp_path / "out/cloud.ply")
    places = [tuple(round(c, 2) for c in row[:3]) for row in ranked]
    root = {tuple(round(c, 2) for c in row[:3]) for row in by_cube[(0, 0, 0, 0)]}
    assert len(by_cube) > 4 and set(places[:ROOT_POINTS]) <= root
    every = sorted(tuple(round(c, 2) for c in row[:3]) for own in by_cube.values() for row in own)
    assert every == sorted(places)


def test_another_format_is_taken_by_names_and_nothing_is_lost(tmp_path):
    """Format 1 of LAS 1.2: angles in degrees become steps of .006, all else keeps its value, and the system its text."""
    las, _ = make(tmp_path, 1, 2, 700, points=3000)
    wkt = b'PROJCS["somewhere"]\0'
    (tmp_path / "in.las").write_bytes(with_records(las.read_bytes(), (b"LASF_Projection", 2112, wkt)))
    done = whittle("convert", tmp_path / "in.las", tmp_path / "out.copc.laz")
    assert done.returncode == 0, done.stderr
    copc = (tmp_path / "out.copc.laz").read_bytes()
    assert copc[104] == 0x86 and wkt in copc and struct.unpack_from("<H", copc, 6)[0] & 0x10
    before, rows = as_text(tmp_path / "in.las")
    after, by_cube = check(tmp_path / "out.copc.laz")
    same = [name for name in before if name != "scan_angle_rank"]
    assert set(same) <= set(after) and "scan_angle" in after and "scan_angle_rank" not in after

    def chosen(row, names, angle, step):
        return tuple(row[names.index(name)] for name in same) + (round(row[names.index(angle)] * step),)
    found = sorted(chosen(row, after, "scan_angle", 0.006) for own in by_cube.values() for row in own)
    assert found == sorted(chosen(row, before, "scan_angle_rank", 1) for row in rows)


def test_any_beginning_of_a_converted_cloud_spreads_over_it(tmp_path):
    done = whittle("convert", hills(tmp_path / "in.xyz"), tmp_path / "out.copc.laz")
    assert done.returncode == 0, done.stderr
    _, by_cube = check(tmp_path / "out.copc.laz")
    root = by_cube[(0, 0, 0, 0)]
    cells = collections.Counter((int(x // 20), int(y // 20)) for x, y, *_ in root)
    assert len(cells) >= 100 and max(cells.values()) < 3 * len(root) / len(cells)


@pytest.mark.parametrize("points", [1, 2, 60000])
def test_the_same_bytes_on_any_threads(tmp_path, points):
    las, _ = make(tmp_path, 7, 0, 0, points=points)
    made = []
    for threads in (1, 2, 5):
        done = whittle(las, "--ratio", 1, "--threads", threads, "-o", tmp_path / f"{threads}.copc.laz")
        assert done.returncode == 0, done.stderr
        made.append((tmp_path / f"{threads}.copc.laz").read_bytes())
    assert made[0] == made[1] == made[2]
    check(tmp_path / "1.copc.laz")


def test_where_one_point_repeats(tmp_path):
    """No cube divides them: the deepest keeps what is left."""
    (tmp_path / "in.xyz").write_text("1 2 3\n" * 70000 + "9 9 9\n")
    done = whittle("convert", tmp_path / "in.xyz", tmp_path / "out.copc.laz")
    assert done.returncode == 0, done.stderr
    _, by_cube = check(tmp_path / "out.copc.laz")
    assert sum(map(len, by_cube.values())) == 70001


def test_levels_files_and_a_pipe(tmp_path):
    las, _ = make(tmp_path, 6, 0, 0, points=2000)
    done = whittle(las, "--levels", "0.5,0.1", "--outputs", "copc", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    for name, points in (("cloud_0.5.copc.laz", 1000), ("cloud_0.1.copc.laz", 200), ("cloud.copc.laz", 1000)):
        assert struct.unpack_from("<Q", (tmp_path / "out" / name).read_bytes(), 247) == (points,)
    piped = subprocess.run([BUILD / "whittle", las, "--outputs", "copc", "-o", "-"], capture_output=True, text=True, check=False)
    assert piped.returncode == 73 and not piped.stdout
    assert piped.stderr.count("\n") == 1 and "use -o NAME.copc.laz" in piped.stderr
    with open(tmp_path / "redirected", "wb") as out:
        assert subprocess.run([BUILD / "whittle", las, "--outputs", "copc", "-q", "-o", "-"], stdout=out, check=False).returncode == 0
    check(tmp_path / "redirected")
    done = whittle(tmp_path / "redirected", "--ratio", 0.5, "-o", tmp_path / "again.COPC.LAZ")
    assert done.returncode == 0 and check(tmp_path / "again.COPC.LAZ"), done.stderr


def test_what_was_in_tiles_ends_as_copc_too(tmp_path):
    scratch = tmp_path / "scratch"
    done = whittle(hills(tmp_path / "in.xyz"), "--ratio", 0.5, "--memory", "400M", "--tile-points", 30000, "--scratch", scratch,
                   "-o", tmp_path / "out.copc.laz")
    assert done.returncode == 0, done.stderr
    _, by_cube = check(tmp_path / "out.copc.laz")
    assert sum(map(len, by_cube.values())) == 80000


def test_a_service_gives_copc(daemon, tmp_path):
    las, _ = make(tmp_path, 1, 0, 0, points=2000)
    job = daemon.ended(daemon.submit(las.read_bytes(), "?ratio=0.5&outputs=copc"))
    assert job["status"] == "successful", job
    reply = daemon.curl(f"/v1/jobs/{job['id']}/outputs/cloud.copc.laz")
    assert reply.headers["content-type"] == daemon.curl(f"/v1/jobs/{job['id']}/outputs").json["outputs"][0]["media_type"]
    (tmp_path / "got.copc.laz").write_bytes(reply.body)
    check(tmp_path / "got.copc.laz")
    part = daemon.curl(f"/v1/jobs/{job['id']}/outputs/cloud.copc.laz", "-H", "Range: bytes=0-588")
    assert part.status == 206 and part.body == reply.body[:589]


def test_another_reader_finds_every_point_in_its_cube(tmp_path):
    if not shutil.which("node") or not (NODE / "node_modules/copc").exists():
        pytest.skip("copc isn't installed: npm ci in tests/node")
    done = whittle("convert", hills(tmp_path / "in.xyz"), tmp_path / "out.copc.laz")
    assert done.returncode == 0, done.stderr
    read = subprocess.run(["node", NODE / "read_copc.mjs", tmp_path / "out.copc.laz"], capture_output=True, text=True, check=False)
    assert read.returncode == 0, read.stderr
    said = json.loads(read.stdout)
    assert (said["points"], said["read"], said["outside"]) == (160000, 160000, 0) and said["cubes"] > 4
    assert said["intensities"] == sum((i + j) % 256 for i in range(400) for j in range(400))
