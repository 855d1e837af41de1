# SPDX-License-Identifier: GPL-3.0-or-later
"""The bodies that a job may come in: raw, form, JSON; compressed; with digests."""
import base64
import gzip
import hashlib
import json
import pathlib
import re
import shutil
import socket
import subprocess

import pytest

from conftest import PATIENCE_S, SMALL, sphere

JSON = ("-H", "Content-Type: application/json")
NAME = hashlib.sha256(SMALL).hexdigest()


@pytest.fixture(name="daemon", scope="module")
def make_shared_daemon(tmp_path_factory):
    from conftest import Daemon
    with Daemon(tmp_path_factory.mktemp("daemon"), "--max-body-bytes", "32M") as daemon:
        yield daemon
        assert daemon.stop() == 0
        assert daemon.leftovers() == []


@pytest.fixture(name="cloud", scope="module")
def make_cloud(daemon):
    return daemon.post("/v1/clouds", SMALL).headers["location"]


def post_json(daemon, document, path="/v1/jobs", *more):
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    return daemon.post(path, text, *JSON, *more)


def form(*parts, boundary="frontier"):
    """A body of parts (headers after the name, content)."""
    body = b"".join(f'--{boundary}\r\nContent-Disposition: form-data; {head}\r\n\r\n'.encode() + content + b"\r\n"
                    for head, content in parts)
    return body + f"--{boundary}--\r\n".encode()


def post_form(daemon, body, path="/v1/jobs", boundary="frontier"):
    return daemon.post(path, body, "-H", f"Content-Type: multipart/form-data; boundary={boundary}")


FILE = ('name="file"; filename="a.xyz"', SMALL)


# ---------------------------------------------------------------------------------------------- JSON

def test_a_job_names_its_cloud(daemon, cloud):
    reply = post_json(daemon, {"input": cloud, "params": {"points": 50, "outputs": ["cloud"]}, "label": "by name"})
    assert reply.status == 201, reply.body
    job = daemon.ended(reply.json["id"])
    assert job["status"] == "successful" and job["report"]["points_out"] == 50 and job["label"] == "by name"
    assert job["input"]["cloud"] == cloud and job["input"]["bytes"] == len(SMALL)
    raw = daemon.ended(daemon.submit(SMALL, "?points=50"))
    assert daemon.curl(f"/v1/jobs/{job['id']}/outputs/cloud.ply").body == \
        daemon.curl(f"/v1/jobs/{raw['id']}/outputs/cloud.ply").body


def test_several_clouds_are_one_job_by_their_names(daemon):
    """join alone: the first is the input, as if the path or input had named it."""
    lines = SMALL.split(b"\n")[-151:-1]
    clouds = [daemon.post("/v1/clouds", b"\n".join(part) + b"\n").headers["location"] for part in (lines[:80], lines[80:])]
    params = {"ratio": 0.5, "outputs": ["cloud"]}
    jobs = [daemon.ended(post_json(daemon, document, path).json["id"]) for document, path in (
        ({"join": clouds, "params": params}, "/v1/jobs"), ({"input": clouds[0], "join": clouds[1:], "params": params}, "/v1/jobs"),
        ({"join": clouds[1:], "params": params}, f"{clouds[0]}/jobs"))]
    assert [job["status"] for job in jobs] == ["successful"] * 3 and [job["report"]["points_in"] for job in jobs] == [150] * 3
    assert len({job["input"]["sha256"] for job in jobs}) == 1


@pytest.mark.parametrize("document, parameter", [({"join": []}, "join"), ({"join": ["x"]}, "join[0]"), ({"join": 3}, "join")])
def test_what_is_no_list_of_clouds_is_named(daemon, document, parameter):
    reply = post_json(daemon, document)
    assert reply.slug == "invalid-parameter" and parameter in [each["parameter"] for each in reply.json["errors"]]


def test_a_detail_is_whole(daemon):
    reply = daemon.post("/v1/jobs?outputs=fbx", SMALL)
    assert reply.json["detail"] == f"outputs: 'fbx' is not allowed; it takes {reply.json['errors'][0]['allowed']}"
    assert reply.json["detail"].endswith("separated by commas")


def test_parameters_may_also_be_in_the_query(daemon, cloud):
    reply = post_json(daemon, {"input": cloud, "params": {"points": 50}}, "/v1/jobs?seed=3&label=q")
    assert reply.json["params"]["seed"] == 3 and reply.json["params"]["points"] == 50 and reply.json["label"] == "q"


