# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `whittle measure`, as a user runs it: a square, one over it, and points."""
import json
import os
import subprocess

import pytest

from conftest import sphere

BUILD = os.environ.get("WHITTLE_BUILD", "build/release")
WHITTLE = os.path.join(BUILD, "whittle")
FACES = "element face 2\nproperty list uchar int vertex_indices\n"
SURFACE_KEYS = ("forward", "surface", "backward")


def measure(*arguments):
    return subprocess.run([WHITTLE, "measure", *map(str, arguments)], capture_output=True, text=True, check=False)


def figures(*arguments):
    run = measure(*arguments, "--json")
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


@pytest.fixture(name="square")
def make_square(tmp_path):
    """A function that writes the square of side 3 at a height z, with or without faces, and returns the path."""
    def write(name, z, faces=True):
        path = tmp_path / name
        path.write_text("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
                        + (FACES if faces else "") + f"end_header\n0 0 {z}\n3 0 {z}\n3 3 {z}\n0 3 {z}\n"
                        + ("3 0 1 2\n3 0 2 3\n" if faces else ""))
        return path
    return write


def test_two_surfaces_are_measured_in_both_directions(square):
    found = figures(square("a.ply", 1.5), square("b.ply", 0))
    assert found["method"] == "uniform"
    assert found["a"] == found["b"] == {"points": 4, "triangles": 2}
    assert found["forward"]["samples"] == 4
    assert found["surface"]["samples"] == found["backward"]["samples"] == 100000
    for key in SURFACE_KEYS:
        for figure in ("mean", "rms", "max"):
            assert found[key][figure] == pytest.approx(1.5, abs=1e-12)
            assert found[key][figure + "_rel"] == pytest.approx(1.5 / 18 ** 0.5, abs=1e-12)
    assert found["mean"] == found["hausdorff"] == pytest.approx(1.5, abs=1e-12)
    assert "metro_diagonal" not in found


def test_metro_s_way_has_its_own_diagonal(square):
    found = figures(square("a.ply", 1), square("b.ply", 0), "--method", "metro", "--samples", 1000)
    box = (3, 3, 1)
    growth = 0.04 * sum(x * x for x in box) ** 0.5
    assert found["metro_diagonal"] == pytest.approx(sum((x + growth) ** 2 for x in box) ** 0.5)
    assert found["hausdorff_metro_rel"] == pytest.approx(1 / found["metro_diagonal"])
    assert "surface" not in found
    assert 900 < found["forward"]["samples"] <= 1000 and 900 < found["backward"]["samples"] <= 1000


@pytest.mark.parametrize("a_faces, b_faces, expected", [(True, False, {"forward", "backward"}), (False, True, {"surface", "backward"})])
def test_a_mesh_and_points_are_measured_both_ways(square, a_faces, b_faces, expected):
    found = figures(square("a.ply", 2, a_faces), square("b.ply", 0, b_faces))
    assert expected == found.keys() & set(SURFACE_KEYS)
    for key in expected | {"mean", "hausdorff"}:
        assert (found[key]["max"] if key in expected else found[key]) == pytest.approx(2, abs=1e-12)


@pytest.mark.parametrize("surface", ["closed", "heightfield"])
def test_a_mesh_is_as_far_from_its_scan_as_the_report_says(tmp_path, surface):
    """Points of a sphere, or of its upper half but for a wide hole, which the height field spans."""
    rows = [row for row in sphere(5000).decode().splitlines()
            if surface == "closed" or (float(row.split()[2]) > 0 and abs(float(row.split()[0])) > 0.3)]
    scan = tmp_path / "in.xyz"
    scan.write_text("\n".join(rows))
    subprocess.run([WHITTLE, scan, "--ratio", "0.2", "-q", "--outputs", "mesh,report", "--surface", surface, "-o", f"{tmp_path}/"], check=True)
    told = json.loads((tmp_path / "report.json").read_text())["error"]
    found = figures(tmp_path / "mesh.ply", scan)
    assert found["hausdorff"] == pytest.approx(told["symmetric"]["max"], rel=1e-4)
    assert found["mean"] == pytest.approx(told["symmetric"]["mean"], rel=1e-4)
    for key, name in (("forward", "input_to_mesh"), ("backward", "mesh_to_input")):
        assert found[key]["samples"] == told[name]["samples"]
        for figure in ("mean", "rms", "max"):
            assert found[key][figure] == pytest.approx(told[name][figure], rel=1e-4)


def test_columns_of_a_text_have_the_names_that_are_given(square, tmp_path):
    a, b = square("a.ply", 2), tmp_path / "survey.csv"
    b.write_text("id,chainage,offset,level\n7,0,0,0\n8,3,0,0\n9,3,3,1\n")
    refused = measure(a, b)
    assert refused.returncode == 65 and "name them" in refused.stderr
    for columns in ("x:chainage,y:offset,z:4", "-,x,y,z"):
        for pair in ((a, b), (b, a)):
            found = figures(*pair, "--columns", columns)
            assert found["hausdorff"] == 2 and found["forward" if pair[0] == a else "backward"]["mean"] == 5 / 3
    wrong = measure(a, b, "--columns", "x,y")
    assert wrong.returncode == 64 and "--columns: it takes different names with x, y and z" in wrong.stderr
    neither = measure(a, a, "--columns", "x,y,z")
    assert neither.returncode == 64 and "neither file is text" in neither.stderr


