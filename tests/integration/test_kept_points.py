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


@pytest.mark.parametrize("options, told", [
    (["--points", "600"], "300 points are kept, not 600: there are no more that are distinct"),
    (["--ratio", "1"], "300 points are kept, not 900: there are no more that are distinct"),
    (["--levels", "0.9,0.1"], "300 points are kept, not 810: there are no more that are distinct"),
    (["--points", "300"], None), (["--ratio", "0.3"], None)], ids=lambda value: str(value)[:20])
def test_fewer_points_than_were_asked_for_are_told(tmp_path, options, told):
    """900 points, of which 300 are distinct."""
    rng = random.Random(3)
    lines = ["%.9g %.9g %.9g\n" % tuple(unit(rng)) for _ in range(300)]
    (tmp_path / "doubles.xyz").write_text("".join(lines * 3))
    subprocess.run([BUILD / "whittle", tmp_path / "doubles.xyz", *options, "-q", "-o", tmp_path], check=True)
    report = json.loads((tmp_path / "report.json").read_text())
    notes = [entry["what"] for entry in report["left_out"] if "distinct" in entry["what"]]
    assert [note.removeprefix("note: ") for note in notes] == ([told] if told else [])
