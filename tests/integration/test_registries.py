# SPDX-License-Identifier: GPL-3.0-or-later
"""What is a table in the source takes one more row: a copy of the tree with it is built, and does what the row says."""
import json
import math
import os
import pathlib
import random
import shutil
import subprocess

import pytest

import conftest
import test_tiles as tiles
from test_parameters import torus, write

pytestmark = pytest.mark.skipif(conftest.SANITIZED, reason="sanitizers change nothing here, and the plain run does it")
ROOT = pathlib.Path(__file__).resolve().parents[2]
BUILD = pathlib.Path(os.environ.get("WHITTLE_BUILD", "build/release")).resolve()

HULL = """/* The convex hull: all that is between the points.  SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/surface/cocone/surface.h"
#include "core/surface/reconstruct.h"

enum status reconstruct_hull(const struct reconstruct_task *task, struct mesh *mesh, struct reconstruct_facts *facts) {
    (void)facts;
    const struct reconstruct_input *input = task->input;
    unsigned threads = task->options->threads;
    struct cocone_star star = {0};
    uint8_t *inside = alloc_zeroed(task->tets->cell_count, 1);
    if (!inside) return STATUS_NO_MEMORY;
    memset(inside, 1, task->tets->finite_count);
    enum status status = cocone_star_build(task->tets, input->points, input->n, threads, &star);
    if (!status) status = cocone_surface_extract(&star, input->support, threads, inside, mesh);
    cocone_star_done(&star);
    free(inside);
    return status;
}
"""


@pytest.fixture(name="tree", scope="module")
def copy_tree(tmp_path_factory):
    """The sources with what was built of them, so that make builds no more than what a change makes it build."""
    tree = tmp_path_factory.mktemp("tree")
    for name in ("core", "api", "server", "deploy"):
        shutil.copytree(ROOT / name, tree / name, symlinks=True)
        if (BUILD / name).is_dir():
            shutil.copytree(BUILD / name, tree / "build" / BUILD.name / name)
    shutil.copy2(ROOT / "Makefile", tree)
    yield tree
    shutil.rmtree(tree)


def sources(tree):
    return {str(path.relative_to(tree)): path.read_bytes() for top in ("core", "api", "server", "deploy")
            for path in (tree / top).rglob("*") if path.is_file()}


@pytest.fixture(name="changed")
def changed_files(tree):
    """A function: which files have changed since the test began, or are new."""
    before = sources(tree)
    return lambda: sorted(name for name, content in sources(tree).items() if before.get(name) != content)