@pytest.mark.parametrize("document, slug, parameter, word", [
    ({"input": "/v1/clouds/" + "0" * 64}, "no-such-cloud", None, None),
    ({"params": {}}, "invalid-parameter", "input", "must be there"),
    ({"input": 3}, "invalid-parameter", "input", "a string"),
    ({"input": "/v1/clouds/x"}, "invalid-parameter", "input", "path of a cloud"),
    ({"input": "", "parms": {}}, "unknown-parameter", "parms", "params"),
    ({"inptu": ""}, "unknown-parameter", "inptu", "input"),
    ({"input": "", "ratio": 0.1}, "unknown-parameter", "ratio", "params.ratio"),
    ({"input": "", "output": "mesh"}, "unknown-parameter", "output", None),
    ({"input": "", "params": []}, "invalid-parameter", None, None),
    ({"input": "", "label": 5}, "invalid-parameter", "label", "a string"),
])
def test_strict_documents(daemon, document, slug, parameter, word):
    reply = post_json(daemon, document)
    assert reply.slug == slug and reply.status in (400, 404)
    if parameter:
        error = next(e for e in reply.json["errors"] if e["parameter"] == parameter)
        assert not word or word in error.get("allowed", "") + error.get("did_you_mean", "")


@pytest.mark.parametrize("params, slug, path, word", [
    ({"ratio": "0.1"}, "invalid-parameter", "params.ratio", "number"),
    ({"ratio": True}, "invalid-parameter", "params.ratio", "number"),
    ({"ratio": None}, "invalid-parameter", "params.ratio", "number"),
    ({"points": 5.5}, "invalid-parameter", "params.points", "whole number"),
    ({"outputs": "cloud"}, "invalid-parameter", "params.outputs", "cloud"),
    ({"outputs": ["cloud,mesh"]}, "invalid-parameter", "params.outputs", "cloud"),
    ({"placement": ["subset"]}, "invalid-parameter", "params.placement", "subset"),
    ({"levels": ["0.1"]}, "invalid-parameter", "params.levels", "number"),
    ({"ratoi": 0.1}, "unknown-parameter", "params.ratoi", "ratio"),
    ({"label": "x"}, "unknown-parameter", "params.label", None),
    ({"ratio": 0.1, "points": 7}, "conflicting-parameters", "params.points", None),
])
def test_types_are_named_by_path(daemon, cloud, params, slug, path, word):
    reply = post_json(daemon, {"input": cloud, "params": params})
    assert (reply.status, reply.slug) == (400, slug)
    error = reply.json["errors"][0]
    assert error["parameter"] == path and reply.json["detail"].startswith("params.")
    assert ("in JSON it takes an array" in reply.json["detail"]) == (path in ("params.outputs", "params.levels"))
    assert not word or word in error.get("allowed", "") + error.get("did_you_mean", "")


def test_all_faults_of_a_document_are_told_at_once(daemon, cloud):
    reply = post_json(daemon, {"input": 1, "label": 2, "nonsense": 3})
    assert {e["parameter"] for e in reply.json["errors"]} == {"input", "label", "nonsense"}
    reply = post_json(daemon, {"input": cloud, "params": {"ratio": "x", "points": "y"}})
    assert {e["parameter"] for e in reply.json["errors"]} == {"params.ratio", "params.points"}


@pytest.mark.parametrize("text, word", [(b"", "line"), (b"[]", "object"), (b"{", "line 1"), (b'{"input":"\\u0000"}', "line"),
                                        (b'{"label":"a","label":"b"}', "duplicate"), (b"\xff", "line"),
                                        (b'{"input":"a"} x', "end of file"), (b"[" * 50000, "line")])
def test_no_document(daemon, text, word):
    reply = post_json(daemon, text)
    assert (reply.status, reply.slug) == (400, "malformed-request") and word in reply.json["detail"]


def test_a_document_has_a_limit(daemon):
    reply = post_json(daemon, b'{"input":"' + b"x" * 70000)
    assert (reply.status, reply.slug) == (413, "body-too-large") and reply.json["limit"] == 65536


def test_a_name_in_query_and_document_is_refused(daemon, cloud):
    reply = post_json(daemon, {"input": cloud, "params": {"seed": 1}}, "/v1/jobs?seed=2")
    assert (reply.status, reply.slug) == (400, "unknown-parameter") and reply.json["errors"][0]["allowed"] == "once"
    assert post_json(daemon, {"input": cloud, "params": {"points": 9}}, "/v1/jobs?ratio=0.5").slug == \
        "conflicting-parameters"


