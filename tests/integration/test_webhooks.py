# SPDX-License-Identifier: GPL-3.0-or-later
"""Webhooks: signed, sent until they are taken, never to where they shouldn't go."""
import base64
import hashlib
import hmac
import http.server
import json
import socket
import subprocess
import threading
import time

import pytest

from conftest import BUILD, SMALL, sphere, wait_until

KEY = bytes(range(32))
SECRET = "whsec_" + base64.b64encode(KEY).decode()


class Receiver:
    """Takes POSTs on a free loopback port; answers with the statuses given, the last one again and again."""

    def __init__(self, *statuses, host="127.0.0.1"):
        self.statuses, self.taken, self.times = list(statuses), [], []
        receiver = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
                receiver.times.append(time.monotonic())
                body = self.rfile.read(int(self.headers["content-length"]))
                receiver.taken.append((dict(self.headers.items()), body, self.path))
                status = receiver.statuses[0] if len(receiver.statuses) == 1 else receiver.statuses.pop(0)
                self.send_response(status)
                if status == 302:
                    self.send_header("Location", receiver.url + "/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            do_GET = do_POST

            def log_message(self, format, *args):  # pylint: disable=redefined-builtin
                pass

        self.server = http.server.ThreadingHTTPServer((host, 0), Handler)
        self.url = f"http://{host}:{self.server.server_address[1]}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def close(self):
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture(name="receive")
def make_receive():
    made = []

    def receive(*statuses):
        made.append(Receiver(*statuses))
        return made[-1]
    yield receive
    for receiver in made:
        receiver.close()


@pytest.fixture(name="hooked")
def make_hooked(make_daemon, tmp_path):
    def hooked(*flags, allow="127.0.0.1"):
        secret = tmp_path / "secret"
        secret.write_text(SECRET + "\n")
        return make_daemon("--webhooks", "--webhook-secret-file", secret, "--webhook-retry", "10ms", "--webhook-allow",
                           allow, *flags)
    return hooked


def log_of(daemon, job_id, text):
    def told():
        log = daemon.curl(f"/v1/jobs/{job_id}/log").body
        return log if text in log else None
    return wait_until(told, text.decode())


def test_the_end_of_a_job_is_told_and_signed(hooked, receive):
    receiver = receive(200)
    daemon = hooked()
    job_id = daemon.submit(SMALL, f"?webhook={receiver.url}/hook%3Fx%3D1&label=told")
    wait_until(lambda: receiver.taken, "the webhook")
    headers, body, path = receiver.taken[0]
    headers = {name.lower(): value for name, value in headers.items()}
    assert path == "/hook?x=1" and headers["content-type"] == "application/json"
    payload = json.loads(body)
    assert payload["type"] == "job.ended" and payload["data"] == daemon.job(job_id)
    assert payload["data"]["status"] == "successful" and payload["timestamp"] == payload["data"]["finished"]
    assert headers["webhook-id"] == job_id
    signed = f"{job_id}.{headers['webhook-timestamp']}.".encode() + body
    expected = base64.b64encode(hmac.new(KEY, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{expected}"
    log_of(daemon, job_id, b"webhook delivered: answered 200")
    assert len(receiver.taken) == 1


def test_failed_dismissed_and_reused_jobs_are_told_too(hooked, receive):
    receiver = receive(204)
    daemon = hooked("--workers", "1")
    first = daemon.submit(SMALL, f"?webhook={receiver.url}")
    daemon.ended(first)
    again = daemon.submit(SMALL, f"?webhook={receiver.url}")
    bad = daemon.submit(b"1 2 3\nx\n" + SMALL, f"?webhook={receiver.url}")
    daemon.ended(bad)
    blocker = daemon.submit(sphere(400000))
    waiting = daemon.submit(sphere(50), f"?webhook={receiver.url}")
    daemon.curl(f"/v1/jobs/{waiting}", "-X", "DELETE")

    def told():
        jobs = [json.loads(body)["data"] for _, body, _ in receiver.taken]
        return {job["id"]: job["status"] for job in jobs}
    wait_until(lambda: len(told()) == 4, "four webhooks")
    assert told() == {first: "successful", again: "successful", bad: "failed", waiting: "dismissed"}
    daemon.curl(f"/v1/jobs/{blocker}", "-X", "DELETE")


def test_it_is_sent_again_until_it_is_taken_with_the_same_id(hooked, receive):
    receiver = receive(500, 302, 429, 200)
    daemon = hooked()
    job_id = daemon.submit(SMALL, f"?webhook={receiver.url}")
    log = log_of(daemon, job_id, b"webhook delivered")
    assert [line for line in log.splitlines() if b"webhook" in line] == [
        b"webhook failed: answered 500", b"webhook failed: answered 302", b"webhook failed: answered 429",
        b"webhook delivered: answered 200"]
    assert {headers["webhook-id"] for headers, _, _ in receiver.taken} == {job_id}
    assert all(path == "/" for _, _, path in receiver.taken)  # no redirect was followed


def test_it_is_given_up_after_some_attempts_or_when_told_to(hooked, receive):
    daemon = hooked("--webhook-retry", "1ms")
    gone, broken = receive(410), receive(503)
    log_of(daemon, daemon.submit(SMALL, f"?webhook={gone.url}"), b"webhook given up: answered 410")
    log_of(daemon, daemon.submit(SMALL, f"?webhook={broken.url}"), b"webhook given up: answered 503")
    assert len(gone.taken) == 1 and len(broken.taken) == 10


def test_it_outlives_the_service(hooked, receive):
    receiver = receive(200)
    daemon = hooked("--workers", "1")
    job_id = daemon.submit(sphere(400000), f"?webhook={receiver.url}")
    daemon.wait_for(job_id, "running")
    daemon.kill()
    daemon.start()
    wait_until(lambda: receiver.taken, "the webhook")
    assert json.loads(receiver.taken[0][1])["data"]["id"] == job_id


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]", "0.0.0.0", "127.1", "2130706433", "169.254.169.254"])
def test_nothing_goes_to_inside_addresses(hooked, receive, host):
    receiver = receive(200)
    daemon = hooked(allow="")
    port = receiver.url.rsplit(":", 1)[1]
    job_id = daemon.submit(SMALL, f"?webhook=http://{host}:{port}/".replace("[", "%5B").replace("]", "%5D"))
    log_of(daemon, job_id, b"webhook failed: its address is not on the public internet")
    assert not receiver.taken


@pytest.mark.parametrize("url", ["ftp://example.org/", "file:///etc/passwd", "http://", "x", "", "http://a:b@example.org/",
                                 "http://example.org/" + "x" * 2048])
def test_a_wrong_url_is_refused(hooked, url):
    reply = hooked().post(f"/v1/jobs?webhook={url}", SMALL)
    assert (reply.status, reply.slug) == (400, "invalid-parameter")
    assert reply.json["errors"][0]["parameter"] == "webhook"


def test_without_the_setting_there_are_none(daemon):
    reply = daemon.post("/v1/jobs?webhook=https://example.org/", SMALL)
    assert reply.slug == "invalid-parameter" and "off" in reply.json["detail"]


@pytest.mark.parametrize("content", [None, "", "whsec_", "whsec_c2hvcnQ=", "secret", "whsec_???"])
def test_without_a_secret_the_service_does_not_start(tmp_path, content):
    secret = tmp_path / "secret"
    if content is not None:
        secret.write_text(content)
    done = subprocess.run([BUILD / "whittled", "--listen", "127.0.0.1:0", "--data", tmp_path / "data", "--webhooks",
                           "--webhook-secret-file", secret], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2 and "webhook-secret-file" in done.stderr


# ---------------------------------------------------------------------------------------------- attempts

def test_pauses_between_attempts_double(hooked, receive):
    """Each is half to one and a half of the one that it stands for, and no attempt comes before its time."""
    receiver = receive(500)
    daemon = hooked("--webhook-retry", "200ms")
    daemon.submit(SMALL, f"?webhook={receiver.url}")
    wait_until(lambda: len(receiver.times) >= 6, "six attempts")
    pauses = [after - before for before, after in zip(receiver.times, receiver.times[1:6])]
    assert all(pause >= 0.1 * 2**i for i, pause in enumerate(pauses)), pauses


def due(daemon):
    """When the only row of the outbox is due, in ms from now; None while it was not yet tried."""
    (attempts, at), = daemon.ask("SELECT attempts, due FROM outbox")
    return at - time.time() * 1000 if attempts else None


def test_no_pause_is_longer_than_an_hour_and_a_half(hooked, receive):
    receiver = receive(500)
    daemon = hooked("--webhook-retry", "1d")
    daemon.submit(SMALL, f"?webhook={receiver.url}")
    left = wait_until(lambda: due(daemon), "the first attempt's failure")
    assert 0.4 * 3600e3 < left <= 1.5 * 3600e3


# ---------------------------------------------------------------------------------------------- odd receivers

class Raw:
    """Takes connections on a loopback port, and does with each what it is told: talk(connection), in a thread."""

    def __init__(self, talk):
        self.open, self.most, self.all, self.lock, self.over = 0, 0, 0, threading.Lock(), threading.Event()
        self.sent = 0  # by send
        self.talk, self.listener = talk, socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}"
        threading.Thread(target=self.take, daemon=True).start()

    def take(self):
        while True:
            try:
                connection = self.listener.accept()[0]
            except OSError:
                return
            threading.Thread(target=self.serve, args=[connection], daemon=True).start()

    def serve(self, connection):
        with self.lock:
            self.open, self.all = self.open + 1, self.all + 1
            self.most = max(self.most, self.open)
        with connection:
            try:
                self.talk(self, connection)
            except OSError:
                pass
        with self.lock:
            self.open -= 1

    def send(self, connection, data):
        connection.sendall(data)
        self.sent += len(data)

    def close(self):
        self.over.set()
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()


def tarpit(_, connection):
    """Reads for as long as anything comes, and never answers."""
    while connection.recv(65536):
        pass


@pytest.fixture(name="raw")
def make_raw():
    made = []

    def raw(talk):
        made.append(Raw(talk))
        return made[-1]
    yield raw
    for receiver in made:
        receiver.close()


@pytest.fixture(name="tenants")
def make_tenants(hooked, tmp_path):
    """A daemon with the tokens a and b; submit(who, webhook) returns the id of a job that has ended."""
    tokens = tmp_path / "tokens"
    tokens.write_text("".join(f"{who}:submit,read:{hashlib.sha256(who.encode()).hexdigest()}\n" for who in "ab"))
    daemon = hooked("--tokens-file", tokens, "--webhook-retry", "1ms")

    def submit(who, url):
        own = ("-H", f"Authorization: Bearer {who}")
        reply = daemon.post(f"/v1/jobs?webhook={url}", SMALL, *own)
        assert reply.status == 201, reply.body
        wait_until(lambda: daemon.curl(reply.headers["location"], *own).json["finished"], "the job's end")
        return reply.json["id"]
    return daemon, submit


def test_a_receiver_that_never_answers_holds_up_no_other_host(tenants, raw, receive):
    """Not even its own tenant's."""
    _, submit = tenants
    slow, good = raw(tarpit), receive(200)
    for _ in range(12):
        submit("a", slow.url)
    wait_until(lambda: slow.open == 2, "its share")
    for who in "ab":
        taken = len(good.taken)
        submit(who, good.url)
        wait_until(lambda before=taken: len(good.taken) > before, "the webhook")
    assert slow.most == 2 and slow.all < 12


def test_a_tenant_with_many_such_receivers_holds_up_no_other_tenant(tenants, raw, receive):
    _, submit = tenants
    slow, good = [raw(tarpit) for _ in range(24)], receive(200)
    for receiver in slow:
        submit("a", receiver.url)
    wait_until(lambda: sum(receiver.open for receiver in slow) == 4, "its share")
    submit("b", good.url)
    wait_until(lambda: good.taken, "the webhook")
    assert sum(receiver.all for receiver in slow) < 24


def answer_for_ever(receiver, connection):
    connection.recv(65536)
    connection.sendall(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
    while not receiver.over.is_set():
        receiver.send(connection, b"10000\r\n" + bytes(65536) + b"\r\n")


def answer_without_an_end(receiver, connection):
    """Of a length that is told, a byte and no more."""
    connection.recv(65536)
    connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 9999999999\r\n\r\nx")
    tarpit(receiver, connection)


def answer_by_and_by(receiver, connection):
    connection.recv(65536)
    connection.sendall(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n")
    while not receiver.over.wait(0.05):
        receiver.send(connection, b"x")


SOCKETS_BYTES = 32 << 20  # what the two sockets' buffers may hold, and more: whoever reads for seconds takes hundreds of MB


@pytest.mark.parametrize("talk, most", [(answer_for_ever, SOCKETS_BYTES), (answer_without_an_end, 0),
                                        (answer_by_and_by, 120)])  # of 200 in the ten seconds of an attempt
def test_an_answer_counts_by_its_status_however_long_it_is(hooked, raw, talk, most):
    receiver = raw(talk)
    daemon = hooked()
    log = log_of(daemon, daemon.submit(SMALL, f"?webhook={receiver.url}"), b"webhook delivered: answered 200")
    assert log.count(b"webhook") == 1
    wait_until(lambda: receiver.open == 0, "the connection's end")
    assert receiver.all == 1 and receiver.sent <= most


def headers_for_ever(receiver, connection):
    connection.recv(65536)
    connection.sendall(b"HTTP/1.1 200 OK\r\n")
    while not receiver.over.is_set():
        receiver.send(connection, b"X: y\r\n" * 10000)


def interim_answers_for_ever(receiver, connection):
    connection.recv(65536)
    while not receiver.over.is_set():
        receiver.send(connection, b"HTTP/1.1 103 Early Hints\r\n\r\n" * 2000)


@pytest.mark.parametrize("talk", [headers_for_ever, interim_answers_for_ever])
def test_headers_without_an_end_are_no_answer(hooked, raw, talk):
    receiver, daemon = raw(talk), hooked("--webhook-retry", "1d")
    log_of(daemon, daemon.submit(SMALL, f"?webhook={receiver.url}"),
           b"webhook failed: the answer's headers are longer than 64 KiB")
    assert receiver.all == 1 and receiver.sent <= SOCKETS_BYTES


def test_the_service_ends_its_deliveries_before_it_ends(hooked, raw):
    daemon = hooked()
    slow = [raw(tarpit) for _ in range(3)]
    ids = [daemon.submit(SMALL, f"?webhook={receiver.url}") for receiver in slow]
    wait_until(lambda: all(receiver.open for receiver in slow), "three deliveries")
    assert daemon.stop() == 0
    log = daemon.log_text()
    for job_id in ids:
        assert log.index(f"job={job_id} webhook interrupted: the service stops") < log.index(" info  ended")
    assert daemon.ask("SELECT attempts FROM outbox") == [(0,)] * 3
