# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds as 3D Tiles: what is in them, where, and how much is missing where tiles aren't shown, measured from outside."""
import collections
import hashlib
import json
import os
import pathlib
import shutil
import struct
import subprocess
import zipfile

import pytest

numpy = pytest.importorskip("numpy", reason="python3-numpy isn't installed: make deps")

WHITTLE = os.path.join(os.environ.get("WHITTLE_BUILD", "build/release"), "whittle")
NODE = pathlib.Path(__file__).parent.parent / "node"
BROWSER = shutil.which("chromium")
POINTS, TILE, ORIGIN = 240000, 20000, (4321000.25, 5432100.5, 250.0)
TYPES = {5121: "u1", 5123: "<u2", 5126: "<f4"}
SHAPES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def whittle(*arguments, status=0):
    done = subprocess.run([WHITTLE, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    return done


def hills(path, points=POINTS, seed=5):
    """Hills in a projected system, denser at one side, with colours, intensity, and something that tiles don't hold."""
    spread = numpy.random.default_rng(seed)
    cloud = numpy.zeros(points, [(name, "<f8") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")] +
                        [("intensity", "<u2"), ("sharpness", "<f4")])
    x, y = 400 * spread.random(points) ** 4, 300 * spread.random(points)
    cloud["x"], cloud["y"] = x + ORIGIN[0], y + ORIGIN[1]
    cloud["z"] = 20 * numpy.sin(x / 30) * numpy.cos(y / 25) + ORIGIN[2]
    cloud["red"], cloud["green"], cloud["blue"] = 255 * x / 400, 255 * y / 300, 77
    cloud["intensity"] = numpy.arange(points) % 65536
    names = {"<f8": "double", "|u1": "uchar", "<u2": "ushort", "<f4": "float"}
    header = "".join(f"property {names[cloud.dtype[name].str]} {name}\n" for name in cloud.dtype.names)
    path.write_bytes(f"ply\nformat binary_little_endian 1.0\nelement vertex {points}\n{header}end_header\n".encode() +
                     cloud.tobytes())
    return cloud


def read_glb(data):
    """Attributes by name, positions in the tileset's axes."""
    magic, version, length, json_bytes, kind = struct.unpack("<4sII I4s", data[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    scene, binary = json.loads(data[20:20 + json_bytes]), data[28 + json_bytes:]
    primitive, = scene["meshes"][0]["primitives"]
    assert primitive["mode"] == 0 and "indices" not in primitive
    found = {}
    for name, number in primitive["attributes"].items():
        accessor = scene["accessors"][number]
        view = scene["bufferViews"][accessor["bufferView"]]
        kind, width = numpy.dtype(TYPES[accessor["componentType"]]), SHAPES[accessor["type"]]
        found[name] = numpy.ndarray((accessor["count"], width), kind, binary, view["byteOffset"],
                                    (view["byteStride"], kind.itemsize))
    node = scene["nodes"][0]
    x, y, z = (found["POSITION"].astype("f8") * node.get("scale", [1, 1, 1]) + node["translation"]).T
    found["place"] = numpy.stack([x, -z, y], 1)
    return found, scene


class Tileset:
    """All of a tileset's tiles, in the order of their tree: (tile, numbers of those above it, attributes)."""

    def __init__(self, read):
        self.json = json.loads(read("tileset.json"))
        self.tiles, self.scenes = [], []
        self._walk(read, self.json["root"], ())
        self.origin = numpy.array(self.json["root"]["transform"][12:15])

    def _walk(self, read, tile, above):
        attributes, scene = read_glb(read(tile["content"]["uri"]))
        number = len(self.tiles)
        self.tiles.append((tile, above, attributes))
        self.scenes.append(scene)
        for child in tile.get("children", []):
            self._walk(read, child, (*above, number))

    def below(self, number):
        return [t for t, (_, above, _) in enumerate(self.tiles) if number in above]

    def places(self, numbers):
        return numpy.concatenate([self.tiles[t][2]["place"] for t in numbers])


@pytest.fixture(name="made", scope="module")
def make_tileset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tileset")
    cloud = hills(folder / "hills.ply")
    whittle(folder / "hills.ply", "--ratio", "1", "-o", folder / "hills.3dtiles")
    return folder, cloud


def in_tiles(cloud, scratch, out, *options, order=lambda tiles: tiles, threads=2):
    """A tileset of more points than the plan's tiles, as if memory had no room for more."""
    whittle("tiles", "plan", cloud, "--scratch", scratch, "--memory", "1G", "--tile-points", TILE, "--outputs", "tileset",
            "--threads", threads, *options)
    for tile in order(whittle("tiles", "list", "--scratch", scratch).stdout.split()):
        whittle("tiles", "run", tile, "--scratch", scratch, "--threads", threads)
    return whittle("tiles", "merge", out, "--scratch", scratch, "--threads", threads)


@pytest.fixture(name="parts", scope="module")
def make_tileset_of_parts(made):
    folder = made[0]
    in_tiles(folder / "hills.ply", folder / "scratch", folder / "parts.3dtiles", "--ratio", "1")
    return folder / "scratch"


@pytest.fixture(name="tileset", scope="module", params=["in memory", "part by part"])
def read_tileset(made, parts, request):
    assert parts
    name = {"in memory": "hills.3dtiles", "part by part": "parts.3dtiles"}[request.param]
    tileset = Tileset(lambda file: (made[0] / name / file).read_bytes())
    tileset.in_memory = request.param == "in memory"
    return tileset


def box_of(tile):
    box = tile["boundingVolume"]["box"]
    assert len(box) == 12 and [box[i] for i in (4, 5, 6, 8, 9, 10)] == [0] * 6
    middle, half = numpy.array(box[:3]), numpy.array([box[3], box[7], box[11]])
    assert (half > 0).all()
    return middle - half, middle + half


def test_it_is_a_tree_of_boxes_that_holds_its_points(tileset):
    assert tileset.json["asset"]["version"] == "1.1" and tileset.json["root"]["refine"] == "ADD"
    assert len(tileset.tiles) > 8 and max(len(above) for _, above, _ in tileset.tiles) >= 2
    assert tileset.json["geometricError"] > tileset.json["root"]["geometricError"] > 0
    for tile, above, attributes in tileset.tiles:
        low, high = box_of(tile)
        assert (attributes["place"] >= low).all() and (attributes["place"] <= high).all()
        for parent in above[-1:]:
            parent_low, parent_high = box_of(tileset.tiles[parent][0])
            assert (low >= parent_low).all() and (high <= parent_high).all()
            assert tile["geometricError"] <= tileset.tiles[parent][0]["geometricError"]
        assert ("children" in tile) == (tile["geometricError"] > 0)


def test_each_point_is_in_one_tile(tileset, made):
    cloud = made[1]
    places = tileset.places(range(len(tileset.tiles))) + tileset.origin
    intensity = numpy.concatenate([a["_INTENSITY"][:, 0] for _, _, a in tileset.tiles])
    colour = numpy.concatenate([a["COLOR_0"] for _, _, a in tileset.tiles])
    expected = numpy.stack([cloud[name] for name in "xyz"], 1)
    mine = numpy.lexsort((places[:, 1].round(3), intensity))
    theirs = numpy.lexsort((expected[:, 1].round(3), cloud["intensity"]))
    assert numpy.abs(places[mine] - expected[theirs]).max() < 1e-4
    assert (intensity[mine] == cloud["intensity"][theirs]).all()
    red = cloud["red"][theirs] / 255
    linear = numpy.where(red <= 0.04045, red / 12.92, ((red + 0.055) / 1.055) ** 2.4)
    assert numpy.abs(colour[mine][:, 0] / 65535 - linear).max() < 1e-4 and (colour[:, 3] == 65535).all()


def test_the_first_tile_has_the_points_of_highest_rank(tileset, made):
    folder = made[0]
    if not tileset.in_memory:
        assert len(tileset.tiles[0][2]["place"]) >= 1 << 15
        return
    whittle(folder / "hills.ply", "--outputs", "cloud", "--ratio", "1", "-o", folder)
    data = (folder / "cloud.ply").read_bytes()
    ranked = numpy.frombuffer(data[data.index(b"end_header\n") + 11:], made[1].dtype)[:1 << 15]
    root = collections.Counter(tileset.tiles[0][2]["_INTENSITY"][:, 0].tolist())
    assert collections.Counter(ranked["intensity"].tolist()) <= root


def test_geometric_errors_are_what_is_missing(tileset):
    spatial = pytest.importorskip("scipy.spatial", reason="python3-scipy isn't installed: make deps")
    checked = 0
    for number, (tile, above, _) in enumerate(tileset.tiles):
        below = tileset.below(number)
        if not below:
            continue
        shown = spatial.cKDTree(tileset.places([*above, number]))
        farthest = shown.query(tileset.places(below))[0].max()
        assert tile["geometricError"] == pytest.approx(farthest, rel=1e-3)
        checked += 1
    assert checked >= 2


def test_the_archive_has_the_same_files_and_an_index(made):
    folder = made[0]
    said = json.loads(whittle(folder / "hills.ply", folder / "hills.3tz", "--ratio", "1", "--json").stdout)
    assert {"file": "tileset", "what": "properties of the points: sharpness"} in said["left_out"]
    with zipfile.ZipFile(folder / "hills.3tz") as archive:
        assert archive.testzip() is None
        members = {info.filename: info for info in archive.infolist()}
        assert archive.namelist()[-1] == "@3dtilesIndex1@"
        index = archive.read("@3dtilesIndex1@")
        tree = folder / "hills.3dtiles"
        files = {str(path.relative_to(tree)) for path in tree.rglob("*") if path.is_file()}
        assert files == set(members) - {"@3dtilesIndex1@"}
        for name in files:
            assert archive.read(name) == (tree / name).read_bytes()
            assert members[name].compress_type == zipfile.ZIP_STORED
    items = [struct.unpack_from("<QQQ", index, at) for at in range(0, len(index), 24)]
    assert items == sorted(items)
    named = {hashlib.md5(name.encode()).digest(): members[name].header_offset for name in files}
    assert {index[at:at + 16]: item[2] for at, item in zip(range(0, len(index), 24), items)} == named


def test_the_same_bytes_for_any_number_of_threads(made):
    folder = made[0]
    for threads in (1, 2, 5):
        whittle(folder / "hills.ply", folder / f"{threads}.3tz", "--ratio", "0.7", "--threads", threads)
    assert len({(folder / f"{threads}.3tz").read_bytes() for threads in (1, 2, 5)}) == 1


def test_a_cloud_in_tiles_of_its_own_becomes_one(made):
    folder = made[0]
    goal = ("--ratio", "0.3")
    whittle("tiles", "plan", folder / "hills.ply", "--scratch", folder / "work", "--memory", "1G", "--tile-points", 40000,
            *goal)
    for tile in whittle("tiles", "list", "--scratch", folder / "work").stdout.split():
        whittle("tiles", "run", tile, "--scratch", folder / "work")
    whittle("tiles", "merge", folder / "merged.3dtiles", "--scratch", folder / "work")
    merged = Tileset(lambda name: (folder / "merged.3dtiles" / name).read_bytes())
    assert len(merged.places(range(len(merged.tiles)))) == POINTS * 3 // 10
    assert merged.json["metadata"]["properties"]["points"] == POINTS * 3 // 10


def files_of(tree):
    """But for those without their names yet, which a kill leaves."""
    return {str(path.relative_to(tree)): path.read_bytes() for path in sorted(tree.rglob("*"))
            if path.is_file() and not path.name.startswith(".")}


def test_parts_are_the_same_whatever_makes_them(made, parts, tmp_path):
    """Order of the tiles, threads, and folder or archive."""
    folder = made[0]
    assert not list(parts.glob("*kept*"))
    in_tiles(folder / "hills.ply", tmp_path / "work", tmp_path / "again.3tz", "--ratio", "1", order=reversed, threads=1)
    with zipfile.ZipFile(tmp_path / "again.3tz") as archive:
        again = {name: archive.read(name) for name in archive.namelist() if not name.startswith("@")}
    assert again == files_of(folder / "parts.3dtiles")


def test_parts_are_the_same_after_kills(made, parts, tmp_path):
    """What is there of the kept points isn't gathered again, and half of them is nothing."""
    folder = made[0]
    shutil.copytree(parts, tmp_path / "work")
    out = tmp_path / "out.3dtiles"
    seen = set()
    for wanted in [".kept.0.*", "kept.0", "kept.0.[0-9]*", "out.3dtiles/tiles/*"]:
        with subprocess.Popen([WHITTLE, "tiles", "merge", out, "--scratch", tmp_path / "work", "-f"],
                              stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            where = tmp_path if "/" in wanted else tmp_path / "work"
            while process.poll() is None and not any(where.glob(wanted)):
                pass
            seen.update([wanted] if process.poll() is None else [])
            process.kill()
    assert seen
    whittle("tiles", "merge", out, "--scratch", tmp_path / "work", "-f")
    assert files_of(out) == files_of(folder / "parts.3dtiles")


def test_some_of_the_points_part_by_part(made, tmp_path):
    """The number is exact, and a part of the ranking is the beginning of it."""
    folder = made[0]
    done = in_tiles(folder / "hills.ply", tmp_path / "work", tmp_path / "some.3dtiles", "--points", 150001)
    assert "150001 of 240000" in done.stdout and "rms" not in done.stdout  # no distances are known
    some = Tileset(lambda file: (tmp_path / "some.3dtiles" / file).read_bytes())
    places = some.places(range(len(some.tiles)))
    assert len(places) == 150001 and some.json["metadata"]["properties"]["points"] == 150001
    whole = Tileset(lambda file: (folder / "hills.3dtiles" / file).read_bytes())
    first = [collections.Counter(t.tiles[0][2]["_INTENSITY"][:, 0].tolist()) for t in (whole, some)]
    assert (first[0] & first[1]).total() > 0.9 * (1 << 15)
    refused = whittle("tiles", "merge", tmp_path / "some.ply", "--scratch", tmp_path / "work", status=64)
    assert "a tileset of more points than memory holds" in refused.stderr


def test_the_service_has_it_as_a_folder(daemon, made):
    folder = made[0]
    data = (folder / "hills.ply").read_bytes()
    job_id = daemon.submit(data, "?ratio=1&outputs=tileset")
    daemon.ended(job_id)
    whole = daemon.curl(f"/v1/jobs/{job_id}/outputs/tileset.3tz")
    assert whole.headers["content-type"] == "application/vnd.maxar.archive.3tz+zip"
    tree = folder / "hills.3dtiles"
    for path in sorted(path.relative_to(tree) for path in tree.rglob("*") if path.is_file()):
        reply = daemon.curl(f"/v1/jobs/{job_id}/tileset/{path}")
        assert reply.status == 200 and reply.body == (tree / path).read_bytes()
        assert reply.headers["content-type"] == {"json": "application/json", "glb": "model/gltf-binary"}[path.suffix[1:]]
        again = daemon.curl(f"/v1/jobs/{job_id}/tileset/{path}", "-H", f"If-None-Match: {reply.headers['etag']}")
        assert again.status == 304
    for absent in ("tiles/99999.glb", "no.json", "tiles/tileset.json"):
        assert daemon.curl(f"/v1/jobs/{job_id}/tileset/{absent}").slug == "no-such-output"
    plain = daemon.submit(data, "?ratio=0.01")
    daemon.ended(plain)
    assert daemon.curl(f"/v1/jobs/{plain}/tileset/tileset.json").slug == "no-such-output"


def test_tileset_json_names_its_folder(made, tmp_path):
    whittle(made[0] / "hills.ply", tmp_path / "tileset.json", "--ratio", "0.1")
    assert sorted(os.listdir(tmp_path)) == ["tiles", "tileset.json"]
    Tileset(lambda name: (tmp_path / name).read_bytes())
    before = (tmp_path / "tileset.json").read_bytes()
    assert "is there already" in whittle(made[0] / "hills.ply", tmp_path / "tileset.json", status=73).stderr
    assert (tmp_path / "tileset.json").read_bytes() == before


def test_it_comes_among_other_outputs(made, tmp_path):
    whittle(made[0] / "hills.ply", "--ratio", "0.02", "--outputs", "tileset,cloud,report", "-o", tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["cloud.ply", "report.json", "tileset.3tz"]
    whittle(made[0] / "hills.ply", "--levels", "0.1,0.02", "--outputs", "tileset", "-o", tmp_path / "lod")
    assert sorted(os.listdir(tmp_path / "lod")) == ["tileset.3tz", "tileset_0.02.3tz", "tileset_0.1.3tz"]


@pytest.mark.parametrize("arguments, says", [
    (["--outputs", "cloud", "-o", "a.3dtiles"], "takes a tileset"),
    (["--levels", "0.2,0.1", "-o", "a.3dtiles"], "of one level"),
])
def test_what_a_folder_of_tiles_does_not_take(made, tmp_path, arguments, says):
    done = subprocess.run([os.path.abspath(WHITTLE), made[0] / "hills.ply", *arguments], cwd=tmp_path,
                          capture_output=True, text=True, check=False)
    assert done.returncode != 0 and says in done.stderr and os.listdir(tmp_path) == []


def test_a_conversion_has_no_ranks(made, tmp_path):
    done = subprocess.run([WHITTLE, "convert", made[0] / "hills.ply", tmp_path / "a.3tz"], capture_output=True, text=True,
                          check=False)
    assert done.returncode != 0 and "most important points first" in done.stderr and os.listdir(tmp_path) == []


@pytest.mark.parametrize("points", [[(5, 6, 7)], [(5, 6, 7)] * 40, [(0, 0, 0), (1e6, 0, 0), (1e6, 1e-3, 0)]])
def test_few_points(tmp_path, points):
    (tmp_path / "few.xyz").write_text("".join("%r %r %r\n" % point for point in points))
    whittle(tmp_path / "few.xyz", tmp_path / "few.3dtiles", "--ratio", "1")
    few = Tileset(lambda name: (tmp_path / "few.3dtiles" / name).read_bytes())
    (tile, _, attributes), = few.tiles
    low, high = box_of(tile)
    assert (attributes["place"] >= low).all() and (attributes["place"] <= high).all()
    places = attributes["place"] + few.origin
    assert {tuple(map(float, point)) for point in points} == {tuple(place) for place in places.round(6)}


def test_normals_are_turned_with_the_points(tmp_path):
    spread = numpy.random.default_rng(1).normal(size=(3000, 3))
    ball = spread / numpy.linalg.norm(spread, axis=1)[:, None]
    lines = ["%.9g %.9g %.9g %.9g %.9g %.9g\n" % (*point, *point) for point in ball]
    (tmp_path / "ball.xyz").write_text("x y z nx ny nz\n" + "".join(lines))
    whittle(tmp_path / "ball.xyz", tmp_path / "ball.3dtiles", "--ratio", "1")
    found = Tileset(lambda name: (tmp_path / "ball.3dtiles" / name).read_bytes())
    (_, _, attributes), = found.tiles
    x, y, z = attributes["NORMAL"].T
    assert numpy.abs(numpy.stack([x, -z, y], 1) - (attributes["place"] + found.origin)).max() < 1e-5
    assert "KHR_materials_unlit" not in found.scenes[0].get("extensionsUsed", [])


def test_tiles_are_valid(made, parts):
    assert parts
    if not (NODE / "node_modules/gltf-validator").exists():
        pytest.skip("gltf-validator isn't installed: npm ci in tests/node")
    tiles = [tile for name in ("hills", "parts") for tile in sorted((made[0] / f"{name}.3dtiles/tiles").iterdir())]
    done = subprocess.run(["node", NODE / "validate_glb.js", *tiles], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("quantize", ["false", "true"])
def test_compressed_is_the_same_when_it_is_read(made, tmp_path, quantize):
    """By the decoder of those who made the compression: tiles, and a mesh with its triangles."""
    if not (NODE / "node_modules/three").exists() or not (NODE / "node_modules/gltf-validator").exists():
        pytest.skip("gltf-validator isn't installed: npm ci in tests/node")
    for packed in ("false", "true"):
        how = ("--quantize", quantize, "--meshopt", packed)
        whittle(made[0] / "hills.ply", tmp_path / f"{packed}.3dtiles", "--ratio", "0.6", *how)
        whittle(made[0] / "hills.ply", tmp_path / f"{packed}.3dtiles/mesh.glb", "--points", "3000", "--surface", "open",
                "--normals", "true", *how)
    plain = sorted((tmp_path / "false.3dtiles").rglob("*.glb"))
    packed = sorted((tmp_path / "true.3dtiles").rglob("*.glb"))
    subprocess.run(["node", NODE / "decode_meshopt.mjs", *packed], check=True)
    done = subprocess.run(["node", NODE / "validate_glb.js", *plain, *packed], capture_output=True, text=True,
                          check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "") and len(plain) == len(packed) > 4
    for one, other in zip(plain, packed):
        data = one.read_bytes()
        json_bytes = struct.unpack("<I", data[12:16])[0]
        length = sum(view["byteLength"] for view in json.loads(data[20:20 + json_bytes])["bufferViews"])
        assert data[28 + json_bytes:][:length] == other.with_name(other.name + ".plain").read_bytes()
        assert other.stat().st_size < 0.8 * one.stat().st_size


def test_quantized_points_are_near_what_they_were(made, tileset):
    folder = made[0]
    whittle(folder / "hills.ply", "--ratio", "1", "--quantize", "true", "-o", folder / "quantized.3dtiles")
    near = Tileset(lambda name: (folder / "quantized.3dtiles" / name).read_bytes())
    for (tile, _, attributes), (_, _, exact) in zip(near.tiles, tileset.tiles, strict=True):
        low, high = exact["place"].min(0), exact["place"].max(0)
        step = (high - low).max() / 65535
        assert numpy.abs(attributes["place"] - exact["place"]).max() <= 0.51 * step
        low, high = box_of(tile)
        assert (attributes["place"] >= low).all() and (attributes["place"] <= high).all()


@pytest.mark.parametrize("quantize", ["false", "true"])
@pytest.mark.parametrize("apart", [0, 4e5])
def test_what_rounding_moves_is_told(tmp_path, apart, quantize):
    """Two bodies far from each other are in one tile; whole numbers stay what they are."""
    spread = numpy.random.default_rng(7)
    points = spread.integers(-500, 500, (4000, 3)) * 2.0 if apart == 0 else spread.normal(size=(4000, 3))
    points[2000:, 0] += apart
    header = "".join(f"property double {axis}\n" for axis in "xyz")
    (tmp_path / "two.ply").write_bytes(
        f"ply\nformat binary_little_endian 1.0\nelement vertex 4000\n{header}end_header\n".encode() + points.tobytes())
    whittle(tmp_path / "two.ply", f"{tmp_path}/out/", "--ratio", "1", "--quantize", quantize, "--outputs", "tileset,report")
    said = json.loads((tmp_path / "out/report.json").read_text(encoding="utf-8"))
    told = [loss["what"] for loss in said["left_out"] if loss["file"] == "tileset"]
    with zipfile.ZipFile(tmp_path / "out/tileset.3tz") as archive:
        found = Tileset(archive.read)
    places = found.places(range(len(found.tiles))) + found.origin
    near, far = (places[places[:, 0] < 2e5], points[points[:, 0] < 2e5])
    off = numpy.abs(numpy.sort(near[:, 0]) - numpy.sort(far[:, 0])).max()
    if apart == 0 and quantize == "false":
        assert told == [] and off == 0
    else:
        text, = told
        assert text.startswith("precision: ") and off <= 1.05 * float(text.split()[-1]) <= 2.2 * off  # two digits


@pytest.mark.parametrize("how", [(), ("--quantize", "true", "--meshopt", "true")], ids=["plain", "packed"])
@pytest.mark.skipif(
    not BROWSER or not shutil.which("node") or not (NODE / "node_modules/3d-tiles-renderer").exists(),
    reason="chromium, node, or what make test-contract installs into tests/node, is not there")
def test_a_viewer_shows_it(made, tileset, tmp_path, how):
    """3d-tiles-renderer: from far off the first tile alone, nearby all that is near; each in the colours it has."""
    shown = tmp_path / "shown.3dtiles" if tileset.in_memory else made[0] / "parts.3dtiles"
    if tileset.in_memory:
        whittle(made[0] / "hills.ply", "--ratio", "1", "-o", shown, *how)
    done = subprocess.run(["node", NODE / "show_tileset.mjs", BROWSER, shown, tmp_path],
                          capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert seen["errors"] == [] and seen["failed"] == []
    sizes = [len(attributes["place"]) for _, _, attributes in tileset.tiles]
    assert seen["far"]["points"] == sizes[0] and seen["far"]["tiles"] == 1
    assert seen["all"]["points"] == sum(sizes) and seen["all"]["tiles"] == len(sizes)
    assert seen["all"]["pixels"] > 2 * seen["far"]["pixels"] > 200
    low, high = (numpy.array(seen["all"][end]) for end in ("low", "high"))
    places = tileset.places(range(len(sizes))) + tileset.origin
    assert numpy.abs(low - places.min(0)).max() < 0.01 and numpy.abs(high - places.max(0)).max() < 0.01