def test_one_shot_of_a_named_cloud(daemon, cloud):
    reply = post_json(daemon, {"input": cloud, "params": {"points": 40}, "output": "xyz"}, "/v1/simplify")
    assert reply.status == 200 and reply.body == daemon.post("/v1/simplify?points=40&output=xyz", SMALL).body


def test_a_cloud_is_no_document(daemon):
    assert post_json(daemon, b"{}", "/v1/clouds").slug == "unsupported-format"


# ---------------------------------------------------------------------------------------------- forms

def test_a_document_that_comes_as_a_cloud_is_told_how_to_come(daemon):
    reply = daemon.curl("/v1/jobs", "-d", '{"input": "/v1/clouds/0"}')
    assert reply.slug == "unsupported-format" and "application/json" in reply.json["hint"]


def test_curls_form(daemon, tmp_path):
    path = tmp_path / "a cloud.xyz"
    path.write_bytes(SMALL)
    reply = daemon.curl("/v1/jobs", "-F", f"file=@{path}", "-F", "points=50", "-F", "label=from a form")
    assert reply.status == 201, reply.body
    job = daemon.ended(reply.json["id"])
    assert job["report"]["points_out"] == 50 and job["label"] == "from a form" and job["input"]["sha256"] == NAME


@pytest.mark.parametrize("order", [1, -1])
def test_params_before_and_after_the_file(daemon, order):
    parts = [('name="params"', b'{"points": 50, "seed": 9}'), FILE, ("name=label", b"x")][::order]
    job = post_form(daemon, form(*parts)).json
    assert job["params"]["points"] == 50 and job["params"]["seed"] == 9 and job["label"] == "x"
    assert job["input"]["sha256"] == NAME


def test_params_may_be_a_file_of_their_own(daemon):
    part = ('name="params"; filename="p.json"\r\nContent-Type: application/json', b'{"points": 50}')
    assert post_form(daemon, form(FILE, part)).json["params"]["points"] == 50


@pytest.mark.parametrize("content", [b"\r\n" + SMALL, SMALL + b"\r\n", SMALL.replace(b"\n", b"\r\n"),
                                     SMALL + b"\r\n--frontie\r\n", SMALL + b"\r\r\n\r\n--\r\n--fronties" + b"\r" * 99])
def test_content_that_looks_like_a_boundary(daemon, content):
    for boundary in ("frontier", "-" * 24 + "x", "a"):
        if b"\r\n--" + boundary.encode() in content:
            continue
        reply = post_form(daemon, form((FILE[0], content), boundary=boundary), "/v1/clouds", f'"{boundary}"')
        assert reply.status in (200, 201) and reply.json["id"] == hashlib.sha256(content).hexdigest()


def test_a_form_in_pieces_of_any_size(daemon):
    import http.client
    body = form(("name=label", b"piecewise"), FILE, ('name="params"', b'{"points": 50}'))
    for size in (1, 7, 1000):
        pieces = body if size == 1 else b""
        connection = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=60)
        chunks = (body[i:i + size] for i in range(0, len(body), size))
        connection.request("POST", "/v1/jobs", body=chunks if size > 1 else pieces, encode_chunked=True,
                           headers={"Content-Type": "multipart/form-data; boundary=frontier"})
        reply = connection.getresponse()
        assert reply.status == 201 and json.load(reply)["input"]["sha256"] == NAME
        connection.close()


def test_a_repeated_list_is_one_list(daemon):
    lists = (daemon.post("/v1/jobs?outputs=cloud&outputs=mesh&ratio=0.5", SMALL),
             post_form(daemon, form(FILE, ("name=outputs", b"cloud"), ("name=ratio", b"0.5"), ("name=outputs", b"mesh"))),
             daemon.post("/v1/jobs?outputs=cloud,mesh&ratio=0.5", SMALL))
    assert [reply.status for reply in lists] == [201] * 3
    for reply in lists:
        assert reply.json["params"]["ratio"] == 0.5
        assert {"cloud", "mesh"} == set(reply.json["params"]["outputs"]) - {"report"}


