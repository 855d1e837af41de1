#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a cluster is worth and what it costs, on one machine: the throughput of three hosts, each held to half a core by
its control group (version 1's cpu.cfs_quota_us), against that of one; and the time from POST to the output of a trivial
job at a host that shares PostgreSQL and Ceph's S3, against one with SQLite and a folder.  Rounds alternate, so that what
else the machine does hits all alike; how busy it is is told.

    bench.py [--rounds 3] [--jobs 24] [--share 0.5]    (make bench-hosts)
"""
import argparse
import concurrent.futures
import datetime
import json
import os
import pathlib
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time

from cluster import BUILD, ROOT, Cluster, wait_until
from conftest import sphere
from rounds import ask

sys.path.insert(0, str(ROOT / "tests/bench"))
from overhead import trivial_jobs  # noqa: E402

GROUPS = pathlib.Path("/sys/fs/cgroup/cpu")
PERIOD_US = 100000
CLOUD = sphere(60000)


class Groups:
    """A control group for each host, and one for all else of the cluster."""

    def __init__(self, names, share):
        self.root = GROUPS / f"whittle{os.getpid()}"
        if not (GROUPS / "cpu.cfs_quota_us").exists():
            sys.exit(f"there is no {GROUPS}/cpu.cfs_quota_us")
        self.root.mkdir()
        # What else the machine does is not to take away what the cluster may have.
        (self.root / "cpu.shares").write_text("65536")
        (self.root / "rest").mkdir()
        (self.root / "rest/cgroup.procs").write_text(str(os.getpid()))
        for name in names:
            (self.root / name).mkdir()
            (self.root / name / "cpu.cfs_period_us").write_text(str(PERIOD_US))
            (self.root / name / "cpu.cfs_quota_us").write_text(str(int(PERIOD_US * share)))

    def inside(self, name):
        """The command that runs another one in the group, in its own place."""
        return "sh", "-ec", f'echo $$ > {self.root / name}/cgroup.procs; exec "$@"', "sh"

    def throttled(self, name):
        """In how many periods the host has had all that it may have."""
        return int(re.search(r"nr_throttled (\d+)", (self.root / name / "cpu.stat").read_text())[1])

    def close(self):
        (GROUPS / "cgroup.procs").write_text(str(os.getpid()))
        for group in [*self.root.iterdir(), self.root]:
            if group.is_dir():
                group.rmdir()


def run_jobs(c, count):
    """Jobs a second, from the first one's start to the last one's end, by the catalog's clock.  All are of one cloud."""
    reply = ask(c.url, "POST", "/v1/clouds", CLOUD, seconds=120)
    wish = {"input": f"/v1/clouds/{json.loads(reply[2])['id']}", "params": {"ratio": 0.5, "outputs": ["cloud", "mesh"]}}

    def submit(_):
        reply = ask(c.url, "POST", "/v1/jobs", json.dumps(wish).encode(), {"Content-Type": "application/json"}, 120)
        assert reply and reply[0] == 201, reply
        return json.loads(reply[2])["id"]

    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        jobs = list(pool.map(submit, range(count)))

    def ended(job):
        reply = ask(c.url, "GET", f"/v1/jobs/{job}")
        document = json.loads(reply[2]) if reply and reply[0] == 200 else {}
        assert document.get("status") != "failed", document
        return document if document.get("status") == "successful" else None

    def all_ended():
        time.sleep(0.5)
        return ended(jobs[-1])
    wait_until(all_ended, "the last job", 900)
    documents = [wait_until(lambda job=job: ended(job), job) for job in jobs]
    starts = [read_time(d["started"]) for d in documents]
    ends = [read_time(d["finished"]) for d in documents]
    return count / (max(ends) - min(starts))


def read_time(text):
    return datetime.datetime.fromisoformat(text.replace("Z", "+00:00")).timestamp()


def measure_throughput(c, options):
    """Ratios of three hosts' throughput to one's, round by round."""
    ratios, names = [], sorted(c.hosts)
    for number in range(options.rounds):
        for name in names[1:]:
            c.hosts[name].is_wanted = False
            c.hosts[name].process.stop()
        one = run_jobs(c, options.jobs // 3)
        for name in names[1:]:
            c.hosts[name].start()
            wait_until(c.hosts[name].answers, name)
        three = run_jobs(c, options.jobs)
        ratios.append(three / one)
        print(f"round {number}: one host {one:.3f} jobs/s, three {three:.3f}, ratio {three / one:.2f}, "
              f"load {os.getloadavg()[0]:.1f}", flush=True)
    return ratios


def measure_trivial(c, folder, flags, rounds):
    """Milliseconds of trivial jobs at a host that shares nothing, and at one of the cluster."""
    alone, shared = [], []
    with subprocess.Popen([BUILD / "whittled", "--listen", "127.0.0.1:0", "--data", folder, *flags],
                          stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as daemon:
        url = daemon.stdout.readline().split()[-1]
        for _ in range(rounds):
            alone += trivial_jobs(url)
            shared += trivial_jobs(c.hosts["host1"].url)
        daemon.terminate()
    return alone, shared


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=30, help="for three hosts; a third of it for one")
    parser.add_argument("--share", type=float, default=0.5, help="of a core, for each host")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    flags = ["--workers", "1", "--threads-per-job", "1", "--result-cache=0", "--max-queue", "10000"]
    groups = Groups([f"host{i + 1}" for i in range(3)], options.share)
    try:
        with tempfile.TemporaryDirectory(prefix="whittle-bench.") as folder, \
                Cluster(folder, 3, flags, fakes_time=False, wrap=groups.inside) as c:
            ratios = measure_throughput(c, options)
            assert all(groups.throttled(name) for name in c.hosts), "the groups held nobody"
        with tempfile.TemporaryDirectory(prefix="whittle-bench.") as folder, \
                Cluster(folder, 1, flags, fakes_time=False) as c:
            alone, shared = measure_trivial(c, pathlib.Path(folder) / "alone", flags, options.rounds)
    finally:
        groups.close()
    print(f"three hosts of {options.share} cores against one: {statistics.median(ratios):.2f} times (median), "
          f"{max(ratios):.2f} at best")
    print(f"trivial job, SQLite and a folder: median {statistics.median(alone):.1f} ms, best {min(alone):.1f} ms")
    print(f"trivial job, PostgreSQL with a synchronous standby and S3: median {statistics.median(shared):.1f} ms, "
          f"best {min(shared):.1f} ms")
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    main()
