#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounds of faults against a cluster, and an oracle outside of it.

In each round clients submit jobs through the load balancer, and cancel some, while one or two faults, drawn by the
seed, hit hosts, processes, servers and links.  Then all is mended, and the oracle looks:
- every job that was answered 201 ends as it must: successful, or dismissed where the cancellation was answered;
- no request that was made again under its Idempotency-Key has made a second job;
- no end that was told changes;
- no output differs by a bit from that of one machine;
- each webhook comes; how often one comes again is counted;
- who reads what has ended before gets it, or an honest 5xx, never that it isn't there;
- no row without its blob, ever; no blob without a row once the grace is over (--grace).
The time from the death of a primary to the next 201 is measured.  Round N of a seed is always the same one.

    rounds.py --rounds 200 --seed 1 [--first N] [--faults kill-host,cut-primary] [--folder DIR]    (make test-cluster)
"""
import argparse
import collections
import concurrent.futures
import hashlib
import http.client
import http.server
import json
import os
import pathlib
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time

import cluster
from cluster import BUILD, PATIENCE_S, Cluster, wait_until
from conftest import sphere

LEASE_S, HOUR_S = 3, 3600
SHAPES = {"small": sphere(300), "middle": sphere(3000), "large": sphere(20000)}
PARAMETERS = "ratio=0.5&outputs=cloud,mesh"
ENDED = ("successful", "failed", "dismissed")
REQUEST_S = 15


def one_machines_hashes(folder):
    """Of each output of each shape, as the program for one machine writes it."""
    found = {}
    for name, points in SHAPES.items():
        (folder / f"{name}.xyz").write_bytes(points)
        subprocess.run([BUILD / "whittle", folder / f"{name}.xyz", "--ratio", "0.5", "--outputs", "cloud,mesh", "-q",
                        "-o", f"{folder / name}/"], check=True)
        found[name] = {p.name: hashlib.sha256(p.read_bytes()).hexdigest()
                       for p in (folder / name).iterdir() if p.suffix == ".ply"}
        assert set(found[name]) == {"cloud.ply", "mesh.ply"}, found
    return found


# ------------------------------------------------------------------------------------------------ requests

def ask(url, method, path, body=None, headers=None, seconds=REQUEST_S):
    """Status, headers, body; None: nobody has answered."""
    connection = http.client.HTTPConnection(url.removeprefix("http://"), timeout=seconds)
    try:
        connection.request(method, path, body=body, headers=headers or {})
        reply = connection.getresponse()
        return reply.status, dict(reply.getheaders()), reply.read()
    except (OSError, http.client.HTTPException):
        return None
    finally:
        connection.close()


class Receiver(http.server.ThreadingHTTPServer):
    """Takes webhooks, and counts them by job."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            self.rfile.read(int(self.headers.get("content-length", 0)))
            with self.server.lock:
                self.server.taken[self.headers["webhook-id"]] += 1
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_):
            pass

    def __init__(self, address):
        super().__init__((address, 0), self.Handler)
        self.lock, self.taken = threading.Lock(), collections.Counter()
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self):
        return "http://%s:%d/" % self.server_address


class Job:
    def __init__(self, key, shape):
        self.key, self.shape = key, shape
        self.id, self.cancelled, self.end = None, False, None


