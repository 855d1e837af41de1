# SPDX-License-Identifier: GPL-3.0-or-later
"""The page in chromium where something goes wrong, by keys alone, by fingers, and in each colour; behind nginx with TLS."""
import hashlib
import json
import math
import os
import random
import re
import signal
import struct
import subprocess
import threading

import pytest

import conftest
import test_proxy
from test_page import BROWSER, NODE, files_of, hold, needs_browser, scan, share_of, walk
from test_parameters import torus
from test_preview import WHITTLE, decode

pytestmark = needs_browser


def drive(scenario, url, *rest, doing=None, flags=()):
    """Plays a scenario of states.js; doing: what it may want to happen to the service."""
    command = ["node", NODE / "states.js", BROWSER, scenario, url, *rest]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          env=os.environ | {"BROWSER_FLAGS": " ".join(flags)}) as node:
        clock = threading.Timer(conftest.PATIENCE_S * 3, node.kill)
        clock.start()
        try:
            for line in node.stdout:
                seen = json.loads(line)
                if "wants" not in seen:
                    break
                doing[seen["wants"]]()
                print("", file=node.stdin, flush=True)
            assert node.wait() == 0, node.stderr.read()
        finally:
            clock.cancel()
    assert {state: found for state, found in seen["violations"].items() if found} == {}
    assert [error for error in seen["errors"] if not re.search("ERR_ABORTED|ERR_CONNECTION|ERR_INTERNET|ERR_INCOMPLETE|ERR_EMPTY", error)] == []
    return seen


def restart(daemon):
    """What kills a daemon, and what starts it again where it was."""
    def start():
        port = daemon.port
        daemon.flags = (*daemon.flags, "--listen", f"127.0.0.1:{port}", "--admin-listen", "127.0.0.1:0")
        daemon.start()
    return {"kill": daemon.kill, "start": start}


@pytest.fixture(name="noise", scope="module")
def make_noise(tmp_path_factory):
    """A PLY of 24 MB that takes long enough."""
    path, numbers = tmp_path_factory.mktemp("noise") / "large.ply", random.Random(4)
    n = 2000000
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {n}\n" + "".join(f"property float {c}\n" for c in "xyz")
    row = struct.pack("<3f", *(numbers.random() for _ in range(3)))
    path.write_bytes(head.encode() + b"end_header\n" + row * 1000 + numbers.randbytes(12 * (n - 1000)).replace(b"\x7f", b"\x3f").replace(b"\xff", b"\x3f"))
    return path


# ---------------------------------------------------------------------------------------------- refusals and failures

