# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that a client can do wrong is answered with a problem document, and leaves nothing behind."""
import contextlib
import gzip
import http.client
import json
import pathlib
import socket
import subprocess
import urllib.parse

import pytest

from conftest import SANITIZED, SMALL, sphere, wait_until
from test_cli import columns_of

FIXTURES = pathlib.Path(__file__).parent.parent / "fixtures"


@pytest.fixture(name="daemon", scope="module")
def make_shared_daemon(tmp_path_factory):
    from conftest import Daemon
    with Daemon(tmp_path_factory.mktemp("daemon"), "--max-body-bytes", "32M") as daemon:
        yield daemon
        wait_until(lambda: daemon.leftovers() == [], "the end of all bodies")
        assert daemon.stop() == 0


# ---------------------------------------------------------------------------------------------- parameters

@pytest.mark.parametrize("query, slug, parameter, word", [
    ("ratoi=0.1", "unknown-parameter", "ratoi", "ratio"),
    ("Ratio=0.1", "unknown-parameter", "Ratio", "ratio"),
    ("ratio=0.1&ratio=0.2", "unknown-parameter", "ratio", "once"),
    ("labl=x", "unknown-parameter", "labl", "label"),
    ("xyzzy_nothing_near=1", "unknown-parameter", "xyzzy_nothing_near", None),
    ("ratio=7", "invalid-parameter", "ratio", "at most 1"),
    ("ratio=", "invalid-parameter", "ratio", "at most 1"),
    ("ratio", "invalid-parameter", "ratio", "at most 1"),
    ("points=-1", "invalid-parameter", "points", "whole number"),
    ("placement=middle", "invalid-parameter", "placement", "subset"),
    ("outputs=cloud,moon", "invalid-parameter", "outputs", "mesh"),
    ("ratio=0.1&points=5", "conflicting-parameters", "points", "ratio"),
    ("label=" + "x" * 129, "invalid-parameter", "label", "128"),
    ("label=%ff%fe", "invalid-parameter", "label", "UTF-8"),
])
def test_parameters(daemon, query, slug, parameter, word):
    reply = daemon.post(f"/v1/jobs?{query}", SMALL)
    assert (reply.status, reply.slug) == (400, slug)
    assert daemon.post(f"/v1/simplify?{query}", SMALL).slug == slug
    error = reply.json["errors"][0]
    assert error["parameter"] == parameter
    if word:
        assert word in error.get("allowed", "") + error.get("did_you_mean", "")
    else:
        assert "did_you_mean" not in error


def test_all_faults_of_a_query_are_told_at_once(daemon):
    reply = daemon.post("/v1/jobs?ratoi=1&points=x&seed=1&seed=2", SMALL)
    assert [e["parameter"] for e in reply.json["errors"]] == ["ratoi", "points", "seed"]


@pytest.mark.parametrize("path", ["/v1/jobs?ratio=1", "/v1/jobs?limit=0", "/v1/jobs?limit=501", "/v1/jobs?limit=x",
                                  "/v1/jobs?status=done", "/v1/jobs?after=x", "/v1/info?x=1", "/v1/parameters?x",
                                  "/openapi.json?x=", "/?x=1", "/problems/queue-full?x=1"])
def test_queries_of_reading(daemon, path):
    reply = daemon.curl(path)
    assert reply.status == 400 and reply.slug in ("unknown-parameter", "invalid-parameter")


def test_one_shot_has_one_output_by_either_name(daemon):
    for query in ("outputs=mesh,cloud", "outputs=mesh&outputs=cloud", "outputs=mesh&output=mesh"):
        refused = daemon.post(f"/v1/simplify?{query}", SMALL)
        assert refused.slug == "conflicting-parameters" and "/v1/jobs" in refused.json["detail"]
    assert daemon.post("/v1/simplify?outputs=mush", SMALL).slug == "invalid-parameter"
    assert daemon.post("/v1/simplify?outputs=mesh.glb&ratio=0.5", SMALL).body == \
        daemon.post("/v1/simplify?output=mesh.glb&ratio=0.5", SMALL).body
    assert daemon.post("/v1/simplify?output=moon", SMALL).slug == "invalid-parameter"


