# SPDX-License-Identifier: GPL-3.0-or-later
"""What `make coverage` does beside running the tests: it forgets what was compiled of sources that are gone, and sums up
rooms."""
import pathlib
import subprocess
import sys

TOOL = pathlib.Path(__file__).resolve().parents[2] / "tests/tools/coverage.py"


def run(folder, *options):
    return subprocess.run([sys.executable, "-B", TOOL, *options], cwd=folder, capture_output=True, text=True, check=False)


def test_what_was_compiled_of_removed_sources_goes_with_all_counts(tmp_path):
    sources = ("core/math/sym3.c", "core/spatial/knn_flann.cc")
    here = [f"core/math/sym3{kind}.{ending}" for kind in ("", ".avx2") for ending in ("gcno", "o")]
    here.append("core/spatial/knn_flann.gcno")
    gone = ["core/math/quat.gcno", "core/math/quat.avx2.gcno", "core/math/quat.avx2.o", "core/math/quat.d",
            "core/math/sym3.gcda"]
    for name in (*sources, *(f"build/cov/{name}" for name in (*here, *gone))):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert run(tmp_path, "--clean", "build/cov").returncode == 0
    left = {str(path.relative_to(tmp_path / "build/cov")) for path in (tmp_path / "build").rglob("*") if path.is_file()}
    assert left == set(here)


def test_rooms_are_sums_of_their_files(tmp_path):
    (tmp_path / "coverage.txt").write_text(
        "File                                       Lines    Exec  Cover   Missing\n"
        "core/math/sym3.c                              40      30    75%   1-10\n"
        "core/math/vec3.h                              10      10   100%\n"
        "server/http/http.c                            50      10    20%   7,9-47\n"
        "TOTAL                                        100      50    50%\n", encoding="ascii")
    told = run(tmp_path, "coverage.txt")
    assert told.returncode == 0
    rows = [line.split() for line in told.stdout.splitlines()[1:]]
    assert rows == [["core/math", "50", "40", "80.0"], ["server/http", "50", "10", "20.0"], ["all", "100", "50", "50.0"]]
    (tmp_path / "coverage.txt").write_text("nothing\n", encoding="ascii")
    assert run(tmp_path, "coverage.txt").returncode != 0
