#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixed traffic for a time, with workers killed at random; nothing may grow: memory, descriptors, processes, disk.

Usage: WHITTLE_BUILD=FOLDER soak.py [--seconds 3600] [--seed 1]

Each round sends jobs, one-shots, listeners, downloads, uploads that are cut off and requests that are wrong, kills a
worker now and then, and deletes what it has made.  Figures are taken between rounds, when nothing is under way; those of
the first tenth of the time count as warming up.
"""
import argparse
import json
import os
import pathlib
import random
import signal
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).parent))
from service import Service  # noqa: E402  (it knows where conftest is)
from conftest import sphere, wait_until  # noqa: E402

MEMORY_GROWTH, DESCRIPTOR_GROWTH = 24 << 20, 8


class Soak:
    def __init__(self, service, seed):
        self.service, self.chance, self.number = service, random.Random(seed), 0
        self.count = {}

    def note(self, what):
        self.count[what] = self.count.get(what, 0) + 1

    def another(self, points):
        self.number += 1
        return sphere(points, self.number % 100000)

    def submit(self):
        status, _, body = self.service.request("POST", "/v1/jobs?outputs=cloud,mesh", self.another(self.chance.choice([30, 300, 3000])))
        assert status == 201, body
        self.note("job")
        return json.loads(body)["id"]

    def one_shot(self):
        status, _, body = self.service.request("POST", "/v1/simplify", self.another(200))
        assert status == 200 or b"worker-crashed" in body, body
        self.note("one-shot")

    def cut_upload(self):
        body = self.another(300)
        with self.service.connect() as connection:
            connection.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n" % len(body))
            connection.sendall(body[:self.chance.randrange(len(body))])
        self.note("cut upload")

    def abandon(self):
        body = self.another(3000)
        with self.service.connect() as connection:
            connection.sendall(b"POST /v1/simplify HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
        self.note("abandoned one-shot")

    def wrong(self):
        for path, status in (("/nowhere", 404), ("/v1/jobs?ratoi=1", 400), ("/v1/jobs/x", 404)):
            assert self.service.request("GET", path)[0] == status
        assert self.service.request("POST", "/v1/jobs", b"\x89PNG\r\n\x1a\n" + bytes(5000))[0] == 415
        self.note("wrong")

    def listen(self, job):
        """Some stay to the end, some don't."""
        with self.service.connect() as connection:
            connection.sendall(b"GET /v1/jobs/%s/events HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n" % job.encode())
            stays = self.chance.random() < 0.5
            while connection.recv(65536) and stays:
                pass
        self.note("listener")

    def download(self, job):
        status, _, body = self.service.request("GET", f"/v1/jobs/{job}/outputs/cloud.ply")
        if status == 200:
            part = self.service.request("GET", f"/v1/jobs/{job}/outputs/cloud.ply", headers={"Range": "bytes=3-50"})
            assert part[0] == 206 and part[2] == body[3:51]
            self.note("download")

    def kill(self, ended):
        """Kills a worker now and then."""
        while not ended.wait(self.chance.random()):
            for pid in self.service.children()[:1]:
                try:
                    os.kill(pid, signal.SIGKILL)
                    self.note("kill")
                except ProcessLookupError:
                    pass

    def round(self):
        ended = threading.Event()
        killer = threading.Thread(target=self.kill, args=(ended,))
        killer.start()
        try:
            jobs = [self.submit() for _ in range(4)]
            for act in self.chance.sample([self.one_shot, self.cut_upload, self.abandon, self.wrong], 4):
                act()
            for job in jobs:
                self.listen(job)
        finally:
            ended.set()
            killer.join()
        wait_until(self.alone, "the end of all connections")
        self.service.finish_jobs()
        for job in self.service.document("/v1/jobs?limit=500")["jobs"]:
            self.download(job["id"])
            assert self.service.request("DELETE", f"/v1/jobs/{job['id']}")[0] == 200
        wait_until(self.alone, "the end of all connections")

    def alone(self):
        return self.service.connections() <= 1

    def figures(self):
        return {"resident": self.service.resident(), "descriptors": self.service.descriptors(),
                "processes": len(self.service.children()), "disk": self.service.disk()}


def check(first, last):
    """What has grown."""
    allowed = {"resident": MEMORY_GROWTH, "descriptors": DESCRIPTOR_GROWTH, "processes": 0, "disk": 0}
    return [f"{name}: {first[name]} -> {last[name]}" for name, more in allowed.items() if last[name] > first[name] + more]


def run(folder, seconds, seed):
    """Returns what has grown, and the figures before and after."""
    service = Service(folder, "--workers", "2")
    soak, begin, first, rounds = Soak(service, seed), time.monotonic(), None, 0
    try:
        while first is None or time.monotonic() - begin < seconds:
            soak.round()
            rounds += 1
            if first is None and time.monotonic() - begin >= seconds / 10:
                first = soak.figures()
        last = soak.figures()
    finally:
        status = service.stop()
    assert status == 0, service.log_text()[-2000:]
    return check(first, last), {"rounds": rounds, "done": soak.count, "first": first, "last": last}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3600)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        grown, figures = run(folder, args.seconds, args.seed)
    print(json.dumps(figures, indent=1))
    print("; ".join(grown) or "nothing has grown")
    sys.exit(bool(grown))


if __name__ == "__main__":
    main()
