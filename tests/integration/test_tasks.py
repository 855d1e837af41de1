# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that don't fit into the memory of a process are made in tiles: the same bytes as the command's, whoever dies."""
import array
import contextlib
import gzip
import hashlib
import math
import os
import random
import re
import shutil
import signal
import struct
import subprocess
import time

import pytest

from conftest import BUILD, HOSTS, SANITIZED, process_lives, read_of, wait_until
from test_hosts import content, make_server, make_shared, names  # noqa: F401 (fixtures)

# Of 160 MiB a process has room for about 250 000 points, and in one piece these take more.
LIMIT, POINTS, QUERY = "160M", 600000, "?ratio=0.02&outputs=cloud"
pytestmark = pytest.mark.skipif(SANITIZED, reason="sanitizers have a time and memory of their own")


@pytest.fixture(name="cloud", scope="module")
def make_cloud(tmp_path_factory):
    spread = random.Random(7)
    body = array.array("f")
    for _ in range(POINTS):
        x, y = 90 * spread.random(), 110 * spread.random()
        body.extend((x, y, 3 * math.sin(x / 5) * math.cos(y / 7)))
    path = tmp_path_factory.mktemp("tasks") / "bumps.ply"
    path.write_bytes((f"ply\nformat binary_little_endian 1.0\nelement vertex {POINTS}\nproperty float x\n"
                      "property float y\nproperty float z\nend_header\n").encode() + body.tobytes())
    return path


@pytest.fixture(name="expected", scope="module")
def make_expected(cloud, tmp_path_factory):
    """What the command makes of it within the same memory."""
    out = tmp_path_factory.mktemp("tasks") / "out.ply"
    done = subprocess.run([BUILD / "whittle", cloud, out, "--ratio", "0.02", "--memory", LIMIT, "--threads", "1"],
                          capture_output=True, text=True, check=True)
    assert "tiles in" in done.stderr
    return out.read_bytes()


def limited(make_daemon, *flags):
    return make_daemon("--job-memory", LIMIT, "--total-memory", "1G", "--workers", "2", "--threads-per-job", "1", *flags)


def blobs_of(daemon, job):
    return sorted(path.name for path in (daemon.data / "jobs" / job).glob("tiles/*"))


def test_the_bytes_are_the_command_s(make_daemon, cloud, expected):
    daemon = limited(make_daemon)
    job = daemon.submit(cloud.read_bytes(), QUERY)
    running = wait_until(lambda: (daemon.job(job)["tiles"] or {}).get("done", 0) > 0 and daemon.job(job), "a tile")
    assert running["status"] in ("running", "successful") and running["tiles"]["of"] > 2
    ended = daemon.ended(job)
    assert ended["status"] == "successful", (ended, daemon.log_text()[-3000:])
    assert ended["tiles"]["done"] == ended["tiles"]["of"]
    assert ended["attempt"] == ended["tiles"]["of"] + 2  # no task ran twice
    assert ended["report"]["points_in"] == POINTS and ended["report"]["points_out"] == POINTS // 50
    assert content(daemon, job) == expected
    assert ended["resources"]["peak_rss_bytes"] < 160 << 20
    if not HOSTS:
        wait_until(lambda: blobs_of(daemon, job) == [] and daemon.leftovers() == [], "an empty folder")
        assert daemon.stop() == 0 and daemon.check()[0] == 0


def test_a_tileset_of_all_points_is_the_command_s(make_daemon, cloud, tmp_path):
    """More points than a process could finish: tiles tell what has gone, and the last task makes files of them."""
    subprocess.run([BUILD / "whittle", cloud, tmp_path / "out.3tz", "--ratio", "1", "--memory", LIMIT, "--threads", "1"],
                   capture_output=True, check=True)
    daemon = limited(make_daemon)
    job = daemon.submit(cloud.read_bytes(), "?ratio=1&outputs=tileset")
    ended = daemon.ended(job)
    assert ended["status"] == "successful" and ended["tiles"]["of"] > 2, (ended, daemon.log_text()[-3000:])
    assert ended["report"]["points_out"] == POINTS
    assert ended["resources"]["peak_rss_bytes"] < 160 << 20
    assert daemon.curl(f"/v1/jobs/{job}/outputs/tileset.3tz").body == (tmp_path / "out.3tz").read_bytes()
    if not HOSTS:
        wait_until(lambda: blobs_of(daemon, job) == [] and daemon.leftovers() == [], "an empty folder")


