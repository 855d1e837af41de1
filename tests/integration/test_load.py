# SPDX-License-Identifier: GPL-3.0-or-later
"""The load and the soak in small: what they check of every byte and every job, and not the times."""
import os
import pathlib
import subprocess
import sys

import pytest

from conftest import BUILD, SANITIZED

LOAD = pathlib.Path(__file__).parent.parent / "load"


def run(program, *arguments):
    done = subprocess.run([sys.executable, LOAD / program, *map(str, arguments)], capture_output=True, text=True, check=False,
                          env=dict(os.environ, WHITTLE_BUILD=str(BUILD)))
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr


def test_many_clients_at_once_and_many_jobs(tmp_path):
    run("load.py", "--uploads", 8, "--bytes", 4000000, "--downloads", 8, "--listeners", 20, "--slow", 50, "--jobs", 30,
        "--no-times", "--folder", tmp_path)


@pytest.mark.skipif(SANITIZED, reason="sanitizers keep freed memory")
def test_mixed_traffic_leaves_nothing():
    run("soak.py", "--seconds", 2)
