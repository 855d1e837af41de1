# SPDX-License-Identifier: GPL-3.0-or-later
"""Every limit of /v1/info can be reached, and says so."""
import concurrent.futures
import gzip
import hashlib
import http.client
import json
import pathlib
import re
import resource
import select
import signal
import socket
import subprocess
import time

import pytest

from conftest import BUILD, PATIENCE_S, SMALL, Daemon, sphere, wait_until


def connect(daemon):
    return socket.create_connection(("127.0.0.1", daemon.port), timeout=60)


def is_cut(connection):
    """Reads to the end of the connection; what came before it."""
    answer = b""
    while True:
        try:
            part = connection.recv(65536)
        except ConnectionResetError:
            return answer
        if not part:
            return answer
        answer += part


# ---------------------------------------------------------------------------------------------- heads

def test_headers_over_the_limit(make_daemon):
    daemon = make_daemon("--max-header-bytes", "2K")
    assert daemon.curl("/v1/info", "-H", "X: " + "x" * 1500).status == 200
    reply = daemon.curl("/v1/info", "-H", "X: " + "x" * 2500)
    assert (reply.status, reply.slug) == (431, "headers-too-large")
    assert reply.json["limit"] == 2048 < reply.json["actual"]
    assert reply.headers["connection"] == "close"


def test_headers_over_what_can_be_read_at_all(daemon):
    with connect(daemon) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 300000)
        answer = is_cut(connection)
    # The library's own 431, where the client's kernel doesn't drop it for what was not read.
    assert answer == b"" or answer.startswith(b"HTTP/1.1 431 ")
    assert daemon.log_text().count("HTTP response code is 431 ") == 1
    assert daemon.curl("/healthz").status == 200


def test_parameters_over_the_limit(make_daemon):
    daemon = make_daemon("--max-parameters", "3")
    assert daemon.curl("/v1/jobs?limit=1&label=x&status=failed").status == 200
    reply = daemon.curl("/v1/jobs?limit=1&label=x&status=failed&more=1")
    assert (reply.status, reply.slug, reply.json["limit"]) == (400, "malformed-request", 3)


# ---------------------------------------------------------------------------------------------- principals

def line(name):
    return f"{name}:submit,read:{hashlib.sha256(name.encode()).hexdigest()}\n"


@pytest.fixture(name="shared")
def make_shared(tmp_path, make_daemon):
    """make(*flags): a daemon with the tokens a and b."""
    tokens = tmp_path / "tokens"
    tokens.write_text(line("a") + line("b"))
    return lambda *flags: make_daemon("--tokens-file", tokens, *flags)


def post(daemon, name, data, path="/v1/jobs"):
    return daemon.post(path, data, "-H", f"Authorization: Bearer {name}")


def test_jobs_of_one_principal(shared, large):
    daemon = shared("--principal-jobs", "1", "--workers", "1")
    first = post(daemon, "a", large)
    assert first.status == 201
    for path in ("/v1/jobs", "/v1/simplify"):
        reply = post(daemon, "a", SMALL, path)
        assert (reply.status, reply.slug, reply.json["limit"]) == (429, "rate-limited", 1)
        assert int(reply.headers["retry-after"]) > 0
    assert post(daemon, "b", SMALL).status == 201
    path = first.headers["location"]
    assert daemon.curl(path, "-X", "DELETE", "-H", "Authorization: Bearer a").json["status"] == "dismissed"
    assert post(daemon, "a", SMALL).status == 201


def upload(daemon, who):
    """A resumable upload, its length yet to come."""
    return daemon.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Defer-Length: 1", "-H",
                       f"Authorization: Bearer {who}")


@pytest.mark.parametrize("flags, own", [((), 2), (("--principal-uploads", "3"), 3)])
def test_resumable_uploads_of_one_principal(shared, flags, own):
    daemon = shared("--max-uploads", "7", *flags)
    assert daemon.curl("/v1/info").json["limits"]["principal_uploads"] == own
    paths = [upload(daemon, "a").headers["location"] for _ in range(own)]
    reply = upload(daemon, "a")
    assert (reply.status, reply.slug, reply.json["limit"]) == (429, "rate-limited", own)
    assert int(reply.headers["retry-after"]) > 0 and "principal_uploads" in reply.json["detail"]
    assert upload(daemon, "b").status == 201
    daemon.stop()
    daemon.start()
    assert upload(daemon, "a").status == 429
    gone = daemon.curl(paths[0], "-X", "DELETE", "-H", "Tus-Resumable: 1.0.0", "-H", "Authorization: Bearer a")
    assert gone.status == 204 and upload(daemon, "a").status == 201