def make(tree, program="whittle", *settings):
    environment = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL")}
    target = f"build/{BUILD.name}/{program}"
    run = subprocess.run(["make", "-j2", f"config={BUILD.name}", "CI=true", *settings, target], cwd=tree, env=environment,
                         capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return tree / target


def add_row(path, after, row):
    text = path.read_text(encoding="utf-8")
    assert text.count(after) == 1
    path.write_text(text.replace(after, after + row), encoding="utf-8")


def test_a_reconstruction_is_a_file_and_a_row(tree, changed, tmp_path):
    (tree / "core/surface/hull.c").write_text(HULL, encoding="ascii")
    add_row(tree / "core/surface/reconstruct.h", '"Tight Cocone as published", "Dey and Goswami 2003")',
            ' \\\n    ROW(HULL, hull, "hull", "the convex hull", "Barber and others 1996")')
    assert changed() == ["core/surface/hull.c", "core/surface/reconstruct.h"]
    whittle = make(tree)
    cloud = write(tmp_path / "torus.obj", torus())
    subprocess.run([whittle, cloud, "--reconstruction", "hull", "--surface", "closed", "--refine", "none",
                    "--outputs", "mesh,report", "-o", f"{tmp_path}/", "-q"], check=True)
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert report["params"]["reconstruction"] == "hull"
    mesh = report["mesh"]
    assert mesh["reconstruction"] == "hull" and mesh["watertight"] and mesh["manifold"]
    assert mesh["triangles"] == 2 * mesh["vertices"] - 4  # a sphere, where the surface of the points has a handle
    wrong = subprocess.run([whittle, cloud, "--reconstruction", "ball"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 64 and "it takes one of tight, literal, hull" in wrong.stderr
    text = subprocess.run([whittle, "--help"], capture_output=True, text=True, check=True).stdout
    told = " ".join(text.split("--reconstruction\n")[1].split("\n  --")[0].split())
    assert "hull: the convex hull (Barber and others 1996). one of tight, literal, hull; default tight" in told


TRIPLES = """/* Triples: "TRIPLES", a blank, then three digits for each point.  SPDX-License-Identifier: GPL-3.0-or-later */
#include <string.h>

#include "core/io/build.h"
#include "core/io/first_bytes.h"
#include "core/io/reader.h"

static const char mark[] = "TRIPLES ";
enum { MARK_BYTES = sizeof mark - 1 };

const char *cloud_triples_look(const struct first_bytes *first) {
    return first_begins(first, mark, MARK_BYTES) ? "triples" : "";
}

enum status cloud_triples_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                               const struct progress *progress, struct cloud *cloud, struct error *error) {
    const unsigned char *digit = (const unsigned char *)bytes + MARK_BYTES;
    struct cloud_build build;
    cloud_build_start(&build, "triples", n, limits, progress, error);
    enum status status = STATUS_OK;
    for (int axis = 0; axis < 3 && !status; axis++)
        status = cloud_build_property(&build, (const char[2]){"xyz"[axis]}, SCALAR_UINT8);
    for (size_t i = 0; i < (n - MARK_BYTES) / 3 && !status; i++) {
        const unsigned char point[3] = {digit[3 * i] - '0', digit[3 * i + 1] - '0', digit[3 * i + 2] - '0'};
        status = cloud_build_point(&build, point, (struct cloud_place){0, MARK_BYTES + 3 * i});
    }
    return cloud_build_end(&build, status, cloud);
}
"""


def test_a_format_is_a_file_and_a_row(tree, changed, tmp_path):
    (tree / "core/io/formats/triples_read.c").write_text(TRIPLES, encoding="ascii")
    add_row(tree / "core/io/formats.h", "#define CLOUD_FORMAT_ROWS(ROW) ",
            '\\\n    ROW(TRIPLES, triples, "TRIPLES", "triples of digits", "triples") ')
    assert changed() == ["core/io/formats.h", "core/io/formats/triples_read.c"]
    whittle = make(tree)
    points = [f"{x}{y}{z}" for x in range(4) for y in range(4) for z in range(4)]
    cloud = tmp_path / "cloud"
    cloud.write_text("TRIPLES " + "".join(points), encoding="ascii")
    subprocess.run([whittle, cloud, "--points", "64", "--outputs", "xyz,report", "-o", f"{tmp_path}/", "-q"], check=True)
    kept = (tmp_path / "cloud.xyz").read_text(encoding="ascii").split("\n")[:-1]
    assert sorted(line.replace(" ", "") for line in kept) == points
    assert json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["input"]["format"] == "triples"
    (tmp_path / "image").write_bytes(b"\x89PNG")
    refused = subprocess.run([whittle, tmp_path / "image"], capture_output=True, text=True, check=False)
    assert "this looks like a PNG image; what is read: TRIPLES, tar archives of clouds, PLY, PCD" in refused.stderr
    text = subprocess.run([whittle, "--help"], capture_output=True, text=True, check=True).stdout
    assert "Formats of INPUT: TRIPLES, tar archives of clouds, PLY, PCD" in text


ELSEWHERE = """/* Blobs in the files of another scheme.  SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/blobs/blobs_backend.h"

static bool is_valid(const char *where) { return blobs_file.is_valid(where); }

static enum status open_elsewhere(const char *where, const char *folder, struct blobs **blobs, struct error *error) {
    return blobs_file.open(where, folder, blobs, error);
}

const struct blobs_backend blobs_elsewhere = {.scheme = "elsewhere:", .is_valid = is_valid, .open = open_elsewhere};
"""


def test_a_blob_store_is_a_file_and_a_row(tree, changed, tmp_path):
    (tree / "server/blobs/elsewhere.c").write_text(ELSEWHERE, encoding="ascii")
    add_row(tree / "server/blobs/blobs_backend.h", "    ROW(blobs_s3)", " \\\n    ROW(blobs_elsewhere)")
    assert changed() == ["server/blobs/blobs_backend.h", "server/blobs/elsewhere.c"]
    make(tree)
    whittled = make(tree, "whittled")
    daemon = conftest.Daemon(tmp_path, "--blobs", f"elsewhere:{tmp_path / 'blobs'}")
    daemon.program = whittled
    try:
        job = daemon.start().submit(conftest.SMALL)
        assert daemon.ended(job)["status"] == "successful"
        assert (tmp_path / "blobs/jobs" / job / "outputs").is_dir()
        assert daemon.curl(f"/v1/jobs/{job}/outputs/cloud.ply").status == 200
    finally:
        conftest.end_all([daemon])


def set_line(path, before, after):
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1
    path.write_text(text.replace(before, after), encoding="utf-8")


def spread_of(points):
    """The mean distance of the points to the nearest other one."""
    return sum(min(math.dist(p, q) for q in points if q is not p) for p in points) / len(points)


def kept_points(whittle, cloud, folder):
    folder.mkdir()
    subprocess.run([whittle, cloud, "--points", "60", "--outputs", "xyz", "-o", f"{folder}/", "-q"], check=True)
    lines = (folder / "cloud.xyz").read_text(encoding="ascii").split("\n")[:-1]
    return [tuple(map(float, line.split()[:3])) for line in lines]


def ridge():
    """A plain with a ridge across it."""
    spread = random.Random(7)
    places = [((i + 0.8 * spread.random()) / 40, (j + 0.8 * spread.random()) / 40) for i in range(40) for j in range(40)]
    return [(x, y, 0.2 * max(0, 1 - 10 * abs(x - 0.5))) for x, y in places]


def test_the_cost_is_in_one_file(tree, changed, tmp_path):
    """With nothing but the length of a pair as its cost, the shortest pairs go first wherever they are: what is kept is
    spread wider than by planes, which keep the ridge and little else."""
    cost = tree / "core/simplify/pair_cost.c"
    before = cost.read_text(encoding="utf-8")
    cloud = write(tmp_path / "ridge.obj", ridge())
    by_planes = kept_points(BUILD / "whittle", cloud, tmp_path / "planes")
    set_line(cost, "    return f64_min(e->p_stays, e->q_stays) + f64_all(f->length_bias) * e->length_sq;\n",
             "    return f64_all(f->length_bias) * e->length_sq;\n")
    assert changed() == ["core/simplify/pair_cost.c"]
    try:
        by_length = kept_points(make(tree), cloud, tmp_path / "length")
    finally:
        cost.write_text(before, encoding="utf-8")
    assert len(by_planes) == len(by_length) == 60
    assert spread_of(by_length) > 1.2 * spread_of(by_planes)


ECHO = """
static void get_echo(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response))
        response_text(response, 200, "text/plain", strdup(request->match.capture[0]));
}

const struct handler handlers_get_echo = {.run = get_echo, .quick = true};
"""


def test_a_route_is_a_row_a_handler_and_its_description(tree, changed, tmp_path):
    add_row(tree / "api/routes.def", 'ROUTE(GET_READINESS, get_readiness, "GET", "/readyz", "getReadiness", PUBLIC)',
            '\nROUTE(GET_ECHO, get_echo, "GET", "/v1/echo/{id}", "getEcho", PUBLIC)')
    handlers = tree / "server/handlers/service.c"
    handlers.write_text(handlers.read_text(encoding="utf-8") + ECHO, encoding="utf-8")
    paths = tree / "api/openapi/paths/service.json"
    described = json.loads(paths.read_text(encoding="utf-8"))
    described["/v1/echo/{id}"] = {"get": {"operationId": "getEcho", "summary": "The word.", "security": [], "tags": ["service"],
                                          "responses": {"200": {"description": "It."}}}}
    paths.write_text(json.dumps(described), encoding="utf-8")
    assert changed() == ["api/openapi/paths/service.json", "api/routes.def", "server/handlers/service.c"]
    make(tree)
    whittled = make(tree, "whittled")
    daemon = conftest.Daemon(tmp_path)
    daemon.program = whittled
    try:
        daemon.start()
        answer = daemon.curl("/v1/echo/word")
        assert answer.status == 200 and answer.body.decode() == "word"
        refused = daemon.curl("/v1/echo/word", "-X", "DELETE")
        assert refused.status == 405 and "GET" in refused.headers["allow"]
        assert "/v1/echo/{id}" in json.loads(daemon.curl("/openapi.json").body)["paths"]
    finally:
        conftest.end_all([daemon])


LEDGER = """/* A catalog in the files of another scheme.  SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/catalog_backend.h"

static bool is_valid(const char *where) { return catalog_sqlite.is_valid(where); }

static bool exists(const char *where) { return catalog_sqlite.exists(where); }

static enum status open_ledger(const char *where, bool as_is, struct catalog **catalog, struct error *error) {
    return catalog_sqlite.open(where, as_is, catalog, error);
}

static enum status migrate(const char *where, struct error *error) { return catalog_sqlite.migrate(where, error); }

const struct catalog_backend catalog_ledger = {
    .scheme = "ledger:", .is_valid = is_valid, .exists = exists, .open = open_ledger, .migrate = migrate};
"""


def test_a_catalog_is_a_folder_and_a_row(tree, changed, tmp_path):
    (tree / "server/catalog/ledger").mkdir()
    (tree / "server/catalog/ledger/ledger.c").write_text(LEDGER, encoding="ascii")
    add_row(tree / "server/catalog/catalog_backend.h", "    ROW(catalog_postgres)", " \\\n    ROW(catalog_ledger)")
    assert changed() == ["server/catalog/catalog_backend.h", "server/catalog/ledger/ledger.c"]
    make(tree)
    whittled = make(tree, "whittled")
    daemon = conftest.Daemon(tmp_path, "--catalog", f"ledger:{tmp_path / 'ledger.db'}")
    daemon.program = whittled
    try:
        job = daemon.start().submit(conftest.SMALL)
        assert daemon.ended(job)["status"] == "successful"
    finally:
        conftest.end_all([daemon])
    assert (tmp_path / "ledger.db").stat().st_size > 0


OFF_HEADER = """/* A mesh as OFF.  SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_OFF_WRITE_H
#define WHITTLE_CORE_IO_OUT_OFF_WRITE_H

#include "core/base/status.h"
#include "core/mesh/mesh.h"

enum status mesh_write_off(int fd, const struct mesh *mesh, struct error *error) MUST_CHECK;

#endif
"""
OFF = """/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/off_write.h"

#include "core/io/out/sink.h"

enum status mesh_write_off(int fd, const struct mesh *mesh, struct error *error) {
    struct sink sink;
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    sink_format(&sink, "OFF\\n%zu %zu 0\\n", mesh->vertex_count, mesh->triangle_count);
    for (size_t v = 0; v < mesh->vertex_count; v++)
        sink_format(&sink, "%.17g %.17g %.17g\\n", mesh->vertex[v].x, mesh->vertex[v].y, mesh->vertex[v].z);
    for (size_t t = 0; t < mesh->triangle_count; t++)
        sink_format(&sink, "3 %u %u %u\\n", mesh->triangle[t][0], mesh->triangle[t][1], mesh->triangle[t][2]);
    return sink_done(&sink, STATUS_OK, error);
}
"""
WRITE_OFF = """static enum status write_off(int fd, const struct outputs *o, struct error *error) {
    const struct cloud *cloud;
    const struct mesh mesh = mesh_of(o, &cloud);
    return mesh_write_off(fd, &mesh, error);
}

"""


def add_output(tree):
    """The mesh as mesh.off: its bit, its name, its writer, and what is told of -o."""
    (tree / "core/io/out/off_write.h").write_text(OFF_HEADER, encoding="ascii")
    (tree / "core/io/out/off_write.c").write_text(OFF, encoding="ascii")
    add_row(tree / "core/params.h", "    OUTPUT_CLOUD_COPC = 1 << 14, /* cloud.copc.laz */\n",
            "    OUTPUT_MESH_OFF = 1 << 15,   /* mesh.off */\n")
    set_line(tree / "core/params.h", "| OUTPUT_MESH_GLB\n", "| OUTPUT_MESH_GLB | OUTPUT_MESH_OFF\n")
    set_line(tree / "core/params.h", "PARAMS_OUTPUTS = 15,", "PARAMS_OUTPUTS = 16,")
    set_line(tree / "core/params.c", '"cloud.copc.laz",\n', '"cloud.copc.laz", "mesh.off",\n')
    set_line(tree / "core/params.c", '"copc",\n', '"copc", "off",\n')
    set_line(tree / "core/params.c", "mesh.stl, mesh.glb; ", "mesh.stl, mesh.glb, mesh.off; ")
    set_line(tree / "server/cli/output.c", '#include "core/io/out/obj_write.h"\n',
             '#include "core/io/out/obj_write.h"\n#include "core/io/out/off_write.h"\n')
    set_line(tree / "server/cli/output.c", "static enum status write_report(", WRITE_OFF + "static enum status write_report(")
    add_row(tree / "server/cli/output.c", "static const struct file files[] = {",
            '\n    {OUTPUT_MESH_OFF, "mesh", "off", true, write_off},')
    set_line(tree / "server/cli/help.c", ".stl, .glb, .png or .json is one", ".stl, .glb, .off, .png or .json is one")


def add_parameter(tree):
    set_line(tree / "core/params.h", "    double dso_exponent;\n", "    double dso_exponent;\n    double dso_factor;\n")
    add_row(tree / "core/params.c", "static const struct param table[] = {",
            '\n    {"dso_factor", PARAM_NUMBER, AT(dso_factor), 0, 4, false, "1", NULL, "", true,\n'
            '     "What dso_exponent is multiplied by"},')
    set_line(tree / "core/simplify/point_quadrics.c", "params->dso_exponent,", "params->dso_exponent * params->dso_factor,")


@pytest.fixture(name="widened", scope="module")
def both_built(tree):
    """whittle with one more output and one more parameter, and the files that each took.  Nearly every source includes
    the structure of parameters, so all of them are compiled again, once for both and without optimising."""
    def taken(change):
        before = sources(tree)
        change(tree)
        return sorted(name for name, content in sources(tree).items() if before.get(name) != content)

    files = {change: taken(change) for change in (add_output, add_parameter)}
    scalar = " -DSIMD_SCALAR" if BUILD.name == "scalar" else ""
    return make(tree, "whittle", f"flags_{BUILD.name}=-O0{scalar}"), files


def test_an_output_is_a_writer_a_bit_a_name_and_a_row(widened, tmp_path):
    whittle, files = widened
    assert files[add_output] == ["core/io/out/off_write.c", "core/io/out/off_write.h", "core/params.c", "core/params.h",
                                 "server/cli/help.c", "server/cli/output.c"]
    cloud = write(tmp_path / "torus.obj", torus())
    subprocess.run([whittle, cloud, "--levels", "0.5,0.2", "--outputs", "mesh.off,mesh,report", "-o", f"{tmp_path}/", "-q"],
                   check=True)
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    head, count, *lines = (tmp_path / "mesh.off").read_text(encoding="ascii").splitlines()
    vertices, triangles, _ = map(int, count.split())
    assert head == "OFF" and len(lines) == vertices + triangles
    assert [vertices, triangles] == [report["mesh"]["vertices"], report["mesh"]["triangles"]]
    assert (tmp_path / "mesh_0.2.off").stat().st_size < (tmp_path / "mesh_0.5.off").stat().st_size
    # what it wrote is read again, as the mesh that it is
    told = subprocess.run([whittle, "info", tmp_path / "mesh.off"], capture_output=True, text=True, check=True).stdout
    assert str(triangles) in told.replace(" ", "").replace(",", "")
    subprocess.run([whittle, cloud, tmp_path / "torus.off", "-q"], check=True)  # by its ending alone
    assert (tmp_path / "torus.off").read_text(encoding="ascii").startswith("OFF\n")
    refused = subprocess.run([whittle, cloud, tmp_path / "mesh.dae"], capture_output=True, text=True, check=False)
    assert refused.returncode == 64 and ".off" in refused.stderr


def test_a_parameter_is_a_member_a_row_and_its_use(widened, tmp_path):
    whittle, files = widened
    assert files[add_parameter] == ["core/params.c", "core/params.h", "core/simplify/point_quadrics.c"]
    cloud = write(tmp_path / "torus.obj", torus())

    def kept(name, *options):
        subprocess.run([whittle, cloud, *options, "--outputs", "cloud,report", "-o", tmp_path / name, "-q"], check=True)
        report = json.loads((tmp_path / name / "report.json").read_text(encoding="utf-8"))
        return (tmp_path / name / "cloud.ply").read_bytes(), report["params"]["dso_factor"]

    by_default, none, halved = kept("default"), kept("none", "--dso-factor", "0"), kept("half", "--dso-factor", "0.5")
    assert [by_default[1], none[1], halved[1]] == [1, 0, 0.5]
    assert none[0] == kept("flat", "--dso-exponent", "0")[0] != by_default[0]
    assert halved[0] == kept("eighth", "--dso-exponent", "0.125")[0] != by_default[0]
    # what is larger than memory is weighed by it, too: in tiles, the factor is as the exponent it makes
    def tiled(name, *options):
        return tiles.steps(sheet, tmp_path / name, tmp_path / f"{name}.ply", goal=("--ratio", "0.05", *options), program=whittle)

    sheet = tiles.bumps(tmp_path / "sheet.ply", 20000)
    assert tiled("tiled half", "--dso-factor", "0.5") == tiled("tiled eighth", "--dso-exponent", "0.125") != tiled("tiled")
    wrong = subprocess.run([whittle, cloud, "--dso-factor", "5"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 64
    assert "--dso-factor: '5' is not allowed; it takes a number from 0, at most 4" in wrong.stderr
    text = subprocess.run([whittle, "--help"], capture_output=True, text=True, check=True).stdout
    told = " ".join(text.split("--dso-factor")[1].split("\n  --")[0].split())
    assert "What dso-exponent is multiplied by. a number from 0, at most 4; default 1" in told
