# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory and points: what can't fit is refused before its body, what can't run now waits."""
import gzip
import math
import os
import pathlib
import random
import re
import struct
import subprocess

import pytest

import conftest
from conftest import SANITIZED, SMALL, process_lives, sphere


def ply_header(points, extra=""):
    return (f"ply\nformat binary_little_endian 1.0\nelement vertex {points}\nproperty float x\nproperty float y\n"
            f"property float z\n{extra}end_header\n").encode()


def ply(points):
    return ply_header(points) + b"".join(struct.pack("<3f", i % 97, i % 89, i % 83) for i in range(points))


def test_a_job_that_cannot_fit_is_refused_by_its_header(make_daemon):
    daemon = make_daemon("--job-memory", "400M", "--worker-sandbox=off")
    points = 10_000_000
    # The length is a promise; what follows the header never comes.
    reply = daemon.curl("/v1/jobs?ratio=0.1", "-X", "POST", "--data-binary", "@-", "-H", "Expect:",
                        "-H", "Transfer-Encoding: chunked", data=ply_header(points) + b"x" * 5000)
    assert (reply.status, reply.slug) == (413, "would-exceed-memory")
    assert reply.json["limit"] == 400 << 20 and reply.json["actual"] > points * 50
    assert "points would fit" in reply.json["hint"] or "ratio=" in reply.json["hint"]
    assert daemon.leftovers() == []


def test_the_hint_is_true(make_daemon):
    daemon = make_daemon("--job-memory", "80M", "--worker-sandbox=off")
    cloud = ply(60000)
    reply = daemon.post("/v1/jobs?ratio=1&outputs=mesh", cloud)
    assert (reply.status, reply.slug) == (413, "would-exceed-memory")
    ratio = re.fullmatch(r"ratio=([0-9.]+) would fit", reply.json["hint"]).group(1)
    assert daemon.post(f"/v1/jobs?ratio={ratio}&outputs=mesh", cloud).status == 201
    cloud = ply(400000)
    reply = daemon.post("/v1/jobs?ratio=0.1", cloud)
    assert reply.slug == "would-exceed-memory"
    points = int(re.match(r"about (\d+) points would fit", reply.json["hint"]).group(1))
    assert daemon.post("/v1/jobs?ratio=0.1", ply(points)).status == 201


def test_parameters_of_a_form_and_named_clouds_count_too(make_daemon, tmp_path):
    daemon = make_daemon("--job-memory", "80M", "--worker-sandbox=off")
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply(60000))
    reply = daemon.curl("/v1/jobs", "-F", f"file=@{path}", "-F", "ratio=1", "-F", "outputs=mesh")
    assert (reply.status, reply.slug) == (413, "would-exceed-memory")
    reply = daemon.post("/v1/clouds", path.read_bytes())
    assert reply.status == 201
    wish = '{"input":"%s","params":{"ratio":%s,"outputs":["mesh"]}}'
    cloud = reply.headers["location"]
    arguments = ("-H", "Content-Type: application/json")
    assert daemon.post("/v1/jobs", (wish % (cloud, 1)).encode(), *arguments).slug == "would-exceed-memory"
    assert daemon.post("/v1/jobs", (wish % (cloud, 0.01)).encode(), *arguments).status == 201


def test_a_plan_says_what_a_job_would_take(make_daemon):
    """Kept points, memory and whether it fits; no job is made."""
    daemon = make_daemon("--job-memory", "80M", "--worker-sandbox=off")
    cloud = ply(60000)
    reply = daemon.post("/v1/clouds", cloud)
    path = reply.headers["location"] + "/plan"
    plan = daemon.curl(path + "?ratio=1&outputs=mesh").json
    refused = daemon.post("/v1/jobs?ratio=1&outputs=mesh", cloud).json
    assert not plan["fits"] and plan["problem"] == refused
    assert plan["memory_bytes"] == refused["actual"] > plan["memory_limit_bytes"] == 80 << 20
    plan = daemon.curl(path + "?levels=0.1,0.01&outputs=cloud").json
    assert plan["fits"] and plan["problem"] is None and plan["seconds"] is None
    assert (plan["points"], plan["points_out"], plan["cloud"]) == (60000, [6000, 600], reply.json["id"])
    assert 60000 * 50 < plan["memory_bytes"] <= 80 << 20
    assert daemon.curl(path + "?points=70000").json["points_out"] == [60000]
    for found_out in ("spacing=0.1", "max_deviation=0.1", "where=x>0", "crop=0,0,0,1,1,1"):
        assert daemon.curl(path + "?" + found_out).json["points_out"] is None
    assert daemon.curl(path + "?ratio=2").slug == "invalid-parameter"
    assert daemon.curl(path + "?rato=0.2").slug == "unknown-parameter"
    assert daemon.curl("/v1/clouds/" + "0" * 64 + "/plan").slug == "no-such-cloud"
    assert daemon.curl("/v1/jobs").json["jobs"] == []