def test_a_simplification_answers_whoever_takes_json(daemon):
    for accept in ("application/json", "application/json, text/plain, */*;q=0", "text/html"):
        reply = daemon.post("/v1/simplify?ratio=0.5", SMALL, "-H", f"Accept: {accept}")
        assert reply.status == 200 and reply.body.startswith(b"ply"), reply.body
    reply = daemon.post("/v1/simplify?ratio=0.5&output=mesh", SMALL, "-H", "Accept: application/json")
    assert reply.status == 200 and reply.headers["content-type"] == "model/ply"
    reply = daemon.post("/v1/simplify?ratio=0.5&output=mesh", SMALL, "-H", "Accept: image/png")
    assert (reply.status, reply.slug) == (406, "not-acceptable")


def test_a_job_of_a_cloud_that_is_here(daemon):
    cloud = daemon.post("/v1/clouds", SMALL).json["id"]
    document = {"params": {"ratio": 0.5, "outputs": ["cloud"]}, "label": "again"}
    json_type = ("-H", "Content-Type: application/json")
    created = daemon.post(f"/v1/clouds/{cloud}/jobs", json.dumps(document).encode(), *json_type)
    assert created.status == 201 and created.json["label"] == "again" and created.json["input"]["sha256"] == cloud
    assert daemon.ended(created.json["id"])["status"] == "successful"
    old = daemon.post("/v1/jobs", json.dumps({"input": f"/v1/clouds/{cloud}", **document}).encode(), *json_type)
    assert old.status == 201
    assert [old.json["params"][name] == created.json["params"][name] for name in ("ratio", "outputs")] == [True, True]
    for document, slug, parameter in (({"input": f"/v1/clouds/{cloud}"}, "invalid-parameter", "input"),
                                      ({"lable": "x"}, "unknown-parameter", "lable"),
                                      ({"params": {"ratio": 9}}, "invalid-parameter", "params.ratio")):
        reply = daemon.post(f"/v1/clouds/{cloud}/jobs", json.dumps(document).encode(), *json_type)
        assert (reply.status, reply.slug, reply.json["errors"][0]["parameter"]) == (400, slug, parameter)
    for wrong in (cloud[:-1], cloud + "0", "x" * 64, "0" * 64):
        assert daemon.post(f"/v1/clouds/{wrong}/jobs", b"{}", *json_type).slug == "no-such-cloud"
    assert daemon.post(f"/v1/clouds/{cloud}/jobs?ratio=0.1", b"{}", *json_type).slug == "unknown-parameter"


@pytest.mark.parametrize("parts, slug, word", [
    ([("name=label", b"x")], "malformed-request", "file"),
    ([FILE, FILE], "unknown-parameter", "more than once"),
    ([FILE, ("name=fiel", b"x")], "unknown-parameter", "fiel"),
    ([('name="cloud"; filename="a"', SMALL)], "unknown-parameter", "file"),
    ([FILE, ("name=ratio", b"9")], "invalid-parameter", "ratio"),
    ([FILE, ("name=ratio", b"0.1"), ("name=points", b"5")], "conflicting-parameters", "points"),
    ([FILE, ("name=seed", b"1"), ("name=seed", b"2")], "unknown-parameter", "once"),
    ([FILE, ("name=seed", b"1"), ("name=params", b'{"seed":1}')], "unknown-parameter", "once"),
    ([FILE, ("name=params", b"{"), ], "malformed-request", "params"),
    ([FILE, ("name=params", b"{}"), ("name=params", b"{}")], "unknown-parameter", "params"),
    ([FILE, ("name=label", b"a\0b")], "invalid-parameter", "NUL"),
    ([FILE, ("name=label", b"x" * 600)], "body-too-large", "label"),
    ([FILE, ("name=label", b"\xff")], "invalid-parameter", "UTF-8"),
    ([FILE, ("nom=x", b"")], "malformed-request", "name"),
    ([FILE, ("name=" + "n" * 99, b"")], "malformed-request", "name"),
    ([(FILE[0] + "\r\nContent-Transfer-Encoding: base64", b"")], "malformed-request", "Transfer-Encoding"),
    ([(FILE[0] + "\r\nContent-Type: image/png", SMALL)], "unsupported-format", "image/png"),
    ([(FILE[0], b"\x89PNG\r\n\x1a\n" + bytes(9000))], "unsupported-format", "PNG"),
    ([(FILE[0] + "\r\nX: " + "x" * 5000, SMALL)], "malformed-request", "too long"),
])
def test_refused_forms(daemon, parts, slug, word):
    reply = post_form(daemon, form(*parts))
    assert reply.slug == slug and word in reply.body.decode(), reply.body


@pytest.mark.parametrize("body", [b"", b"--frontier", form(FILE)[:-6], form(FILE)[:200], b"--frontier\r\n\r\nx",
                                  b"--frontierx\r\n", b"no boundary at all", b"--frontier\r\nContent-Disposition\r\n\r\n"])
