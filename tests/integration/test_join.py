# SPDX-License-Identifier: GPL-3.0-or-later
"""Several inputs as one cloud: names on the command line, tar archives, coordinate systems."""
import json
import struct
import tarfile

import pytest

from test_cli import FIXTURES, GEO, las, sphere, whittle

PLY = ("ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
       "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float scalar_Intensity\nend_header\n"
       "1 2 3 10 20 30 5\n4 5 6 40 50 60 6\n")
KEYS = struct.Struct("<8H")


@pytest.fixture(name="three")
def make_three(tmp_path):
    paths = tmp_path / "a.las", tmp_path / "c.ply", tmp_path / "d.csv"
    paths[0].write_bytes((FIXTURES / "valid/las-2/input.las").read_bytes())
    paths[1].write_text(PLY)
    paths[2].write_text("x,y,z,class\n7,8,9,6\n")
    return paths


def rows(path):
    names, *lines = path.read_text().splitlines()
    return [dict(zip(names.split(), map(float, line.split()))) for line in lines]


def check_rows(found):
    assert [r["x"] for r in found] == [1000000.01, 1, 4, 7]
    assert [r["intensity"] for r in found] == [65535, 5, 6, 0]
    assert [r["classification"] for r in found] == [2, 0, 0, 6]
    assert [r["blue"] for r in found] == [0, 30, 60, 0]


def test_inputs_are_one_cloud_in_their_order_by_what_attributes_are_called(three, tmp_path):
    done = whittle("convert", *three, tmp_path / "all.xyz", "--header", "plain")
    assert done.returncode == 0, done.stderr
    check_rows(rows(tmp_path / "all.xyz"))
    assert "d.csv has no intensity, red, green, blue: 0 there" in done.stdout
    assert "c.ply and others have no return_number" in done.stdout
    assert "c.ply has no classification: 0 there" in done.stdout


def test_an_archive_says_the_same_as_its_files(three, tmp_path):
    with tarfile.open(tmp_path / "all.tar.gz", "w:gz") as archive:
        for path in three:
            archive.add(path, arcname="scans/" + path.name)
    done = whittle("convert", tmp_path / "all.tar.gz", tmp_path / "all.xyz", "--header", "plain")
    assert done.returncode == 0, done.stderr
    check_rows(rows(tmp_path / "all.xyz"))
    found = json.loads(whittle("info", tmp_path / "all.tar.gz", "--json", "--quick").stdout)
    assert (found["format"], found["points"]) == ("tar", 4)


def test_las_of_the_same_fields_stays_las_and_others_leave_it_the_system(three, tmp_path):
    again = tmp_path / "again.las"
    again.write_bytes(three[0].read_bytes())
    assert whittle("convert", three[0], again, tmp_path / "two.las").returncode == 0
    head = (tmp_path / "two.las").read_bytes()
    assert head[104] == three[0].read_bytes()[104] and head[131:179] == three[0].read_bytes()[131:179]
    (tmp_path / "with.las").write_bytes(las([(b"LASF_Projection", 34735, GEO)]))
    assert whittle("convert", tmp_path / "with.las", three[1], tmp_path / "kept.laz").returncode == 0
    found = json.loads(whittle("info", tmp_path / "kept.laz", "--json", "--quick").stdout)
    assert found["coordinate_system"] == "EPSG:25832" and found["points"] == 4


@pytest.mark.parametrize("other, status, part", [
    (25832, 0, ""), (25833, 65, "b.las is in the coordinate system EPSG:25833, and a.las in EPSG:25832")])
def test_coordinate_systems_must_agree(tmp_path, other, status, part):
    for name, number in (("a.las", 25832), ("b.las", other)):
        keys = KEYS.pack(1, 1, 0, 1, 3072, 0, 1, number)
        (tmp_path / name).write_bytes(las([(b"LASF_Projection", 34735, keys)]))
    done = whittle("convert", tmp_path / "a.las", tmp_path / "b.las", tmp_path / "c.las")
    assert done.returncode == status and part in done.stderr
    assert (tmp_path / "c.las").exists() == (status == 0)


