# SPDX-License-Identifier: GPL-3.0-or-later
"""A whittled of one's own, under load: its figures, and the clouds that are sent to it."""
import hashlib
import http.client
import json
import os
import pathlib
import re
import socket
import struct
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent / "integration"))
from conftest import PATIENCE_S, Daemon  # noqa: E402

VERTEX = struct.Struct("<fff")
UNLIMITED = ("--max-queue", "100000", "--max-connections", "4000", "--connections-per-address", "4000",
             "--header-timeout", "1h", "--idle-timeout", "1h", "--min-upload-rate", "0", "--min-free", "0")


class Service(Daemon):
    """Limits are set out of the way: it is the load that is looked at."""

    def __init__(self, folder, *flags):
        super().__init__(pathlib.Path(folder), *UNLIMITED, *flags)
        self.start()
        line = self.process.stdout.readline()
        assert line.startswith("health and metrics on http://"), line
        self.admin_port = int(line.rsplit(":", 1)[1])

    def connect(self):
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S)

    def client(self):
        return http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)

    def document(self, path):
        return json.loads(self.request("GET", path)[2])

    def metrics(self):
        text = self.request("GET", "/metrics")[2].decode()
        return {m[1]: float(m[2]) for m in re.finditer(r"^(whittled_\S+(?:\{.*\})?) (\S+)$", text, re.M)}

    def connections(self):
        return self.metrics()["whittled_http_connections"]

    def unfinished(self):
        metrics = self.metrics()
        return sum(metrics[f'whittled_jobs{{state="{state}"}}'] for state in ("accepted", "running"))

    def finish_jobs(self):
        """Waits for the end of all jobs, as long as some end."""
        left, since = self.unfinished(), time.monotonic()
        while left:
            time.sleep(0.2)
            now = self.unfinished()
            if now < left:
                left, since = now, time.monotonic()
            assert time.monotonic() - since < PATIENCE_S, f"none of {left} jobs ends"

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
