#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Uploads, range downloads, listeners and slow clients all at once, then many tiny jobs; what comes of it is checked.

Usage: WHITTLE_BUILD=FOLDER load.py [--uploads 64] [--bytes 268435456] [--downloads 64] [--listeners 200] [--slow 1000] [--jobs 10000]

Every upload has to arrive right to the byte, every range to be the one asked for, every tiny job to end well, the
service's memory to stay below 64 MiB and 160 KiB for each connection, and /healthz on the admin listener to come within
50 ms in 99 of 100 cases.  The latter depends on the machine: --no-times leaves it out.  The clients share the
processors with the service, and let it and the probe of its health go first.  --uploads 0 or --jobs 0 leaves one half
out.
"""
import argparse
import concurrent.futures
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from service import Cloud, Service  # noqa: E402  (it knows where conftest is)
from conftest import SANITIZED, sphere, wait_until  # noqa: E402

HEALTH_MS, BASE_BYTES, CONNECTION_BYTES = 50, 64 << 20, 160 << 10


def upload(service, cloud):
    """Sends the cloud; what the service says of it."""
    with service.connect() as connection:
        connection.sendall(b"POST /v1/clouds HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: %d\r\n\r\n"
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
    status, _, body = service.request("GET", f"/v1/clouds/{name}/data", headers={"Range": f"bytes={first}-{last}"})
    assert status == 206 and body == cloud.slice(first, last), (status, first, last)


class Crowd:
    """Clients that hold connections and do next to nothing."""

    def __init__(self, service, listeners, slow):
        self.service, self.ended = service, threading.Event()
        busy = service.request("POST", "/v1/jobs?outputs=mesh", sphere(200000))
        wait = service.request("POST", "/v1/jobs", sphere(100))
        self.jobs = [json.loads(reply[2])["id"] for reply in (busy, wait)]
        self.listeners = [self.listen() for _ in range(listeners)]
        self.slow = [service.connect() for _ in range(slow)]
        self.thread = threading.Thread(target=self.trickle)
        self.thread.start()

    def listen(self):
        connection = self.service.connect()
        connection.sendall(b"GET /v1/jobs/%s/events HTTP/1.1\r\nHost: localhost\r\n\r\n" % self.jobs[1].encode())
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
            self.service.request("DELETE", f"/v1/jobs/{job}")
        wait_until(lambda: self.service.connections() <= 2, "the end of all connections")


def percentile(times, part):
    return sorted(times)[min(len(times) - 1, int(len(times) * part))]


def step_back():
    """Of a thread: whoever is served isn't asked how fast the clients are."""
    os.setpriority(os.PRIO_PROCESS, 0, min(19, os.getpriority(os.PRIO_PROCESS, 0) + 10))


class Probe:
    """Asks a service for its health until the end."""

    def __init__(self, service):
        self.process = subprocess.Popen(
            [sys.executable, str(pathlib.Path(__file__).with_name("probe.py")), str(service.admin_port)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def end(self):
        """All times in milliseconds."""
        return [float(line) for line in self.process.communicate("end\n")[0].split()]


def run_traffic(service, idle, args):
    """All at once; returns the figures.  A second service that does nothing shows what the machine alone costs."""
    cloud = Cloud(-1, args.bytes)
    name = check_upload(service, cloud)
    crowd = Crowd(service, args.listeners, args.slow)
    probes = [Probe(service), Probe(idle)]
    begin, most = time.monotonic(), 0
    try:
        with concurrent.futures.ThreadPoolExecutor(args.uploads + args.downloads, initializer=step_back) as pool:
            work = [pool.submit(check_upload, service, Cloud(n, args.bytes)) for n in range(args.uploads)]
            work += [pool.submit(check_download, service, cloud, name, n, args.downloads) for n in range(args.downloads)]
            while not all(task.done() for task in work):
                most = max(most, service.connections())
                time.sleep(0.2)
            for task in work:
                task.result()
        seconds = time.monotonic() - begin
    finally:
        times, idle_times = (probe.end() for probe in probes)
        crowd.leave()
    connections = max(most, args.listeners + args.slow)
    return {"seconds": seconds, "upload_bytes_per_s": args.uploads * args.bytes / seconds, "probes": len(times),
            "health_ms_median": percentile(times, 0.5), "health_ms_99": percentile(times, 0.99), "health_ms_max": max(times),
            "idle_health_ms_99": percentile(idle_times, 0.99), "idle_health_ms_max": max(idle_times),
            "connections": connections, "resident_bytes_max": service.resident(peak=True),
            "resident_bytes_allowed": BASE_BYTES + CONNECTION_BYTES * int(connections)}


def run_jobs(service, _, args):
    """Tiny jobs, each another one; returns the figures."""
    count, before, begin = args.jobs, service.metrics(), time.monotonic()

    def submit(numbers):
        client, names = service.client(), []
        for number in numbers:
            status, _, body = service.request("POST", "/v1/jobs?label=tiny", sphere(12, number), connection=client)
            assert status == 201, body
            names.append(json.loads(body)["id"])
        return names
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        names = {name for part in pool.map(submit, [range(i, count, 4) for i in range(4)]) for name in part}
    submitted = time.monotonic() - begin
    service.finish_jobs()
    seconds, after = time.monotonic() - begin, service.metrics()
    found, path = {}, "/v1/jobs?label=tiny&limit=500"
    while path:
        _, headers, body = service.request("GET", path)
        found |= {job["id"]: job["status"] for job in json.loads(body)["jobs"]}
        path = headers["Link"].split(">")[0][1:] if "Link" in headers else None
    assert len(names) == count and set(found) == names, (len(names), len(found))
    assert set(found.values()) <= {"successful"}, set(found.values())

    def cpu(name):
        return (after[f"whittled_{name}_cpu_seconds_total"] - before[f"whittled_{name}_cpu_seconds_total"]) / count * 1e3
    return {"jobs": count, "submit_ms_each": submitted / count * 1e3, "seconds": seconds,
            "service_cpu_ms_each": cpu("process"), "worker_cpu_ms_each": cpu("worker")}


def measure(run, args, *flags):
    """Runs it against a service of its own and prints the figures, and how busy the machine was."""
    with tempfile.TemporaryDirectory(dir=args.folder) as folder, tempfile.TemporaryDirectory() as other:
        services = [Service(folder, *flags), Service(other)]
        try:
            figures = run(*services, args)
        finally:
            for service in services:
                service.stop()
    figures["load_average"] = os.getloadavg()[0]
    print(json.dumps(figures, indent=1), flush=True)
    return figures


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, value in (("uploads", 64), ("bytes", 256 << 20), ("downloads", 64), ("listeners", 200), ("slow", 1000),
                        ("jobs", 10000)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--folder", help="where the data goes; it needs room for all uploads")
    parser.add_argument("--no-times", action="store_true", help="don't judge the times")
    args = parser.parse_args()
    faults = []
    if args.uploads:
        figures = measure(run_traffic, args, "--workers", "1")
        if figures["resident_bytes_max"] > figures["resident_bytes_allowed"] and not SANITIZED:
            faults.append("the service has taken too much memory")
        if figures["health_ms_99"] > HEALTH_MS and not args.no_times:
            faults.append("health came too late")
    if args.jobs:
        measure(run_jobs, args)
    print("; ".join(faults) or "all as it should be")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