def test_scales_that_do_not_reach_all_tiles_are_widened_and_the_finer_one_is_taken(tmp_path):
    """Tiles a million metres apart, one in 0.1 mm from 0 and one in 10 mm."""
    for name, scale, offset in (("a.las", 1e-4, 0), ("b.las", 1e-2, 1e6)):
        made = bytearray(las([]))
        struct.pack_into("<6d", made, 131, *[scale] * 3, *[offset] * 3)
        (tmp_path / name).write_bytes(made)
    first, second = (rows_of(tmp_path, name) for name in ("a.las", "b.las"))
    assert whittle("convert", tmp_path / "a.las", tmp_path / "b.las", tmp_path / "c.las").returncode == 0
    found = rows_of(tmp_path, "c.las")
    assert [r["x"] for r in found] == pytest.approx([r["x"] for r in first + second], abs=1e-3)
    assert max(abs(r["x"]) for r in found) > 9e5


def rows_of(folder, name):
    out = folder / (name + ".xyz")
    assert whittle("convert", folder / name, out, "--header", "plain").returncode == 0
    return rows(out)


def test_a_sphere_in_parts_is_simplified_as_the_whole(tmp_path):
    lines = ["%.9f %.9f %.9f\n" % p for p in sphere(3000)]
    (tmp_path / "whole.xyz").write_text("".join(lines))
    parts = [tmp_path / f"{i}.xyz" for i in range(3)]
    for i, part in enumerate(parts):
        part.write_text("".join(lines[1000 * i:1000 * (i + 1)]))
    for inputs, out in (([tmp_path / "whole.xyz"], "one"), (parts, "many")):
        done = whittle(*inputs, "--ratio", 0.1, "--outputs", "cloud,mesh,report", "-o", tmp_path / out)
        assert done.returncode == 0, done.stderr
    for name in ("cloud.ply", "mesh.ply"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "many" / name).read_bytes()


def test_no_input_is_replaced_whichever_it_is(three, tmp_path):
    (tmp_path / "link.las").hardlink_to(three[0])
    before = [path.read_bytes() for path in three]
    for out in (three[0], three[2], tmp_path / "link.las"):
        done = whittle("convert", *three, "-o", out.with_suffix(".las") if out == three[0] else out)
        assert done.returncode in (64, 73), done.stdout
    done = whittle("convert", three[1], three[0], "-o", tmp_path / "link.las")
    assert done.returncode == 73 and "is the input itself" in done.stderr
    assert [path.read_bytes() for path in three] == before


@pytest.mark.parametrize("arguments, status, part", [
    (["c.ply", "none.ply", "out.ply"], 66, "none.ply: read: can't open"),
    (["c.ply", "bad.ply", "out.ply"], 65, "bad.ply: line 2"),
    (["-", "-", "out.ply"], 64, "standard input is one input"), (["c.ply", "d.csv"], 64, "no .csv is written"),
    (["", "out.ply"], 64, "a name is missing")])
def test_what_can_not_be_joined_is_told_of_by_its_name(three, tmp_path, arguments, status, part):
    (tmp_path / "bad.ply").write_text("ply\nformat nothing\n")
    done = whittle(*[tmp_path / a if "." in a else a for a in arguments], stdin=three[1].open())
    assert done.returncode == status and part in done.stderr, done.stderr
    assert not (tmp_path / "out.ply").exists()


def test_standard_input_is_one_of_several(three, tmp_path):
    done = whittle("convert", "-", three[2], tmp_path / "out.xyz", "--header", "plain", stdin=three[1].open())
    assert done.returncode == 0, done.stderr
    assert [r["x"] for r in rows(tmp_path / "out.xyz")] == [1, 4, 7]
    assert "standard input has no class: 0 there" in done.stdout


def test_more_files_than_descriptors_are_allowed_at_first(tmp_path):
    parts = [tmp_path / f"{i}.xyz" for i in range(1100)]
    for i, part in enumerate(parts):
        part.write_text(f"{i} 0 0\n")
    done = whittle("convert", *parts, tmp_path / "all.xyz")
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "all.xyz").read_text().splitlines()) == 1100
