# SPDX-License-Identifier: GPL-3.0-or-later
"""HTTP by the letter: conditions, digests, preferences, heads that hold what they must not, half-closed connections,
and what somebody meets who begins with curl."""
import base64
import hashlib
import json
import pathlib
import re
import socket
import subprocess

import pytest

import conftest
from conftest import SMALL, parse_reply, sphere, wait_until


def raw(daemon, data, half_close=True):
    """Sends bytes; all that comes back until the connection's end."""
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=conftest.PATIENCE_S) as connection:
        connection.sendall(data)
        if half_close:
            connection.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: connection.recv(65536), b""))


def ask(daemon, target, *lines, method="GET"):
    return raw(daemon, b"\r\n".join([method.encode() + b" " + target + b" HTTP/1.1", b"Host: localhost",
                                     b"Connection: close", *lines, b"", b""]))


@pytest.fixture(name="ended")
def make_ended(daemon):
    """(path of a job that has ended, its output's path)"""
    job_id = daemon.submit(SMALL, "?ratio=0.5")
    daemon.ended(job_id)
    return f"/v1/jobs/{job_id}", f"/v1/jobs/{job_id}/outputs/cloud.ply"


# ---------------------------------------------------------------------------------------------- If-Match

def matching(etag):
    return [etag, "*", f'"other", {etag}', f'W/"other",{etag}']


def other_than(etag):
    return ['"other"', f"W/{etag}", etag.strip('"'), f'"{etag}"', '"other", "another"', '""']


def test_if_match_on_reading(daemon, ended):
    cloud = f"/v1/clouds/{hashlib.sha256(SMALL).hexdigest()}/data"
    for path in (*ended, cloud):
        etag = daemon.curl(path).headers["etag"]
        for method in ((), ("-I",)):
            for value in matching(etag):
                assert daemon.curl(path, *method, "-H", f"If-Match: {value}").status == 200, value
            for value in other_than(etag):
                assert daemon.curl(path, *method, "-H", f"If-Match: {value}").status == 412, value
    reply = daemon.curl(ended[1], "-H", 'If-Match: "other"', "-H", "Range: bytes=0-1", "-H", "If-None-Match: *")
    assert (reply.status, reply.slug) == (412, "precondition-failed")  # it counts before the others
    assert daemon.curl("/v1/info", "-H", 'If-Match: "x"').status == 412  # that has no tag
    assert daemon.curl("/v1/info", "-H", "If-Match: *").status == 200


def test_if_match_in_two_lines(daemon, ended):
    etag = daemon.curl(ended[1]).headers["etag"]
    assert daemon.curl(ended[1], "-H", 'If-Match: "other"', "-H", f"If-Match: {etag}").status == 200
    assert daemon.curl(ended[1], "-H", f"If-None-Match: {etag}", "-H", 'If-None-Match: "other"').status == 304


def test_if_match_on_deleting(daemon, ended):
    job, output = ended
    etag = daemon.curl(job).headers["etag"]
    for value in other_than(etag):
        reply = daemon.curl(job, "-X", "DELETE", "-H", f"If-Match: {value}")
        assert (reply.status, reply.slug) == (412, "precondition-failed")
    assert daemon.curl(output).status == 200
    assert daemon.curl(job, "-X", "DELETE", "-H", f"If-Match: {etag}").status == 200
    assert daemon.curl(job).status == 410


@pytest.fixture(name="gated")
def make_gated(make_daemon, tmp_path):
    """A service whose one worker begins with its job when the gate, a file, is removed: until then the job runs."""
    gate, worker = tmp_path / "gate", tmp_path / "worker"
    gate.touch()
    program = pathlib.Path(conftest.BUILD).resolve() / "whittle"
    worker.write_text(f'#!/bin/sh\nwhile [ -e "{gate}" ]; do sleep 0.02; done\nexec "{program}" "$@"\n')
    worker.chmod(0o755)
    yield lambda *flags: (make_daemon("--worker", worker, "--worker-sandbox=off", "--workers", "1", *flags), gate)
    gate.unlink(missing_ok=True)


