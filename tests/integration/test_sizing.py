# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of deploy/README.md on sizing says what `make sizing` measures here.  Memory and disk are the same on every
machine; of the time, which isn't, the two rows are compared."""
import pathlib
import re
import subprocess
import sys

import pytest

import conftest

ROOT = pathlib.Path(__file__).resolve().parents[2]
ROW = r"^\| (the cloud alone|cloud, mesh and measured error) \| ([\d.]+) s \| (\d+) MB \| (\d+) MB, ([\d.]+) MB \|$"


POINTS = 200000
TOLERANCE, TIME_TOLERANCE = 0.12, 0.5


def rows(text):
    """For each row of the table: its name, seconds, MB of memory, of input, of outputs."""
    return {name: [float(figure) for figure in figures] for name, *figures in re.findall(ROW, text, re.M)}


@pytest.mark.skipif(conftest.SANITIZED, reason="sanitizers take memory and time of their own")
def test_the_table_says_what_is_measured():
    done = subprocess.run([sys.executable, ROOT / "tests/bench/sizing.py", conftest.BUILD, str(POINTS)],
                          capture_output=True, text=True, check=True)
    found, told = rows(done.stdout), rows((ROOT / "deploy/README.md").read_text())
    assert list(found) == list(told) and len(told) == 2
    for name, (_, memory, *disk) in told.items():
        assert found[name][1:] == [pytest.approx(memory, rel=TOLERANCE), *(pytest.approx(d, abs=0.1) for d in disk)]
    times = [row[1][0] / row[0][0] for row in (list(found.values()), list(told.values()))]
    assert times[0] == pytest.approx(times[1], rel=TIME_TOLERANCE)
