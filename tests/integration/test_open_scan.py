# SPDX-License-Identifier: GPL-3.0-or-later
"""Open scans, whose hole is known: shapes with an end, and a real scan without what lies above a plane."""
import functools
import json
import math
import pathlib
import random
import subprocess
import sys

import pytest

from conftest import BUILD

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "peers"))
import borders  # noqa: E402  pylint: disable=wrong-import-position
import models  # noqa: E402  pylint: disable=wrong-import-position

HORSE = models.SHARED / "horse.mesh.ply"
CUT = 0.018  # y of the plane, through neck and trunk


def area_of(a, b, c):
    u, v = [y - x for x, y in zip(a, b)], [y - x for x, y in zip(a, c)]
    return math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]) / 2


def loops_in_space(path):
    points, corners = borders.points_of(path)
    return [[points[v] for v in loop] for loop in borders.loops_of(corners)]


def make_mesh(cloud, folder, ratio, boundary):
    """(path of the mesh, report)."""
    subprocess.run([BUILD / "whittle", cloud, "--ratio", str(ratio), "--boundary", boundary, "-q", "--outputs",
                    "mesh,report,error", "-o", folder], check=True)
    return folder / "mesh.ply", json.loads((folder / "report.json").read_text())


# ---------------------------------------------------------------------------------------------------- shapes
def spiral(count):
    """Even on the unit sphere, from pole to pole."""
    for i in range(count):
        z, angle = 1 - (2 * i + 1) / count, i * math.pi * (3 - math.sqrt(5))
        yield math.sqrt(1 - z * z) * math.cos(angle), math.sqrt(1 - z * z) * math.sin(angle), z


def tube():
    turns = [2 * math.pi * k / 60 for k in range(60)]
    return [(math.cos(turn), math.sin(turn), z / 10) for z in range(80) for turn in turns]


def scattered(count):
    """On the unit sphere, by chance: with voids."""
    chance = random.Random(1)
    for _ in range(count):
        place = [chance.gauss(0, 1) for _ in range(3)]
        yield tuple(x / math.hypot(*place) for x in place)


def sheets():
    return [(x, y, z + math.sin(x / 9)) for z in (0, 8) for x in range(40) for y in range(40)]


def write_xyz(path, points):
    path.write_text("".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points))
    return path


def circle(z, radius):
    return [(radius * math.cos(k / 50), radius * math.sin(k / 50), z) for k in range(314)]


# The spacing is about 0.1 in the tube and 0.05 on the spheres.
@pytest.mark.parametrize("ratio", [1, 0.2])
@pytest.mark.parametrize("points, rims, near", [
    (tube(), [circle(0, 1), circle(7.9, 1)], 0.3),
    ([p for p in spiral(4000) if p[2] < 0.2], [circle(0.2, math.sqrt(0.96))], 0.15),
    ([p for p in spiral(20000) if p[2] < -0.8], [circle(-0.8, 0.6)], 0.08)], ids=["tube", "bowl", "saucer"])
def test_a_shape_with_ends_stays_open_at_each(tmp_path, points, rims, near, ratio):
    mesh, report = make_mesh(write_xyz(tmp_path / "scan.xyz", points), tmp_path, ratio, "keep")
    assert report["mesh"]["manifold"] and report["mesh"]["oriented"] and report["mesh"]["components"] == 1
    assert report["mesh"]["points_lost"] == 0
    loops = loops_in_space(mesh)
    assert len(loops) == len(rims)
    assert max(borders.distances([p for rim in rims for p in rim], loops)) < near
    assert max(borders.distances([p for loop in loops for p in loop], rims)) < near


@pytest.mark.parametrize("ratio", [1, 0.2, 0.05])
@pytest.mark.parametrize("points", [list(spiral(4000)), list(scattered(10000))], ids=["even", "scattered"])
def test_a_closed_scan_has_no_hole(tmp_path, points, ratio):
    cloud = write_xyz(tmp_path / "scan.xyz", points)
    kept, report = make_mesh(cloud, tmp_path / "keep", ratio, "keep")
    filled, _ = make_mesh(cloud, tmp_path / "fill", ratio, "fill")
    assert report["mesh"]["watertight"]
    assert borders.points_of(kept) == borders.points_of(filled)