def test_a_token_that_is_refused_is_said(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"alice:submit,read:{hashlib.sha256(b'secret').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens)
    files_of(daemon)
    assert "doesn't take this token" in drive("wrong_token", f"{daemon.url}/", tmp_path, "secret2")["title"]


def test_a_file_that_is_no_scan(daemon, tmp_path):
    files_of(daemon)
    picture = tmp_path / "holiday.jpg"
    picture.write_bytes(b"\xff\xd8\xff\xe0\0\x10JFIF" + bytes(range(256)) * 40)
    seen = drive("no_scan", f"{daemon.url}/", tmp_path, picture)
    assert seen["news"]["refused"].startswith("\u2068holiday.jpg\u2069: ") and "PLY, LAS" in seen["news"]["refused"]
    (tmp_path / "nothing.ply").write_bytes(b"")
    seen = drive("no_scan", f"{daemon.url}/", tmp_path, tmp_path / "nothing.ply")
    assert seen["news"]["refused"] == "\u2068nothing.ply\u2069: the file is empty."
    assert [url for url in seen["requests"] if "/v1/uploads" in url] == []


def test_a_file_may_be_dropped_anywhere_and_one_at_a_time(daemon, tmp_path):
    files_of(daemon)
    first = scan(tmp_path / "torus.ply").read_text()
    seen = drive("dropped", f"{daemon.url}/", tmp_path, first, first.replace("element vertex 2592", "element vertex 2593") + "0 0 2 9 9 9\n")
    assert "second.ply" in seen["facts"] and seen["back"] == "first.ply"
    assert seen["news"]["two files"] == "Drop one file at a time; these were 2." and seen["news"]["dropped on a result"] == ""


def test_a_full_disk(make_daemon, tmp_path):
    daemon = make_daemon("--min-free", "1023T")
    files_of(daemon)
    seen = drive("no_scan", f"{daemon.url}/", tmp_path, scan(tmp_path / "torus.ply"))
    assert "disk is full" in seen["news"]["refused"], seen["news"]


def test_a_quota(make_daemon, tmp_path):
    daemon = make_daemon("--principal-bytes", "120000")
    assert daemon.post("/v1/clouds", conftest.sphere(2000)).status == 201
    files_of(daemon)
    seen = drive("no_scan", f"{daemon.url}/", tmp_path, scan(tmp_path / "torus.ply"))
    assert "limit" in seen["news"]["refused"] and "delete" in seen["news"]["refused"], seen["news"]


def test_a_job_that_fails_says_why_and_what_to_do(daemon, tmp_path):
    files_of(daemon)
    letter = tmp_path / "letter.txt"
    letter.write_text("Dear reader,\nthis is no cloud.\n")
    title, text, advice = drive("failed", f"{daemon.url}/", tmp_path, letter)["ended"]
    assert title == "\u2068letter.txt\u2069 has failed" and "Malformed cloud" in text and "Save it again" in advice


def test_a_deviation_in_the_units_of_the_file(daemon, tmp_path):
    files_of(daemon)
    seen = drive("units", f"{daemon.url}/", tmp_path, scan(tmp_path / "torus.ply"))
    assert "percent of the box's diagonal" in seen["percent"][0] and "max_deviation_rel=" in seen["percent"][1], seen
    assert "5 mm" in seen["empty"][0] and "/jobs/" not in seen["empty"][1] and seen["empty"][2], seen
    job = daemon.curl(f"/v1/jobs/{seen['job'].rsplit('/', 1)[1]}").json
    assert job["params"]["max_deviation"] == 0.02 and 0 < job["report"]["deviation"]["reached"] <= 0.02, job["report"]["deviation"]
    assert "in the file's units" in seen["again"][0] and "0.02 in the file's units" in seen["again"][1], seen["again"] # the box is known


def test_columns_of_a_text_are_named_where_they_are_not_known(daemon, tmp_path):
    files_of(daemon)
    points = [f"P{i},{math.cos(2.4 * i) * (i / 500) ** .5:.4f},{math.sin(2.4 * i) * (i / 500) ** .5:.4f},{i % 7 / 100},tree" for i in range(500)]
    (tmp_path / "survey.csv").write_text("\n".join(points) + "\n")
    seen = drive("columns", f"{daemon.url}/", tmp_path, tmp_path / "survey.csv")
    assert "columns" in seen["ended"][0] and seen["ended"][1] == "Name its columns under “Change parameters”.", seen["ended"]
    params = daemon.curl(f"/v1/jobs/{seen['job'].rsplit('/', 1)[1]}").json["params"]
    assert params["columns"] == ["-", "x", "y", "z", "-"] and params["where"] == ["z<0.06", "x>-0.9"], params
    assert params["viewpoint"] == [0, 0, 9] and params["weights"] == ["z:0.1"], params


def test_a_table_with_texts_is_read_and_what_is_left_out_is_said(daemon, tmp_path):
    files_of(daemon)
    points = [f"P{i},{x:.4f},{y:.4f},{z:.4f},{'edge of the road' if i % 3 else ''}" for i, (x, y, z) in enumerate(torus())]
    (tmp_path / "survey.csv").write_text("Point ID,Easting,Northing,Elevation,Remark\n" + "\n".join(points) + "\n")
    warnings = drive("table", f"{daemon.url}/", tmp_path, tmp_path / "survey.csv")["warnings"]
    assert "column Point_ID, which has no numbers" in warnings and "column Remark, which has no numbers" in warnings, warnings


def test_a_laz_is_described_before_anything_runs(daemon, tmp_path):
    files_of(daemon)
    scan(tmp_path / "torus.ply")
    subprocess.run([WHITTLE, "convert", tmp_path / "torus.ply", tmp_path / "torus.laz", "-q"], check=True)
    seen = drive("facts", f"{daemon.url}/", tmp_path, tmp_path / "torus.laz")
    assert "x, y, z, intensity" in seen["facts"] and " × " in seen["facts"] and "counted" not in seen["facts"], seen["facts"]
    assert seen["label"] == "Largest deviation, in the file's units"
    assert max(seen["tops"]) - min(seen["tops"]) < 1 # pixel: what is told later moves nothing from below a finger


def test_a_job_is_cancelled(daemon, tmp_path, large):
    files_of(daemon)
    (tmp_path / "large.ply").write_bytes(large)
    seen = drive("cancelled", f"{daemon.url}/", tmp_path, tmp_path / "large.ply")
    assert seen["stage"] and seen["ended"][0] == "\u2068large.ply\u2069 was cancelled"


def test_a_job_that_waits_says_for_how_many_and_then_for_how_long(make_daemon, tmp_path, gated):
    gate, flags = gated
    gate.touch()
    daemon = make_daemon(*flags)
    files_of(daemon)
    jobs = [daemon.submit(conftest.SMALL + b"# %d\n" % i, "?outputs=cloud") for i in range(4)]
    daemon.wait_for(jobs[0], "running")
    seen = drive("queued", f"{daemon.url}/jobs/{jobs[3]}", tmp_path, doing={
        "less": lambda: daemon.curl(f"/v1/jobs/{jobs[1]}", "-X", "DELETE"), "open": gate.unlink})
    assert "40 %, about 5 min left" in seen["told"] and "40 %, fitting the mesh to the points" in seen["told"], seen["told"]


# ---------------------------------------------------------------------------------------------- a service that is away

@pytest.mark.parametrize("scenario", ["killed", "offline"])
def test_an_upload_goes_on_where_it_was(daemon, tmp_path, noise, scenario):
    files_of(daemon)
    seen = drive(scenario, f"{daemon.url}/", tmp_path, noise, doing=restart(daemon))
    assert seen["news"]["after it"] == "" and max(seen["offsets"]) >= 8 << 20
    assert seen["offsets"].count(0) == 1, seen["offsets"]


def test_a_service_that_goes_away_while_a_job_runs(daemon, tmp_path, large):
    files_of(daemon)
    (tmp_path / "large.ply").write_bytes(large)
    seen = drive("away", f"{daemon.url}/", tmp_path, tmp_path / "large.ply", doing=restart(daemon))
    assert seen["news"]["after it"] == ""


# ---------------------------------------------------------------------------------------------- hands

def test_keys_alone_lead_from_the_example_to_its_deletion(daemon, tmp_path):
    files_of(daemon)
    seen = drive("keys", f"{daemon.url}/", tmp_path)
    first, last = seen["views"]
    assert all(first[name] != last[name] for name in ("azimuth", "elevation", "distance", "centre"))
    assert "points" in seen["level"] and re.match(r"[\d.]+ between", seen["measured"][-1]), seen["measured"]


def test_a_turn_is_shown_at_once(daemon, tmp_path):
    """What is drawn when nothing moves is waited for by nobody who moves it."""
    files_of(daemon)
    job = daemon.submit(scan(tmp_path / "torus.ply").read_bytes(), "?ratio=0.3&outputs=mesh,error")
    assert daemon.ended(job)["status"] == "successful"
    assert len(set(drive("restless", f"{daemon.url}/jobs/{job}", tmp_path)["views"])) == 3


def test_fingers_turn_zoom_and_move(daemon, tmp_path):
    files_of(daemon)
    job = daemon.submit(scan(tmp_path / "torus.ply").read_bytes(), "?ratio=0.3&outputs=mesh,error")
    assert daemon.ended(job)["status"] == "successful"
    seen = drive("fingers", f"{daemon.url}/jobs/{job}", tmp_path)
    before, turned, zoomed, shifted = (seen[name] for name in ("before", "turned", "zoomed", "shifted"))
    assert turned["azimuth"] != before["azimuth"] and turned["distance"] == before["distance"]
    assert zoomed["distance"] < 0.6 * turned["distance"] and zoomed["azimuth"] == turned["azimuth"]
    assert shifted["centre"] != zoomed["centre"] and abs(shifted["distance"] / zoomed["distance"] - 1) < 0.05


def extent_of(path, wanted):
    """Shares of the picture's width and height between which pixels are for which wanted(r, g, b) holds; labels lie in its
    corners."""
    width, rows = decode(path.read_bytes())
    corner = range(len(rows) // 10, len(rows) * 9 // 10)
    hits = [(i // 3, y) for y, row in enumerate(rows) for i in range(0, 3 * width, 3)
            if wanted(*row[i:i + 3]) and (y in corner or width // 4 < i // 3 < width * 3 // 4)]
    columns, lines = zip(*hits)
    return min(columns) / width, max(columns) / width, min(lines) / len(rows), max(lines) / len(rows)


def camera_of(view, up):
    """Unit vectors to the right and towards the viewer, in the file's axes."""
    a, e = view["azimuth"], view["elevation"]
    right, towards = (math.cos(a), 0, -math.sin(a)), (math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e))
    return [(x, -z, y) if up == "z" else (x, y, z) for x, y, z in (right, towards)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def hold_the_camera(seen):
    """It goes where it is turned, and back."""
    usual, dragged, pushed, wheeled, shifted = (seen[name] for name in ("usual", "dragged", "pushed", "wheeled", "shifted"))
    assert abs(dragged["azimuth"] - usual["azimuth"] + 0.32) < 1e-6 and abs(dragged["elevation"] - usual["elevation"] - 0.16) < 1e-6
    assert pushed["azimuth"] == dragged["azimuth"] and pushed["distance"] == dragged["distance"] < wheeled["distance"] < 2 * pushed["distance"]

    def moved(one, other):
        a = other["azimuth"]
        return dot([y - x for x, y in zip(one["centre"], other["centre"])], (math.cos(a), 0, -math.sin(a)))
    assert moved(dragged, pushed) < 0 < moved(wheeled, shifted) # what is seen follows the pointer, and the key's arrow the camera
    assert seen["above"]["elevation"] == 1.55
    assert seen["still"] == seen["nearer"] # who has moved it keeps it, whatever shape the window gets
    assert all(abs(a - b) < 1e-9 for a, b in zip(seen["home"]["centre"], usual["centre"]))
    assert {name: seen["home"][name] for name in ("azimuth", "elevation", "distance")} == {name: usual[name] for name in ("azimuth", "elevation", "distance")}


def hold_what_is_picked(seen):
    """The nearest point, in the units of the file."""
    def place(text):
        numbers = [float(number) for number in re.match(r"First place: (.*)\. Pick", text)[1].split(", ")]
        return [a - b for a, b in zip(numbers, (100, 200, 300))]
    first, both, third, turned = seen["places"]
    _, towards = camera_of(seen["usual"], "z")
    assert abs(math.hypot(*place(first)) - 5) < 0.01 and dot(place(first), towards) > 4.9, (first, towards)
    between = re.match(r"([\d.]+) between the two places \(x (-?[\d.]+), y (-?[\d.]+), z (-?[\d.]+)\), in the file's units", both)
    far, *apart = (float(number) for number in between.groups())
    second = [a + b for a, b in zip(place(first), apart)]
    right, _ = camera_of(seen["usual"], "z")
    assert abs(far - math.hypot(*apart)) < 0.01 and abs(math.hypot(*second) - 5) < 0.02 and dot(apart, right) > 0.5, both
    assert place(third) == place(first) and seen["marks"] == [2, 2] and seen["none"] == [0, 0] # a box and a line on each side
    assert dot(place(turned), camera_of(seen["usual"], "y")[1]) > 4.8, turned


def hold_pictures(seen, folder):
    """The view is filled, the box lies around it, all of it is saved."""

    def clay(r, g, b):
        return g + 2 < r < 240 and b + 5 < r

    def line(r, g, b):
        return max(r, g, b) - min(r, g, b) < 8 and r < 180
    left, right, top, bottom = extent_of(folder / "ball.png", clay)
    assert min(left, 1 - right, top, 1 - bottom) > 0.01 and bottom - top > 0.8, (left, right, top, bottom)
    wide = extent_of(folder / "boxed.png", line)
    assert wide[0] < left - 0.02 and wide[1] > right + 0.02, (wide, left, right)
    assert abs(seen["saved"] - sum(share_of(folder / "ball.png", clay)) / 2) < 0.05, seen["saved"]
    for name in ("swipe-800", "after-360", "side-360"):
        left, right, top, bottom = extent_of(folder / f"{name}.png", clay)
        assert min(1 - right, 1 - bottom) > 0.005 and (right - left > 0.6 or bottom - top > 0.4), (name, left, right, top, bottom)
    _, rows = decode((folder / "dark.png").read_bytes())
    assert sum(rows[12][3 * 160:3 * 161]) < 150 # between labels, ball and the outline of what has the focus


def test_the_camera_picks_and_pictures(daemon, tmp_path):
    """With a ball of radius 5 around 100, 200, 300."""
    files_of(daemon)
    job = daemon.submit(ball(20000, 5, (100, 200, 300)), "?ratio=0.5&outputs=cloud,dso")
    assert daemon.ended(job)["status"] == "successful"
    seen = drive("camera", f"{daemon.url}/jobs/{job}", tmp_path)
    hold_the_camera(seen)
    hold_what_is_picked(seen)
    hold_pictures(seen, tmp_path)


def test_the_form_says_what_is_asked_for(daemon, tmp_path):
    files_of(daemon)
    seen = drive("form", f"{daemon.url}/", tmp_path, scan(tmp_path / "it's a scan.ply"))
    assert "-T 'it'\\''s a scan.ply'" in seen["command"], seen["command"]
    outputs = "outputs=cloud,mesh,error,preview.png"
    assert seen["usual"] == f"ratio=0.1&{outputs}'" and seen["points"] == f"points=1234&{outputs}'", seen
    assert seen["text"].replace("\u202f", "") == "1234 of 2592 points, 47.6 %" and seen["most"].replace("\u202f", "").startswith("2592 of 2592")
    assert seen["levels"] == f"levels=0.4,0.1&{outputs}&surface=closed&seed=7'", seen["levels"]


def test_figures_links_and_files_of_a_result(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"alice:submit,read:{hashlib.sha256(b'secret').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens, "--base-path", "/whittle")
    files_of(daemon, "/whittle")
    bearer = ("-H", "Authorization: Bearer secret")
    made = daemon.post("/whittle/v1/jobs?ratio=0.3&outputs=cloud,mesh&label=torus.ply", scan(tmp_path / "torus.ply").read_bytes(), *bearer,
                       "-H", f"Prefer: wait={conftest.PATIENCE_S}").json
    report = made["report"]
    seen = drive("figures", f"{daemon.url}/whittle/jobs/{made['id']}", tmp_path, "secret")
    rows = {row[0]: row[1:] for row in seen["rows"]}

    def same(text, number):
        return abs(float(text.replace("\u202f", "").removesuffix("\u00a0%")) - number) <= 0.006 * abs(number)
    for name, direction in (("points to mesh", "input_to_mesh"), ("mesh to points", "mesh_to_input"), ("both ways", "symmetric")):
        figures = report["error"][direction]
        assert all(same(text, number) for text, number in zip(rows[name], (figures["mean"], figures["rms"], figures["max"], 100 * figures["max_rel"]), strict=True)), (rows[name], figures)
    assert same(rows["triangles"][0], report["mesh"]["triangles"]) and same(rows["area"][0], report["mesh"]["area"])
    assert rows["closed"] == ["yes"] and rows["handles"] == ["1"] and report["mesh"]["handles"] == 1
    assert seen["title"] == "torus.ply · whittled"
    subprocess.run(seen["command"].replace("curl ", "curl -H 'Authorization: Bearer secret' -o again.json "), shell=True, cwd=tmp_path, check=True)
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["params"] == made["params"] and again["input"]["sha256"] == made["input"]["sha256"]
    cloud = daemon.curl(f"/whittle/v1/jobs/{made['id']}/outputs/cloud.ply", *bearer).body
    assert (tmp_path / seen["saved"]).read_bytes() == cloud
    link = re.search(r"good for a day: (http\S+)", seen["link"])[1]
    assert daemon.curl(link.removeprefix(daemon.url)).body == cloud and "secret" not in link
    assert seen["cards"] == 1 and daemon.curl(f"/whittle/v1/jobs/{made['id']}", *bearer).status == 200
    assert seen["kept"] == ["whittled-token/whittle"]


def test_an_upload_that_was_left_goes_on_when_the_file_is_dropped_again(daemon, tmp_path, noise):
    files_of(daemon)
    seen = drive("resumed", f"{daemon.url}/", tmp_path, noise)
    assert seen["offsets"][0] == 0 < seen["offsets"][seen["before"]], seen["offsets"]


# ---------------------------------------------------------------------------------------------- colours

def surveyed():
    """The torus with normals, classes, intensities, and a time that only grows, as binary PLY."""
    points = list(torus())
    names = [("x", "float"), ("y", "float"), ("z", "float"), ("nx", "float"), ("ny", "float"), ("nz", "float"),
             ("intensity", "ushort"), ("classification", "uchar"), ("gps_time", "double")]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n" + "".join(f"property {kind} {name}\n" for name, kind in names)
    rows = (struct.pack("<6fHBd", x, y, z, 0, 0, 1 if z > 0 else -1, int(30000 + 9000 * x), 2 if z < 0 else 6, 1e5 + i)
            for i, (x, y, z) in enumerate(points))
    return head.encode() + b"end_header\n" + b"".join(rows)


def tones_of(path):
    """How many different colours a picture has, coarsely, and the share of its pixels that are mostly red, green, blue."""
    width, rows = decode(path.read_bytes())
    pixels = [row[i:i + 3] for row in rows for i in range(0, 3 * width, 3)]
    most = [sum(p[c] > max(p[:c] + p[c + 1:]) + 25 for p in pixels) / len(pixels) for c in range(3)]
    return len({(p[0] >> 5, p[1] >> 5, p[2] >> 5) for p in pixels}), most


def test_each_attribute_colours_with_a_legend_and_levels_have_meshes(daemon, tmp_path):
    files_of(daemon)
    job = daemon.submit(surveyed(), "?levels=0.4,0.1&outputs=cloud,mesh,error&normals=true")
    assert daemon.ended(job)["status"] == "successful"
    seen = drive("colours", f"{daemon.url}/jobs/{job}", tmp_path)
    assert [name for name, _ in seen["after"]] == ["mesh_0.4.ply", "mesh_0.1.ply", "cloud"]
    (few, of_few), (many, of_many) = seen["meshes"]
    assert few < many / 3 and "10 %" in of_few and "40 %" in of_many
    assert {"plain", "height", "normals", "intensity", "classification", "gps_time"} <= {name for name, _ in seen["colours"]}
    legends = seen["legends"]
    assert legends["plain"] is None and legends["normals"] is None
    assert "2 ground" in legends["classification"] and "6 building" in legends["classification"] and "%" in legends["classification"]
    for name in ("height", "intensity", "gps_time"):
        assert re.search(r"half of the points below [\d.\u202f-]+, 98 of 100 below", legends[name]), legends[name]
    tones = {name: tones_of(tmp_path / f"cloud-{name}.png") for name, _ in seen["colours"]}
    assert len({str(tone) for tone in tones.values()}) == len(tones)
    assert min(tones["classification"][1][0], tones["normals"][1][2]) > 0.02 > tones["plain"][1][0]
    assert (tmp_path / "mesh-smooth.png").read_bytes() != (tmp_path / "mesh-normals.png").read_bytes()
    assert seen["stays"] == "height"
    assert "Deviation" in seen["histogram"] and "largest" in seen["histogram"]
    hot = [sum(share_of(tmp_path / f"swipe-{bar}.png", lambda r, g, b: r > g + 40 and g > b)) for bar in (20, 80)]
    assert hot[1] > 2 * hot[0], hot
    width, rows = decode_any(tmp_path / seen["saved"])
    assert width > 500 and rows > 300


@pytest.mark.parametrize("form", ["mesh.glb", "mesh.obj", "mesh.stl"])
def test_a_mesh_is_seen_whatever_its_form(daemon, tmp_path, form):
    files_of(daemon)
    job = daemon.submit(surveyed(), f"?ratio=0.3&outputs={form}")
    ended = daemon.ended(job)
    assert ended["status"] == "successful"
    seen = drive("sides", f"{daemon.url}/jobs/{job}", tmp_path)
    assert seen["layers"][1]["triangles"] == ended["report"]["mesh"]["triangles"]
    assert seen["layers"][0]["count"] and not seen["why"]
    assert re.match(r"Upload of \d", seen["title"]), seen["title"]


def test_what_is_not_drawn_is_said(daemon, tmp_path):
    files_of(daemon)
    (tmp_path / "scan.ply").write_bytes(surveyed())
    subprocess.run([WHITTLE, "convert", tmp_path / "scan.ply", tmp_path / "scan.laz", "-q"], check=True)
    job = daemon.submit((tmp_path / "scan.laz").read_bytes(), "?ratio=0.3&outputs=cloud.laz")
    assert daemon.ended(job)["status"] == "successful"
    seen = drive("sides", f"{daemon.url}/jobs/{job}", tmp_path)
    assert seen["layers"] == [None, None]
    assert "LAZ isn't drawn here" in seen["why"] and "cloud.laz can't be drawn here" in seen["why"]


def decode_any(path):
    """Width and height of a PNG."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", data[16:24])


def ball(n, radius=1, middle=(0, 0, 0)):
    """Points evenly on a sphere, without normals, as binary PLY."""
    def row(i):
        z = 1 - (2 * i + 1) / n
        wide, turn = math.sqrt(1 - z * z), i * math.pi * (3 - math.sqrt(5))
        return struct.pack("<3f", *(radius * c + m for c, m in zip((wide * math.cos(turn), wide * math.sin(turn), z), middle)))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {n}\n" + "".join(f"property float {c}\n" for c in "xyz")
    return head.encode() + b"end_header\n" + b"".join(row(i) for i in range(n))


def brightness_of(path):
    """The tenth and the ninetieth percentile of the brightness of pixels that aren't paper."""
    width, rows = decode(path.read_bytes())
    found = sorted(sum(row[i:i + 3]) for row in rows for i in range(0, 3 * width, 3) if sum(row[i:i + 3]) < 715)
    return found[len(found) // 10], found[len(found) * 9 // 10]


def test_a_large_cloud_is_seen_as_tiles(daemon, tmp_path):
    """Nearer fetches more of them, never draws more than it may, and nothing is left when the job is closed; points
    without normals are lit by their depths."""
    files_of(daemon)
    job = daemon.submit(ball(150000), "?ratio=0.9&outputs=cloud,tileset")
    assert daemon.ended(job)["status"] == "successful"
    seen = drive("tiles", f"{daemon.url}/jobs/{job}", tmp_path)
    assert seen["after"] == ["cloud", "tiles"]
    away, usual, few, near = (seen[name] for name in ("away", "usual", "few", "near"))
    assert 1 <= away["tiles"]["shown"] < usual["tiles"]["shown"] <= usual["tiles"]["all"]
    assert away["fetched"] < usual["fetched"] and away["shown"] < usual["shown"] <= usual["count"] == 135000
    assert few["tiles"]["budget"] < 10000 and few["shown"] == few["tiles"]["budget"]
    assert near["tiles"]["shown"] < near["tiles"]["held"] <= near["tiles"]["all"]
    assert re.match(rf"{usual['shown']} of 135000 points, in {usual['tiles']['shown']} of", usual["text"].replace("\u202f", ""))
    tiles = [url for url in seen["requests"] if "/tileset/tiles/" in url]
    assert len(tiles) == len(set(tiles)) == near["tiles"]["held"]
    assert seen["geometries"] >= seen["before"] + near["tiles"]["shown"] - 1 and seen["left"] <= 2
    for name in ("lit", "tiles"):
        dark, light = brightness_of(tmp_path / f"{name}.png")
        assert dark < 0.8 * light, (name, dark, light)


def test_a_device_that_forgets_is_given_all_again(daemon, tmp_path):
    files_of(daemon)
    job = daemon.submit(scan(tmp_path / "torus.ply").read_bytes(), "?ratio=0.3&outputs=mesh,error")
    assert daemon.ended(job)["status"] == "successful"
    drive("lost_device", f"{daemon.url}/jobs/{job}", tmp_path)
    (width, before), (_, after), (_, turned) = (decode((tmp_path / f"{name}.png").read_bytes()) for name in ("before", "after", "turned"))

    def differing(one, other):
        return sum(abs(a - b) > 24 for rows in zip(one, other) for a, b in zip(*rows)) / (3 * width * len(one))
    assert differing(before, after) < 0.005 < 0.02 < differing(before, turned)
    dark = share_of(tmp_path / "before.png", lambda r, g, b: r + g + b < 90)
    assert dark[1] > 0.0002, dark # what lies behind an edge of the mesh


def test_without_webgl_the_picture_is_shown(daemon, tmp_path):
    files_of(daemon)
    job = daemon.submit(scan(tmp_path / "torus.ply").read_bytes(), "?ratio=0.3&outputs=mesh,preview.png")
    assert daemon.ended(job)["status"] == "successful"
    seen = drive("no_webgl", f"{daemon.url}/jobs/{job}", tmp_path, flags=["--disable-3d-apis"])
    assert seen["tools"] and seen["why"] == "This browser has no WebGL. The picture shows the result."
    seen = drive("no_worker", f"{daemon.url}/jobs/{job}", tmp_path)
    assert seen["why"] == "The part of this page that reads points can't be loaded. The picture shows the result."


def test_names_of_files_are_names_alone(daemon, tmp_path):
    """Markup, directions of writing, 4 000 letters; and a job that another tab has deleted."""
    files_of(daemon)
    seen = drive("hostile", f"{daemon.url}/", tmp_path, scan(tmp_path / "torus.ply").read_text())
    assert seen["hit"] is None
    assert seen["shown"] == [name[:128].strip() for name in seen["names"]]
    assert [fit for fit in seen["fits"] if fit[2] > fit[3]] == []
    assert "deleted" in seen["news"]["deleted elsewhere"]
    assert [line for line in seen["console"] if line.startswith("error") and not re.search("404|410", line)] == []


def test_a_token_that_expires_is_asked_for_and_nothing_is_lost(make_daemon, tmp_path):
    tokens, words, given = tmp_path / "tokens", ["first", "second", "third"], []

    def next_token():
        given.append(words[len(given)])
        tokens.write_text(f"alice:submit,read:{hashlib.sha256(given[-1].encode()).hexdigest()}\n")
    next_token()
    daemon = make_daemon("--tokens-file", tokens)
    files_of(daemon)
    made = daemon.post("/v1/jobs?ratio=0.3&outputs=mesh,error", scan(tmp_path / "torus.ply").read_bytes(),
                       "-H", "Authorization: Bearer first", "-H", f"Prefer: wait={conftest.PATIENCE_S}")
    assert made.json["status"] == "successful"

    def revoke():
        next_token()
        daemon.process.send_signal(signal.SIGHUP)
        conftest.wait_until(lambda: daemon.curl("/v1/jobs", "-H", f"Authorization: Bearer {given[-1]}").status == 200, "the next token")
    seen = drive("expired", f"{daemon.url}/jobs/{made.json['id']}", tmp_path, *words, doing={"revoke": revoke})
    assert seen["goals"][0] == seen["goals"][1] and not seen["goals"][0].startswith("30")


def test_a_service_that_is_away_while_somebody_looks(daemon, tmp_path):
    files_of(daemon)
    job = daemon.submit(scan(tmp_path / "torus.ply").read_bytes(), "?ratio=0.3&outputs=mesh,error")
    assert daemon.ended(job)["status"] == "successful"
    seen = drive("away_looking", f"{daemon.url}/jobs/{job}", tmp_path, doing=restart(daemon))
    assert seen["colour"] == "own" and seen["news"]["back"] == ""


def test_a_job_that_another_tab_deletes_while_it_is_looked_at(daemon, tmp_path):
    files_of(daemon)
    job = daemon.submit(scan(tmp_path / "torus.ply").read_bytes(), "?ratio=0.3&outputs=mesh,cloud,error")
    assert daemon.ended(job)["status"] == "successful"
    seen = drive("deleted", f"{daemon.url}/jobs/{job}", tmp_path)
    assert "deleted" in seen["news"]["deleted while looked at"] and "deleted" in seen["news"]["deleted twice"], seen["news"]


def test_a_browser_that_keeps_nothing(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"alice:submit,read:{hashlib.sha256(b'secret').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens)
    files_of(daemon)
    assert drive("no_storage", f"{daemon.url}/", tmp_path, "secret", scan(tmp_path / "torus.ply"))["title"] == "torus.ply"


def test_a_list_of_more_jobs_than_a_page_has(daemon, tmp_path):
    """The filter finds what isn't listed yet; a picture is asked for once."""
    files_of(daemon)
    for i in range(60):
        reply = daemon.post(f"/v1/jobs?ratio=1&outputs=cloud,preview.png&label=Number-{i}-", conftest.SMALL, "-H", f"Prefer: wait={conftest.PATIENCE_S}")
        assert reply.json["status"] == "successful"
    seen = drive("many", f"{daemon.url}/", tmp_path, "Number-3-", "60")
    assert seen["capitals"] == ["Number-31-"]
    assert len(seen["first"]) == 24 and "Number-59-" in seen["first"] and seen["found"] == ["Number-3-"]
    pictures = [url for url in seen["requests"][:seen["asked"]] if url.endswith("preview.png")]
    assert len(pictures) == len(set(pictures)) == 60, len(pictures)


def places(*rows):
    text = "\n".join(" ".join(map(str, row)) for row in rows)
    return f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\nproperty double x\nproperty double y\nproperty double z\nend_header\n{text}\n".encode()


def test_hardly_any_points_and_very_large_numbers_are_seen(daemon, tmp_path):
    files_of(daemon)
    ring = list(torus())
    column = [(c * math.cos(i), y, c * math.sin(i)) for i in range(600) for y, c in ((i / 200, 0.3), (0, (i + 1) / 600))] # on a round foot
    clouds = {"one": places((1, 2, 3)), "two": places((0, 0, 0), (1, 2, 2)), "equal": places(*[(5, 5, 5)] * 9),
              "huge": places(*[[1e30 * c for c in p] for p in ring]), "tiny": places(*[[1e-20 * c for c in p] for p in ring]),
              "standing": places(*column), "upright": places(*[(x, -z, y) for x, y, z in column]),
              "deep": places(*[[x, 4 * y, z] for x, y, z in ring]), "askew": places(*[[x - 3 * y, x + 3 * y, z] for x, y, z in ring]),
              "strip": places(*[[9 * x, y, z] for x, y, z in ring]),
              "square": places(*[(i % 60, i // 60, 0) for i in range(3600)]),
              "far": places(*[[x + 691234.5, y + 5334567.25, z + 512.125] for x, y, z in ring]),
              "stray": places(*ring, (700, 20, 5)),
              "holes": places(*[(x, float("nan"), z) if i % 7 == 0 else (x, y, z) for i, (x, y, z) in enumerate(ring)])}
    addresses = {}
    for name, cloud in clouds.items():
        outputs = "cloud" if len(cloud) < 500 or name in ("stray", "standing", "upright", "square") else "mesh,cloud,error"
        job = daemon.submit(cloud, f"?ratio=1&outputs={outputs}&normals={'false' if len(cloud) < 500 else 'true'}")
        ended = daemon.ended(job)
        assert ended["status"] == "successful", (name, ended["problem"])
        addresses[name] = f"{daemon.url}/jobs/{job}"
    seen = drive("odd", f"{daemon.url}/", tmp_path, json.dumps(addresses))
    assert [line for line in seen["console"] if line.startswith("error")] == []
    for name in clouds:
        shown = share_of(tmp_path / f"{name}.png", lambda r, g, b: abs(r - 250) + abs(g - 250) + abs(b - 248) > 12)
        assert (0.0005 if name in ("one", "two", "equal") else 0.05) < max(shown) < 0.7, (name, shown)
    assert [seen["seen"][name]["up"] for name in ("standing", "upright", "far")] == ["y", "z", "z"]
    turned = {name: round(math.degrees(seen["seen"][name]["view"]["azimuth"])) for name in ("far", "deep", "askew")}
    assert turned == {"far": 30, "deep": 60, "askew": -15}, turned # the widest side, and 30 degrees
    assert [seen["seen"][name]["stacked"] for name in ("far", "deep", "strip")] == ["false", "true", "true"] # what is wide is larger so
    left, right, top, bottom = extent_of(tmp_path / "square.png", lambda r, g, b: g + 2 < r < 240 and b + 5 < r)
    assert max(abs(left - 1 + right), abs(top - 1 + bottom)) < 0.03 and min(left, top, 1 - bottom) > 0.005, (left, right, top, bottom) # all its corners
    assert "10^30" in seen["seen"]["huge"]["box"] and "10^-20" in seen["seen"]["tiny"]["box"]


def test_packed_tiles_look_as_others(daemon, tmp_path):
    files_of(daemon)
    jobs = {name: daemon.submit(ball(30000), f"?ratio=0.9&outputs=tileset{query}")
            for name, query in (("plain", ""), ("packed", "&meshopt=true&quantize=true"))}
    for job in jobs.values():
        assert daemon.ended(job)["status"] == "successful"
    seen = drive("odd", f"{daemon.url}/", tmp_path, json.dumps({name: f"{daemon.url}/jobs/{job}" for name, job in jobs.items()}))
    plain, packed = (seen["seen"][name]["layers"][1] for name in ("plain", "packed"))
    assert plain["shown"] == packed["shown"] == 27000 and packed["fetched"] < 0.6 * plain["fetched"]
    (width, one), (_, other) = (decode((tmp_path / f"{name}.png").read_bytes()) for name in jobs)
    differ = sum(abs(a - b) > 24 for rows in zip(one, other) for a, b in zip(*rows))
    assert differ < 0.02 * 3 * width * len(one), differ


def test_operations_are_tried_out_on_the_reference(make_daemon, tmp_path):
    daemon = make_daemon("--base-path", "/whittle")
    files_of(daemon, "/whittle")
    contract = daemon.curl("/whittle/openapi.json").json
    seen = drive("docs", f"{daemon.url}/whittle/docs", tmp_path, scan(tmp_path / "torus.ply"))
    assert seen["tries"] == sum(method != "parameters" for item in contract["paths"].values() for method in item)
    assert seen["made"].startswith("201 ") and "location: /whittle/v1/jobs/" in seen["made"]
    job = re.search(r'"id": "([0-9a-f-]{36})"', seen["made"])[1]
    assert seen["got"].startswith("200 ") and job in seen["got"]
    assert seen["token"] == "Bearer secret" and seen["save"][0].endswith("cloud.ply") and "bytes" in seen["save"][1], seen
    assert seen["wrong"].startswith("404 ") and "no-such-cloud" in seen["wrong"]
    assert [table for table in seen["tables"] if table[0] > table[1]] == [] # whatever they list, their last column is seen
    assert all(url.startswith(f"{daemon.url}/whittle/") for url in seen["requests"]), seen["requests"]


# ---------------------------------------------------------------------------------------------- nginx

def pinned(certificate):
    """The flag that makes chromium trust one key alone, which is how a test can have an authority of its own."""
    key = subprocess.run(f"openssl x509 -in {certificate} -pubkey -noout | openssl pkey -pubin -outform der | openssl dgst -sha256 -binary | base64",
                         shell=True, capture_output=True, text=True, check=True).stdout.strip()
    return f"--ignore-certificate-errors-spki-list={key}"


@pytest.mark.skipif(not test_proxy.NGINX or not test_proxy.shutil.which("openssl"), reason="nginx and openssl aren't installed")
@pytest.mark.parametrize("protocol, flags", [("h2", ()), ("http/1.1", ("--disable-http2",))])
def test_the_whole_way_behind_nginx_with_tls_below_a_path_with_a_token(make_daemon, tmp_path, monkeypatch, protocol, flags):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"alice:submit,read:{hashlib.sha256(b'secret').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens, "--base-path", "/whittle")
    files_of(daemon, "/whittle")
    proxy = test_proxy.Proxy(tmp_path / "nginx", daemon.port).start()
    try:
        monkeypatch.setenv("BROWSER_FLAGS", " ".join([pinned(proxy.folder / "tls.crt"), *flags]))
        seen = walk(f"{proxy.url}/whittle/", scan(tmp_path / "torus.ply"), tmp_path / "pictures", "secret")
    finally:
        proxy.stop()
    seen["console"] = [line for line in seen["console"] if "401" not in line]
    hold(seen, proxy, "/whittle")
    assert seen["address"].startswith(f"{proxy.url}/whittle/jobs/") and len(seen["cards"]) == 1
    assert set(seen["protocols"]) == {protocol}
    assert f"{proxy.url}/whittle/v1/jobs?" in seen["command"]