def test_a_plan_says_how_long_such_jobs_took(make_daemon):
    daemon = make_daemon("--result-cache=0")
    ended = [daemon.ended(daemon.submit(sphere(4000), "?ratio=0.1")) for _ in range(2)]
    assert [job["status"] for job in ended] == ["successful", "successful"]
    took = [job["resources"]["wall_seconds"] for job in ended]
    text = daemon.post("/v1/clouds", sphere(4000)).headers["location"] + "/plan"
    plan = daemon.curl(text + "?ratio=0.1").json
    assert abs(plan["seconds"] - sum(took) / 2) <= 0.005 + 1e-9 and plan["points"] == 4000


def test_too_many_points(make_daemon):
    daemon = make_daemon("--max-points", "1000")
    for path in ("/v1/jobs", "/v1/clouds", "/v1/simplify"):
        reply = daemon.post(path, ply(1001))
        assert (reply.status, reply.slug) == (413, "too-many-points")
        assert reply.json["limit"] == 1000 and reply.json["actual"] == 1001
    assert daemon.post("/v1/jobs", sphere(2000)).slug == "too-many-points"
    assert daemon.post("/v1/simplify", ply(1000)).status == 200
    assert daemon.post("/v1/simplify", sphere(1000)).status == 200
    assert daemon.curl("/v1/info").json["limits"]["max_points"] == 1000


def test_jobs_that_do_not_fit_together_wait(make_daemon, large):
    daemon = make_daemon("--workers", "2", "--total-memory", "200M")
    first, second = daemon.submit(large, "?ratio=0.1"), daemon.submit(large, "?ratio=0.2")
    small = daemon.submit(SMALL)
    pid = daemon.worker_pid(first)
    assert daemon.job(second)["status"] == "accepted" or not process_lives(pid)
    jobs = [daemon.ended(job_id) for job_id in (first, second, small)]
    assert all(job["status"] == "successful" for job in jobs)
    order = re.findall(r"job=(\S+) (?:accepted -> running|running -> successful)", daemon.log_text())
    assert order[:2] == [first, first], "the second began while the first ran"


def packed_ply(points):
    """Compressed, with a header that can be believed and a body that never comes whole."""
    return gzip.compress(ply_header(points) + os.urandom(200000))


def test_what_is_compressed_is_looked_into(make_daemon):
    daemon = make_daemon("--job-memory", "400M", "--worker-sandbox=off", "--max-points", "20000000")
    for body in (packed_ply(10_000_000), packed_ply(10_000_000)[:70000]):
        reply = daemon.post("/v1/jobs?ratio=0.1", body)
        assert (reply.status, reply.slug) == (413, "would-exceed-memory")
        assert reply.json["actual"] > 10_000_000 * 50
    assert daemon.post("/v1/clouds", packed_ply(20_000_001)).slug == "too-many-points"
    assert daemon.leftovers() == []


def failing_worker(folder):
    worker = folder / "worker"
    worker.write_text("#!/bin/sh\necho 'failed no-memory 0 - knn no memory for the tree' >&3\nexit 71\n")
    worker.chmod(0o755)
    return worker