def test_nul_in_the_query(daemon):
    reply = daemon.post("/v1/jobs?label=a%00b", SMALL)
    assert (reply.status, reply.slug) == (400, "malformed-request")


def test_too_many_parameters(daemon):
    reply = daemon.post("/v1/jobs?" + "&".join(f"p{i}=1" for i in range(100)), SMALL)
    assert (reply.status, reply.slug) == (400, "malformed-request")


# ---------------------------------------------------------------------------------------------- paths and methods

@pytest.mark.parametrize("path", ["/nothing", "/v1", "/v1/", "/v1/jobs/", "/v1//jobs", "/v1/jobs/x/y/z", "/V1/jobs",
                                  "/openapi.json/", "/v1/jobs/a%2Foutputs%2Fb%2Fc", "/problems/none"])
def test_nothing_here(daemon, path):
    reply = daemon.curl(path, "--path-as-is")
    assert (reply.status, reply.slug) == (404, "no-such-resource")


@pytest.mark.parametrize("path", ["x", "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e", "..", "%2e%2e", "x" * 120])
def test_no_such_job(daemon, path):
    for tail in ("", "/outputs", "/outputs/cloud.ply", "/events", "/log"):
        reply = daemon.curl(f"/v1/jobs/{path}{tail}", "--path-as-is")
        assert reply.status == 404 and reply.slug == "no-such-job"
    assert daemon.curl(f"/v1/jobs/{path}", "--path-as-is", "-X", "DELETE").slug == "no-such-job"


@pytest.mark.parametrize("name", ["mesh.ply", "cloud.ply.part", "..", "%2e%2e%2flog", "..%2f..%2f..%2fwhittled.db", "log"])
def test_no_such_output(daemon, name):
    job_id = daemon.submit(SMALL)
    assert daemon.ended(job_id)["status"] == "successful"
    reply = daemon.curl(f"/v1/jobs/{job_id}/outputs/{name}", "--path-as-is")
    assert reply.status == 404 and reply.slug in ("no-such-output", "no-such-resource")


@pytest.mark.parametrize("method, path, allow", [
    ("PUT", "/v1/jobs", "POST, GET, HEAD"), ("DELETE", "/v1/jobs", "POST, GET, HEAD"),
    ("POST", "/v1/jobs/x", "GET, HEAD, DELETE"), ("GET", "/v1/simplify", "POST"), ("PATCH", "/healthz", "GET, HEAD"),
    ("OPTIONS", "/v1/info", "GET, HEAD"), ("TRACE", "/", "GET, HEAD"), ("BREW", "/", "GET, HEAD")])
def test_methods(daemon, method, path, allow):
    reply = daemon.curl(path, "-X", method)
    assert (reply.status, reply.slug) == (405, "method-not-allowed")
    assert reply.headers["allow"] == allow


# ---------------------------------------------------------------------------------------------- bodies

def cases():
    return sorted(p.parent for p in FIXTURES.glob("invalid/*/input.*"))


@pytest.mark.parametrize("case", cases(), ids=lambda case: case.name)
def test_every_bad_cloud_is_a_problem(daemon, case):
    columns = columns_of(case)
    query = "?columns=" + urllib.parse.quote(columns) if columns else ""
    reply = daemon.post("/v1/simplify" + query, next(case.glob("input.*")).read_bytes())
    assert reply.status in (413, 415, 422), reply.body
    assert reply.slug in ("malformed-cloud", "unsupported-format", "too-many-points", "degenerate-cloud",
                          "would-exceed-memory")
    if reply.slug == "unsupported-format":
        assert "xyz" in reply.json["supported"]