def test_if_match_on_dismissing(gated):
    daemon, _ = gated()
    running = daemon.submit(SMALL)
    daemon.wait_for(running, "running")
    waiting = daemon.submit(SMALL)
    for job_id in (running, waiting):
        assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE", "-H", 'If-Match: "0"').slug == "precondition-failed"
    assert [daemon.job(job_id)["status"] for job_id in (running, waiting)] == ["running", "accepted"]
    etag = daemon.curl(f"/v1/jobs/{waiting}").headers["etag"]
    gone = daemon.curl(f"/v1/jobs/{waiting}", "-X", "DELETE", "-H", f"If-Match: {etag}")
    assert gone.json["status"] == "dismissed"
    assert daemon.curl(f"/v1/jobs/{running}", "-X", "DELETE", "-H", "If-Match: *").json["status"] == "dismissed"


def test_if_match_on_what_has_no_tag(daemon):
    cloud = daemon.post("/v1/clouds", SMALL).headers["location"]
    upload = daemon.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Length: 9").headers["location"]
    for path in (cloud, upload):
        delete = (path, "-X", "DELETE", "-H", "Tus-Resumable: 1.0.0")
        assert daemon.curl(*delete, "-H", 'If-Match: "x"').slug == "precondition-failed"
        assert daemon.curl(path).status == 200
        assert daemon.curl(*delete, "-H", "If-Match: *").status in (200, 204)
        assert daemon.curl(path).status == 404


# ---------------------------------------------------------------------------------------------- 304

def test_304_has_what_200_has(daemon, ended):
    for path in (*ended, f"/v1/clouds/{hashlib.sha256(SMALL).hexdigest()}/data"):
        whole = daemon.curl(path)
        same = daemon.curl(path, "-H", f"If-None-Match: {whole.headers['etag']}")
        assert (same.status, same.body) == (304, b"")
        for name in ("etag", "cache-control"):
            assert same.headers[name] == whole.headers[name]
        assert int(same.headers["content-length"]) == len(whole.body)


def test_304_of_a_job_under_way(gated):
    daemon, _ = gated()
    daemon.submit(SMALL)
    path = f"/v1/jobs/{daemon.submit(SMALL)}"
    whole = daemon.curl(path)
    same = daemon.curl(path, "-H", f"If-None-Match: {whole.headers['etag']}")
    assert same.status == 304 and same.headers["cache-control"] == whole.headers["cache-control"] == "no-cache"


def test_a_connection_goes_on_after_304(daemon, ended):
    etag = daemon.curl(ended[1]).headers["etag"].encode()
    answer = raw(daemon, b"GET " + ended[1].encode() + b" HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: " + etag +
                 b"\r\n\r\nGET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    assert re.findall(rb"HTTP/1.1 (\d+)", answer) == [b"304", b"200"] and answer.endswith(b'{"status":"alive"}')


# ---------------------------------------------------------------------------------------------- digests

def sha(bits, data):
    return f"sha-{bits}=:{base64.b64encode(hashlib.new(f'sha{bits}', data).digest()).decode()}:"


@pytest.mark.parametrize("name", ["Content-Digest", "Repr-Digest"])
@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/clouds", "/v1/simplify"])
def test_sha_512(daemon, name, path):
    right, wrong = sha(512, SMALL), sha(512, b"x")
    for value in (right, f"{sha(256, SMALL)}, {right}", right.replace("sha", "SHA"), f"md5=:AAAA:, {right}"):
        assert daemon.post(path, SMALL, "-H", f"{name}: {value}").status in (200, 201), value
    for value in (wrong, f"{sha(256, SMALL)}, {wrong}", f"{wrong}, {sha(256, SMALL)}", f"{right}, {sha(256, b'x')}",
                  f"{right}, {wrong}"):
        cloud = SMALL  # known by now: the digest counts nevertheless
        reply = daemon.post(path, cloud, "-H", f"{name}: {value}")
        assert (reply.status, reply.slug) == (400, "digest-mismatch"), value
        assert reply.json["actual"] in (right[9:-1], sha(256, SMALL)[9:-1])


def test_a_digest_in_a_second_line_counts(daemon):
    reply = daemon.post("/v1/clouds", SMALL, "-H", f"Content-Digest: {sha(512, b'x')}", "-H",
                        f"Content-Digest: {sha(256, SMALL)}")
    assert reply.slug == "digest-mismatch" and daemon.curl("/v1/clouds").json["clouds"] == []


@pytest.mark.parametrize("value", ["sha-512=:AAAA:", "sha-512=" + sha(256, b"")[8:], "sha-512=x", "sha-512=::"])
def test_what_is_no_sha_512(daemon, value):
    assert daemon.post("/v1/jobs", SMALL, "-H", f"Content-Digest: {value}").slug == "malformed-request"


def test_sha_512_of_a_piece(daemon):
    path = daemon.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H",
                       f"Upload-Length: {len(SMALL)}").headers["location"]
    patch = ("-X", "PATCH", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Offset: 0", "-H",
             "Content-Type: application/offset+octet-stream", "-H")
    assert daemon.post(path, SMALL, *patch, f"Content-Digest: {sha(512, b'x')}").slug == "digest-mismatch"
    assert daemon.curl(path).headers["upload-offset"] == "0"
    assert daemon.post(path, SMALL, *patch, f"Content-Digest: {sha(512, SMALL)}").status == 204