@pytest.mark.parametrize("flags, name", [(("--spacing", "0.8"), "cloud.ply"), (("--normals", "true"), "cloud.ply"),
                                         ((), "mesh.glb")])
def test_what_tiles_make_beside_plain_clouds(make_daemon, cloud, tmp_path, flags, name):
    """Spacings, normals, and meshes of as many points as there is room for: the bytes are the command's."""
    flags = (*flags, *(() if "--spacing" in flags else ("--ratio", "0.02")), "--outputs", name)
    done = subprocess.run([BUILD / "whittle", cloud, "-o", tmp_path / name, *flags, "--memory", LIMIT, "--threads", "1"],
                          capture_output=True, text=True, check=True)
    assert "tiles in" in done.stderr
    daemon = limited(make_daemon)
    query = "&".join(f"{flag[2:]}={value}" for flag, value in zip(flags[::2], flags[1::2]))
    ended = daemon.ended(daemon.submit(cloud.read_bytes(), f"?{query}"))
    assert ended["status"] == "successful" and ended["tiles"]["of"] > 2, (ended, daemon.log_text()[-3000:])
    assert ended["resources"]["peak_rss_bytes"] < 160 << 20
    assert daemon.curl(f"/v1/jobs/{ended['id']}/outputs/{name}").body == (tmp_path / name).read_bytes()


@pytest.mark.parametrize("form", ["ply.zst", "xyz.gz", "pcd"])
def test_what_is_compressed_is_made_in_tiles_too(make_daemon, cloud, tmp_path, form):
    """Each of them beyond memory once it is decompressed, which a task does onto its disk."""
    path = tmp_path / f"bumps.{form.partition('.')[0]}"
    subprocess.run([BUILD / "whittle", "convert", cloud, path, "--pcd-precision", "double"], capture_output=True, check=True)
    if form == "pcd":
        path.write_bytes(in_columns(path.read_bytes()))
    elif form.endswith("gz"):
        path.write_bytes(gzip.compress(path.read_bytes(), 1))
    elif shutil.which("zstd"):
        subprocess.run(["zstd", "-q", "--rm", "-1", path, "-o", f"{path}.zst"], check=True)
        path = path.with_name(f"{path.name}.zst")
    else:
        pytest.skip("zstd isn't installed")
    done = subprocess.run([BUILD / "whittle", path, tmp_path / "out.ply", "--ratio", "0.02", "--memory", LIMIT,
                           "--threads", "1", "-f"], capture_output=True, text=True, check=True)
    assert "tiles in" in done.stderr
    daemon = limited(make_daemon)
    job = daemon.submit(path.read_bytes(), QUERY)
    ended = daemon.ended(job)
    assert ended["problem"] is None, ended["problem"]
    assert ended["status"] == "successful" and ended["tiles"]["of"] > 2, (ended, daemon.log_text()[-3000:])
    assert ended["resources"]["peak_rss_bytes"] < (160 << 20) + len(path.read_bytes()) + 40 * POINTS
    assert content(daemon, job) == (tmp_path / "out.ply").read_bytes()
    torn = daemon.ended(daemon.submit(path.read_bytes()[:-2000], QUERY))
    assert torn["status"] == "failed" and torn["problem"]["type"].endswith("malformed-cloud"), torn


def in_columns(pcd):
    """A binary PCD as binary_compressed: column after column, here as LZF has what it can't make shorter."""
    head, body = pcd.split(b"DATA binary\n")
    sizes = [int(size) for size in re.search(rb"SIZE (.*)", head)[1].split()]
    starts, each = [sum(sizes[:i]) for i in range(len(sizes))], sum(sizes)
    columns = b"".join(b"".join(body[i + start:i + start + size] for i in range(0, len(body), each))
                       for start, size in zip(starts, sizes))
    runs = (columns[i:i + 32] for i in range(0, len(columns), 32))
    packed = b"".join(bytes([len(run) - 1]) + run for run in runs)
    return head + b"DATA binary_compressed\n" + struct.pack("<II", len(packed), len(columns)) + packed


