#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The crash campaign: kills the service, or its workers, at a named or at a random moment, starts it again, and looks.

After each restart every job that was answered 201 ends in a right state, every output has the bytes of its hash, what
was deleted stays so, and `whittled check` finds nothing damaged and nothing left behind.  Only what no client was told
of may be in lost+found, clouds aside: another body may have brought the same content.

    crash.py --rounds 500 --seed 1 [--folder DIR]          (make test-crash; a short form runs as test_crash.py)
"""
import argparse
import collections
import concurrent.futures
import hashlib
import http.client
import json
import os
import pathlib
import random
import re
import signal
import sys
import tempfile
import time

from conftest import PATIENCE_S, Daemon, process_lives, sphere, wait_until

# Where the service ends itself (server/daemon/fault_point.c), and how often the point may be passed before that.
POINTS = {"upload-open": 6, "upload-write": 8, "upload-sync": 6, "rename-clouds": 6, "sync-clouds": 6,
          "submit-kept": 6, "submit-committed": 6, "claimed": 5, "started": 5, "outputs-begin": 5, "output-open": 8,
          "output-sync": 8, "rename-jobs": 5, "sync-jobs": 5, "outputs-kept": 5, "job-recorded": 5,
          "delete-committed": 3, "remove-rename": 3, "removed": 3, "commit": 12}
RANDOM_MOMENTS = ("service", "worker", "worker-writing", "mid-upload")
FEW, MANY = sphere(300), sphere(20000)


def request(daemon, method, path, body=None):
    """Status and body; None when the service is gone."""
    try:
        status, _, answer = daemon.request(method, path, body)
        return status, answer
    except (OSError, http.client.HTTPException):
        return None


class Round:
    """A data folder that lives through many ends of its service."""

    def __init__(self, folder, chance, seen):
        self.daemon = Daemon(folder, "--workers", "2", "--min-free", "0", "--threads-per-job", "1")
        self.chance = chance
        self.accepted, self.ended, self.deleted = set(), set(), set()
        self.serial = 0
        self.seen = seen  # how often a named point has ended the service

    def submit(self):
        self.serial += 1
        few = self.chance.random() < 0.8
        same = self.chance.random() < 0.3  # as another one, whose result may serve again
        body = (FEW if few else MANY) + b"# %d\n" % (self.serial % 4 if same else self.serial)
        return body, f"/v1/jobs?ratio=0.5&outputs={self.chance.choice(['cloud', 'cloud,mesh,xyz'])}"

    def post(self, body, path):
        reply = request(self.daemon, "POST", path, body)
        if reply and reply[0] == 201:
            self.accepted.add(json.loads(reply[1])["id"])

    def delete(self, job_id):
        """Of a job that has ended: it is gone for good if that was answered."""
        self.accepted.discard(job_id)
        reply = request(self.daemon, "DELETE", f"/v1/jobs/{job_id}")
        if reply and reply[0] == 200:
            self.deleted.add(job_id)

    def dismiss(self, job_id):
        """Of a job that may be in any state, so that nothing is known of it any more."""
        self.accepted.discard(job_id)
        request(self.daemon, "DELETE", f"/v1/jobs/{job_id}")

    def half_an_upload(self):
        connection = http.client.HTTPConnection("127.0.0.1", self.daemon.port, timeout=PATIENCE_S)
        connection.putrequest("POST", "/v1/jobs?ratio=0.5")
        connection.putheader("Content-Length", str(len(MANY)))
        connection.endheaders()
        connection.send(MANY[:len(MANY) // 2])
        tmp = self.daemon.data / "tmp"
        wait_until(lambda: any(name.startswith("upload") for name in os.listdir(tmp)), "the half")
        return connection

    def traffic(self):
        """A few jobs and deletions, side by side; what the service no longer answers is left out."""
        ended = [i for i in sorted(self.accepted & self.ended) if self.chance.random() < 0.1]
        fresh = [i for i in sorted(self.accepted - self.ended) if self.chance.random() < 0.1]
        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            work = [pool.submit(self.post, *self.submit()) for _ in range(self.chance.randint(4, 8))]
            work += [pool.submit(self.delete, job_id) for job_id in ended]
            work += [pool.submit(self.dismiss, job_id) for job_id in fresh]
            for one in work:
                one.result()

    def gone(self):
        return self.daemon.process.poll() is not None

    def writes(self):
        """Whether a job has begun to write its outputs."""
        try:
            return any(os.listdir(self.daemon.data / "tmp" / name) for name in os.listdir(self.daemon.data / "tmp")
                       if name[0].isdigit())
        except OSError:
            return False  # it has just ended

    def kill_workers(self, writing):
        """Kills a worker, in the midst of its outputs if that is wanted and comes to pass."""
        end = time.monotonic() + 2
        while time.monotonic() < end:
            pids = re.findall(r"accepted -> running attempt=\d+ pid=(\d+)", self.daemon.log_text()[-5000:])
            pids = [int(pid) for pid in pids if process_lives(pid)]
            if pids and (not writing or self.writes()):
                try:
                    os.kill(self.chance.choice(pids), signal.SIGKILL)
                except ProcessLookupError:
                    pass
                return

    def end_somehow(self, moment):
        if moment in POINTS:
            for _ in range(20):
                if self.gone():
                    break
                self.traffic()
            self.seen[moment] += self.gone()
        elif moment == "mid-upload":
            connection = self.half_an_upload()
            self.daemon.kill()
            connection.close()
        else:
            with concurrent.futures.ThreadPoolExecutor(1) as pool:
                work = pool.submit(self.traffic)
                if moment == "service":
                    time.sleep(self.chance.random() * 0.4)
                    self.daemon.kill()
                else:
                    self.kill_workers(moment == "worker-writing")
                work.result()
        if not self.gone():
            self.daemon.kill()
        self.daemon.process.wait(PATIENCE_S)

    def look(self):
        """After the restart."""
        daemon = self.daemon
        for job_id in sorted(self.accepted):
            job = daemon_job(daemon, job_id)
            assert job["status"] == "successful", job
            status, body = request(daemon, "GET", f"/v1/jobs/{job_id}/outputs")
            assert status == 200, body
            for output in json.loads(body)["outputs"]:
                status, content = request(daemon, "GET", f"/v1/jobs/{job_id}/outputs/{output['name']}")
                assert status == 200 and len(content) == output["bytes"]
                assert hashlib.sha256(content).hexdigest() == output["sha256"], output
        self.ended = set(self.accepted)
        for job_id in self.chance.sample(sorted(self.deleted), min(20, len(self.deleted))):
            status, _ = request(daemon, "GET", f"/v1/jobs/{job_id}")
            assert status == 410, (job_id, status)

    def start(self, moment, *fault):
        """false: the point was passed during the start already."""
        try:
            self.daemon.start(*fault)
            return True
        except AssertionError:
            assert fault and self.daemon.process.wait(PATIENCE_S) == -signal.SIGKILL
            self.seen[moment] += 1
            return False

    def run(self, moment):
        fault = ("--fault", f"{moment}=kill:{self.chance.randint(1, POINTS[moment])}") if moment in POINTS else ()
        if self.start(moment, *fault):
            self.end_somehow(moment)
        self.daemon.start()
        self.look()
        assert self.daemon.stop() == 0
        status, lines = self.daemon.check()
        kept = {path.name for kind in ("jobs", "uploads") for path in self.daemon.data.glob(f"lost+found/*/{kind}/*")}
        assert not kept & (self.accepted | self.deleted), kept
        assert status == 0 and all(line.startswith("set aside:") for line in lines[:-1]), lines


def daemon_job(daemon, job_id):
    def ended():
        reply = request(daemon, "GET", f"/v1/jobs/{job_id}")
        assert reply and reply[0] == 200, (job_id, reply)
        job = json.loads(reply[1])
        return job if job["status"] not in ("accepted", "running") else None
    return wait_until(ended, f"the end of {job_id}")


def moments(rounds):
    """Every named point in turn, with a random moment after each two."""
    every = []
    for i, point in enumerate(POINTS):
        every.append(point)
        if i % 2:
            every.append(RANDOM_MOMENTS[i // 2 % len(RANDOM_MOMENTS)])
    return [every[i % len(every)] for i in range(rounds)]


def campaign(folder, rounds, seed, told=lambda text: None):
    chance = random.Random(seed)
    order = moments(rounds)
    chance.shuffle(order)
    current, seen = None, collections.Counter()
    for i, moment in enumerate(order):
        if i % 12 == 0:  # a folder grows with its jobs, and looking at them takes longer
            place = pathlib.Path(folder, f"round{i}")
            place.mkdir()
            current = Round(place, chance, seen)
        told(f"round {i}: {moment}, {len(current.accepted)} jobs")
        try:
            current.run(moment)
        except BaseException:
            print(f"seed {seed}, round {i}: {moment}\n{current.daemon.log_text()[-6000:]}")
            raise
        finally:
            if current.daemon.process and current.daemon.process.poll() is None:
                current.daemon.kill()
    return seen


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", help="for data; a temporary one where it isn't given")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        seen = campaign(arguments.folder or temporary, arguments.rounds, arguments.seed,
                        lambda text: (print(text), sys.stdout.flush()))
    print("ended at:", ", ".join(f"{point} {seen[point]}" for point in POINTS))
    print(f"{arguments.rounds} rounds: nothing lost, nothing damaged, nothing left behind")


if __name__ == "__main__":
    main()