@pytest.mark.parametrize("header", [b"ply\nformat ascii 1.0\nelement vertex 1000000000000\nproperty float x\n"
                                    b"property float y\nproperty float z\nend_header\n",
                                    b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nend_header\n"])
def test_a_header_that_cannot_be_true_is_refused_before_it_is_a_job(daemon, header):
    before = daemon.curl("/v1/jobs?limit=500").json["jobs"]
    reply = daemon.post("/v1/jobs", header + b"0 0 0\n")
    assert reply.status in (413, 422)
    assert daemon.curl("/v1/jobs?limit=500").json["jobs"] == before


@pytest.mark.parametrize("media", ["image/png", "application/jsonx", "multipart/mixed; boundary=x", "video/mp4"])
def test_media_types_that_are_no_cloud(daemon, media):
    reply = daemon.post("/v1/jobs", SMALL, "-H", f"Content-Type: {media}")
    assert (reply.status, reply.slug) == (415, "unsupported-format")
    assert reply.json["supported"]


@pytest.mark.parametrize("media", ["", "text/plain", "model/ply", "application/octet-stream", "text/csv"])
def test_media_types_that_may_be_one(daemon, media):
    assert daemon.post("/v1/simplify", SMALL, "-H", f"Content-Type:{media}").status == 200


def test_no_body(daemon):
    for arguments in (("-X", "POST"), ("-X", "POST", "-H", "Content-Length: 0")):
        reply = daemon.curl("/v1/jobs", *arguments)
        assert (reply.status, reply.slug) == (422, "malformed-cloud")


def test_too_large_by_its_length_is_refused_before_it_is_sent(daemon, tmp_path):
    body = tmp_path / "body"
    with open(body, "wb") as file:
        file.truncate(64 << 20)
    done = subprocess.run(daemon.curl_command("/v1/jobs", "-X", "POST", "-T", body, "-H", "Expect: 100-continue", "-w",
                                              "sent=%{size_upload}"), capture_output=True, check=False)
    assert b" 413 " in done.stdout and done.stdout.endswith(b"sent=0")
    assert b'"limit":33554432' in done.stdout and b'"actual":67108864' in done.stdout


def test_too_large_without_a_length(daemon):
    reply = daemon.post("/v1/jobs", b"0.25 0.5 0.75\n" * (40 << 16), "-H", "Transfer-Encoding: chunked")
    assert (reply.status, reply.slug) == (413, "body-too-large")


@pytest.mark.parametrize("path, headers, status", [
    ("/v1/jobs?ratio=9", {}, 400), ("/v1/jobs", {"Content-Type": "image/png"}, 415), ("/nowhere", {}, 404)])
def test_a_client_that_sends_everything_first_gets_its_answer(daemon, path, headers, status):
    connection = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=60)
    connection.request("POST", path, body=b"0 0 0\n" * (4 << 20), headers=headers)
    assert connection.getresponse().status == status
    connection.close()


def test_what_is_no_cloud_is_refused_by_its_first_bytes(daemon):
    connection = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=60)
    connection.request("POST", "/v1/jobs", body=b"\x89PNG\r\n\x1a\n" + bytes(20 << 20))
    assert connection.getresponse().status == 415
    connection.close()


# ---------------------------------------------------------------------------------------------- the wire

def raw(daemon, data):
    """Sends bytes, returns all that comes back."""
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=60) as connection:
        connection.sendall(data)
        with contextlib.suppress(OSError):  # the other side may have ended it already
            connection.shutdown(socket.SHUT_WR)
        answer = b""
        while True:
            part = connection.recv(65536)
            if not part:
                return answer
            answer += part


@pytest.mark.parametrize("headers", [b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n",
                                     b"Content-Length: 5\r\nContent-Length: 6\r\n",
                                     b"Content-Length: -5\r\n", b"Content-Length: 5x\r\n",
                                     b"Transfer-Encoding: gzip, chunked\r\n", b"Host: b\r\n"], ids=range(6))
