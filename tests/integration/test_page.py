# SPDX-License-Identifier: GPL-3.0-or-later
"""The page at /: its files over HTTP, and the whole way through it in Debian's chromium, from a file to its result.
`make test-page` builds the page and installs the browser and its driver."""
import gzip
import hashlib
import html
import json
import math
import pathlib
import re
import shutil
import struct
import subprocess

import pytest

import conftest
from test_parameters import torus
from test_preview import decode

NODE = pathlib.Path(__file__).parent.parent / "page"
SHARED = pathlib.Path(__file__).resolve().parents[3] / "shared" / "data"
BROWSER = shutil.which("chromium")
NOT_BUILT = "the page isn't built: make page"
needs_browser = pytest.mark.skipif(
    not BROWSER or not shutil.which("node") or not (NODE / "node_modules/puppeteer-core").exists(),
    reason="chromium, node, or what make test-page installs into tests/page, is not there")


def files_of(daemon, base=""):
    """Names of all files of the page: those of the document, and those that they name."""
    found, rest = {}, re.findall(r"/page/([\w.-]+)", daemon.curl(f"{base}/").body.decode())
    if not rest:
        pytest.skip(NOT_BUILT)
    while rest:
        name = rest.pop()
        if name not in found:
            found[name] = daemon.curl(f"{base}/page/{name}")
            assert found[name].status == 200, name
            rest += re.findall(r"\./([\w-]+-[0-9a-f]{16}\.js)", found[name].body.decode())
    return found


def test_files_have_exact_types_and_may_be_kept_for_ever(daemon):
    files = files_of(daemon)
    assert len(files) > 10
    for name, reply in files.items():
        kind = {"js": "text/javascript", "css": "text/css"}[name.rsplit(".", 1)[1]]
        assert reply.headers["content-type"] == f"{kind}; charset=utf-8"
        assert reply.headers["cache-control"] == "public, max-age=31536000, immutable"
        assert reply.headers["x-content-type-options"] == "nosniff"
        assert "default-src 'none'" in reply.headers["content-security-policy"]
        assert hashlib.sha256(reply.body).hexdigest()[:16] in name
        packed = daemon.curl(f"/page/{name}", "-H", "Accept-Encoding: br, gzip;q=0.8")
        assert packed.headers["content-encoding"] == "gzip" and gzip.decompress(packed.body) == reply.body
        assert packed.headers["etag"] != reply.headers["etag"] and packed.headers["vary"] == "Accept-Encoding"
        for refused in ("gzip;q=0", "br", "identity"):
            assert "content-encoding" not in daemon.curl(f"/page/{name}", "-H", f"Accept-Encoding: {refused}").headers
        unchanged = daemon.curl(f"/page/{name}", "-H", f"If-None-Match: {reply.headers['etag']}")
        assert unchanged.status == 304 and not unchanged.body
        assert daemon.curl(f"/page/{name}", "-H", 'If-None-Match: "another"').status == 200


def test_the_document_allows_its_own_files_alone(daemon):
    files_of(daemon)
    for path in ("/", "/jobs/01a205bf-bba5-7085-a1bd-0e6236374022"):
        reply = daemon.curl(path)
        policy = dict(rule.strip().split(" ", 1) for rule in reply.headers["content-security-policy"].split(";"))
        assert policy["default-src"] == "'none'"
        assert {policy[name] for name in ("script-src", "style-src", "connect-src", "worker-src")} == {"'self'"}
        assert policy["img-src"] == "'self' blob: data:"
        assert "unsafe" not in reply.headers["content-security-policy"]
        document = reply.body.decode()
        assert "$BASE" not in document and "$HERE" not in document
        assert not re.search(r"<script(?![^>]*src=)|<style|\son\w+=|\sstyle=|https?://(?!127\.0\.0\.1)", document)


def test_a_browser_is_told_that_there_is_no_such_job(daemon):
    reply = daemon.curl("/jobs/nonsense", "-H", "Accept: text/html,application/xhtml+xml,*/*;q=0.8")
    assert reply.status == 404 and reply.headers["content-type"] == "text/html; charset=utf-8"
    assert "Job not found" in reply.body.decode() and '<a href="/">' in reply.body.decode()
    assert daemon.curl("/jobs/nonsense").slug == "no-such-resource"


