# SPDX-License-Identifier: GPL-3.0-or-later
"""A whittled of one's own, under load: starting it, talking to it over sockets and http.client, and its figures."""
import hashlib
import http.client
import json
import os
import pathlib
import re
import signal
import socket
import struct
import subprocess
import time

PATIENCE_S = 600
VERTEX = struct.Struct("<fff")


class Service:
    """Limits are set out of the way: it is the load that is looked at."""

    def __init__(self, build, folder, *flags):
        self.data = pathlib.Path(folder) / "data"
        self.log = pathlib.Path(folder) / "log"
        sanitized = re.search("asan|tsan", str(build))
        unlimited = ("--job-memory", "1024T", "--worker-sandbox=off") if sanitized else ()
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(
                [pathlib.Path(build) / "whittled", "--listen", "127.0.0.1:0", "--data", self.data, "--max-queue", "100000",
                 "--max-connections", "4000", "--connections-per-address", "4000", "--header-timeout", "1h",
                 "--idle-timeout", "1h", "--min-upload-rate", "0", "--min-free", "0", *unlimited, *flags],
                stdout=subprocess.PIPE, stderr=log, text=True)
        self.port = self.read_port("listening on http://")
        self.admin_port = self.read_port("health and metrics on http://")

    def read_port(self, words):
        line = self.process.stdout.readline()
        if not line.startswith(words):
            raise RuntimeError(f"{line!r}: {self.log.read_text()[-2000:]}")
        return int(line.rsplit(":", 1)[1])

    def stop(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE_S)

    def connect(self):
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S)

    def client(self):
        return http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)

    def ask(self, method, path, body=None, client=None, headers=None):
        """(status, headers, body) of one request."""
        own = client or self.client()
        own.request(method, path, body=body, headers=headers or {})
        reply = own.getresponse()
        answer = reply.status, dict(reply.getheaders()), reply.read()
        if not client:
            own.close()
        return answer

    def document(self, path, method="GET"):
        return json.loads(self.ask(method, path)[2])

    def metrics(self):
        text = self.ask("GET", "/metrics")[2].decode()
        return {m[1]: float(m[2]) for m in re.finditer(r"^(whittled_\S+(?:\{.*\})?) (\S+)$", text, re.M)}

    def wait_for(self, condition, what):
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            answer = condition()
            if answer:
                return answer
            time.sleep(0.02)
        raise RuntimeError(f"{what} did not come")

    # ------------------------------------------------------------------------------------------ figures

    def resident(self, peak=False):
        """Bytes of memory, now or at most."""
        text = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(rf"^Vm{'HWM' if peak else 'RSS'}:\s+(\d+) kB", text, re.M)[1]) * 1024

    def descriptors(self):
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    def children(self):
        """Processes that run jobs."""
        pids = []
        for task in pathlib.Path(f"/proc/{self.process.pid}/task").iterdir():
            try:
                pids += (task / "children").read_text().split()
            except OSError:
                pass
        return [int(pid) for pid in pids]

    def disk(self):
        """Bytes of clouds, outputs and what is being written; the database apart."""
        total = 0
        for folder in ("clouds", "jobs", "tmp"):
            for path in (self.data / folder).rglob("*"):
                try:
                    total += path.stat().st_size if path.is_file() else 0
                except OSError:
                    pass
        return total


class Cloud:
    """A binary PLY of about so many bytes, made while it is sent; each number is another one."""

    BLOCK = b"".join(VERTEX.pack(i * 0.25, (i * 7 % 1000) * 0.5, (i * 13 % 977) * 0.125) for i in range(8192)) * 8

    def __init__(self, number, count_bytes):
        points = max(1, count_bytes // VERTEX.size)
        self.first = (f"ply\nformat binary_little_endian 1.0\nelement vertex {points}\nproperty float x\nproperty float y\n"
                      "property float z\nend_header\n").encode() + VERTEX.pack(number, 0, 0)
        self.rest = (points - 1) * VERTEX.size
        self.bytes = len(self.first) + self.rest

    def parts(self):
        yield self.first
        left = self.rest
        while left:
            part = self.BLOCK[:left]
            left -= len(part)
            yield part

    def sha256(self):
        digest = hashlib.sha256()
        for part in self.parts():
            digest.update(part)
        return digest.hexdigest()

    def slice(self, first, last):
        """The bytes of a range, made anew."""
        out, at = b"", 0
        for part in self.parts():
            if at + len(part) > first and at <= last:
                out += part[max(0, first - at):last + 1 - at]
            at += len(part)
        return out
