# SPDX-License-Identifier: GPL-3.0-or-later
"""Webhooks: signed, sent until they are taken, never to where they shouldn't go."""
import base64
import hashlib
import hmac
import http.server
import json
import subprocess
import threading

import pytest

from conftest import BUILD, SMALL, sphere, wait_until

KEY = bytes(range(32))
SECRET = "whsec_" + base64.b64encode(KEY).decode()


class Receiver:
    """Takes POSTs on a free loopback port; answers with the statuses given, the last one again and again."""

    def __init__(self, *statuses, host="127.0.0.1"):
        self.statuses, self.taken = list(statuses), []
        receiver = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
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
