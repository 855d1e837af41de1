# SPDX-License-Identifier: GPL-3.0-or-later
"""Kept points are on the mesh, even where sheets cross and no closed surface goes through all of them nicely."""
import json
import math
import random
import subprocess

import pytest

from conftest import BUILD


def unit(rng, across=(0, 0, 0)):
    """A random direction, across another one."""
    direction = [rng.gauss(0, 1) for _ in range(3)]
    along = sum(x * y for x, y in zip(direction, across))
    direction = [x - along * y for x, y in zip(direction, across)]
    length = math.hypot(*direction)
    return [x / length for x in direction]


def crossing_sheets(seed):
    """Six squares that share a corner, 500 points on each."""
    rng = random.Random(seed)
    lines = []
    for _ in range(6):
        one = unit(rng)
        other = unit(rng, one)
        for _ in range(500):
            s, t = rng.random(), rng.random()
            lines.append("%.9g %.9g %.9g\n" % tuple(s * x + t * y for x, y in zip(one, other)))
    return "".join(lines)


@pytest.mark.parametrize("seed", [23, 42, 65, 93])
def test_no_point_of_crossing_sheets_is_lost(tmp_path, seed):
    cloud = tmp_path / "sheets.xyz"
    cloud.write_text(crossing_sheets(seed))
    subprocess.run([BUILD / "whittle", cloud, "--ratio", "0.3", "--surface", "closed", "--outputs", "mesh,report", "-q", "-o", tmp_path],
                   check=True)
    mesh = json.loads((tmp_path / "report.json").read_text())["mesh"]
    assert mesh["points_lost"] == 0
    assert mesh["watertight"] and mesh["manifold"] and mesh["oriented"]
