# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds in tiles: the same bytes whatever happens on the way, within the memory that was given."""
import gzip
import json
import math
import os
import pathlib
import random
import resource
import shutil
import signal
import struct
import subprocess
import time

import pytest

from conftest import BUILD, SANITIZED

WHITTLE = os.path.join(os.environ.get("WHITTLE_BUILD", "build/release"), "whittle")
POINTS, TILE = 60000, 9000


def bumps(path, points, seed=3):
    """A bumpy sheet with an attribute, in float."""
    spread = random.Random(seed)
    body = bytearray()
    for i in range(points):
        x, y = 40 * spread.random(), 40 * spread.random()
        z = math.sin(0.9 * x) * math.cos(0.7 * y) + 0.1 * math.sin(6 * x)
        body += struct.pack("<3fH", x, y, z, i % 65536)
    path.write_bytes((f"ply\nformat binary_little_endian 1.0\nelement vertex {points}\nproperty float x\n"
                      "property float y\nproperty float z\nproperty ushort intensity\nend_header\n").encode() + body)
    return path


def whittle(*arguments, status=0, program=WHITTLE, **options):
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False, **options)
    assert done.returncode == status, done.stderr
    return done


def steps(cloud, folder, out, order=lambda tiles: tiles, threads=2, goal=("--ratio", "0.05"), program=WHITTLE):
    def tiles(*arguments):
        return whittle("tiles", *arguments, "--scratch", folder, program=program).stdout
    tiles("plan", cloud, "--memory", "1G", "--tile-points", TILE, *goal, "--threads", threads)
    for tile in order(tiles("list").split()):
        tiles("run", tile, "--threads", threads)
    assert tiles("list") == ""
    tiles("merge", out, "--threads", threads, "-f")
    return out.read_bytes()


def records(data):
    body = data[data.index(b"end_header\n") + 11:]
    return [body[i:i + 14] for i in range(0, len(body), 14)]


@pytest.fixture(name="cloud", scope="module")
def make_cloud(tmp_path_factory):
    return bumps(tmp_path_factory.mktemp("tiles") / "bumps.ply", POINTS)


def test_only_points_that_are_asked_for(cloud, tmp_path):
    """As if there were no others: the file without them gives the same points, for the same tiles."""
    asked = ("--crop", "0,0,-9,30,30,9", "--where", "intensity>=20000")
    data = cloud.read_bytes()
    start = data.index(b"end_header\n") + 11
    body = [data[i:i + 14] for i in range(start, len(data), 14)]
    some = []
    for record in body:
        x, y, z, intensity = struct.unpack("<3fH", record)
        if 0 <= x <= 30 and 0 <= y <= 30 and -9 <= z <= 9 and intensity >= 20000:
            some.append(record)
    head = data[:start].replace(b"vertex %d" % POINTS, b"vertex %d" % len(some))
    (tmp_path / "some.ply").write_bytes(head + b"".join(some))
    assert 0 < len(some) < POINTS / 2
    goal = ("--ratio", "0.1")
    expected = steps(tmp_path / "some.ply", tmp_path / "one", tmp_path / "one.ply", goal=goal)
    assert steps(cloud, tmp_path / "two", tmp_path / "two.ply", goal=(*goal, *asked)) == expected
    done = whittle("tiles", "plan", cloud, "--scratch", tmp_path / "none", "--memory", "1G", "--where", "colour==1",
                   status=64)
    assert "colour" in done.stderr
    done = whittle("tiles", "plan", cloud, "--scratch", tmp_path / "none", "--memory", "1G", "--where", "intensity<0",
                   status=64)
    assert "no point is left of 60000" in done.stderr


@pytest.fixture(name="expected", scope="module")
def make_expected(cloud, tmp_path_factory):
    folder = tmp_path_factory.mktemp("expected")
    return steps(cloud, folder / "work", folder / "out.ply")


def test_tiles_keep_what_memory_keeps(cloud, expected, tmp_path):
    whittle(cloud, tmp_path / "out.ply", "--ratio", "0.05")
    inside, tiled = records((tmp_path / "out.ply").read_bytes()), records(expected)
    everything = set(records(cloud.read_bytes()))
    assert len(tiled) == len(inside) == POINTS // 20 and everything.issuperset(tiled)
    assert len(set(inside) & set(tiled)) > 0.99 * len(inside)
    first = len(inside) // 10  # the ranking, too: its first points are a coarser cloud
    assert len(set(inside[:first]) & set(tiled[:first])) > 0.95 * first


@pytest.mark.parametrize("points", [2, 3, 20, 100])
def test_a_few_points_around_the_first_come_to_an_end(tmp_path, points):
    """Cells on both sides of the first point stay two, however large they get."""
    spread = random.Random(points)
    others = "".join(f"{spread.uniform(-1, 1)} {spread.uniform(-1, 1)} {spread.uniform(-1, 1)}\n" for _ in range(points - 2))
    (tmp_path / "few.xyz").write_text("0 0 0\n-1 -1 -1\n" + others)
    made = steps(tmp_path / "few.xyz", tmp_path / "work", tmp_path / "out.xyz", goal=("--ratio", "1"))
    assert sum(not line.startswith(b"#") for line in made.splitlines()) == points


@pytest.mark.parametrize("order, threads", [(reversed, 1), (sorted, 1), (list, 2)])
def test_bytes_do_not_depend_on_order_and_threads(cloud, expected, tmp_path, order, threads):
    assert steps(cloud, tmp_path / "work", tmp_path / "out.ply", order, threads) == expected


@pytest.fixture(name="many", scope="module")
def make_many(cloud, tmp_path_factory):
    """More than tiles leave, so that some are told alone."""
    folder = tmp_path_factory.mktemp("many")
    return steps(cloud, folder / "work", folder / "out.ply", threads=1, goal=("--ratio", "0.25"))