def test_points_against_points_are_measured_both_ways(square, tmp_path):
    a, b = square("a.ply", 1, False), tmp_path / "b.xyz"
    b.write_text("0 0 1\n0 0 0\n0 0 0\n3 4 1\n")  # distances to the corners at z = 1: 0, 1, 1, 1
    found = figures(a, b)
    assert found["forward"] | {"mean": 0.75, "rms": 0.75 ** 0.5, "max": 1} == found["forward"]
    assert found["forward"]["samples"] == found["backward"]["samples"] == 4 and "surface" not in found
    back = [0, 3, 1, (3 ** 2 + 0) ** 0.5]  # (3 0 1) to (0 0 1); (3 3 1) to (3 4 1); (0 3 1) to (0 0 1)
    assert found["backward"]["mean"] == pytest.approx(sum(back) / 4, abs=1e-12)
    assert found["backward"]["max"] == found["hausdorff"] == 3
    assert found["mean"] == pytest.approx((0.75 + sum(back) / 4) / 2, abs=1e-12)
    assert found["mean_rel"] == pytest.approx(found["mean"] / found["diagonal"], rel=1e-12)
    rows = {line[:18].strip(): line[18:].split() for line in measure(a, b).stdout.splitlines()}
    assert rows["points of B to A"][0] == rows["points of A to B"][0] == "4"
    assert rows["Hausdorff"][0] == "3.000000e+00" and "surface of B to A" not in rows
    other = figures(b, a)
    assert (other["forward"]["mean"], other["hausdorff"]) == (found["backward"]["mean"], 3)


def test_a_simplified_cloud_is_a_part_of_its_original(tmp_path):
    (tmp_path / "in.xyz").write_bytes(sphere(5000))
    subprocess.run([WHITTLE, tmp_path / "in.xyz", "--ratio", "0.2", "-q", "-o", tmp_path / "small.ply"], check=True)
    found = figures(tmp_path / "small.ply", tmp_path / "in.xyz", "--threads", 1)
    assert found["backward"]["samples"] == 1000 and found["backward"]["max"] == 0
    assert found["forward"]["samples"] == 5000 and 0 < found["forward"]["mean"] < found["forward"]["max"] < 0.2
    assert figures(tmp_path / "small.ply", tmp_path / "in.xyz", "--threads", 3) == found


@pytest.mark.parametrize("faces", [(False, False), (True, False), (False, True)])
def test_metro_s_way_needs_faces_in_both(square, faces):
    run = measure(square("a.ply", 1, faces[0]), square("b.ply", 0, faces[1]), "--method", "metro")
    assert run.returncode == 65
    assert "the method metro needs faces in both" in run.stderr and run.stdout == ""


def test_the_table_has_the_same_figures(square):
    run = measure(square("a.ply", 1.5), square("b.ply", 0))
    assert run.returncode == 0
    rows = {line[:18].strip(): line[18:].split() for line in run.stdout.splitlines()}
    for label, samples in (("points of B to A", "4"), ("surface of B to A", "100000"), ("surface of A to B", "100000")):
        assert rows[label] == [samples] + ["1.50000e+00"] * 3 + ["3.53553e-01"] * 3
    assert rows["mean of both"][0] == rows["Hausdorff"][0] == "1.500000e+00"


def test_seed_and_threads_do_what_they_say(square, tmp_path):
    tilted = tmp_path / "tilted.ply"
    tilted.write_text(square("a.ply", 0).read_text().replace("3 3 0", "3 3 1"))
    flat = square("b.ply", 0)
    first = figures(tilted, flat, "--samples", 5000, "--threads", 1)
    assert figures(tilted, flat, "--samples", 5000, "--threads", 3) == first
    other = figures(tilted, flat, "--samples", 5000, "--seed", 1)
    assert other["backward"]["mean"] != first["backward"]["mean"]
    assert other["backward"]["mean"] == pytest.approx(first["backward"]["mean"], rel=0.01)


@pytest.mark.parametrize("arguments, complaint", [
    ((), "names of two files"), (("a",), "names of two files"), (("a", "b", "c"), "names of two files"), (("a", "b", "--samples", "0"), "--samples"),
    (("a", "b", "--samples", "-1"), "--samples"), (("a", "b", "--samples", "1e5"), "--samples"),
    (("a", "b", "--seed", "18446744073709551616"), "--seed"), (("a", "b", "--method", "fast"), "--method"),
    (("a", "b", "--threads", "257"), "--threads"), (("a", "b", "--nonsense"), "nonsense"), (("a", "b", "--seed"), "seed")])
def test_wrong_arguments_are_a_usage_error(arguments, complaint):
    run = measure(*arguments)
    assert run.returncode == 64
    assert complaint in run.stderr and run.stdout == ""


def test_files_that_can_t_be_read_are_named(square, tmp_path):
    run = measure(square("a.ply", 0), tmp_path / "nowhere.ply")
    assert run.returncode == 66 and "nowhere.ply" in run.stderr
    (tmp_path / "broken.ply").write_text("ply\nformat ascii 1.0\nelement vertex 4\n")
    run = measure(tmp_path / "broken.ply", square("b.ply", 0))
    assert run.returncode == 65 and "broken.ply" in run.stderr


def test_a_full_disk_is_noticed(square):
    with open("/dev/full", "w", encoding="ascii") as full:
        for extra in ([], ["--json"]):
            run = subprocess.run([WHITTLE, "measure", square("a.ply", 1), square("b.ply", 0), *extra], stdout=full,
                                 stderr=subprocess.PIPE, check=False)
            assert run.returncode == 74


def test_help_goes_to_standard_output():
    run = measure("--help")
    assert run.returncode == 0 and "Exit status" in run.stdout and run.stderr == ""