def test_progress_never_goes_back(make_daemon, cloud):
    daemon = limited(make_daemon)
    job = daemon.submit(cloud.read_bytes(), QUERY)
    seen = []
    wait_until(lambda: seen.append(daemon.job(job)) or seen[-1]["status"] == "successful", "the end")
    assert [j["progress"] for j in seen] == sorted(j["progress"] for j in seen)
    done = [j["tiles"]["done"] for j in seen if j["tiles"]]
    assert done == sorted(done) and len(set(done)) > 1


def test_killed_workers_cost_a_tile_each(make_daemon, cloud, expected):
    daemon = limited(make_daemon)
    job = daemon.submit(cloud.read_bytes(), QUERY)
    killed = []

    def kill_next():
        for attempt, pid in re.findall(rf"job={job} accepted -> running attempt=(\d+) pid=(\d+)", daemon.log_text()):
            if int(attempt) in (1, 3, 4) and pid not in killed and process_lives(int(pid)):
                os.kill(int(pid), signal.SIGKILL)
                killed.append(pid)
        return len(killed) == 3 or daemon.job(job)["status"] not in ("accepted", "running")

    wait_until(kill_next, "three processes that were killed")
    ended = daemon.ended(job)
    assert ended["status"] == "successful" and killed
    assert ended["attempt"] <= ended["tiles"]["of"] + 2 + len(killed)
    assert content(daemon, job) == expected


@pytest.mark.skipif(HOSTS, reason="a host that is killed holds its leases")
def test_a_killed_service_goes_on_where_it_was(make_daemon, cloud, expected):
    daemon = limited(make_daemon)
    job = daemon.submit(cloud.read_bytes(), QUERY)
    for tiles in (0, 1, 3):
        wait_until(lambda: (daemon.job(job)["tiles"] or {}).get("done", -1) >= tiles, f"{tiles} tiles")
        before = daemon.job(job)["tiles"]["done"]
        daemon.kill()
        daemon.start()
        assert daemon.job(job)["tiles"]["done"] >= before  # what is done stays done
    ended = daemon.ended(job)
    assert ended["status"] == "successful" and content(daemon, job) == expected
    wait_until(lambda: blobs_of(daemon, job) == [] and daemon.leftovers() == [], "an empty folder")


@pytest.mark.skipif(HOSTS, reason="a host that is killed holds its leases")
def test_what_another_version_has_planned_begins_anew(make_daemon, cloud, expected):
    daemon = limited(make_daemon)
    job = daemon.submit(cloud.read_bytes(), QUERY)
    wait_until(lambda: (daemon.job(job)["tiles"] or {}).get("done", 0) > 0, "a tile")
    daemon.kill()
    plan = daemon.data / "jobs" / job / "tiles" / "plan"
    head = bytearray(plan.read_bytes())
    head[16:20] = b"9.9\0"  # after the mark
    plan.write_bytes(head)
    daemon.start()
    ended = daemon.ended(job)
    assert ended["status"] == "successful" and content(daemon, job) == expected
    assert "was made by whittle 9.9" in daemon.log_text()