def test_many_are_those_that_memory_keeps(cloud, many, tmp_path):
    assert steps(cloud, tmp_path / "again", tmp_path / "out.ply", reversed, goal=("--ratio", "0.25")) == many
    for name, goal in (("all", ("--ratio", "0.25")), ("levels", ("--levels", "0.25,0.02"))):
        (tmp_path / name).mkdir()
        whittle("tiles", "plan", cloud, "--scratch", tmp_path / "work", "--memory", "1G", "--tile-points", TILE, *goal,
                "--normals", "true" if name == "all" else "false")
        for tile in whittle("tiles", "list", "--scratch", tmp_path / "work").stdout.split():
            whittle("tiles", "run", tile, "--scratch", tmp_path / "work")
        whittle("tiles", "merge", f"{tmp_path / name}/", "--scratch", tmp_path / "work", "--outputs", "cloud,report")
        shutil.rmtree(tmp_path / "work")
    (tmp_path / "inside").mkdir()
    whittle(cloud, f"{tmp_path}/inside/", "--ratio", "0.25", "--outputs", "cloud,report")
    inside = records((tmp_path / "inside/cloud.ply").read_bytes())
    assert len(inside) == len(records(many)) and len(set(inside) & set(records(many))) > 0.99 * len(inside)
    assert len(set(inside[:600]) & set(records(many)[:600])) > 0.95 * 600
    assert records((tmp_path / "levels/cloud_0.02.ply").read_bytes()) == records(many)[:POINTS // 50]
    planes = [json.loads((tmp_path / name / "report.json").read_text())["cloud"]["tangent_error"] for name in ("inside", "all")]
    assert planes[1]["samples"] == POINTS and planes[1]["mean"] == pytest.approx(planes[0]["mean"], rel=0.01)


def test_a_coarser_goal_is_a_prefix(cloud, expected, tmp_path):
    whittle("tiles", "plan", cloud, "--scratch", tmp_path / "work", "--memory", "1G", "--tile-points", TILE,
            "--levels", "0.05,0.01")
    for tile in whittle("tiles", "list", "--scratch", tmp_path / "work").stdout.split():
        whittle("tiles", "run", tile, "--scratch", tmp_path / "work")
    (tmp_path / "out").mkdir()
    whittle("tiles", "merge", f"{tmp_path}/out/", "--scratch", tmp_path / "work", "--outputs", "cloud,report")
    assert records((tmp_path / "out/cloud.ply").read_bytes()) == records(expected)
    assert records((tmp_path / "out/cloud_0.01.ply").read_bytes()) == records(expected)[:POINTS // 100]


def kill_while(command, after_s):
    """Whether it was killed: it may have ended before."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        return process.wait(after_s) != 0
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()
        return True


def test_bytes_are_the_same_after_kills(cloud, many, tmp_path):
    seed = int(os.environ.get("SEED", random.randrange(1 << 30)))
    print(f"SEED={seed}")
    when = random.Random(seed)
    work, out = tmp_path / "work", tmp_path / "out.ply"
    plan = [WHITTLE, "tiles", "plan", str(cloud), "--scratch", str(work), "--memory", "1G", "--tile-points", str(TILE),
            "--ratio", "0.25"]
    merge = [WHITTLE, "tiles", "merge", str(out), "--scratch", str(work), "-f"]
    kills = 0
    for _ in range(5):
        kills += kill_while(plan, when.uniform(0, 0.5))
    subprocess.run(plan, check=True, stdout=subprocess.DEVNULL)
    tiles = whittle("tiles", "list", "--scratch", work).stdout.split()
    while kills < 18:
        tile = when.choice(tiles)
        (work / f"left.{tile}").unlink(missing_ok=True)  # so that there is something to be killed at
        kills += kill_while([WHITTLE, "tiles", "run", tile, "--scratch", str(work)], when.uniform(0, 0.05))
    for tile in whittle("tiles", "list", "--scratch", work).stdout.split():
        whittle("tiles", "run", tile, "--scratch", work)
    while kills < 20:
        kills += kill_while(merge, when.uniform(0, 0.02))
    subprocess.run(merge, check=True, stdout=subprocess.DEVNULL)
    assert out.read_bytes() == many


def peak_of(*arguments):
    """Bytes that the command had at most, by a program that is small itself: what a parent holds would count."""
    seconds, bytes_most = 600, 1 << 62
    told = subprocess.run([BUILD / "tests/tools/run_measured", str(seconds), str(bytes_most), WHITTLE, *map(str, arguments)],
                          stdout=subprocess.PIPE, text=True, check=True)
    _, peak, status = told.stdout.split()
    assert status == "0", arguments
    return int(peak)


@pytest.fixture(name="large", scope="module")
def make_large(tmp_path_factory):
    """A cloud that doesn't fit into the memory that is given here."""
    return bumps(tmp_path_factory.mktemp("large") / "large.ply", 700000)


def test_each_task_stays_in_the_memory_of_the_plan(large, tmp_path):
    work, memory = tmp_path / "work", 160 << 20
    peaks = {"plan": peak_of("tiles", "plan", large, "--scratch", work, "--memory", "160M", "--ratio", "0.05")}
    listed = subprocess.run([WHITTLE, "tiles", "list", "--scratch", work], capture_output=True, text=True, check=True)
    tasks = listed.stdout.split()
    for task in tasks:
        peaks[task] = peak_of("tiles", "run", task, "--scratch", work)
    peaks["merge"] = peak_of("tiles", "merge", tmp_path / "out.ply", "--scratch", work)
    print({task: f"{peak >> 20} MiB" for task, peak in peaks.items()})
    assert len(tasks) > 1 and (SANITIZED or max(peaks.values()) < memory), peaks


def test_what_does_not_fit_is_tiled_and_what_fits_is_not(cloud, large, tmp_path):
    whittle(cloud, tmp_path / "a.ply", "--ratio", "0.05")
    fits = whittle(cloud, tmp_path / "b.ply", "--ratio", "0.05", "--memory", "400M")
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes() and "tiles" not in fits.stderr
    dry = whittle(large, tmp_path / "c.ply", "--ratio", "0.05", "--memory", "200M", "-n")
    assert "tiles in" in dry.stderr and not (tmp_path / "c.ply.tiles").exists()
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    done = whittle(large, tmp_path / "c.ply", "--ratio", "0.05", "--memory", "200M")
    after = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    assert "tiles in" in done.stderr and "GiB" in done.stderr
    assert SANITIZED or after == before or after < 200 << 10
    assert len(records((tmp_path / "c.ply").read_bytes())) == 35000
    assert not (tmp_path / "c.ply.tiles").exists()


def places(data):
    return [struct.unpack("<3f", record[:12]) for record in records(data)]


def nearest(points, of, spacing):
    """For each of the points the square of the distance to the nearest other one of `of`, if that is below 2 spacings."""
    cells = {}
    for p in of:
        cells.setdefault(tuple(int(c // (2 * spacing)) for c in p), []).append(p)
    found = []
    for p in points:
        at = [int(c // (2 * spacing)) for c in p]
        near = [q for dx in (-1, 0, 1) for dy in (-1, 0, 1) for dz in (-1, 0, 1)
                for q in cells.get((at[0] + dx, at[1] + dy, at[2] + dz), ()) if q != p]
        found.append(min((math.dist(p, q) for q in near), default=math.inf))
    return found


@pytest.mark.parametrize("spacing", [0.15, 0.6])
def test_no_two_are_nearer_than_the_spacing(cloud, tmp_path, spacing):
    """And no point is farther than that from a kept one, though most of what is kept here had gone from tiles."""
    goal = ("--spacing", spacing)
    tiled = steps(cloud, tmp_path / "work", tmp_path / "out.ply", goal=goal)
    kept = places(tiled)
    assert len(set(kept)) == len(kept) and set(records(cloud.read_bytes())).issuperset(records(tiled))
    assert min(nearest(kept, kept, spacing)) >= spacing
    others = set(places(cloud.read_bytes())) - set(kept)
    assert max(nearest(others, kept, spacing)) < spacing
    whittle(cloud, tmp_path / "inside.ply", *goal)
    inside = records((tmp_path / "inside.ply").read_bytes())
    assert abs(len(inside) - len(kept)) < 0.02 * len(inside)
    first = len(inside) // 10  # those that tiles have left are ranked as in memory
    assert len(set(inside[:first]) & set(records(tiled)[:first])) > 0.95 * first
    assert steps(cloud, tmp_path / "again", tmp_path / "again.ply", reversed, 1, goal=goal) == tiled


def test_a_spacing_beside_a_ratio(cloud, large, tmp_path):
    goal = ("--spacing", 0.4, "--ratio", 0.05)
    tiled = steps(cloud, tmp_path / "work", tmp_path / "out.ply", goal=goal)
    whittle(cloud, tmp_path / "inside.ply", *goal)
    inside = records((tmp_path / "inside.ply").read_bytes())
    assert len(inside) == POINTS // 20 and len(set(inside) & set(records(tiled))) > 0.98 * len(inside)
    done = whittle(large, tmp_path / "some.ply", "--spacing", 0.01, "--memory", "160M", status=71)
    assert "are 0.01 apart" in done.stderr and "wider spacing" in done.stderr


def test_normals_are_those_of_memory(cloud, tmp_path):
    """As they were found among all points, and turned to the same side."""
    tiled = steps(cloud, tmp_path / "work", tmp_path / "out.ply", goal=("--ratio", "0.05", "--normals", "true"))
    whittle(cloud, tmp_path / "inside.ply", "--ratio", "0.05", "--normals", "true")
    inside = (tmp_path / "inside.ply").read_bytes()
    head, body = inside.split(b"end_header\n", 1)
    assert tiled.startswith(head) and head.count(b"float n") == 3
    each = len(body) // (POINTS // 20)
    ours, theirs = ({data[i:i + 14]: struct.unpack("<3f", data[i + each - 12:i + each])
                     for i in range(0, len(data), each)} for data in (tiled[len(head) + 11:], body))
    common = ours.keys() & theirs.keys()
    assert len(common) > 0.99 * len(theirs)
    same = sum(math.dist(ours[p], theirs[p]) < 1e-6 for p in common)
    assert same > 0.99 * len(common) and all(n[2] > 0 for n in ours.values())


def test_a_viewer_turns_normals_of_tiles(cloud, tmp_path):
    tiled = steps(cloud, tmp_path / "work", tmp_path / "out.ply",
                  goal=("--ratio", "0.05", "--normals", "true", "--viewpoint", "20,20,-900"))
    body = tiled[tiled.index(b"end_header\n") + 11:]
    each = len(body) // (POINTS // 20)
    assert all(struct.unpack("<f", body[i + each - 4:i + each])[0] < 0 for i in range(0, len(body), each))


ROOM = (10, 10, 3)
SCANNERS = [(3, 5, 2), (7, 5, 1)]


def points_of_room(scanner, seed, points=30000):
    """Points of walls, floor and ceiling as the scanner saw them."""
    spread = random.Random(seed)
    for _ in range(points):
        place, axis = [spread.uniform(0, wide) for wide in ROOM], spread.randrange(3)
        place[axis] = spread.choice((0, ROOM[axis]))
        yield [p - s for p, s in zip(place, scanner)]


def ptx_of_rooms(path, scans):
    with open(path, "w", encoding="ascii") as file:
        for scanner, seed in scans:
            local = list(points_of_room(scanner, seed))
            file.write(f"{len(local) // 100}\n100\n")
            file.write("{0} {1} {2}\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n{0} {1} {2} 1\n".format(*scanner))
            file.writelines("{:.6f} {:.6f} {:.6f} 0.5\n".format(*p) for p in local)


def crc32c(data, table=[]):  # pylint: disable=dangerous-default-value
    if not table:
        for value in range(256):
            for _ in range(8):
                value = value >> 1 ^ (0x82f63b78 if value & 1 else 0)
            table.append(value)
    remainder = 0xffffffff
    for byte in data:
        remainder = remainder >> 8 ^ table[(remainder ^ byte) & 255]
    return remainder ^ 0xffffffff


def physical(logical):
    """Of each page of 1024 bytes the last four are its checksum."""
    return logical // 1020 * 1024 + logical % 1020


def e57_section(at, local, each=400):
    """A scan's points as packets of x, y and z in double."""
    packets = b""
    for first in range(0, len(local), each):
        some = local[first:first + each]
        body = b"".join(struct.pack(f"<{len(some)}d", *axis) for axis in zip(*some))
        packets += struct.pack("<BBHHHHH", 1, 0, 12 + len(body) - 1, 3, *[8 * len(some)] * 3) + body
    return struct.pack("<B7xQQQ", 1, 32 + len(packets), physical(at + 32), 0) + packets


def e57_of_rooms(path, scans, posed=True):
    """As E57, each scan turned by half a turn about z before its pose, if it has one, turns it back."""
    logical, text = bytearray(48), '<?xml version="1.0"?>\n<e57Root type="Structure" xmlns="e57"><data3D>\n'
    for scanner, seed in scans:
        local = [(-x, -y, z) for x, y, z in points_of_room(scanner, seed)]
        x, y, z = scanner
        pose = ("<pose><rotation><w>0</w><x>0</x><y>0</y><z>1</z></rotation><translation>"
                f"<x>{x}</x><y>{y}</y><z>{z}</z></translation></pose>")
        text += (f"<vectorChild>{pose if posed else ''}<points type=\"CompressedVector\" "
                 f"fileOffset=\"{physical(len(logical))}\" recordCount=\"{len(local)}\"><prototype>"
                 + "".join(f'<cartesian{axis} type="Float"/>' for axis in "XYZ")
                 + "</prototype><codecs/></points></vectorChild>\n")
        logical += e57_section(len(logical), local)
    text = (text + "</data3D></e57Root>").encode()
    xml = len(logical)
    logical += text + bytes(-(len(logical) + len(text)) % 1020)
    logical[:48] = b"ASTM-E57" + struct.pack("<IIQQQQ", 1, 0, physical(len(logical)), physical(xml), len(text), 1024)
    pages = (bytes(logical[i:i + 1020]) for i in range(0, len(logical), 1020))
    path.write_bytes(b"".join(page + struct.pack(">I", crc32c(page)) for page in pages))


def towards_their_scanner(path):
    """How many points there are, and of how many the normal points to where they were scanned from."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    columns = [line.split()[1:] for line in head.decode().splitlines() if line.startswith("property")]
    form = "<" + "".join({"double": "d", "float": "f", "ushort": "H", "uchar": "B"}[kind] for kind, _ in columns)
    points = [dict(zip((name for _, name in columns), record)) for record in struct.iter_unpack(form, body)]
    turned = [sum((SCANNERS[p["scan"]][k] - p["xyz"[k]]) * p["n" + "xyz"[k]] for k in range(3)) > 0 for p in points]
    return len(turned), sum(turned)


@pytest.mark.parametrize("posed", [True, False])
def test_an_e57_tells_a_viewpoint_by_its_pose_alone(tmp_path, posed):
    e57_of_rooms(tmp_path / "room.e57", [(SCANNERS[0], 0)], posed)
    whittle(tmp_path / "room.e57", f"{tmp_path}/out/", "--points", 3000, "--normals", "true", "--outputs", "cloud,report")
    assert (report_of(tmp_path / "out")["normals"]["orientation"] == "viewpoint") == posed


@pytest.mark.parametrize("write", [ptx_of_rooms, e57_of_rooms])
@pytest.mark.parametrize("files", [1, 2])
def test_scanners_turn_normals_of_tiles(tmp_path, files, write):
    """Walls of a room face those who scanned them from inside, whether one file has both scans or each a file."""
    scans, paths = [(scanner, seed) for seed, scanner in enumerate(SCANNERS)], []
    for i in range(files):
        paths.append(tmp_path / f"room{i}")
        write(paths[-1], scans[i::files])
    goal = ("--points", 3000, "--normals", "true", "--outputs", "cloud,report")
    whittle("tiles", "plan", *paths, "--scratch", tmp_path / "work", "--memory", "1G", "--tile-points", TILE, *goal)
    for tile in whittle("tiles", "list", "--scratch", tmp_path / "work").stdout.split():
        whittle("tiles", "run", tile, "--scratch", tmp_path / "work")
    whittle("tiles", "merge", f"{tmp_path}/tiled/", "--scratch", tmp_path / "work")
    whittle(*paths, f"{tmp_path}/inside/", *goal)
    for folder in ("tiled", "inside"):
        assert report_of(tmp_path / folder)["normals"]["orientation"] == "viewpoint"
        assert towards_their_scanner(tmp_path / folder / "cloud.ply") == (3000, 3000)


def report_of(folder):
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def test_a_mesh_is_made_of_as_many_points_as_memory_has_room_for(tmp_path):
    large = bumps(tmp_path / "large.ply", 200000)
    goal = ("--ratio", "0.02", "--outputs", "mesh,cloud,report")
    # By a shell, since Linux counts what the parent holds at the start as the process's own peak.
    told = whittle("-c", '"$0" "$@"; exit $?', WHITTLE, large, *goal, "--memory", "160M", "-o", tmp_path / "tiled",
                   program="sh")
    assert "tiles in" in told.stderr and "most important points" in told.stdout
    assert not (tmp_path / "tiled.tiles").exists()
    whittle(large, *goal, "-o", tmp_path / "inside")
    tiled, inside = report_of(tmp_path / "tiled"), report_of(tmp_path / "inside")
    assert tiled["points_in"] == 200000 and tiled["points_out"] == inside["points_out"] == 4000
    assert tiled["params"] == inside["params"]
    assert SANITIZED or tiled["peak_rss_bytes"] < 160 << 20
    ours, theirs = (subprocess.run([WHITTLE, "measure", tmp_path / folder / "mesh.ply", large, "--json"], check=True,
                                   capture_output=True, text=True).stdout for folder in ("tiled", "inside"))
    ours, theirs = (json.loads(text)["forward"] for text in (ours, theirs))
    assert ours["mean"] < 1.5 * theirs["mean"]  # to all points, of which the mesh has seen a part
    for report, measured in ((tiled, ours), (inside, theirs)):
        assert report["error"]["input_to_mesh"]["samples"] == measured["samples"] == 200000
        assert all(math.isclose(report["error"]["input_to_mesh"][key], measured[key], rel_tol=1e-5)
                   for key in ("mean", "rms", "max"))
    planes = [report["cloud"]["tangent_error"] for report in (tiled, inside)]
    assert planes[0]["samples"] == planes[1]["samples"] == 200000
    assert math.isclose(planes[0]["mean"], planes[1]["mean"], rel_tol=0.1)
    assert tiled["timings_ms"]["measure_all"] > 0 and "measure_all" not in inside["timings_ms"]
    assert "input_to_mesh is of all points" in told.stdout
    done = whittle(large, tmp_path / "fine.glb", "--ratio", "0.5", "--memory", "160M", status=71)
    assert "have room to make one of" in done.stderr


def test_a_dry_run_of_tiles_tells_what_they_take(large, tmp_path):
    told = whittle(large, tmp_path / "out.ply", "--ratio", "0.02", "--memory", "160M", "--dry-run").stdout.splitlines()
    assert told[:3] == ["input            ply/binary_little_endian, 700000 points, 0 triangles",
                        "would keep       14000 of 700000 points", "would take       at most 160.0 MiB"]
    assert told[3].endswith("MiB on the disk, in tiles") and told[5] == f"would write      {tmp_path}/out.ply"
    told = json.loads(whittle(large, tmp_path / "out.ply", "--points", 9, "--memory", "160M", "-n", "--json").stdout)
    assert told["in_tiles"] and told["points_out"] == [9] and told["disk_bytes"] > 700000
    assert told["memory_bytes"] == 160 << 20 and told["seconds"] > 0
    for goal in (("--ratio", "0.5", "--outputs", "mesh"), ("--ratio", "0.9")):
        said = [whittle(large, f"{tmp_path}/out/", *goal, "--memory", "160M", *how, status=71).stderr.splitlines()[-1]
                for how in (["-n"], [])]
        assert said[0] == said[1] and "keep fewer, or allow more memory" in said[0]
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_step_by_step(cloud, tmp_path):
    """Which the plan has to know of."""
    goal = ("--ratio", "0.02", "--outputs", "mesh.obj")
    first = steps(cloud, tmp_path / "work", tmp_path / "one.obj", goal=goal)
    assert steps(cloud, tmp_path / "again", tmp_path / "two.obj", reversed, 1, goal=goal) == first
    assert first.count(b"\nf ") > POINTS // 50
    steps(cloud, tmp_path / "other", tmp_path / "out.ply")
    refused = whittle("tiles", "merge", tmp_path / "mesh.obj", "--scratch", tmp_path / "other", status=64)
    assert "the plan is for a cloud" in refused.stderr


def test_a_cloud_that_is_refused_while_it_is_planned_leaves_no_tiles(tmp_path):
    """That this is a bomb shows only when it is read; a folder that was there stays."""
    bomb = tmp_path / "bomb.gz"
    bomb.write_bytes(gzip.compress(b"0.5 0.25 0.125\n" * 4_000_000))
    for there in (False, True):
        if there:
            (tmp_path / "out.tiles").mkdir()
            (tmp_path / "out.tiles/mine").write_bytes(b"x")
        run = whittle(bomb, tmp_path / "out.ply", "--memory", "256M", status=65)
        assert "tiles in" in run.stderr and "the gzip data becomes more than" in run.stderr
        assert sorted(p.name for p in tmp_path.iterdir()) == ["bomb.gz"] + there * ["out.tiles"]
    assert [p.name for p in (tmp_path / "out.tiles").iterdir()] == ["mine"]


def test_what_tiles_do_not_do_is_refused(large, tmp_path):
    for what, flags in (("denoise", ("--denoise", "full")), ("max_deviation", ("--max-deviation", 0.01)),
                        ("weights", ("--weights", "intensity:1")), ("dso", ("--outputs", "dso")),
                        ("normals with spacing", ("--normals", "true", "--spacing", 1))):
        done = whittle(large, "-o", tmp_path / "out", *flags, "--memory", "160M", status=71)
        assert f"{what} isn't done of a cloud that doesn't fit" in done.stderr
    for name in ("most.ply", "most.copc.laz"):
        done = whittle(large, tmp_path / name, "--ratio", "0.9", "--memory", "160M", status=71)
        assert "are to be kept" in done.stderr and not (tmp_path / name).exists()


def test_a_tile_has_room_for_more_points_than_there_are(cloud, tmp_path):
    done = whittle("tiles", "plan", cloud, "--scratch", tmp_path / "work", "--memory", "1G", "--tile-points", 10 ** 11)
    assert "tiles            1," in done.stdout
    assert whittle("tiles", "list", "--scratch", tmp_path / "work").stdout == "0\n"


def test_points_of_a_tile_are_counted_as_points_are(cloud, tmp_path):
    for i, (written, points) in enumerate((("9k", 9000), ("0.02M", 20000), ("9000", 9000))):
        done = whittle("tiles", "plan", cloud, "--scratch", tmp_path / str(i), "--memory", "1G", "--tile-points", written)
        assert f"of {points} points at most" in done.stdout
    for written in ("0", "9x", "-9k", ""):
        done = whittle("tiles", "plan", cloud, "--scratch", tmp_path / "work", "--tile-points", written, status=64)
        assert "a number of points over 0" in done.stderr


def test_another_run_of_a_folder_is_refused(cloud, tmp_path):
    work = tmp_path / "work"
    same = ["tiles", "plan", cloud, "--scratch", work, "--memory", "1G", "--tile-points", TILE]
    whittle(*same, "--ratio", "0.05")
    assert "ratio differs" in whittle(*same, "--ratio", "0.06", status=64).stderr
    other = bumps(tmp_path / "other.ply", POINTS, seed=4)
    same[2] = other
    assert "input differs" in whittle(*same, "--ratio", "0.05", status=64).stderr
    assert "isn't done yet" in whittle("tiles", "merge", tmp_path / "out.ply", "--scratch", work, status=64).stderr
    assert "tiles 0 to" in whittle("tiles", "run", 99, "--scratch", work, status=64).stderr
    whittle("tiles", "run", "--scratch", work, status=64)
    whittle("tiles", "list", "--scratch", tmp_path / "nowhere", status=74)


def test_a_stop_leaves_what_is_done(large, tmp_path):
    command = [WHITTLE, large, tmp_path / "out.ply", "--ratio", "0.05", "--memory", "200M"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    work = tmp_path / "out.ply.tiles"
    while not (work / "left.0").exists() and process.poll() is None:
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate()
    if process.returncode != 0:  # else it was done before
        assert process.returncode == 75 and "goes on from" in told
        done = (work / "left.0").stat().st_ino
        dump = pathlib.Path(tmp_path / "kept")
        os.link(work / "left.0", dump)
        whittle(*command[1:])
        assert dump.stat().st_ino == done
    assert (tmp_path / "out.ply").exists() and not work.exists()


def damage(path):
    with open(path, "r+b") as file:
        file.seek(path.stat().st_size // 2)
        byte = file.read(1)[0]
        file.seek(-1, os.SEEK_CUR)
        file.write(bytes([byte ^ 1]))


def bare(folder, points):
    """Of the least that a point can have, three floats."""
    data = bumps(folder / "all.ply", points).read_bytes()
    start = data.index(b"end_header\n") + 11
    head = data[:start].replace(b"property ushort intensity\n", b"")
    cloud = folder / "bare.ply"
    cloud.write_bytes(head + b"".join(data[i:i + 12] for i in range(start, len(data), 14)))
    return cloud


ON_A_SMALL_DISK = """
mount -t tmpfs -o size=$SIZE scratch "$WORK" || exit 77
"$WHITTLE" tiles plan "$CLOUD" --scratch "$WORK/s" --memory 1G --tile-points 9000 --ratio 0.25 || exit
for tile in $("$WHITTLE" tiles list --scratch "$WORK/s"); do
    "$WHITTLE" tiles run $tile --scratch "$WORK/s" || exit
done
"$WHITTLE" tiles merge "$OUT" --scratch "$WORK/s"
"""


def test_a_disk_of_twice_the_input_is_enough(tmp_path):
    """At each moment; what is compressed lies there unpacked, too, which is known before."""
    cloud, work, out = bare(tmp_path, 100000), tmp_path / "work", tmp_path / "out.ply"
    work.mkdir()
    (tmp_path / "bare.ply.gz").write_bytes(gzip.compress(cloud.read_bytes(), 1))
    prefix = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"]), "sh", "-c", ON_A_SMALL_DISK]
    done = [subprocess.run(prefix, capture_output=True, text=True, check=False,
                           env={**os.environ, "WHITTLE": os.path.abspath(WHITTLE), "CLOUD": str(path), "WORK": str(work),
                                "OUT": str(out), "SIZE": str(2 * cloud.stat().st_size)})
            for path in (cloud, tmp_path / "bare.ply.gz")]
    if "unshare" in done[0].stderr or done[0].returncode == 77:
        pytest.skip("mounting a file system of one's own isn't allowed here")
    assert done[0].returncode == 0, done[0].stderr
    assert b"vertex 25000\n" in out.read_bytes()
    assert done[1].returncode == 74 and "2 MiB free, and tiles take 4 MiB" in done[1].stderr, done[1].stderr


@pytest.mark.parametrize("ratio", ["0.02", "0.1", "0.25"])
def test_scratch_files_are_no_more_than_twice_the_input(tmp_path, ratio):
    """Much more could be left where the memory alone bounds it.  Of what is kept more than there is room for, the more
    important ones are."""
    points, work = 100000, tmp_path / "work"
    cloud = bare(tmp_path, points)
    whittle("tiles", "plan", cloud, "--scratch", work, "--memory", "1G", "--tile-points", TILE, "--ratio", ratio)
    assert sum(f.stat().st_size for f in work.iterdir()) < 1.7 * cloud.stat().st_size
    for tile in whittle("tiles", "list", "--scratch", work).stdout.split():
        whittle("tiles", "run", tile, "--scratch", work)
    assert sum(f.stat().st_size for f in work.iterdir()) < 2 * cloud.stat().st_size
    whittle("tiles", "merge", tmp_path / "out.ply", "--scratch", work)
    assert b"vertex %d\n" % (float(ratio) * points) in (tmp_path / "out.ply").read_bytes()


def test_what_is_damaged_on_the_disk_is_made_again(large, tmp_path):
    """While it is stopped a bit of some points changes, and one of what a tile has left."""
    work = tmp_path / "out.ply.tiles"
    command = [large, tmp_path / "out.ply", "--ratio", "0.05", "--memory", "200M"]
    whittle(large, tmp_path / "whole.ply", *command[2:])
    process = subprocess.Popen([WHITTLE, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not (work / "left.0").exists() and process.poll() is None:
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode == 75, "it was done before"
    damage(work / "left.0")
    damage(max(work.glob("points.*"), key=lambda path: int(path.suffix[1:])))
    told = whittle(*command).stderr
    assert "left.0 wasn't what was written" in told and told.count("wasn't what was written") == 2
    assert (tmp_path / "out.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes() and not work.exists()


@pytest.mark.parametrize("suffix", ["las", "laz", "xyz", "ply", "pcd"])
def test_formats_keep_their_attributes(cloud, tmp_path, suffix):
    whole, some = tmp_path / f"all.{suffix}", tmp_path / f"some.{suffix}"
    whittle("convert", cloud, whole, "--header", "plain")
    steps(whole, tmp_path / "work", some, goal=("--points", "500"))
    whittle("convert", whole, tmp_path / "whole.xyz", "-f")
    whittle("convert", some, tmp_path / "kept.xyz", "-f")
    kept = (tmp_path / "kept.xyz").read_text(encoding="ascii").splitlines()
    assert len(kept) == 500
    assert set((tmp_path / "whole.xyz").read_text(encoding="ascii").splitlines()).issuperset(kept)


def scanned(path, cloud, places):
    """The cloud as scans from several places, of columns without a return here and there, as PTX."""
    points = [record[:12] for record in records(cloud.read_bytes())]
    each = len(points) // len(places)
    with open(path, "w", encoding="ascii") as file:
        for s, (x0, y0, z0) in enumerate(places):
            some = [struct.unpack("<3f", p) for p in points[s * each:(s + 1) * each]]
            file.write(f"{each // 100}\n101\n{x0} {y0} {z0}\n1 0 0\n0 1 0\n0 0 1\n"
                       f"1 0 0 0\n0 1 0 0\n0 0 1 0\n{x0} {y0} {z0} 1\n")
            for i, (x, y, z) in enumerate(some):
                file.write(f"{x - x0:.6f} {y - y0:.6f} {z - z0:.6f} 0.5\n")
                if i % 100 == 99:
                    file.write("0 0 0 0\n")
    return path


def test_scans_of_ptx_are_read_part_by_part(cloud, tmp_path):
    """Each by its pose, without what didn't return: the points that memory keeps, and their scans."""
    scans = scanned(tmp_path / "scans.ptx", cloud, [(0, 0, 50), (40, 40, 60), (20, 0, 55)])
    steps(scans, tmp_path / "work", tmp_path / "out.ply", goal=("--points", "500"))
    whittle(scans, tmp_path / "inside.ply", "--points", "500")
    tiled, inside = ((tmp_path / name).read_bytes() for name in ("out.ply", "inside.ply"))
    head = inside.index(b"end_header\n") + 11
    assert tiled[:head] == inside[:head] and b"scan" in inside[:head]
    each = (len(inside) - head) // 500
    ours, theirs = ({data[i:i + each] for i in range(head, len(data), each)} for data in (tiled, inside))
    assert len(ours) == 500 and len(ours & theirs) > 480
    torn = tmp_path / "torn.ptx"
    torn.write_bytes(scans.read_bytes()[:-3000])
    done = whittle("tiles", "plan", torn, "--scratch", tmp_path / "none", "--memory", "1G", status=65)
    assert "the file ends after" in done.stderr


def caught_while_reading(command, path, deed):
    """What became of a command that was still reading the file when this was done to it."""
    content = path.read_bytes()
    for _ in range(50):
        process = subprocess.Popen(list(map(str, command)), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        maps, reads = pathlib.Path(f"/proc/{process.pid}/maps"), False
        while process.poll() is None and not reads:
            reads = str(path) in maps.read_text(encoding="ascii")
        if reads:
            process.send_signal(signal.SIGSTOP)
            deed()
            process.send_signal(signal.SIGCONT)
        _, told = process.communicate()
        if process.returncode:
            return process.returncode, told
        path.unlink(missing_ok=True)
        path.write_bytes(content)
        shutil.rmtree(command[command.index("--scratch") + 1])
    raise AssertionError("it was never caught reading")


def mapped(process, path):
    """Whether the process has the file mapped."""
    return str(path) in pathlib.Path(f"/proc/{process.pid}/maps").read_text(encoding="ascii")


@pytest.mark.parametrize("command", ["tiles", "convert"])
def test_a_file_that_is_cut_short_under_a_mapping_is_named(tmp_path, command):
    """Of two inputs the one that it was, whose pages the process asks for when they have gone."""
    whole, cut = bumps(tmp_path / "whole.ply", 1000), tmp_path / "cut here.ply"
    bumps(cut, 400000)
    content, told = cut.read_bytes(), ""
    for attempt in range(60):
        folder = ("tiles", "plan", whole, cut, "--scratch", tmp_path / f"work{attempt}", "--memory", "1G", "--points", "9")
        arguments = folder if command == "tiles" else ("convert", cut, tmp_path / "out.xyz", "-f")
        process = subprocess.Popen([WHITTLE, *map(str, arguments)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                                   text=True)
        while process.poll() is None and not mapped(process, cut):
            pass
        os.truncate(cut, 4096)
        _, told = process.communicate()
        if process.returncode == 74 and "its disk failed" in told:
            break
        cut.write_bytes(content)
    assert f"whittle: {cut} was cut short, or its disk failed, while it was read" in told, told


def test_an_input_that_changes_while_it_is_read_is_told(tmp_path):
    """One that is cut short under a mapping ends a process by a signal, unless that is told."""
    large, other = bumps(tmp_path / "large.ply", 300000), bumps(tmp_path / "other.ply", 300000, seed=4)
    command = [WHITTLE, "tiles", "plan", large, "--scratch", tmp_path / "work", "--memory", "1G", "--points", "100"]
    status, told = caught_while_reading(command, large, lambda: os.truncate(large, 5000))
    assert status in (74, 65) and ("cut short" in told or "changed" in told or "points are promised" in told), told
    shutil.copy(other, tmp_path / "next.ply")
    bumps(large, 300000)
    shutil.rmtree(tmp_path / "work")
    status, told = caught_while_reading(command, large, lambda: os.replace(tmp_path / "next.ply", large))
    assert status in (64, 74) and ("isn't what it was" in told or "has changed while" in told), told
    assert not (tmp_path / "work" / "plan").exists()


@pytest.mark.parametrize("compress", [gzip.compress, None])
def test_what_is_compressed_is_read_from_the_disk(cloud, expected, tmp_path, compress):
    """It shows by what it becomes that it doesn't fit, and the kept points are the same."""
    packed = tmp_path / "bumps.packed"
    if compress:
        packed.write_bytes(compress(cloud.read_bytes()))
    elif not shutil.which("zstd"):
        pytest.skip("zstd isn't installed")
    else:
        subprocess.run(["zstd", "-q", cloud, "-o", packed], check=True)
    work = tmp_path / "work"
    assert steps(packed, work, tmp_path / "out.ply") == expected
    assert not list(work.glob(".input*"))
    (tmp_path / "torn").write_bytes(packed.read_bytes()[:-2000])
    done = whittle("tiles", "plan", tmp_path / "torn", "--scratch", tmp_path / "none", "--memory", "1G", status=65)
    assert "ends" in done.stderr or "checksum" in done.stderr
    large = bumps(tmp_path / "large.ply", 500000)
    (tmp_path / "large.ply.gz").write_bytes(gzip.compress(large.read_bytes(), 1))
    goal = ("--points", 5000, "--memory", "160M")
    for name in ("large.ply", "large.ply.gz"):
        done = whittle(tmp_path / name, tmp_path / f"{name}.out.ply", *goal)
        assert "tiles in" in done.stderr
    assert (tmp_path / "large.ply.out.ply").read_bytes() == (tmp_path / "large.ply.gz.out.ply").read_bytes()


def test_several_inputs_are_one_cloud(tmp_path):
    parts = [bumps(tmp_path / f"part{i}.ply", 30000, seed=i) for i in range(2)]
    work, out = tmp_path / "work", tmp_path / "out.ply"
    whittle("tiles", "plan", *parts, "--scratch", work, "--memory", "1G", "--tile-points", TILE, "--points", 1000)
    for tile in whittle("tiles", "list", "--scratch", work).stdout.split():
        whittle("tiles", "run", tile, "--scratch", work)
    whittle("tiles", "merge", out, "--scratch", work)
    whittle(*parts, tmp_path / "inside.ply", "--points", 1000)
    inside, tiled = (set(records((tmp_path / name).read_bytes())) for name in ("inside.ply", "out.ply"))
    assert len(tiled) == 1000 and len(inside & tiled) > 980
    assert "is the input" in whittle("tiles", "merge", parts[1], "--scratch", work, "-f", status=73).stderr
    two = (tmp_path / "two.ply", tmp_path / "report.json")
    assert "one OUTPUT" in whittle("tiles", "merge", *two, "--scratch", work, status=64).stderr
    assert not any(path.exists() for path in two)


def test_what_is_wrong_with_any_of_the_inputs_is_told(tmp_path):
    """What shows at the end of a file alone, of the first and of those that follow."""
    parts = [bumps(tmp_path / f"part{i}.ply", 30000, seed=i) for i in range(2)]
    whole = [tmp_path / f"part{i}.las" for i in range(2)]
    for part, las in zip(parts, whole):
        whittle("convert", part, las, "--crop", "0,0,-9,30,30,9")
    with open(parts[0], "ab") as more:
        more.write(b"not counted")
    with open(whole[1], "ab") as las:
        las.truncate(whole[1].stat().st_size - 100)
    for inputs, told in ((parts, "bytes behind all that the header counts: 11"), (whole, "the file is cut short")):
        work, report = tmp_path / f"{inputs[0].suffix}.work", tmp_path / "report.json"
        whittle("tiles", "plan", *inputs, "--scratch", work, "--memory", "1G", "--tile-points", TILE, "--points", 100)
        for tile in whittle("tiles", "list", "--scratch", work).stdout.split():
            whittle("tiles", "run", tile, "--scratch", work)
        whittle("tiles", "merge", report, "--scratch", work, "-f")
        notes = [note["what"] for note in json.loads(report.read_text())["left_out"] if note["file"] == "input"]
        assert any(told in note for note in notes), notes
        if inputs is parts:
            whittle(*inputs, report, "--points", 100, "-f")
            assert notes == [n["what"] for n in json.loads(report.read_text())["left_out"] if n["file"] == "input"]


DEPLOY = pathlib.Path(__file__).resolve().parents[2] / "deploy"


def test_make_runs_tiles_beside_each_other(cloud, expected, tmp_path):
    command = ["make", "-f", DEPLOY / "tiles.mk", "-j2", f"IN={cloud}", f"OUT={tmp_path}/out.ply", "MEMORY=1G",
               f"WHITTLE={os.path.abspath(WHITTLE)}", f"PARAMETERS=--ratio 0.05 --tile-points {TILE}"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE") and name != "MFLAGS"}
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
    assert (tmp_path / "out.ply").read_bytes() == expected
    (tmp_path / "out.ply").unlink()
    (tmp_path / "out.ply.tiles/left.3").unlink()
    told = subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout
    assert told.count("tiles run") == 1 and (tmp_path / "out.ply").read_bytes() == expected


SBATCH = """#!/bin/sh
# Runs what slurm would: an array's tasks one after the other, last first.
array=
while [ "${1#--}" != "$1" ]; do
    case $1 in --array=*) array=${1#--array=} ;; esac
    shift
done
for task in $(echo "${array:-0}" | tr ',' '\\n' | tac); do
    SLURM_ARRAY_TASK_ID=$task sh "$@" >&2 || exit 1
done
echo 17
"""


def test_an_array_job_runs_tiles_in_any_order(cloud, expected, tmp_path):
    (tmp_path / "sbatch").write_text(SBATCH, encoding="ascii")
    (tmp_path / "sbatch").chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "WHITTLE": os.path.abspath(WHITTLE),
                   "MEMORY": "1G"}
    subprocess.run(["sh", DEPLOY / "tiles.slurm", cloud, tmp_path / "out.ply", "--ratio", "0.05", "--tile-points",
                    str(TILE)], check=True, env=environment, stdout=subprocess.DEVNULL)
    assert (tmp_path / "out.ply").read_bytes() == expected


REAL = pathlib.Path(__file__).resolve().parents[2].parent / "shared/data/laz/autzen_trim.laz"


@pytest.mark.skipif(not REAL.exists(), reason="../shared/data/laz/autzen_trim.laz isn't there")
def test_a_survey_in_tiles_is_what_memory_makes_of_it(tmp_path):
    tiled = steps(REAL, tmp_path / "work", tmp_path / "tiled.laz")
    whittle(REAL, tmp_path / "inside.laz", "--ratio", "0.05")
    assert tiled == (tmp_path / "inside.laz").read_bytes()
