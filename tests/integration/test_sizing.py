# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of deploy/README.md on sizing is one that `make sizing` prints: the same rows, and figures in them."""
import pathlib
import re
import subprocess
import sys

import pytest

import conftest

ROOT = pathlib.Path(__file__).resolve().parents[2]
ROW = r"^\| (the cloud alone|cloud, mesh and measured error) \| ([\d.]+) s \| (\d+) MB \| (\d+) MB, ([\d.]+) MB \|$"


def test_the_table_is_printed():
    if not (conftest.BUILD / "tests/bench/make_scan").exists():
        pytest.skip("make_scan isn't built: make tests")
    done = subprocess.run([sys.executable, ROOT / "tests/bench/sizing.py", conftest.BUILD, "20000"],
                          capture_output=True, text=True, check=True)
    cloud, mesh = re.findall(ROW, done.stdout, re.M)
    assert [row[0] for row in re.findall(ROW, (ROOT / "deploy/README.md").read_text(), re.M)] == [cloud[0], mesh[0]]
    assert float(mesh[1]) > float(cloud[1]) > 0 and int(mesh[2]) >= int(cloud[2]) > 0
    assert cloud[3] == mesh[3] == "12" and float(mesh[4]) > float(cloud[4])
