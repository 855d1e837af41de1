#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Uploads, range downloads, listeners and slow clients all at once, then many tiny jobs; what comes of it is checked.

Usage: load.py BUILD [--uploads 64] [--bytes 268435456] [--downloads 64] [--listeners 200] [--slow 1000] [--jobs 10000]

Every upload has to arrive right to the byte, every range to be the one asked for, every tiny job to end well, the
service's memory to stay below 64 MiB and 160 KiB for each connection, and /healthz on the admin listener to come within
50 ms in 99 of 100 cases.  The latter depends on the machine: --no-times leaves it out.
"""
import argparse
import concurrent.futures
import json
import pathlib
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from service import Cloud, Service  # noqa: E402

HEALTH_MS, BASE_BYTES, CONNECTION_BYTES = 50, 64 << 20, 160 << 10


def upload(service, cloud):
    """Sends the cloud; what the service says of it."""
    with service.connect() as connection:
        connection.sendall(b"POST /v1/clouds HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: %d\r\n\r\n"
                           % cloud.bytes)
        for part in cloud.parts():
            connection.sendall(part)
        answer = b""
        while True:
            part = connection.recv(65536)
            if not part:
                break
            answer += part
    head, _, body = answer.partition(b"\r\n\r\n")
    if b" 201 " not in head.split(b"\r\n")[0]:
        raise RuntimeError(answer[:500])
    return json.loads(body)


def check_upload(service, cloud):
    told = upload(service, cloud)
    assert told["bytes"] == cloud.bytes, (told, cloud.bytes)
    assert told["sha256"] == cloud.sha256(), told
    return told["id"]


def check_download(service, cloud, name, number, of):
    size = min(cloud.bytes // of, 4 << 20)
    first = number * (cloud.bytes // of)
    last = first + size - 1
    status, _, body = service.ask("GET", f"/v1/clouds/{name}/data", headers={"Range": f"bytes={first}-{last}"})
    assert status == 206 and body == cloud.slice(first, last), (status, first, last)


class Crowd:
    """Clients that hold connections and do next to nothing."""

    def __init__(self, service, listeners, slow):
        self.service, self.ended = service, threading.Event()
        busy = service.ask("POST", "/v1/jobs?outputs=mesh", sphere(200000))
        wait = service.ask("POST", "/v1/jobs", sphere(100))
        self.jobs = [json.loads(reply[2])["id"] for reply in (busy, wait)]
        self.listeners = [self.listen() for _ in range(listeners)]
        self.slow = [service.connect() for _ in range(slow)]
        self.thread = threading.Thread(target=self.trickle)
        self.thread.start()

    def listen(self):
        connection = self.service.connect()
        connection.sendall(b"GET /v1/jobs/%s/events HTTP/1.1\r\nHost: a\r\n\r\n" % self.jobs[1].encode())
        assert connection.recv(12) == b"HTTP/1.1 200"
        return connection

    def trickle(self):
        """A byte of a header for each, once in a while."""
        for connection in self.slow:
            connection.sendall(b"GET / HTTP/1.1\r\nX: ")
        while not self.ended.wait(1):
            for connection in self.slow:
                connection.sendall(b"x")

    def leave(self):
        self.ended.set()
        self.thread.join()
        for connection in self.listeners + self.slow:
            connection.close()
        for job in self.jobs:
            self.service.ask("DELETE", f"/v1/jobs/{job}")
        self.service.wait_for(lambda: self.service.metrics()["whittled_http_connections"] <= 2, "the end of all connections")


def sphere(count, number=0):
    import math
    turn = math.pi * (3 - math.sqrt(5))
    lines = []
    for i in range(count):
        z = 1 - (2 * i + 1) / count
        r = math.sqrt(1 - z * z)
        lines.append(f"{r * math.cos(turn * i) + number:.6f} {r * math.sin(turn * i):.6f} {z:.6f}\n")
    return "".join(lines).encode()


def percentile(times, part):
    return sorted(times)[min(len(times) - 1, int(len(times) * part))]


def run_traffic(service, args):
    """All at once; returns the figures."""
    cloud = Cloud(-1, args.bytes)
    name = check_upload(service, cloud)
    crowd = Crowd(service, args.listeners, args.slow)
    probe = subprocess.Popen([sys.executable, str(pathlib.Path(__file__).with_name("probe.py")), str(service.admin_port)],
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    begin, most = time.monotonic(), 0
    try:
        with concurrent.futures.ThreadPoolExecutor(args.uploads + args.downloads) as pool:
            work = [pool.submit(check_upload, service, Cloud(n, args.bytes)) for n in range(args.uploads)]
            work += [pool.submit(check_download, service, cloud, name, n, args.downloads) for n in range(args.downloads)]
            while not all(task.done() for task in work):
                most = max(most, service.metrics()["whittled_http_connections"])
                time.sleep(0.2)
            for task in work:
                task.result()
        seconds = time.monotonic() - begin
    finally:
        times, _ = probe.communicate("end\n")
        crowd.leave()
    times = [float(line) for line in times.split()]
    connections = max(most, args.listeners + args.slow)
    return {"seconds": seconds, "upload_bytes_per_s": args.uploads * args.bytes / seconds, "probes": len(times),
            "health_ms_median": percentile(times, 0.5), "health_ms_99": percentile(times, 0.99), "health_ms_max": max(times),
            "connections": connections, "resident_bytes_max": service.resident(peak=True),
            "resident_bytes_allowed": BASE_BYTES + CONNECTION_BYTES * int(connections)}


def run_jobs(service, count):
    """Tiny jobs, each another one; returns the figures."""
    before, begin = service.metrics(), time.monotonic()

    def submit(numbers):
        client, names = service.client(), []
        for number in numbers:
            status, _, body = service.ask("POST", "/v1/jobs?label=tiny", sphere(12, number), client)
            assert status == 201, body
            names.append(json.loads(body)["id"])
        return names
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        names = {name for part in pool.map(submit, [range(i, count, 4) for i in range(4)]) for name in part}
    submitted = time.monotonic() - begin
    service.wait_for(lambda: not any(service.metrics()[f'whittled_jobs{{state="{s}"}}'] for s in ("accepted", "running")),
                     "the end of all jobs")
    seconds, after = time.monotonic() - begin, service.metrics()
    found, path = {}, "/v1/jobs?label=tiny&limit=500"
    while path:
        _, headers, body = service.ask("GET", path)
        found |= {job["id"]: job["status"] for job in json.loads(body)["jobs"]}
        path = headers["Link"].split(">")[0][1:] if "Link" in headers else None
    assert len(names) == count and set(found) == names, (len(names), len(found))
    assert set(found.values()) <= {"successful"}, set(found.values())

    def cpu(name):
        return (after[f"whittled_{name}_cpu_seconds_total"] - before[f"whittled_{name}_cpu_seconds_total"]) / count * 1e3
    return {"jobs": count, "submit_ms_each": submitted / count * 1e3, "seconds": seconds,
            "service_cpu_ms_each": cpu("process"), "worker_cpu_ms_each": cpu("worker")}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build")
    for name, value in (("uploads", 64), ("bytes", 256 << 20), ("downloads", 64), ("listeners", 200), ("slow", 1000),
                        ("jobs", 10000)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--folder", help="where the data goes; it needs room for all uploads")
    parser.add_argument("--no-times", action="store_true", help="don't judge the times")
    args = parser.parse_args()
    faults = []
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        service = Service(args.build, folder, "--workers", "1")
        try:
            figures = run_traffic(service, args)
        finally:
            service.stop()
    print(json.dumps(figures, indent=1))
    if figures["resident_bytes_max"] > figures["resident_bytes_allowed"] and "asan" not in args.build:
        faults.append("the service has taken too much memory")
    if figures["health_ms_99"] > HEALTH_MS and not args.no_times:
        faults.append("health came too late")
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        service = Service(args.build, folder)
        try:
            print(json.dumps(run_jobs(service, args.jobs), indent=1))
        finally:
            service.stop()
    print("; ".join(faults) or "all as it should be")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