def test_without_tokens_all_resumable_uploads_are_one_principals(make_daemon):
    daemon = make_daemon("--max-uploads", "7")
    assert daemon.curl("/v1/info").json["limits"]["principal_uploads"] == 7
    assert [upload(daemon, "nobody").status for _ in range(8)] == [201] * 7 + [503]


def test_bytes_of_one_principal(shared):
    daemon = shared("--principal-bytes", str(len(SMALL) + 100))
    first = post(daemon, "a", SMALL)
    assert first.status == 201
    reply = post(daemon, "a", sphere(50))
    assert (reply.status, reply.slug, reply.json["limit"]) == (429, "rate-limited", len(SMALL) + 100)
    assert post(daemon, "b", SMALL).status == 201
    path = first.headers["location"]
    wait_until(lambda: daemon.curl(path, "-H", "Authorization: Bearer a").json["finished"], "the end")
    assert daemon.curl(path, "-X", "DELETE", "-H", "Authorization: Bearer a").status == 200
    assert post(daemon, "a", sphere(50)).status == 201


def test_what_can_never_be_kept_is_told_from_what_is_too_much_now(shared):
    """413 has no Retry-After; 429 tells what there is, and what would come."""
    limit = len(SMALL) + 100
    daemon = shared("--principal-bytes", str(limit), "--max-body-bytes", "20000")
    large, larger = sphere(400), sphere(1000)
    assert limit < len(large) < 20000 < len(larger)
    for path, more in (("/v1/jobs", ()), ("/v1/clouds", ()), ("/v1/simplify", ()),
                       ("/v1/uploads", (f"Upload-Length: {len(large)}", "Tus-Resumable: 1.0.0"))):
        lines = [part for header in more for part in ("-H", header)]
        reply = daemon.post(path, b"" if more else large, "-H", "Authorization: Bearer a", *lines)
        assert (reply.status, reply.slug, reply.json["limit"], reply.json["actual"]) == (
            413, "body-too-large", limit, len(large)), path
        assert "retry-after" not in reply.headers and f"principal_bytes is {limit}" in reply.json["detail"]
    assert post(daemon, "a", larger).json["limit"] == 20000
    assert daemon.post("/v1/clouds", SMALL, "-H", "Authorization: Bearer a").status == 201
    reply = post(daemon, "a", sphere(50))
    assert (reply.status, reply.slug) == (429, "rate-limited")
    assert (reply.json["limit"], reply.json["actual"]) == (limit, len(SMALL) + len(sphere(50)))
    assert f"{len(SMALL)} bytes are kept for you, and {len(sphere(50))} would come" in reply.json["detail"]
    assert post(daemon, "a", larger).json["limit"] == 20000


def test_bytes_are_counted_where_no_length_is_told(shared):
    daemon = shared("--principal-bytes", "1K")
    reply = daemon.post("/v1/jobs", SMALL, "-H", "Authorization: Bearer a", "-H", "Transfer-Encoding: chunked")
    assert (reply.status, reply.slug) == (429, "rate-limited")
    assert daemon.leftovers() == []


def tus(daemon, method, path, *headers, data=b""):
    lines = [part for header in ("Tus-Resumable: 1.0.0", "Authorization: Bearer a", *headers) for part in ("-H", header)]
    if method == "PATCH":
        lines += ["-H", "Content-Type: application/offset+octet-stream"]
    return daemon.post(path, data, *lines, "-X", method)


def test_clouds_without_a_length_count_too(shared):
    daemon = shared("--principal-bytes", "1K")
    reply = daemon.post("/v1/clouds", SMALL, "-H", "Authorization: Bearer a", "-H", "Transfer-Encoding: chunked")
    assert (reply.status, reply.slug) == (413, "body-too-large")  # deleting makes no room for it
    packed = daemon.post("/v1/clouds", gzip.compress(b"0 0 0\n" * 1000), "-H", "Authorization: Bearer a", "-H",
                         "Content-Encoding: gzip")
    assert (packed.status, packed.slug, packed.json["actual"]) == (413, "body-too-large", 6000)  # as it is kept
    assert daemon.kept("clouds") == []
    wait_until(lambda: daemon.leftovers() == [], "the removal of what came")