# A sheet's corner may hang on by one triangle of the wall between, lest its point be lost.
@pytest.mark.parametrize("ratio", [1, 0.2])
def test_two_sheets_have_no_wall_between_them(tmp_path, ratio):
    mesh, report = make_mesh(write_xyz(tmp_path / "scan.xyz", sheets()), tmp_path, ratio, "keep")
    assert report["mesh"]["manifold"] and report["mesh"]["points_lost"] == 0
    points, corners = borders.points_of(mesh)
    between = [t for t in borders.triangles_of(corners) if len({points[v][2] > 4 for v in t}) == 2]
    assert len(between) <= 4


@pytest.mark.parametrize("points", [
    [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (3, 3, 3)],
    list(scattered(12))], ids=["four", "five", "twelve"])
def test_few_points_lose_none(tmp_path, points):
    _, report = make_mesh(write_xyz(tmp_path / "scan.xyz", points), tmp_path, 1, "keep")
    assert report["mesh"]["manifold"] and report["mesh"]["points_lost"] == 0


# ---------------------------------------------------------------------------------------------------- a real scan
@pytest.fixture(name="trunk", scope="module")
def make_trunk(tmp_path_factory):
    """The mesh of all below the plane: its vertices are the cloud, its faces the truth."""
    if not HORSE.exists():
        pytest.skip("../shared/data/horse.mesh.ply isn't there")
    path = tmp_path_factory.mktemp("open") / "trunk.ply"
    borders.write(path, *borders.cut(*borders.points_of(HORSE), lambda point: point[1] < CUT))
    return path


@pytest.fixture(name="made", scope="module")
def make_made(trunk, tmp_path_factory):
    """A function that meshes the trunk, once; (path of the mesh, report)."""
    return functools.cache(lambda boundary, ratio: make_mesh(trunk, tmp_path_factory.mktemp(boundary), ratio, boundary))


def mean_and_most(distances, diagonal):
    return sum(distances) / len(distances) / diagonal, max(distances) / diagonal


# There is one other gap in the scan, between the legs.
@pytest.mark.parametrize("ratio", [1, 0.4, 0.2, 0.1, 0.05])
def test_keep_leaves_the_hole_open_along_its_border(trunk, made, ratio):
    mesh, report = made("keep", ratio)
    assert report["mesh"]["manifold"] and report["mesh"]["oriented"] and not report["mesh"]["watertight"]
    assert report["mesh"]["points_lost"] == 0 and report["mesh"]["hole_fill_triangles"] == 0
    *others, rim = sorted(loops_in_space(mesh), key=borders.length_of)
    assert len(others) <= 1
    assert sum(map(borders.length_of, others)) < 0.3 * borders.length_of(rim)
    true_loops = loops_in_space(trunk)
    mean, most = mean_and_most(borders.distances(true_loops[-1], [rim]), report["input"]["diagonal"])
    assert mean < 0.003 and most < 0.015
    mean, most = mean_and_most(borders.distances(rim, true_loops), report["input"]["diagonal"])
    assert mean < 0.003 and most < 0.06
    true_points, true_corners = borders.points_of(trunk)
    area = sum(area_of(*(true_points[v] for v in triangle)) for triangle in borders.triangles_of(true_corners))
    assert report["mesh"]["area"] == pytest.approx(area, rel=0.02)
    assert report["error"]["backward"]["mean_rel"] < 5e-4


def test_fill_closes_the_hole(made):
    mesh, report = made("fill", 0.1)
    assert report["mesh"]["manifold"] and report["mesh"]["oriented"] and report["mesh"]["watertight"]
    assert report["mesh"]["points_lost"] == 0 and report["mesh"]["hole_fill_triangles"] > 10
    assert not loops_in_space(mesh)
    assert report["mesh"]["area"] > made("keep", 0.1)[1]["mesh"]["area"] * 1.05
