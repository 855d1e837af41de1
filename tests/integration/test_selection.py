# SPDX-License-Identifier: GPL-3.0-or-later
"""What part of a cloud is taken, how far apart its points are kept, and which way normals point: from file to file."""
import itertools
import json
import math
import random
import re
import subprocess

import pytest

from conftest import BUILD

SIDE = 60


def height(x, y):
    return 0.2 * math.sin(6 * x) * math.cos(5 * y)


def hill(chance):
    for i in range(SIDE * SIDE):
        x, y = ((k + chance.uniform(-0.4, 0.4)) / SIDE for k in (i % SIDE, i // SIDE))
        yield x, y, height(x, y)


@pytest.fixture(name="scan", scope="module")
def make_scan(tmp_path_factory):
    """A hill with classes by thirds, in columns of text."""
    path = tmp_path_factory.mktemp("scan") / "scan.csv"
    lines = [f"{x:.5f},{y:.5f},{z:.5f},{int(3 * x) % 3},{i % 256}" for i, (x, y, z) in enumerate(hill(random.Random(3)))]
    path.write_text("x,y,z,class,intensity\n" + "\n".join(lines) + "\n", encoding="ascii")
    return path


def whittle(scan, folder, **options):
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    run = subprocess.run([BUILD / "whittle", scan, "-q", "-o", folder, *words], capture_output=True, text=True,
                         check=False)
    assert run.returncode == 0, run.stderr
    return json.loads((folder / "report.json").read_text())


def rows(path):
    return [tuple(map(float, line.split())) for line in path.read_text().splitlines()]


def ply_rows(path):
    head, body = path.read_text().split("end_header\n")
    count = int(re.search(r"element vertex (\d+)", head)[1])
    names = re.findall(r"property \w+ (\w+)", head[:head.find("element face")])
    return [dict(zip(names, map(float, line.split()))) for line in body.splitlines()[:count]]


def test_no_two_points_are_nearer_than_the_spacing(scan, tmp_path):
    """By comparing all pairs; and no point of the input is left that had room."""
    report = whittle(scan, tmp_path, spacing=0.05, outputs="xyz,report")
    kept = [row[:3] for row in rows(tmp_path / "cloud.xyz")]
    assert min(math.dist(a, b) for a, b in itertools.combinations(kept, 2)) >= 0.05
    everything = [tuple(map(float, line.split(",")[:3])) for line in scan.read_text().splitlines()[1:]]
    assert all(min(math.dist(p, q) for q in kept) < 0.05 for p in everything)
    assert report["spacing"] == {"spacing": 0.05, "points": len(kept)} and report["points_out"] == len(kept)


def test_with_another_goal_the_fewer_points_are_kept(scan, tmp_path):
    most = whittle(scan, tmp_path / "most", spacing=0.05, outputs="xyz,report")["points_out"]
    few = whittle(scan, tmp_path / "few", spacing=0.05, points=100, outputs="xyz,report")
    assert few["points_out"] == 100 and few["spacing"]["points"] == most
    assert rows(tmp_path / "few/cloud.xyz") == rows(tmp_path / "most/cloud.xyz")[:100]
    assert whittle(scan, tmp_path / "all", spacing=0.05, ratio=0.9, outputs="report")["points_out"] == most
    bound = whittle(scan, tmp_path / "bound", spacing=0.05, max_deviation=0.02, outputs="report")
    assert bound["points_out"] <= most and bound["deviation"]["reached"] <= 0.02


def test_a_mesh_with_a_spacing_has_the_points_that_are_kept(scan, tmp_path):
    report = whittle(scan, tmp_path, spacing=0.05, outputs="xyz,mesh,report", refine="none", encoding="ascii")
    kept = {row[:3] for row in rows(tmp_path / "cloud.xyz")}
    found = {(v["x"], v["y"], v["z"]) for v in ply_rows(tmp_path / "mesh.ply")}
    assert found <= kept and len(found) > 0.98 * len(kept)
    assert report["mesh"]["manifold"] and report["mesh"]["oriented"]


def test_what_was_left_out_is_counted(scan, tmp_path):
    whole = rows_of(scan)
    report = whittle(scan, tmp_path, crop="0.1,0.2,-1,0.8,0.9,1", where="class==0|2,intensity>100", ratio=0.5,
                     outputs="xyz,report")
    inside = [r for r in whole if 0.1 <= r[0] <= 0.8 and 0.2 <= r[1] <= 0.9]
    taken = [r for r in inside if r[3] in (0, 2) and r[4] > 100]
    given = report["input"]
    assert given["points"] == len(taken)
    assert given["points_cropped"] == len(whole) - len(inside)
    assert given["points_filtered"] == len(inside) - len(taken)
    assert report["points_out"] == len(taken) // 2
    assert set(rows(tmp_path / "cloud.xyz")) <= set(taken)


def rows_of(scan):
    return [tuple(map(float, line.split(","))) for line in scan.read_text().splitlines()[1:]]


def test_a_cloud_that_was_cut_before_gives_the_same(scan, tmp_path):
    """Cutting is no more than leaving lines out."""
    lines = scan.read_text().splitlines()
    cut = tmp_path / "cut.csv"
    cut.write_text("\n".join(lines[:1] + [line for line in lines[1:] if line.split(",")[3] == "1"]) + "\n")
    whittle(scan, tmp_path / "a", where="class==1", outputs="cloud,mesh,report")
    whittle(cut, tmp_path / "b", outputs="cloud,mesh,report")
    for name in ("cloud.ply", "mesh.ply"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_an_unknown_property_is_told_with_those_there_are(scan, tmp_path):
    run = subprocess.run([BUILD / "whittle", scan, "-o", tmp_path / "out", "--where", "return==1"],
                         capture_output=True, text=True, check=False)
    assert run.returncode == 64
    assert "no property 'return'; it has x, y, z, class, intensity" in run.stderr


def share(truths):
    truths = list(truths)
    return sum(truths) / len(truths)


@pytest.mark.parametrize("surface", ["open", "heightfield"])
def test_normals_face_the_viewpoint_and_change_nothing_else(scan, tmp_path, surface):
    made = {}
    for name, options in {"plain": {}, "up": {"normals": "true"},
                          "down": {"normals": "true", "viewpoint": "0.5,0.5,-8"}}.items():
        made[name] = whittle(scan, tmp_path / name, outputs="cloud,mesh,report", encoding="ascii", surface=surface,
                             **options)
    assert made["plain"]["normals"] == {"source": "computed"}
    assert made["up"]["normals"] == {"source": "computed", "orientation": "upwards"}
    assert made["down"]["normals"] == {"source": "computed", "orientation": "viewpoint"}
    assert made["down"]["surface"]["orientation"] == "viewpoint"
    for file in ("cloud.ply", "mesh.ply"):
        plain, up, down = (ply_rows(tmp_path / name / file) for name in ("plain", "up", "down"))
        places = [[(v["x"], v["y"], v["z"]) for v in rows] for rows in (plain, up, down)]
        assert places[0] == places[1]
        assert file == "mesh.ply" or places[0] == places[2]
        # as the faces do, of which those of a sheet of few points hang over its rim here and there
        least = 0.97 if surface == "open" else 1
        assert share(v["nz"] > 0 for v in up) >= least and share(v["nz"] < 0 for v in down) >= least
        assert all(abs(math.hypot(v["nx"], v["ny"], v["nz"]) - 1) < 1e-5 for v in up)


@pytest.mark.parametrize("kind", ["down", "random"])
def test_normals_of_the_input_count_where_they_fit(tmp_path, kind):
    chance = random.Random(5)
    path = tmp_path / "hill.xyz"
    lines = ["x y z nx ny nz"]
    for x, y, z in hill(chance):
        n = (0, 0, -1) if kind == "down" else [chance.gauss(0, 1) for _ in range(3)]
        lines.append(" ".join(f"{value:.5f}" for value in (x, y, z, *n)))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    report = whittle(path, tmp_path / "out", surface="open", outputs="cloud,mesh,report", encoding="ascii",
                     normals="true")
    assert report["normals"]["source"] == ("given" if kind == "down" else "computed")
    assert report["surface"]["orientation"] == ("normals" if kind == "down" else "upwards")
    assert any("don't fit" in row["what"] for row in report["left_out"]) == (kind == "random")
    written = ply_rows(tmp_path / "out/cloud.ply")
    assert share(v["nz"] == -1 if kind == "down" else v["nz"] > 0 for v in written) >= (1 if kind == "down" else 0.97)


def ptx_scan(z, first):
    """Half of a plane, seen from a height z: in the scanner's own coordinates, which the matrix moves."""
    local = [(x / 30, y / 30, -z) for x in range(30) for y in range(30)]
    lines = ["30", "30", f"{first} 0 {z}", "1 0 0", "0 1 0", "0 0 1", "1 0 0 0", "0 1 0 0", "0 0 1 0",
             f"{first} 0 {z} 1"]
    return lines + [f"{x:.4f} {y:.4f} {z:.4f} 0.5" for x, y, z in local]


def test_each_scan_of_a_file_is_seen_from_its_own_place(tmp_path):
    scan = tmp_path / "two.ptx"
    scan.write_text("\n".join(ptx_scan(1, 0) + ptx_scan(-1, 1.1)) + "\n", encoding="ascii")
    report = whittle(scan, tmp_path / "out", normals="true", outputs="cloud,report", encoding="ascii", ratio=0.5)
    assert report["input"]["format"] == "ptx" and report["input"]["points"] == 1800
    assert report["normals"] == {"source": "computed", "orientation": "viewpoint"}
    for v in ply_rows(tmp_path / "out/cloud.ply"):
        assert abs(v["z"]) < 1e-9 and v["scan"] == (v["x"] > 1)
        assert v["nz"] * (1 if v["scan"] == 0 else -1) > 0.99


@pytest.mark.parametrize("noise,strays,done", [(0, 0, "none"), (0, 0.02, "outliers"), (0.35, 0, "full")])
def test_denoising_is_done_where_it_pays(tmp_path, noise, strays, done):
    """Noise is in distances between points; where nothing is done the result is that without the parameter."""
    chance = random.Random(6)
    points = [(x, y, z + chance.gauss(0, noise / SIDE)) for x, y, z in hill(chance)]
    points += [tuple(chance.uniform(-0.5, 1.5) for _ in range(3)) for _ in range(int(strays * len(points)))]
    path = tmp_path / "scan.xyz"
    path.write_text("\n".join(f"{x:.5f} {y:.5f} {z:.5f}" for x, y, z in points) + "\n", encoding="ascii")
    reports = {form: whittle(path, tmp_path / form, denoise=form, outputs="cloud,report") for form in
               ("none", "outliers", "full", "auto")}
    assert reports["auto"]["denoised"] == done
    same = [(tmp_path / form / "cloud.ply").read_bytes() == (tmp_path / "auto/cloud.ply").read_bytes()
            for form in (done, "auto")]
    assert same == [True, True]
    level = reports["none"]["input"]["noise_level"] * SIDE
    assert abs(level - noise) < 0.1


def test_what_is_thin_without_its_doubles_is_not_smoothed(tmp_path):
    """Two layers are as thick as noise; once the less exact one has gone the other is exact."""
    chance = random.Random(3)
    ways = [[chance.gauss(0, 1) for _ in range(3)] for _ in range(16000)]
    on = [[x / math.hypot(*way) for x in way] for way in ways]
    exact, doubles = on[:8000], [[x + 0.03 * d for x, d in zip(*pair)] for pair in zip(on[:8000], on[8000:])]
    path = tmp_path / "scan.xyz"
    path.write_text("\n".join(f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in exact + doubles) + "\n", encoding="ascii")
    report = whittle(path, tmp_path / "out", outputs="mesh,cloud,report", encoding="ascii")
    assert report["denoised"] == "layers" and 4000 < report["input"]["points_outliers"] < 8000
    written = ply_rows(tmp_path / "out/cloud.ply")
    assert share(abs(math.hypot(v["x"], v["y"], v["z"]) - 1) < 0.01 for v in written) > 0.99


@pytest.mark.parametrize("noise,outputs,done", [(1.2, "mesh,cloud,report", True), (0.05, "mesh,report", False),
                                                (1.2, "cloud,report", False)])
def test_a_shell_is_smoothed_before_a_mesh_is_made_of_it(tmp_path, noise, outputs, done):
    """Noise is in distances between points; clouds alone have points as they came."""
    chance = random.Random(8)
    points = [(x, y, z + chance.gauss(0, noise / SIDE)) for x, y, z in hill(chance)]
    path = tmp_path / "scan.xyz"
    path.write_text("\n".join(f"{x:.5f} {y:.5f} {z:.5f}" for x, y, z in points) + "\n", encoding="ascii")
    report = whittle(path, tmp_path / "default", outputs=outputs)
    assert report["params"]["denoise"] == "noisy"
    assert (report.get("denoised") == "full") == done
    assert any("points were smoothed" in text for text in report.get("warnings", [])) == done
    other = whittle(path, tmp_path / "other", outputs=outputs, denoise="full" if done else "none")
    assert other.get("denoised") == report.get("denoised")
    for name in ("cloud.ply", "mesh.ply"):
        if (tmp_path / "default" / name).exists():
            assert (tmp_path / "default" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()


@pytest.mark.parametrize("strays,doubles,outputs,done", [(0.05, 0, "mesh,cloud,report", "outliers"),
                                                         (0.015, 0, "mesh,report", "outliers"),
                                                         (0.0003, 0, "mesh,report", "outliers"),
                                                         (0.05, 1, "mesh,report", "layers"), (0, 0, "mesh,report", None),
                                                         (0.05, 0, "cloud,report", None)])
def test_strays_and_doubles_get_no_mesh(tmp_path, strays, doubles, outputs, done):
    """Strays, and as many points again, off by a third of the distance between points; clouds alone stay as they
    came."""
    chance = random.Random(9)
    points = list(hill(chance))
    points += [tuple(c + chance.gauss(0, 0.3 / SIDE) for c in p) for p in points[:int(doubles * len(points))]]
    points += [tuple(chance.uniform(-0.5, 1.5) for _ in range(3)) for _ in range(int(strays * len(points)))]
    path = tmp_path / "scan.xyz"
    path.write_text("\n".join(f"{x:.5f} {y:.5f} {z:.5f}" for x, y, z in points) + "\n", encoding="ascii")
    report = whittle(path, tmp_path / "default", outputs=outputs)
    assert report.get("denoised") == done
    assert any("were dropped" in text for text in report.get("warnings", [])) == (done is not None)
    other = whittle(path, tmp_path / "other", outputs=outputs, denoise="auto" if done else "none")
    assert other["input"]["points_outliers"] == report["input"]["points_outliers"]
    for name in ("cloud.ply", "mesh.ply"):
        if (tmp_path / "default" / name).exists():
            assert (tmp_path / "default" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()


def turning(chance):
    """A wall and the ground about a scanner of 32 beams 1.9 m above it, and far posts, with nothing between: beams that
    meet the ground beyond 30 m don't come back."""
    posts = ((9, 3, 0.3), (-20, 14, 0.4), (5, -31, 0.5), (-50, 8, 0.5), (-60, -20, 0.6), (-20, 70, 0.6), (-75, 30, 0.7))
    for column, beam in itertools.product(range(900), range(32)):
        yaw, pitch = 2 * math.pi * column / 900, math.radians(0.75 * beam - 16)
        way = (math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), math.sin(pitch))
        far = 1.9 / -way[2] if way[2] < 0 else math.inf
        far = far if far < 30 else math.inf
        level = math.cos(pitch) ** 2
        for x, y, radius in posts:
            along = way[0] * x + way[1] * y
            inside = along ** 2 - level * (x * x + y * y - radius * radius)
            if inside > 0 and along > 0:
                far = min(far, (along - math.sqrt(inside)) / level)
        if way[0] > 0:
            far = min(far, 20 / way[0])
        if far < 150:
            yield tuple((far + chance.gauss(0, 0.01)) * w for w in way)


@pytest.mark.parametrize("strays", [0, 60])
def test_what_is_far_from_a_scanner_is_no_stray(tmp_path, strays):
    """Its points lie the farther apart the farther they are from where they were seen, which their order tells."""
    chance = random.Random(2)
    points = list(turning(chance))
    for _ in range(strays):
        yaw, far = chance.uniform(1.7, 4.5), chance.uniform(3, 15)
        points.insert(chance.randrange(len(points)), (far * math.cos(yaw), far * math.sin(yaw), chance.uniform(1, 2)))
    path = tmp_path / "scan.xyz"
    path.write_text("\n".join(f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in points) + "\n", encoding="ascii")
    report = whittle(path, tmp_path / "out", outputs="mesh,report")
    assert strays * 0.9 <= report["input"]["points_outliers"] <= strays * 1.1


@pytest.fixture(name="painted", scope="module")
def make_painted(tmp_path_factory):
    """The hill with a lake of no points, half of it red, half blue."""
    path = tmp_path_factory.mktemp("painted") / "painted.xyz"
    lines = ["x y z red green blue"]
    for x, y, z in hill(random.Random(4)):
        if math.hypot(x - 0.7, y - 0.4) > 0.17:
            lines.append(f"{x:.5f} {y:.5f} {z:.5f} {'200 0 0' if x < 0.5 else '0 0 200'}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


@pytest.mark.parametrize("attributes", ["nearest", "mean"])
def test_vertices_that_moved_have_the_colours_around_them(painted, tmp_path, attributes):
    report = whittle(painted, tmp_path, placement="optimal", attributes=attributes, surface="open",
                     outputs="mesh,mesh.obj,mesh.glb,report", encoding="ascii")
    assert not any("properties" in row["what"] for row in report["left_out"])
    vertices = ply_rows(tmp_path / "mesh.ply")
    near = 3 / SIDE if attributes == "nearest" else 8 / SIDE
    for v in vertices:
        if abs(v["x"] - 0.5) > near:
            assert (v["red"], v["green"], v["blue"]) == ((200, 0, 0) if v["x"] < 0.5 else (0, 0, 200))
    mixed = sum(v["red"] * v["blue"] > 0 for v in vertices)
    assert (mixed > 0) == (attributes == "mean")
    first = (tmp_path / "mesh.obj").read_text().splitlines()
    assert len(next(line for line in first if line.startswith("v ")).split()) == 7
    assert b"COLOR_0" in (tmp_path / "mesh.glb").read_bytes()


def test_a_hole_is_closed_and_told(painted, tmp_path):
    for surface in ("open", "heightfield"):
        made = [whittle(painted, tmp_path / f"{surface}-{longest}", surface=surface, outputs="mesh,report",
                        close_holes=longest)["mesh"] for longest in (0.05, 1.5, 100)]
        assert [mesh["borders"] for mesh in made][1:] == [1, 1] and made[0]["borders"] >= 2
        assert [mesh["holes_closed"] for mesh in made][1:] == 2 * [made[0]["borders"] - 1]
        assert made[0]["holes_closed"] == 0
        assert made[0]["hole_fill_triangles"] == 0 < made[1]["hole_fill_triangles"]
        assert all(mesh["manifold"] and mesh["oriented"] for mesh in made)
        assert 0.04 < made[1]["area"] - made[0]["area"] < 0.15  # 0.09 is the area of the hole, more or less triangles


def test_edges_of_colours_draw_points(painted, tmp_path):
    def beside(folder, **options):
        whittle(painted, tmp_path / folder, ratio=0.05, outputs="xyz,report", **options)
        kept = rows(tmp_path / folder / "cloud.xyz")
        return sum(abs(row[0] - 0.5) < 1.5 / SIDE for row in kept) / len(kept)
    assert beside("weighted", weights="rgb:0.5") > 2 * beside("plain")