def test_ambiguous_framing(daemon, headers):
    answer = raw(daemon, b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\n" + headers + b"\r\n0\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 400 ") or answer == b"", answer
    assert b"HTTP/1.1 2" not in answer # nothing behind it was taken for a request


@pytest.mark.parametrize("noise", [b"", b"\0" * 100, b"GET\r\n\r\n", b"\x16\x03\x01\x02\x00\x01", b"GET / HTTP/9.9\r\n\r\n",
                                   b"GET /" + b"a" * 300000 + b" HTTP/1.1\r\n\r\n"], ids=range(6))
def test_noise(daemon, noise):
    raw(daemon, noise)
    assert daemon.curl("/healthz").status == 200


def test_a_client_that_vanishes_in_mid_upload_leaves_nothing(daemon):
    before = len(daemon.curl("/v1/jobs?limit=500").json["jobs"])
    connection = socket.create_connection(("127.0.0.1", daemon.port), timeout=60)
    connection.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n" + SMALL)
    wait_until(daemon.leftovers, "the upload's file")
    connection.close()
    wait_until(lambda: not daemon.leftovers(), "the file's removal")
    assert len(daemon.curl("/v1/jobs?limit=500").json["jobs"]) == before


def test_a_connection_without_headers_is_cut(make_daemon):
    daemon = make_daemon("--header-timeout", "100ms")
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=60) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost:")
        assert connection.recv(100) == b""


# ---------------------------------------------------------------------------------------------- no room

def test_a_full_queue(make_daemon, large):
    daemon = make_daemon("--workers", "1", "--max-queue", "1")
    daemon.wait_for(daemon.submit(large), "running")
    waiting = daemon.submit(SMALL)
    for path in ("/v1/jobs", "/v1/simplify"):
        reply = daemon.post(path, SMALL)
        assert (reply.status, reply.slug) == (503, "queue-full") and int(reply.headers["retry-after"]) > 0
    assert daemon.curl("/readyz").status == 503 and daemon.curl("/healthz").status == 200
    assert daemon.ended(waiting)["status"] == "successful"
    assert daemon.curl("/readyz").status == 200


def test_a_disk_without_room(make_daemon):
    daemon = make_daemon("--min-free", "1023T")
    reply = daemon.post("/v1/jobs", SMALL)
    assert (reply.status, reply.slug) == (507, "storage-full")
    assert daemon.curl("/readyz").status == 507


@pytest.mark.skipif(SANITIZED, reason="sanitizers reserve address space")
def test_a_job_that_needs_too_much_memory(make_daemon):
    daemon = make_daemon("--job-memory", "160M")
    query = "?output=mesh&denoise=full"  # which isn't done in tiles
    reply = daemon.post(f"/v1/simplify{query}", sphere(300000))
    assert (reply.status, reply.slug) == (413, "would-exceed-memory")
    reply = daemon.post(f"/v1/simplify{query}", gzip.compress(sphere(300000), 1))  # what is in it shows when it runs
    assert (reply.status, reply.slug) == (507, "out-of-memory")
    assert daemon.post("/v1/simplify", SMALL).status == 200


def test_a_job_that_needs_too_much_processor_time(make_daemon):
    daemon = make_daemon("--job-cpu", "1s")
    reply = daemon.post("/v1/simplify?output=mesh", sphere(600000))
    assert (reply.status, reply.slug) == (504, "time-limit")
    assert (reply.json["setting"], reply.json["limit_ms"]) == ("job-cpu", 1000) and reply.json["log"].endswith("/log")


def test_a_job_that_takes_too_long(make_daemon, large):
    daemon = make_daemon("--job-wall", "1s")
    reply = daemon.post("/v1/simplify?output=mesh", large)
    assert (reply.status, reply.slug) == (504, "time-limit")
    assert (reply.json["setting"], reply.json["limit_ms"]) == ("job-wall", 1000)
    assert reply.json["stage"] in reply.json["detail"] and "refine=flips" in reply.json["detail"]