def test_broken_forms(daemon, body):
    reply = post_form(daemon, body)
    assert (reply.status, reply.slug) == (400, "malformed-request") and "byte_offset" in reply.json


@pytest.mark.parametrize("media", ["multipart/form-data", "multipart/form-data; boundary=", "multipart/form-data; boundary="
                                   + "x" * 71])
def test_a_form_wants_a_boundary(daemon, media):
    reply = daemon.post("/v1/jobs", form(FILE), "-H", f"Content-Type: {media}")
    assert (reply.status, reply.slug) == (400, "malformed-request") and "boundary" in reply.json["detail"]


def test_the_file_of_a_form_has_the_bodys_limit(daemon):
    reply = post_form(daemon, form((FILE[0], b"0.25 0.5 0.75\n" * (40 << 16))))
    assert (reply.status, reply.slug) == (413, "body-too-large")


# ---------------------------------------------------------------------------------------------- pieces

BOUNDARY = "x" * 60
NEAR = f"\r\n--{BOUNDARY[:-1]}-".encode()  # a boundary, but for its last byte


def in_a_form(content):
    head = b'Content-Disposition: form-data; name="file"; filename="c"'
    return b"--%b\r\n%b\r\n\r\n%b\r\n--%b--\r\n" % (BOUNDARY.encode(), head, content, BOUNDARY.encode())


def send_in_chunks(daemon, body, media, request="POST /v1/clouds", *headers):
    """One byte in each chunk; the status."""
    head = [f"{request} HTTP/1.1", "Host: localhost", "Connection: close", f"Content-Type: {media}",
            "Transfer-Encoding: chunked", *headers, "", ""]
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=PATIENCE_S) as connection:
        connection.sendall("\r\n".join(head).encode()
                           + b"".join(b"1\r\n%c\r\n" % byte for byte in body) + b"0\r\n\r\n")
        return int(connection.makefile("rb").readline().split()[1])


def write_calls(daemon):
    """How often the service has called write(2) and its like."""
    text = pathlib.Path(f"/proc/{daemon.process.pid}/io").read_text(encoding="ascii")
    return int(re.search(r"^syscw: (\d+)", text, re.MULTILINE)[1])


@pytest.mark.parametrize("kind", ["boundaries that aren't", "line ends", "a byte in a chunk", "a cloud's byte in a chunk"])
def test_what_comes_in_crumbs_is_written_in_pages(make_daemon, kind):
    daemon = make_daemon()
    media = f"multipart/form-data; boundary={BOUNDARY}"
    content = SMALL + {"boundaries that aren't": 16384 * NEAR, "line ends": 300000 * b"\r"}.get(kind, sphere(6000))
    before = write_calls(daemon)
    if kind == "a byte in a chunk":
        assert send_in_chunks(daemon, in_a_form(content), media) == 201
    elif kind == "a cloud's byte in a chunk":
        assert send_in_chunks(daemon, content, "text/plain") == 201
    else:
        reply = daemon.post("/v1/clouds", in_a_form(content), "-H", f"Content-Type: {media}")
        assert reply.status == 201, reply.body
    assert write_calls(daemon) - before < len(content) / 4096 + 100
    assert daemon.curl(f"/v1/clouds/{hashlib.sha256(content).hexdigest()}/data").body == content


def test_the_crumbs_of_an_upload_s_piece_are_written_in_pages(daemon):
    content = sphere(6000)
    tus = ("Tus-Resumable: 1.0.0", "Upload-Offset: 0")
    upload = daemon.curl("/v1/uploads", "-X", "POST", "-H", tus[0], "-H", f"Upload-Length: {len(content)}").headers["location"]
    before = write_calls(daemon)
    media = "application/offset+octet-stream"
    assert send_in_chunks(daemon, content, media, f"PATCH {upload}", *tus) == 204
    assert write_calls(daemon) - before < len(content) / 4096 + 100
    assert daemon.curl(f"/v1/clouds/{hashlib.sha256(content).hexdigest()}/data").body == content


# ---------------------------------------------------------------------------------------------- content codings

def zstd(data):
    if not shutil.which("zstd"):
        pytest.skip("zstd isn't installed")
    return subprocess.run(["zstd", "-c"], input=data, capture_output=True, check=True).stdout