# ---------------------------------------------------------------------------------------------- heads

@pytest.mark.parametrize("lines", [(b"X: a\0b",), (b"X: \0",), (b"X:\0a", b"Y: b"), (b"X: a\0", b"Y: b"),
                                   (b"Prefer: wait=0\0, wait=9", b"Y: b"), (b"X: a", b"Y: b\0\0\0")], ids=range(6))
def test_nul_in_a_value(daemon, lines):
    answer = ask(daemon, b"/v1/info", *lines)
    assert answer.startswith(b"HTTP/1.1 400 ") and b"malformed-request" in answer and answer.count(b"HTTP/1.1 ") == 1


@pytest.mark.parametrize("lines", [(b"X: ",), (b"X:",), (b"X:  a  ",), (b"X: a", b"Y:\tb\t"), (b"X: \xff\xfe",)], ids=range(5))
def test_values_without_nul_are_taken(daemon, lines):
    assert ask(daemon, b"/v1/info", *lines).startswith(b"HTTP/1.1 200 ")
    bare = b"GET /v1/info HTTP/1.1\nHost: localhost\n" + b"\n".join(lines) + b"\nConnection: close\n\n"
    assert raw(daemon, bare).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize("size", [10, 1000, 20000])
def test_heads_in_pieces_hold_no_nul_either(daemon, size):
    """Wherever the pieces end in libmicrohttpd's memory."""
    head = b"GET /v1/info HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nX: " + b"x" * size + b"\r\nY: y\r\n\r\n"
    for cut in (20, 40, 60, 70, len(head) - 9, len(head) - 3, len(head) - 1):
        with socket.create_connection(("127.0.0.1", daemon.port), timeout=60) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(head[:cut])
            assert daemon.curl("/healthz").status == 200  # time to read the first piece
            connection.sendall(head[cut:])
            assert connection.recv(12) == b"HTTP/1.1 200"


@pytest.mark.parametrize("target", [b"/v1/info\0", b"/v1/info\0x", b"/v1/in\0fo", b"/v1/jobs?limit=1\0", b"/v1/jobs?\0limit=1",
                                    b"/v1/jobs\0?limit=1"], ids=range(6))
def test_nul_in_the_target(daemon, target):
    answer = ask(daemon, target)
    assert answer.startswith(b"HTTP/1.1 400 ") and b"malformed-request" in answer


@pytest.mark.parametrize("path", ["/v1%2Finfo", "/v1%2finfo", "/v1/jobs%2f", "/%2Fv1/info", "/problems%2Fno-such-job"])
def test_a_slash_within_a_name_is_no_other_path(daemon, path):
    reply = daemon.curl(path, "--path-as-is")
    assert (reply.status, reply.slug) == (404, "no-such-resource")
    assert daemon.curl("/v1/jobs?label=a%2Fb").status == 200  # in a query it is what it says


@pytest.mark.parametrize("count", [66, 67, 1500, 3000, 10000])
def test_parameters_without_number(daemon, count):
    for argument in ("p", "", "p="):
        answer = ask(daemon, b"/v1/jobs?" + "&".join([argument] * count).encode())
        assert answer.startswith(b"HTTP/1.1 400 "), answer[:100]
        assert json.loads(parse_reply(answer).body)["type"] == "/problems/malformed-request"


@pytest.mark.parametrize("query", ["&ratio=0.5", "&&ratio=0.5&&", "&", "&&&"])
def test_nothing_between_two_ampersands_is_no_parameter(daemon, query):
    """As in URLs that are put together from "?" and "&name=value" each."""
    reply = daemon.post(f"/v1/jobs?{query}", SMALL)
    assert reply.status == 201, reply.body
    assert reply.json["params"]["ratio"] == (0.5 if "ratio" in query else 0.1)


def test_a_parameter_without_a_name_is_told_so(daemon):
    reply = daemon.post("/v1/jobs?=0.5", SMALL)
    assert (reply.status, reply.slug) == (400, "unknown-parameter")
    assert reply.json["detail"].startswith("a parameter without a name: ")