class Clients:
    """What is asked of the cluster during a round, by several threads."""

    def __init__(self, url, chance, name, webhook, library, threads=3):
        self.url, self.name, self.webhook, self.library = url, name, webhook, library
        self.jobs, self.found, self.lock = [], [], threading.Lock()
        self.first_201 = []  # (when its request began, when it was answered), by time.monotonic()
        self.ends = threading.Event()
        self.statuses, self.reads = collections.Counter(), collections.Counter()
        seeds = [chance.random() for _ in range(threads)]
        self.threads = [threading.Thread(target=self.work, args=(i, random.Random(s)), daemon=True)
                        for i, s in enumerate(seeds)] if threads else []
        if library:
            self.threads.append(threading.Thread(target=self.read, args=(random.Random(chance.random()),), daemon=True))
        for thread in self.threads:
            thread.start()

    def work(self, number, chance):
        serial = 0
        while not self.ends.is_set():
            serial += 1
            key = f"{self.name}-{number}-{serial}"
            job = Job(key, chance.choices(list(SHAPES), [6, 3, 1])[0])
            by_cloud, cancel, twice = chance.random() < 0.2, chance.random() < 0.1, chance.random() < 0.1
            if self.submit(job, by_cloud):
                with self.lock:
                    self.jobs.append(job)
                if twice:
                    self.submit_again(job)
                if cancel:
                    self.cancel(job)
            self.ends.wait(0.1 + chance.random() * 0.5)

    def read(self, chance):
        """Jobs that have ended before the round, and their outputs."""
        while not self.ends.is_set():
            job, name = chance.choice(self.library), chance.choice([None, "cloud.ply", "mesh.ply"])
            path = f"/v1/jobs/{job.id}" + (f"/outputs/{name}" if name else "")
            reply = ask(self.url, "GET", path)
            self.reads[reply[0] if reply else "none"] += 1
            if reply and reply[0] == 200:
                same = (hashlib.sha256(reply[2]).hexdigest() == job.hashes[name] if name
                        else json.loads(reply[2]) == job.end)
                if not same:
                    self.found.append(f"GET {path} has changed: {reply[2][:300]}")
            elif reply and reply[0] < 500:
                self.found.append(f"GET {path}: {reply[0]} {reply[2][:300]}")
            self.ends.wait(0.2)

    def persist(self, method, path, body, headers, done):
        """Asks until somebody says what is done; what nobody has answered is asked again, also when the round has
        ended.  The reply, None where it was refused for good."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            began = time.monotonic()
            reply = ask(self.url, method, path, body, headers)
            with self.lock:
                self.statuses[reply[0] if reply else "none"] += 1
            if reply and reply[0] in done:
                if reply[0] == 201:
                    with self.lock:
                        self.first_201.append((began, time.monotonic()))
                return reply
            # 409 another one with the key is under way, 429 the queue is full, 5xx not now.
            if reply and reply[0] not in (409, 429) and reply[0] < 500:
                self.found.append(f"{method} {path} of {headers}: {reply[0]} {reply[2][:300]}")
                return None
            time.sleep(0.3)
        self.found.append(f"{method} {path} of {headers} was not answered in {PATIENCE_S} s: {reply and reply[2][:300]}")
        return None

    def submit(self, job, by_cloud):
        body = SHAPES[job.shape] + b"# %s\n" % job.key.encode()
        path, headers = f"/v1/jobs?{PARAMETERS}&webhook={self.webhook}", {"Idempotency-Key": job.key}
        if by_cloud:
            reply = self.persist("POST", "/v1/clouds", body, {"Idempotency-Key": job.key + "-cloud"}, (200, 201))
            if not reply:
                return False
            path, headers = "/v1/jobs", {**headers, "Content-Type": "application/json"}
            body = json.dumps({"input": f"/v1/clouds/{json.loads(reply[2])['id']}", "webhook": self.webhook,
                               "params": {"ratio": 0.5, "outputs": ["cloud", "mesh"]}}).encode()
        job.request = path, body, headers
        reply = self.persist("POST", *job.request, (201,))
        if reply:
            job.id = json.loads(reply[2])["id"]
        return reply is not None

    def submit_again(self, job):
        """Once more under the same key: it is the same job."""
        reply = self.persist("POST", *job.request, (200, 201))
        if reply and json.loads(reply[2])["id"] != job.id:
            self.found.append(f"key {job.key} made {job.id} and {json.loads(reply[2])['id']}")

    def cancel(self, job):
        """DELETE: of one that has ended by then it removes it."""
        reply = self.persist("DELETE", f"/v1/jobs/{job.id}", None, {}, (200, 202, 410))
        job.cancelled = reply is not None

    def stop(self):
        self.ends.set()
        for thread in self.threads:
            thread.join()


# ------------------------------------------------------------------------------------------------ faults

class Fault:
    """What happens, and how it is mended.  Mending comes when `hold` seconds are over."""

    def __init__(self, name, target, hold, begin, mend=lambda: None):
        self.name, self.target, self.hold, self.begin, self.mend = name, target, hold, begin, mend

    def __str__(self):
        return f"{self.name}({self.target})"


def make_faults(c, chance):
    """One of each kind, with its target and its time drawn."""
    host = c.hosts[chance.choice(sorted(c.hosts))]
    network, database, gateway = c.network, c.database, c.store.gateway
    hold = LEASE_S + 1 + chance.random() * 4
    aims = {}

    def of_primary(begin, mend=lambda node: None):
        """The one that is the primary when it begins."""
        def aim():
            aims["primary"] = database.primary
            begin(database.primary)
        return aim, lambda: mend(aims["primary"])

    def orphan():
        aims["orphan"] = database.orphan()

    def adopt():
        if aims["orphan"]:
            database.adopt()

    def stop_gateway():
        gateway.signal(signal.SIGSTOP)

    def kill_worker():
        # A job's process, of whichever host has one by then.
        end = time.monotonic() + 5
        while time.monotonic() < end:
            for each in [host, *c.hosts.values()]:
                for pid in each.jobs():
                    try:
                        os.kill(pid, signal.SIGKILL)
                        return
                    except ProcessLookupError:
                        pass
            time.sleep(0.01)

    def sign(seconds):
        return lambda: host.set_clock(seconds)

    def one_way(a, b):
        return (lambda: network.mute(a, b)), (lambda: network.unmute(a, b))

    def fill_store():
        for kind, ratio in (("nearfull", "0.00001"), ("backfillfull", "0.00002"), ("full", "0.00003")):
            c.store.ceph_command("osd", f"set-{kind}-ratio", ratio)

    def empty_store():
        for kind, ratio in (("full", "0.95"), ("backfillfull", "0.9"), ("nearfull", "0.85")):
            c.store.ceph_command("osd", f"set-{kind}-ratio", ratio)

    other = chance.choice([-HOUR_S, HOUR_S])
    kinds = {
        "kill-host": (host.name, host.process.kill),
        "stop-host": (host.name, lambda: host.process.signal(signal.SIGSTOP), lambda: host.process.signal(signal.SIGCONT)),
        "kill-worker": (host.name, kill_worker),
        "kill-primary": ("database", *of_primary(lambda node: database.nodes[node].kill())),
        "stop-primary": ("database", *of_primary(lambda node: database.nodes[node].signal(signal.SIGSTOP))),
        "orphan-primary": ("database", orphan, adopt),
        "kill-standby": ("database", lambda: database.nodes[database.standby].kill()),
        "kill-gateway": ("s3", gateway.kill, gateway.start),
        "stop-gateway": ("s3", stop_gateway, lambda: gateway.signal(signal.SIGCONT)),
        "cut-host": (host.name, lambda: network.cut(host.name), lambda: network.join(host.name)),
        "cut-primary": ("database", *of_primary(network.cut, network.join)),
        "cut-gateway": ("s3", lambda: network.cut("s3"), lambda: network.join("s3")),
        "mute-host-to-primary": (host.name, *of_primary(lambda node: network.mute(host.name, node),
                                                        lambda node: network.unmute(host.name, node))),
        "mute-primary-to-host": (host.name, *of_primary(lambda node: network.mute(node, host.name),
                                                        lambda node: network.unmute(node, host.name))),
        "mute-host-to-store": (host.name, *one_way(host.name, "s3")),
        "mute-store-to-host": (host.name, *one_way("s3", host.name)),
        "mute-balancer-to-host": (host.name, *one_way("lb", host.name)),
        "mute-host-to-balancer": (host.name, *one_way(host.name, "lb")),
        "mute-primary-to-standby": ("database", *of_primary(
            lambda node: network.mute(node, other_node(database, node)),
            lambda node: network.unmute(node, other_node(database, node)))),
        "full-disk": (host.name, host.fill_disk, host.free_disk),
        "full-store": ("s3", fill_store, empty_store),
        "clock": (f"{host.name} {other:+d} s", sign(other), sign(0)),
    }
    return {name: Fault(name, kind[0], max(hold, SLOW.get(name, 0)), *kind[1:]) for name, kind in kinds.items()}


def other_node(database, node):
    return next(n for n in database.nodes if n != node)


SLOW = {"full-store": 15, "orphan-primary": 15}  # seconds that it takes to be noticed
ENDS_PRIMARY = ("kill-primary", "stop-primary", "cut-primary", "orphan-primary")


# ------------------------------------------------------------------------------------------------ rounds

class Campaign:
    def __init__(self, c, options, hashes):
        self.cluster, self.options, self.hashes = c, options, hashes
        self.receiver = Receiver(c.network.address("client"))
        self.gaps, self.found, self.jobs, self.cancelled, self.again = [], [], 0, 0, 0
        self.drawn = collections.Counter()
        self.library = self.make_library()

    def make_library(self):
        """Jobs that are read in all rounds."""
        clients = Clients(self.cluster.url, random.Random(0), f"library-{os.getpid()}", self.receiver.url, [], 0)
        jobs = [Job(f"library-{os.getpid()}-{shape}", shape) for shape in SHAPES]
        for job in jobs:
            assert clients.submit(job, False), clients.found
            job.hashes = self.hashes[job.shape]
            assert self.look_at(job) == [], job.id
        return jobs

    def draw(self, number):
        chance = random.Random(f"{self.options.seed}/{number}")
        faults = make_faults(self.cluster, chance)
        names = sorted(set(self.options.faults or faults))
        # Each kind in turn, and a second one at random in half of the rounds.
        drawn = [faults[names[number % len(names)]]]
        if chance.random() < 0.5 and len(names) > 1:
            second = make_faults(self.cluster, chance)[chance.choice([n for n in names if n != drawn[0].name])]
            if not (drawn[0].name in ENDS_PRIMARY and second.name in ENDS_PRIMARY):
                drawn.append(second)
        return chance, drawn

    def run_round(self, number):
        chance, faults = self.draw(number)
        began = time.monotonic()
        clients = Clients(self.cluster.url, chance, f"s{self.options.seed}r{number}-{os.getpid()}", self.receiver.url,
                          self.library)
        deaths, mends = [], []
        for fault in faults:
            time.sleep(0.5 + chance.random())
            fault.begin()
            if fault.name in ENDS_PRIMARY:
                deaths.append(time.monotonic())
            self.drawn[fault.name] += 1
            mends.append((time.monotonic() + fault.hold, fault))
        for when, fault in sorted(mends, key=lambda m: m[0]):
            time.sleep(max(0, when - time.monotonic()))
            fault.mend()
        time.sleep(1 if not deaths else 3)
        clients.stop()
        found = clients.found
        try:
            wait_until(self.cluster.is_whole, "a whole cluster")
        except AssertionError as error:
            found.append(str(error))
        # The next answer to a request that was begun after the death.
        gaps = [min((answered - death for asked, answered in clients.first_201 if asked > death), default=None)
                for death in deaths]
        self.gaps += gaps
        found += [f"no work went on after the primary's death within 30 s: {gap}" for gap in gaps if not gap or gap > 30]
        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            found += [text for texts in pool.map(self.look_at, clients.jobs) for text in texts]
        found += self.look_at_all(clients.jobs)
        self.jobs += len(clients.jobs)
        print(f"round {number}: {' + '.join(map(str, faults))}: {len(clients.jobs)} jobs, "
              f"{time.monotonic() - began:.0f} s, answers {dict(clients.statuses)}, reads {dict(clients.reads)}"
              + (f", the next 201 {', '.join(f'{g:.1f}' for g in gaps if g)} s after the primary's death" if gaps else ""),
              flush=True)
        for text in found:
            print(f"  WRONG: {text}", flush=True)
        self.found += [f"round {number}: {text}" for text in found]

    def document(self, job):
        reply = ask(self.cluster.url, "GET", f"/v1/jobs/{job.id}", seconds=30)
        return (reply[0], json.loads(reply[2])) if reply and reply[0] in (200, 404, 410) else None

    def look_at(self, job):
        """What is wrong with a job."""
        def ended():
            answer = self.document(job)
            return answer if answer and (answer[0] != 200 or answer[1]["status"] in ENDED) else None
        try:
            status, document = wait_until(ended, f"the end of {job.id} ({job.shape})")
        except AssertionError as error:
            return [f"{error}: {self.document(job)}"]
        if job.cancelled:
            self.cancelled += 1
            gone = status == 410 or (status == 200 and document["status"] == "dismissed")
            return [] if gone else [f"{job.id} was cancelled, and is {status} {document}"]
        if status != 200 or document["status"] != "successful":
            return [f"{job.id} has ended as {status} {document.get('status')}: {document.get('problem')}"]
        job.end = document
        return self.look_at_outputs(job)

    def look_at_outputs(self, job):
        found = []
        for name, expected in self.hashes[job.shape].items():
            reply = wait_until(lambda: (lambda r: r if r and r[0] != 503 else None)(
                ask(self.cluster.url, "GET", f"/v1/jobs/{job.id}/outputs/{name}", seconds=60)), f"{name} of {job.id}")
            if reply[0] != 200:
                found.append(f"{name} of {job.id}: {reply[0]} {reply[2][:200]}")
            elif hashlib.sha256(reply[2]).hexdigest() != expected:
                found.append(f"{name} of {job.id} ({job.shape}) isn't what one machine makes of it")
        return found

    def look_at_all(self, jobs):
        """Webhooks that didn't come, ends that changed; then the jobs are deleted."""
        found, ended = [], [job for job in jobs if job.end]
        try:
            wait_until(lambda: all(self.receiver.taken[job.id] for job in ended), "every webhook")
        except AssertionError as error:
            found.append(f"{error}: {[job.id for job in ended if not self.receiver.taken[job.id]]}")
        self.again += sum(self.receiver.taken[job.id] - 1 for job in ended if self.receiver.taken[job.id] > 1)
        for job in ended:
            answer = wait_until(lambda: self.document(job), f"an answer for {job.id}")
            if answer != (200, job.end):
                found.append(f"the end of {job.id} has changed: {job.end} {answer}")
            def deleted(job=job):
                reply = ask(self.cluster.url, "DELETE", f"/v1/jobs/{job.id}")
                return reply if reply and reply[0] < 500 else None
            reply = wait_until(deleted, f"an answer to DELETE of {job.id}")
            if reply[0] not in (200, 410):  # 410: the answer to the first one was lost
                found.append(f"DELETE of {job.id}: {reply}")
        return found

    def check(self, grace_s=0):
        """Rows and blobs.  What belongs to nothing may be there until the grace is over."""
        end = time.monotonic() + grace_s
        while True:
            status, lines = self.cluster.check()
            left = [line for line in lines[:-1] if not line.startswith("damaged")]
            if status or not left or time.monotonic() > end:
                break
            time.sleep(5)
        print(f"check: {lines[-1]}", flush=True)
        wrong = [line for line in lines if line.startswith("damaged")] if status else []
        if status and not wrong:
            wrong = lines
        self.found += [f"check: {line}" for line in wrong + (left if grace_s else [])]
        for line in (wrong + left)[:20]:
            print(f"  {line}", flush=True)


