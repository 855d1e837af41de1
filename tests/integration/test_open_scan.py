# SPDX-License-Identifier: GPL-3.0-or-later
"""A real scan with a hole that is known: Horse without what lies above a plane."""
import functools
import json
import math
import pathlib
import subprocess
import sys

import pytest

from conftest import BUILD

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "peers"))
import models  # noqa: E402  pylint: disable=wrong-import-position

HORSE = models.SHARED / "horse.mesh.ply"
CUT = 0.018  # y of the plane, through neck and trunk
NEAR = 0.01  # of the diagonal


def points_of(path):
    columns, corners = models.read_ply(path)
    return list(zip(columns["x"], columns["y"], columns["z"])), corners


def area_of(a, b, c):
    u, v = [y - x for x, y in zip(a, b)], [y - x for x, y in zip(a, c)]
    return math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]) / 2


def borders(corners):
    """The vertices of each border, all the way around."""
    edges = {edge for i in range(0, len(corners), 3)
             for a, b, c in [corners[i:i + 3]] for edge in ((a, b), (b, c), (c, a))}
    after = {b: a for a, b in edges if (b, a) not in edges}
    loops = []
    while after:
        loop, vertex = [], next(iter(after))
        while vertex in after:
            loop.append(vertex)
            vertex = after.pop(vertex)
        loops.append(loop)
    return sorted(loops, key=len)


@pytest.fixture(name="trunk", scope="module")
def make_trunk(tmp_path_factory):
    """The mesh of all below the plane: its vertices are the cloud, its faces the truth."""
    if not HORSE.exists():
        pytest.skip("../shared/data/horse.mesh.ply isn't there")
    points, corners = points_of(HORSE)
    number = {old: new for new, old in enumerate(i for i, point in enumerate(points) if point[1] < CUT)}
    kept = [v for i in range(0, len(corners), 3) if all(v in number for v in corners[i:i + 3])
            for v in corners[i:i + 3]]
    path = tmp_path_factory.mktemp("open") / "trunk.ply"
    models.write_ply(path, [c for old in number for c in points[old]], [number[v] for v in kept])
    return path


@pytest.fixture(name="made", scope="module")
def make_made(trunk, tmp_path_factory):
    """A function that meshes the trunk, once; (path of the mesh, report)."""
    @functools.cache
    def make(boundary):
        folder = tmp_path_factory.mktemp(boundary)
        subprocess.run([BUILD / "whittle", trunk, "--ratio", "0.1", "--boundary", boundary, "-q", "--outputs",
                        "mesh,report", "-o", folder], check=True)
        return folder / "mesh.ply", json.loads((folder / "report.json").read_text())
    return make


def test_keep_leaves_the_hole_open_along_its_border(trunk, made):
    mesh, report = made("keep")
    assert report["mesh"]["manifold"] and report["mesh"]["oriented"] and not report["mesh"]["watertight"]
    assert report["mesh"]["points_lost"] == 0 and report["mesh"]["hole_fill_triangles"] == 0
    near = NEAR * report["input"]["diagonal"]
    points, corners = points_of(mesh)
    *small, around = borders(corners)
    assert len(around) > 30 and all(len(loop) < len(around) / 3 for loop in small)
    assert all(abs(points[v][1] - CUT) < near for v in around)
    true_points, true_corners = points_of(trunk)
    true_border = [true_points[v] for v in borders(true_corners)[-1]]
    assert all(min(math.dist(points[v], true) for true in true_border) < near for v in around)
    area = sum(area_of(*(true_points[v] for v in true_corners[i:i + 3])) for i in range(0, len(true_corners), 3))
    assert report["mesh"]["area"] == pytest.approx(area, rel=0.02)
    assert report["error"]["backward"]["mean_rel"] < 4e-4


def test_fill_closes_the_hole(made):
    mesh, report = made("fill")
    assert report["mesh"]["manifold"] and report["mesh"]["oriented"] and report["mesh"]["watertight"]
    assert report["mesh"]["points_lost"] == 0 and report["mesh"]["hole_fill_triangles"] > 10
    assert not borders(points_of(mesh)[1])
    assert report["mesh"]["area"] > made("keep")[1]["mesh"]["area"] * 1.05