@pytest.mark.parametrize("pack", [bytes, gzip.compress], ids=["plain", "gzip"])
def test_a_prediction_that_was_wrong_says_so_and_what_would_fit(make_daemon, tmp_path, pack):
    daemon = make_daemon("--worker", failing_worker(tmp_path), "--worker-sandbox=off", "--job-memory", "300M")
    cloud = pack(ply(130000))
    job = daemon.ended(daemon.submit(cloud, "?ratio=0.8&outputs=mesh"))
    problem = job["problem"]
    assert problem["type"] == "/problems/out-of-memory"
    assert 0 < problem["predicted_bytes"] < problem["limit"] == 300 << 20 and problem["used_bytes"] > 0
    said = re.fullmatch(r"no memory for the tree: (\d+) MiB were predicted, \d+ MiB used, 300 MiB of address space "
                        r"allowed; (ratio=(0\.\d+) would fit)", problem["detail"])
    assert int(said[1]) == problem["predicted_bytes"] >> 20 and said[2] == problem["hint"]
    # With that ratio, a quarter less is predicted.
    again = daemon.ended(daemon.submit(cloud, f"?ratio={said[3]}&outputs=mesh"))["problem"]
    assert 0.6 < again["predicted_bytes"] / problem["predicted_bytes"] <= 0.751


def test_a_job_has_what_was_predicted_and_no_more(make_daemon, tmp_path):
    """Where the limit of all jobs is far away, the prediction is the limit."""
    daemon = make_daemon("--worker", failing_worker(tmp_path), "--worker-sandbox=off", "--job-memory", "3G")
    problem = daemon.ended(daemon.submit(ply(200000), "?ratio=0.1&threads=1"))["problem"]
    assert problem["type"] == "/problems/out-of-memory"
    assert problem["predicted_bytes"] < problem["limit"] < problem["predicted_bytes"] * 1.125 + (45 << 20)
    said = re.fullmatch(r"no memory for the tree: the (\d+) MiB predicted did not suffice, \d+ MiB used, (\d+) MiB of "
                        r"data allowed; (.+)", problem["detail"])
    assert int(said[1]) == problem["predicted_bytes"] >> 20 and int(said[2]) == problem["limit"] >> 20
    assert said[3] == problem["hint"]


def test_texts_are_predicted_too(make_daemon, tmp_path):
    daemon = make_daemon("--worker", failing_worker(tmp_path), "--worker-sandbox=off", "--job-memory", "3G")
    cloud = sphere(100000)
    plain, packed = (daemon.ended(daemon.submit(body))["problem"]["predicted_bytes"]
                     for body in (cloud, gzip.compress(cloud)))
    assert 0.7 < packed / plain < 1.4
    nothing_known = daemon.ended(daemon.submit(b"OFF\n1 0 0\n0 0 0\n"))["problem"]
    assert nothing_known["hint"] and nothing_known["detail"].endswith(nothing_known["hint"])


def cone(points):
    """Points on a cone, as text: about 20 tetrahedra for each, twice what is predicted."""
    rng = random.Random(3)
    lines = []
    for _ in range(points):
        h, a = rng.random(), 2 * math.pi * rng.random()
        lines.append(f"{h * math.cos(a):.6f} {h * math.sin(a):.6f} {2 * h:.6f}\n")
    return "".join(lines).encode()


def as_ply(text):
    rows = [tuple(map(float, line.split())) for line in text.decode().splitlines()]
    return ply_header(len(rows)) + b"".join(struct.pack("<3f", *row) for row in rows)


@pytest.mark.skipif(SANITIZED, reason="sanitizers have a time and memory of their own")
def test_a_job_with_more_tetrahedra_than_predicted_gets_the_memory_for_them(make_daemon):
    daemon = make_daemon("--job-memory", "3G", "--workers", "1")
    job_id = daemon.submit(as_ply(cone(20000)), "?ratio=1&outputs=mesh&refine=none&threads=1")
    job = daemon.ended(job_id)
    assert job["status"] == "successful" and job["attempt"] == 2
    said = re.search(rf"job={job_id} running -> queued again attempt=1 .*?: the 20000 points of the mesh have more than "
                     r"(\d+) tetrahedra between them, .* and (\d+) MiB have no room for more", daemon.log_text())
    assert int(said[1]) > 200000 and int(said[2]) < 100
    assert daemon.log_text().count("queued again") == 1


@pytest.mark.skipif(SANITIZED, reason="sanitizers have a time and memory of their own")
def test_a_job_with_too_many_tetrahedra_for_its_limit_fails(make_daemon):
    daemon = make_daemon("--job-memory", "80M", "--worker-sandbox=off")
    job = daemon.ended(daemon.submit(as_ply(cone(20000)), "?ratio=1&outputs=mesh&refine=none&threads=1"))
    assert job["status"] == "failed" and job["attempt"] == 2
    problem = job["problem"]
    assert problem["type"] == "/problems/out-of-memory" and problem["limit"] == 80 << 20
    assert problem["detail"].startswith("the 20000 points of the mesh have more than") and problem["hint"]


