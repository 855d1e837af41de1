# SPDX-License-Identifier: GPL-3.0-or-later
"""Refinement of surfaces with borders, from a file of points to a mesh: terrain whose true heights are known."""
import collections
import json
import math
import pathlib
import random
import re
import subprocess
import sys

import pytest

from conftest import BUILD, sphere

PEERS = pathlib.Path(__file__).resolve().parents[1] / "peers"
sys.path.insert(0, str(PEERS))
import borders  # noqa: E402  pylint: disable=wrong-import-position
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "bench"))
import odd_shapes  # noqa: E402  pylint: disable=wrong-import-position

SIDE = 90


def height(x, y):
    return 0.1 * math.sin(7 * x) * math.cos(5 * y) + 0.03 * math.sin(23 * x * y)


@pytest.fixture(name="terrain", scope="module")
def make_terrain(tmp_path_factory):
    """Points of a terrain, somewhat off a grid, with a lake amid it."""
    chance = random.Random(7)
    path = tmp_path_factory.mktemp("terrain") / "terrain.xyz"
    with open(path, "w", encoding="ascii") as file:
        for i in range(SIDE * SIDE):
            x, y = ((k + chance.uniform(-0.3, 0.3)) / SIDE for k in (i % SIDE, i // SIDE))
            if math.hypot(x - 0.6, y - 0.4) > 0.12:
                file.write(f"{x:.6f} {y:.6f} {height(x, y):.6f}\n")
    return path


def meshed(terrain, folder, **parameters):
    """(points of the mesh, its triangles, report)."""
    options = [word for name, value in parameters.items() for word in (f"--{name}", str(value))]
    subprocess.run([BUILD / "whittle", terrain, "-q", "--outputs", "mesh,report", "-o", folder, *options], check=True)
    points, corners = borders.points_of(folder / "mesh.ply")
    return points, list(zip(*[iter(corners)] * 3)), json.loads((folder / "report.json").read_text())


def check_sheet(points, triangles, upwards):
    """Each edge once in each direction, one border around the sheet and one around the lake, no vertex in two fans."""
    edges = collections.Counter((t[k], t[(k + 1) % 3]) for t in triangles for k in range(3))
    assert max(edges.values()) == 1
    out = collections.Counter(a for a, b in edges if (b, a) not in edges)
    assert max(out.values()) == 1
    loops = borders.loops_of([v for t in triangles for v in t])
    assert sorted(len(loop) > 0 for loop in loops) == [True, True]
    for a, b, c in triangles if upwards else ():
        (ax, ay, _), (bx, by, _), (cx, cy, _) = points[a], points[b], points[c]
        assert (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0


@pytest.mark.parametrize("surface", ["open", "heightfield"])
def test_sheets_are_nearer_when_reconstructed_first(terrain, tmp_path, surface):
    """Unrefined, where the order is all that differs; auto is reconstruct-first for sheets."""
    made = {order: meshed(terrain, tmp_path / order, surface=surface, ratio=0.06, refine="none", order=order)[2]
            for order in ("simplify-first", "reconstruct-first", "auto")}
    simple, first, auto = made.values()
    kept = simple["mesh"]["vertices"]
    assert simple["mesh"]["reconstructed_from"] == kept and first["mesh"]["reconstructed_from"] > 1.5 * kept
    assert abs(first["mesh"]["vertices"] - kept) < 0.02 * kept
    assert first["error"]["input_to_mesh"]["mean"] < 0.9 * simple["error"]["input_to_mesh"]["mean"]
    assert auto["mesh"] == first["mesh"] and auto["error"] == first["error"]


@pytest.mark.parametrize("ratio", [0.3, 0.1])
@pytest.mark.parametrize("noise", [0.005, 0.01])
def test_free_vertices_are_never_farther_from_noisy_points(tmp_path, noise, ratio):
    """Points of a curved wall, a fifth of them far off it: one that stays at a point has that point for nothing."""
    chance = random.Random(5)
    with open(tmp_path / "wall.xyz", "w", encoding="ascii") as file:
        for _ in range(5000):
            x, y = chance.random(), 0.6 * chance.random()
            z = 0.05 * math.sin(6 * x) + chance.gauss(0, noise) * (1 if chance.random() < 0.8 else 4)
            file.write(f"{x:.6f} {y:.6f} {z:.6f}\n")
    told = {placement: meshed(tmp_path / "wall.xyz", tmp_path / placement, surface="open", ratio=ratio, denoise="none",
                              placement=placement)[2] for placement in ("subset", "optimal")}
    there, both = ({placement: report["error"][form]["mean"] for placement, report in told.items()}
                   for form in ("input_to_mesh", "symmetric"))
    assert there["optimal"] <= there["subset"] and both["optimal"] < 1.06 * both["subset"]
    stayed = [note for note in told["optimal"]["left_out"] if note["what"].startswith("note: placement=optimal")]
    assert len(stayed) == (told["optimal"]["mesh"] == told["subset"]["mesh"])


@pytest.mark.parametrize("surface", ["open", "heightfield"])
@pytest.mark.parametrize("placement", ["subset", "optimal"])
def test_refinement_halves_the_error_and_keeps_the_sheet(terrain, tmp_path, surface, placement):
    made = {form: meshed(terrain, tmp_path / form, surface=surface, placement=placement, ratio=0.06, refine=form,
                         order="simplify-first") for form in ("none", "full")}
    before, after = (made[form][2]["error"]["input_to_mesh"]["mean"] for form in ("none", "full"))
    assert after < 0.5 * before
    check_sheet(*made["full"][:2], surface == "heightfield")
    near = 2 / SIDE
    for x, y, z in made["full"][0]:
        assert -near < x < 1 + near and -near < y < 1 + near
        assert math.hypot(x - 0.6, y - 0.4) > 0.12 - near
        assert abs(z - height(x, y)) < 0.02


def test_threads_change_nothing(terrain, tmp_path):
    for threads in (1, 3):
        meshed(terrain, tmp_path / str(threads), surface="open", ratio=0.06, threads=threads)
    assert (tmp_path / "1/mesh.ply").read_bytes() == (tmp_path / "3/mesh.ply").read_bytes()


SLOT = (0.457, 0.533)  # in x, nine spacings wide; the boards meet below it


@pytest.fixture(name="boards", scope="module")
def make_boards(tmp_path_factory):
    """Points of two bent boards with a slot between them."""
    chance, count = random.Random(5), 120
    path = tmp_path_factory.mktemp("boards") / "boards.xyz"
    with open(path, "w", encoding="ascii") as file:
        for i in range(count * count):
            x, y = ((k + chance.uniform(-0.2, 0.2)) / count for k in (i % count, i // count))
            if not (SLOT[0] < x < SLOT[1] and y > 0.2):
                file.write(f"{x:.6f} {y:.6f} {0.15 * math.sin(5 * x + 3 * y):.6f}\n")
    return path


@pytest.mark.parametrize("placement", ["subset", "optimal"])
@pytest.mark.parametrize("order", ["simplify-first", "reconstruct-first"])
def test_a_slot_has_no_rungs(boards, tmp_path, placement, order):
    """Nothing runs across it, though no place in it is three spacings from the points; and nothing else opens."""
    points, triangles, _ = meshed(boards, tmp_path, surface="open", ratio=0.1, placement=placement, order=order)
    across = [t for t in triangles if min(points[v][0] for v in t) < SLOT[0] + 0.01
              and max(points[v][0] for v in t) > SLOT[1] - 0.01 and min(points[v][1] for v in t) > 0.26]
    assert not across
    assert len(borders.loops_of([v for t in triangles for v in t])) <= 2  # a tiny hole beside the outer border


ROOM, EYE, RINGS = (12.0, 8.0, 3.0), (5.0, 3.0, 1.2), 16


@pytest.fixture(name="rotating", scope="module")
def make_rotating(tmp_path_factory):
    """What a scanner with 16 beams sees of a room: lines 18 times as far apart as the points along them."""
    path = tmp_path_factory.mktemp("rotating") / "room.ply"
    with open(path, "wb") as file:
        points = odd_shapes.rotating_lidar(20000, RINGS)
        file.write(f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty double x\nproperty double y\n"
                   "property double z\nend_header\n".encode())
        file.writelines(f"{x:.6f} {y:.6f} {z:.6f}\n".encode() for x, y, z in points)
    return path


def test_lines_of_a_rotating_scanner_become_one_room(rotating, tmp_path):
    points, triangles, report = meshed(rotating, tmp_path / "out", ratio=0.1, placement="subset")
    assert report["surface"]["kind"] == "open"
    area = cut_corners = 0
    for a, b, c in triangles:
        u, v = ([points[k][i] - points[a][i] for i in range(3)] for k in (b, c))
        size = math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]) / 2
        middle = [(points[a][i] + points[b][i] + points[c][i]) / 3 for i in range(3)]
        off = min(min(abs(middle[i]), abs(middle[i] - ROOM[i])) for i in range(3))
        area += size
        cut_corners += size * (off > 0.1)
    assert 170 < area < 205  # of floor, ceiling and walls what the beams come to is 189
    assert cut_corners < 0.1 * area
    assert report["mesh"]["components"] <= 3


CHEST = ((2.0, 1.5, 0.0), (3.0, 2.2, 0.9))
STATIONS = ((1.2, 1.0, 1.6), (3.9, 3.1, 1.5))


def range_in_a_room(eye, ray):
    """How far it is to the walls of a room of 5 by 4 by 2.7 m, or to the chest in it."""
    nearest = min(((size if d > 0 else 0) - e) / d for e, d, size in zip(eye, ray, (5, 4, 2.7)))
    sides = [sorted(((low - e) / d, (high - e) / d)) for e, d, low, high in zip(eye, ray, *CHEST)]
    enter, leave = max(first for first, _ in sides), min(last for _, last in sides)
    return min(nearest, enter) if 0 < enter < leave else nearest


@pytest.fixture(name="scanned_room", scope="module")
def make_scanned_room(tmp_path_factory):
    """All of a room by two terrestrial scanners, column after column: hardly a hole, so like a solid's skin."""
    chance = random.Random(3)
    path = tmp_path_factory.mktemp("room") / "room.xyz"
    with open(path, "w", encoding="ascii") as file:
        for eye in STATIONS:
            for k in range(170 * 80):
                turn, rise = 2 * math.pi * (k // 80 + 0.5) / 170, math.radians(-88 + 177 * (k % 80) / 80)
                ray = (math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), math.sin(rise))
                along = range_in_a_room(eye, ray) + chance.gauss(0, 0.001)
                file.write("{:.5f} {:.5f} {:.5f}\n".format(*(e + along * d for e, d in zip(eye, ray))))
    return path


def area_and_away(points, triangles, eyes):
    """Areas, doubled: of all triangles, and of those that none of the eyes is in front of."""
    area = away = 0
    for a, b, c in triangles:
        u, v = ([points[k][i] - points[a][i] for i in range(3)] for k in (b, c))
        normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        area += math.hypot(*normal)
        if all(sum(n * (e - p) for n, e, p in zip(normal, eye, points[a])) < 0 for eye in eyes):
            away += math.hypot(*normal)
    return area, away


def test_a_room_faces_those_who_scanned_it(scanned_room, tmp_path):
    points, triangles, report = meshed(scanned_room, tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and report["surface"]["orientation"] == "scan pattern"
    area, away = area_and_away(points, triangles, STATIONS)
    assert away < 0.03 * area


def meets_lamp(eye, ray):
    """How far it is to a ball that hangs in that room; None beside it."""
    off = [e - c for e, c in zip(eye, (3.4, 1.8, 1.9))]
    along = sum(o * d for o, d in zip(off, ray))
    under = along * along - sum(o * o for o in off) + 0.6 * 0.6
    return -along - math.sqrt(under) if under > 0 and along < 0 else None


def is_doorway(point):
    return point[0] < 0.05 and 1 < point[1] < 2.2 and point[2] < 2.4


@pytest.fixture(name="fused_room", scope="module", params=["no door", "an open door"])
def make_fused_room(request, tmp_path_factory):
    """The same room with a lamp, by four scanners, one point of each cell of 4 cm, in no order; and one with an open door,
    which alone would be little enough for the bottom of a statue."""
    chance = random.Random(4)
    path, cells = tmp_path_factory.mktemp("fused") / "room.xyz", {}
    for eye in (*STATIONS, (4.2, 0.7, 1.4), (0.8, 3.4, 1.7)):
        for k in range(220 * 110):
            turn, rise = 2 * math.pi * (k // 110 + 0.5) / 220, math.radians(-88 + 177 * (k % 110) / 110)
            ray = (math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), math.sin(rise))
            along = min(range_in_a_room(eye, ray), meets_lamp(eye, ray) or 9) + chance.gauss(0, 0.001)
            point = [e + along * d for e, d in zip(eye, ray)]
            if request.param == "no door" or not is_doorway(point):
                cells[tuple(math.floor(x / 0.04) for x in point)] = point
    points = list(cells.values())
    chance.shuffle(points)
    path.write_text("".join("{:.5f} {:.5f} {:.5f}\n".format(*p) for p in points), encoding="ascii")
    return path


def test_a_room_in_no_order_faces_its_inside(fused_room, tmp_path):
    points, triangles, report = meshed(fused_room, tmp_path / "out", ratio=0.2)
    assert report["surface"]["kind"] == "open" and report["surface"]["orientation"] == "inwards"
    assert not report["surface"]["sure"]
    area, away = area_and_away(points, triangles, STATIONS)
    assert away < 0.03 * area


BALLS = ((0, 0, 0.5, 0.5), (0.45, 0, 0.85, 0.28), (-0.4, 0.1, 0.8, 0.2), (0.7, 0.1, 1.1, 0.18), (-0.3, -0.5, 0.25, 0.2))


def range_to_balls(eye, ray, plate):
    """How far it is to one of the balls, or to the square plate that they stand on; None beside them."""
    ranges = []
    if plate and ray[2] < 0 and max(abs(e - eye[2] / ray[2] * d) for e, d in zip(eye[:2], ray[:2])) < 0.8:
        ranges.append(-eye[2] / ray[2])
    for *centre, radius in BALLS:
        off = [e - c for e, c in zip(eye, centre)]
        along = sum(o * d for o, d in zip(off, ray))
        under = along * along - sum(o * o for o in off) + radius * radius
        if under > 0:
            ranges.append(-along - math.sqrt(under))
    return min(ranges, default=None)


def write_range_maps(path, heights, plate):
    """Row after row of a picture of the balls from places around them, each so high; returns those places."""
    chance, eyes = random.Random(5), []
    with open(path, "w", encoding="ascii") as file:
        for k, height_of_eye in enumerate(heights):
            turn = 2 * math.pi * k / len(heights)
            eye = (2.5 * math.cos(turn), 2.5 * math.sin(turn), height_of_eye)
            eyes.append(eye)
            level = math.hypot(2.5, eye[2] - 0.6)
            fore = (-2.5 * math.cos(turn) / level, -2.5 * math.sin(turn) / level, (0.6 - eye[2]) / level)
            side = (math.sin(turn), -math.cos(turn), 0)
            up = [fore[1] * side[2] - fore[2] * side[1], fore[2] * side[0] - fore[0] * side[2],
                  fore[0] * side[1] - fore[1] * side[0]]
            for pixel in range(90 * 90):
                x, y = ((pixel % 90) / 45 - 1) * 0.4, ((pixel // 90) / 45 - 1) * 0.4
                ray = [f + x * s + y * u for f, s, u in zip(fore, side, up)]
                ray = [d / math.hypot(*ray) for d in ray]
                along = range_to_balls(eye, ray, plate)
                if along:
                    along += chance.gauss(0, 0.001)
                    file.write("{:.5f} {:.5f} {:.5f}\n".format(*(e + along * d for e, d in zip(eye, ray))))
    return eyes


@pytest.fixture(name="range_maps", scope="module")
def make_range_maps(tmp_path_factory):
    """Of balls on a plate, and the places that they were made from."""
    path = tmp_path_factory.mktemp("balls") / "balls.xyz"
    return path, write_range_maps(path, [1.0 + 0.4 * (k % 3) for k in range(5)], True)


def test_what_the_order_tells_of_parts_is_not_lost_in_the_whole(range_maps, tmp_path):
    path, eyes = range_maps
    points, triangles, report = meshed(path, tmp_path / "out", ratio=0.1)
    assert report["surface"]["orientation"] == "scan pattern"
    area, away = area_and_away(points, triangles, eyes)
    assert away < 0.03 * area


def test_a_bottom_that_no_scanner_saw_gets_no_lid(tmp_path):
    """Its rim was seen from the side, so points there are as far apart as a lid would be from them."""
    eyes = write_range_maps(tmp_path / "balls.xyz", [2.0] * 8, False)
    points, triangles, report = meshed(tmp_path / "balls.xyz", tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and report["surface"]["orientation"] == "scan pattern"
    area, away = area_and_away(points, triangles, eyes)
    assert away < 0.02 * area


def test_a_bottom_that_is_missing_in_no_order_gets_no_lid(tmp_path):
    """Nothing tells of the scanners, but a closed mesh of which side is outside."""
    eyes = write_range_maps(tmp_path / "balls.xyz", [2.0] * 8, False)
    lines = (tmp_path / "balls.xyz").read_text().splitlines(True)
    random.Random(7).shuffle(lines)
    (tmp_path / "balls.xyz").write_text("".join(lines))
    points, triangles, report = meshed(tmp_path / "balls.xyz", tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and report["surface"]["orientation"] == "outwards"
    area, away = area_and_away(points, triangles, eyes)
    assert away < 0.02 * area


def write_figure(folder, seed, points):
    """A figure by merged range maps, without its bottom and in no order; skips without scipy."""
    pytest.importorskip("scipy", reason="python3-scipy isn't installed: make deps")
    cloud = folder / "figure.ply"
    options = ["--points", str(points), "--shuffled"]
    subprocess.run(["/usr/bin/python3", PEERS / "scenes.py", "figure", str(seed), cloud, *options], check=True)
    return cloud


def test_a_figure_without_a_bottom_is_not_turned_in_parts(tmp_path):
    """Much of its inside is seen through the bottom, as a room's walls are, and isn't in front for that."""
    cloud = write_figure(tmp_path, seed=2, points=60000)
    points, triangles, report = meshed(cloud, tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and report["surface"]["orientation"] == "outwards"
    up = down = 0
    for a, b, c in triangles:
        area = ((points[b][0] - points[a][0]) * (points[c][1] - points[a][1])
                - (points[b][1] - points[a][1]) * (points[c][0] - points[a][0]))
        up, down = up + max(area, 0), down + max(-area, 0)
    assert up > 2 * down


def test_a_lid_is_left_before_more_points_bring_a_closed_mesh_nearer(tmp_path):
    """Twice the kept points, which creases ask for, tell nothing of a bottom that no scanner saw."""
    cloud = write_figure(tmp_path, seed=1, points=40000)
    _, _, report = meshed(cloud, tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and report["surface"]["orientation"] == "outwards"


def write_room_in_no_order(path, seed, points):
    pytest.importorskip("scipy", reason="python3-scipy isn't installed: make deps")
    subprocess.run(["/usr/bin/python3", PEERS / "scenes.py", "room-scanners", str(seed), path, "--points", str(points),
                    "--shuffled"], check=True)


def test_a_room_is_of_more_points_though_a_closed_mesh_came_first(tmp_path):
    """The closed mesh was of more points for its thin walls, which tells nothing of the one that takes its place."""
    write_room_in_no_order(tmp_path / "room.ply", 6, 20000)
    _, _, found = meshed(tmp_path / "room.ply", tmp_path / "auto", ratio=0.2)
    _, _, asked = meshed(tmp_path / "room.ply", tmp_path / "open", ratio=0.2, surface="open")
    assert found["surface"]["kind"] == "open" and found["surface"]["orientation"] == "inwards"
    assert found["mesh"]["reconstructed_from"] == asked["mesh"]["reconstructed_from"] > 2.2 * found["points_out"]


def test_a_room_with_a_lid_does_not_face_outwards(tmp_path):
    """Its closed mesh has the room's inside as its own, so its outside tells nothing, and cuts nothing."""
    write_room_in_no_order(tmp_path / "room.ply", 11, 60000)
    _, _, report = meshed(tmp_path / "room.ply", tmp_path / "out", ratio=0.05)
    assert report["surface"]["kind"] == "open" and report["surface"]["orientation"] == "inwards"
    assert report["mesh"]["components"] < 8


def depth_to_city(eye, ray, houses):
    """How far along the ray the ground or a house is."""
    nearest = -eye[2] / ray[2]
    for low, high in houses:
        enters, leaves = 0, nearest
        for e, d, a, b in zip(eye, ray, low, high):
            near, far = sorted(((a - e) / d, (b - e) / d))
            enters, leaves = max(enters, near), min(leaves, far)
        if enters < leaves:
            nearest = enters
    return nearest


def test_walls_of_a_city_are_no_height_field(tmp_path):
    """Two strips from 80 m above, along the middles of both halves; walls have as many points as roofs."""
    chance = random.Random(5)
    houses = [((x, y, -1), (x + 8, y + 8, chance.uniform(10, 45))) for x in range(3, 92, 15) for y in range(3, 92, 15)]
    with open(tmp_path / "city.xyz", "w", encoding="ascii") as file:
        for i in range(45000):
            eye = (100 * (i // 100) / 450 + chance.uniform(0, 0.2), 25 + 50 * (i % 2), 80)
            across = math.radians(-36 + 72 * (i % 100) / 100 + chance.uniform(0, 0.5))
            ray = (chance.gauss(0, 0.002), math.sin(across), -math.cos(across))
            along = depth_to_city(eye, ray, houses) + chance.gauss(0, 0.03)
            file.write("{:.3f} {:.3f} {:.3f}\n".format(*(e + along * d for e, d in zip(eye, ray))))
    points, triangles, report = meshed(tmp_path / "city.xyz", tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and "walls" in report["surface"]["reason"]
    assert report["error"]["input_to_mesh"]["mean_rel"] < 5e-4
    up, down = 0, 0
    for corners in triangles:
        (ax, ay, _), (bx, by, _), (cx, cy, _) = (points[v] for v in corners)
        turn = ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)) / 2
        up, down = up + max(turn, 0), down + max(-turn, 0)
    assert up > 0.85 * 100 * 100 and down < 0.08 * 100 * 100


def write_town(path, points, walls, leaves, trees):
    """Shares of the points are on walls and in the crowns of trees, all others on the ground and on roofs."""
    chance = random.Random(1)
    houses = [(*(chance.uniform(0, 75) for _ in range(2)), *(chance.uniform(9, 18) for _ in range(2)),
               chance.uniform(8, 22)) for _ in range(14)]
    crowns = [(chance.uniform(0, 90), chance.uniform(0, 90), chance.uniform(2, 4)) for _ in range(trees)]
    with open(path, "w", encoding="ascii") as file:
        for _ in range(points):
            x, y, on = chance.uniform(0, 90), chance.uniform(0, 90), chance.random()
            left, front, wide, deep, high = chance.choice(houses)
            if on < walls:
                side, along, z = chance.randrange(4), chance.random(), chance.uniform(0, high)
                x = left + wide * (along if side < 2 else side - 2)
                y = front + deep * (side if side < 2 else along)
            elif on < walls + leaves:
                x, y, r = chance.choice(crowns)
                x, y, z = chance.gauss(x, r / 2), chance.gauss(y, r / 2), chance.uniform(1, 2.5 * r + 3)
            else:
                z = max((h for a, b, w, d, h in houses if 0 < x - a < w and 0 < y - b < d), default=0)
                z += chance.gauss(0, 0.03)
            file.write(f"{x:.3f} {y:.3f} {z:.3f}\n")


@pytest.mark.parametrize("town, kept, most", [((13000, 0.2, 0.2, 40), 200, 5e-3), ((8000, 0, 0.2, 150), 120, 9e-3)])
def test_of_few_points_what_is_seen_from_above_is_a_field(tmp_path, town, kept, most):
    """A closed mesh, or a sheet with borders, is nearer at first or said to be, but there is nothing to fit it to."""
    write_town(tmp_path / "town.xyz", *town)
    _, _, report = meshed(tmp_path / "town.xyz", tmp_path / "out", points=kept)
    assert report["surface"]["kind"] == "heightfield"
    assert report["error"]["input_to_mesh"]["mean_rel"] < most


def test_two_flights_over_a_town_are_no_thin_walls(tmp_path):
    """Their strips are apart by a fifth of a per cent, so that most places have two heights, as thin solids have; a
    closed mesh has lids between them, and what tells is what it looks like from above."""
    chance, lines = random.Random(8), []
    for _ in range(15000):
        x, y = chance.uniform(0, 100), chance.uniform(0, 100)
        on_roof = x % 25 > 12 and y % 25 > 12
        z = (8 + 4 * (x // 25) + 2 * (y // 25) if on_roof else 0) + chance.gauss(0, 0.02)
        lines += [(x, y, z), (x + 0.09, y + 0.12, z + 0.26)]
    with open(tmp_path / "flights.xyz", "w", encoding="ascii") as file:
        file.writelines("{:.3f} {:.3f} {:.3f}\n".format(*p) for p in lines)
    _, _, report = meshed(tmp_path / "flights.xyz", tmp_path / "out", ratio=0.1)
    surface = report["surface"]
    assert surface["kind"] == "open" and surface["reason"].startswith("seen along (0.00, 0.00, 1.00)"), surface


@pytest.mark.parametrize("denoise", ["noisy", "auto"])
def test_what_is_seen_of_walls_from_above_is_kept(tmp_path, denoise):
    """Blocks on the ground from high above: roofs and ground are dense, and each wall has a few points at random."""
    chance, lines = random.Random(8), []
    for i in range(20000):
        x, y = chance.uniform(0, 100), chance.uniform(0, 100)
        on_roof = x % 25 > 12 and y % 25 > 12
        lines.append((x, y, (8 + 4 * (x // 25) + 2 * (y // 25) if on_roof else 0) + chance.gauss(0, 0.02)))
    walls = []
    for block in range(16):
        x, y, top = 25 * (block % 4), 25 * (block // 4), 8 + 4 * (block % 4) + 2 * (block // 4)
        walls += [(x + 12 + chance.gauss(0, 0.02), y + chance.uniform(12.5, 24.5), chance.uniform(1, top - 1))
                  for _ in range(20)]
    with open(tmp_path / "blocks.xyz", "w", encoding="ascii") as file:
        file.writelines("{:.3f} {:.3f} {:.3f}\n".format(*p) for p in lines + walls)
    _, _, report = meshed(tmp_path / "blocks.xyz", tmp_path / "out", ratio=0.1, denoise=denoise)
    assert report["surface"]["kind"] == "heightfield"
    assert report["input"]["points_outliers"] == 0, report["input"]


@pytest.mark.parametrize("doubles", [0, 4000])
def test_a_less_exact_scan_beside_another_goes_by_default(tmp_path, doubles):
    """A ball, without strays, of which a third was scanned again, a spacing off."""
    lines, chance = sphere(12000).decode().splitlines(), random.Random(6)
    points = [tuple(map(float, line.split())) for line in lines]
    again = [tuple(c * (1 + chance.gauss(0, 0.02)) for c in p) for p in chance.sample(points, doubles)]
    with open(tmp_path / "ball.xyz", "w", encoding="ascii") as file:
        file.writelines("{:.6f} {:.6f} {:.6f}\n".format(*p) for p in points + again)
    points, _, report = meshed(tmp_path / "ball.xyz", tmp_path / "out", ratio=0.1)
    assert report.get("denoised") == ("layers" if doubles else None)
    assert 0.6 * doubles <= report["input"]["points_outliers"] <= doubles
    assert all(abs(math.hypot(*p) - 1) < 0.02 for p in points)


@pytest.mark.parametrize("strays", [0, 1000])
@pytest.mark.parametrize("denoise", ["noisy", "full"])
def test_of_two_scans_that_do_not_fit_the_first_stays(tmp_path, strays, denoise):
    """A ball and the same again, half a spacing and more aside, one after the other as merged files have them."""
    chance = random.Random(8)
    first = [tuple(map(float, line.split())) for line in sphere(10000).decode().splitlines()]
    second = [(x + 0.01, y - 0.01, z + 0.015) for x, y, z in first]
    around = [tuple(chance.uniform(-1, 1) for _ in range(3)) for _ in range(strays)]
    with open(tmp_path / "twice.xyz", "w", encoding="ascii") as file:
        file.writelines("{:.6f} {:.6f} {:.6f}\n".format(*p) for p in first + second + around)
    points, _, report = meshed(tmp_path / "twice.xyz", tmp_path / "out", ratio=0.1, denoise=denoise)
    assert report["input"]["points_outliers"] > 9900 + 0.9 * strays
    notes = [note["what"] for note in report["left_out"] if "a scan that doesn't fit" in note["what"]]
    assert len(notes) == 1, report["left_out"]
    assert re.match(r"note: from about point 100\d\d on all lie 0\.02\d* beside .* keeps them$", notes[0]), notes
    off = [p for p in points if abs(math.hypot(*p) - 1) > 0.005]
    assert len(off) <= 0.01 * strays, off  # strays beside the surface


def test_two_scans_stay_where_nothing_is_to_be_dropped(tmp_path):
    first = [tuple(map(float, line.split())) for line in sphere(10000).decode().splitlines()]
    second = [(x + 0.01, y - 0.01, z + 0.015) for x, y, z in first]
    with open(tmp_path / "twice.xyz", "w", encoding="ascii") as file:
        file.writelines("{:.6f} {:.6f} {:.6f}\n".format(*p) for p in first + second)
    _, _, report = meshed(tmp_path / "twice.xyz", tmp_path / "out", ratio=0.1, denoise="none")
    assert report["input"]["points_outliers"] == 0
    assert not any("a scan that doesn't fit" in note["what"] for note in report["left_out"])


def depth_of_shelves(ray):
    """From the origin along (x, y, 1): balls before a wall that is slanted away; as depth."""
    x, y = ray
    depth = 4 / (1 - 0.9 * x)
    for bx, by, bz, radius in ((-0.6, -0.3, 2.0, 0.35), (0.3, 0.2, 2.4, 0.5), (0.9, -0.5, 3.0, 0.3)):
        a, b, c = x * x + y * y + 1, x * bx + y * by + bz, bx * bx + by * by + bz * bz - radius * radius
        if b * b > a * c:
            depth = min(depth, (b - math.sqrt(b * b - a * c)) / a)
    return depth


def write_depth_image(path, noise, shuffled=False, wrong=0.0, share=1.0):
    chance, rows, columns = random.Random(11), 120, 160
    lines = []
    for i in range(rows * columns):
        ray = (1.2 * (i % columns) / columns - 0.6, 0.9 * (i // columns) / rows - 0.45)
        depth = depth_of_shelves(ray)
        depth += noise * depth * depth * chance.gauss(0, 1)
        if wrong and chance.random() < wrong:
            depth = chance.uniform(0.8, 1.2)
        lines.append("{:.4f} {:.4f} {:.4f}\n".format(ray[0] * depth, ray[1] * depth, depth))
    if shuffled:
        chance.shuffle(lines)
    path.write_text("".join(lines[:int(share * len(lines))]), encoding="ascii")


@pytest.mark.parametrize("known_by", ["viewpoint", "order", "lattice", "half", "quarter"])
def test_what_one_camera_saw_faces_it(tmp_path, known_by):
    """A depth image whose noise is larger than its points are apart, so that a sheet through them all crumples; half:
    or a quarter of its points at random."""
    shuffled = known_by in ("lattice", "half", "quarter")
    write_depth_image(tmp_path / "depth.xyz", 0.004, shuffled, share={"half": 0.5, "quarter": 0.25}.get(known_by, 1))
    viewpoint = {"viewpoint": "0,0,0"} if known_by == "viewpoint" else {}
    for placement in ("subset", "optimal"):
        points, triangles, report = meshed(tmp_path / "depth.xyz", tmp_path / placement, ratio=0.1, surface="open",
                                           placement=placement, **viewpoint)
        area, away = area_and_away(points, triangles, [(0, 0, 0)] * len(points))
        assert away < (0.01 if shuffled else 0.001) * area, (away, area)
        assert report["mesh"]["reconstruction"] == "delaunay-of-view", report["mesh"]
        assert report["error"]["input_to_mesh"]["mean"] < 0.03


@pytest.mark.parametrize("part", ["all", "northern", "region", "region.pcd", "southern"])
@pytest.mark.parametrize("shuffled", [False, True])
def test_a_globe_faces_outwards(tmp_path, part, shuffled):
    """Meridians and parallels are as even from its middle as the rays of a scanner there would be."""
    wide, south, north, high = {"all": (360, -75, 75, 0.02), "northern": (360, 0, 75, 0.02),
                                "southern": (40, -65, -45, 0.001)}.get(part, (160, -30, 30, 0.02))
    lines = []
    for i in range(100 * 160):
        turn, lift = math.radians(wide * (i % 160) / 160), math.radians(south + (north - south) * (i // 160) / 99)
        r = 1 + high * math.sin(9 * turn) * math.cos(14 * lift)
        lines.append(f"{r * math.cos(lift) * math.cos(turn):.6f} {r * math.cos(lift) * math.sin(turn):.6f} "
                     f"{r * math.sin(lift):.6f}\n")
    if shuffled:
        random.Random(1).shuffle(lines)
    cloud = tmp_path / "globe.xyz"
    cloud.write_text("".join(lines), encoding="ascii")
    if part.endswith(".pcd"):
        cloud = tmp_path / "globe.pcd"
        subprocess.run([BUILD / "whittle", "convert", tmp_path / "globe.xyz", cloud, "-q"], check=True)
    points, triangles, report = meshed(cloud, tmp_path / "out", ratio=0.1)
    area, inwards = area_and_away([(0, 0, 0)] + points, [[v + 1 for v in t] for t in triangles], [(0, 0, 0)])
    assert inwards > 0.99 * area, (inwards, area, report["surface"])
    assert report["mesh"]["components"] == 1, report["mesh"]


@pytest.mark.parametrize("placement", ["subset", "optimal"])
def test_steps_of_a_depth_image_stay(tmp_path, placement):
    """Disparities are whole numbers of pixels, so that depths are steps: of fewer points than all that one place has
    seen triangles lie across them."""
    lines = []
    for i in range(160 * 120):
        ray = (1.2 * (i % 160) / 160 - 0.6, 0.9 * (i // 160) / 120 - 0.45)
        depth = 120 / round(120 / depth_of_shelves(ray))
        lines.append(f"{ray[0] * depth:.5f} {ray[1] * depth:.5f} {depth:.5f}\n")
    (tmp_path / "steps.xyz").write_text("".join(lines), encoding="ascii")
    _, _, report = meshed(tmp_path / "steps.xyz", tmp_path / "out", ratio=0.1, viewpoint="0,0,0", placement=placement)
    assert report["mesh"]["reconstruction"] == "delaunay-of-view", report["mesh"]
    assert report["mesh"]["reconstructed_from"] > 0.99 * 160 * 120, report["mesh"]
    assert report["error"]["input_to_mesh"]["mean_rel"] < 3e-5, report["error"]["input_to_mesh"]


@pytest.mark.parametrize("scan", ["steps", "terrain"])
def test_vertices_are_freed_by_the_points_alone(tmp_path, scan):
    """Where middles of triangles between steps, or between heights that are whole numbers, lead free vertices astray."""
    lines = []
    for i in range(160 * 120):
        x, y = i % 160 / 160, i // 160 / 120
        depth = depth_of_shelves((1.2 * x - 0.6, 0.9 * y - 0.45))
        depth = 120 / round(120 / depth)
        lines.append(f"{(1.2 * x - 0.6) * depth:.5f} {(0.9 * y - 0.45) * depth:.5f} {depth:.5f}\n" if scan == "steps"
                     else f"{160 * x:.0f} {120 * y:.0f} {round(60 * height(x, y))}\n")
    (tmp_path / "scan.xyz").write_text("".join(lines), encoding="ascii")
    where = {"steps": {"viewpoint": "0,0,0"}, "terrain": {"surface": "heightfield"}}[scan]
    means = {}
    for placement in ("subset", "optimal"):
        _, _, report = meshed(tmp_path / "scan.xyz", tmp_path / placement, ratio=0.1, placement=placement, **where)
        means[placement] = report["error"]["input_to_mesh"]["mean"]
    assert means["optimal"] < 0.95 * means["subset"], means


@pytest.mark.parametrize("seed", [1, 2])
def test_strays_of_few_points_go_and_no_more(tmp_path, seed):
    """A room whose points are few for what is in it: hardly a stray can be far from them, and all but its walls lie off
    their neighbours' planes, as doubles do."""
    pytest.importorskip("scipy", reason="python3-scipy isn't installed: make deps")
    scene, text, cloud = tmp_path / "room.ply", tmp_path / "room.xyz", tmp_path / "cloud.xyz"
    subprocess.run(["/usr/bin/python3", PEERS / "scenes.py", "room-rgbd", str(seed), scene, "--points", "4000", "--shuffled"],
                   check=True)
    subprocess.run([BUILD / "whittle", "convert", scene, text, "-q"], check=True)
    lines = [line for line in text.read_text(encoding="ascii").splitlines() if line[0] in "-.0123456789"]
    points, chance = [[float(word) for word in line.split()[:3]] for line in lines], random.Random(seed)
    ends = [(min(values), max(values)) for values in zip(*points)]
    points += [[chance.uniform(low, high) for low, high in ends] for _ in range(40)]
    cloud.write_text("".join(f"{x:.4f} {y:.4f} {z:.4f}\n" for x, y, z in points), encoding="ascii")
    _, _, report = meshed(cloud, tmp_path / "out", ratio=0.3)
    assert 30 <= report["input"]["points_outliers"] <= 80, report["input"]


@pytest.mark.parametrize("kind, placement", [("conifers", "subset"), ("figure", "optimal")])
def test_computed_normals_are_on_the_side_of_the_faces(tmp_path, kind, placement):
    """Normals of crowns, which the points alone turn this way and that, and of vertices that are no points."""
    pytest.importorskip("scipy", reason="python3-scipy isn't installed: make deps")
    cloud, folder = tmp_path / "cloud.ply", tmp_path / "out"
    subprocess.run(["/usr/bin/python3", PEERS / "scenes.py", kind, "3", cloud, "--points", "20000"], check=True)
    subprocess.run([BUILD / "whittle", cloud, "-q", "--ratio", "0.2", "--normals", "true", "--encoding", "ascii",
                    "--placement", placement, "--outputs", "mesh,report", "-o", folder], check=True)
    report = json.loads((folder / "report.json").read_text())
    lines = (folder / "mesh.ply").read_text(encoding="ascii").splitlines()
    begin = lines.index("end_header") + 1
    vertices = [[float(w) for w in line.split()] for line in lines[begin:begin + report["mesh"]["vertices"]]]
    columns = [line.split()[-1] for line in lines[:begin] if line.startswith("property") and "list" not in line]
    at, side = columns.index("x"), columns.index("nx")
    against = [0.0] * len(vertices)
    for line in lines[begin + len(vertices):begin + len(vertices) + report["mesh"]["triangles"]]:
        corners = [vertices[int(v)] for v in line.split()[1:4]]
        a, b, c = ([corner[at + k] for k in range(3)] for corner in corners)
        u, v = [b[k] - a[k] for k in range(3)], [c[k] - a[k] for k in range(3)]
        area = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        for word in line.split()[1:4]:
            against[int(word)] += sum(area[k] * vertices[int(word)][side + k] for k in range(3))
    assert len(against) > 1000
    assert sum(a < 0 for a in against) < 0.002 * len(against), sum(a < 0 for a in against)
    assert report["normals"]["orientation"] == report["surface"]["orientation"]


@pytest.mark.parametrize("order", [[], ["--shuffled"]], ids=["kept", "lost"])
def test_what_one_place_has_seen_is_no_solid(tmp_path, order):
    """Noisy points of a street, whose order or rays tell of the camera before they are known to have as many others above
    them as a solid's: no closed mesh is tried."""
    pytest.importorskip("scipy", reason="python3-scipy isn't installed: make deps")
    cloud = tmp_path / "stereo.ply"
    subprocess.run(["/usr/bin/python3", PEERS / "scenes.py", "stereo", "2", cloud, "--points", "30000", *order],
                   check=True)
    _, _, report = meshed(cloud, tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and "from one place" in report["surface"]["reason"], report["surface"]
    assert report["surface"]["sure"]


def test_broadleaves_that_one_camera_saw_are_no_height_field(tmp_path):
    """A stereo pair from above: a field of few points isn't nearer than a sheet, so one of more isn't tried, and what is
    seen from there is nearer than that one would be."""
    pytest.importorskip("scipy", reason="python3-scipy isn't installed: make deps")
    cloud = tmp_path / "stereo.ply"
    code = """
import sys, scenes
def from_above(rng, scene, *_):
    return scenes.stereo_pair(rng, scene, (0.0, -40.0, 60.0), (0.0, 0.0, 0.0), 260, 200, base=2.0, wrong=0.002)
scenes.from_the_air = from_above
scenes.write(sys.argv[1], scenes.make("broadleaves", 31, 52000).points)
"""
    subprocess.run(["/usr/bin/python3", "-c", code, cloud], cwd=PEERS, check=True)
    _, _, report = meshed(cloud, tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and report["mesh"]["reconstruction"] == "delaunay-of-view", report


@pytest.mark.parametrize("order", ["kept", "lost", "a third, lost"])
def test_a_field_faces_the_camera(tmp_path, order):
    """What stands before a camera is a height field over what the camera's axis is normal to, but has no upper side."""
    chance = random.Random(7)
    lines = []
    for i in range(200 * 150):
        u, v = (i % 200 - 99.5) / 180, (i // 200 - 74.5) / 180
        depth = 2 - 0.3 * math.exp(-((u - 0.1) ** 2 + v * v) / 0.03) + chance.gauss(0, 0.001)
        lines.append(f"{u * depth:.5f} {v * depth:.5f} {depth:.5f}\n")
    if order != "kept":
        chance.shuffle(lines)
    if order == "a third, lost":
        lines = lines[:len(lines) // 3]
    (tmp_path / "wall.xyz").write_text("".join(lines), encoding="ascii")
    points, triangles, report = meshed(tmp_path / "wall.xyz", tmp_path / "out", ratio=0.1)
    area, away = area_and_away(points, triangles, [(0, 0, 0)] * len(points))
    assert report["surface"]["kind"] == "heightfield", report["surface"]
    assert report["surface"]["orientation"] == "scan pattern", report["surface"]
    assert away < 0.03 * area, (away, area)


def write_clutter(path, side, shuffled):
    """30 balls that hide each other, with nothing behind, as one camera sees them from the origin, downwards; shuffled:
    along rays of no lattice, in no order."""
    chance = random.Random(5)
    balls = [(chance.uniform(-0.9, 0.9), chance.uniform(-0.9, 0.9), chance.uniform(-4.6, -3.6),
              chance.uniform(0.15, 0.45)) for _ in range(30)]
    lines = []
    for i in range(side * side):
        u, v = (0.7 * (k + 0.5 + (chance.uniform(-0.4, 0.4) if shuffled else 0)) / side - 0.35
                for k in (i % side, i // side))
        depths = []
        for x, y, z, radius in balls:
            a, b, c = u * u + v * v + 1, u * x + v * y - z, x * x + y * y + z * z - radius * radius
            if b * b > a * c:
                depths.append((b - math.sqrt(b * b - a * c)) / a)
        if depths:
            lines.append(f"{u * min(depths):.6f} {v * min(depths):.6f} {-min(depths):.6f}\n")
    if shuffled:
        chance.shuffle(lines)
    path.write_text("".join(lines), encoding="ascii")


@pytest.mark.parametrize("shuffled", [False, True])
def test_what_one_camera_saw_of_clutter_is_no_landscape(tmp_path, shuffled):
    """Hardly any of its points has others below it, but a height field hangs curtains from ball to ball."""
    write_clutter(tmp_path / "clutter.xyz", 200, shuffled)
    _, _, report = meshed(tmp_path / "clutter.xyz", tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "open" and "steps" in report["surface"]["reason"], report["surface"]
    assert report["mesh"]["components"] <= 30 and report["mesh"]["unsupported_area_share"] < 0.03, report["mesh"]
    assert report["error"]["mesh_to_input"]["mean_rel"] < 0.0015
    assert shuffled or report["mesh"]["reconstruction"] == "delaunay-of-view"


def test_leaves_were_seen_from_where_their_rays_say(tmp_path):
    """Many points lie behind others, as of no scan of walls, but the rays tell that the place is the true one."""
    chance = random.Random(11)
    leaves = [(chance.uniform(-1, 1), chance.uniform(-0.8, 0.8), chance.uniform(2, 4), chance.uniform(0.02, 0.05))
              for _ in range(1500)]
    nearest = {}
    for x, y, z, radius in leaves:
        reach = int(radius / z * 260) + 1
        for i in range(int(x / z * 260) - reach, int(x / z * 260) + reach + 1):
            for j in range(int(y / z * 260) - reach, int(y / z * 260) + reach + 1):
                u, v = i / 260, j / 260
                a, b, c = u * u + v * v + 1, u * x + v * y + z, x * x + y * y + z * z - radius * radius
                if b * b > a * c:
                    nearest[i, j] = min(nearest.get((i, j), 9), (b - math.sqrt(b * b - a * c)) / a)
    lines = [f"{i / 260 * depth:.6f} {j / 260 * depth:.6f} {depth:.6f}\n" for (i, j), depth in nearest.items()]
    chance.shuffle(lines)
    (tmp_path / "leaves.xyz").write_text("".join(lines), encoding="ascii")
    points, triangles, report = meshed(tmp_path / "leaves.xyz", tmp_path / "out", ratio=0.3, viewpoint="0,0,0")
    assert report["surface"]["kind"] == "open", report["surface"]
    assert not any("hidden behind" in str(note) for note in report["left_out"]), report["left_out"]
    area, away = area_and_away(points, triangles, [(0, 0, 0)] * len(points))
    assert away < 0.03 * area, (away, area)


def write_ball(path, form):
    """A ball of radius 1 around (2, 0, 0), without a bottom, evenly: a spiral from its top."""
    count, golden = 8000, math.pi * (3 - math.sqrt(5))
    heights = [1 - 1.7 * (i + 0.5) / count for i in range(count)]
    points = [(math.sqrt(1 - h * h) * math.cos(golden * i) + 2, math.sqrt(1 - h * h) * math.sin(golden * i), h)
              for i, h in enumerate(heights)]
    head = (f"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {count}\nHEIGHT 1\n"
            f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA ascii\n" if form == "pcd" else "")
    path.write_text(head + "".join("{:.5f} {:.5f} {:.5f}\n".format(*p) for p in points), encoding="ascii")


def test_a_small_cloud_is_of_one_kind_however_many_are_kept(tmp_path):
    """A ball without its bottom, whose mesh of few points isn't surely open."""
    count, golden = 800, math.pi * (3 - math.sqrt(5))
    heights = [1 - 1.6 * (i + 0.5) / count for i in range(count)]
    lines = ["{:.6f} {:.6f} {:.6f}\n".format(math.sqrt(1 - h * h) * math.cos(golden * i),
                                             math.sqrt(1 - h * h) * math.sin(golden * i), h)
             for i, h in enumerate(heights)]
    (tmp_path / "bowl.xyz").write_text("".join(lines), encoding="ascii")
    kinds = [meshed(tmp_path / "bowl.xyz", tmp_path / str(ratio), ratio=ratio)[2]["surface"]["kind"]
             for ratio in (0.05, 0.1, 0.2, 0.5)]
    assert kinds == ["open"] * 4


@pytest.mark.parametrize("depth", [1.3, 1.6])
def test_a_large_opening_is_told_by_fewer_points(tmp_path, depth):
    """A bowl of so many points that the labels of a quarter of the kept ones tell that nothing closes it: of the shallow
    one at once, of the deep one, whose lid is a seventh of the area, once the points have judged them."""
    count, golden = 84_000, math.pi * (3 - math.sqrt(5))
    heights = [-1 + depth * (i + 0.5) / count for i in range(count)]
    lines = ["{:.6f} {:.6f} {:.6f}\n".format(math.sqrt(1 - h * h) * math.cos(golden * i),
                                             math.sqrt(1 - h * h) * math.sin(golden * i), h)
             for i, h in enumerate(heights)]
    (tmp_path / "bowl.xyz").write_text("".join(lines), encoding="ascii")
    report = meshed(tmp_path / "bowl.xyz", tmp_path / "out", ratio=0.1)[2]
    assert report["surface"]["kind"] == "open", report["surface"]
    assert "a first closed mesh" in report["surface"]["reason"], report["surface"]
    assert report["mesh"]["borders"] == 1 and report["mesh"]["components"] == 1, report["mesh"]
    assert report["error"]["mesh_to_input"]["max_rel"] < 0.003, report["error"]


def test_a_body_was_not_seen_from_the_origin_beside_it(tmp_path):
    """A PCD has the origin for a viewpoint where nobody said: half of a body is hidden from there."""
    for form in ("xyz", "pcd"):
        write_ball(tmp_path / f"ball.{form}", form)
        _, _, report = meshed(tmp_path / f"ball.{form}", tmp_path / form, ratio=0.2, surface="open")
        assert report["surface"]["orientation"] == "outwards" and report["mesh"]["borders"] == 1, (form, report)


def test_a_place_that_has_not_seen_all_cuts_nothing(tmp_path):
    """Whoever says so: half of the ball faces it, and stays joined to the other."""
    write_ball(tmp_path / "ball.xyz", "xyz")
    _, _, report = meshed(tmp_path / "ball.xyz", tmp_path / "out", ratio=0.2, surface="open", viewpoint="0,0,0")
    assert report["surface"]["orientation"] == "viewpoint" and report["mesh"]["borders"] == 1, report
    assert any("hidden behind others" in str(note) for note in report["left_out"]), report["left_out"]


def test_nothing_hangs_where_rays_went_through(tmp_path):
    """Wrong matches in front of all else are as far from each other as triangles of them are large."""
    write_depth_image(tmp_path / "depth.xyz", 0.004, wrong=0.004)
    points, triangles, report = meshed(tmp_path / "depth.xyz", tmp_path / "out", ratio=0.3, surface="open",
                                       denoise="none")
    hanging = [t for t in triangles if all(points[v][2] < 1.3 for v in t)]
    area, _ = area_and_away(points, hanging, [(0, 0, 0)] * len(points))
    assert report["mesh"]["reconstruction"] == "delaunay-of-view"
    assert area < 0.01, area


def test_a_viewpoint_that_the_rays_deny_is_not_believed(tmp_path):
    write_depth_image(tmp_path / "depth.xyz", 0.004)
    points, triangles, report = meshed(tmp_path / "depth.xyz", tmp_path / "out", ratio=0.1, surface="open",
                                       viewpoint="3,0,9")
    area, away = area_and_away(points, triangles, [(0, 0, 0)] * len(points))
    assert away < 0.001 * area, (away, area)
    told = [note for note in report["left_out"] if "viewpoint" in str(note)]
    assert len(told) == 1 and "seen from" in str(told[0]), report["left_out"]


@pytest.mark.parametrize("order", ["rows", "random"])
@pytest.mark.parametrize("denoise", ["outliers", "auto", "full"])
def test_a_viewpoint_is_denied_before_strays_go(tmp_path, order, denoise):
    """Before there is an index of the points, and of a cloud that is smaller without its stray."""
    path = tmp_path / "depth.xyz"
    write_depth_image(path, 0.004)
    lines = path.read_text(encoding="ascii").splitlines()
    if order == "random":
        random.Random(5).shuffle(lines)
    path.write_text("\n".join([*lines, "20 30 40"]) + "\n", encoding="ascii")
    points, triangles, report = meshed(path, tmp_path / "out", ratio=0.1, surface="open", viewpoint="3,0,9",
                                       denoise=denoise)
    area, away = area_and_away(points, triangles, [(0, 0, 0)] * len(points))
    assert report["input"]["points_outliers"] >= 1
    assert away < 0.002 * area, (away, area)
    assert len([note for note in report["left_out"] if "viewpoint" in str(note)]) == 1, report["left_out"]


def test_what_faces_its_camera_anyway_is_not_made_again(tmp_path):
    write_depth_image(tmp_path / "depth.xyz", 0)
    points, triangles, report = meshed(tmp_path / "depth.xyz", tmp_path / "out", ratio=0.1, surface="open")
    area, away = area_and_away(points, triangles, [(0, 0, 0)] * len(points))
    assert away < 0.005 * area, (away, area)
    assert report["mesh"]["reconstruction"] == "advancing-front", report["mesh"]


def write_street(path):
    """Rings of 24 beams that turn between walls, with bushes before them."""
    chance, lines = random.Random(17), []
    for k in range(24 * 900):
        turn, rise = 2 * math.pi * (k // 24) / 900, math.radians(-20 + 30 * (k % 24) / 23)
        ray = (math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), math.sin(rise))
        along = min(-1.8 / ray[2] if ray[2] < 0 else 99, 7 / abs(ray[1]) if ray[1] else 99)
        if along * abs(ray[1]) > 5 and math.sin(1.3 * along * ray[0]) > 0.3 and ray[2] * along < 2:
            along -= min(chance.expovariate(2), 2)  # leaves before the walls
        along += chance.gauss(0, 0.02)
        if along < 40:
            lines.append("{:.4f} {:.4f} {:.4f}\n".format(*(along * d for d in ray)))
    path.write_text("".join(lines), encoding="ascii")


def test_rings_of_one_scanner_face_it(tmp_path):
    """A street with bushes by 24 beams that turn: on the ground the rings are far apart, and nothing is between them."""
    write_street(tmp_path / "street.xyz")
    points, triangles, report = meshed(tmp_path / "street.xyz", tmp_path / "out", ratio=0.2, viewpoint="0,0,0")
    assert report["surface"]["kind"] == "open" and report["mesh"]["reconstruction"] == "delaunay-of-view"
    area, away = area_and_away(points, triangles, [(0, 0, 0)] * len(points))
    assert away < 0.005 * area, (away, area)
    assert report["error"]["input_to_mesh"]["mean"] < 0.05, report["error"]


def test_what_one_place_has_seen_is_of_many_points(tmp_path):
    """As many as there is memory for, since rings of few points come apart."""
    write_street(tmp_path / "street.xyz")
    _, _, report = meshed(tmp_path / "street.xyz", tmp_path / "out", ratio=0.03, viewpoint="0,0,0")
    assert report["mesh"]["reconstruction"] == "delaunay-of-view"
    assert report["mesh"]["reconstructed_from"] > 6 * report["points_out"], report["mesh"]


def test_rings_are_of_fewer_points(tmp_path):
    """Of all of them the mesh comes apart between the rings, and its pieces leave hardly a vertex to choose."""
    write_street(tmp_path / "street.xyz")
    _, _, report = meshed(tmp_path / "street.xyz", tmp_path / "out", ratio=0.1, viewpoint="0,0,0")
    assert report["mesh"]["reconstruction"] == "delaunay-of-view"
    assert 2 * report["points_out"] < report["mesh"]["reconstructed_from"] < 5 * report["points_out"], report["mesh"]


def test_pieces_do_not_take_all_vertices(tmp_path):
    """Of many points trees are so many pieces that a triangle of each would leave no vertex to choose."""
    pytest.importorskip("scipy", reason="python3-scipy isn't installed: make deps")
    cloud = tmp_path / "trees.ply"
    code = """
import sys, numpy, scenes
def trees(rng, count):
    scene, eye = scenes.Scene(scenes.Ground(rng, .2, 50)), (0, 0, 2.0)
    for turn in numpy.arange(8) * numpy.pi / 4:
        away = rng.uniform(8, 30)
        scenes.plant(rng, scene, away * numpy.cos(turn), away * numpy.sin(turn))
    return scenes.Scan(scenes.turning(rng, scene, eye, numpy.radians(numpy.linspace(-31, 11, 32)), count // 32, .02))
scenes.KINDS["trees"] = trees
scenes.write(sys.argv[1], scenes.make("trees", 5, 20000).points)
"""
    subprocess.run(["/usr/bin/python3", "-c", code, cloud], cwd=PEERS, check=True)
    _, _, report = meshed(cloud, tmp_path / "out", ratio=0.03)
    assert report["mesh"]["reconstruction"] == "delaunay-of-view"
    assert report["mesh"]["reconstructed_from"] == 4 * report["points_out"], report["mesh"]


def test_woods_that_one_sees_through_are_a_height_field(tmp_path):
    """Points lie anywhere in crowns and on the ground below: sheets through them say nothing that a field doesn't."""
    chance, lines = random.Random(13), []
    trees = [(x + chance.uniform(-1, 1), y + chance.uniform(-1, 1), chance.uniform(8, 15))
             for x in range(3, 60, 5) for y in range(3, 60, 5)]
    for _ in range(40000):
        x, y = chance.uniform(0, 60), chance.uniform(0, 60)
        top = max((1 - math.hypot(x - tx, y - ty) / (0.25 * high)) * high for tx, ty, high in trees)
        down = top - chance.expovariate(1.2)
        lines.append(f"{x:.3f} {y:.3f} {max(down, 0) + chance.gauss(0, 0.02):.3f}\n")
    (tmp_path / "woods.xyz").write_text("".join(lines), encoding="ascii")
    points, triangles, report = meshed(tmp_path / "woods.xyz", tmp_path / "out", ratio=0.1)
    assert report["surface"]["kind"] == "heightfield" and "from above" in report["surface"]["reason"], report["surface"]
    over = sum((points[b][0] - points[a][0]) * (points[c][1] - points[a][1]) -
               (points[b][1] - points[a][1]) * (points[c][0] - points[a][0]) for a, b, c in triangles) / 2
    assert 0.93 * 60 * 60 < over < 1.01 * 60 * 60


@pytest.mark.parametrize("ratio", [0.03, 0.1, 0.3])
def test_leaves_fill_a_volume_that_has_no_skin(ratio, tmp_path):
    """Leaves around twigs at all heights and the ground below, in no order: a closed mesh is no skin of theirs."""
    chance, lines = random.Random(29), []
    trees = [(x + chance.uniform(-1.5, 1.5), y + chance.uniform(-1.5, 1.5), chance.uniform(9, 16))
             for x in range(3, 48, 6) for y in range(3, 48, 6)]
    for _ in range(9000):
        x, y = chance.uniform(0, 48), chance.uniform(0, 48)
        lines.append(f"{x:.3f} {y:.3f} {math.sin(x / 9) + chance.gauss(0, 0.03):.3f}\n")
    twigs = []
    for x, y, high in trees:
        for _ in range(9):
            rise, turn = chance.uniform(0.3, 1), chance.uniform(-math.pi, math.pi)
            twigs.append((x + 0.2 * high * math.cos(turn), y + 0.2 * high * math.sin(turn), rise * high, 0.038 * high))
    for _ in range(21000):
        *at, size = chance.choice(twigs)
        lines.append("{:.3f} {:.3f} {:.3f}\n".format(*(a + chance.gauss(0, size) for a in at)))
    chance.shuffle(lines)
    (tmp_path / "leaves.xyz").write_text("".join(lines), encoding="ascii")
    _, _, report = meshed(tmp_path / "leaves.xyz", tmp_path / "out", ratio=ratio)
    assert report["surface"]["kind"] == "open" and "foliage" in report["surface"]["reason"], report["surface"]
    assert report["mesh"]["unsupported_area_share"] < 0.05


def test_height_fields_that_face_down_are_refined(terrain, tmp_path):
    """As exactly as those that face up: a scanner may have stood on either side."""
    errors = {}
    for side, place in (("up", "0.5,0.5,9"), ("down", "0.5,0.5,-9")):
        points, triangles, report = meshed(terrain, tmp_path / side, surface="heightfield", viewpoint=place)
        errors[side] = report["error"]["input_to_mesh"]["mean"]
        a, b, c = (points[v] for v in triangles[0])
        turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        assert (turn > 0) == (side == "up")
    assert errors["down"] == pytest.approx(errors["up"], rel=0.05)
