# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory and points: what can't fit is refused before its body, what can't run now waits."""
import gzip
import os
import re
import struct

import pytest

from conftest import SMALL, process_lives, sphere


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
    daemon = make_daemon("--job-memory", "60M", "--worker-sandbox=off")
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
    daemon = make_daemon("--job-memory", "60M", "--worker-sandbox=off")
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
    cloud = pack(ply(200000))
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


def test_texts_are_predicted_too(make_daemon, tmp_path):
    daemon = make_daemon("--worker", failing_worker(tmp_path), "--worker-sandbox=off", "--job-memory", "3G")
    cloud = sphere(100000)
    plain, packed = (daemon.ended(daemon.submit(body))["problem"]["predicted_bytes"]
                     for body in (cloud, gzip.compress(cloud)))
    assert 0.7 < packed / plain < 1.4
    nothing_known = daemon.ended(daemon.submit(b"OFF\n1 0 0\n0 0 0\n"))["problem"]
    assert nothing_known["hint"] and nothing_known["detail"].endswith(nothing_known["hint"])
