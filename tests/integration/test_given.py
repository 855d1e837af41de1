# SPDX-License-Identifier: GPL-3.0-or-later
"""surface=given: the input's own faces are simplified, with the connectivity that they have."""
import collections
import itertools
import json
import math
import os
import pathlib
import struct
import subprocess

import pytest

WHITTLE = pathlib.Path(os.environ.get("WHITTLE_BUILD", "build/release")).resolve() / "whittle"
AROUND, ACROSS = 64, 32


def run(*arguments, **options):
    return subprocess.run([WHITTLE, *map(str, arguments)], capture_output=True, text=True, check=False, **options)


def write_ply(path, vertices, faces, names=("x", "y", "z")):
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property double {n}" for n in names),
             f"element face {len(faces)}", "property list int int vertex_indices", "end_header",
             *(" ".join(f"{x:.17g}" for x in v) for v in vertices), *(" ".join(map(str, (len(f), *f))) for f in faces)]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def read_ply(path):
    """(names, vertices, triangles) of the binary PLY that whittle writes."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    names, form, counts, element = [], "<", {}, None
    for words in (line.split() for line in data[:end].decode("ascii").splitlines()):
        if words[0] == "element":
            element, counts[words[1]] = words[1], int(words[2])
        elif words[0] == "property" and element == "vertex":
            names.append(words[2])
            form += {"double": "d", "float": "f", "float64": "d", "float32": "f", "uchar": "B"}[words[1]]
    row, at = struct.Struct(form), end + counts["vertex"] * struct.calcsize(form)
    vertices = list(row.iter_unpack(data[end:at]))
    size = (len(data) - at) // counts["face"]
    faces = [struct.unpack_from("<B3i", data, at + i * size)[1:] for i in range(counts["face"])]
    return names, vertices, faces


def simplify(path, folder, *options):
    done = run(path, "--outputs", "mesh,report", "-o", folder, *options)
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "report.json").read_text(encoding="utf-8")), *read_ply(folder / "mesh.ply")


def grid(around, across, closed):
    """Quadrilaterals of a grid; where it is closed, its ends are joined both ways."""
    rows, columns = (around, across) if closed else (around - 1, across - 1)
    return [(i * across + j, (i + 1) % around * across + j, (i + 1) % around * across + (j + 1) % across,
             i * across + (j + 1) % across) for i in range(rows) for j in range(columns)]


def torus():
    def place(i, j):
        u, v = 2 * math.pi * i / AROUND, 2 * math.pi * j / ACROSS
        return (3 + math.cos(v)) * math.cos(u), (3 + math.cos(v)) * math.sin(u), math.sin(v)
    return [place(i, j) for i in range(AROUND) for j in range(ACROSS)], grid(AROUND, ACROSS, True)


def hill(n=50):
    vertices = [(i, j, 4 * math.sin(i / 9) * math.cos(j / 7)) for i in range(n) for j in range(n)]
    return vertices, grid(n, n, False)


def tube():
    """With texture coordinates around and along it, and so a seam where they begin and end."""
    vertices = [(math.cos(2 * math.pi * i / AROUND), math.sin(2 * math.pi * (i % AROUND) / AROUND), j / 8, i / AROUND,
                 j / ACROSS) for i in range(AROUND + 1) for j in range(ACROSS)]
    vertices[AROUND * ACROSS:] = [(*vertices[j][:3], 1, j / ACROSS) for j in range(ACROSS)]
    return vertices, grid(AROUND + 1, ACROSS, False)


def edges_of(faces):
    return collections.Counter(tuple(sorted((f[k], f[(k + 1) % 3]))) for f in faces for k in range(3))


@pytest.mark.parametrize("surface", ["given", "auto"])
def test_a_closed_surface_stays_what_it_is(tmp_path, surface):
    vertices, faces = torus()
    path = write_ply(tmp_path / "torus.ply", vertices, faces)
    report, _, found, triangles = simplify(path, tmp_path, "--ratio", 0.2, "--surface", surface, "--placement", "subset")
    wanted = len(vertices) // 5
    assert report["surface"]["kind"] == report["mesh"]["reconstruction"] == "given"
    assert report["surface"]["orientation"] == "faces"
    assert report["mesh"]["vertices"] == len(found) == wanted and len(triangles) == 2 * wanted
    assert report["mesh"]["watertight"] and report["mesh"]["handles"] == 1 and report["mesh"]["components"] == 1
    assert report["mesh"]["self_intersections"] == 0 and report["left_out"] == []
    assert set(found) <= set(vertices)
    assert set(edges_of(triangles).values()) == {2}


def test_a_mesh_goes_in_and_a_mesh_comes_out(tmp_path):
    """Where the output's format has faces, and nobody says what to write; a cloud stays a cloud."""
    vertices, faces = torus()
    mesh, cloud = write_ply(tmp_path / "mesh.ply", vertices, faces), write_ply(tmp_path / "cloud.ply", vertices, [])
    wanted = len(vertices) // 10
    for name in ("small.ply", "small.obj", "small.stl", "small.glb"):
        told = run(mesh, tmp_path / name)
        assert told.returncode == 0 and f"mesh             {2 * wanted} triangles" in told.stdout, told
        assert "given: the input has faces" in told.stdout and "faces, which" not in told.stdout
    assert len(read_ply(tmp_path / "small.ply")[2]) == 2 * wanted
    assert "would write" in run(mesh, tmp_path / "other.ply", "--dry-run").stdout
    with open(mesh, "rb") as file:
        piped = subprocess.run([WHITTLE, "-", "-o", "-"], stdin=file, capture_output=True, check=True).stdout
    (tmp_path / "piped.ply").write_bytes(piped)
    assert (tmp_path / "piped.ply").read_bytes() == (tmp_path / "small.ply").read_bytes()
    assert len(read_ply_cloud(run(mesh, tmp_path / "points.ply", "--outputs", "cloud"), tmp_path / "points.ply")) == wanted
    assert len(read_ply_cloud(run(cloud, tmp_path / "few.ply"), tmp_path / "few.ply")) == wanted
    folder = run(mesh, "-o", tmp_path / "out")
    assert folder.returncode == 0 and f"mesh             {2 * wanted} triangles" in folder.stdout, folder
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["mesh.ply", "report.json"]
    assert len(read_ply(tmp_path / "out/mesh.ply")[2]) == 2 * wanted
    (tmp_path / "here").mkdir()
    own = write_ply(tmp_path / "here/mesh.ply", vertices, faces)
    refused = subprocess.run([WHITTLE, own], cwd=tmp_path / "here", capture_output=True, text=True, check=False)
    assert refused.returncode and "mesh.ply" in refused.stderr and "use -o" in refused.stderr, refused
    assert own.read_bytes() == mesh.read_bytes() and [path.name for path in own.parent.iterdir()] == ["mesh.ply"]
    levels = run(mesh, "--levels", "0.5,0.2", "-o", tmp_path / "levels")
    assert levels.returncode == 0 and (tmp_path / "levels/mesh_0.2.ply").exists()
    assert not list((tmp_path / "levels").glob("cloud*"))
    run(cloud, "-o", tmp_path / "points")
    assert sorted(path.name for path in (tmp_path / "points").iterdir()) == ["cloud.ply", "report.json"]
    without = run(mesh, tmp_path / "small.xyz")
    assert without.returncode == 0 and "its faces, which a .xyz has not" in without.stdout