@pytest.mark.skipif(HOSTS, reason="a host that is killed holds its leases")
@pytest.mark.parametrize("name", ["points", "left"])
def test_what_the_disk_has_damaged_is_made_anew(make_daemon, cloud, expected, name):
    daemon = limited(make_daemon)
    job = daemon.submit(cloud.read_bytes(), QUERY)
    wait_until(lambda: (daemon.job(job)["tiles"] or {}).get("done", 0) > 0, "a tile")
    daemon.kill()
    for path in (daemon.data / "jobs" / job / "tiles").glob(f"{name}.*"):
        damaged = bytearray(path.read_bytes())
        damaged[len(damaged) // 2] ^= 1
        path.write_bytes(damaged)
    daemon.start()
    ended = daemon.ended(job)
    assert ended["status"] == "successful" and content(daemon, job) == expected
    assert "it is damaged" in daemon.log_text()


@pytest.mark.parametrize("tiles", [None, 1])
def test_cancelling_leaves_nothing(make_daemon, cloud, tiles):
    daemon = limited(make_daemon)
    job = daemon.submit(cloud.read_bytes(), QUERY)
    if tiles is None:
        daemon.wait_for(job, "running")
    else:
        wait_until(lambda: (daemon.job(job)["tiles"] or {}).get("done", 0) >= tiles, "a tile")
    pids = [int(pid) for pid in re.findall(rf"job={job} accepted -> running attempt=\d+ pid=(\d+)", daemon.log_text())]
    assert daemon.curl(f"/v1/jobs/{job}", "-X", "DELETE").json["status"] == "dismissed"
    wait_until(lambda: not any(process_lives(pid) for pid in pids), "the end of its processes")
    if not HOSTS:
        wait_until(lambda: blobs_of(daemon, job) == [] and daemon.leftovers() == [], "an empty folder")
        assert daemon.ask("SELECT count(*) FROM tasks") == [(0,)]
    other = daemon.submit(b"0 0 0\n1 0 0\n0 1 0\n1 1 0\n", "?ratio=1&outputs=cloud")
    assert daemon.ended(other)["status"] == "successful"


def test_a_job_in_tiles_is_one_job_of_its_principal(make_daemon, cloud):
    daemon = limited(make_daemon, "--principal-jobs", "1")
    job = daemon.submit(cloud.read_bytes(), QUERY)
    daemon.wait_for(job, "running")
    refused = daemon.post("/v1/jobs?outputs=cloud&ratio=1", b"0 0 0\n1 0 0\n0 1 0\n")
    assert refused.status == 429
    assert daemon.ended(job)["status"] == "successful"
    assert daemon.post("/v1/jobs?outputs=cloud&ratio=1", b"0 0 0\n1 0 0\n0 1 0\n").status == 201


def test_principals_take_turns_between_tasks(make_daemon, cloud, expected, tmp_path):
    """Tiles of one don't keep another one's job waiting until they are all done, though there is one worker."""
    tokens = tmp_path / "tokens"
    tokens.write_text("".join(f"{name}:submit,read:{hashlib.sha256(name.encode()).hexdigest()}\n"
                              for name in ("alice", "bob")), encoding="ascii")
    daemon = make_daemon("--job-memory", LIMIT, "--workers", "1", "--threads-per-job", "1", "--tokens-file", tokens)

    def of(name, path, *arguments, data=None):
        return daemon.curl(path, "-H", f"Authorization: Bearer {name}", *arguments, data=data)

    def submit(name, query, data):
        reply = of(name, f"/v1/jobs{query}", "-X", "POST", "--data-binary", "@-", "-H", "Expect:", data=data)
        assert reply.status == 201, reply.body
        return reply.json["id"]

    large = submit("alice", QUERY, cloud.read_bytes())
    wait_until(lambda: (of("alice", f"/v1/jobs/{large}").json["tiles"] or {}).get("done", 0) > 0, "a tile")
    small = submit("bob", "?ratio=1&outputs=cloud", b"0 0 0\n1 0 0\n0 1 0\n1 1 0\n")
    wait_until(lambda: of("bob", f"/v1/jobs/{small}").json["status"] == "successful", "the other one's job")
    wait_until(lambda: of("alice", f"/v1/jobs/{large}").json["status"] == "successful", "the end")
    before, after = daemon.log_text().split(f"job={small} accepted -> running")
    assert before.count(f"job={large} accepted -> running") < after.count(f"job={large} accepted -> running") + 4
    assert f"job={large} accepted -> running" in after
    assert of("alice", f"/v1/jobs/{large}/outputs/cloud.ply").body == expected


@pytest.mark.parametrize("query", ["?ratio=0.02&outputs=dso", "?ratio=0.02&outputs=cloud&denoise=full",
                                   "?ratio=0.9&outputs=cloud"])
def test_what_tiles_cannot_do_is_refused(make_daemon, cloud, query):
    daemon = limited(make_daemon)
    reply = daemon.post(f"/v1/jobs{query}", cloud.read_bytes())
    assert (reply.status, reply.slug) == (422, "would-exceed-memory") or reply.status == 413
    assert "MiB" in reply.json["detail"]


def test_hosts_share_the_tasks(make_daemon, shared, cloud, expected):
    """One of them is killed on the way."""
    front = limited(make_daemon, *shared, "--roles", "http")
    job = front.submit(cloud.read_bytes(), QUERY)
    hosts = [limited(make_daemon, *shared) for _ in range(2)]
    wait_until(lambda: all(f"job={job}" in host.log_text() for host in hosts), "a task of each host")
    wait_until(lambda: (front.job(job)["tiles"] or {}).get("done", 0) > 0, "a tile")
    hosts[0].kill()
    ended = front.ended(job)
    assert ended["status"] == "successful" and ended["tiles"]["done"] == ended["tiles"]["of"]
    assert content(front, job) == expected
    if any(str(flag).startswith("file:") for flag in shared):
        folder = next(str(flag) for flag in shared if str(flag).startswith("file:"))[5:]
        wait_until(lambda: not os.path.exists(f"{folder}/jobs/{job}/tiles"), "the removal of tiles")


def tasks_that_run(hosts, job):
    """Pairs of a task, as its process was told it, and the process."""
    found = []
    for host in hosts:
        for pid in re.findall(rf"job={job} accepted -> running attempt=\d+ pid=(\d+)", host.log_text()):
            words = read_of(int(pid), "cmdline").split() if process_lives(int(pid)) else []
            if "work" in words:
                found.append((words[words.index("work") + 1], int(pid)))
    return found


def test_three_hosts_and_twenty_kills(make_daemon, shared, cloud, tmp_path):
    """Hosts and processes of tasks die by kill -9 at random moments, and the bytes are those of the command, which is
    one process on one thread.  A process is killed once for each task, since one that dies three times has failed."""
    seed = int(os.environ.get("SEED", random.randrange(1 << 30)))
    print(f"SEED={seed}")
    when, data = random.Random(seed), cloud.read_bytes()
    front = limited(make_daemon, *shared, "--roles", "http")
    hosts = [limited(make_daemon, *shared) for _ in range(3)]
    kills, jobs = {"host": 0, "task": 0}, []
    while sum(kills.values()) < 20:
        points = 12000 - 100 * len(jobs)
        job, struck = front.submit(data, f"?points={points}&outputs=cloud"), set()
        jobs.append(job)
        while sum(kills.values()) < 20 and front.job(job)["status"] in ("accepted", "running"):
            time.sleep(when.uniform(0, 0.4))
            fresh = [(task, pid) for task, pid in tasks_that_run(hosts, job) if task not in struck]
            if fresh and when.random() < 0.5:
                task, pid = when.choice(fresh)
                struck.add(task)
                with contextlib.suppress(ProcessLookupError):  # it may have ended just now
                    os.kill(pid, signal.SIGKILL)
                    kills["task"] += 1
            elif when.random() < 0.5:
                host = when.choice(hosts)
                host.kill()
                host.start()
                kills["host"] += 1
        ended = front.ended(job)
        assert ended["status"] == "successful", (ended, [host.log_text()[-3000:] for host in hosts])
        assert ended["tiles"]["done"] == ended["tiles"]["of"] > 2
        subprocess.run([BUILD / "whittle", cloud, tmp_path / "out.ply", "--points", str(points), "--memory", LIMIT,
                        "--threads", "1", "-f"], capture_output=True, check=True)
        assert content(front, job) == (tmp_path / "out.ply").read_bytes()
    print(f"{kills} in {len(jobs)} jobs")
    assert kills["host"] and kills["task"]
    assert all(any(f"job={job}" in host.log_text() for job in jobs) for host in hosts)  # each has had a part