def test_as_many_parameters_as_there_may_be_are_read(daemon):
    reply = daemon.curl("/v1/jobs?" + "&".join(f"p{i}=1" for i in range(64)))
    assert reply.slug == "unknown-parameter"


# ---------------------------------------------------------------------------------------------- half-closed

def half_closed(daemon, cloud, *lines):
    return parse_reply(raw(daemon, b"\r\n".join([b"POST /v1/simplify?output=mesh HTTP/1.1", b"Host: localhost", *lines,
                                                 b"Content-Length: %d" % len(cloud), b"", cloud])))


def test_a_half_closed_one_shot_is_told_what_becomes_of_its_job(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    reply = half_closed(daemon, large)
    assert (reply.status, reply.slug) == (409, "job-dismissed") and "Idempotency-Key" in reply.json["detail"]
    job_id = re.search(r"/v1/jobs/([0-9a-f-]+)>", reply.headers["link"])[1]
    assert daemon.ended(job_id)["status"] == "dismissed"
    kept = half_closed(daemon, SMALL + large, b"Idempotency-Key: k")
    assert (kept.status, kept.slug) == (504, "sync-timeout") and "goes on" in kept.json["detail"]
    assert daemon.ended(kept.headers["location"].rsplit("/", 1)[1])["status"] == "successful"


# ---------------------------------------------------------------------------------------------- Prefer: wait

def wait_for_end(daemon, path, *more):
    return daemon.curl(path, "-H", "Prefer: wait=600", *more)


def test_a_wait_ends_with_the_job(make_daemon, large):
    daemon = make_daemon("--wait-max", "10m", "--workers", "1")
    path = f"/v1/jobs/{daemon.submit(large, '?outputs=mesh')}"
    reply = wait_for_end(daemon, path)
    assert reply.json["status"] == "successful" and reply.headers["preference-applied"] == "wait=600"
    assert daemon.curl(path, "-H", "Prefer: wait=600").headers["preference-applied"] == "wait=600"  # at once
    assert "preference-applied" not in daemon.curl(path).headers


def test_a_creation_may_wait_for_the_end(make_daemon):
    daemon = make_daemon("--wait-max", "10m")
    reply = daemon.post("/v1/jobs?ratio=0.5&outputs=mesh", sphere(20000), "-H", "Prefer: wait=600")
    assert (reply.status, reply.json["status"]) == (201, "successful") and reply.json["report"]["points_out"] == 10000
    assert reply.headers["preference-applied"] == "wait=600" and reply.headers["location"].endswith(reply.json["id"])
    assert daemon.curl(reply.headers["location"]).json == reply.json


def test_a_wait_that_is_over_before_the_job(gated):
    daemon, _ = gated()
    first = daemon.post("/v1/jobs", sphere(100), "-H", "Prefer: wait=0")
    assert (first.status, first.headers["preference-applied"]) == (201, "wait=0")
    assert first.json["status"] in ("accepted", "running")
    second = daemon.post("/v1/jobs", SMALL, "-H", "Prefer: wait=1")
    assert (second.status, second.json["status"]) == (201, "accepted")  # it waited behind the first
    assert second.headers["preference-applied"] == "wait=1"
    late = daemon.curl(first.headers["location"], "-H", "Prefer: wait=1")
    assert late.json["status"] == "running" and late.headers["preference-applied"] == "wait=1"


def test_a_wait_is_cut_to_the_limit(gated):
    daemon, _ = gated("--wait-max", "1s", "--sync-max", "1s")
    daemon.submit(SMALL)
    reply = daemon.post("/v1/jobs", SMALL, "-H", "Prefer: wait=1000")
    assert reply.status == 201 and reply.headers["preference-applied"] == "wait=1"
    shot = daemon.post("/v1/simplify?ratio=0.4", SMALL, "-H", "Prefer: wait=1000")
    assert shot.status == 504 and shot.headers["preference-applied"] == "wait=1"


def test_a_creation_that_waits_keeps_its_reply_for_its_key(make_daemon):
    daemon = make_daemon("--wait-max", "10m")
    send = ("/v1/jobs", sphere(5000), "-H", "Prefer: wait=600", "-H", "Idempotency-Key: k")
    first = daemon.post(*send)
    assert first.json["status"] == "successful"
    again = daemon.post(*send)
    assert (again.status, again.body) == (201, first.body) and again.headers["location"] == first.headers["location"]
    assert len(daemon.curl("/v1/jobs").json["jobs"]) == 1


def test_a_creation_whose_client_leaves_goes_on(gated):
    daemon, gate = gated()
    command = daemon.curl_command("/v1/jobs?label=mine", "-X", "POST", "--data-binary", "@-", "-H", "Prefer: wait=60")
    daemon.submit(sphere(100))
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as client:
        client.stdin.write(SMALL)
        client.stdin.close()
        job = wait_until(lambda: daemon.curl("/v1/jobs?label=mine").json["jobs"], "the job")[0]
        assert client.poll() is None  # it waits
        client.kill()
    gate.unlink()
    assert daemon.ended(job["id"])["status"] == "successful"


def test_both_preferences_mean_later_if_it_takes_longer(gated):
    daemon, gate = gated()
    both = ("-H", "Prefer: respond-async", "-H", "Prefer: wait=1")
    late = daemon.post("/v1/simplify", sphere(100), *both)
    assert late.status == 202 and late.json["status"] == "running"
    assert daemon.curl(late.headers["location"], "-X", "DELETE").status == 200
    gate.unlink()
    soon = daemon.post("/v1/simplify", SMALL, "-H", "Prefer: respond-async, wait=60")
    assert soon.status == 200 and soon.headers["preference-applied"] == "wait=60" and soon.body.startswith(b"ply")


# ---------------------------------------------------------------------------------------------- beginners

def test_the_page_names_the_host_that_it_was_asked_of(make_daemon):
    daemon = make_daemon("--allowed-hosts", "*")
    for host in (f"127.0.0.1:{daemon.port}", "whittle.example.org", "[::1]:8080"):
        page = daemon.curl("/", "-H", f"Host: {host}").body.decode()
        assert f"'{host}/v1/simplify?ratio=0.1'" in page and "$HERE" not in page and "localhost:8080" not in page
        assert page.count(host) == len(re.findall(r"\bcurl -", page)) and page.rstrip().endswith("</html>")
    secure = daemon.curl("/", "-H", "Host: whittle.example.org", "-H", "X-Forwarded-Proto: https").body.decode()
    assert "'https://whittle.example.org/v1/simplify?" in secure and not re.search(r"'whittle\.example", secure)


@pytest.mark.parametrize("host", ["a'b", "a&b", "$(a)", "a;b", "%3Cb%3E"])
def test_the_page_repeats_nothing_that_means_more_than_itself(make_daemon, host):
    page = make_daemon("--allowed-hosts", "*").curl("/", "-H", f"Host: {host}").body.decode()
    assert host not in page and "'localhost:8080/v1/simplify" in page


def test_the_page_under_a_base_path(make_daemon):
    daemon = make_daemon("--base-path", "/whittle")
    assert f"'127.0.0.1:{daemon.port}/whittle/v1/simplify?" in daemon.curl("/whittle/").body.decode()


def test_the_page_s_commands_work(daemon, tmp_path):
    (tmp_path / "in.ply").write_bytes(SMALL)
    command = re.search(r"<(pre|code)>(curl [^<]*/v1/simplify[^<]*)</\1>", daemon.curl("/").body.decode())[2]
    subprocess.run(command.replace("&amp;", "&").replace("\n", " "), shell=True, cwd=tmp_path, check=True)
    assert (tmp_path / "out.ply").read_bytes().startswith(b"ply")


@pytest.mark.parametrize("path, status, instead", [
    ("/v1/simplify?ratio=0.1", 405, "/v1/simplify"), ("/v1/jobs", 405, "/v1/jobs"), ("/v1/clouds", 405, "/v1/clouds"),
    ("/v1/info", 405, "/v1/simplify"), ("/", 404, "/v1/simplify"), ("/v1/jobs/", 405, "/v1/simplify")])
def test_curl_with_t_alone_is_told_what_to_do(make_daemon, tmp_path, path, status, instead):
    daemon = make_daemon()
    (tmp_path / "in.ply").write_bytes(SMALL)
    reply = daemon.curl(path, "-T", tmp_path / "in.ply")
    assert reply.status == status and reply.slug in ("method-not-allowed", "no-such-resource")
    assert "curl -X POST -T FILE" in reply.json["hint"] and reply.json["hint"].endswith(f" {instead}")
    done = daemon.curl(instead, "-X", "POST", "-T", tmp_path / "in.ply")
    assert done.status in (200, 201)