def test_resumable_uploads_count_with_what_they_will_have(shared):
    daemon = shared("--principal-bytes", "10K")
    first = tus(daemon, "POST", "/v1/uploads", f"Upload-Length: {len(SMALL)}")
    assert first.status == 201
    path = first.headers["location"]
    for refused in (tus(daemon, "POST", "/v1/uploads", "Upload-Length: 2000"), post(daemon, "a", SMALL)):
        assert (refused.status, refused.slug, refused.json["limit"]) == (429, "rate-limited", 10240)
    assert post(daemon, "b", SMALL).status == 201
    assert tus(daemon, "PATCH", path, "Upload-Offset: 0", data=SMALL[:5000]).status == 204  # its own bytes are within
    assert tus(daemon, "PATCH", path, "Upload-Offset: 5000", data=SMALL[5000:]).status == 204
    assert tus(daemon, "POST", "/v1/uploads", "Upload-Length: 2000").slug == "rate-limited"  # a cloud now
    assert tus(daemon, "POST", "/v1/uploads", "Upload-Length: 1000").status == 201


@pytest.mark.parametrize("how", ["clouds", "jobs", "reused", "uploads"])
def test_the_share_in_bytes_holds_for_requests_side_by_side(shared, how):
    length = len(SMALL)
    daemon = shared("--principal-bytes", str(3 * length + (40000 if how == "reused" else 100)), "--max-uploads", "100")
    if how == "reused":  # an earlier result serves: inputs and outputs count once more
        first = post(daemon, "a", SMALL).headers["location"]
        wait_until(lambda: daemon.curl(first, "-H", "Authorization: Bearer a").json["finished"], "the end")

    def one(i):
        if how == "uploads":
            return tus(daemon, "POST", "/v1/uploads", f"Upload-Length: {length}")
        path = "/v1/clouds" if how == "clouds" else "/v1/jobs?points=20"
        body = SMALL if how == "reused" else SMALL[:-1] + b" %02d\n" % i
        return daemon.post("/v1/jobs" if how == "reused" else path, body, "-H", "Authorization: Bearer a")
    with concurrent.futures.ThreadPoolExecutor(20) as pool:
        replies = list(pool.map(one, range(20)))
    assert {reply.status for reply in replies} == {201, 429}
    taken = [reply for reply in replies if reply.status == 201]
    kept = daemon.ask("SELECT (SELECT coalesce(sum(length), 0) FROM uploads WHERE principal = 'a') + (SELECT "
                      "coalesce(sum(bytes), 0) FROM clouds WHERE principal = 'a') + (SELECT coalesce(sum(input_bytes),"
                      " 0) FROM jobs WHERE principal = 'a')")[0][0]
    outputs = daemon.ask("SELECT coalesce(sum(bytes), 0) FROM outputs WHERE job IN (SELECT id FROM jobs WHERE "
                         "principal = 'a')")[0][0]
    if how == "reused":
        assert kept + outputs <= 3 * length + 40000
    else:
        assert kept <= 3 * length + 100 and 1 <= len(taken) <= 3


def test_resumable_uploads_of_no_known_length_count_with_what_has_come(shared):
    daemon = shared("--principal-bytes", "4K")
    path = tus(daemon, "POST", "/v1/uploads", "Upload-Defer-Length: 1").headers["location"]
    assert tus(daemon, "PATCH", path, "Upload-Offset: 0", data=SMALL[:3000]).status == 204
    assert tus(daemon, "PATCH", path, "Upload-Offset: 3000", data=SMALL[3000:5000]).slug == "rate-limited"
    assert tus(daemon, "PATCH", path, "Upload-Offset: 3000", "Upload-Length: 5000").slug == "rate-limited"
    assert tus(daemon, "PATCH", path, "Upload-Offset: 3000", f"Upload-Length: {len(SMALL)}").slug == "body-too-large"
    rest = tus(daemon, "PATCH", path, "Upload-Offset: 3000", "Transfer-Encoding: chunked", data=SMALL[3000:])
    assert rest.slug == "rate-limited"  # nobody knew how much it would be ...
    assert tus(daemon, "PATCH", path, f"Upload-Offset: {len(SMALL)}", "Upload-Length: 8548").slug == "body-too-large"
    assert "whittle-cloud" not in daemon.curl(path, "-H", "Authorization: Bearer a").headers  # ... and becomes no cloud
    assert daemon.kept("clouds") == []
    assert tus(daemon, "DELETE", path).status == 204
    assert tus(daemon, "POST", "/v1/uploads", "Upload-Length: 4096").status == 201


