# SPDX-License-Identifier: GPL-3.0-or-later
"""LAZ from end to end: another reader's opinion of what our writer makes, threads, the service."""
import pathlib
import shutil
import subprocess

import pytest

from conftest import BUILD
from test_cli import FIXTURES, whittle

NODE = pathlib.Path(__file__).parent.parent / "node"
MAKE_LAZ = BUILD / "tests/tools/make_laz"
POINTS = 20000


def make(folder, point_format, extra, chunk, items="new", points=POINTS):
    """The same points as LAS and LAZ; returns both paths."""
    las, laz = folder / "points.las", folder / "points.laz"
    subprocess.run([MAKE_LAZ, *map(str, (point_format, extra, points, chunk, items, las, laz))], check=True)
    return las, laz


def read_by_laz_perf(laz, las):
    if not shutil.which("node") or not (NODE / "node_modules/laz-perf").exists():
        pytest.skip("laz-perf isn't installed: npm ci in tests/node")
    return subprocess.run(["node", NODE / "compare_laz.js", laz, las], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("chunk", [1000, 0])
@pytest.mark.parametrize("extra", [0, 3])
@pytest.mark.parametrize("point_format", [0, 1, 2, 3, 6, 7, 8])
def test_laz_perf_reads_what_we_write(tmp_path, point_format, extra, chunk):
    las, laz = make(tmp_path, point_format, extra, chunk)
    read = read_by_laz_perf(laz, las)
    assert (read.returncode, read.stdout) == (0, f"{POINTS} points\n"), read.stderr


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("point_format,items", [(1, "new"), (3, "old"), (5, "new"), (7, "new"), (10, "4")])
def test_laz_is_read_as_las_on_any_threads(tmp_path, point_format, items, threads):
    las, laz = make(tmp_path, point_format, 2, 700, items, 5000)
    for path in (las, laz):
        done = whittle(path, "--ratio", 0.5, "--threads", threads, "-o", path.with_suffix(".ply"))
        assert done.returncode == 0, done.stderr
        path.with_suffix(".ply").rename(path.with_suffix(path.suffix + ".ply"))
    assert (tmp_path / "points.las.ply").read_bytes() == (tmp_path / "points.laz.ply").read_bytes()


def test_the_report_says_that_it_was_laz_and_what_is_missing(tmp_path):
    case = FIXTURES / "valid/laz-7-channels/input.laz"
    done = whittle(case, "--ratio", 0.5, "--outputs", "report", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert '"laz"' in (tmp_path / "out/report.json").read_text()
    cut = tmp_path / "cut.las"
    las, _ = make(tmp_path, 6, 0, 0, points=100)
    cut.write_bytes(las.read_bytes()[:-1])
    done = whittle(cut, "--ratio", 0.5, "--outputs", "report", "-o", tmp_path / "out", "--force")
    assert done.returncode == 0, done.stderr
    assert "the last 1 of 100 points: the file is cut short" in (tmp_path / "out/report.json").read_text()


def test_a_broken_chunk_is_told_with_its_place():
    done = whittle(FIXTURES / "invalid/laz-chunk-damaged/input.laz", "--dry-run")
    assert done.returncode == 65
    assert "byte 335: chunks: chunk 0, of points 0 to 39" in done.stderr
