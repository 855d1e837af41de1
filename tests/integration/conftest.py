# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts whittled for a test, on a free port and a data folder of its own, and talks to it with curl."""
import http.client
import json
import math
import os
import pathlib
import re
import signal
import subprocess
import time

import pytest

BUILD = pathlib.Path(os.environ.get("WHITTLE_BUILD", "build/release"))
SANITIZED = bool(re.search("asan|tsan", str(BUILD)))
PATIENCE_S = 600 if SANITIZED else 180  # how long a condition may take before the test gives up
# Sanitizers reserve address space that a limit would deny, and do what confinement forbids.
UNLIMITED = ("--job-memory", "1024T", "--worker-sandbox=off") if SANITIZED else ()


def wait_until(condition, what="the condition"):
    """Returns what condition() answers as soon as that is true."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        answer = condition()
        if answer:
            return answer
        time.sleep(0.01)
    raise AssertionError(f"{what} did not come in {PATIENCE_S} s")


def pytest_make_parametrize_id(val):
    """Bytes are named by their length: the content may differ between two processes that collect the same tests."""
    return f"{len(val)} bytes" if isinstance(val, bytes) else None


class Reply:
    """What curl -D gives: status, headers (lower-case names), body."""

    def __init__(self, status, headers, body):
        self.status, self.headers, self.body = status, headers, body

    @property
    def json(self):
        return json.loads(self.body)

    @property
    def slug(self):
        assert self.headers["content-type"] == "application/problem+json", self.headers
        document = self.json
        assert document["status"] == self.status
        assert document["title"] and document["detail"]
        return document["type"].removeprefix("/problems/")


class Daemon:
    """A whittled of this test's own."""

    def __init__(self, folder, *flags):
        self.folder, self.flags = folder, flags
        self.data = folder / "data"
        self.log = folder / "log"
        self.process = None
        self.curl_flags = ()
        self.prefix = ()  # a command that ends in exec of its arguments

    def start(self, *more):
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(
                [*self.prefix, BUILD / "whittled", "--listen", "127.0.0.1:0", "--data", self.data, *UNLIMITED, *self.flags, *more],
                stdout=subprocess.PIPE, stderr=log, text=True)
        line = self.process.stdout.readline()
        assert re.match("listening on https?://127.0.0.1:", line), (line, self.log_text()[-4000:])
        self.url = line.split()[-1]
        return self

    @property
    def port(self):
        return int(self.url.rsplit(":", 1)[1])

    def log_text(self):
        return self.log.read_text(errors="replace")

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(PATIENCE_S)

    def stop(self):
        """Drains; returns the exit status."""
        if self.process and self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(PATIENCE_S)
        return self.process.returncode if self.process else None

    def request(self, method, path, body=None, headers=None, connection=None):
        """(status, headers, body) without curl, for the many requests of a campaign; connection: one that is kept."""
        own = connection or http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            own.request(method, path, body=body, headers=headers or {})
            reply = own.getresponse()
            return reply.status, dict(reply.getheaders()), reply.read()
        finally:
            if not connection:
                own.close()

    def curl_command(self, path, *arguments):
        return ["curl", "-sS", "--max-time", str(PATIENCE_S), "-D", "-", *map(str, (*self.curl_flags, *arguments)),
                self.url + path]

    def curl(self, path, *arguments, data=None):
        done = subprocess.run(self.curl_command(path, *arguments), input=data, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr
        return parse_reply(done.stdout)

    def post(self, path, data, *arguments):
        return self.curl(path, "-X", "POST", "--data-binary", "@-", "-H", "Expect:", *arguments, data=data)

    def submit(self, data, query=""):
        reply = self.post(f"/v1/jobs{query}", data)
        assert reply.status == 201, reply.body
        return reply.json["id"]

    def job(self, job_id):
        return self.curl(f"/v1/jobs/{job_id}").json

    def wait_for(self, job_id, *states):
        def reached():
            job = self.job(job_id)
            return job if job["status"] in states else None
        return wait_until(reached, f"{' or '.join(states)} of {job_id}: {self.job(job_id)}")

    def ended(self, job_id):
        return self.wait_for(job_id, "successful", "failed", "dismissed")

    def worker_pid(self, job_id):
        """The process that runs the job, once it is one."""
        def started():
            return re.findall(rf"job={job_id} accepted -> running attempt=\d+ pid=(\d+)", self.log_text())
        return int(wait_until(started, "the worker's start")[-1])

    def check(self):
        """Runs `whittled check` on the folder, which nothing may serve; returns exit status and lines."""
        done = subprocess.run([BUILD / "whittled", "check", "--data", self.data], capture_output=True, text=True,
                              check=False)
        return done.returncode, (done.stdout + done.stderr).splitlines()

    def leftovers(self):
        return sorted(p.name for p in (self.data / "tmp").iterdir())


def parse_reply(output):
    """The last of the header blocks, and the body."""
    while True:
        head, _, rest = output.partition(b"\r\n\r\n")
        lines = head.decode("latin-1").split("\r\n")
        status = int(lines[0].split()[1])
        if status != 100:
            break
        output = rest
    headers = {}
    for line in lines[1:]:
        name, _, value = line.partition(":")
        headers[name.lower()] = value.strip()
    return Reply(status, headers, rest)


def process_lives(pid):
    """Whether the process exists and is no zombie."""
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def sphere(count, place=0):
    """Points spread evenly over a unit sphere about (place, 0, 0), as XYZ text."""
    turn = math.pi * (3 - math.sqrt(5))
    lines = []
    for i in range(count):
        z = 1 - (2 * i + 1) / count
        r = math.sqrt(1 - z * z)
        lines.append(f"{r * math.cos(turn * i) + place:.6f} {r * math.sin(turn * i):.6f} {z:.6f}\n")
    return "".join(lines).encode()


SMALL = sphere(300)


@pytest.fixture(name="large", scope="session")
def make_large():
    """A cloud that takes seconds."""
    return sphere(400000)


@pytest.fixture(name="make_daemon")
def make_make_daemon(tmp_path):
    """make_daemon(*flags) starts one; all are ended with the test."""
    daemons = []

    def make(*flags):
        folder = tmp_path / f"daemon{len(daemons)}"
        folder.mkdir()
        daemons.append(Daemon(folder, *flags))
        return daemons[-1].start()

    yield make
    for daemon in daemons:
        if daemon.process and daemon.process.poll() is None:
            daemon.kill()
        print(daemon.log_text()[-20000:])


@pytest.fixture(name="daemon")
def make_one_daemon(make_daemon):
    return make_daemon()
