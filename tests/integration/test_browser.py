# SPDX-License-Identifier: GPL-3.0-or-later
"""The pages for people in a real browser, Debian's chromium: nothing is loaded from elsewhere, nothing fails, everything
is there and legible on a desk and in a hand.  `make test-contract` installs browser and driver."""
import functools
import hashlib
import http.server
import json
import pathlib
import re
import shutil
import subprocess
import threading

import pytest

from conftest import SMALL

NODE = pathlib.Path(__file__).parent.parent / "node"
BROWSER = shutil.which("chromium")
pytestmark = pytest.mark.skipif(
    not BROWSER or not shutil.which("node") or not (NODE / "node_modules/puppeteer-core").exists(),
    reason="chromium, node, or what make test-contract installs into tests/node, is not there")


def look(url, width, folder):
    picture = folder / "page.png"
    done = subprocess.run(["node", NODE / "docs_page.js", BROWSER, url, str(width), picture], capture_output=True,
                          text=True, check=False, timeout=180)
    assert done.returncode == 0, done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 10000
    seen = json.loads(done.stdout)
    assert seen["status"] == 200
    assert seen["console"] == seen["errors"] == []
    page = seen["page"]
    assert page["clientWidth"] == width and page["scrollWidth"] <= width, page["wide"]
    assert page["wide"] == [] and page["dead"] == [] and page["invisible"] == 0 and page["fontPx"] >= 12
    return seen


def only_from(seen, *urls):
    """What else a browser asks for by itself is the icon of the site."""
    assert set(seen["requests"]) <= set(urls), seen["requests"]
    assert urls[0] in seen["requests"]


@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("base", ["", "/whittle"])
def test_the_reference_page(make_daemon, tmp_path, base, width):
    daemon = make_daemon("--base-path", base)
    contract = daemon.curl("/openapi.json").json
    seen = look(f"{daemon.url}{base}/docs", width, tmp_path)
    scripts = re.findall("page/docs-[0-9a-f]{16}.js", daemon.curl(f"{base}/docs").body.decode())  # where the page is built
    only_from(seen, f"{daemon.url}{base}/docs", f"{daemon.url}{base}/openapi.json", *(f"{daemon.url}{base}/{name}" for name in scripts))
    headings = seen["page"]["headings"]
    for path, item in contract["paths"].items():
        for method in item:
            assert method == "parameters" or f"{method.upper()} {path}" in headings
    assert set(contract["components"]["schemas"]) <= set(headings)
    assert seen["hash"] == "#upload" and -5 < seen["top"] < 450
    assert {"How to upload a cloud", *(tag["name"] for tag in contract["tags"])} <= set(headings)


@pytest.mark.parametrize("width", [1280, 400])
def test_the_plain_first_page(daemon, tmp_path, width):
    if b"/page/" in daemon.curl("/").body:
        pytest.skip("the page is built, and test_page.py goes through it")
    seen = look(f"{daemon.url}/", width, tmp_path)
    only_from(seen, f"{daemon.url}/")
    assert seen["page"]["title"] == "whittled"
    assert seen["page"]["cut"] == []


def test_a_problems_page(daemon, tmp_path):
    seen = look(f"{daemon.url}/problems/would-exceed-memory", 400, tmp_path)
    only_from(seen, f"{daemon.url}/problems/would-exceed-memory")
    assert "Job would exceed its memory limit" in seen["page"]["headings"]


@pytest.fixture(name="other_origin")
def serve_another_origin(tmp_path):
    """A page with the client beside it, and a field for a file, as anybody's own server would have them."""
    folder = tmp_path / "site"
    folder.mkdir()
    shutil.copy(NODE.parent.parent / "api/javascript/whittle.js", folder)
    (folder / "index.html").write_text("<!doctype html><title>a page</title><input type=file>")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_the_javascript_client_in_a_page(make_daemon, tmp_path, other_origin):
    """A file that somebody chose, in pieces, from another origin, with a token; then a job, a batch, arrays, problems."""
    token = "0123456789abcdef" * 4
    (tmp_path / "tokens").write_text(f"me:submit,read:{hashlib.sha256(token.encode()).hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tmp_path / "tokens", "--cors-origins", other_origin)
    (tmp_path / "ball.xyz").write_bytes(SMALL)
    done = subprocess.run(["node", NODE / "browser_client.js", BROWSER, other_origin + "/", daemon.url, token,
                           tmp_path / "ball.xyz"], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    seen = json.loads(done.stdout)
    assert seen["errors"] == [] and seen["cloud"] == hashlib.sha256(SMALL).hexdigest()
    assert seen["told"] == [[min(at, len(SMALL)), len(SMALL)] for at in range(0, len(SMALL) + 3000, 3000)]
    assert seen["job"] == seen["seen"][-1] == seen["batch"] == "successful"
    assert (seen["points"], seen["vertices"], seen["corners"]) == (150, 150, 3 * (2 * 150 - 4))
    assert seen["kind"] == "Float64Array"  # of text
    for name, status, slug in (("refused", 400, "invalid-parameter"), ("stranger", 401, "unauthorized"),
                               ("deleted", 410, "job-gone")):
        assert seen[name] == {"isProblem": True, "status": status, "type": f"/problems/{slug}"}