@pytest.mark.parametrize("name", [
    "..", "../../etc/passwd", "%2e%2e%2f%2e%2e%2fetc%2fpasswd", "..%2fplain.html", "app.js", "index.html", "", "%00",
    "app%00.js", "/etc/passwd", "a" * 200, "app-0000000000000000.js", "%ff%fe", "three-*.js", "files.h", "style.css/x"])
def test_no_other_name_leads_anywhere(daemon, name):
    for method in ("GET", "HEAD"):
        reply = daemon.curl(f"/page/{name}", "--path-as-is", *(["-I"] if method == "HEAD" else []))
        assert reply.status in (400, 404), (name, reply.status)
        assert b"root:" not in reply.body


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_nothing_but_reading_is_allowed(daemon, method):
    for path in ("/page/app.js", "/jobs/01a205bf-bba5-7085-a1bd-0e6236374022"):
        reply = daemon.curl(path, "-X", method)
        assert reply.status == 405 and reply.headers["allow"] == "GET, HEAD"


def test_a_jobs_page_tells_nothing_of_the_job(make_daemon, tmp_path):
    """The document is the same whether there is such a job or not, and what is no id has none."""
    tokens = tmp_path / "tokens"
    tokens.write_text(f"alice:submit,read:{hashlib.sha256(b'secret').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens)
    bearer = ("-H", "Authorization: Bearer secret")
    made = daemon.post("/v1/jobs", conftest.SMALL, *bearer)
    pages = {daemon.curl(f"/jobs/{job}").body for job in (made.json["id"], "01a205bf-bba5-7085-a1bd-0e6236374022")}
    assert len(pages) == 1
    for name in ("..", "none", "%2e%2e", "01a205bf"):
        assert daemon.curl(f"/jobs/{name}", "--path-as-is").status == 404


def walk(url, cloud, folder, *token):
    folder.mkdir(exist_ok=True)
    done = subprocess.run(["node", NODE / "walk.js", BROWSER, url, cloud, folder, *token], capture_output=True, text=True,
                          check=False, timeout=conftest.PATIENCE_S * 3)
    assert done.returncode == 0, done.stderr + done.stdout[-3000:]
    return json.loads(done.stdout)


def hold(seen, daemon, base=""):
    """What holds on every way through."""
    here = f"{daemon.url}{base}/"
    assert [url for url in seen["requests"] if not url.startswith((here, "blob:", "data:"))] == []
    assert [line for line in seen["console"] if not line.startswith(("warn", "debug"))] == []
    assert [error for error in seen["errors"] if "ERR_ABORTED" not in error] == []
    assert [fit for fit in seen["fits"] if fit[2] > fit[3]] == []
    assert {part: found for part, found in seen["violations"].items() if found} == {}


def scan(path):
    """A torus with grooves, coloured, as PLY."""
    lines = [f"{x:.6f} {y:.6f} {z:.6f} {int(100 + 50 * x)} {int(100 + 50 * y)} 90" for x, y, z in torus()]
    head = ["ply", "format ascii 1.0", f"element vertex {len(lines)}", *(f"property float {c}" for c in "xyz"),
            *(f"property uchar {c}" for c in ("red", "green", "blue")), "end_header"]
    path.write_text("\n".join(head + lines) + "\n", encoding="ascii")
    return path


def share_of(path, wanted):
    """Of the pixels for which wanted(r, g, b) holds, by halves: left, right."""
    width, rows = decode(path.read_bytes())
    halves = [0, 0]
    for row in rows:
        for x in range(width):
            halves[2 * x >= width] += wanted(*row[3 * x:3 * x + 3])
    return [n / (width * len(rows) / 2) for n in halves]


@needs_browser
def test_the_whole_way(daemon, tmp_path):
    files_of(daemon)
    seen = walk(f"{daemon.url}/", scan(tmp_path / "torus.ply"), tmp_path / "pictures")
    hold(seen, daemon)
    assert seen["first"]["bytes"] < 250000
    assert "2 592" in seen["facts"].replace("\u202f", " ") and "red" in seen["facts"]
    assert seen["least"].startswith("0.1 %")
    goal = re.match(r"(20|19\.\d|2\d(\.\d)?) %: (\d+) of", seen["goal"].replace("\u202f", ""))
    assert goal, seen["goal"]
    kept = int(goal[3])
    assert f"{daemon.url}/v1/jobs?ratio=0.2" in seen["command"] and "outputs=cloud,mesh,error,preview.png" in seen["command"]
    assert re.match(r"Needs up to [\d.]+ MiB of memory \([\d.]+ [MG]iB available\)( and about [\d.]+ s)?\.$", seen["plan"]), seen["plan"]
    before, after = seen["shown"]["layers"]
    assert before["shown"] == before["count"] == 2592 and after["triangles"] == 2 * kept, seen["shown"]
    assert f"{kept} of 2592" in seen["figures"].replace("\u202f", "")
    assert [shown for wanted, shown, _ in seen["levels"] if wanted == shown] == [1, round(kept * 10 ** -1.5), kept]
    assert re.match(rf"{kept} of {kept} points, 2\d", seen["levels"][2][2].replace("\u202f", "").replace(" %", "%"))
    assert re.match(r"[\d.]+ between the two places", seen["measured"]), seen["measured"]
    sides = [float(side) for side in seen["box"].split(" in ")[0].split(" × ")]
    spans = [max(values) - min(values) for values in zip(*torus())]
    assert all(abs(a - b) < 0.002 for a, b in zip(sides, spans)), (seen["box"], spans)
    assert seen["again"].replace("\u202f", "").startswith(goal[0][:4])
    assert len(seen["cards"]) == 1 and "torus.ply" in seen["cards"][0]


@needs_browser
def test_pictures_show_deviation_on_the_left_and_the_mesh_on_the_right(daemon, tmp_path):
    files_of(daemon)
    folder = tmp_path / "pictures"
    walk(f"{daemon.url}/", scan(tmp_path / "torus.ply"), folder)

    def drawn(r, g, b):
        return abs(r - 250) + abs(g - 250) + abs(b - 248) > 12

    def hot(r, g, b):
        return r > g + 40 and g > b
    left, right = share_of(folder / "side.png", drawn)
    assert 0.08 < left < 0.7 and 0.08 < right < 0.7 and abs(left - right) < 0.12, (left, right)
    hot_left, _ = share_of(folder / "side.png", hot)
    assert hot_left > 0.01
    assert (folder / "turned.png").read_bytes() != (folder / "cloud.png").read_bytes()


@needs_browser
def test_with_a_token_and_below_a_path(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"alice:submit,read:{hashlib.sha256(b'secret').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens, "--base-path", "/whittle")
    files_of(daemon, "/whittle")
    seen = walk(f"{daemon.url}/whittle/", scan(tmp_path / "torus.ply"), tmp_path / "pictures", "secret")
    seen["console"] = [line for line in seen["console"] if "401" not in line]
    hold(seen, daemon, "/whittle")
    assert seen["address"].startswith(f"{daemon.url}/whittle/jobs/") and len(seen["cards"]) == 1


@needs_browser
def test_a_large_cloud_is_seen_before_it_is_there(daemon, tmp_path):
    """The first view takes a small part of the bytes; then all points come, and nothing but what was asked for."""
    files_of(daemon)
    n = 400000
    body = b"".join(struct.pack("<3f", i % 631, i // 631, 20 * math.sin(i % 631 / 40)) for i in range(n))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {n}\n" + "".join(f"property float {c}\n" for c in "xyz")
    job = daemon.submit(head.encode() + b"end_header\n" + body, "?ratio=0.25&outputs=cloud,dso")
    assert daemon.ended(job)["status"] == "successful"
    done = subprocess.run(["node", NODE / "measure.js", BROWSER, f"{daemon.url}/jobs/{job}", tmp_path / "seen.png"],
                          capture_output=True, text=True, check=False, timeout=conftest.PATIENCE_S * 3)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    before, after = seen["layers"]
    assert before["shown"] == before["count"] == n and after["shown"] == after["count"] == n // 4
    assert before["fetched"] + after["fetched"] > n * 12
    assert seen["first_view_bytes"] < 1000000 < seen["bytes"] / 4
    assert seen["page_bytes"] < 250000 < seen["first_view_bytes"] < seen["prefix_bytes"] and 50000 * 12 < seen["prefix_bytes_of_result"] < 1000000 - seen["page_bytes"]
    assert seen["memory_bytes"]["arrays"] + seen["memory_bytes"]["scripts"] > n * 12 and seen["memory_bytes"]["renderer"] > n * 12
    assert min(seen["frame_processor_ms"].values()) > 0 < seen["longest_task_processor_ms"]
    assert before["fetched"] + after["fetched"] < seen["bytes"] < before["fetched"] + after["fetched"] + 500000


@pytest.mark.skipif(not shutil.which("node"), reason="node isn't installed")
@pytest.mark.parametrize("quantize", ["false", "true"])
def test_packed_tiles_are_unpacked_to_the_byte(tmp_path, quantize):
    cloud = scan(tmp_path / "torus.ply")
    for packed in ("false", "true"):
        subprocess.run([conftest.BUILD / "whittle", cloud, tmp_path / f"{packed}.3dtiles", "--ratio", "0.8", "--normals", "true", "--quantize", quantize, "--meshopt", packed, "-q"], check=True)
    plain, packed = (sorted(tmp_path.glob(f"{each}.3dtiles/tiles/*.glb")) for each in ("false", "true"))
    subprocess.run(["node", NODE / "unpack.mjs", *packed], check=True)
    for one, other in zip(plain, packed, strict=True):
        data = one.read_bytes()
        length, = struct.unpack("<I", data[12:16])
        views = json.loads(data[20:20 + length])["bufferViews"]
        assert data[28 + length:][:sum(view["byteLength"] for view in views)] == other.with_name(f"{other.name}.plain").read_bytes()
    whole = packed[0].read_bytes()
    (tmp_path / "short.glb").write_bytes(whole[:-200] + bytes(200))
    done = subprocess.run(["node", NODE / "unpack.mjs", tmp_path / "short.glb"], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "isn't whole" in done.stderr


def write_meshes(folder):
    """A tetrahedron far from the origin in every form of a mesh, and its corners, x, y, z, red, green, blue."""
    places = [[512345.25, 4123456.5, 100, 255, 0, 10], [512347.5, 4123456.5, 100, 0, 200, 20], [512345.25, 4123459.5, 100, 30, 40, 250], [512345.25, 4123456.5, 104, 7, 77, 177]]
    rows = [*(" ".join(map(str, place)) for place in places), "3 0 2 1", "3 0 1 3", "3 1 2 3", "3 2 0 3"]
    names = [*(f"property double {c}" for c in "xyz"), *(f"property uchar {c}" for c in ("red", "green", "blue"))]
    folder.mkdir()
    (folder / "mesh.ply").write_text("\n".join(["ply", "format ascii 1.0", "element vertex 4", *names, "element face 4",
                                                "property list uchar int vertex_indices", "end_header", *rows, ""]))
    (folder / "places.json").write_text(json.dumps(places))
    whittle = conftest.BUILD / "whittle"
    for name in ("mesh.obj", "mesh.stl", "mesh.glb"):
        subprocess.run([whittle, "convert", folder / "mesh.ply", folder / name, "-q"], check=True)
    subprocess.run([whittle, folder / "mesh.ply", folder / "mesh_small.glb", "--ratio", "1", "--placement", "subset", "--meshopt", "true",
                    "--quantize", "true", "-q"], check=True)
    return folder


@pytest.mark.skipif(not shutil.which("node"), reason="node isn't installed")
def test_modules_without_a_window(tmp_path):
    """Numbers, PLY, colours, layers, and tiles of points whose colours, normals and intensity tell where they are."""
    if not (NODE.parents[1] / "server/page/node_modules/three").exists():
        pytest.skip(NOT_BUILT)
    rows = []
    for i in range(120000):
        z, turn = 1 - (2 * i + 1) / 120000, i * math.pi * (3 - math.sqrt(5))
        facing = math.sqrt(1 - z * z) * math.cos(turn), math.sqrt(1 - z * z) * math.sin(turn), z
        place = [128 + 100 * c for c in facing]
        rows.append(struct.pack("<3f3f3BH", *place, *facing, *(round(c) for c in place), round(place[0])))
    names = [*(f"float {c}" for c in ("x", "y", "z", "nx", "ny", "nz")), *(f"uchar {c}" for c in ("red", "green", "blue")), "ushort intensity"]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n" + "".join(f"property {name}\n" for name in names)
    (tmp_path / "ball.ply").write_bytes(head.encode() + b"end_header\n" + b"".join(rows))
    subprocess.run([conftest.BUILD / "whittle", tmp_path / "ball.ply", tmp_path / "ball.3dtiles", "--ratio", "0.9", "--normals", "true", "-q"], check=True)
    done = subprocess.run(["node", NODE / "modules.mjs", write_meshes(tmp_path / "meshes"), tmp_path / "ball.3dtiles"], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and len(done.stdout.splitlines()) == 13, done.stdout + done.stderr


@needs_browser
def test_a_real_scan(daemon, tmp_path):
    cloud = SHARED / "horse.points.ply"
    if not cloud.exists():
        pytest.skip("../shared/data/horse.points.ply isn't there")
    files_of(daemon)
    seen = walk(f"{daemon.url}/", cloud, tmp_path / "pictures")
    hold(seen, daemon)
    assert seen["shown"]["layers"][0]["count"] == 48485


def test_the_reference_begins_with_how_to_upload_at_the_address_it_was_asked_at(make_daemon, tmp_path):
    """The first line for a shell does what it says."""
    daemon = make_daemon("--base-path", "/whittle")
    text = html.unescape(daemon.curl("/whittle/docs").body.decode())
    assert text.index("How to upload a cloud") < text.index('id="jobs"')
    here = daemon.url.removeprefix("http://") + "/whittle"
    line = re.search(r"<pre[^>]*>(curl .*?)</pre>", text)[1]
    assert here in line and "localhost:8080" not in text
    (tmp_path / "scan.ply").write_bytes(conftest.SMALL)
    subprocess.run(line, shell=True, cwd=tmp_path, check=True)
    assert (tmp_path / "small.ply").read_bytes().startswith(b"ply")
    picture = re.search(r"<pre[^>]*>(curl .*-o preview\.png)</pre>", text)[1]
    subprocess.run(picture, shell=True, cwd=tmp_path, check=True)
    assert decode((tmp_path / "preview.png").read_bytes())[0] > 500
    assert not re.search(r"(from|over|at most|default) -?[0-9]+\.0\b", text) and "`" not in re.sub(r"(?s)<pre.*?</pre>", "", text)
    assert "0.10000000000000001" not in text and "0.0030000000000000001" not in text and "default 0.003" in text


def test_the_reference_has_a_line_for_each_operation_that_does_what_it_says(daemon, tmp_path):
    contract, text = daemon.curl("/openapi.json").json, html.unescape(daemon.curl("/docs").body.decode())
    (tmp_path / "scan.ply").write_bytes(conftest.SMALL)
    for path, item in contract["paths"].items():
        for method, operation in item.items():
            if method == "parameters":
                continue
            part = text[text.index(f'<h3 id="{operation["operationId"]}">'):].split("<h3", 2)[1]
            line = re.search(r"<pre[^>]*>(curl .*?)</pre>", part)[1]
            assert "{" not in line.rsplit("'", 2)[1] and "null" not in line.lower(), line
            answers = [reply for status, reply in operation["responses"].items() if status[0] == "2"]
            if any("examples" in reply.get("content", {}).get("application/json", {}) for reply in answers):
                assert "An answer (2" in part, path
            names = re.findall("{([^}]*)}", path)
            if method == "get" and not names or method == "post" and path in ("/v1/simplify", "/v1/jobs", "/v1/clouds"):
                done = subprocess.run(line, shell=True, cwd=tmp_path, check=False, capture_output=True)
                assert done.returncode == 0, (line, done.stdout, done.stderr)