def read_ply_cloud(done, path):
    assert done.returncode == 0 and b"element face" not in path.read_bytes()[:400], done
    return read_points(path)


def read_points(path):
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    return list(struct.iter_unpack("<3d", data[end:]))


def test_vertices_move_freely_unless_there_are_texture_coordinates(tmp_path):
    vertices, faces = torus()
    plain = write_ply(tmp_path / "torus.ply", vertices, faces)
    textured = write_ply(tmp_path / "textured.ply", [(*v, v[0], v[1]) for v in vertices], faces, ("x", "y", "z", "s", "t"))
    error = {}
    for placement in ("auto", "optimal", "subset"):
        folder = tmp_path / placement
        report, _, found, _ = simplify(plain, folder, "--placement", placement)
        error[placement] = report["error"]["symmetric"]["mean"]
        assert (set(found) <= set(vertices)) == (placement == "subset")
    assert error["auto"] == error["optimal"] < error["subset"]
    _, _, found, _ = simplify(textured, tmp_path)
    assert {v[:3] for v in found} <= set(vertices)
    reconstructed = simplify(plain, tmp_path, "--surface", "closed")[2]
    assert set(reconstructed) <= set(vertices)


def test_edges_are_collapsed_to_where_that_costs_least(tmp_path):
    """Before any refinement; corners and edges of a box stay sharp."""
    path = write_ply(tmp_path / "torus.ply", *torus())
    error = {}
    for placement in ("optimal", "subset"):
        report, _, found, _ = simplify(path, tmp_path, "--placement", placement, "--refine", "none", "--ratio", 0.1)
        error[placement] = report["error"]["symmetric"]["mean"]
        assert (set(found) <= set(torus()[0])) == (placement == "subset")
    assert error["optimal"] < 0.8 * error["subset"]
    report, _, found, triangles = simplify(write_ply(tmp_path / "box.ply", *box()), tmp_path, "--points", 8)
    assert len(triangles) == 12 and report["error"]["symmetric"]["max_rel"] < 1e-6
    assert sorted(tuple(round(c, 4) for c in v) for v in found) == sorted(itertools.product((0, 1), repeat=3))