@pytest.mark.parametrize("coding, pack", [("gzip", gzip.compress), ("x-gzip", gzip.compress), ("GZIP", gzip.compress),
                                          ("zstd", zstd), ("identity", bytes)])
def test_codings_are_undone(daemon, coding, pack):
    reply = daemon.post("/v1/jobs?points=50", pack(SMALL), "-H", f"Content-Encoding: {coding}")
    assert reply.status == 201 and reply.json["input"]["sha256"] == NAME
    assert reply.json["input"]["bytes"] == len(SMALL)
    packed_form = daemon.post("/v1/jobs", pack(form(FILE)), "-H", f"Content-Encoding: {coding}",
                              "-H", "Content-Type: multipart/form-data; boundary=frontier")
    assert packed_form.status == 201 and packed_form.json["input"]["sha256"] == NAME


@pytest.mark.parametrize("coding", ["br", "deflate", "gzip, gzip", "compress"])
def test_unknown_codings(daemon, coding):
    reply = daemon.post("/v1/jobs", SMALL, "-H", f"Content-Encoding: {coding}")
    assert (reply.status, reply.slug) == (415, "unsupported-format")
    assert reply.json["supported"] == ["gzip", "zstd", "identity"]


@pytest.mark.parametrize("body", [SMALL, b"", gzip.compress(SMALL)[:-3], gzip.compress(SMALL)[:100],
                                  gzip.compress(SMALL) + b"x"],
                         ids=["plain", "nothing", "without its end", "a part", "with more behind"])
def test_what_is_not_compressed_as_it_says(daemon, body):
    reply = daemon.post("/v1/jobs", body, "-H", "Content-Encoding: gzip")
    assert (reply.status, reply.slug) == (400, "malformed-request") and "Content-Encoding" in reply.json["detail"]


def test_a_small_body_that_becomes_a_large_one(daemon):
    bomb = gzip.compress(b"0 0 0\n" * (60 << 20 >> 2), 9)
    reply = daemon.post("/v1/clouds", bomb, "-H", "Content-Encoding: gzip")
    assert (reply.status, reply.slug) == (413, "body-too-large") and reply.json["limit_expansion"] == 250
    large = gzip.compress(sphere(30000) * 40, 1)
    reply = daemon.post("/v1/clouds", large, "-H", "Content-Encoding: gzip")
    assert (reply.status, reply.slug) == (413, "body-too-large") and reply.json["limit"] == 32 << 20


def test_what_comes_out_is_looked_at(daemon):
    reply = daemon.post("/v1/jobs", gzip.compress(b"\x89PNG\r\n\x1a\n" + bytes(9999)), "-H", "Content-Encoding: gzip")
    assert (reply.status, reply.slug) == (415, "unsupported-format") and "PNG" in reply.json["detail"]


# ---------------------------------------------------------------------------------------------- digests

def digest_of(data):
    return f"sha-256=:{base64.b64encode(hashlib.sha256(data).digest()).decode()}:"


@pytest.mark.parametrize("name", ["Content-Digest", "Repr-Digest"])
def test_digests(daemon, name):
    packed = gzip.compress(SMALL)
    for body, more in ((SMALL, ()), (packed, ("-H", "Content-Encoding: gzip"))):
        for value in (digest_of(body), f"md5=:AAAA:, {digest_of(body)}", "sha=:AAAA:", "md5=:AAAA:"):
            assert daemon.post("/v1/jobs?points=50", body, "-H", f"{name}: {value}", *more).status == 201


@pytest.mark.parametrize("name", ["Content-Digest", "Repr-Digest"])
@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/simplify", "/v1/clouds"])
def test_a_wrong_digest_keeps_nothing(daemon, name, path):
    cloud = sphere(77)
    reply = daemon.post(path, cloud, "-H", f"{name}: {digest_of(SMALL)}")
    assert (reply.status, reply.slug) == (400, "digest-mismatch") and reply.json["actual"] in digest_of(cloud)
    assert daemon.curl(f"/v1/clouds/{hashlib.sha256(cloud).hexdigest()}").status == 404
    assert not (daemon.data / "clouds" / hashlib.sha256(cloud).hexdigest()).exists()
    assert not [name for name in daemon.leftovers() if name.startswith("upload-")]


@pytest.mark.parametrize("value", ["sha-256=x", "sha-256=:AAAA:", "sha-256=:" + "!" * 43 + "=:", "sha-256="])
def test_a_malformed_digest(daemon, value):
    assert daemon.post("/v1/jobs", SMALL, "-H", f"Content-Digest: {value}").slug == "malformed-request"