def end_orderly(*_):
    sys.exit(1)  # so that what was started is ended


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seed", default=str(random.SystemRandom().randrange(10**6)))
    parser.add_argument("--first", type=int, default=0, help="the number of the first round")
    parser.add_argument("--faults", type=lambda text: text.split(","), help="these alone, separated by commas")
    parser.add_argument("--grace", type=int, help="how long blobs without a row may stay at the end, in seconds; "
                        "without it they are counted")
    parser.add_argument("--folder", help="for logs and data; kept, as it is without this where something is found")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, end_orderly)
    folder = pathlib.Path(options.folder or tempfile.mkdtemp(prefix="whittle-cluster."))
    folder.mkdir(parents=True, exist_ok=True)
    print(f"seed {options.seed}, rounds {options.first} to {options.first + options.rounds - 1}, in {folder}", flush=True)
    reference = folder / "reference"
    reference.mkdir()
    hashes = one_machines_hashes(reference)
    secret = folder / "secret"
    secret.write_text("whsec_MDEyMzQ1Njc4OWFiY2RlZjAxMjM0NTY3ODlhYmNkZWY=\n", encoding="ascii")
    secret.chmod(0o600)
    flags = ["--lease", f"{LEASE_S}s", "--workers", "1", "--threads-per-job", "1", "--result-cache=0", "--webhooks",
             "--webhook-secret-file", secret, "--webhook-allow", "10.77.0.1", "--webhook-retry", "1s",
             "--drain-timeout", "10s"]
    began = time.monotonic()
    with Cluster(folder, 3, flags) as c:
        print(f"three hosts, two servers, a gateway and a balancer are up after {time.monotonic() - began:.0f} s", flush=True)
        campaign = Campaign(c, options, hashes)
        for number in range(options.first, options.first + options.rounds):
            campaign.run_round(number)
            if number % 10 == 9:
                campaign.check()
        campaign.check(options.grace or 0)
    gaps = [gap for gap in campaign.gaps if gap]
    print(f"{options.rounds} rounds, {campaign.jobs} jobs, {campaign.cancelled} of them cancelled, "
          f"{campaign.again} webhooks that came again, {time.monotonic() - began:.0f} s, seed {options.seed}")
    if gaps:
        print(f"failover: {len(gaps)} times, the next 201 came after {statistics.median(gaps):.1f} s (median), "
              f"{max(gaps):.1f} s at most")
    print("faults: " + ", ".join(f"{name} {count}" for name, count in sorted(campaign.drawn.items())))
    print(f"{len(campaign.found)} findings")
    for text in campaign.found:
        print(f"  {text}")
    if not campaign.found and not options.folder:
        shutil.rmtree(folder, ignore_errors=True)
    sys.exit(1 if campaign.found else 0)


if __name__ == "__main__":
    main()