def box(n=12):
    """The surface of the unit cube, each side of n by n squares."""
    ids, faces = {}, []

    def place(*p):
        return ids.setdefault(p, len(ids))
    for axis, side in itertools.product(range(3), (0, n)):
        for i, j in itertools.product(range(n), repeat=2):
            square = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)][::1 if side else -1]
            faces.append([place(*(c[:axis] + (side,) + c[axis:])) for c in square] if axis != 1 else
                         [place(*(c[:axis] + (side,) + c[axis:])) for c in square[::-1]])
    return [tuple(c / n for c in p) for p in ids], faces


def test_the_cloud_beside_a_mesh_is_its_vertices(tmp_path):
    vertices, faces = torus()
    path = write_ply(tmp_path / "torus.ply", vertices, faces)
    done = run(path, "--outputs", "cloud,mesh,report", "--placement", "subset", "--ratio", 0.1, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    cloud = read_points(tmp_path / "cloud.ply")
    assert sorted(cloud) == sorted(read_ply(tmp_path / "mesh.ply")[1]) and len(cloud) == len(vertices) // 10
    ranked = run(path, "--outputs", "cloud", "-o", tmp_path / "ranked", "--ratio", 1)
    assert ranked.returncode == 0, ranked.stderr
    place = {point: i for i, point in enumerate(read_points(tmp_path / "ranked" / "cloud.ply"))}
    assert [place[point] for point in cloud] == sorted(place[point] for point in cloud)
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert report["points_out"] == len(cloud)


def test_the_mesh_alone_takes_no_work_for_points(tmp_path):
    """Nor is it another one where a cloud is asked for beside it; what is told of points is left open then."""
    path = write_ply(tmp_path / "torus.ply", *torus())
    alone = simplify(path, tmp_path / "alone", "--ratio", 0.1)[0]
    beside = simplify(path, tmp_path / "beside", "--ratio", 0.1, "--outputs", "cloud,mesh,report")[0]
    assert (tmp_path / "alone/mesh.ply").read_bytes() == (tmp_path / "beside/mesh.ply").read_bytes()
    for_points = {"neighbours", "normals", "sides", "dso", "quadrics", "contract", "tangent", "vertices"}
    assert for_points <= beside["timings_ms"].keys() and not for_points & alone["timings_ms"].keys()
    assert alone["error"] == beside["error"] and alone["mesh"] == beside["mesh"]
    assert alone["input"]["noise_level"] is None and alone["cloud"]["contraction_error_rel"] is None


@pytest.mark.parametrize("option", [("--max-error", 1e-3), ("--spacing", 0.1), ("--max-deviation", 0.05), ("--normals", "true"),
                                    ("--reference", "points"), ("--weights", "red:1")])
def test_what_is_asked_of_the_points_is_found(tmp_path, option):
    path = write_ply(tmp_path / "torus.ply", *torus())
    done = run(path, "--outputs", "mesh,report", "-o", tmp_path / "out", *option)
    if option[0] == "--weights":
        assert done.returncode and "red" in done.stderr, done
        return
    assert done.returncode == 0, done.stderr
    assert "contract" in json.loads((tmp_path / "out/report.json").read_text(encoding="utf-8"))["timings_ms"]


def test_it_is_nearer_than_what_is_reconstructed(tmp_path):
    path = write_ply(tmp_path / "torus.ply", *torus())
    error = {}
    for surface in ("given", "closed"):
        report = simplify(path, tmp_path, "--ratio", 0.1, "--surface", surface)[0]
        assert report["surface"]["kind"] == surface
        error[surface] = report["error"]["symmetric"]["mean"]
    assert error["given"] < error["closed"]


def test_borders_keep_their_course(tmp_path):
    vertices, faces = hill()
    path = write_ply(tmp_path / "hill.ply", vertices, faces)
    report, _, found, triangles = simplify(path, tmp_path, "--ratio", 0.1)
    whole = simplify(path, tmp_path, "--ratio", 1, "--refine", "none")[0]["mesh"]
    mesh = report["mesh"]
    assert report["surface"]["kind"] == "given"
    assert mesh["vertices"] == len(vertices) // 10 and mesh["borders"] == 1 and mesh["manifold"]
    assert mesh["border_length"] == pytest.approx(whole["border_length"], rel=0.01)
    assert mesh["area"] == pytest.approx(whole["area"], rel=0.01)
    border = {v for edge, count in edges_of(triangles).items() if count == 1 for v in edge}
    assert len(border) < 3 * math.sqrt(len(vertices)), "borders are simplified, too"
    assert all(min(found[v][0], found[v][1]) < 2 or max(found[v][0], found[v][1]) > 47 for v in border)


@pytest.mark.parametrize("placement", ["subset", "optimal"])
@pytest.mark.parametrize("names", [("s", "t"), ("texture_u", "texture_v")])
def test_texture_coordinates_keep_their_seams(tmp_path, placement, names):
    vertices, faces = tube()
    path = write_ply(tmp_path / "tube.ply", vertices, faces, ("x", "y", "z", *names))
    report, properties, found, triangles = simplify(path, tmp_path, "--ratio", 0.2, "--placement", placement)
    assert properties[3:] == list(names)
    assert report["surface"]["kind"] == "given"
    assert report["mesh"]["borders"] == 2 and report["mesh"]["manifold"], "joined at the seam it is a tube"
    assert set(found) <= set(vertices)
    on_seam = {(v[2], v[3]) for v in found if v[3] in (0, 1)}
    assert report["mesh"]["vertices_split"] == len(on_seam) // 2 > 1
    assert {z for z, s in on_seam if s == 0} == {z for z, s in on_seam if s == 1}
    for f in triangles:
        around = [found[v][3] for v in f]
        assert max(around) - min(around) < 0.4, "no triangle runs over the seam to the picture's other side"
    placed = [note["what"] for note in report["left_out"] if "placement" in note["what"]]
    assert len(placed) == (placement == "optimal")


def notes_of(report):
    return " ".join(note["what"] for note in report["left_out"])


def test_an_obj_with_texture_coordinates_at_its_corners_keeps_them(tmp_path):
    vertices, faces = tube()
    number = {}
    for v in vertices:
        number.setdefault(v[:3], len(number) + 1)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in number] + [f"vt {v[3]!r} {v[4]!r}" for v in vertices]
    lines += ["f " + " ".join(f"{number[vertices[v][:3]]}/{v + 1}" for v in f) for f in faces]
    path = tmp_path / "tube.obj"
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    report, properties, found, triangles = simplify(path, tmp_path, "--ratio", 0.2)
    assert report["input"]["points"] == len(vertices) and report["input"]["points_distinct"] == len(number)
    assert properties == ["x", "y", "z", "s", "t"] and report["mesh"]["vertices_split"] > 1
    assert set(found) <= set(vertices)
    assert all(max(found[v][3] for v in f) - min(found[v][3] for v in f) < 0.4 for f in triangles)
    done = run(path, "--ratio", 0.2, "--outputs", "mesh.obj,mesh.glb", "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    written = [line.split() for line in (tmp_path / "mesh.obj").read_text(encoding="ascii").splitlines()]
    assert [tuple(map(float, words[1:])) for words in written if words[0] == "vt"] == [v[3:] for v in found]
    assert [tuple(int(word.split("/")[1]) - 1 for word in words[1:]) for words in written if words[0] == "f"] == triangles
    glb = (tmp_path / "mesh.glb").read_bytes()
    size = struct.unpack_from("<I", glb, 12)[0]
    described = json.loads(glb[20:20 + size])
    accessor = described["accessors"][described["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]]
    view = described["bufferViews"][accessor["bufferView"]]
    places = list(struct.iter_unpack("<2f", glb[28 + size + view["byteOffset"]:][:view["byteLength"]]))
    assert len(places) == len(found)
    assert all(p == pytest.approx((v[3], 1 - v[4]), abs=1e-6) for p, v in zip(places, found)), "downwards, in glTF"


def test_texture_coordinates_of_each_face_s_own_are_left_out(tmp_path):
    vertices, faces = torus()
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices] + [f"vt {i / 4} {i / 9}" for i in range(4 * len(faces))]
    lines += ["f " + " ".join(f"{v + 1}/{4 * i + k + 1}" for k, v in enumerate(f)) for i, f in enumerate(faces)]
    path = tmp_path / "torus.obj"
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    report, properties, found, _ = simplify(path, tmp_path, "--ratio", 0.2)
    assert properties == ["x", "y", "z"] and len(found) == len(vertices) // 5
    assert report["input"]["points"] == len(vertices) and report["mesh"]["watertight"]
    assert "texture coordinates" in notes_of(report)


def test_faces_that_face_against_each_other_are_turned(tmp_path):
    vertices, faces = torus()
    faces = [tuple(reversed(f)) if i % 5 == 0 else f for i, f in enumerate(faces)]
    report = simplify(write_ply(tmp_path / "t.ply", vertices, faces), tmp_path, "--ratio", 0.2)[0]
    assert report["mesh"]["watertight"] and report["mesh"]["oriented"] and report["mesh"]["volume"] > 0
    turned = 2 * len([f for i, f in enumerate(faces) if i % 5 == 0])
    assert f"{turned} faces faced against" in notes_of(report)


def test_three_sheets_at_an_edge_stay_together(tmp_path):
    n = 20
    vertices = [(i, j, 0) for i in range(n) for j in range(n)] + [(n // 2, j, k) for k in range(1, 9) for j in range(n)]
    wall = [[n // 2 * n + j for j in range(n)], *[[n * n + k * n + j for j in range(n)] for k in range(8)]]
    faces = grid(n, n, False) + [(a[j], b[j], b[j + 1], a[j + 1]) for a, b in zip(wall, wall[1:]) for j in range(n - 1)]
    path = write_ply(tmp_path / "sheets.ply", vertices, faces)
    report, _, found, triangles = simplify(path, tmp_path, "--ratio", 0.2, "--surface", "given")
    assert f"{n} vertices where more than two faces share an edge" in notes_of(report)
    assert {(n / 2, float(j), 0.0) for j in range(n)} <= set(found)
    assert 3 in edges_of(triangles).values() and report["mesh"]["components"] == 1


HOSTILE = {
    "repeated": ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], [(0, 1, 2), (1, 2, 0), (2, 1, 0), (1, 3, 2), (1, 1, 2)]),
    "a polygon of many corners": ([(math.cos(i / 500), math.sin(i / 500), 0) for i in range(3000)], [range(3000)]),
    "a point that is none": ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (float("nan"), 1, 0), (1, 1, 0)],
                             [(0, 1, 2), (1, 3, 2), (1, 4, 2)]),
    "fans at one point": ([(0, 0, 0)] + [(i, j, 1) for i in (1, 2, 3, 4) for j in (1, 2)],
                          [(0, 1, 2), (0, 3, 4), (0, 5, 6), (0, 7, 8)]),
    "a strip with one side": ([((2 + w * math.cos(u / 2)) * math.cos(u), (2 + w * math.cos(u / 2)) * math.sin(u),
                                w * math.sin(u / 2)) for u in (k * math.pi / 10 for k in range(20)) for w in (-1, 1)],
                              [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(19)] + [(38, 39, 0, 1)]),
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("placement", ["subset", "optimal"])
def test_odd_faces_make_a_mesh_or_are_refused(tmp_path, name, placement):
    vertices, faces = HOSTILE[name]
    path = write_ply(tmp_path / "odd.ply", vertices, [tuple(f) for f in faces])
    report, _, found, triangles = simplify(path, tmp_path, "--ratio", 0.3, "--surface", "given",
                                           "--placement", placement)
    assert triangles and all(len(set(f)) == 3 and max(f) < len(found) for f in triangles)
    assert report["mesh"]["oriented"] == (name != "a strip with one side")


@pytest.mark.parametrize("faces, says", [
    ([], "the input has no faces"), ([(0, 0, 1), (2, 2, 2)], "none of the input's 2 triangles"),
    ([(0, 1, 9)], "an index is of no vertex"), ([(0, 1, -1)], "an index is of no vertex")])
def test_what_is_no_surface_is_refused_in_words(tmp_path, faces, says):
    path = write_ply(tmp_path / "none.ply", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], faces)
    done = run(path, "--surface", "given", "--outputs", "mesh", "-o", tmp_path / "out")
    assert done.returncode in (64, 65) and says in done.stderr, done.stderr


def test_faces_of_few_points_don_t_decide(tmp_path):
    vertices = torus()[0]
    path = write_ply(tmp_path / "few.ply", vertices, torus()[1][:100])
    report = simplify(path, tmp_path, "--ratio", 0.3, "--refine", "none")[0]
    assert report["surface"]["kind"] == "closed" and "surface=given takes them" in notes_of(report)


def test_levels_bounds_and_threads(tmp_path):
    path = write_ply(tmp_path / "torus.ply", *torus())
    made = []
    for threads in (1, 2, 3):
        folder = tmp_path / str(threads)
        done = run(path, "--levels", "0.3,0.1", "--outputs", "mesh,cloud,error", "-o", folder, "--threads", threads,
                   "--placement", "optimal")
        assert done.returncode == 0, done.stderr
        made.append({file.name: file.read_bytes() for file in folder.iterdir()})
    assert made[0] == made[1] == made[2] and {"mesh_0.3.ply", "mesh_0.1.ply"} <= made[0].keys()
    assert [len(read_ply(tmp_path / "1" / f"mesh_{r}.ply")[1]) for r in (0.3, 0.1)] == [614, 204]
    report = simplify(path, tmp_path / "bound", "--max-deviation", 0.05)[0]
    assert report["surface"]["kind"] == "given" and report["error"]["input_to_mesh"]["max"] <= 0.05
    assert report["mesh"]["vertices"] < 1000


def test_the_service_says_what_it_took(daemon, tmp_path):
    mesh = write_ply(tmp_path / "torus.ply", *torus()).read_bytes()
    job = daemon.ended(daemon.submit(mesh, "?ratio=0.2&surface=given&outputs=mesh,report"))
    assert job["status"] == "successful", job
    assert job["report"]["surface"]["kind"] == "given" and job["report"]["mesh"]["watertight"]
    cloud = "\n".join(" ".join(map(str, v)) for v in torus()[0]).encode()
    job = daemon.ended(daemon.submit(cloud, "?surface=given&outputs=mesh"))
    assert job["status"] == "failed" and "no faces" in json.dumps(job)


def test_texture_coordinates_of_glb_keep_their_seams(tmp_path):
    """A tube by way of GLB, there and back: whose texture begins and ends at an edge."""
    tube_ply = write_ply(tmp_path / "tube.ply", *tube(), ("x", "y", "z", "s", "t"))
    assert run("convert", tube_ply, tmp_path / "tube.glb").returncode == 0
    assert run(tmp_path / "tube.glb", tmp_path / "small.glb", "--ratio", 0.2).returncode == 0
    assert run("convert", tmp_path / "small.glb", tmp_path / "small.ply").returncode == 0
    names, found, triangles = read_ply(tmp_path / "small.ply")
    assert names == ["x", "y", "z", "s", "t"] and len(triangles) > 100
    given = {tuple(round(c, 4) for c in v) for v in tube()[0]}
    assert {tuple(round(c, 4) for c in v) for v in found} <= given
    assert max(v[3] for v in found) == 1 and min(v[3] for v in found) == 0
    assert all(max(found[i][3] for i in t) - min(found[i][3] for i in t) < 0.5 for t in triangles), "none across the seam"


def test_the_service_takes_glb(daemon, tmp_path):
    mesh = write_ply(tmp_path / "torus.ply", *torus())
    assert run("convert", mesh, tmp_path / "torus.glb").returncode == 0
    data = (tmp_path / "torus.glb").read_bytes()
    job = daemon.ended(daemon.submit(data, "?ratio=0.2&outputs=mesh.glb,report"))
    assert job["status"] == "successful" and job["input"]["format"] == "glb", job
    assert job["report"]["surface"]["kind"] == "given" and job["report"]["mesh"]["watertight"]
    refused = daemon.post("/v1/simplify", data.replace(b'"asset":{"version":"2.0"', b'"extensionsRequired":["EXT_meshopt_compression"],'
                                                       b'"asset":{"version":"2.0"')[:len(data)])
    assert refused.status in (415, 422), refused
