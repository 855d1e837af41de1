# SPDX-License-Identifier: GPL-3.0-or-later
"""The service below a prefix of a site, as a user of https://HOST/whittle/ meets it: Debian's nginx with TLS in front,
which changes no body, and every link followed.  The proxy passes the path on whole, or takes the prefix away."""
import base64
import json
import re
import subprocess

import pytest

import conftest
import test_proxy
from test_webhooks import SECRET, Receiver

pytestmark = test_proxy.pytestmark
BASE = "/whittle"
TUS = ("-H", "Tus-Resumable: 1.0.0")


@pytest.fixture(name="site", params=["passed on whole", "taken away"])
def make_site(request, make_daemon, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text(SECRET + "\n")
    daemon = make_daemon("--base-path", BASE, "--webhooks", "--webhook-secret-file", secret, "--webhook-allow",
                         "127.0.0.1")
    inner = "proxy_pass http://whittled;\n    }\n\n    location @too_large"
    changes = {inner: inner.replace("whittled;", "whittled/;", 1)} if request.param == "taken away" else {}
    proxy = test_proxy.Proxy(tmp_path / "nginx", daemon.port, **changes).start()
    used = (proxy.folder / "conf.d/whittled.conf").read_text()
    assert ("http://whittled/;" in used) == bool(changes)
    yield proxy
    proxy.stop()
    print(proxy.log_text()[-5000:], daemon.log_text()[-5000:])


def links_in(value):
    """Every text in a document that is a link to something of the service, wherever it leads."""
    if isinstance(value, dict):
        return [link for v in value.values() for link in links_in(v)]
    if isinstance(value, list):
        return [link for v in value for link in links_in(v)]
    is_link = isinstance(value, str) and re.match(r"(/whittle)?/(v1/|problems/|openapi)", value)
    return [value] if is_link else []


def follow(site, links, count):
    assert len(links) >= count, links
    for link in links:
        assert link.startswith(f"{BASE}/"), link
        assert site.curl(link, "--max-time", "20").status == 200, link


def job_below(site, cloud=conftest.SMALL, query="?points=50&outputs=cloud,mesh,report"):
    reply = site.post(f"{BASE}/v1/jobs{query}", cloud)
    assert reply.status == 201, reply.body
    where = reply.headers["location"]
    assert re.fullmatch(BASE + r"/v1/jobs/[0-9a-f-]{36}", where)

    def ended():
        job = site.curl(where).json
        return job if job["status"] in ("successful", "failed") else None
    return where, conftest.wait_until(ended, "the job's end")


def test_jobs_and_their_lists(site):
    where, job = job_below(site)
    follow(site, links_in(job), 5)
    manifest = site.curl(where + "/outputs").json
    follow(site, links_in(manifest), 3)
    assert links_in(site.curl(f"{BASE}/v1/jobs").json) == links_in(job)
    job_below(site)
    link = re.fullmatch("<(.+)>; rel=\"next\"", site.curl(f"{BASE}/v1/jobs?limit=1").headers["link"])[1]
    assert link.startswith(f"{BASE}/v1/jobs?limit=1&after=") and len(site.curl(link).json["jobs"]) == 1
    events = site.curl(where + "/events").body.decode()
    follow(site, [json.loads(line[6:])["href"] for line in events.splitlines() if '"href"' in line], 3)


def test_what_is_saved_is_not_changed_on_the_way(site):
    _, job = job_below(site)
    for output in site.curl(job["links"][-1]["href"]).json["outputs"]:
        reply = site.curl(output["href"])
        digest = base64.b64encode(bytes.fromhex(output["sha256"])).decode()
        assert reply.headers["repr-digest"] == f"sha-256=:{digest}:" and len(reply.body) == output["bytes"]


def test_one_shots(site):
    reply = site.post(f"{BASE}/v1/simplify?points=50", conftest.SMALL)
    monitor = re.fullmatch("<(.+)>; rel=\"monitor\"", reply.headers["link"])[1]
    follow(site, [monitor], 1)
    late = site.post(f"{BASE}/v1/simplify?ratio=0.1", conftest.sphere(200000), "-H", "Prefer: wait=0")
    assert late.status == 504 and late.json["type"] == f"{BASE}/problems/sync-timeout"
    follow(site, [late.headers["location"], late.json["type"]], 2)
    asked = site.post(f"{BASE}/v1/simplify?ratio=0.2", conftest.SMALL, "-H", "Prefer: respond-async")
    assert asked.status == 202
    follow(site, [asked.headers["location"]], 1)


def test_clouds_are_named_by_their_links(site):
    created = site.post(f"{BASE}/v1/clouds", conftest.SMALL)
    follow(site, [created.headers["location"], *links_in(created.json)], 3)
    other = site.post(f"{BASE}/v1/clouds", conftest.sphere(10))
    link = re.fullmatch("<(.+)>; rel=\"next\"", site.curl(f"{BASE}/v1/clouds?limit=1").headers["link"])[1]
    assert site.curl(link).json["clouds"][0]["id"] in (created.json["id"], other.json["id"])
    for named in (created.headers["location"], created.headers["location"].removeprefix(BASE)):
        body = json.dumps({"input": named, "params": {"points": 40}}).encode()
        assert site.post(f"{BASE}/v1/jobs", body, "-H", "Content-Type: application/json").status == 201


def test_resumable_uploads(site):
    made = site.curl(f"{BASE}/v1/uploads", "-X", "POST", *TUS, "-H", f"Upload-Length: {len(conftest.SMALL)}")
    where = made.headers["location"]
    assert made.status == 201 and where.startswith(f"{BASE}/v1/uploads/")
    piece = ("-H", "Upload-Offset: 0", "-H", "Content-Type: application/offset+octet-stream")
    # PATCH said by POST is understood below the prefix too.
    done = site.post(where, conftest.SMALL, *TUS, *piece, "-H", "X-HTTP-Method-Override: PATCH")
    assert done.status == 204
    follow(site, [done.headers["whittle-cloud"], *links_in(site.curl(where).json)], 3)


def test_signed_links(site):
    where, _ = job_below(site)
    follow(site, links_in(site.curl(f"{where}/outputs/mesh.ply/link", "-X", "POST").json), 1)


def test_problems(site):
    wrong = site.curl(f"{BASE}/v1/jobs/00000000-0000-0000-0000-000000000000")
    assert wrong.status == 404
    follow(site, links_in(wrong.json), 1)
    _, job = job_below(site, b"1 2 3\nx\n" + conftest.SMALL, "?points=5")
    assert job["problem"]["type"] == f"{BASE}/problems/malformed-cloud"
    follow(site, links_in(job["problem"]), 2)


def test_webhooks(site):
    receiver = Receiver(204)
    try:
        job_below(site, query=f"?points=60&webhook={receiver.url}/hook")
        conftest.wait_until(lambda: receiver.taken, "the webhook")
    finally:
        receiver.close()
    follow(site, links_in(json.loads(receiver.taken[0][1])), 4)


def test_the_service_describes_itself_where_it_is(site):
    contract = site.curl(f"{BASE}/openapi.json").json
    assert contract["servers"] == [{"url": BASE}]
    assert site.curl(f"{contract['servers'][0]['url']}/v1/info").status == 200
    follow(site, links_in(site.curl(f"{BASE}/v1/info").json["links"]), 2)
    assert site.curl(f"{BASE}/v1/parameters").json["$id"] == f"{BASE}/v1/parameters"
    for page in ("/", "/docs"):
        # Each once: the reference names some problems in every operation, more often than nginx lets one client ask.
        hrefs = set(re.findall(r'href="([^"#]+)"', site.curl(BASE + page).body.decode())) - {"data:,"}
        assert hrefs and not [h for h in hrefs if ":" in h or (h.startswith("/") and not h.startswith(f"{BASE}/"))]
        assert all(site.curl(h if h.startswith("/") else f"{BASE}/{h}").status == 200 for h in hrefs)
    assert f"<code>{BASE}</code>" in site.curl(f"{BASE}/docs").body.decode()


def test_the_prefix_is_no_way_around(site):
    assert site.curl("/whittles/v1/info").status == 404
    for path in ("/metrics", f"{BASE}/metrics", f"{BASE}{BASE}/metrics", f"{BASE}/readyz"):
        assert site.curl(path).status == 404


@pytest.mark.parametrize("base", ["/", "whittle", "/whittle/", "/a//b", "/..", "/a?b", "/" + 64 * "x"])
def test_what_is_no_base_path_ends_the_start(base):
    done = subprocess.run([conftest.BUILD / "whittled", "--check-config", "--base-path", base], capture_output=True,
                          text=True, check=False)
    assert done.returncode == 2 and "base-path" in done.stderr and "/whittle" in done.stderr
