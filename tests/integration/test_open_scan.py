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
import borders  # noqa: E402  pylint: disable=wrong-import-position
import models  # noqa: E402  pylint: disable=wrong-import-position

HORSE = models.SHARED / "horse.mesh.ply"
CUT = 0.018  # y of the plane, through neck and trunk
NEAR = 0.01  # of the diagonal


def area_of(a, b, c):
    u, v = [y - x for x, y in zip(a, b)], [y - x for x, y in zip(a, c)]
    return math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]) / 2


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
    @functools.cache
    def make(boundary, ratio):
        folder = tmp_path_factory.mktemp(boundary)
        subprocess.run([BUILD / "whittle", trunk, "--ratio", str(ratio), "--boundary", boundary, "-q", "--outputs",
                        "mesh,report", "-o", folder], check=True)
        return folder / "mesh.ply", json.loads((folder / "report.json").read_text())
    return make


def loops_in_space(path):
    points, corners = borders.points_of(path)
    return [[points[v] for v in loop] for loop in borders.loops_of(corners)]


# Of the diagonal: how far the true border's points are from the mesh's border.  At a tenth of the points it doesn't
# follow the cut all the way into the neck, whose sides are an edge apart there.
@pytest.mark.parametrize("ratio, mean, most", [(0.2, 0.003, 0.02), (0.1, 0.008, 0.06)])
def test_keep_leaves_the_hole_open_along_its_border(trunk, made, ratio, mean, most):
    mesh, report = made("keep", ratio)
    assert report["mesh"]["manifold"] and report["mesh"]["oriented"] and not report["mesh"]["watertight"]
    assert report["mesh"]["points_lost"] == 0 and report["mesh"]["hole_fill_triangles"] == 0
    diagonal = report["input"]["diagonal"]
    near = NEAR * diagonal
    rim = [loop for loop in loops_in_space(mesh) if all(abs(point[1] - CUT) < near for point in loop)]
    true_loops = loops_in_space(trunk)
    far = borders.distances(true_loops[-1], rim)
    assert sum(far) / len(far) < mean * diagonal and max(far) < most * diagonal
    assert max(borders.distances([point for loop in rim for point in loop], true_loops)) < near / 10
    true_points, true_corners = borders.points_of(trunk)
    area = sum(area_of(*(true_points[v] for v in triangle)) for triangle in borders.triangles_of(true_corners))
    assert report["mesh"]["area"] == pytest.approx(area, rel=0.02)
    assert report["error"]["backward"]["mean_rel"] < 4e-4


def test_fill_closes_the_hole(made):
    mesh, report = made("fill", 0.1)
    assert report["mesh"]["manifold"] and report["mesh"]["oriented"] and report["mesh"]["watertight"]
    assert report["mesh"]["points_lost"] == 0 and report["mesh"]["hole_fill_triangles"] > 10
    assert not loops_in_space(mesh)
    assert report["mesh"]["area"] > made("keep", 0.1)[1]["mesh"]["area"] * 1.05
