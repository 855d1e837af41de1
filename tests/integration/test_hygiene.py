# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests that two readers could understand in two ways are refused, and what follows them is never a request."""
import http.client
import json
import re
import shutil
import socket
import subprocess

import pytest

from conftest import SMALL, Daemon, wait_until

SMUGGLED = b"GET /v1/info HTTP/1.1\r\nHost: smuggled\r\nX-Request-Id: smuggled\r\n\r\n"


@pytest.fixture(name="daemon", scope="module")
def make_shared_daemon(tmp_path_factory):
    with Daemon(tmp_path_factory.mktemp("daemon")) as daemon:
        yield daemon
        wait_until(lambda: daemon.leftovers() == [], "the end of all bodies")  # of connections just closed, too
        assert daemon.curl("/v1/jobs").json["jobs"] == []
        assert daemon.stop() == 0
        assert "id=smuggled" not in daemon.log_text()


def raw(daemon, data):
    """Sends bytes, returns all that comes back until the other side closes."""
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=60) as connection:
        answer = b""
        try:
            connection.sendall(data)
            while True:
                part = connection.recv(65536)
                if not part:
                    return answer
                answer += part
        except ConnectionResetError:
            return answer


def statuses(answer):
    return re.findall(rb"HTTP/1\.[01] (\d{3}) ", answer)


def only_problem(answer):
    """The one answer that came: a problem document, after which the connection is closed."""
    head, _, body = answer.partition(b"\r\n\r\n")
    assert len(statuses(answer)) == 1 and answer.startswith(b"HTTP/1.1 "), answer
    assert b"application/problem+json" in head and b"onnection: close" in head, answer
    assert int(re.search(rb"Content-Length: (\d+)", head)[1]) == len(body)
    problem = json.loads(body)
    assert problem["status"] == int(statuses(answer)[0])
    return problem


HEAD = b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\n"
TWICE = {  # what libmicrohttpd refuses by itself, and would twice
    b"Content-Length: 5, 5\r\n": 400, b"Content-Length: -1\r\n": 400, b"Content-Length: +5\r\n": 400,
    b"Content-Length: 0x5\r\n": 400, b"Content-Length: 5 5\r\n": 400, b"Content-Length:\r\n": 400,
    b"Content-Length: five\r\n": 400, b"Content-Length: 99999999999999999999\r\n": 413,
    b"Cookie: " + b"a=b;" * 15000 + b"\r\n": 431}


@pytest.mark.parametrize("head, status", [(head, 400) for head in (
    b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n", b"Transfer-Encoding: chunked\r\nContent-Length: 5\r\n",
    b"Content-Length: 5\r\nContent-Length: 5\r\n", b"Content-Length: 5\r\nContent-Length: 50\r\n",
    b"Transfer-Encoding: gzip, chunked\r\n", b"Transfer-Encoding: chunked, identity\r\n",
    b"Transfer-Encoding: identity\r\n", b"Transfer-Encoding: xchunked\r\n",
    b"Transfer-Encoding: chunked\r\nTransfer-Encoding: identity\r\n", b"Transfer-Encoding : chunked\r\n",
    b"Content-Length : 5\r\n", b"Content Length: 5\r\n", b"Host: b\r\n",
    b"Content-Type: text/plain\r\nContent-Type: image/png\r\n")] + list(TWICE.items()),
    ids=lambda value: value[:60].decode("latin-1").strip().replace("\r\n", " | ") if isinstance(value, bytes) else "")
def test_ambiguous_heads(daemon, head, status):
    answer = raw(daemon, HEAD + head + b"\r\n0\r\n\r\n" + SMUGGLED)
    assert only_problem(answer)["status"] == status and b"smuggled" not in answer
    if status == 400:
        assert b"/problems/malformed-request" in answer