# ---------------------------------------------------------------------------------------------- starting

@pytest.mark.parametrize("flags, word", [
    (["--listen", "0.0.0.0:0"], "--insecure-open"), (["--listen", "nonsense"], "HOST:PORT"), (["--workres", "2"], "unknown"),
    (["--workers", "many"], "whole number"), (["--retention", "5y"], "duration"), (["stray"], "no setting"), (["--data"], "value")])
def test_bad_flags_end_the_start(daemon, tmp_path, flags, word):
    program = daemon.process.args[0]
    done = subprocess.run([program, "--data", tmp_path / "data", *flags], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and word in done.stderr and done.stdout == ""


def test_bad_environment_ends_the_start(daemon, tmp_path):
    done = subprocess.run([daemon.process.args[0], "--data", tmp_path], capture_output=True, text=True, check=False,
                          env={"WHITTLED_MAX_QEUE": "3"})
    assert done.returncode == 2 and "max-qeue" in done.stderr


def test_settings_from_file_and_environment(daemon, tmp_path):
    file = tmp_path / "whittled.conf"
    file.write_text("# limits\nmax-queue = 7\nworkers = 3 # three\n\n")
    environment = {"WHITTLED_MAX_QUEUE": "8", "WHITTLED_CONFIG": str(file)}
    process = subprocess.Popen([daemon.process.args[0], "--data", tmp_path / "data", "--listen", "127.0.0.1:0",
                                "--sync-max", "2m"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                               env=environment)
    try:
        url = process.stdout.readline().split()[-1]
        limits = subprocess.run(["curl", "-sS", f"{url}/v1/info"], capture_output=True, text=True, check=True).stdout
        assert '"max_queue": 8' in limits and '"workers": 3' in limits and '"sync_max_ms": 120000' in limits
    finally:
        process.kill()
        process.wait()


def test_two_daemons_cannot_have_the_same_folder(daemon):
    done = subprocess.run([daemon.process.args[0], "--data", daemon.data, "--listen", "127.0.0.1:0"],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "another whittled" in done.stderr


def test_help_names_every_setting(daemon):
    done = subprocess.run([daemon.process.args[0], "--help"], capture_output=True, text=True, check=True)
    for name in ("--listen", "--data", "--worker ", "--workers", "--max-body-bytes", "--retention", "--drain-timeout"):
        assert name in done.stdout


AS_PLY = b"ply\nformat ascii 1.0\nelement vertex 300\nproperty float x\nproperty float y\nproperty float z\nend_header\n" + SMALL


@pytest.mark.parametrize("query, parameter, reason", [
    ("outputs=mesh&reference=faces", "reference", "faces: the input has no faces"),
    ("outputs=mesh&surface=given", "surface", "given: the input has no faces; leave it out, and the surface is reconstructed"),
    ("weights=rgb:0.2", "weights", "the input has no property 'red'; it has x, y, z"),
    ("where=intensity>3", "where", "the input has no property 'intensity'; it has x, y, z")])
@pytest.mark.parametrize("packed", [False, True])
def test_what_a_header_has_not_is_refused_at_once(daemon, query, parameter, reason, packed):
    body = gzip.compress(AS_PLY) if packed else AS_PLY
    reply = daemon.post(f"/v1/jobs?{query}", body)
    assert (reply.status, reply.slug) == (400, "invalid-parameter") and reply.json["detail"] == f"{parameter}: {reason}"
    assert [error["parameter"] for error in reply.json["errors"]] == [parameter]
    path = daemon.post("/v1/clouds", body).headers["location"]
    assert daemon.post(f"/v1/jobs?{query}", json.dumps({"input": path}).encode(), "-H", "Content-Type: application/json").json["detail"] == reply.json["detail"]
    allowed = query.replace("mesh", "cloud").replace("rgb:0.2", "x:0.2").replace("intensity>3", "x>-9")  # no mesh, no faces
    assert daemon.post(f"/v1/jobs?{allowed}", body).status == 201
