# SPDX-License-Identifier: GPL-3.0-or-later
"""LAZ from end to end: another reader's opinion of what our writer makes, threads, the service."""
import pathlib
import shutil
import struct
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


def records_of(las):
    """The records of points of a LAS file, sorted."""
    first, = struct.unpack_from("<I", las, 96)
    each, = struct.unpack_from("<H", las, 105)
    return sorted(las[i:i + each] for i in range(first, len(las) - each + 1, each))


@pytest.mark.parametrize("extra", [0, 3])
@pytest.mark.parametrize("point_format", [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10])
def test_las_goes_out_as_it_came_in(tmp_path, point_format, extra):
    """Every kept point to the bit, in the same format, also beside outputs that get colours of 8 bits."""
    las, laz = make(tmp_path, point_format, extra, 700, points=3000)
    done = whittle(laz, "--ratio", 1, "--outputs", "cloud,cloud.las,cloud.laz", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    before, after = las.read_bytes(), (tmp_path / "out/cloud.las").read_bytes()
    assert records_of(after) == records_of(before)
    assert after[104:107] == before[104:107] and after[131:179] == before[131:179]
    done = whittle(tmp_path / "out/cloud.laz", "--ratio", 1, "--outputs", "cloud.las", "-o", tmp_path / "again")
    assert done.returncode == 0, done.stderr
    assert records_of((tmp_path / "again/cloud.las").read_bytes()) == records_of(before)
    if point_format not in (4, 5, 9, 10):
        assert read_by_laz_perf(tmp_path / "out/cloud.laz", tmp_path / "out/cloud.las").returncode == 0


def with_records(las, *records):
    """The same file with variable length records before its points."""
    header, = struct.unpack_from("<H", las, 94)
    blob = b"".join(struct.pack("<H16sHH32s", 0, user, number, len(data), b"") + data for user, number, data in records)
    made = bytearray(las[:header] + blob + las[header:])
    struct.pack_into("<II", made, 96, header + len(blob), len(records))
    return bytes(made)


@pytest.mark.parametrize("name", ["cloud.las", "cloud.laz"])
def test_the_coordinate_system_is_kept_and_never_guessed(tmp_path, name):
    las, _ = make(tmp_path, 6, 0, 700, points=100)
    keys, wkt = bytes(range(32)), b'PROJCS["somewhere"]\0'
    (tmp_path / "crs.las").write_bytes(with_records(las.read_bytes(), (b"LASF_Projection", 34735, keys),
                                                    (b"LASF_Projection", 2112, wkt), (b"nobody", 7, b"secret")))
    for path, expected in ((tmp_path / "crs.las", True), (las, False)):
        done = whittle(path, "--ratio", 0.5, "--outputs", name, "-o", tmp_path / "out", "--force")
        assert done.returncode == 0, done.stderr
        out = (tmp_path / "out" / name).read_bytes()
        assert (keys in out and wkt in out) == expected and b"secret" not in out
        assert (b"LASF_Projection" in out) == expected
    done = whittle(tmp_path / "crs.las", "--ratio", 0.5, "--outputs", "cloud,report", "-o", tmp_path / "out", "--force")
    assert "the coordinate system, except in cloud.las" in (tmp_path / "out/report.json").read_text()


def test_newer_formats_say_whether_the_system_is_text(tmp_path):
    """Text goes before keys, which only older formats are to have."""
    las, _ = make(tmp_path, 1, 0, 700, points=100)
    keys, text = (b"LASF_Projection", 34735, bytes(range(32))), (b"LASF_Projection", 2112, b'PROJCS["somewhere"]\0')
    for records, bit in (((keys, text), 0x10), ((text, keys), 0x10), ((text,), 0x10), ((keys,), 0)):
        (tmp_path / "crs.las").write_bytes(with_records(las.read_bytes(), *records))
        done = whittle(tmp_path / "crs.las", "--ratio", 0.5, "--outputs", "cloud.copc.laz,report", "-o",
                       tmp_path / "out", "--force")
        assert done.returncode == 0, done.stderr
        out = (tmp_path / "out/cloud.copc.laz").read_bytes()
        assert out[104] & 63 == 6 and out[6] & 0x10 == bit and all(data in out for _, _, data in records)
        assert ("GeoTIFF keys go on" in (tmp_path / "out/report.json").read_text()) == (bit == 0)


def test_other_formats_become_las_with_a_scale_that_is_told(tmp_path):
    """Fields by their names, others as described extra bytes; a pipe gets the same points as a file."""
    lines = "".join(f"{5e5 + i / 7:.6f} {i / 3:.6f} {i % 5} {i % 256} {i % 7} {255 - i % 256} {i * 3} {i / 9:.6f}\n"
                    for i in range(500))
    cloud = tmp_path / "in.xyz"
    cloud.write_text("x y z red green blue intensity mine\n" + lines)
    done = whittle(cloud, "--ratio", 1, "--outputs", "cloud.las,report", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    las = (tmp_path / "out/cloud.las").read_bytes()
    assert las[104] == 2 and b"mine" in las and struct.unpack_from("<H", las, 105) == (26 + 8,)
    assert "multiples of" in (tmp_path / "out/report.json").read_text()
    again = whittle(tmp_path / "out/cloud.las", "--ratio", 1, "--outputs", "xyz", "--header", "plain", "-o", "-")
    names, *rows = again.stdout.splitlines()
    columns = names.split()
    found = sorted(tuple(float(v) for v in row.split()) for row in rows)
    for row, line in zip(found, sorted(tuple(map(float, line.split())) for line in lines.splitlines())):
        point = dict(zip(columns, row))
        assert [abs(point[a] - b) < 1e-5 for a, b in zip("xyz", line)] == [True] * 3
        assert (point["red"], point["intensity"], point["mine"]) == (line[3], line[6], line[7])
    with open(tmp_path / "appended.laz", "ab") as appended: # where no byte can be written again
        subprocess.run([BUILD / "whittle", cloud, "--ratio", "1", "--outputs", "cloud.laz", "-q", "-o", "-"], stdout=appended,
                       check=True)
    back = whittle(tmp_path / "appended.laz", "--ratio", 1, "--outputs", "cloud.las", "-o", tmp_path / "back")
    assert back.returncode == 0, back.stderr
    assert records_of((tmp_path / "back/cloud.las").read_bytes()) == records_of(las)


def test_a_service_takes_and_gives_laz(daemon, tmp_path):
    _, laz = make(tmp_path, 7, 1, 700, points=2000)
    job = daemon.ended(daemon.submit(laz.read_bytes(), "?ratio=0.5&outputs=cloud.laz"))
    assert job["status"] == "successful", job
    out = daemon.curl(f"/v1/jobs/{job['id']}/outputs/cloud.laz").body
    assert out[:4] == b"LASF" and out[104] == 0x87 and struct.unpack_from("<Q", out, 247) == (1000,)
    assert daemon.curl(f"/v1/jobs/{job['id']}/outputs/cloud.laz?points=10").status == 400
