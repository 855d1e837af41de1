#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job through a cluster of one machine: several hosts, PostgreSQL with a standby, Ceph's S3, nginx.

A scan is uploaded once, and jobs with several ratios are made of it; while they run the host that has one of them is
killed.  Prints which host did what, and keeps the outputs of the last job.

    demo.py OUT_FOLDER CLOUD [--hosts 3] [--ratio 0.1] [--jobs 6]    (make demo HOSTS=3)
"""
import argparse
import json
import pathlib
import re
import tempfile
import time

from cluster import PATIENCE_S, Cluster, wait_until
from rounds import ask

OUTPUTS = ["cloud", "mesh", "preview.png", "report"]


def get(url, path):
    """The document, from whichever host answers."""
    def answer():
        reply = ask(url, "GET", path)
        return reply if reply and reply[0] == 200 else None
    return wait_until(answer, f"GET {path}")[2]


def events(c):
    """(time, host, what) of each line of the hosts' logs that tells of a job."""
    found = []
    for host in c.hosts.values():
        for line in host.log_text().splitlines():
            match = re.match(r"\S+T(\S+)Z +\w+ +job=(\S+) (.*)", line)
            if match:
                found.append((match[1], host.name, match[2], match[3]))
    return sorted(found)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("cloud", type=pathlib.Path)
    parser.add_argument("--hosts", type=int, default=3)
    parser.add_argument("--ratio", type=float, default=0.1)
    parser.add_argument("--jobs", type=int, default=6)
    options = parser.parse_args()
    body = options.cloud.read_bytes()
    flags = ["--workers", "1", "--threads-per-job", "1", "--result-cache=0", "--lease", "3s"]
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="whittle-demo.") as folder, Cluster(folder, options.hosts, flags) as c:
        print(f"{options.hosts} hosts, PostgreSQL with a synchronous standby, Ceph's S3 and nginx are up after "
              f"{time.monotonic() - began:.0f} s: {c.url}")
        reply = ask(c.url, "POST", "/v1/clouds", body, seconds=PATIENCE_S)
        assert reply and reply[0] in (200, 201), reply
        cloud = json.loads(reply[2])["id"]
        print(f"POST {c.url}/v1/clouds  <  {options.cloud.name}: {len(body)} bytes, {cloud[:12]}...")
        jobs = []
        for i in range(options.jobs):
            wish = {"input": f"/v1/clouds/{cloud}", "params": {"ratio": options.ratio / (i + 1), "outputs": OUTPUTS}}
            reply = ask(c.url, "POST", "/v1/jobs", json.dumps(wish).encode(), {"Content-Type": "application/json"})
            assert reply and reply[0] == 201, reply
            jobs.append(json.loads(reply[2])["id"])
        print(f"{len(jobs)} jobs of it, with ratios from {options.ratio:g} to {options.ratio / len(jobs):g}")
        busy = wait_until(lambda: next((h for h in c.hosts.values() if h.jobs()), None), "a job that runs")
        busy.process.kill()
        print(f"{busy.name} is killed while it computes; it is started again, as systemd does")
        documents = {}
        for job in jobs:
            def ended(job=job):
                document = json.loads(get(c.url, f"/v1/jobs/{job}"))
                return document if document["status"] in ("successful", "failed", "dismissed") else None
            documents[job] = wait_until(ended, f"the end of {job}", 900)
        print("who did what:")
        number = {job: f"job {i + 1}" for i, job in enumerate(jobs)}
        for when, host, job, what in events(c):
            if job in number:
                print(f"  {when}  {host}  {number[job]}: {what}")
        options.out.mkdir(parents=True, exist_ok=True)
        for output in json.loads(get(c.url, f"/v1/jobs/{jobs[0]}/outputs"))["outputs"]:
            (options.out / output["name"]).write_bytes(get(c.url, f"/v1/jobs/{jobs[0]}/outputs/{output['name']}"))
            print(f"  {options.out / output['name']}: {output['bytes']} bytes")
        assert all(d["status"] == "successful" for d in documents.values()), documents


if __name__ == "__main__":
    main()