@pytest.mark.parametrize("head", TWICE, ids=range(len(TWICE)))
def test_a_head_that_comes_in_pieces_is_refused_once(daemon, head):
    """And nothing else that is on its way is taken for it."""
    others = [socket.create_connection(("127.0.0.1", daemon.port), timeout=60) for _ in range(8)]
    for other, start in zip(others, [HEAD, HEAD + b"Content-Length: x\r\n", b"G", b"GET /healthz HTTP/1.1\r\n"] * 2):
        other.sendall(start)
    ends = {other: rest for other, rest in zip(others, [b"\r\n", b"\r\n", b"", b"Host: localhost\r\n\r\n"] * 2)}
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=60) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert connection.recv(65536).startswith(b"HTTP/1.1 200")  # the connection is kept
        for i in range(0, len(HEAD + head), 1 + len(head) // 20):
            connection.sendall((HEAD + head)[i:i + 1 + len(head) // 20])
        connection.sendall(b"X-Request-Id: mine\r\n\r\n")
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    assert only_problem(answer)["status"] == TWICE[head] and b"X-Request-Id: mine\r\n" in answer
    for other, rest in ends.items():
        other.sendall(rest)
        if b"healthz" in rest or rest.startswith(b"Host"):
            assert other.recv(65536).startswith(b"HTTP/1.1 200")
        other.close()
    assert re.search(f"http id=mine peer=127.0.0.1 .*status={TWICE[head]} ", daemon.log_text())


@pytest.mark.parametrize("head", [
    b"POST /v1/jobs HTTP/1.1\r\nContent-Length: 100\r\n", b"GET /v1/jobs HTTP/1.1\r\n",
    b"GET /v1/ jobs HTTP/1.1\r\nHost: localhost\r\n", b"GET /v1/jobs?label=a b HTTP/1.1\r\nHost: localhost\r\n",
    b"GET /v1/jobs\t HTTP/1.1\r\nHost: localhost\r\n", b"GET /v1/jobs HTTP/1.1\r\n Host: localhost\r\n"], ids=range(6))
def test_heads_against_the_grammar(daemon, head):
    answer = raw(daemon, head + b"\r\n" + SMUGGLED)
    assert statuses(answer) == [b"400"] and b"smuggled" not in answer, answer
    assert b"application/problem+json" in answer and b"malformed-request" in answer, answer


def test_http_1_0_needs_no_host(daemon):
    assert statuses(raw(daemon, b"GET /v1/info HTTP/1.0\r\n\r\n")) == [b"200"]


POST = b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\n"


@pytest.mark.parametrize("request_head", [
    POST + b"Content-Length: 5\r\n 0\r\n", POST + b"Content-Length:\r\n 5\r\n", POST + b"X: y\r\n Content-Length: 5\r\n",
    POST + b"Transfer-Encoding:\r\n chunked\r\n", POST + b"Transfer-Encoding: chunked\r\n\tx\r\n",
    POST + b"Transfer-Encoding : chunked\r\nContent-Length: 5\r\n", POST + b"Content-Length : 5\r\n",
    POST + b"Transfer-Encoding\t: chunked\r\n", POST + b": 5\r\n", POST + b"a b: 5\r\n",
    POST + b"X: b\rTransfer-Encoding: chunked\r\n", POST + b"Transfer-Encoding: \x0bchunked\r\n",
    POST + b"Transfer-Encoding: \"chunked\"\r\nContent-Length: 5\r\n",
    b"POST /v1/jobs HTTP/1.0\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n",
    b"GET /v1/jobs HTTP/1.1\r\n", b"GET /v1/jobs HTTP/1.1\r\nHost: a b\r\n", b"GET /v1/jobs HTTP/1.1\r\nHost: a/b\r\n",
    b"GET /v1/jobs HTTP/1.1\r\nHost: u@a\r\n", b"GET /v1/jobs HTTP/1.1\r\nHost:\r\n a\r\n",
], ids=lambda head: head.decode("latin-1").partition("1.1\r\n")[2].strip().encode("unicode_escape").decode())
def test_heads_that_others_could_read_otherwise(daemon, request_head):
    answer = raw(daemon, request_head + b"\r\n0\r\n\r\n" + SMUGGLED)
    assert {status[:1] for status in statuses(answer)} == {b"4"} and b"smuggled" not in answer, answer


PICTURE = b"\x89PNG\r\n"  # is read, and refused for what it is


@pytest.mark.parametrize("body, status", [
    (b"6;name=value\r\n" + PICTURE + b"\r\n0;last\r\n\r\n", b"415"),
    (b"6\r\n" + PICTURE + b"\r\n0\r\nHost: evil\r\nContent-Length: 4\r\n\r\n", b"415"),
    (b"5\r\n" + PICTURE + b"\r\n0\r\n\r\n", b"400"), (b"6 \r\n" + PICTURE + b"\r\n0\r\n\r\n", b"400"),
    (b"fffffffffffffffff\r\n" + PICTURE, b"413")], ids=["extension", "trailer", "longer", "blank", "huge"])
def test_chunks_with_more_than_their_size(daemon, body, status):
    answer = raw(daemon, POST + b"Transfer-Encoding: chunked\r\nConnection: close\r\n\r\n" + body)
    assert statuses(answer) == [status], answer


def test_a_chunk_that_never_ends_is_limited_by_the_body(make_daemon):
    small = make_daemon("--max-body-bytes", "100K", "--refuse-drain-bytes", "100K")
    answer = raw(small, POST + b"Transfer-Encoding: chunked\r\n\r\n7fffffffffffffff\r\n" + b"0 0 0\n" * 60000)
    assert statuses(answer) in ([], [b"413"])  # nothing: it was cut off while it still sent
    wait_until(lambda: small.leftovers() == [], "the upload's end")


def half_closed(daemon, data):
    """Sends bytes and that there are no more, returns all that comes back."""
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=60) as connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        while part := connection.recv(65536):
            answer += part
        return answer


@pytest.mark.parametrize("body, answers", [
    (b"zz\r\n", [b"400"]), (b"5\r\nabc", []), (b"-1\r\n\r\n", [b"400"]), (b"ffffffffffffffffff\r\n", [b"413"]),
    (b"0x5\r\nabcde\r\n0\r\n\r\n", [b"400"])], ids=["letters", "cut off", "negative", "huge", "hexadecimal"])
def test_malformed_chunks(daemon, body, answers):
    assert statuses(half_closed(daemon, POST + b"Transfer-Encoding: chunked\r\n\r\n" + body)) == answers
    wait_until(lambda: daemon.leftovers() == [], "the upload's end")
    assert daemon.curl("/v1/jobs").json["jobs"] == []


@pytest.mark.parametrize("request_line, answers", [
    (b"GET /v1/info HTTP/1.1\r\n Host: folded\r\n", [b"400"]), (b"GET  /v1/info HTTP/1.1\r\n", [b"400"]),
    (b"GET /v1/info\r\n", [b"400"]), (b"GET\r\n", []),  # no request yet
    (b"get /v1/info HTTP/1.1\r\n", [b"400"]), (b"GET /v1/info HTTP/1.1\r\nHost a\r\n", [b"400"]),
    (b"GET /v1/info HTTP/1.1\r\nHost : a\r\n", [b"400"]), (b"GET /v1/info HTTP/2.0\r\n", [b"505"]),
    (b"PRI * HTTP/2.0\r\n\r\nSM\r\n", [b"505"]), (b"CONNECT a:80 HTTP/1.1\r\n", [b"400"]),
    (b"OPTIONS * HTTP/1.1\r\n", [b"400"]), (b"GET http://other/v1/jobs/x HTTP/1.1\r\n", [b"400"])], ids=range(12))
def test_odd_first_lines_are_refused_and_do_no_harm(daemon, request_line, answers):
    assert statuses(half_closed(daemon, request_line + b"\r\n\r\n")) == answers
    assert daemon.curl("/healthz").status == 200


@pytest.mark.parametrize("path", ["/v1/%2e%2e/v1/info", "/v1/../v1/info", "//v1/info", "/v1//info", "/v1/info/",
                                  "/v1%2finfo%2f", "/.%2e/etc/passwd", "/v1/info%0d%0aX:%20y", "/%", "/%zz", "/v1/info%20",
                                  "/" + "a/" * 2000, "/\\..\\", "/v1/%c0%ae%c0%ae/v1/info", "/v1%c0%afinfo", "/v1/\udcff",
                                  "/v1/jobs/..%2f..%2fwhittled.db"])
def test_paths_are_matched_and_nothing_else(daemon, path):
    reply = daemon.curl(path, "--path-as-is", "--globoff")
    assert (reply.status, reply.slug) == (404, "no-such-resource")
    assert "x" not in reply.headers


@pytest.mark.parametrize("path", ["/v1/info%00", "/v1/jobs%00/x", "/%00", "/v1/info%00?x=1"])
def test_nul_in_paths(daemon, path):
    assert daemon.curl(path).slug == "malformed-request"


@pytest.mark.parametrize("query", ["label=a%00b", "%00=1", "label=%00"])
def test_nul_in_arguments(daemon, query):
    assert daemon.post(f"/v1/jobs?{query}", SMALL).slug == "malformed-request"


def test_an_argument_longer_than_the_head_may_be(daemon):
    reply = daemon.curl("/v1/jobs?label=" + "x" * 40000)
    assert (reply.status, reply.slug) == (431, "headers-too-large")


def test_what_follows_a_refused_request_is_not_answered(daemon):
    answer = raw(daemon, b"POST /v1/jobs?ratio=9 HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000000\r\n\r\n" + SMUGGLED)
    assert statuses(answer) == [b"400"]


def test_pipelined_requests_are_each_answered(daemon):
    answer = raw(daemon, b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n" * 2 +
                 b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    assert statuses(answer) == [b"200"] * 3


def test_a_body_where_none_is_taken_is_read_away(daemon):
    answer = raw(daemon, b"GET /v1/info HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nabcde"
                 b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    assert statuses(answer) == [b"200", b"200"] and b"alive" in answer


# ---------------------------------------------------------------------------------------------- early refusals

def test_who_waits_for_100_is_refused_instead(daemon):
    head = b"POST /v1/jobs?ratio=9 HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\nExpect: 100-continue\r\n\r\n"
    answer = raw(daemon, head)
    assert statuses(answer) == [b"400"] and b"onnection: close" in answer
    assert statuses(raw(daemon, head + SMUGGLED)) == [b"400"]  # who doesn't wait isn't heard either


CASES = [("/v1/jobs?ratio=9", "text/plain", 400), ("/v1/jobs", "image/png", 415), ("/nowhere", "text/plain", 404)]


@pytest.mark.parametrize("path, media, status", CASES)
def test_python_gets_the_answer_to_a_body_that_it_sent_in_vain(daemon, path, media, status):
    connection = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=60)
    connection.request("POST", path, body=b"0 0 0\n" * (4 << 20), headers={"Content-Type": media})
    assert connection.getresponse().status == status
    connection.close()


@pytest.mark.parametrize("path, media, status", CASES)
def test_curl_too_with_and_without_expect(daemon, path, media, status, tmp_path):
    body = tmp_path / "body"
    body.write_bytes(b"0 0 0\n" * (4 << 20))
    for expect in ("Expect: 100-continue", "Expect:"):
        reply = daemon.curl(path, "-X", "POST", "-T", body, "-H", expect, "-H", f"Content-Type: {media}")
        assert reply.status == status


NODE = """
const http = require('http');
const request = http.request({host: '127.0.0.1', port: process.argv[1], path: process.argv[2], method: 'POST',
    headers: {'Content-Type': process.argv[3]}},
    (reply) => { console.log(reply.statusCode); reply.resume(); reply.on('end', () => process.exit(0)); });
request.on('error', (error) => { console.log(error.code); process.exit(1); });
request.end(Buffer.alloc(24 << 20, '0 0 0\\n'));
"""


@pytest.mark.skipif(not shutil.which("node"), reason="node is not installed")
@pytest.mark.parametrize("path, media, status", CASES)
def test_node_too(daemon, path, media, status):
    done = subprocess.run(["node", "-e", NODE, str(daemon.port), path, media], capture_output=True, text=True, check=False,
                          timeout=60)
    assert done.stdout.strip() == str(status), done