# ---------------------------------------------------------------------------------------------- connections

def admin_of(daemon):
    """(host, port) of the admin listener."""
    line = daemon.process.stdout.readline()
    assert line.startswith("health and metrics on http://"), line
    host, port = line.split("//")[1].strip().split(":")
    return host, int(port)


def ask(connection, path):
    connection.request("GET", path)
    reply = connection.getresponse()
    return reply.status, reply.read().decode()


def test_connections(make_daemon):
    """All come to their turn, as the service lets go of those that say nothing while others wait; never more at a time."""
    daemon = make_daemon("--max-connections", "8")
    admin = http.client.HTTPConnection(*admin_of(daemon), timeout=PATIENCE_S)
    held = [connect(daemon) for _ in range(30)]
    for connection in held:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
    answered, most = set(), 0
    while len(answered) < len(held):
        ready, _, _ = select.select([c for c in held if c not in answered], [], [], PATIENCE_S)
        assert ready, f"{len(answered)} of {len(held)} were answered"
        for connection in ready:
            assert connection.recv(12) == b"HTTP/1.1 200"
            answered.add(connection)
        open_now = int(re.search(r"^whittled_http_connections (\d+)", ask(admin, "/metrics")[1], re.MULTILINE)[1])
        most = max(most, open_now - 1)  # without the one that asks
    assert 0 < most <= 8
    for connection in held:
        connection.close()
    assert daemon.curl("/healthz").status == 200


def limited(tmp_path, files, *flags):
    folder = tmp_path / "limited"
    folder.mkdir(exist_ok=True)
    daemon = Daemon(folder, *flags)
    daemon.prefix = ("prlimit", f"--nofile={files // 2}:{files}")
    return daemon


def test_connections_leave_descriptors_to_everything_else(tmp_path):
    """The soft limit is raised to the hard one, and uploads of three descriptors each never reach it."""
    daemon = limited(tmp_path, 300, "--workers", "2", "--upload-grace", "1h", "--header-timeout", "1h").start()
    try:
        admin = http.client.HTTPConnection(*admin_of(daemon), timeout=PATIENCE_S)
        most = daemon.curl("/v1/info").json["limits"]["max_connections"]
        assert most == (300 - 64 - 64 - 32 - 2 * 8) // 3
        assert f"max-connections is {most} instead of 1000: a connection may take 3 of 300 open files" in daemon.log_text()
        held = [socket.create_connection(("127.0.0.1", daemon.port), source_address=(f"127.0.0.{2 + i % 20}", 0))
                for i in range(200)]
        for connection in held:
            connection.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n0 0 0\n")
        for _ in range(20):
            assert ask(admin, "/healthz")[0] == 200
            assert len(list(pathlib.Path(f"/proc/{daemon.process.pid}/fd").iterdir())) < 300
        assert daemon.curl("/healthz").status == 200  # as those that send nothing are cut
        for connection in held:
            connection.close()
        assert daemon.ended(daemon.submit(SMALL))["status"] == "successful"
        daemon.process.send_signal(signal.SIGHUP)
        wait_until(lambda: "reading settings, tokens and certificate again" in daemon.log_text(), "the reload")
        assert daemon.stop() == 0
        assert "max-connections has changed" not in daemon.log_text()
        assert len(daemon.log_text()) < 200000 and "Too many open files" not in daemon.log_text()
    finally:
        if daemon.process.poll() is None:
            daemon.kill()


def test_a_complaint_that_comes_without_end_is_told_once_a_second(make_daemon):
    """No descriptor is left to take a connection with, for as long as that lasts."""
    daemon = make_daemon()
    pid = daemon.process.pid
    assert daemon.curl("/healthz").status == 200
    before, limits = len(daemon.log_text()), resource.prlimit(pid, resource.RLIMIT_NOFILE)
    begin = time.monotonic()
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (8, limits[1]))
    with connect(daemon):
        wait_until(lambda: "more of these lines were left out" in daemon.log_text(), "the second line")
        took = time.monotonic() - begin
        assert daemon.log_text()[before:].count("\n") < 8 * (took + 1)  # a second: a line and its count, of few kinds
        resource.prlimit(pid, resource.RLIMIT_NOFILE, limits)
        assert daemon.curl("/healthz").status == 200
    assert daemon.stop() == 0