@pytest.fixture(scope="session")
def no_exact_numbers(tmp_path_factory):
    """A library to preload: exact numbers get no memory."""
    library = tmp_path_factory.mktemp("preloaded") / "exact_without_memory.so"
    source = pathlib.Path(__file__).with_name("exact_without_memory.c")
    subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return library


@pytest.mark.skipif(SANITIZED, reason="sanitizers have a time and memory of their own")
@pytest.mark.parametrize("count", [0, 1000])
def test_exact_numbers_without_memory_are_told_as_all_else_is(no_exact_numbers, tmp_path, count):
    """A lattice that isn't along the axes takes exact numbers: rounding makes flat tetrahedra of points on one plane.
    This one is so small, in the middle of a cube, that its sums are beyond double, so that rational numbers are taken."""
    path, small, side = tmp_path / "lattice.xyz", 1e-110, [k / 4 for k in range(-4, 5)]
    cube = [(x, y, z) for x in side for y in side for z in side if max(abs(x), abs(y), abs(z)) == 1]
    lattice = [(small * (0.1 * i + 0.03 * j), small * (0.1 * j - 0.07 * k), small * (0.1 * k + 0.011 * i))
               for i in range(4) for j in range(4) for k in range(4)]
    path.write_text("".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in cube + lattice))
    told = tmp_path / "told"
    with open(told, "w") as out:
        run = subprocess.run([conftest.BUILD / "whittle", path, "--ratio", "1", "--outputs", "mesh", "--refine", "none",
                              "--surface", "closed", "-o", tmp_path / "out", "--progress-fd", str(out.fileno())],
                             capture_output=True, text=True, pass_fds=[out.fileno()], check=False,
                             env={**os.environ, "LD_PRELOAD": str(no_exact_numbers),
                                  "WHITTLE_EXACT_NUMBERS": str(count)})
    assert (run.returncode, run.stderr) == (71, f"whittle: {path}: delaunay: no memory for an exact number\n")
    assert told.read_text().splitlines()[-1].startswith("failed no-memory ")
    assert not (tmp_path / "out" / "mesh.ply").exists()


def fan(points, corners):
    """An OBJ file with one face of many corners, all of one digit: as many triangles as half of its bytes."""
    rng = random.Random(4)
    lines = []
    for _ in range(points):
        p = [rng.gauss(0, 1) for _ in range(3)]
        r = math.sqrt(sum(c * c for c in p))
        lines.append("v " + " ".join(f"{c / r:.6f}" for c in p) + "\n")
    return "".join(lines).encode() + b"f" + b" 1 2 3 4 5 6 7" * (corners // 7) + b"\n"


@pytest.mark.skipif(SANITIZED, reason="sanitizers have a time and memory of their own")
def test_a_job_with_more_triangles_than_predicted_gets_the_memory_for_them(make_daemon):
    daemon = make_daemon("--job-memory", "3G", "--workers", "1")
    job_id = daemon.submit(fan(5000, 700000), "?outputs=mesh&threads=1")
    job = daemon.ended(job_id)
    assert job["status"] == "successful" and job["attempt"] == 2
    said = re.search(rf"job={job_id} running -> queued again attempt=1 .*?: the faces are more than (\d+) triangles, and "
                     "the memory allowed has no room for more", daemon.log_text())
    assert int(said[1]) < 699998


def test_faces_that_memory_has_no_room_for_are_refused(tmp_path):
    path = tmp_path / "fan.obj"
    path.write_bytes(fan(5000, 70000))
    arguments = [conftest.BUILD / "whittle", path, "--outputs", "mesh", "-o", tmp_path / "out", "--memory"]
    for memory, said in (("20M", "69998 triangles and 5000 points, and the 20 MiB of memory allowed have no room"),
                         ("7M", "the faces are more than")):
        run = subprocess.run([*arguments, memory], capture_output=True, text=True)
        assert run.returncode == 71 and said in run.stderr
    assert subprocess.run([*arguments, "60M"]).returncode == 0
