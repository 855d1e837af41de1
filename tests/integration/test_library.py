# SPDX-License-Identifier: GPL-3.0-or-later
"""libwhittle as it is installed: linked by C and C++ programs through pkg-config, and from Python through numpy."""
import fcntl
import os
import pathlib
import pydoc
import re
import signal
import subprocess
import sys
import threading
import time
import weakref

import pytest

from conftest import BUILD, SANITIZED

ROOT = pathlib.Path(__file__).resolve().parents[2]
numpy = pytest.importorskip("numpy", reason="python3-numpy isn't installed: make deps")
pytestmark = pytest.mark.skipif(SANITIZED, reason="a library with sanitizers can't be loaded by a program without; "
                                                  "unit/test_library.c runs under them")


def run(*command, **options):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def installed(tmp_path_factory):
    """A tree as `make install-library` leaves it, at a prefix that is found nowhere by itself."""
    prefix = tmp_path_factory.mktemp("installed") / "usr"
    config = pathlib.Path(BUILD).name
    with open(pathlib.Path(BUILD) / "library.lock", "w") as lock:  # several processes of pytest, one build folder
        fcntl.flock(lock, fcntl.LOCK_EX)
        install(prefix, config)
    return prefix


def install(prefix, config, *settings):
    run("make", "-C", ROOT, f"config={config}", "install-library", f"PREFIX={prefix}", *settings,
        env={k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")})


def test_the_default_place_is_one_where_python_looks(tmp_path):
    looked_in = run("/usr/bin/python3", "-c", "import sys; print(*sys.path, sep='\\n')", cwd="/").splitlines()
    if not any(folder.startswith("/usr/local/lib/python3") for folder in looked_in):
        pytest.skip("this Python doesn't look into /usr/local")
    with open(pathlib.Path(BUILD) / "library.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        install("/usr/local", pathlib.Path(BUILD).name, f"DESTDIR={tmp_path}")
    module, = tmp_path.rglob("whittle/__init__.py")
    assert f"/{module.parent.parent.relative_to(tmp_path)}" in looked_in
    assert (tmp_path / "usr/local/lib/libwhittle.so.0").is_file()


def flags(installed, *wanted):
    return run("pkg-config", *wanted, "whittle",
               env={**os.environ, "PKG_CONFIG_PATH": str(installed / "lib/pkgconfig")}).split()


def grid(side=60):
    """A wavy sheet: (side * side, 3)."""
    x, y = numpy.meshgrid(numpy.linspace(0, 1, side), numpy.linspace(0, 1, side))
    return numpy.stack([x.ravel(), y.ravel(), 0.1 * numpy.sin(6 * x.ravel())], axis=1)


def sphere(n=4000):
    i = numpy.arange(n) + 0.5
    z, turn = 1 - 2 * i / n, i * 2.399963229728653
    r = numpy.sqrt(1 - z * z)
    return numpy.stack([r * numpy.cos(turn), r * numpy.sin(turn), z], axis=1)


@pytest.mark.parametrize("compiler", [("gcc", "-std=c11"), ("g++", "-std=c++17", "-x", "c++")], ids=["C", "C++"])
@pytest.mark.parametrize("static", [False, True], ids=["shared", "static"])
def test_the_example_builds_against_the_installed_tree(installed, tmp_path, compiler, static):
    cloud, program = tmp_path / "cloud.xyz", tmp_path / "example"
    numpy.savetxt(cloud, sphere())
    link = flags(installed, "--cflags", "--libs", *(["--static"] if static else []))
    if static:
        link = [str(installed / "lib/libwhittle.a") if f == "-lwhittle" else f for f in link]
    run(*compiler, "-pedantic", "-Wall", "-Wextra", "-Werror", ROOT / "tests/library/example.c", "-x", "none", *link,
        "-o", program)
    environment = {**os.environ, "LD_LIBRARY_PATH": str(installed / "lib")}
    said = run(program, cloud, "0.1", env=environment)
    assert re.match(r"400 of 4000 points, the first is number \d+; 796 triangles; largest error 0\.0\d+\n", said), said
    refused = subprocess.run([program, cloud, "7"], capture_output=True, text=True, env=environment, check=False)
    assert refused.returncode == 1 and "ratio" in refused.stderr


def test_only_names_of_the_library_are_exported(installed):
    shared = run("nm", "-D", "--defined-only", installed / "lib/libwhittle.so.0").splitlines()
    names = {line.split()[2].split("@")[0] for line in shared}
    assert names - {"WHITTLE_0"} and all(n.startswith("whittle_") for n in names - {"WHITTLE_0"}), names
    # Of the archive: what templates of the standard library and CGAL leave is weak, and can't collide.
    static = run("nm", "-g", "--defined-only", installed / "lib/libwhittle.a").splitlines()
    strong = {line.split()[2] for line in static if re.match(r"[0-9a-f]+ [TDBR] ", line)}
    assert strong and all(n.startswith("whittle_") for n in strong), sorted(strong)[:20]
    header = (ROOT / "core/whittle.h").read_text()
    declared = set(re.findall(r"^WHITTLE_API [^;]*?\b(whittle_\w+)\(", header, re.M))
    assert declared == names - {"WHITTLE_0"}, declared ^ names


def test_the_soname_is_the_file_s_name(installed):
    assert "Library soname: [libwhittle.so.0]" in run("readelf", "-d", installed / "lib/libwhittle.so.0")
    assert os.readlink(installed / "lib/libwhittle.so") == "libwhittle.so.0"


def test_the_library_keeps_its_version(installed):
    assert flags(installed, "--modversion")[0] == run(ROOT / "deploy/version.sh").strip()


@pytest.fixture(scope="session")
def whittle(installed):
    """The module as it is installed, which finds the library beside it: not that of the sources, which others import."""
    folder = str(installed / "lib/python3/dist-packages")
    others = {name: sys.modules.pop(name) for name in list(sys.modules) if name.partition(".")[0] == "whittle"}
    sys.path.insert(0, folder)
    import whittle as module
    assert pathlib.Path(module.__file__).is_relative_to(installed)
    yield module
    sys.path.remove(folder)
    sys.modules.update(others)


def test_arrays_in_and_arrays_out(whittle):
    points = sphere()
    result = whittle.simplify(points, ratio=0.1, outputs=("cloud", "mesh", "dso", "error"))
    assert result.ids.shape == (400,) and len(set(result.ids)) == 400
    assert (result.points == points[result.ids]).all()
    assert result.mesh.vertices.shape == (400, 3) and result.mesh.triangles.shape == (796, 3)
    assert (result.mesh.vertices == points[result.mesh.sources]).all()
    assert result.report["points_out"] == 400 and result.report["mesh.watertight"] == 1
    assert result.distances.shape == result.operator.shape == (4000,)
    assert 0 < result.distances.max() < 0.1
    a, b, c = (result.mesh.vertices[result.mesh.triangles[:, k]] for k in range(3))
    assert 0.9 * 4.19 < (a * numpy.cross(b, c)).sum() / 6 < 4.19  # outside is outside


def test_attributes_come_with_the_points_in_their_types(whittle):
    points = grid().astype("f4")
    n = len(points)
    colours = numpy.stack([numpy.arange(n) % 256] * 3, axis=1).astype("u1")
    result = whittle.simplify(points, points=500, colors=colours, attributes={"time": numpy.arange(n) / 7,
                                                                              "kept": numpy.arange(n) % 2 == 0})
    columns = result.attributes
    assert {name: c.dtype.str[1:] for name, c in columns.items()} == {
        "red": "u1", "green": "u1", "blue": "u1", "time": "f8", "kept": "u1"}
    assert (columns["red"] == colours[result.ids, 0]).all() and (columns["time"] == result.ids / 7).all()
    assert result.cloud.attributes["x"].dtype == numpy.float32


def test_levels_are_nested(whittle):
    result = whittle.simplify(sphere(), levels=(0.4, 0.1), outputs=("cloud", "mesh"))
    assert [len(level.ids) for level in result.levels] == [1600, 400]
    assert (result.levels[0].ids[:400] == result.levels[1].ids).all()
    assert result.levels[1].mesh.triangles.shape == (796, 3) and result.levels[1].report["ratio"] == 0.1


def test_files_and_their_surfaces(whittle, tmp_path):
    result = whittle.simplify(sphere(), ratio=0.5, outputs="mesh")
    path = tmp_path / "mesh.off"
    with open(path, "w") as out:
        print(f"OFF\n{len(result.mesh.vertices)} {len(result.mesh.triangles)} 0", file=out)
        numpy.savetxt(out, result.mesh.vertices)
        numpy.savetxt(out, numpy.insert(result.mesh.triangles, 0, 3, axis=1), fmt="%d")
    cloud = whittle.Cloud.read(path)
    assert len(cloud) == 2000 and (cloud.triangles == result.mesh.triangles).all()
    of_file = whittle.simplify(path, ratio=0.1, outputs="mesh")
    of_arrays = whittle.simplify(result.mesh.vertices, triangles=result.mesh.triangles, ratio=0.1, outputs="mesh")
    assert (of_file.mesh.triangles == of_arrays.mesh.triangles).all()
    assert (of_file.mesh.vertices == of_arrays.mesh.vertices).all()


def test_triangles_are_simplified_with_their_own_connectivity(whittle):
    n = 40
    points = numpy.array([(i, j, numpy.sin(i / 6) + numpy.cos(j / 5)) for i in range(n) for j in range(n)])
    corners = [(i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1)
               for i in range(n - 1) for j in range(n - 1)]
    triangles = numpy.array([t for a, b, c, d in corners for t in ((a, b, c), (a, c, d))])
    result = whittle.simplify(points, triangles=triangles, ratio=0.1, outputs=("mesh",), surface="given",
                              placement="subset")
    assert result.report["mesh.borders"] == 1 and result.report["mesh.manifold"] == 1
    assert len(result.mesh.vertices) == n * n // 10
    assert (result.mesh.vertices == points[result.mesh.sources]).all()


def test_columns_of_a_text_have_the_names_that_the_caller_says(whittle, tmp_path):
    path, points = tmp_path / "survey.csv", sphere(500)
    numpy.savetxt(path, numpy.column_stack([numpy.arange(500), points]), fmt="%.17g", delimiter=",",
                  header="id,chainage,offset,level", comments="")
    for columns in ("x:chainage,y:offset,z:4", ["-", "x", "y", "z"]):
        assert (whittle.Cloud.read(path, columns=columns).points == points).all()
        result = whittle.simplify(path, columns=columns, ratio=0.1)
        assert (result.points == points[result.ids]).all()
    for source in (path, points, whittle.Cloud(points)):
        with pytest.raises((whittle.Error, ValueError), match="columns"):
            whittle.simplify(source, ratio=0.1, columns=None if source is path else "x,y,z")


def test_a_lid_is_warned_of(whittle):
    """Half a sphere, closed by a disc that no point supports."""
    points = sphere()
    result = whittle.simplify(points[points[:, 2] > 0], ratio=0.3, outputs="mesh", boundary="fill")
    assert result.report["mesh.unsupported_area_share"] > 0.1 and len(result.warnings) == 1
    assert whittle.simplify(points, ratio=0.3, outputs="mesh").warnings == []


def test_results_outlive_what_they_came_from(whittle):
    distances = whittle.simplify(sphere(), ratio=0.1, outputs="error").distances
    for _ in range(5):
        whittle.simplify(grid(), ratio=0.1)
    assert 0 < distances.max() < 0.1 and not distances.flags.writeable


@pytest.mark.parametrize("call, kind, says", [
    (lambda w: w.simplify(sphere(), ratio=3), "Error", "ratio: '3' is not allowed"),
    (lambda w: w.simplify(sphere(), rato=0.1), "Error", "ratio"),
    (lambda w: w.simplify(sphere()[:, :2]), ValueError, "(n, 3) is wanted"),
    (lambda w: w.simplify(sphere() * numpy.nan), "Error", "x: point 0: x is not a finite number"),
    (lambda w: w.simplify(sphere()[:0]), "Error", "0 points"),
    (lambda w: w.simplify(sphere(), attributes={"a": [1, 2]}), ValueError, "attribute a"),
    (lambda w: w.simplify(sphere(), attributes={"a": ["b"] * 4000}), TypeError, "attribute a"),
    (lambda w: w.simplify(sphere(), triangles=[[0, 1, 4000]]), ValueError, "triangles"),
    (lambda w: w.simplify(sphere(), triangles=[[0, 1, -1]]), ValueError, "triangles"),
    (lambda w: w.simplify("/nonexistent.ply"), "Error", "/nonexistent.ply"),
    (lambda w: w.simplify(sphere(), progress=lambda stage, fraction: fraction > 0.3), "Cancelled", "cancelled"),
    (lambda w: w.simplify(sphere(), progress=lambda stage, fraction: 1 / 0), ZeroDivisionError, ""),
], ids=lambda value: "" if callable(value) or isinstance(value, type) else str(value)[:24])
def test_refusals_say_what_and_where(whittle, call, kind, says):
    with pytest.raises(getattr(whittle, kind) if isinstance(kind, str) else kind) as raised:
        call(whittle)
    assert says in str(raised.value)


def ball_of(count):
    normal = numpy.random.default_rng(0).normal(size=(count, 3))
    return normal / numpy.linalg.norm(normal, axis=1)[:, None]


CALLS = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever started the tests may ignore it
sys.path.insert(0, sys.argv[1])
import numpy, whittle
points = numpy.random.default_rng(0).normal(size=(600000, 3))
points /= numpy.linalg.norm(points, axis=1)[:, None]
told = []
def ticking(stage, fraction):
    if not told: print("running", flush=True)
    told.append(stage)
if sys.argv[2] == "silent":
    began = time.time()
    whittle.simplify(points[:60000], ratio=0.1, outputs="mesh")
    tenth = time.time() - began
    print("running", flush=True)
began = time.time()
try:
    whittle.simplify(points, ratio=0.1, outputs="mesh", progress=None if sys.argv[2] == "silent" else ticking)
except BaseException as error:
    late = told == [] and time.time() - began > 5 * tenth
    print(type(error).__name__, *["late"] * late)
else:
    print("ended")
"""


@pytest.mark.parametrize("progress", ["silent", "ticking"])
def test_ctrl_c_cancels_and_comes_out(whittle, progress):
    """Wherever it comes: in the progress function, on the way to it or back, or while the library computes."""
    for wait_s in (0.3, 0.53, 0.71) if progress == "ticking" else (0.5,):
        command = [sys.executable, "-c", CALLS, pathlib.Path(whittle.__file__).parents[1], progress]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout.readline() == "running\n"
            time.sleep(wait_s)  # anywhere in the run, which takes several seconds
            process.send_signal(signal.SIGINT)
            said, errors = process.communicate(timeout=60)
        assert (said, errors) == ("KeyboardInterrupt\n", ""), wait_s


def test_what_progress_raises_comes_out_and_leaves_nothing(whittle):
    class Sudden(BaseException):
        pass

    def fail(stage, fraction):
        raise Sudden(stage)

    points = ball_of(20000)
    for _ in range(3):
        cloud = whittle.Cloud(points)
        gone = weakref.ref(cloud)
        with pytest.raises(Sudden):
            whittle.simplify(cloud, ratio=0.1, progress=fail)
        del cloud
        assert gone() is None
    seen = []
    whittle.simplify(points, ratio=0.1, progress=lambda stage, fraction: seen.append((threading.get_ident(), fraction)))
    assert {thread for thread, _ in seen} == {threading.get_ident()}
    assert [fraction for _, fraction in seen] == sorted(fraction for _, fraction in seen)
    assert not [t for t in threading.enumerate() if t.name == "whittle"]


def test_normals_are_computed_where_the_option_says_so(whittle, tmp_path):
    points, path = sphere(), tmp_path / "ball.xyz"
    numpy.savetxt(path, points)
    for source in (points, path, whittle.Cloud(points)):
        for value in (True, "true", numpy.True_):
            result = whittle.simplify(source, ratio=0.1, normals=value)
            assert result.normals.shape == (400, 3) and result.normals.dtype == numpy.float32
            assert (result.normals * result.points).sum(axis=1).min() > 0.99
        assert whittle.simplify(source, ratio=0.1, normals=False).normals is None
    own = numpy.roll(points, 1, axis=1)
    result = whittle.simplify(points, ratio=0.1, normals=own)
    assert (result.normals == own[result.ids].astype("f4")).all() and result.attributes.keys() == {"nx", "ny", "nz"}
    with pytest.raises(whittle.Error, match="normals: 'maybe'"):
        whittle.simplify(points, normals="maybe")


def test_options_are_taken_as_python_has_them(whittle):
    points = sphere()
    reference = whittle.simplify(points, levels="0.4,0.1", viewpoint="0,0,5").ids
    assert (whittle.simplify(points, levels=numpy.array([0.4, 0.1]), viewpoint=numpy.array([0, 0, 5])).ids
            == reference).all()
    assert len(whittle.simplify(points, ratio=numpy.float64(0.1), quantize=True).ids) == 400
    assert len(whittle.simplify(points, ratio="10%").ids) == 400 and len(whittle.simplify(points, points="1k").ids) == 1000


def test_a_file_s_content_comes_as_bytes(whittle, tmp_path):
    points, path = sphere(), tmp_path / "ball.xyz"
    numpy.savetxt(path, points)
    of_path, content = whittle.simplify(path, ratio=0.1).ids, path.read_bytes()
    for given in (content, bytearray(content), memoryview(content)):
        assert (whittle.simplify(given, ratio=0.1).ids == of_path).all()
    with pytest.raises(whittle.Error, match="byte 0: this looks like a PNG image"):
        whittle.simplify(b"\x89PNG\r\n\x1a\n" + bytes(200))


def test_masked_points_are_refused(whittle):
    points = numpy.ma.array(sphere(), mask=False)
    assert len(whittle.simplify(points, ratio=0.1).ids) == 400
    points[7] = numpy.ma.masked
    with pytest.raises(ValueError, match="masked"):
        whittle.simplify(points, ratio=0.1)


def test_dir_and_help_show_what_there_is(whittle):
    assert set(whittle.__all__) <= set(dir(whittle))
    help_text = pydoc.plain(pydoc.render_doc(whittle))
    assert all(f"{name}(" in help_text for name in ("simplify", "options", "class Cloud", "class Client"))


def test_threads_run_side_by_side(whittle):
    from concurrent.futures import ThreadPoolExecutor
    alone = whittle.simplify(sphere(), ratio=0.1, outputs="cloud")
    with ThreadPoolExecutor(4) as pool:
        ids = list(pool.map(lambda _: whittle.simplify(sphere(), ratio=0.1, outputs="cloud").ids, range(8)))
    assert all((one == alone.ids).all() for one in ids)


def test_to_and_from_open3d(whittle):
    open3d = pytest.importorskip("open3d", reason="python3-open3d isn't installed")
    source = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(sphere()))
    source.colors = open3d.utility.Vector3dVector((sphere() + 1) / 2)
    source.normals = open3d.utility.Vector3dVector(sphere())
    result = whittle.simplify(source, ratio=0.1, outputs=("cloud", "mesh"))
    back = result.to_open3d()
    assert numpy.asarray(back.points).shape == (400, 3) and back.has_colors() and back.has_normals()
    assert numpy.abs(numpy.asarray(back.colors) - (result.points + 1) / 2).max() < 0.003
    mesh = result.mesh.to_open3d()
    assert mesh.is_watertight() and len(whittle.Cloud.of(mesh)) == 400


def test_to_and_from_trimesh(whittle):
    trimesh = pytest.importorskip("trimesh", reason="trimesh isn't installed; Debian 12 has no package of it")
    mesh = whittle.simplify(trimesh.creation.icosphere(4), ratio=0.2, outputs="mesh").to_trimesh()
    assert mesh.is_watertight


def test_options_are_those_of_the_command(whittle):
    names = {option["name"] for option in whittle.options()}
    said = run(pathlib.Path(BUILD).resolve() / "whittle", "--help")
    assert "ratio" in names and all(f"--{n}" in said or f"--{n.replace('_', '-')}" in said for n in names)