def test_too_few_descriptors_are_refused_at_the_start(tmp_path):
    done = subprocess.run(["prlimit", "--nofile=150:150", BUILD / "whittled", "--listen", "127.0.0.1:0", "--data",
                           tmp_path / "data"], capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 2
    assert "150 open files (RLIMIT_NOFILE) are too few" in done.stderr and "raise the limit to" in done.stderr


@pytest.mark.parametrize(("begun", "why"), [
    (b"GET / HTTP/1.1\r\nHos", "headers"),
    (b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n0", "slow"),
])
def test_those_who_send_next_to_nothing_make_room_for_others(make_daemon, begun, why):
    """From twenty addresses, whatever the patience with each alone is."""
    daemon = make_daemon("--max-connections", "40", "--upload-grace", "1h", "--header-timeout", "1h", "--idle-timeout", "1h")
    held = [socket.create_connection(("127.0.0.1", daemon.port), source_address=(f"127.0.0.{2 + i % 20}", 0))
            for i in range(40)]
    for connection in held:
        connection.sendall(begun)
    assert daemon.curl("/healthz").status == 200
    wait_until(lambda: cut_count(daemon, why) > 0, "room")
    for connection in held:
        connection.close()


def test_a_body_is_to_keep_its_rate(make_daemon):
    """Much at its beginning is no credit for later."""
    daemon = make_daemon("--min-upload-rate", "1K", "--upload-grace", "1s")
    with connect(daemon) as connection:
        connection.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000000\r\n\r\n" + 8 * SMALL * 100)
        assert is_cut(connection).startswith(b"HTTP/1.1 408 ")
    assert cut_count(daemon, "slow") == 1


def test_connections_of_one_address(make_daemon):
    daemon = make_daemon("--connections-per-address", "3")
    held = []
    for _ in range(3):
        held.append(connect(daemon))
        held[-1].sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert held[-1].recv(12) == b"HTTP/1.1 200"
    with connect(daemon) as connection:
        try:
            connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        except OSError:
            pass
        assert is_cut(connection) == b""
    with socket.create_connection(("127.0.0.1", daemon.port), source_address=("127.0.0.2", 0)) as other:
        other.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert other.recv(12) == b"HTTP/1.1 200"
    for connection in held:
        connection.close()


def cut_count(daemon, reason):
    text = daemon.curl("/metrics").body.decode()
    return int(re.search(rf'connections_cut_total{{reason="{reason}"}} (\d+)', text)[1])


def test_headers_that_take_too_long(make_daemon):
    daemon = make_daemon("--header-timeout", "300ms")
    with connect(daemon) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n")
        assert is_cut(connection) == b""
    assert cut_count(daemon, "headers") == 1


def test_a_connection_that_is_idle(make_daemon):
    daemon = make_daemon("--idle-timeout", "1s")
    with connect(daemon) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert is_cut(connection).startswith(b"HTTP/1.1 200")


def test_an_upload_that_trickles(make_daemon):
    daemon = make_daemon("--min-upload-rate", "1M", "--upload-grace", "100ms")
    with connect(daemon) as connection:
        connection.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n0 0 0\n")
        head, _, body = is_cut(connection).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 408 ") and b"\r\nConnection: close" in head
    assert json.loads(body)["type"] == "/problems/too-slow" and "1048576 bytes a second" in json.loads(body)["detail"]
    wait_until(lambda: not daemon.leftovers(), "the file's removal")
    assert cut_count(daemon, "slow") == 1


# ---------------------------------------------------------------------------------------------- time

def test_results_expire_and_say_so(make_daemon):
    daemon = make_daemon("--retention", "1s")
    job_id = daemon.submit(SMALL)
    wait_until(lambda: daemon.curl(f"/v1/jobs/{job_id}").status == 410, "the job's expiry")
    reply = daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply")
    assert (reply.status, reply.slug, reply.json["reason"]) == (410, "job-gone", "expired") and reply.json["at"]
    wait_until(lambda: daemon.kept("jobs") == [], "the removal of its files")
    assert daemon.kept("clouds") == []
    assert daemon.leftovers() == []


def test_a_link_lives_no_longer_than_allowed(make_daemon):
    daemon = make_daemon("--link-max", "10s")
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    path = f"/v1/jobs/{job_id}/outputs/cloud.ply/link"
    assert daemon.curl(path + "?seconds=10", "-X", "POST").status == 200
    assert daemon.curl(path + "?seconds=11", "-X", "POST").slug == "invalid-parameter"
    assert daemon.curl(path, "-X", "POST").status == 200


def test_a_long_poll_waits_no_longer_than_allowed(make_daemon, large):
    daemon = make_daemon("--wait-max", "10ms", "--workers", "1")
    running = daemon.submit(large)
    waiting = daemon.submit(large + b"0 0 0\n")
    etag = daemon.curl(f"/v1/jobs/{waiting}").headers["etag"]
    reply = daemon.curl(f"/v1/jobs/{waiting}", "-H", "Prefer: wait=50", "-H", f"If-None-Match: {etag}")
    assert reply.status == 304 and daemon.job(running)["status"] == "running"


# ---------------------------------------------------------------------------------------------- jobs at a time

def test_no_more_jobs_run_than_allowed_and_with_no_more_threads(make_daemon, tmp_path):
    go, patient = tmp_path / "go", tmp_path / "patient"
    patient.write_text(f'#!/bin/sh\necho "arguments: $@" >&2\nwhile [ ! -e {go} ]; do sleep 0.1; done\nexit 9\n')
    patient.chmod(0o755)
    daemon = make_daemon("--worker", patient, "--worker-sandbox=off", "--workers", "2", "--threads-per-job", "3")
    jobs = [daemon.submit(sphere(100 + i)) for i in range(5)]
    logs = [daemon.data / "jobs" / job / "log" for job in jobs]

    def begun():
        return [log for log in logs if log.exists() and "arguments:" in log.read_text()]
    wait_until(lambda: len(begun()) == 2, "two at work")
    assert sorted(daemon.job(job)["status"] for job in jobs) == ["accepted"] * 3 + ["running"] * 2
    assert all(" --threads 3 " in f"{log.read_text()} ".replace("\n", " ") for log in begun())
    go.touch()
    for job in jobs:
        daemon.ended(job)


# ---------------------------------------------------------------------------------------------- none is left out

REACHED_BY = {
    "connections_per_address": "test_connections_of_one_address", "header_timeout_ms": "test_headers_that_take_too_long",
    "idempotency_retention_ms": "test_keys_are_forgotten_after_their_time", "idle_timeout_ms": "test_a_connection_that_is_idle",
    "job_cpu_ms": "test_a_job_that_needs_too_much_processor_time", "job_wall_ms": "test_a_job_that_takes_too_long",
    "job_stall_ms": "test_a_process_that_stands_still_is_ended_and_its_job_tried_again",
    "job_file_bytes": "test_a_file_longer_than_a_job_may_write",
    "job_write_bytes": "test_a_job_may_write_so_much_in_all",
    "job_memory_bytes": "test_a_job_that_needs_too_much_memory",
    "link_max_ms": "test_a_link_lives_no_longer_than_allowed", "max_body_bytes": "test_too_large_without_a_length",
    "max_connections": "test_connections", "max_expansion": "test_a_small_body_that_becomes_a_large_one",
    "max_header_bytes": "test_headers_over_the_limit", "max_parameters": "test_parameters_over_the_limit",
    "max_points": "test_too_many_points", "max_queue": "test_a_full_queue", "max_uploads": "test_a_number_of_uploads",
    "min_free_bytes": "test_what_is_to_stay_free_stays_free_while_bodies_of_no_known_length_come",
    "min_upload_bytes_per_s": "test_an_upload_that_trickles", "upload_grace_ms": "test_an_upload_that_trickles",
    "principal_bytes": "test_resumable_uploads_count_with_what_they_will_have",
    "principal_uploads": "test_resumable_uploads_of_one_principal",
    "principal_jobs": "test_jobs_of_one_principal", "retention_ms": "test_results_expire_and_say_so",
    "sync_max_ms": "test_one_shot_that_takes_too_long_names_its_job",
    "threads_per_job": "test_no_more_jobs_run_than_allowed_and_with_no_more_threads",
    "total_memory_bytes": "test_jobs_that_do_not_fit_together_wait", "upload_expiry_ms": "test_expiration",
    "wait_max_ms": "test_a_long_poll_waits_no_longer_than_allowed",
    "workers": "test_no_more_jobs_run_than_allowed_and_with_no_more_threads"}


def test_each_limit_has_a_test_that_reaches_it(daemon):
    assert set(daemon.curl("/v1/info").json["limits"]) == set(REACHED_BY)
    tests = "".join(path.read_text() for path in pathlib.Path(__file__).parent.glob("test_*.py"))
    missing = [test for test in REACHED_BY.values() if f"\ndef {test}(" not in tests]
    assert missing == []
